"""Keypoints of tables (DeepLabCut, SLEAP, Sports2D), and points by the names that other programs give them.

DeepLabCut's table has a column for each value. Its heading has a row each for ``scorer``, ``individuals`` (where there
are several), ``bodyparts`` and ``coords`` (``x``, ``y`` and mostly ``likelihood``), named in the first column. A row
below is a frame: its number, or the name of its picture in one to three columns, then the values in pixels.

Other tables have a row of titles (``nose.x``, ``nose.y``, ``nose.score``), and a row for each person of a frame
(``track``, ``frame_idx``, as SLEAP's). A TRC whose z is 0 everywhere has pixels too.
"""

from __future__ import annotations

import csv
import io
import os
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from dousa.arrays import FloatArray
from dousa.errors import KeypointError, MotionFileError
from dousa.estimation.keypoints.keypoint_json import ReadFrames, ReadPerson
from dousa.files.disk import read_bytes
from dousa.files.frame_files import number_frames
from dousa.motion.canonical.naming import normalise_names

_TITLE = re.compile(r"(?P<part>.+?)[._ ](?P<kind>[xyz]|score|likelihood|confidence|visibility)", re.IGNORECASE)
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


@dataclass(frozen=True, slots=True, eq=False)
class _Columns:
    """Columns of x, y and confidence by person and point, of the frame, of the person; lines above; cells of a row.

    ``width`` : the cells that a row needs; ``most`` : those that have a title.
    """

    points: dict[tuple[str, str], dict[str, int]]
    labels: range
    track: int | None
    above: int
    width: int
    most: int


def is_keypoint_table(path: str | os.PathLike[str], head: int = 65_536) -> bool:
    """Return whether a file begins with the heading of a table of points in pictures; ``head`` : bytes looked at."""
    if not os.fspath(path).lower().endswith((".csv", ".tsv", ".trc")):
        return False
    try:
        with open(path, "rb") as file:
            text = file.read(head).decode("utf-8-sig", "replace")
        return text.lstrip(" \"'").lower().startswith("scorer") or _find_titles(_split_rows(text)[:-1]) is not None
    except (OSError, csv.Error):
        return False


def _split_rows(text: str) -> list[list[str]]:
    mark = max(",;\t", key=text[:4096].count)
    return [row for row in csv.reader(io.StringIO(text, newline=""), delimiter=mark) if any(map(str.strip, row))]


def _find_titles(rows: Sequence[list[str]]) -> _Columns | None:
    """The columns of a table with a row of titles; None if it has no points, or points in space."""
    if not rows:
        return None
    trc, above = rows[0][0].startswith("PathFileType"), 1
    titles = rows[0]
    if trc and len(rows) > 5:
        above = 5
        titles = [*rows[3][:2], *(f"{name}_{axis}" for name in rows[3][2::3] if name for axis in "xyz")]
    points: dict[tuple[str, str], dict[str, int]] = {}
    for column, title in enumerate(titles):
        found = _TITLE.fullmatch(title.strip())
        if found is not None:
            kind = found["kind"].lower()
            points.setdefault(("", found["part"]), {}).setdefault(kind if kind in "xyz" else "likelihood", column)
    points = {part: own for part, own in points.items() if {"x", "y"} <= own.keys()}
    depth = [own["z"] for own in points.values() if "z" in own]
    flat = trc and not any(row[column].strip(" 0.-") for row in rows[above:] for column in depth if column < len(row))
    words = [title.strip().lower() for title in titles]
    label = next((column for column, word in enumerate(words) if word.startswith(("frame", "image"))), None)
    track = next((column for column, word in enumerate(words) if word in ("track", "track_id", "person", "id")), None)
    if len(points) < 3 or (depth and not flat) or (label is None and track is not None):
        return None  # rows of people without a frame
    width = max(label or 0, track or 0, *(max(own.values()) for own in points.values())) + 1
    return _Columns(points, range(0) if label is None else range(label, label + 1), track, above, width, len(titles))


def read_keypoint_table(path: str | os.PathLike[str], *, most_bytes: int = 500_000_000) -> ReadFrames:
    """Read a table of points in pictures, of ``most_bytes`` at most.

    Raises
    ------
    KeypointError : missing, another table, a heading that does not name every column, a value that is no number.
    """
    try:
        if os.path.isfile(path) and os.path.getsize(path) > most_bytes:
            raise KeypointError("keypoint_json.large", most=most_bytes // 1_000_000)
        text = read_bytes(path).decode("utf-8-sig")
        rows = _split_rows(text)
        return _read_rows(rows, _find_titles(rows) or _find_heading(rows))
    except KeypointError as error:
        raise error.at(path) from None
    except MotionFileError as error:
        raise KeypointError(error.message).at(path) from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise KeypointError("keypoint_table.broken", reason=error).at(path) from error


def _find_heading(rows: Sequence[list[str]]) -> _Columns:
    """The columns of DeepLabCut's table."""
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
    return _Columns(columns, range(first), None, len(heading), len(kinds), len(kinds))


def _read_rows(rows: Sequence[list[str]], columns: _Columns) -> ReadFrames:
    body = rows[columns.above :]
    if not body:
        raise KeypointError("keypoint_table.empty")
    names = tuple(dict.fromkeys(part for _, part in columns.points))
    people = {who: number for number, who in enumerate(dict.fromkeys(who for who, _ in columns.points))}
    values = np.full((len(people), len(body), len(names), 3), (np.nan, np.nan, 0.0))
    for (who, name), own in columns.points.items():
        points = values[people[who], :, names.index(name)]
        for place, kind in enumerate(("x", "y", "likelihood")):
            points[:, place] = _parse_column(body, own[kind], columns) if kind in own else 1.0
    frames: list[list[ReadPerson]] = [[] for _ in body]
    tracks: dict[str, int] = {}
    for row, cells in enumerate(body):
        for number in range(len(people)):
            if np.isfinite(values[number, row, :, :2]).all(axis=1).any():
                track = number if columns.track is None else tracks.setdefault(cells[columns.track], len(tracks))
                frames[row].append(ReadPerson(values[number, row], track))
    labels = ["/".join(row[column] for column in columns.labels if column < len(row)) for row in body]
    if columns.track is not None:
        together: dict[str, list[ReadPerson]] = {}
        for label, found in zip(labels, frames, strict=True):
            together.setdefault(label, []).extend(found)
        labels, frames = [*together], [*together.values()]
    return ReadFrames(_place_frames(labels, frames), None, spell_points(names))


def _parse_column(body: Sequence[list[str]], column: int, columns: _Columns) -> FloatArray:
    values = np.full(len(body), np.nan)
    for number, row in enumerate(body):
        line = columns.above + number + 1
        found = len(row) if len(row) <= columns.most else max(n for n, cell in enumerate(row, 1) if cell.strip())
        if not columns.width <= found <= columns.most:
            raise KeypointError("keypoint_table.row", expected=columns.most, found=found).at(line=line)
        word = row[column].strip()
        try:
            values[number] = float(word) if word else np.nan
        except ValueError:
            raise KeypointError("keypoint_table.number", found=word[:40]).at(line=line) from None
    return values


def _place_frames(labels: list[str], frames: list[list[ReadPerson]]) -> list[list[ReadPerson]]:
    """Return the frames at their numbers: pictures of a film that were left out are frames without people."""
    places = {label: row for row, label in enumerate(labels)}
    if len(places) < len(labels):
        return frames
    numbered = number_frames(labels)
    return [frames[places[numbered[frame]]] if frame in numbered else [] for frame in range(max(numbered) + 1)]
