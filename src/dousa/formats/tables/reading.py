"""Reading of tables with a header: where it ends, whose rows they are, when they were.

Any separator is taken (comma, semicolon, tab, bar, white space), decimal commas where the separator is another, and the
titles in one row, or in two with names over the axes; rows of units and of anything else above are looked at for the
unit and the rate. Known to come so: Vicon Nexus (the section ``Trajectories``), FreeMoCap, Azure Kinect, bvh-toolbox,
anipose, DeepLabCut 3D; and tables with a row for every point of a frame (``frame, keypoint, x, y, z``).
"""

from __future__ import annotations

import csv
import datetime
import os
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from dousa.arrays import FloatArray, IndexArray
from dousa.errors import MotionFileError
from dousa.files.disk import read_bytes
from dousa.formats.arrays.joints import BODY_OF, list_layouts, name_joints
from dousa.formats.assembly import declared_unit
from dousa.formats.guard import Clock
from dousa.formats.guard.people import take_person
from dousa.formats.landmarks import note_hips, refuse_pictures
from dousa.formats.optical import read_motive, read_qualisys
from dousa.formats.optical.cells import breaks_off, decode, is_number, read_rows
from dousa.formats.parts import choose
from dousa.formats.tables.columns import Columns, find_columns, spread_names
from dousa.formats.tables.joint_angles import is_of_angles, read_angles
from dousa.messages import Message
from dousa.motion import Motion, Trajectories
from dousa.motion.canonical.naming import holds_limb, match_names

_MARKS = ("\t", ";", ",", "|", " ")
_MOST_TITLES = 80  # lines a header may have, by the definition of docs/formats.md
_MOST_ROWS = 6  # above the axes, one with the names: four in the standard export of Visual3D
_RATE = re.compile(r"(?:rate|fps|frequency|sampling|hz)\W{1,4}(\d+(?:\.\d+)?)", re.IGNORECASE)
_UNITS = re.compile(r"\bunits?\W{1,4}([a-z]+)", re.IGNORECASE)
_LENGTH = re.compile(r"\[?\(?(?:mm|cm|m|in|inch|inches|ft)\)?\]?", re.IGNORECASE)


@dataclass(frozen=True, slots=True, eq=False)
class _Header:
    """What is above the rows: columns, separator, first line of the body (from 0), declared rate and unit, titles."""

    columns: Columns
    mark: str
    body: int
    rate: float | None
    unit: str
    width: int = 0


def read_table(
    path: str | os.PathLike[str],
    *,
    unit: float | str | None = None,
    up: str | None = None,
    frame_rate: float | None = None,
    person: str | None = None,
    animation: str | None = None,
) -> Motion | Trajectories:
    """Read a table of text with a header: bones or markers of Motive or Qualisys, or the points of its columns.

    Parameters
    ----------
    path : the file.
    unit : metres per unit; by default that of the header, else inferred from the body.
    up : axis that points up; by default inferred.
    frame_rate : Hz, whatever the table says.
    person : name or number of one of several people, by their column or the beginnings of names; by default the first.
    animation : name or number of one of several clips in a table, by their column; by default the longest.

    Raises
    ------
    MotionFileError : missing, damaged, no columns x, y, z of any point, points in a picture, text for a number.
    """
    text = decode(read_bytes(path))
    for sign, read in ((r'\A\s*"?Format Version', read_motive), (r"^\s*NO_OF_FRAMES", read_qualisys)):
        if re.search(sign, text[:4096], re.MULTILINE | re.IGNORECASE):
            return take_person(read(path, unit=unit, up=up), path, person)
    lines = text.split("\n")
    start = _find_section(lines)
    header = find_header(lines[start : start + _MOST_TITLES])
    if header is None or not header.columns.points:
        raise MotionFileError(path, "tables.flat" if header else "tables.no_points")
    if is_of_angles(path):
        return take_person(read_angles(path, unit=unit, up=up), path, person)
    numbered = _list_rows(lines, start + header.body, header.mark)
    wide = _count_cells(next(_split([numbered[0][1]], header.mark))) if numbered else 0
    if wide > header.width:
        raise MotionFileError(path, "tables.width", numbered[0][0], expected=header.width, found=wide)
    numbered, cut = _leave_out_cut(numbered, len(lines), header.mark)
    numbered, clip = _choose_rows(path, header, numbered, "animation", "clips", animation)
    clip = (*cut, *clip)
    if "people" not in header.columns.roles:
        return take_person(_build(path, header, numbered, unit, up, frame_rate, clip), path, person)
    numbered, notes = _choose_rows(path, header, numbered, "person", "people", person)
    return _build(path, header, numbered, unit, up, frame_rate, (*clip, *notes))


def is_table(path: str | os.PathLike[str], head: bytes) -> bool:
    """Return whether a table of a folder is a motion: it names a whole arm or leg, or counts the points of a layout.

    ``head`` : the first bytes of the file.
    """
    lines = decode(head).split("\n")
    start = _find_section(lines)
    header = find_header(lines[start : start + _MOST_TITLES])
    if header is None or not header.columns.points or is_of_angles(path):
        return False
    names = tuple(header.columns.points)
    labels = header.columns.roles.get("labels")
    if names == ("",) and labels is not None:  # a row for every point: the last line may be cut
        numbered = _list_rows(lines[:-1], start + header.body, header.mark)
        names = tuple(dict.fromkeys(_column(numbered, header.mark, labels)))
    if header.columns.counted:
        return any(len(layout.names) == len(names) for layout in list_layouts())
    match = match_names(names)
    return match is not None and holds_limb(match.missing)


def _find_section(lines: Sequence[str]) -> int:
    """Line of the section ``Trajectories`` of Vicon Nexus; 0 of other files."""
    return next((n for n, line in enumerate(lines) if line[:12] == "Trajectories" and not line[12:].strip(' ,;\t"')), 0)


def find_header(lines: Sequence[str]) -> _Header | None:
    """Find the titles of points among the first lines of a table; None if there are none, in space or in a picture."""
    flat = None
    for mark in _MARKS:
        rows = [next(_split([line], mark), []) for line in lines]
        for number, titles in enumerate(rows):
            columns = _name_columns(rows, number)
            if columns.points:
                return _finish(lines, rows, number, columns, mark)
            if len(columns.flat) > 2 and len(titles) > len(columns.flat):
                flat = flat or _Header(columns, mark, number + 1, None, "")
    return flat


def _name_columns(rows: list[list[str]], number: int) -> Columns:
    titles = rows[number]
    axes = sum(title.strip().lower() in ("x", "y", "z") for title in titles)
    if number and axes > 3:
        above = [row for row in reversed(rows[max(0, number - _MOST_ROWS) : number]) if any(map(str.strip, row))]
        named = [find_columns(spread_names(row, titles)) for row in above]
        return max(named, key=lambda some: len(some.points), default=Columns())
    return find_columns(titles) if len(titles) > 2 else Columns()


def _finish(lines: Sequence[str], rows: list[list[str]], number: int, columns: Columns, mark: str) -> _Header:
    """Look at the rows around the titles for units and rate."""
    body, units = number + 1, {columns.unit} - {""}
    while body < len(rows) and not any(_is_number(cell) for cell in rows[body]):
        under = {name: rows[body][c[0]].strip() for name, c in columns.points.items() if c[0] < len(rows[body])}
        lengths = {name for name, cell in under.items() if _LENGTH.fullmatch(cell)}
        if lengths:  # of model outputs only the places: angles and forces have other units
            columns.points = {name: own for name, own in columns.points.items() if name in lengths}
            units = {under[name].strip("[]()") for name in lengths}
        body += 1
    above = "\n".join(lines[:number])
    rate, unit = _RATE.search(above), _UNITS.search(above)
    alone = [float(row[0]) for row in rows[:number] if row and _is_number(row[0]) and not any(map(str.strip, row[1:]))]
    found = float(rate[1]) if rate else alone[0] if alone else None
    named = units.pop() if len(units) == 1 else unit[1] if unit else ""
    return _Header(columns, mark, body, found, named, _count_cells(rows[number]))


def _count_cells(row: Sequence[str]) -> int:
    """The cells of a row up to the last that is not blank."""
    return max((number for number, cell in enumerate(row, 1) if cell.strip()), default=0)


def _is_number(cell: str) -> bool:
    return is_number(cell.replace(",", "."))


def _split(lines: Sequence[str], mark: str) -> Iterator[list[str]]:
    if mark == " ":
        return (line.split() for line in lines)
    return csv.reader((line.strip("\r\n") for line in lines), delimiter=mark)


def _list_rows(lines: list[str], body: int, mark: str) -> list[tuple[int, str]]:
    """The lines of the body with their numbers, up to a blank one that other text follows (the next section)."""
    numbered = []
    for number in range(body, len(lines)):
        line = lines[number]
        if line.strip(f'{mark} "\t'):
            numbered.append((number + 1, line))
        elif numbered:
            following = next((later for later in lines[number + 1 :] if later.strip(f'{mark} "\t')), "")
            if not any(map(_is_number, next(_split([following], mark), [""]))):
                break
    return numbered


def _leave_out_cut(
    numbered: list[tuple[int, str]], last: int, mark: str
) -> tuple[list[tuple[int, str]], tuple[Message, ...]]:
    """Rows without one at the end that breaks off, and a note about it; the ``last`` line of the file has no end."""
    rows = [line for _, line in numbered]
    width, own = (len(next(_split(some, mark), [])) for some in (rows, rows[-1:]))
    open_end = len(rows) > 1 and numbered[-1][0] == last
    if own >= width and not (open_end and breaks_off(rows, width, mark)):
        return numbered, ()
    return numbered[:-1], (Message("guard.cut_off", line=numbered[-1][0]),)


def _read_cells(
    path: str | os.PathLike[str], numbered: list[tuple[int, str]], mark: str, wanted: list[int], chunk: int = 200_000
) -> FloatArray:
    """(rows, wanted columns) numbers; so many cells are held as text at a time."""
    body = numbered
    if mark != "," and any("," in line for _, line in numbered) and not any("." in line for _, line in numbered):
        body = [(number, line.replace(",", ".")) for number, line in numbered]
    width = max(wanted) + 1
    step, parts = max(1, chunk // width), []
    for start in range(0, len(body), step):
        part = body[start : start + step]
        rows = [
            [row[column] if column < len(row) else "" for column in wanted]
            for row in _split([line for _, line in part], mark)
        ]
        parts.append(read_rows(path, rows, [number for number, _ in part], len(wanted)))
    return np.concatenate(parts)


def _build(
    path: str | os.PathLike[str],
    header: _Header,
    numbered: list[tuple[int, str]],
    unit: float | str | None,
    up: str | None,
    frame_rate: float | None,
    notes: tuple[Message, ...] = (),
) -> Trajectories:
    columns = header.columns
    triples = {name: own for name, own in columns.points.items() if name} or columns.points
    if not numbered:
        raise MotionFileError(path, "tables.no_frames", header.body)
    if "" in triples:
        numbered, more = _choose_kind(columns, numbered, header.mark)
        notes += more
        names, rows = _spread_points(path, columns, numbered, header.mark)
    else:
        names, rows = tuple(triples), None
    scores = [columns.scores.get(name) for name in triples]
    wanted = [column for own in triples.values() for column in own] + [s for s in scores if s is not None]
    timed: list[str] = [role for role in ("times", "numbers", "parts") if role in columns.roles]
    times = {role: read_times(_column(numbered, header.mark, columns.roles[role])) for role in timed}
    values = _read_cells(path, numbered, header.mark, wanted)
    points = values[:, : 3 * len(triples)].reshape(len(values), len(triples), 3)
    sure = np.ones(points.shape[:2])
    sure[:, [n for n, s in enumerate(scores) if s is not None]] = values[:, 3 * len(triples) :]
    points = np.where((sure > 0)[..., None], points, np.nan)
    if rows is not None:
        first = np.unique(rows[0], return_index=True)[1]
        times = {role: column[first] for role, column in times.items()}
        spread = np.full((len(first), len(names), 3), np.nan)
        spread[rows] = points[:, 0]
        points, sure = spread, np.ones(spread.shape[:2])
    refuse_pictures(path, np.concatenate((points, sure[..., None]), axis=2))
    if columns.counted and points.shape[1] in BODY_OF:
        points = points[:, : BODY_OF[points.shape[1]]]
    notes += note_hips(points)
    known = columns.counted and any(len(layout.names) == points.shape[1] for layout in list_layouts())
    return name_joints(
        path, "csv", points, None if known else names[: points.shape[1]], unit=unit, up=up, frame_rate=frame_rate,
        clock=_read_clock(header, times), unit_in_file=declared_unit(header.unit), notes=notes,
    )  # fmt: skip


def _column(numbered: list[tuple[int, str]], mark: str, column: int) -> list[str]:
    return [row[column].strip() if column < len(row) else "" for row in _split([line for _, line in numbered], mark)]


def _choose_rows(
    path: str | os.PathLike[str],
    header: _Header,
    numbered: list[tuple[int, str]],
    kind: str,
    role: str,
    wanted: str | None,
    most: int = 1000,
) -> tuple[list[tuple[int, str]], tuple[Message, ...]]:
    """Rows of one of several parts that a column tells apart: ``most``, and each of two rows or more on average."""
    column = header.columns.roles.get(role)
    owners = ["1"] * len(numbered) if column is None else _column(numbered, header.mark, column)
    counts = Counter(owners)
    if len(counts) > min(most, len(owners) // 2):  # it counts rows
        owners, counts = ["1"] * len(numbered), Counter({"1": len(numbered)})
    if not counts or (column is None and wanted is None):
        return numbered, ()
    chosen, notes = choose(path, kind, [*counts], wanted, [*counts.values()])
    name = [*counts][chosen]
    return [row for row, owner in zip(numbered, owners, strict=True) if owner == name], notes


def _choose_kind(
    columns: Columns, numbered: list[tuple[int, str]], mark: str
) -> tuple[list[tuple[int, str]], tuple[Message, ...]]:
    """Of a table with a row for every point and a column of kinds (FreeMoCap's ``model``): the rows of the first."""
    if "kinds" not in columns.roles:
        return numbered, ()
    kinds = _column(numbered, mark, columns.roles["kinds"])
    kept = [row for row, kind in zip(numbered, kinds, strict=True) if kind == kinds[0]]
    others = tuple(dict.fromkeys(kind for kind in kinds if kind != kinds[0]))
    return kept, (Message("tables.kinds", read=kinds[0], others=others),) if others else ()


def _spread_points(
    path: str | os.PathLike[str], columns: Columns, numbered: list[tuple[int, str]], mark: str
) -> tuple[tuple[str, ...], tuple[IndexArray, IndexArray]]:
    """Of a table with a row for every point: the names, and (frames, points) of its rows."""
    labels = columns.roles.get("labels")
    clock = columns.roles.get("numbers", columns.roles.get("times"))
    if labels is None or clock is None:
        raise MotionFileError(path, "tables.no_points")
    frames, names = _column(numbered, mark, clock), _column(numbered, mark, labels)
    keys = dict.fromkeys(zip(frames, names, strict=True))
    if len(keys) < len(numbered):
        raise MotionFileError(path, "tables.twice", numbered[0][0], found=len(numbered) - len(keys))
    order = {frame: n for n, frame in enumerate(dict.fromkeys(frames))}
    known = {name: n for n, name in enumerate(dict.fromkeys(names))}
    rows = (np.array([order[frame] for frame in frames]), np.array([known[name] for name in names]))
    columns.counted = list(known) == [str(n) for n in range(len(known))]
    return tuple(known), rows


def read_times(cells: Sequence[str]) -> FloatArray:
    """Read times or numbers of frames: numbers, dates and times of day in seconds, numbers in names (``img_012.png``).

    NaN for anything else: a clock goes on without it.
    """
    if all(map(_is_number, filter(None, cells[:2]))):
        return np.array([float(cell.replace(",", ".")) if _is_number(cell) else np.nan for cell in cells])
    return np.array([_read_time(cell) for cell in cells])


def _read_time(cell: str) -> float:
    clock = re.search(r"(\d+):(\d+):(\d+(?:[.,]\d+)?)", cell)
    if clock is None:
        number = re.search(r"(\d{1,15})\D*$", cell)
        return float(number[1]) if number else np.nan
    day = re.match(r"(\d{4})-(\d\d)-(\d\d)", cell)
    days = datetime.date(*map(int, day.groups())).toordinal() if day else 0
    hours, minutes, seconds = (float(part.replace(",", ".")) for part in clock.groups())
    return 86400.0 * days + 3600 * hours + 60 * minutes + seconds


def _read_clock(header: _Header, times: dict[str, FloatArray]) -> Clock:
    """What the columns and the header say about time; the parts of a frame are frames of their own."""
    seconds, numbers = times.get("times"), times.get("numbers")
    if seconds is not None and header.columns.seconds is not None:
        seconds = seconds * header.columns.seconds
    if numbers is not None and "parts" in times:
        parts = np.nan_to_num(times["parts"])
        numbers = numbers * (parts.max() + 1) + parts
    return Clock(header.rate, seconds, numbers)
