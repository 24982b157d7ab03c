"""Keypoints of DeepLabCut as CSV, and points by the names that other programs give them.

DeepLabCut's table has a column for each value. Its heading has a row each for ``scorer``, ``individuals`` (where there
are several), ``bodyparts`` and ``coords`` (``x``, ``y`` and mostly ``likelihood``), named in the first column. A row
below is a frame: its number, or the name of its picture in one to three columns, then the values in pixels.
"""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Iterable, Sequence

import numpy as np

from dousa.arrays import FloatArray
from dousa.errors import KeypointError, MotionFileError
from dousa.estimation.keypoints.keypoint_json import ReadFrames, ReadPerson
from dousa.files.disk import read_bytes
from dousa.files.frame_files import number_frames
from dousa.motion.canonical.naming import normalise_names

_HEADINGS = ("scorer", "individuals", "bodyparts", "coords")

# Words that are two in the names of `landmarks`; cores come without separators.
_SPELLINGS = {"bigtoe": "big_toe", "smalltoe": "small_toe", "littletoe": "small_toe", "footindex": "foot_index"}
_SIDES = {"l": "left_", "r": "right_", "": ""}


def spell_points(names: Iterable[str]) -> tuple[str, ...]:
    """Return names of points as dousa spells them: ``LShoulder`` and ``shoulder_l`` are ``left_shoulder``.

    Where two would become one, both stay as they are.
    """
    given = tuple(names)
    spelled = [_SIDES[side] + _SPELLINGS.get(core, core) for side, core in normalise_names(given)]
    return tuple(name if spelled.count(name) == 1 else old for name, old in zip(spelled, given, strict=True))


def is_keypoint_table(path: str | os.PathLike[str]) -> bool:
    """Return whether a file begins with the heading of DeepLabCut's tables."""
    try:
        with open(path, "rb") as file:
            return file.read(64).lstrip(b"\xef\xbb\xbf \"'").lower().startswith(b"scorer")
    except OSError:
        return False


def read_keypoint_table(path: str | os.PathLike[str], *, most_bytes: int = 500_000_000) -> ReadFrames:
    """Read the CSV of DeepLabCut, of ``most_bytes`` at most.

    Raises
    ------
    KeypointError : missing, another table, a heading that does not name every column, a value that is no number.
    """
    try:
        if os.path.isfile(path) and os.path.getsize(path) > most_bytes:
            raise KeypointError("keypoint_json.large", most=most_bytes // 1_000_000)
        text = read_bytes(path).decode("utf-8-sig")
        rows = [row for row in csv.reader(io.StringIO(text, newline="")) if row]
        return _read_rows(rows)
    except KeypointError as error:
        raise error.at(path) from None
    except MotionFileError as error:
        raise KeypointError(error.message).at(path) from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise KeypointError("keypoint_table.broken", reason=error).at(path) from error


def _read_rows(rows: Sequence[list[str]]) -> ReadFrames:
    heading = {row[0].strip().lower(): row for row in rows[: len(_HEADINGS)] if row[0].strip().lower() in _HEADINGS}
    if not {"scorer", "bodyparts", "coords"} <= heading.keys():
        raise KeypointError("keypoint_table.unknown", found=tuple(row[0][:40] for row in rows[:4]))
    kinds = [word.strip().lower() for word in heading["coords"]]
    first = next((column for column, kind in enumerate(kinds) if kind in ("x", "y")), len(kinds))
    parts, people = heading["bodyparts"], heading.get("individuals")
    columns: dict[tuple[str, str], dict[str, int]] = {}
    for column in range(first, len(kinds)):
        if column >= len(parts) or (people is not None and column >= len(people)) or not parts[column].strip():
            raise KeypointError("keypoint_table.column", column=column + 1)
        who = "" if people is None else people[column].strip()
        columns.setdefault((who, parts[column].strip()), {})[kinds[column]] = column
    if any(not {"x", "y"} <= found.keys() for found in columns.values()) or not columns:
        raise KeypointError("keypoint_table.unknown", found=tuple(kinds[first : first + 4]))
    body = rows[len(heading) :]
    if not body:
        raise KeypointError("keypoint_table.empty")
    values = _parse_values(body, first, len(kinds), len(heading))
    names = tuple(dict.fromkeys(part for _, part in columns))
    frames: list[list[ReadPerson]] = [[] for _ in body]
    for number, who in enumerate(dict.fromkeys(who for who, _ in columns)):
        points = np.full((len(body), len(names), 3), (np.nan, np.nan, 0.0))
        for row, name in enumerate(names):
            found = columns.get((who, name), {})
            for place, kind in enumerate(("x", "y")):
                if kind in found:
                    points[:, row, place] = values[:, found[kind] - first]
            points[:, row, 2] = values[:, found["likelihood"] - first] if "likelihood" in found else 1.0
        for frame in np.flatnonzero(np.isfinite(points[..., :2]).all(axis=2).any(axis=1)):
            frames[frame].append(ReadPerson(points[frame], number))
    return ReadFrames(_place_frames(["/".join(row[:first]) for row in body], frames), None, spell_points(names))


def _parse_values(body: Sequence[list[str]], first: int, stop: int, above: int) -> FloatArray:
    values = np.full((len(body), stop - first), np.nan)
    for number, row in enumerate(body):
        if len(row) != stop:
            raise KeypointError("keypoint_table.row", expected=stop, found=len(row)).at(line=above + number + 1)
        try:
            values[number] = [float(word) if word.strip() else np.nan for word in row[first:]]
        except ValueError:
            wrong = next(word for word in row[first:] if word.strip() and not _is_number(word))
            raise KeypointError("keypoint_table.number", found=wrong[:40]).at(line=above + number + 1) from None
    return values


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _place_frames(labels: list[str], frames: list[list[ReadPerson]]) -> list[list[ReadPerson]]:
    """Return the frames at their numbers: pictures of a film that were left out are frames without people."""
    places = {label: row for row, label in enumerate(labels)}
    if len(places) < len(labels):
        return frames
    numbered = number_frames(labels)
    return [frames[places[numbered[frame]]] if frame in numbered else [] for frame in range(max(numbered) + 1)]
