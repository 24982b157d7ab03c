"""Tables of text: rows of as many cells as their titles, cells as numbers, blank where a value is missing.

Rows and cells as texts of Python take many times their bytes. So a table stays one text, which is cut piece by piece,
and its numbers go into one array.
"""

from __future__ import annotations

import csv
import heapq
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from dousa.arrays import BoolArray, FloatArray, IntArray
from dousa.errors import MotionFileError
from dousa.formats.guard import check_memory
from dousa.formats.numbers import DONE, scan_numbers
from dousa.kernels import is_worth_compiling
from dousa.messages import Message

BLANK = frozenset({"", "nan", "na", "n/a", "null", "none", "-", "--", "."})
"""What programs write for a missing number, in lower case."""


def decode(data: bytes) -> str:
    """Decode the text of a table, with plain ends of lines; bytes of 0 are damage, as are others that are no text."""
    wide = data[:2] in (b"\xff\xfe", b"\xfe\xff")
    text = data.decode("utf-16" if wide else "utf-8-sig", errors="replace")
    for odd, plain in (("\0", "\ufffd"), ("\r\n", "\n"), ("\r", "\n")):
        text = text.replace(odd, plain)
    return text


def list_lines(text: str, most: int = 80) -> list[str]:
    """Return the first lines of a text."""
    return text.split("\n", most)[:most]


def split_rows(lines: Sequence[str], mark: str, most: int = -1) -> list[list[str]]:
    """Split each line into its cells, ``most`` and the rest; the ``mark`` of a blank stands for any white space."""
    own = None if mark == " " else mark
    return [
        line.split(own, most) if own is None or '"' not in line else next(csv.reader([line], delimiter=mark), [])
        for line in lines
    ]


def count_cells(row: Sequence[str]) -> tuple[int, int]:
    """Count the cells of a row of titles, up to the last that is not blank, and all of them."""
    return max((number for number, cell in enumerate(row, 1) if cell.strip()), default=0), len(row)


def is_number(cell: str) -> bool:
    """Return whether a cell is a number."""
    try:
        float(cell)
    except ValueError:
        return False
    return True


def read_number(cell: str | Sequence[str] | None) -> float | None:
    """Read a number of a header, decimal comma or point; None without a cell or in a blank one, NaN for other text."""
    if not isinstance(cell, str):
        cell = cell[0] if cell else ""
    cell = cell.strip().replace(",", ".")
    return None if not cell else float(cell) if is_number(cell) else np.nan


def _cut(text: str, size: int = 1 << 18) -> Iterator[str]:
    """Pieces of whole lines, of about so many characters: some MB as text of Python."""
    start = 0
    while start < len(text):
        end = text.find("\n", start + size)
        end = len(text) if end < 0 else end
        yield text[start:end]
        start = end + 1


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """The rows of a table.

    Parameters
    ----------
    path : for messages.
    text : a line for each row; cells that are in wrong columns are blank.
    mark : between cells.
    lines : (T,) 1-based line of the file of each row.
    """

    path: str
    text: str
    mark: str
    lines: IntArray

    def read(self, *groups: Sequence[int], loose: Sequence[int] = ()) -> list[FloatArray]:
        """Read (T, columns) numbers of each group; blank cells, and cells missing at the end of a row, are NaN.

        Parameters
        ----------
        groups : of columns.
        loose : columns in which other text is no error.

        Raises
        ------
        MotionFileError : a cell that is neither blank nor a number.
        """
        columns = [column for group in groups for column in group]
        ends = np.cumsum([len(group) for group in groups])
        found = [np.empty((len(self.lines), len(group))) for group in groups]
        row = 0
        for piece in _cut(self.text):
            values = _scan(piece, self.mark)
            if values is not None and max(columns) < values.shape[1]:
                values = values[:, columns]
            else:
                cells = split_rows(piece.split("\n"), self.mark)
                try:
                    numbers = [[float(own[column] or "nan") for column in columns] for own in cells]
                except (ValueError, IndexError):
                    numbers = [self._read_row(own, columns, loose, n) for n, own in enumerate(cells, row)]
                values = np.array(numbers)
            for array, end in zip(found, ends, strict=True):
                array[row : row + len(values)] = values[:, end - array.shape[1] : end]
            row += len(values)
        return found

    def _read_row(self, cells: Sequence[str], columns: Sequence[int], loose: Sequence[int], row: int) -> list[float]:
        values = [np.nan] * len(columns)
        for place, column in enumerate(columns):
            cell = cells[column].strip() if column < len(cells) else ""
            if is_number(cell):
                values[place] = float(cell)
            elif cell.lower() not in BLANK and column not in loose:
                raise MotionFileError(self.path, "tables.number", int(self.lines[row]), found=cell[:40])
        return values

    def find_texts(self, column: int) -> tuple[list[str], IntArray]:
        """Find the different texts of a column, blank ones as "", and the number of that of each row (T,)."""
        known: dict[str, int] = {}
        numbers = np.empty(len(self.lines), np.int64)
        row = 0
        for piece in _cut(self.text):
            rows = split_rows(piece.split("\n"), self.mark, column + 1)
            cells = [own[column].strip() if column < len(own) else "" for own in rows]
            numbers[row : row + len(cells)] = [known.setdefault(cell, len(known)) for cell in cells]
            row += len(cells)
        return ["" if text.lower() in BLANK else text for text in known], numbers

    def take(self, kept: BoolArray) -> Rows:
        """Return some of the rows."""
        if kept.all():
            return self
        marks = iter(kept.tolist())
        pieces = ["\n".join(line for line in piece.split("\n") if next(marks)) for piece in _cut(self.text)]
        return Rows(self.path, "\n".join(filter(None, pieces)), self.mark, self.lines[kept])


def _scan(piece: str, mark: str) -> FloatArray | None:
    """All numbers of some rows, by the kernel; None where that is not worth it, or something else is among them."""
    if '"' in piece or (mark != " " and re.search(r"[^\S\n\t]", piece)) or not is_worth_compiling(len(piece) // 8):
        return None
    if mark == " ":
        columns = len(piece.partition("\n")[0].split())
    else:
        columns = piece.partition("\n")[0].count(mark) + 1
        for before, after in ((mark, mark), (mark, "\n"), ("\n", mark)):
            while before + after in piece:
                piece = piece.replace(before + after, f"{before}nan{after}")
        piece = f"{'nan' * piece.startswith(mark)}{piece}{'nan' * piece.endswith(mark)}".replace(mark, " ")
    data = f"{piece}\n".encode()
    values, status, _, filled, bad = scan_numbers(data, 0, columns, piece.count("\n") + 1)
    return values if status == DONE and bad is None and filled == values.size else None


def find_rows(
    path: str | os.PathLike[str],
    text: str,
    body: int,
    mark: str,
    titles: tuple[int, int],
    *,
    declared: float | None = None,
    few: float = 0.1,
) -> tuple[Rows, tuple[Message, ...]]:
    """Find the rows of a table below its titles, and notes.

    The cells of a row are as many as those of the titles; blank ones at the end of either may be too many. Where they
    are not, its values are in wrong columns: they are left empty. A last line that breaks off is left out; blank lines
    are no rows. A blank line that other text than numbers follows ends the table. Decimal commas become points.

    Parameters
    ----------
    path : for messages.
    text : of the whole file.
    body : lines above the rows.
    mark : between cells.
    titles : number of their cells as of `count_cells`.
    declared : number of frames in the header, if any.
    few : share of the rows that may have another number of cells; if more have, the titles are wrong.

    Raises
    ------
    MotionFileError : no rows, too many of another number of cells, rows that take too much memory.
    """
    start = sum(len(line) + 1 for line in list_lines(text, body))
    ends = text.endswith("\n")
    rest = text[start : len(text) - ends]
    if mark != "," and "," in rest and "." not in rest:
        rest = rest.replace(",", ".")
    lines, odd = _survey(rest, body, mark, titles)
    notes = []
    if not ends and len(lines) > 1 and lines[-1] == body + rest.count("\n") + 1:
        last = rest.rpartition("\n")[2]
        lacks = odd[-1][1] < titles[0] if odd and odd[-1][0] == lines[-1] else _is_shorter(last, rest, mark)
        if lacks or len(lines) < (declared or 0):
            notes.append(Message("guard.cut_off", line=int(lines[-1])))
            odd, lines = [one for one in odd if one[0] < lines[-1]], lines[:-1]
    if not len(lines):
        raise MotionFileError(path, "tables.no_frames", body)
    check_memory(path, 8 * titles[0] * len(lines), len(text))
    if odd:
        line, found = odd[0]
        if len(odd) > few * len(lines):
            raise MotionFileError(path, "tables.width", line, expected=titles[0], found=found)
        notes.append(Message("guard.row_width", n=len(odd), line=line, found=found, expected=titles[0]))
    if odd or len(lines) != rest.count("\n") + 1:
        blank, wrong, every = mark.join(["nan"] * titles[0]), {line for line, _ in odd}, rest.split("\n")
        rest = "\n".join(blank if line in wrong else every[line - body - 1] for line in lines.tolist())
    return Rows(os.fspath(path), rest, mark, lines), tuple(notes)


def _survey(text: str, body: int, mark: str, titles: tuple[int, int]) -> tuple[IntArray, list[tuple[int, int]]]:
    """The lines that are rows, from ``body`` + 1 on, and the line and number of cells of those of odd width."""
    low, high = titles
    signs = f'{mark} "\t'
    unusual = re.compile(rf'"|(?:\A|\n)(?:[{re.escape(signs)}\n]|\Z)')
    found: list[IntArray] = []
    odd: list[tuple[int, int]] = []
    gap, number = False, body
    for piece in _cut(text):
        lines = piece.split("\n")
        first, number = number + 1, number + len(lines)
        if not gap and mark != " " and not unusual.search(piece):
            counts = [line.count(mark) + 1 for line in lines]
            if low <= min(counts) and max(counts) <= high:
                found.append(np.arange(first, number + 1))
                continue
        rows: list[int] = []
        for place, cells in enumerate(split_rows(lines, mark), first):
            if not lines[place - first].strip(signs):
                gap = gap or bool(rows or found)
                continue
            if gap and not any(map(is_number, cells)):
                found.append(np.array(rows, np.int64))
                return np.concatenate(found), odd
            gap = False
            rows.append(place)
            full = len(cells)
            if full < low or (full > high and count_cells(cells)[0] > high):
                odd.append((place, full))
        found.append(np.array(rows, np.int64))
    return np.concatenate(found) if found else np.zeros(0, np.int64), odd


def _is_shorter(last: str, text: str, mark: str) -> bool:
    """Whether the number at the end of the last row is shorter than those of all others."""
    ends = (len(line.rpartition(mark)[2]) for piece in _cut(text) for line in piece.split("\n") if line)
    shortest = heapq.nsmallest(3, ends)
    own = len(last.rpartition(mark)[2])
    return len(shortest) > 2 and own == shortest[0] and 0 < own < shortest[1]
