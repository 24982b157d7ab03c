"""How motion files are read: `ReadOptions` from ``--read KEY=VALUE`` and the options of its usual keys."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dousa.errors import OptionError

if TYPE_CHECKING:
    from dousa.formats.motion_files import ReadOptions

_OWN = ("person", "animation")  # keys with options of their own where a command is about single files
_YES, _NO = ("", "yes", "true", "1"), ("no", "false", "0")


@dataclass(frozen=True, slots=True)
class Reading:
    """Properties of motion files that they do not state themselves."""

    read: Annotated[
        list[str] | None,
        typer.Option(
            "--read",
            metavar="KEY=VALUE",
            help="How files are read; repeatable. unit=cm; up=z; skeleton=FILE (.asf of an .amc, .pmx of a .vmd, SMPL "
            "model); frame_rate=HZ; person=NAME, animation=NAME (of several; or a number from 1); joint_map=FILE; "
            "any_skeleton (also animals); markers (on the skin, though named like joints; markers=no: joints).",
        ),
    ] = None

    @property
    def values(self) -> dict[str, Any]:
        """The options by name, as `ReadOptions` takes them; a joint map as its file.

        Raises
        ------
        OptionError : an unknown key, a key without a value, one given twice, a value that cannot be understood.
        """
        given = ((key, getattr(self, key, None)) for key in _OWN)
        return _parse((*(self.read or ()), *(f"{key}={value}" for key, value in given if value is not None)))

    @property
    def files(self) -> tuple[Path | None, ...]:
        """The files that the options name."""
        return tuple(self.values.get(key) for key in ("skeleton", "joint_map"))

    def load(self) -> ReadOptions:
        """Parse the options and read the joint map.

        Raises
        ------
        OptionError : as `values`, or a joint map that cannot be read.
        """
        from dousa.formats.motion_files import ReadOptions

        values = self.values
        if "joint_map" in values:
            from dousa.motion import read_joint_map

            values["joint_map"] = read_joint_map(values["joint_map"])
        return ReadOptions(**values)


@dataclass(frozen=True, slots=True)
class PartReading(Reading):
    """The same for commands about single files, with the parts of a file as options of their own."""

    person: Annotated[
        str | None,
        typer.Option(
            "--person", metavar="NAME|N", help="Whose motion, of several people. Default: seen most, or first."
        ),
    ] = None
    animation: Annotated[
        str | None,
        typer.Option("--animation", metavar="NAME|N", help="Which of several animations. Default: the longest."),
    ] = None


def _parse(texts: Iterable[str]) -> dict[str, Any]:
    values: dict[str, Any] = {}
    for text in texts:
        key, _, value = text.partition("=")
        key = key.strip().replace("-", "_")
        if key not in _PARSERS:
            raise OptionError("reading.unknown_key", found=key, known=tuple(_PARSERS))
        if key in values:
            raise OptionError("reading.twice", key=key)
        values[key] = _PARSERS[key](key, value.strip())
    return values


def _parse_text(key: str, value: str) -> str:
    if not value:
        raise OptionError("reading.no_value", key=key)
    return value


def _parse_file(key: str, value: str) -> Path:
    return Path(_parse_text(key, value))


def _parse_number(key: str, value: str) -> float:
    try:
        return float(_parse_text(key, value))
    except ValueError:
        raise OptionError("reading.not_a_number", key=key, found=value) from None


def _parse_switch(key: str, value: str) -> bool:
    if value.lower() not in (*_YES, *_NO):
        raise OptionError("reading.not_a_switch", key=key, found=value)
    return value.lower() in _YES


_PARSERS: Mapping[str, Callable[[str, str], Any]] = {
    "unit": _parse_text,
    "up": _parse_text,
    "skeleton": _parse_file,
    "frame_rate": _parse_number,
    "joint_map": _parse_file,
    "any_skeleton": _parse_switch,
    "person": _parse_text,
    "animation": _parse_text,
    "markers": _parse_switch,
}
