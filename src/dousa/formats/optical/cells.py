"""Cells of tables of text: numbers, blank where a value is missing; owners of names; trees by usual names."""

from __future__ import annotations

import csv
import os
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from dousa.arrays import FloatArray, IntArray
from dousa.errors import MotionFileError
from dousa.formats.guard import check_memory
from dousa.messages import Message
from dousa.motion.canonical.naming import group_owners

BLANK = frozenset({"", "nan", "na", "n/a", "null", "none", "-", "--", "."})
"""What programs write for a missing number, in lower case."""


def decode(data: bytes) -> str:
    """Decode the text of a table, with plain ends of lines; bytes of 0 are damage, as are others that are no text."""
    wide = data[:2] in (b"\xff\xfe", b"\xfe\xff")
    text = data.decode("utf-16" if wide else "utf-8-sig", errors="replace")
    return text.replace("\0", "\ufffd").replace("\r\n", "\n").replace("\r", "\n")


def read_rows(path: str | os.PathLike[str], rows: list[list[str]], lines: Sequence[int], width: int) -> FloatArray:
    """Read (T, width) numbers; blank cells, and cells missing at the end of a row, are NaN.

    Parameters
    ----------
    path : for messages.
    rows : cells as text.
    lines : 1-based line of each row.
    width : cells read per row.

    Raises
    ------
    MotionFileError : a cell that is neither blank nor a finite number.
    """
    values = np.full((len(rows), width), np.nan)
    for number, row in enumerate(rows):
        cells = row[:width]
        try:
            values[number, : len(cells)] = [float(cell or "nan") for cell in cells]
        except ValueError:
            bare = [cell.strip() for cell in cells]
            bad = next((cell for cell in bare if cell.lower() not in BLANK and not is_number(cell)), None)
            if bad is not None:
                raise MotionFileError(path, "tables.number", lines[number], found=bad[:40]) from None
            values[number, : len(cells)] = [np.nan if cell.lower() in BLANK else float(cell) for cell in bare]
    return values


def read_lines(
    path: str | os.PathLike[str],
    lines: Sequence[str],
    body: int,
    width: int,
    *,
    mark: str = "\t",
    declared: float = np.nan,
    whole: bool = False,
    at_once: int = 200_000,
) -> tuple[FloatArray, tuple[Message, ...]]:
    """Read (T, width) numbers from the lines of a table, and notes.

    A last line that breaks off is left out.

    Parameters
    ----------
    path : for messages.
    lines : of the whole file, the last one empty where the last row has an end.
    body : index of the first that is a row; blank lines are none.
    width : cells read per row.
    mark : between cells.
    declared : number of frames in the header, if any.
    whole : refuse rows of another width, but for blank cells at their end.
    at_once : so many cells are held as text at a time.

    Raises
    ------
    MotionFileError : no rows, a cell that is no number, rows of another width, rows that take too much memory.
    """
    blank = f'{mark} \r"\t'
    rows = [number for number in range(body, len(lines)) if lines[number].strip(blank)]
    notes = []
    open_end = len(rows) > 1 and rows[-1] == len(lines) - 1
    if open_end and breaks_off([lines[number] for number in rows], width, mark, declared):
        notes.append(Message("guard.cut_off", line=rows.pop() + 1))
    if not rows:
        raise MotionFileError(path, "tables.no_frames", body)
    check_memory(path, 8 * width * len(rows), sum(map(len, lines)))
    parts, widths = [], []
    step = max(1, at_once // width)
    for start in range(0, len(rows), step):
        part = rows[start : start + step]
        cells = [_split(lines[number], mark) for number in part]
        if whole:
            for number, row in zip(part, cells, strict=True):
                if len(row) < width or any(cell.strip() for cell in row[width:]):
                    raise MotionFileError(path, "tables.width", number + 1, expected=width, found=len(row))
        widths += list(map(len, cells))
        parts.append(read_rows(path, cells, [number + 1 for number in part], width))
    values = np.concatenate(parts)
    return values, (*notes, *_empty_shifted(values, np.array(widths), [number + 1 for number in rows]))


def _empty_shifted(values: FloatArray, widths: IntArray, lines: list[int], few: float = 0.1) -> tuple[Message, ...]:
    """Empty the rows (T, C) whose number of cells is not that of all others; of more than a ``few`` it says nothing."""
    usual = int(np.bincount(widths).argmax())
    odd = np.flatnonzero(widths != usual)
    if not 0 < len(odd) <= few * len(widths):
        return ()
    values[odd] = np.nan
    row = int(odd[0])
    return (Message("guard.row_width", n=len(odd), line=lines[row], found=int(widths[row]), expected=usual),)


def _split(line: str, mark: str) -> list[str]:
    return line.split(mark) if '"' not in line else next(csv.reader([line], delimiter=mark))


def breaks_off(rows: Sequence[str], width: int, mark: str, declared: float = np.nan) -> bool:
    """Return whether the last row, which has no end of line, breaks off.

    It lacks cells, or frames are missing, or its last number is shorter than all others of the column.

    Parameters
    ----------
    rows : as text.
    width : cells of a row.
    mark : between cells.
    declared : number of frames in the header, if any.
    """
    last = rows[-1].split(mark)
    if len(last) < width or len(rows) < declared:
        return True
    ends = [len(row.rpartition(mark)[2]) for row in rows[:-1]]
    return len(last) == width and len(rows) > 2 and 0 < len(last[-1]) < min(ends)


def read_number(cell: str | Sequence[str] | None) -> float | None:
    """Read a number of a header, decimal comma or point; None without a cell or in a blank one, NaN for other text."""
    if not isinstance(cell, str):
        cell = cell[0] if cell else ""
    cell = cell.strip().replace(",", ".")
    return None if not cell else float(cell) if is_number(cell) else np.nan


def is_number(cell: str) -> bool:
    """Return whether a cell is a number."""
    try:
        float(cell)
    except ValueError:
        return False
    return True


def strip_owner(names: list[str]) -> list[str]:
    """Strip the owner before a colon or a shared underscore, if all names have the same."""
    if len({name.rpartition(":")[0] for name in names}) > 1:
        return names
    bare = [name.rpartition(":")[2] for name in names]
    prefix = bare[0].partition("_")[0] + "_" if bare and "_" in bare[0] else ""
    shared = bool(prefix) and len(bare) > 4 and all(name.startswith(prefix) for name in bare)
    return [name.removeprefix(prefix) for name in bare] if shared else bare


_SIDES = ("L", "R")
_FINGERS = ("Thumb", "Index", "Middle", "Ring", "Pinky")

_MOTIVE_CHAINS = [
    "Hip Ab Chest Neck Head",
    "Hip Ab Spine2 Spine3 Spine4 Chest",
    *(f"Chest {s}Shoulder {s}UArm {s}FArm {s}Hand" for s in _SIDES),
    *(f"Hip {s}Thigh {s}Shin {s}Foot {s}Toe" for s in _SIDES),
    *(f"{s}Hand {s}{finger}1 {s}{finger}2 {s}{finger}3" for s in _SIDES for finger in _FINGERS),
]
_FBX_CHAINS = [
    "Hips Spine Spine1 Spine2 Spine3 Spine4 Neck Neck1 Head",
    *(f"TRUNK {s}Shoulder {s}Arm {s}ForeArm {s}ForeArmRoll {s}Hand" for s in ("Left", "Right")),
    *(f"Hips {s}UpLeg {s}Leg {s}Foot {s}ToeBase" for s in ("Left", "Right")),
    *(f"{s}Hand {s}Hand{f}1 {s}Hand{f}2 {s}Hand{f}3 {s}Hand{f}4" for s in ("Left", "Right") for f in _FINGERS),
    *(f"{s}Hand {s}InHand{f} {s}Hand{f}1" for s in ("Left", "Right") for f in _FINGERS),
]


def guess_parents(names: list[str]) -> dict[str, str]:
    """Return the parent of each joint of Motive's or Qualisys' skeletons by name, per person; {} for other names.

    Joints that a skeleton lacks are skipped.
    """
    parents: dict[str, str] = {}
    people = group_owners(tuple(names))
    for owner, joints in people.items():
        before = {name.rpartition(":")[2].removeprefix(f"{owner}_"): name for name in (names[j] for j in joints)}
        found = _guess_tree(list(before))
        if not found:
            return {}
        parents |= {before[child]: before[parent] for child, parent in found.items()}
    return parents if people else _guess_tree(names)


def _guess_tree(names: list[str]) -> dict[str, str]:
    """The parents of the joints of one skeleton."""
    present = set(names)
    chains = _MOTIVE_CHAINS if "Hip" in present else _FBX_CHAINS if "Hips" in present else []
    trunk = [name for name in ("Hips", "Spine", "Spine1", "Spine2", "Spine3", "Spine4") if name in present]
    parents: dict[str, str] = {}
    for chain in chains:
        joints = [trunk[-1] if name == "TRUNK" and trunk else name for name in chain.split()]
        for parent, child in pairwise([name for name in joints if name in present]):
            parents[child] = parent
    roots = [name for name in names if name not in parents]
    return parents if len(roots) == 1 else {}
