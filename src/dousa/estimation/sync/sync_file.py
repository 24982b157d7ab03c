"""Time offsets of films in a TOML file: one table ``[[film]]`` for each.

``offset`` (s) is what is added to the film's own time, which begins with its first picture, to get the time of the
first film; ``spread`` (s) its standard deviation; ``basis`` by what it was found.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence

from dousa.errors import CalibrationError, MotionFileError
from dousa.estimation.cameras.camera_sets import find_views
from dousa.estimation.sync.synchronise import Synchronisation
from dousa.files.disk import atomic_write, read_bytes
from dousa.files.markup import parse_toml, quote_toml

_MOST_SECONDS = 1e6


def write_offsets(path: str | os.PathLike[str], names: Sequence[str], found: Synchronisation) -> None:
    """Write time offsets; the file appears whole or not at all.

    Parameters
    ----------
    path : the file to write or replace.
    names : (V,) of the films, without suffix.
    found : their offsets.

    Raises
    ------
    MotionWriteError : the folder is missing or read-only, or the disk is full.
    """
    lines = ["# A film's own time plus its offset is the time of the first film; in seconds.", ""]
    for name, offset, spread, basis in zip(names, found.offsets, found.spreads, found.basis, strict=True):
        lines += ["[[film]]", f"name = {quote_toml(name)}", f"offset = {float(offset):.6f}"]
        lines += [f"spread = {float(spread):.6f}", f"basis = {quote_toml(basis)}", ""]
    with atomic_write(path) as file:
        file.write("\n".join(lines).encode("utf-8"))


def read_offsets(path: str | os.PathLike[str], names: Sequence[str]) -> list[float]:
    """Read the time offsets of films.

    Parameters
    ----------
    path : as `write_offsets` writes it, or by hand: of each film ``name`` and ``offset``.
    names : (V,) of the films, without suffix, in the order in which their offsets are wanted.

    Returns
    -------
    (V,) s.

    Raises
    ------
    CalibrationError : missing, no TOML, no offset for a film, or one that is no number.
    """
    try:
        tree = parse_toml(read_bytes(path).decode("utf-8-sig"))
    except MotionFileError as error:
        raise CalibrationError(error.message).at(path) from error
    except (ValueError, RecursionError) as error:
        raise CalibrationError("sync_file.toml", reason=str(error)[:200]).at(path) from error
    films = tree.get("film")
    if not isinstance(films, list) or not all(isinstance(film, Mapping) and "name" in film for film in films):
        raise CalibrationError("sync_file.no_films").at(path)
    try:
        places = find_views([str(film["name"]) for film in films], names)
    except CalibrationError as error:
        raise error.at(path) from error
    return [_read_offset(films[place], path) for place in places]


def _read_offset(film: Mapping[str, object], path: str | os.PathLike[str]) -> float:
    offset = film.get("offset")
    number = isinstance(offset, int | float) and not isinstance(offset, bool)
    if not number or not abs(offset) <= _MOST_SECONDS:  # type: ignore[arg-type]  # nan neither
        raise CalibrationError("sync_file.offset", film=str(film["name"])[:80], found=str(offset)[:40]).at(path)
    return float(offset)  # type: ignore[arg-type]
