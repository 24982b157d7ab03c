"""TRC: marker positions as a table of text (Motion Analysis Cortex, OpenSim, Pose2Sim).

Three lines of header, a line of marker names over every third column, a line X1 Y1 Z1 X2 ..., and then one row per
frame: frame number, time, coordinates, separated by tabs, or throughout a file by commas, semicolons or spaces. A blank
or ``nan`` cell is a missing value; the decimal sign is a point or, throughout a file, a comma.
Reference: OpenSim documentation, "Marker (.trc) Files". The format does not declare the up axis.

Rows and names count, not NumFrames and NumMarkers, which are wrong in published files (those of Pose2Sim): a note.
"""

from __future__ import annotations

import os
import re

from dousa.errors import MotionFileError, MotionWriteError
from dousa.files.disk import atomic_write, read_bytes
from dousa.formats.assembly import declared_unit, settle_trajectories
from dousa.formats.guard import Clock, check_points, compare_points
from dousa.formats.tables.cells import decode, find_rows, list_lines, read_number
from dousa.motion import Trajectories


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
    text = decode(read_bytes(path))
    lines, mark = _with_tabs(list_lines(text))
    fields = _read_fields(path, lines)
    names, body = _read_names(path, lines)
    frames, width = read_number(fields.get("numframes")), 2 + 3 * len(names)
    rows, notes = find_rows(path, text, body, mark, (width, width), declared=frames)
    counted, values = rows.read((0, 1), range(2, width))
    del text, rows
    return settle_trajectories(
        path, "trc", names, values.reshape(len(values), -1, 3),
        Clock(read_number(fields.get("datarate")), counted[:, 1], counted[:, 0], frames),
        unit=unit, up=up, declared_unit=declared_unit(fields.get("units", "")), keep_values=True,
        notes=(*notes, *compare_points(read_number(fields.get("nummarkers")), len(names))),
    )  # fmt: skip


def _with_tabs(lines: list[str]) -> tuple[list[str], str]:
    """Replace the separators of the first lines with tabs; that of the rows."""
    header = next((line for line in lines[:20] if line.lstrip().lower().startswith("datarate")), "")
    if "\t" in header:
        return lines, "\t"
    mark = next((mark for mark in ",;" if mark in header), None)
    if mark is not None:
        return [line.replace(mark, "\t") for line in lines], mark
    start = next((n for n, line in enumerate(lines) if line.lstrip().lower().startswith("frame")), len(lines))
    if start < len(lines) and "\t" in lines[start]:
        return lines, "\t"
    # Blanks cannot mark an empty cell: the names stand one after the other.
    return lines[:start] + ["\t".join(line.split()) for line in lines[start:]], " "


def _cells(line: str) -> list[str]:
    parts = line.split("\t") if "\t" in line else line.split()
    return [part.strip() for part in parts]


def _read_fields(path: str | os.PathLike[str], lines: list[str]) -> dict[str, str]:
    """Header fields by lower-case name."""
    for number, line in enumerate(lines[:20]):
        if line.lstrip().lower().startswith("datarate"):
            if number + 1 >= len(lines):
                break
            keys, values = _cells(line), _cells(lines[number + 1])
            if len(values) > len(keys):  # some programs put two tabs between the values
                keys, values = [key for key in keys if key], [value for value in values if value]
            return {key.lower(): value for key, value in zip(keys, values, strict=False)}
    raise MotionFileError(path, "trc.no_header")


def _read_names(path: str | os.PathLike[str], lines: list[str]) -> tuple[tuple[str, ...], int]:
    """Marker names, and the index of the first line after the header."""
    for number, line in enumerate(lines[:20]):
        if line.lstrip()[:5].lower() != "frame":
            continue
        check_points(path, line.count("\t") // 3, number + 1)
        cells = line.split("\t")
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
