"""Weights of segments: a teacher tells what matters in a dance.

A file of TOML or plain lines ``segment = number``:

    arms = 2            # arms are what this dance is about
    left_forearm = 1.5  # what is named more exactly counts
    legs = 0            # not judged

What is not named weighs 1.
"""

from __future__ import annotations

import os
import tomllib
from collections.abc import Mapping
from typing import Any

from dousa.errors import OptionError
from dousa.evaluation.posture import LIMBS, SEGMENTS

__all__ = ["LEVELS", "read_weights"]

_MOST_BYTES = 1_000_000
_LARGEST = 1e6
_SHOWN = 40  # letters of a wrong value in a message

# From the coarse names to the exact ones, which are laid over them.
LEVELS: tuple[dict[str, tuple[str, ...]], ...] = (
    {
        "arms": tuple(SEGMENTS[i] for i in (*LIMBS["left_arm"], *LIMBS["right_arm"])),
        "legs": tuple(SEGMENTS[i] for i in (*LIMBS["left_leg"], *LIMBS["right_leg"])),
    },
    {name: tuple(SEGMENTS[i] for i in members) for name, members in LIMBS.items() if name not in SEGMENTS},
    {name: (name,) for name in SEGMENTS},
)


def read_weights(path: str | os.PathLike[str]) -> dict[str, float]:
    """Read a file of weights.

    Parameters
    ----------
    path : TOML, or lines ``segment = number``; names of `SEGMENTS`, of `LIMBS`, or ``arms`` and ``legs``. Spaces
        in a name are underscores, capitals do not matter.

    Returns
    -------
    Weight of every one of the nine segments, 0 or more, at least one above 0.

    Raises
    ------
    OptionError : the file cannot be read, a name that is no segment, a weight that is no number of 0 or more,
        nothing that weighs.
    """
    where = os.fspath(path)
    entries: dict[str, Any] = {}
    for given, value in _parse(_read_text(path, where), where).items():
        if _plain(given) in entries:
            raise OptionError(f"{where}: '{given}' is given a second time")
        entries[_plain(given)] = value
    known = [name for level in LEVELS for name in level]
    weights = dict.fromkeys(SEGMENTS, 1.0)
    for name, value in entries.items():
        if name not in known:
            raise OptionError(f"{where}: '{name}' is no segment; there are: {', '.join(known)}")
        _check(value, name, where)
    for level in LEVELS:
        for name in level.keys() & entries.keys():
            weights.update(dict.fromkeys(level[name], float(entries[name])))
    if not any(weights.values()):
        raise OptionError(f"{where}: every segment weighs 0, so nothing is left to judge; give one a weight")
    return weights


def _read_text(path: str | os.PathLike[str], where: str) -> str:
    try:
        # Not the size that the system tells: a device or a pipe has none, and may never end.
        with open(path, "rb") as file:
            data = file.read(_MOST_BYTES + 1)
        if len(data) > _MOST_BYTES:
            raise OptionError(f"{where}: expected weights, a few lines, got a file of over 1 MB")
        return data.decode("utf-8-sig")
    except OSError as error:
        raise OptionError(f"{where}: the weights cannot be read: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise OptionError(f"{where}: expected text in UTF-8: {error}") from error


def _parse(text: str, where: str) -> Mapping[str, Any]:
    try:
        entries = tomllib.loads(text)
    except (ValueError, RecursionError):  # no TOML, or a number of too many digits
        entries = _parse_lines(text, where)
    if len(entries) == 1 and isinstance(inner := next(iter(entries.values())), dict):
        entries = inner  # under one heading, such as [weights]
    if not entries:
        raise OptionError(f"{where}: expected lines 'segment = number', got none")
    return entries


def _parse_lines(text: str, where: str) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for number, line in enumerate(text.splitlines(), 1):
        content = line.partition("#")[0].strip()
        if not content or (content.startswith("[") and content.endswith("]")):
            continue
        name, equals, value = (part.strip() for part in content.partition("="))
        if not equals or not name or not value:
            raise OptionError(f"{where}:{number}: expected 'segment = number', got {_shown(content)}")
        if _plain(name) in found:
            raise OptionError(f"{where}:{number}: '{name}' is given a second time")
        try:
            found[_plain(name)] = float(value)
        except ValueError:
            raise OptionError(
                f"{where}:{number}: expected a number for '{name}', got {_shown(value)}"
            ) from None
    return found


def _plain(name: str) -> str:
    return "_".join(name.strip().lower().replace("-", " ").split())


def _check(value: Any, name: str, where: str) -> None:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    # nan is in no range; an integer may be too large for a float.
    if not number or not 0 <= value <= _LARGEST:
        raise OptionError(f"{where}: '{name}': expected a weight from 0 to a million, got {_shown(value)}")


def _shown(value: Any) -> str:
    """The beginning of a wrong value."""
    try:
        text = repr(value)
    except ValueError:  # an integer of more digits than Python writes
        text = "a huge number"
    return text if len(text) <= _SHOWN else text[:_SHOWN] + "..."
