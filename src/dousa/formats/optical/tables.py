"""Numbers of a table of text: rows of cells, blank where a value is missing."""

from __future__ import annotations

import os

import numpy as np

from dousa.arrays import FloatArray
from dousa.errors import MotionFileError


def read_rows(path: str | os.PathLike[str], rows: list[list[str]], first_line: int, width: int) -> FloatArray:
    """Read (T, width) numbers; blank cells, and cells missing at the end of a row, are NaN.

    Parameters
    ----------
    path : for messages.
    rows : cells as text.
    first_line : 1-based line of the first row.
    width : cells read per row.

    Raises
    ------
    MotionFileError : a cell that is neither blank nor a finite number.
    """
    values = np.full((len(rows), width), np.nan)
    for number, row in enumerate(rows):
        cells = row[:width]
        try:
            values[number, : len(cells)] = [float(cell) if cell.strip() else np.nan for cell in cells]
        except ValueError:
            bad = next(cell for cell in cells if cell.strip() and not _is_number(cell))
            raise MotionFileError(path, "tables.number", first_line + number, found=bad.strip()[:40]) from None
    if np.isinf(values).any():
        raise MotionFileError(path, "tables.infinite", first_line + int(np.argwhere(np.isinf(values))[0][0]))
    return values


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def strip_owner(names: list[str]) -> tuple[list[str], list[str]]:
    """Strip owners from names, before a colon or a shared underscore; and the owners in order."""
    owners = list(dict.fromkeys(name.rpartition(":")[0] for name in names))
    bare = [name.rpartition(":")[2] for name in names]
    prefix = bare[0].partition("_")[0] + "_" if bare and "_" in bare[0] else ""
    if prefix and len(bare) > 4 and sum(name.startswith(prefix) for name in bare) == len(bare):
        bare = [name.removeprefix(prefix) for name in bare]
        owners = [prefix[:-1]]
    return bare, owners
