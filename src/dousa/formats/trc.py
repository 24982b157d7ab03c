"""TRC: marker positions as a table of text (Motion Analysis Cortex, OpenSim, Pose2Sim).

Three lines of header, a line of marker names over every third column, a line X1 Y1 Z1 X2 ..., and then one row per
frame: frame number, time, coordinates, separated by tabs, or throughout a file by commas, semicolons or spaces. A blank
or ``nan`` cell is a missing value; the decimal sign is a point or, throughout a file, a comma.
Reference: OpenSim documentation, "Marker (.trc) Files". The format does not declare the up axis.

The rows count, not NumFrames and NumMarkers, which are wrong in published files (those of Pose2Sim). A file counts as
cut off where the last row is short, or where frames are missing and the last line does not end: that row is left out,
with a note.
"""

from __future__ import annotations

import os
import re

import numpy as np

from dousa.arrays import FloatArray
from dousa.errors import MotionFileError, MotionWriteError
from dousa.files.disk import atomic_write, read_bytes
from dousa.formats.assembly import declared_unit, settle_trajectories
from dousa.messages import Message
from dousa.motion import Trajectories

_NUMBER = re.compile(r"\s*[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?\s*|\s*[+-]?(nan|inf|infinity)\s*", re.IGNORECASE)


def read_trc(path: str | os.PathLike[str], *, unit: float | str | None = None, up: str | None = None) -> Trajectories:
    """Read the markers of a TRC file, NaN where missing; ``provenance.values`` (T, K, 3) are the file's own numbers.

    Parameters
    ----------
    path : the file.
    unit : metres per unit, or its name; by default that of the header.
    up : axis that points up; by default Y unless the body stands along another.

    Raises
    ------
    MotionFileError : missing, empty, text where numbers belong, rows of another width.
    """
    # splitlines would also break at exotic separators inside a name
    text = read_bytes(path).decode("utf-8-sig", errors="replace")
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    lines = _with_tabs(lines)
    fields, fields_line = _read_fields(path, lines)
    rate = _field_number(path, fields, "datarate", fields_line)
    if not 0 < rate <= 1e6:
        raise MotionFileError(path, "trc.rate", fields_line, rate=rate)
    names, body = _read_names(path, lines)
    declared = _field_number(path, fields, "numframes", fields_line) if "numframes" in fields else 0.0
    whole = _without_cut_row(lines, body, 2 + 3 * len(names), declared)
    positions = _read_rows(path, whole, body, names)
    notes = []
    if len(whole) < len(lines):
        notes.append(Message("trc.cut_off", found=len(positions), declared=declared))
    elif 0 < declared != len(positions):
        notes.append(Message("trc.frame_count", found=len(positions), declared=declared))
    return settle_trajectories(
        path,
        "trc",
        names,
        positions,
        rate,
        unit=unit,
        up=up,
        unit_in_file=declared_unit(fields.get("units", "")),
        up_in_file=None,
        default_up="y",
        keep_values=True,
        notes=tuple(notes),
    )


def _with_tabs(lines: list[str]) -> list[str]:
    """Replace the separators of the lines with tabs."""
    header = next((line for line in lines[:20] if line.lstrip().lower().startswith("datarate")), "")
    if "\t" in header:
        return lines
    mark = next((mark for mark in ",;" if mark in header), None)
    if mark is not None:
        return [line.replace(mark, "\t") for line in lines]
    start = next((n for n, line in enumerate(lines) if line.lstrip().lower().startswith("frame")), len(lines))
    if start < len(lines) and "\t" in lines[start]:
        return lines
    # Blanks cannot mark an empty cell: the names stand one after the other.
    return lines[:start] + ["\t".join(line.split()) for line in lines[start:]]


def _without_cut_row(lines: list[str], body: int, width: int, declared: float) -> list[str]:
    """Drop a last row that breaks off, unless it is the only one."""
    rows = [number for number in range(body, len(lines)) if lines[number].strip()]
    if len(rows) < 2:
        return lines
    last = lines[rows[-1]]
    cut = rows[-1] == len(lines) - 1 and (len(rows) < declared or last.count("\t") + 1 < width)
    return lines[: rows[-1]] if cut else lines


def _cells(line: str) -> list[str]:
    parts = line.split("\t") if "\t" in line else line.split()
    return [part.strip() for part in parts]


def _read_fields(path: str | os.PathLike[str], lines: list[str]) -> tuple[dict[str, str], int]:
    """Header fields by lower-case name, and the 1-based line of their values."""
    for number, line in enumerate(lines[:20]):
        if line.lstrip().lower().startswith("datarate"):
            if number + 1 >= len(lines):
                break
            keys, values = _cells(line), _cells(lines[number + 1])
            if len(values) > len(keys):  # some programs put two tabs between the values
                keys, values = [key for key in keys if key], [value for value in values if value]
            return {key.lower(): value for key, value in zip(keys, values, strict=False)}, number + 2
    raise MotionFileError(path, "trc.no_header")


def _field_number(path: str | os.PathLike[str], fields: dict[str, str], key: str, line: int) -> float:
    text = fields.get(key, "").replace(",", ".")
    if not _NUMBER.fullmatch(text):
        raise MotionFileError(path, "trc.header_number", line, key=key, found=text)
    return float(text)


def _read_names(path: str | os.PathLike[str], lines: list[str]) -> tuple[tuple[str, ...], int]:
    """Marker names, and the index of the first line after the header."""
    for number, line in enumerate(lines[:20]):
        cells = line.split("\t")
        if not cells[0].strip().lower().startswith("frame"):
            continue
        cells = [cell.strip() for cell in cells[2:]]
        while cells and not cells[-1]:
            cells.pop()
        # Some programs write the names one after the other instead of over every third column.
        spaced = all(not cell for index, cell in enumerate(cells) if index % 3)
        columns = cells[::3] if spaced else [cell for cell in cells if cell]
        if not columns:
            raise MotionFileError(path, "trc.empty_names", number + 1)
        names = tuple(name or f"point{index + 1}" for index, name in enumerate(columns))
        body = number + 1
        while body < len(lines) and lines[body].strip()[:1] in ("", "X", "x"):
            body += 1
        return names, body
    raise MotionFileError(path, "trc.no_names")


def _read_rows(
    path: str | os.PathLike[str], lines: list[str], body: int, names: tuple[str, ...], chunk: int = 200_000
) -> FloatArray:
    """Positions (T, K, 3) in file units; so many cells are held as text at a time."""
    width = 2 + 3 * len(names)
    rows = lines[body:]
    if any("," in row for row in rows) and not any("." in row for row in rows):
        rows = [row.replace(",", ".") for row in rows]
    numbered = [(number, row) for number, row in enumerate(rows, body + 1) if row and not row.isspace()]
    if not numbered:
        raise MotionFileError(path, "trc.no_frames", body)
    step = max(1, chunk // width)
    chunks = []
    for start in range(0, len(numbered), step):
        part = numbered[start : start + step]
        cells = [_row_cells(path, line, number, names) for number, line in part]
        chunks.append(_parse_rows(path, cells, part, names))
    positions = np.concatenate(chunks)
    if np.isinf(positions).any():
        row, point, _ = np.argwhere(np.isinf(positions))[0]
        raise MotionFileError(path, "trc.infinite", numbered[row][0], name=names[point])
    return positions


def _row_cells(path: str | os.PathLike[str], line: str, number: int, names: tuple[str, ...]) -> list[str]:
    width = 2 + 3 * len(names)
    cells = line.split("\t")
    if len(cells) != width:
        if any(cell.strip() for cell in cells[width:]) or len(cells) < width:
            raise MotionFileError(path, "trc.value_count", number, expected=width, markers=len(names), found=len(cells))
        cells = cells[:width]
    return cells[2:]


def _parse_rows(
    path: str | os.PathLike[str],
    rows: list[list[str]],
    numbered: list[tuple[int, str]],
    names: tuple[str, ...],
) -> FloatArray:
    try:
        values = np.array([[float(cell or "nan") for cell in row] for row in rows])
    except ValueError:
        values = np.array(
            [
                [_parse_cell(path, cell, number, names[column // 3]) for column, cell in enumerate(row)]
                for row, (number, _) in zip(rows, numbered, strict=True)
            ]
        )
    return values.reshape(len(rows), len(names), 3)


def _parse_cell(path: str | os.PathLike[str], cell: str, number: int, name: str) -> float:
    if not cell.strip():
        return float("nan")
    if not _NUMBER.fullmatch(cell):
        raise MotionFileError(path, "trc.number", number, name=name, found=cell.strip()[:40])
    return float(cell)


def write_trc(motion: Trajectories, path: str | os.PathLike[str]) -> None:
    """Write trajectories as a TRC file.

    Unchanged positions from a TRC file are written in its unit and axes, digit for digit; others in metres with Y up.
    Missing values are written as ``nan``.

    Raises
    ------
    MotionWriteError : a blank name or one with a tab or line break, a disk error.
    """
    for name in motion.names:
        if not name.strip() or re.search(r"[\t\r\n]", name):
            raise MotionWriteError(path, "trc.marker_name", name=name)
    source = motion.provenance
    values, unit = motion.positions, "m"
    kept = source.values_of(motion.positions) if source is not None and source.format == "trc" else None
    if source is not None and kept is not None:
        known = {1.0: "m", 0.01: "cm", 0.001: "mm", 0.0254: "inches", 0.3048: "ft"}
        if source.unit in known:
            values, unit = kept, known[source.unit]
    with atomic_write(path) as file:
        file.write(_header(motion, os.path.basename(os.fspath(path)), unit).encode())
        for frame, row in enumerate(values.reshape(motion.n_frames, -1).tolist()):
            cells = "\t".join(map(repr, row))
            file.write(f"{frame + 1}\t{frame / motion.frame_rate!r}\t{cells}\n".encode())


def _header(motion: Trajectories, file_name: str, unit: str) -> str:
    count, rate = len(motion.names), repr(float(motion.frame_rate)).removesuffix(".0")
    keys = "DataRate CameraRate NumFrames NumMarkers Units OrigDataRate OrigDataStartFrame OrigNumFrames"
    values = (rate, rate, motion.n_frames, count, unit, rate, 1, motion.n_frames)
    axes = "\t".join(f"X{k}\tY{k}\tZ{k}" for k in range(1, count + 1))
    lines = (
        f"PathFileType\t4\t(X/Y/Z)\t{file_name}",
        "\t".join(keys.split()),
        "\t".join(map(str, values)),
        "Frame#\tTime\t" + "\t\t\t".join(motion.names) + "\t\t",
        f"\t\t{axes}",
        "",
    )
    return "\n".join(lines) + "\n"
