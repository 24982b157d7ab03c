"""Tables of labels as text: dousa's own CSV, those that BORIS exports, and the lists of actions of CMU's subject 86.

dousa's own has comma, semicolon or tab separated columns ``start_s``, ``end_s`` and ``category``, and may have
``tier``; with ``path`` or ``file`` it is about several takes. A row without a category means that nothing happens, or,
with a name in the column ``perhaps``, that it is unclear. BORIS (Friard and Gamba, Methods in Ecology and Evolution 7,
2016) exports "tabular events", a row for each start and stop, and "aggregated events", a row per behaviour; its
subjects are the tiers.

CMU's lists (``mocap.txt``) have, after a line with the numbers of subject and take, a line for each action: its name
and the earliest, likely and latest frame of its end, where the next begins. The part between the earliest and the
latest end is unclear.
"""

from __future__ import annotations

import csv
import io
import os
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

from dousa.errors import MotionFileError
from dousa.files.disk import atomic_write
from dousa.formats.annotations.label_file import (
    LabelFile,
    LabelTier,
    check_category,
    clean_category,
    decode_text,
    finish_tier,
    is_unknown,
    make_span,
    parse_number,
)
from dousa.messages import Message
from dousa.motion.annotation import Stretch

_START = ("start_s", "start", "begin_s", "begin", "start (s)", "onset")
_STOP = ("end_s", "end", "stop_s", "stop", "stop (s)", "offset")
_CATEGORY = ("category", "label", "behavior", "behaviour")
_DOUBT = "perhaps"
_TIER = ("tier", "subject")
_TAKE = ("path", "file")
_OBSERVATION = "observation id"
_MEDIA = ("media file name", "media file", "media file path")
_KIND = ("behavior type", "behaviour type", "status", "event type")
_MOST_ABOVE = 60  # lines that BORIS writes above its table


@dataclass(frozen=True, slots=True)
class _Row:
    line: int
    cells: list[str]


@dataclass(frozen=True, slots=True)
class _Table:
    """Rows under a head; ``columns`` are the places of the names, which are in small letters."""

    path: str
    columns: dict[str, int]
    head_line: int
    rows: list[_Row]

    def find(self, names: Sequence[str]) -> str:
        """Return the first of these columns that is there, or nothing."""
        return next((name for name in names if name in self.columns), "")

    def cell(self, row: _Row, name: str) -> str:
        """Return a cell; empty where the table has no such column, or the row is short."""
        place = self.columns.get(name)
        return row.cells[place].strip() if place is not None and place < len(row.cells) else ""


def find_head(text: str) -> tuple[int, list[str]] | None:
    """Find the line (from 0) of the head of a table of labels and its names; None if the text has none."""
    for number, line in enumerate(text.splitlines()[:_MOST_ABOVE]):
        names = [name.strip().strip('"').strip().lower() for name in line.split(_find_delimiter(line))]
        is_own = any(name in names for name in _START) and any(name in names for name in _STOP)
        is_tabular = "time" in names and any(name in names for name in _KIND)
        if any(name in names for name in _CATEGORY) and (is_own or is_tabular):
            return number, names
    return None


def _find_delimiter(head: str) -> str:
    return max(",;\t", key=head.count)


def read_table(path: str, data: bytes) -> LabelFile:
    """Read the labels of a table; MotionFileError for missing columns, an invalid time, or an event without a stop."""
    text = decode_text(path, data)
    head = find_head(text)
    if head is None:
        first = next((line for line in text.splitlines() if line.strip()), "")
        found = [name.strip() for name in first.split(_find_delimiter(first))][:12]
        raise MotionFileError(path, "label_files.no_columns", 1, found=found)
    table = _split(path, text, *head)
    if "time" in table.columns and not table.find(_STOP):
        return _read_events(table)
    return _read_spans(table)


def _split(path: str, text: str, number: int, names: list[str]) -> _Table:
    lines = text.splitlines(keepends=True)
    delimiter = _find_delimiter(lines[number])
    reader = csv.reader(io.StringIO("".join(lines[number:]), newline=""), delimiter=delimiter, strict=True)
    rows = []
    before = 0
    try:
        next(reader)
        before = reader.line_num
        for cells in reader:
            if any(_holds_row(cell, delimiter, len(names)) for cell in cells):
                raise MotionFileError(path, "label_files.open_quote", number + before + 1)
            if any(cell.strip() for cell in cells):
                rows.append(_Row(number + before + 1, cells))
            before = reader.line_num
    except csv.Error as error:
        first = number + before + 1
        if '"' in "".join(lines[first - 1 : number + reader.line_num]):  # what else can be wrong with a row
            raise MotionFileError(path, "label_files.open_quote", first) from error
        raise MotionFileError(path, "label_files.not_a_table", first, reason=error) from error
    columns: dict[str, int] = {}
    for place, name in enumerate(names):
        columns.setdefault(name, place)
    return _Table(path, columns, number + 1, rows)


def _holds_row(cell: str, delimiter: str, n_columns: int) -> bool:
    """Whether a cell continues over lines that look like rows of the table."""
    return any(line.count(delimiter) >= n_columns - 1 for line in cell.splitlines()[1:])


def _read_spans(table: _Table) -> LabelFile:
    start_in, stop_in, category_in = table.find(_START), table.find(_STOP), table.find(_CATEGORY)
    kind_in = table.find(_KIND)
    found = _Found()
    for row in table.rows:
        if len(row.cells) <= max(table.columns[name] for name in (start_in, stop_in, category_in)):
            expected = max(table.columns[name] for name in (start_in, stop_in, category_in)) + 1
            raise MotionFileError(
                table.path, "label_files.too_few_columns", row.line, expected=expected, found=len(row.cells)
            )
        tier = found.tier(table, row)
        category = clean_category(table.cell(row, category_in))
        start = parse_number(table.path, table.cell(row, start_in), start_in, row.line)
        if table.cell(row, kind_in).upper() == "POINT":
            tier.n_points += 1
            continue
        stop = parse_number(table.path, table.cell(row, stop_in), stop_in, row.line)
        span = make_span(table.path, start, stop, category, row.line)
        doubt = clean_category(table.cell(row, _DOUBT))
        if category and not (doubt and is_unknown(category)):
            tier.spans.append(span)
        elif doubt:
            tier.unclear.append((start, stop))
        else:
            tier.n_rest += 1
    return found.to_file(table)


def _read_events(table: _Table) -> LabelFile:
    """Read BORIS's tabular events: START and STOP in rows of their own."""
    kind_in, category_in = table.find(_KIND), table.find(_CATEGORY)
    found = _Found()
    open_ones: dict[tuple[int, str], tuple[float, int]] = {}
    for row in table.rows:
        tier = found.tier(table, row)
        category = clean_category(table.cell(row, category_in))
        time = parse_number(table.path, table.cell(row, "time"), "Time", row.line)
        kind, key = table.cell(row, kind_in).upper(), (id(tier), category)
        if kind == "POINT":
            tier.n_points += 1
        elif kind == "START" and key not in open_ones:
            open_ones[key] = time, row.line
        elif kind == "STOP" and key in open_ones:
            begin, line = open_ones.pop(key)
            tier.spans.append(make_span(table.path, begin, time, category, line))
        elif kind in ("START", "STOP"):
            code = "label_files.starts_twice" if kind == "START" else "label_files.stops_only"
            raise MotionFileError(table.path, code, row.line, category=category)
        else:
            raise MotionFileError(table.path, "label_files.no_kind", row.line, found=kind[:40])
    for (_, category), (_, line) in open_ones.items():
        raise MotionFileError(table.path, "label_files.never_stops", line, category=category)
    return found.to_file(table)


class _Tier:
    def __init__(self, name: str) -> None:
        self.name = name
        self.spans: list[Stretch] = []
        self.unclear: list[tuple[float, float]] = []
        self.n_points = 0
        self.n_rest = 0


class _Found:
    """Tiers of takes, in the order of the file."""

    def __init__(self) -> None:
        self._takes: dict[str, dict[str, _Tier]] = {}

    def tier(self, table: _Table, row: _Row) -> _Tier:
        """Return the tier of a row."""
        take = table.cell(row, _name_takes(table))
        tiers = self._takes.setdefault(take, {})
        name = table.cell(row, table.find(_TIER))
        return tiers.setdefault(name, _Tier(name))

    def to_file(self, table: _Table) -> LabelFile:
        """Return the whole file; one about a single BORIS observation is about any take."""
        takes = {take: tuple(self._finish(table.path, tiers)) for take, tiers in self._takes.items()}
        own = table.find(_TAKE)
        if not own and len(takes) == 1:
            takes = {"": next(iter(takes.values()))}
        if not takes and not own:
            takes = {"": ()}
        return LabelFile(table.path, takes, by_name=own != "path")

    def _finish(self, path: str, tiers: dict[str, _Tier]) -> Iterator[LabelTier]:
        for own in tiers.values():
            spans, unclear = tuple(own.spans), tuple(own.unclear)
            yield finish_tier(path, LabelTier(own.name, spans, unclear, n_points=own.n_points, n_rest=own.n_rest))


def _name_takes(table: _Table) -> str:
    """Column of take names: of dousa's table, else BORIS's observation, else its film."""
    return table.find((*_TAKE, _OBSERVATION, *_MEDIA))


def about_one_take(file: LabelFile) -> LabelFile:
    """Assign the table beside a take to it under any name, if the table is about one take."""
    if len(file.takes) != 1:
        return file
    return replace(file, takes={"": next(iter(file.takes.values()))})


COLUMNS = ("start_s", "end_s", "category")


def format_labels_csv(segments: Iterable[Stretch]) -> str:
    """Format a row per segment: start_s, end_s, category (empty where nothing happens).

    If some are unclear, they have a question mark in a column ``perhaps``.
    """
    rows = list(segments)
    doubtful = not all(one.counted for one in rows)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow((*COLUMNS, *(("perhaps",) if doubtful else ())))
    for one in rows:
        perhaps = ("" if one.counted else "?",) if doubtful else ()
        writer.writerow((f"{one.start:.3f}", f"{one.stop:.3f}", one.category or "", *perhaps))
    return text.getvalue()


def write_labels_csv(segments: Iterable[Stretch], path: str | os.PathLike[str]) -> None:
    """Write ``format_labels_csv`` to a file; MotionWriteError if it cannot be written."""
    with atomic_write(path) as file:
        file.write(format_labels_csv(segments).encode())


_CMU_TAKE = re.compile(r"\s*(\d+)[\s_]+(\d+)\s*")
_ACTION = re.compile(r"\s*(\S*[^\W\d]\S*)\s+(\d+)\s+(\d+)\s+(\d+)\s*")


def is_cmu_list(text: str) -> bool:
    """Return whether the first lines of a text are those of such a list."""
    lines = [line for line in text.splitlines()[:20] if line.strip()][:2]
    return len(lines) == 2 and bool(_CMU_TAKE.fullmatch(lines[0])) and bool(_ACTION.fullmatch(lines[1]))


def read_cmu_list(path: str, data: bytes) -> LabelFile:
    """Read labels of several takes, in frames; MotionFileError for a line that is neither a take nor an action."""
    takes: dict[str, tuple[LabelTier, ...]] = {}
    name, begin = "", 0.0
    spans: list[Stretch] = []
    unclear: list[tuple[float, float]] = []
    warnings: list[Message] = []
    for number, line in enumerate(decode_text(path, data).splitlines(), 1):
        take, action = _CMU_TAKE.fullmatch(line), _ACTION.fullmatch(line)
        if take:
            name, begin, spans, unclear, warnings = f"{take[1]}_{take[2]}", 0.0, [], [], []
        elif action and name:
            earliest, likely, latest = sorted(float(action[k]) for k in (2, 3, 4))
            if earliest <= begin < likely:  # a typing error: only the likely end is used
                note = Message("label_files.cmu_order", frame=earliest, before=begin, likely=likely)
                warnings.append(Message("text.in_line", path=path, line=number, problem=note))
                earliest = likely
            if earliest <= begin:
                raise MotionFileError(path, "label_files.cmu_backwards", number, frame=latest, before=begin)
            check_category(path, action[1], number)
            spans.append(Stretch(begin, earliest, action[1], line=number))
            if latest > earliest:
                unclear.append((earliest, latest))
            begin = latest
        elif line.strip():
            raise MotionFileError(path, "label_files.cmu_line", number, found=line.strip()[:60])
        if name:
            takes[name] = (LabelTier("", tuple(spans), tuple(unclear), warnings=tuple(warnings)),)
    return LabelFile(path, takes, counts_frames=True)
