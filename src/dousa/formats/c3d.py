"""C3D: measured points in binary (Vicon, Qualisys, Motion Analysis ...; c3d.org).

Reference: Motion Lab Systems, "The C3D File Format User Guide" (2021). All three processors (Intel, DEC, MIPS),
integer and float storage, more than 255 labels and more than 65,535 frames are read; analog channels are skipped.

Why no library reads the file. Measured on damaged copies of one good file (bytes changed in the header and
parameter section, or cut off; memory limited to 2 GB):

- ezc3d 1.7.2 (C++): 1,500 copies gave 72 segmentation faults, 4 hangs and 29 failed huge allocations. A crash
  cannot be caught, and whatever check would keep such files away from it must understand the whole section.
- c3d 0.6.0 (Python): no crash, but it refuses sound files on which header and parameters disagree in what does not
  matter here (analog rate, scale), or in which a parameter occurs twice, and takes one Python step per frame.

So the two sections are taken apart here with every pointer checked and the data in one numpy
view; the tests compare with ezc3d, value by value.
"""

from __future__ import annotations

import math
import os
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray, IndexArray
from dousa.errors import MotionFileError, MotionWriteError
from dousa.files.disk import atomic_write, read_bytes
from dousa.formats.assembly import declared_unit, settle_trajectories
from dousa.formats.guard import EXACT, Clock, check_points, compare_bytes, find_shift
from dousa.messages import Message
from dousa.motion import Motion, Trajectories, thin
from dousa.motion.canonical.reference_frame import infer_reference_frame

BLOCK = 512
"""Bytes of a block, by the definition of the format (user guide)."""

# By the definition of the format: the key in the second byte, the processors.
_MAGIC, _INTEL, _DEC, _MIPS = 0x50, 84, 85, 86


@dataclass(frozen=True, slots=True)
class Header:
    """The numbers needed from the first block; word numbers as in the user guide."""

    n_points: int
    n_analog: int
    """Analog samples per frame, all channels together."""
    first_frame: int
    last_frame: int
    scale: float
    data_block: int
    n_samples: int
    """Analog samples per frame and channel."""
    frame_rate: float


@dataclass(frozen=True, slots=True)
class Sections:
    """Header, and the bytes after the link of each parameter by ``"GROUP:NAME"``, upper case; parsed when asked for."""

    path: str
    header: Header
    parameters: dict[str, bytes]
    processor: int

    def number(self, key: str) -> float | None:
        """Return the first value of a numeric parameter, None if there is none."""
        if key not in self.parameters:
            return None
        size, _, data = self._find(key)
        if len(data) < abs(size) or not size:
            return None
        if size == 4:
            return _decode_float(data[:4], self.processor)
        return float(int.from_bytes(data[: abs(size)], "big" if self.big_endian else "little"))

    def numbers(self, key: str) -> FloatArray:
        """Return all values of a numeric parameter; 16-bit integers unsigned, as counts may exceed 32,767."""
        if key not in self.parameters:
            return np.zeros(0)
        size, _, data = self._find(key)
        if size == 4:
            return decode_floats(data, self.processor).astype(np.float64)
        kind = np.uint8 if size != 2 else ">u2" if self.big_endian else "<u2"
        return np.frombuffer(data, kind).astype(np.float64)

    def texts(self, key: str) -> list[str]:
        """Return the texts of a parameter and of its continuations NAME2, NAME3 ..., without blanks and zero bytes."""
        texts: list[str] = []
        number, name = 1, key
        while name in self.parameters:
            _, shape, data = self._find(name)
            length = shape[0] if len(shape) > 1 else len(data)
            texts += [_decode_text(data[start : start + length]) for start in range(0, len(data), length or 1)]
            number += 1
            name = f"{key}{number}"
        return texts

    def _find(self, key: str) -> tuple[int, bytes, bytes]:
        """Bytes of an item (-1 for text), shape (text length first) and data of a parameter.

        MotionFileError if its sizes point outside its bytes, which may be more than it needs.
        """
        entry = self.parameters[key]
        if len(entry) >= 2:
            item_size, start = int.from_bytes(entry[:1], signed=True), 2 + entry[1]
            shape = entry[2:start]
            stop = start + abs(item_size) * math.prod(shape)
            if len(entry) >= max(start, stop) and item_size in (-1, 1, 2, 4):
                return item_size, shape, entry[start:stop]
        raise MotionFileError(self.path, "c3d.parameter_size", name=key)

    @property
    def big_endian(self) -> bool:
        """Whether the high byte comes first."""
        return self.processor == _MIPS


def _decode_text(data: bytes) -> str:
    data = data.partition(b"\0")[0].strip()
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def decode_floats(data: bytes, processor: int) -> NDArray[np.float32]:
    """Convert 32-bit floats of any of the three processors to native ones; DEC's exponents are two higher."""
    usable = len(data) // 4 * 4
    with np.errstate(invalid="ignore"):  # damaged bytes may be a signalling NaN
        if processor == _DEC:
            words = np.ascontiguousarray(np.frombuffer(data[:usable], "<u2").reshape(-1, 2)[:, ::-1])
            return (words.view("<f4")[:, 0] / np.float32(4)).astype(np.float32)
        return np.frombuffer(data[:usable], ">f4" if processor == _MIPS else "<f4").astype(np.float32)


def _decode_float(data: bytes, processor: int) -> float:
    """Convert one float, several times faster than `decode_floats`."""
    if processor == _DEC:
        return float(decode_floats(data, processor)[0])
    number: float = struct.unpack(">f" if processor == _MIPS else "<f", data)[0]
    return number


def parse_sections(path: str | os.PathLike[str], data: bytes) -> Sections:
    """Parse header and parameters; MotionFileError if it is no C3D file, cut off, or points outside."""
    if len(data) < 2 or data[1] != _MAGIC:
        raise MotionFileError(path, "c3d.magic")
    if len(data) < 2 * BLOCK:
        raise MotionFileError(path, "c3d.short", found=len(data))
    start = (max(data[0], 2) - 1) * BLOCK  # a pointer of 0 or 1 means the usual place
    if start + 4 > len(data):
        raise MotionFileError(path, "c3d.parameters_beyond")
    processor = data[start + 3]
    if processor not in (_INTEL, _DEC, _MIPS):
        raise MotionFileError(path, "c3d.processor", found=processor)
    header = _parse_header(data, processor)
    # The section's own block count is one byte, too small for the largest files: the data section ends it.
    data_start = (header.data_block - 1) * BLOCK
    end = min(data_start, len(data)) if data_start > start else len(data)
    return Sections(os.fspath(path), header, _parse_parameters(path, data[start + 4 : end], processor), processor)


def _parse_header(data: bytes, processor: int) -> Header:
    order = ">" if processor == _MIPS else "<"
    points, analog, first, last, scale, block, samples, rate = struct.unpack_from(f"{order}2x4H2x4s2H4s", data)
    scale, rate = _decode_float(scale, processor), _decode_float(rate, processor)
    return Header(points, analog, first, last, scale, block, samples, rate)


def _parse_parameters(
    path: str | os.PathLike[str], section: bytes, processor: int, most: int = 20_000
) -> dict[str, bytes]:
    """Split groups and parameters, at most so many: 127 groups of real files hold some hundreds."""
    groups: dict[int, str] = {}
    found: list[tuple[int, str, bytes]] = []
    text, padded, place = section.decode("latin-1"), section + bytes(256), 0
    signs = struct.Struct("bb").unpack_from
    here, turned = (struct.Struct(f"{order}H").unpack_from for order in ("><" if processor == _MIPS else "<>"))
    while place + 2 <= len(section):
        length, number = signs(section, place)
        if length == 0 or number == 0:
            break
        link = place + 2 + abs(length)  # a negative length marks a locked entry, a negative number a group
        name = text[place + 2 : link].partition("\0")[0].strip().upper()
        (offset,) = here(padded, link)
        if link + offset > len(section):  # files that were turned from one processor to another keep some as they were
            (offset,) = turned(padded, link)
        if number < 0:
            groups.setdefault(-number, name)
        else:
            found.append((number, name, section[link + 2 : link + offset if offset else None]))
        if offset == 0:
            break
        if len(found) > most:
            raise MotionFileError(path, "c3d.too_many_parameters", most=most)
        if offset < 2 or link + offset > len(section):
            raise MotionFileError(path, "c3d.parameter_place", name=name)
        place = link + offset
    parameters: dict[str, bytes] = {}
    for number, name, entry in found:
        parameters.setdefault(f"{groups.get(number, number)}:{name}", entry)
    return parameters


# By the definition of the format: sizes of a parameter are bytes, counts of the header are 16 bits.
_MOST_LABELS, _FULL_COUNTER = 255, 65_535


def write_c3d(motion: Trajectories, path: str | os.PathLike[str]) -> None:
    """Write trajectories as a C3D file, in mm with Y up, as 32-bit floats.

    Missing positions get the residual -1. Names are kept; the tree and the rest pose are lost. What is so far from the
    origin that 32 bits resolve no micrometre is moved to it; the parameter DOUSA:SHIFT has what was taken off, in mm.

    Raises
    ------
    MotionWriteError : names that C3D cannot hold, too many points, positions too large, a disk error.
    """
    names = [_check_name(path, name) for name in motion.names]
    shift = find_shift(motion.positions, far=EXACT)
    if shift is not None:
        motion = motion.replace(positions=motion.positions - shift)
    # The place of the data is in the parameters, whose size does not depend on it.
    blocks = -(-len(_parameter_section(motion, names, 0, shift)) // BLOCK)
    if len(names) > _FULL_COUNTER or blocks > 255:
        raise MotionWriteError(path, "c3d.too_many_points", count=len(names))
    section = _parameter_section(motion, names, 2 + blocks, shift).ljust(blocks * BLOCK, b"\0")
    section = section[:2] + bytes([blocks]) + section[3:]
    with atomic_write(path) as file:
        file.write(_header(motion, 2 + blocks))
        file.write(section)
        for start in range(0, motion.n_frames, 4096):
            file.write(_encode_frames(path, motion.positions[start : start + 4096]))
        file.write(bytes(-file.tell() % BLOCK))


def _check_name(path: str | os.PathLike[str], name: str) -> bytes:
    try:
        text = name.encode("utf-8")
    except UnicodeEncodeError:
        text = b""
    if not text.strip() or len(text) > 255 or text.startswith(b"*") or b"\0" in text:
        raise MotionWriteError(path, "c3d.point_name", name=name[:40])
    return text


def _encode_frames(path: str | os.PathLike[str], positions: np.ndarray) -> bytes:
    words = np.zeros((*positions.shape[:2], 4), "<f4")
    missing = np.isnan(positions).any(axis=2)
    with np.errstate(over="ignore"):
        words[..., :3] = positions * 1000.0
    words[missing] = (0.0, 0.0, 0.0, -1.0)
    if not np.isfinite(words).all():
        raise MotionWriteError(path, "c3d.range")
    return words.tobytes()


def _header(motion: Trajectories, data_block: int) -> bytes:
    last = min(motion.n_frames, _FULL_COUNTER)
    start = struct.pack(
        "<BBHHHHHfHHf", 2, _MAGIC, len(motion.names), 0, 1, last, 0, -1.0, data_block, 0, motion.frame_rate
    )
    return start.ljust(BLOCK, b"\0")


def _parameter_section(motion: Trajectories, names: list[bytes], data_block: int, shift: FloatArray | None) -> bytes:
    frames = motion.n_frames
    point = [
        _integers("USED", [len(names)]),
        _floats("SCALE", [-1.0]),
        _floats("RATE", [motion.frame_rate]),
        _integers("DATA_START", [data_block]),
        _integers("FRAMES", [min(frames, _FULL_COUNTER)]),
        _floats("LONG_FRAMES", [frames]),
        _texts("UNITS", [b"mm"]),
        _texts("X_SCREEN", [b"+X"]),
        _texts("Y_SCREEN", [b"+Y"]),
    ]
    for number, start in enumerate(range(0, len(names), _MOST_LABELS), 1):
        part, suffix = names[start : start + _MOST_LABELS], "" if number == 1 else str(number)
        point += [_texts(f"LABELS{suffix}", part), _texts(f"DESCRIPTIONS{suffix}", [b""] * len(part))]
    groups = {
        "POINT": point,
        "ANALOG": [_integers("USED", [0]), _floats("RATE", [0.0]), _floats("GEN_SCALE", [1.0])],
        "FORCE_PLATFORM": [_integers("USED", [0])],
        "TRIAL": [
            _integers("ACTUAL_START_FIELD", [1, 0]),
            _integers("ACTUAL_END_FIELD", [frames % 65_536, frames // 65_536]),
        ],
    }
    if shift is not None:
        groups["DOUSA"] = [_texts("SHIFT", [" ".join(map(repr, (shift * 1000).tolist())).encode()])]
    section = bytes([1, _MAGIC, 0, _INTEL])
    for group_id, (name, parameters) in enumerate(groups.items(), 1):
        section += struct.pack("bb", len(name), -group_id) + name.encode() + b"\3\0\0"
        for parameter_name, content in parameters:
            section += struct.pack("bb", len(parameter_name), group_id) + parameter_name.encode()
            section += struct.pack("<H", len(content) + 3) + content + b"\0"
    return section + b"\0\0"


def _integers(name: str, values: Sequence[int]) -> tuple[str, bytes]:
    return name, _array(2, values, "<u2")


def _floats(name: str, values: Sequence[float]) -> tuple[str, bytes]:
    return name, _array(4, values, "<f4")


def _array(item_size: int, values: Sequence[float], dtype: str) -> bytes:
    """One value is a scalar, more are a list."""
    axes = [] if len(values) == 1 else [len(values)]
    return struct.pack("bB", item_size, len(axes)) + bytes(axes) + np.array(values, dtype).tobytes()


def _texts(name: str, values: list[bytes]) -> tuple[str, bytes]:
    """One text is a string, more are a table of strings of equal length."""
    length = max(1, *map(len, values)) if len(values) > 1 else max(1, len(values[0]))
    content = b"".join(value.ljust(length) for value in values)
    return name, struct.pack("bBBB", -1, 2, length, len(values)) + content


# Parameters of the POINT group that list points other than positions.
_NOT_POSITIONS = ("ANGLES", "FORCES", "MOMENTS", "POWERS", "REACTIONS", "SCALARS")


def read_c3d(
    path: str | os.PathLike[str], *, unit: float | str | None = None, up: str | None = None
) -> Trajectories | Motion:
    """Read the points of a C3D file, or the poses of segments of a markerless system if it holds no points.

    Unlabelled points (no name, or one that starts with ``*``) and computed angles, forces, moments and powers are
    left out. Missing positions are NaN.

    Parameters
    ----------
    path : the file.
    unit : metres per unit, or its name; by default POINT:UNITS, else inferred from body height.
    up : axis that points up; by default POINT:Y_SCREEN, else inferred.

    Raises
    ------
    MotionFileError : missing, not C3D, damaged, cut off, without points.
    """
    data = read_bytes(path)
    sections = parse_sections(path, data)
    if not sections.number("POINT:USED") and sections.number("ROTATION:USED"):
        return _read_segments(sections, data, unit=unit, up=up)
    chosen, names = _choose_points(sections)
    positions, clock, notes = _read_positions(sections, data, chosen)
    notes += _compare_header(sections)
    shift = [float(word) for word in " ".join(sections.texts("DOUSA:SHIFT")).split()]
    if len(shift) == 3:  # see `write_c3d`
        positions += shift
    units = sections.texts("POINT:UNITS")
    unit_in_file = declared_unit(units[0]) if units else None
    if any(note.values.get("key") == "POINT:SCALE" for note in notes if note.code == "c3d.header"):
        positions, notes = _choose_scale(sections, names, positions, unit_in_file, notes)
    return settle_trajectories(
        path, "c3d", names, positions, clock,
        unit=unit, up=up, declared_unit=unit_in_file, declared_up=_up_axis(sections), default_up=None, notes=notes,
    )  # fmt: skip


def _read_segments(sections: Sections, data: bytes, *, unit: float | str | None, up: str | None) -> Motion:
    """The motion of the 4 x 4 matrices of the ROTATION group."""
    from dousa.formats.theia import ITEMS, build_segments

    labels = sections.texts("ROTATION:LABELS")[: max(0, int(sections.number("ROTATION:USED") or 0))]
    start = max(0, int(sections.number("ROTATION:DATA_START") or sections.header.data_block) - 1) * BLOCK
    width = ITEMS * len(labels)
    values = decode_floats(data[start:], sections.processor).astype(np.float64)
    ratio = max(1, int(sections.number("ROTATION:RATIO") or 1))
    declared = (sections.header.last_frame - sections.header.first_frame + 1) * ratio
    frames = min(declared, len(values) // width) if width else 0
    if frames < 1:
        raise MotionFileError(sections.path, "c3d.no_points")
    rate = sections.number("ROTATION:RATE") or ratio * _frame_rate(sections)
    rows = values[: frames * width].reshape(frames, len(labels), ITEMS)
    named = (*sections.texts("POINT:UNITS"), "mm")[0]
    return build_segments(sections.path, labels, rows, rate, unit=unit, up=up, unit_in_file=named)


def _n_points(sections: Sections) -> int:
    used = sections.number("POINT:USED")
    count = sections.header.n_points if used is None or not math.isfinite(used) else int(used)
    if count <= 0:
        raise MotionFileError(sections.path, "c3d.no_points")
    check_points(sections.path, count)
    return count


def _choose_points(sections: Sections) -> tuple[IndexArray, tuple[str, ...]]:
    """Indices and names of the points that are labelled positions; of all points if none has a label."""
    count = _n_points(sections)
    labels = sections.texts("POINT:LABELS")[:count]
    labels += [""] * (count - len(labels))
    if not any(labels):
        return np.arange(count), tuple(f"point{number + 1}" for number in range(count))
    left_out = {name for group in _NOT_POSITIONS for name in sections.texts(f"POINT:{group}")}
    chosen = [number for number, label in enumerate(labels) if label and label[0] != "*" and label not in left_out]
    if not chosen:  # no marker has a name
        chosen = [number for number, label in enumerate(labels) if label not in left_out]
        labels = [f"point{number + 1}" for number in range(count)]
    if not chosen:
        raise MotionFileError(sections.path, "c3d.no_labels")
    names = tuple(labels[number] for number in chosen)
    if len(set(names)) < len(names):  # some programs cut labels to four letters; the descriptions are whole
        whole = dict(enumerate(sections.texts("POINT:DESCRIPTIONS")))
        described = tuple(whole.get(number, "").lstrip("* ") for number in chosen)
        names = described if len(set(described)) == len(described) and all(described) else names
    return np.array(chosen), names


def _frame_rate(sections: Sections) -> float:
    rate = sections.number("POINT:RATE")
    if rate is None or not rate > 0:
        rate = sections.header.frame_rate
    return _shorten(float(rate))


@lru_cache(maxsize=64)
def _shorten(rate: float) -> float:
    """29.97, not 29.969999313354492; most files of a folder have one rate."""
    return float(str(np.float32(rate)))


def _are_finite(*numbers: float) -> bool:
    return all(map(math.isfinite, numbers))


def _compare_header(sections: Sections, near: float = 0.005) -> tuple[Message, ...]:
    """Note words of the header that the parameters contradict: these count, as in other readers.

    ``near`` : share by which numbers may differ. Of scales below 0 only the sign counts.
    """
    header, notes = sections.header, []
    for key, word in (
        ("POINT:USED", header.n_points),
        ("POINT:RATE", header.frame_rate),
        ("POINT:SCALE", header.scale),
    ):
        said = sections.number(key)
        if not said or not _are_finite(said, word) or (key == "POINT:SCALE" and max(said, word) < 0):
            continue
        if abs(said - word) > near * abs(said):
            notes.append(Message("c3d.header", key=key, header=word, found=said))
    return tuple(notes)


def _choose_scale(
    sections: Sections,
    names: tuple[str, ...],
    positions: FloatArray,
    unit: float | None,
    notes: tuple[Message, ...],
) -> tuple[FloatArray, tuple[Message, ...]]:
    """Positions by the header's scale if by that of the parameters, and not by it, a body has no person's stature."""
    said, word = sections.number("POINT:SCALE") or 0.0, sections.header.scale
    if said <= 0 or word <= 0 or unit is None:
        return positions, notes
    whole = Trajectories(names, thin(positions, min(10, len(positions))), 1.0)
    bodies = [
        infer_reference_frame(whole.replace(positions=whole.positions * k), declared_unit=unit)
        for k in (1, word / said)
    ]
    odd = [any(note.code in ("units.odd_body", "units.other_unit") for note in body.notes) for body in bodies]
    if odd != [True, False]:
        return positions, notes
    kept = tuple(note for note in notes if note.values.get("key") != "POINT:SCALE")
    return positions * (word / said), (*kept, Message("c3d.scale_of_header", header=word, found=said))


def _up_axis(sections: Sections) -> str | None:
    texts = sections.texts("POINT:Y_SCREEN")
    axis = texts[0].lower().removeprefix("+") if texts else ""
    return axis if axis.removeprefix("-") in ("x", "y", "z") else None


def _read_positions(
    sections: Sections, data: bytes, chosen: IndexArray
) -> tuple[FloatArray, Clock, tuple[Message, ...]]:
    """Positions (T, K, 3) of the chosen points in file units, NaN where the residual is negative; time, and notes."""
    scale = sections.number("POINT:SCALE") or sections.header.scale
    if scale == 0 or not math.isfinite(scale):
        raise MotionFileError(sections.path, "c3d.scale", scale=scale)
    width = 4 * _n_points(sections)
    item_size = 4 if scale < 0 else 2
    start = _data_start(sections)
    items = max(0, len(data) - start) // item_size
    row, frames, declared, notes = _measure_rows(sections, width, items, BLOCK // item_size)
    end = start + frames * row * item_size
    block = data[start:end]
    if scale < 0:
        values = decode_floats(block, sections.processor)
    else:
        values = np.frombuffer(block, ">i2" if sections.big_endian else "<i2")
    rows = values.reshape(frames, row)
    if frames < declared:
        rows = rows[: 1 + max(np.flatnonzero(rows.any(axis=1)), default=0)]  # the rest is what fills the last block
    elif len(data) != end and (len(data) % BLOCK or data.count(0, end) != len(data) - end):
        notes += compare_bytes(
            -(-end // BLOCK) * BLOCK, len(data)
        )  # behind the frames are zeros, to the end of a block
    points = rows[:, :width].reshape(len(rows), -1, 4)[:, chosen]
    with np.errstate(invalid="ignore"):  # a damaged float may be a signalling NaN
        positions = points[..., :3].astype(np.float64)
        missing = points[..., 3] < 0
    if scale > 0:
        positions *= scale
    if missing.all() and np.count_nonzero(positions) > positions.size // 2:
        notes += (Message("c3d.residuals"),)  # a program that writes -1 for all points, also those seen
    else:
        positions[missing] = np.nan
    return positions, Clock(_frame_rate(sections), frames=declared), notes


def _measure_rows(sections: Sections, width: int, items: int, slack: int) -> tuple[int, int, int, tuple[Message, ...]]:
    """Items of a frame, frames in the file and declared, notes; by the size of the file if the header contradicts it.

    The data fill whole blocks, so the right row leaves less than a block over. Some programs write the number of analog
    channels in place of the number of their samples, which would misplace every frame but the first.
    """
    held, counts = {}, _analog_counts(sections)
    for count in counts:
        try:
            frames = _count_frames(sections, items // (width + count))
        except MotionFileError:
            continue
        held[count] = items - frames * (width + count)
    if not held:
        frames = items // (width + counts[0])
        declared = _declared_frames(sections)
        if not frames or not declared:
            _count_frames(sections, frames)  # raises the error
        return width + counts[0], frames, min(declared), ()
    fitting = [count for count in held if held[count] < slack]
    count = next(iter(held)) if not fitting else fitting[0]
    frames = _count_frames(sections, items // (width + count))
    notes = (Message("c3d.analog_count", header=counts[0], found=count),) if count != counts[0] else ()
    return width + count, frames, frames, notes


def _analog_counts(sections: Sections) -> list[int]:
    """Possible numbers of analog samples per frame, all channels together: of the header, then of parameters."""
    header = sections.header
    used, rate = sections.number("ANALOG:USED"), sections.number("ANALOG:RATE")
    points_rate = sections.number("POINT:RATE")
    counts = [header.n_analog]
    if used and rate and points_rate and _are_finite(used, rate, points_rate):
        samples = max(1, round(min(abs(rate / points_rate), 1e6)))
        # Some programs leave the header word empty.
        counts.insert(0 if header.n_analog == 0 else 1, int(used) * samples)
    counts.append(header.n_analog * header.n_samples)
    return list(dict.fromkeys(count for count in counts if count >= 0))


def _data_start(sections: Sections) -> int:
    block = float(sections.header.data_block)
    if block < 2:
        block = sections.number("POINT:DATA_START") or 0
    if not 2 <= block <= _FULL_COUNTER:
        raise MotionFileError(sections.path, "c3d.data_start", block=block)
    return (int(block) - 1) * BLOCK


def _count_frames(sections: Sections, held: int) -> int:
    """Number of frames: the largest declared one that the file holds."""
    declared = _declared_frames(sections)
    if not declared:
        raise MotionFileError(sections.path, "c3d.no_frames")
    fitting = [count for count in declared if count <= held]
    if not fitting:
        raise MotionFileError(sections.path, "c3d.frame_count", declared=min(declared), held=held)
    return max(fitting)


def _declared_frames(sections: Sections) -> list[int]:
    """Declared numbers of frames, above 0.

    Four places may declare it; programs keep them with different care, and 16 bits overflow.
    """
    header = sections.header
    declared = [header.last_frame - header.first_frame + 1]
    for key in ("POINT:FRAMES", "POINT:LONG_FRAMES"):
        number = sections.number(key)
        if number is not None and math.isfinite(number):
            declared.append(int(number))
    first, last = sections.numbers("TRIAL:ACTUAL_START_FIELD"), sections.numbers("TRIAL:ACTUAL_END_FIELD")
    ends = [*last[:2].tolist(), *first[:2].tolist()]
    if len(ends) == 4 and _are_finite(*ends):
        declared.append(int(ends[0] + 65_536 * ends[1] - ends[2] - 65_536 * ends[3]) + 1)
    if max(declared) > _FULL_COUNTER:
        declared = [count for count in declared if count > _FULL_COUNTER]  # the others overflowed
    return [count for count in declared if count > 0]
