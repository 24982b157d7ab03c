"""Reading of tables with a header: where it ends, whose rows they are, when they were.

Any separator is taken (comma, semicolon, tab, bar, white space), decimal commas where the separator is another, and the
titles in one row, or in two with names over the axes; rows of units and of anything else above are looked at for the
unit and the rate. Known to come so: Vicon Nexus (the section ``Trajectories``), FreeMoCap, Azure Kinect, bvh-toolbox,
anipose, DeepLabCut 3D; and tables with a row for every point of a frame (``frame, keypoint, x, y, z``).
"""

from __future__ import annotations

import dataclasses
import datetime
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dousa.arrays import FloatArray, IntArray
from dousa.errors import MotionFileError
from dousa.files.disk import read_bytes
from dousa.formats.arrays.joints import BODY_OF, list_layouts, name_joints
from dousa.formats.assembly import declared_unit
from dousa.formats.guard import Clock
from dousa.formats.landmarks import note_hips, refuse_pictures
from dousa.formats.parts import choose
from dousa.formats.tables.cells import Rows, count_cells, decode, find_rows, is_number, list_lines, split_rows
from dousa.formats.tables.columns import Columns, find_columns, find_odd, spread_names
from dousa.formats.tables.joint_angles import is_of_angles, read_angles
from dousa.formats.tables.motive import read_motive
from dousa.formats.tables.qualisys import read_qualisys
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
    """What is above the rows: columns, separator, number of lines, declared rate and unit, cells of the titles."""

    columns: Columns
    mark: str
    body: int
    rate: float | None
    unit: str
    cells: tuple[int, int] = (0, 0)


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
            return read(path, text, unit=unit, up=up)
    header = _find_titles(text)
    if header is None or not header.columns.points:
        raise MotionFileError(path, "guard.flat" if header else "tables.no_points")
    if is_of_angles(path):
        return read_angles(path, unit=unit, up=up)
    rows, notes = find_rows(path, text, header.body, header.mark, header.cells)
    odd = find_odd(header.columns)
    if odd:
        notes += (Message("tables.odd_columns", n=len(odd), total=len(header.columns.points), name=odd[0]),)
    del text
    for kind, role, wanted in (("animation", "clips", animation), ("person", "people", person)):
        rows, more = _choose_rows(path, header, rows, kind, role, wanted)
        notes += more
    return _build(path, header, rows, unit, up, frame_rate, notes)


def is_table(path: str | os.PathLike[str], head: bytes) -> bool:
    """Return whether a table of a folder is a motion: it names a whole arm or leg, or counts the points of a layout.

    ``head`` : the first bytes of the file.
    """
    text = decode(head)
    header = _find_titles(text)
    if header is None or not header.columns.points or is_of_angles(path):
        return False
    names = tuple(header.columns.points)
    labels = header.columns.roles.get("labels")
    if names == ("",) and labels is not None:  # a row for every point: the last line may be cut
        lines = text.split("\n")[header.body : -1]
        names = tuple(dict.fromkeys(row[labels].strip() for row in split_rows(lines, header.mark) if len(row) > labels))
    if header.columns.counted:
        return any(len(layout.names) == len(names) for layout in list_layouts())
    match = match_names(names)
    return match is not None and holds_limb(match.missing)


def _find_titles(text: str) -> _Header | None:
    """The titles of a table, below the line ``Trajectories`` of Vicon Nexus if there is one."""
    found = re.search(r"^Trajectories[ ,;\t\"']*$", text, re.MULTILINE)
    start = found.start() if found else 0
    header = find_header(list_lines(text[start:], _MOST_TITLES))
    return header and dataclasses.replace(header, body=header.body + text.count("\n", 0, start))


def find_header(lines: Sequence[str]) -> _Header | None:
    """Find the titles of points among the first lines of a table; None if there are none, in space or in a picture."""
    flat = None
    for mark in _MARKS:
        rows = split_rows(lines, mark)
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
    return _Header(columns, mark, body, found, named, count_cells(rows[number]))


def _is_number(cell: str) -> bool:
    return is_number(cell.replace(",", "."))


def _build(
    path: str | os.PathLike[str],
    header: _Header,
    rows: Rows,
    unit: float | str | None,
    up: str | None,
    frame_rate: float | None,
    notes: tuple[Message, ...] = (),
) -> Trajectories:
    columns = header.columns
    triples = {name: own for name, own in columns.points.items() if name} or columns.points
    names, order = tuple(triples), None
    if "" in triples:
        rows, more = _choose_kind(columns, rows)
        notes += more
        names, order = _spread_points(path, columns, rows)
    scored = {n: columns.scores[name] for n, name in enumerate(triples) if name in columns.scores}
    clock = {role: column for role, column in columns.roles.items() if role in ("times", "numbers", "parts")}
    times, counted = _read_times(rows, clock)
    places = [column for own in triples.values() for column in own]
    values, scores, plain = rows.read(places, [*scored.values()], [*counted.values()], loose=[*counted.values()])
    del rows
    times |= dict(zip(counted, plain.T, strict=True))
    points = values.reshape(len(values), len(triples), 3)
    for place, column in enumerate(scored):
        points[~(scores[:, place] > 0), column] = np.nan
    if order is not None:
        frames, numbers = order
        first = np.unique(frames, return_index=True)[1]
        times = {role: column[first] for role, column in times.items()}
        spread = np.full((len(first), max(len(names), numbers.max() + 1), 3), np.nan)
        spread[frames, numbers] = points[:, 0]
        points = spread[:, : len(names)]
    refuse_pictures(path, points)
    if columns.counted and points.shape[1] in BODY_OF:
        points = points[:, : BODY_OF[points.shape[1]]]
    notes += note_hips(points)
    known = columns.counted and any(len(layout.names) == points.shape[1] for layout in list_layouts())
    return name_joints(
        path, "csv", points, None if known else names[: points.shape[1]], unit=unit, up=up, frame_rate=frame_rate,
        clock=_read_clock(header, times), unit_in_file=declared_unit(header.unit), notes=notes,
    )  # fmt: skip


def _choose_rows(
    path: str | os.PathLike[str],
    header: _Header,
    rows: Rows,
    kind: str,
    role: str,
    wanted: str | None,
    most: int = 1000,
) -> tuple[Rows, tuple[Message, ...]]:
    """Rows of one of several parts that a column tells apart: ``most``, and each of two rows or more on average."""
    column = header.columns.roles.get(role)
    if column is None:
        return rows, () if wanted is None or kind == "person" else choose(path, kind, ["1"], wanted)[1]
    names, owners = rows.find_texts(column)
    if len(names) > min(most, len(owners) // 2):  # it counts rows
        names, owners = ["1"], np.zeros_like(owners)
    counts = np.bincount(owners, minlength=len(names)) * np.array([bool(name) for name in names])
    known = [name for name in names if name]
    if not known:
        return rows, ()
    chosen, notes = choose(path, kind, known, wanted, counts[counts > 0].tolist())
    return rows.take(owners == names.index(known[chosen])), notes


def _choose_kind(columns: Columns, rows: Rows) -> tuple[Rows, tuple[Message, ...]]:
    """Of a table with a row for every point and a column of kinds (FreeMoCap's ``model``): the rows of the first."""
    if "kinds" not in columns.roles:
        return rows, ()
    (first, *others), kinds = rows.find_texts(columns.roles["kinds"])
    return rows.take(kinds == 0), (Message("tables.kinds", read=first, others=tuple(others)),) if others else ()


def _spread_points(
    path: str | os.PathLike[str], columns: Columns, rows: Rows
) -> tuple[tuple[str, ...], tuple[IntArray, IntArray]]:
    """Of a table with a row for every point: the names, and (frames, points) of its rows."""
    labels = columns.roles.get("labels")
    clock = columns.roles.get("numbers", columns.roles.get("times"))
    if labels is None or clock is None:
        raise MotionFileError(path, "tables.no_points")
    names, points = rows.find_texts(labels)
    frames = rows.find_texts(clock)[1]
    twice = int(np.count_nonzero(np.diff(np.sort(frames * len(names) + points)) == 0))
    if twice:
        raise MotionFileError(path, "tables.twice", int(rows.lines[0]), found=twice)
    if all(name.isdecimal() and len(name) < 6 for name in names):  # 100,000 are no body
        names, points = _count_points(names, points)
        columns.counted = True
    return tuple(names), (frames, points)


def _count_points(names: list[str], points: IntArray, hands: int = 100) -> tuple[list[str], IntArray]:
    """Names and points of rows in the order of numbers, of which some may never come: their count gives the layout.

    ``hands`` : Caliscope's number of the first point that is none of the body.
    """
    numbers = np.array([int(name) for name in names])
    known = {len(layout.names) for layout in list_layouts()} | set(BODY_OF)
    start = int(numbers.min() == 1 and numbers.max() in known)
    count = int(numbers[numbers < hands].max(initial=-1)) + 1 - start
    every = np.union1d(numbers, np.arange(count) + start) if count in known else np.unique(numbers)
    body = every[:count] if count in known else every
    return [str(number) for number in body.tolist()], np.searchsorted(every, numbers)[points]


def _read_times(rows: Rows, columns: dict[str, int]) -> tuple[dict[str, FloatArray], dict[str, int]]:
    """Times and frames by role that are texts: dates, times of day, numbers in names; the columns of plain numbers."""
    head = split_rows(list_lines(rows.text, 2), rows.mark)
    times, plain = {}, {}
    for role, column in columns.items():
        if all(is_number(row[column]) for row in head if column < len(row) and row[column].strip()):
            plain[role] = column
        else:
            texts, numbers = rows.find_texts(column)
            times[role] = np.array([_read_time(text) for text in texts])[numbers]
    return times, plain


def _read_time(cell: str) -> float:
    """The seconds of a date or a time of day, or the number in a name (``img_012.png``); NaN for anything else."""
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
