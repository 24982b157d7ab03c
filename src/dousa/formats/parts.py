"""The parts of a file: one of its people, one of its animations.

A reader that meets several asks `choose` with their names; people who differ only by the prefixes of their names, or by
their roots, are found in what was read (`dousa.formats.guard.people`). A note says which was taken and which were left
out.

An address names a file and a part of it in the way of media fragments (W3C, Media Fragments URI 1.0):
``moves.glb#animation=Walk``, ``two.glb#animation=Walk&person=Anna``.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import lru_cache
from typing import Any, TypeVar, cast

from dousa.errors import MotionFileError
from dousa.messages import Message

_T = TypeVar("_T")

KINDS = ("animation", "person")

_CODES = {
    "animation": ("parts.animation", "parts.animation_asked", "parts.no_animation"),
    "person": ("parts.person", "parts.person_asked", "parts.no_person"),
}
_ADDRESS = re.compile(rf"(.+?)#((?:{'|'.join(KINDS)})=[^#/\\]*)")
_RESERVED = re.compile(r"[\x00-\x20%#&=/\\]")


def file_of(path: str | os.PathLike[str]) -> str:
    """Return the file of an address; any other path as it is."""
    return split_address(path)[0]


def split_address(path: str | os.PathLike[str]) -> tuple[str, dict[str, str]]:
    """Split an address into its file and the parts by kind, {} for a whole file."""
    text = os.fspath(path)
    found = _ADDRESS.match(text) if "#" in text else None
    if found is None:
        return text, {}
    from urllib.parse import unquote

    pairs = (piece.partition("=") for piece in found[2].split("&"))
    return found[1], {kind: unquote(name) for kind, _, name in pairs if kind in KINDS}


def join_address(path: str | os.PathLike[str], parts: Mapping[str, str]) -> str:
    """Return the address of parts of a file, by kind."""
    fragment = "&".join(f"{kind}={_RESERVED.sub(_quote, parts[kind])}" for kind in KINDS if kind in parts)
    return f"{os.fspath(path)}#{fragment}" if fragment else os.fspath(path)


def _quote(sign: re.Match[str]) -> str:
    return f"%{ord(sign[0]):02X}"


def choose(
    path: str | os.PathLike[str],
    kind: str,
    names: Sequence[str],
    wanted: str | None,
    lengths: Sequence[float] | None = None,
) -> tuple[int, tuple[Message, ...]]:
    """Choose one of the people or animations of a file.

    Parameters
    ----------
    path : for the messages.
    kind : one of ``KINDS``.
    names : of the parts, in the order of the file, none twice (see `distinguish`).
    wanted : a name, or a number from 1; None takes the longest, of equal ones the first.
    lengths : of the parts: seconds, frames in which someone is seen; by default equal.

    Returns
    -------
    The index of the chosen part, and a note if there are several.

    Raises
    ------
    MotionFileError : there is no such part; the message lists those that there are.
    """
    taken, asked, missing = _CODES[kind]
    if wanted is None:
        chosen = max(range(len(names)), key=lambda number: lengths[number] if lengths is not None else 0)
    else:
        chosen = _find(names, wanted)
        if chosen < 0:
            raise MotionFileError(path, missing, found=wanted[:60], known=tuple(names))
    if len(names) < 2:
        return chosen, () if wanted is None else (Message("parts.alone", read=names[chosen]),)
    if wanted is None or len(names) <= _MANY:
        others = (*names[:chosen], *names[chosen + 1 :])
    else:  # each part names its neighbours in a ring: where no neighbour lacks, all are there
        others = (names[chosen - 1], names[(chosen + 1) % len(names)])
    return chosen, (Message(taken if wanted is None else asked, read=names[chosen], others=others),)


_MANY = 20  # by definition: parts of which each names all others in its note; n notes of n names are n squared


def load_once(load: Callable[[Any], _T], path: str | os.PathLike[str], part: str | None) -> _T:
    """Load the content of a file; that of the last file of which a ``part`` was asked for is kept for the next part.

    It is loaded again when size or time of the file have changed.
    """
    try:
        stat = os.stat(path) if part is not None else None
    except OSError:  # the reader says what is wrong
        stat = None
    return load(path) if stat is None else cast(_T, _load_once(load, os.fspath(path), stat.st_size, stat.st_mtime_ns))


@lru_cache(maxsize=1)
def _load_once(load: Callable[[Any], object], path: str, size: int, changed: int) -> object:
    return load(path)


def check_chosen(path: str | os.PathLike[str], kind: str, wanted: str, notes: Iterable[Message]) -> None:
    """Raise MotionFileError if a part was asked for of a file in which no reader met any: it holds one, the first.

    ``notes`` : of reading it.
    """
    if wanted != "1" and not {_CODES[kind][1], "parts.alone"} & {note.code for note in notes}:
        code = "parts.one_person" if kind == "person" else "parts.one_animation"
        raise MotionFileError(path, code, found=wanted[:60])


def _find(names: Sequence[str], wanted: str) -> int:
    lower = [name.lower() for name in names]
    if wanted.lower() in lower:
        return names.index(wanted) if wanted in names else lower.index(wanted.lower())
    number = int(wanted) if re.fullmatch(r"\d{1,6}", wanted) else 0
    if 0 < number <= len(names):
        return number - 1
    return next((index for index, name in enumerate(lower) if name == f"id {wanted}"), -1)


def distinguish(names: Iterable[str]) -> list[str]:
    """Return names of which none comes twice: the second ``Walk`` is ``Walk 2``."""
    counts: dict[str, int] = {}
    result = []
    for name in names:
        one = name
        while one in counts:
            counts[name] += 1
            one = f"{name} {counts[name]}"
        counts[one] = 1
        result.append(one)
    return result


def list_untaken(path: str | os.PathLike[str], notes: Iterable[Message]) -> tuple[str, ...]:
    """Return the addresses of all parts of a file, unless one of them was asked for.

    Parameters
    ----------
    path : as it was read: a file, or the address of a part that has parts itself.
    notes : of reading it.
    """
    file, parts = split_address(path)
    said = {note.code: note.values for note in notes}
    for kind in KINDS:  # who moves depends on the animation
        if values := said.get(_CODES[kind][0]):
            return tuple(join_address(file, {**parts, kind: name}) for name in (values["read"], *values["others"]))
    return ()


def find_address(path: str | os.PathLike[str], notes: Iterable[Message]) -> str:
    """Return the address of what was read, with the names of its parts as the file has them; a file of one as it is."""
    kinds = {asked: kind for kind, (_, asked, _) in _CODES.items()}
    return join_address(file_of(path), {kinds[note.code]: note.values["read"] for note in notes if note.code in kinds})


def are_all(notes: Mapping[str, Iterable[Message]]) -> bool:
    """Return whether addresses are all parts of their file.

    ``notes`` : of reading each part, by address; they name the parts that were left out.
    """
    kinds = {asked: kind for kind, (_, asked, _) in _CODES.items()}
    there = {part for address in notes for part in split_address(address)[1].items()}
    left_out = {
        (kinds[note.code], name)
        for own in notes.values()
        for note in own
        if note.code in kinds
        for name in note.values["others"]
    }
    return left_out <= there
