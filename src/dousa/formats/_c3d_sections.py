"""The header and the parameter section of a C3D file.

Reference: Motion Lab Systems, "The C3D File Format User Guide" (2021). Every size and pointer of the file is
checked against the bytes at hand before it is followed.
"""

from __future__ import annotations

import os
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dousa.errors import MotionFileError

__all__ = ["BLOCK", "Header", "Parameter", "Sections", "parse_sections"]

BLOCK = 512
_MAGIC = 0x50
_MOST_PARAMETERS = 20_000  # 127 groups of real files hold some hundreds
_INTEL, _DEC, _MIPS = 84, 85, 86


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter: its raw data and how to take them.

    Parameters
    ----------
    item_size : bytes per item, -1 for text.
    shape : Fortran order, text length first.
    data : raw bytes; None if the file's sizes point outside the section.
    processor : 84 Intel, 85 DEC, 86 MIPS.
    """

    item_size: int
    shape: tuple[int, ...]
    data: bytes | None
    processor: int

    def texts(self) -> list[str]:
        """The texts, without the blanks and zero bytes that pad them."""
        data = self.data or b""
        length = self.shape[0] if len(self.shape) > 1 else len(data)
        if length == 0:
            return []
        pieces = [data[start : start + length] for start in range(0, len(data), length)]
        return [_decode_text(piece) for piece in pieces]

    def numbers(self) -> NDArray[np.float64]:
        """All values in file order; 16-bit integers unsigned, as counts may exceed 32,767."""
        data = self.data or b""
        if self.item_size == 4:
            with np.errstate(invalid="ignore"):  # a signalling NaN
                return decode_floats(data, self.processor).astype(np.float64)
        if self.item_size == 2:
            return np.frombuffer(data, ">u2" if self.processor == _MIPS else "<u2").astype(np.float64)
        return np.frombuffer(data, np.uint8).astype(np.float64)


@dataclass(frozen=True, slots=True)
class Header:
    """The numbers of the first block that matter here; word numbers as in the user guide."""

    n_points: int
    n_analog: int
    """Analog samples per frame, all channels together."""
    first_frame: int
    last_frame: int
    scale: float
    data_block: int
    frame_rate: float


@dataclass(frozen=True, slots=True)
class Sections:
    """What precedes the data: header and parameters by ``"GROUP:NAME"``, upper case."""

    path: str
    header: Header
    parameters: dict[str, Parameter]
    processor: int

    def number(self, key: str) -> float | None:
        """First value of a numeric parameter, None if there is none."""
        values = self.numbers(key)
        return float(values[0]) if len(values) else None

    def numbers(self, key: str) -> NDArray[np.float64]:
        """All values of a numeric parameter."""
        return np.zeros(0) if key not in self.parameters else self._checked(key).numbers()

    def texts(self, key: str) -> list[str]:
        """The texts of a parameter, together with those of its continuations NAME2, NAME3 ..."""
        texts: list[str] = []
        number, name = 1, key
        while name in self.parameters:
            texts += self._checked(name).texts()
            number += 1
            name = f"{key}{number}"
        return texts

    def _checked(self, key: str) -> Parameter:
        parameter = self.parameters[key]
        if parameter.data is None:
            raise MotionFileError(
                self.path, f"parameter {key} claims more bytes than its section has; the file is damaged"
            )
        return parameter

    @property
    def big_endian(self) -> bool:
        """Whether the high byte comes first."""
        return self.processor == _MIPS


def _decode_text(data: bytes) -> str:
    data = data.split(b"\0", 1)[0].strip()
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def decode_floats(data: bytes, processor: int) -> NDArray[np.float32]:
    """32-bit floats of any of the three processors as native ones; DEC's exponents are two higher."""
    usable = len(data) // 4 * 4
    with np.errstate(invalid="ignore"):  # damaged bytes may be a signalling NaN
        if processor == _DEC:
            words = np.ascontiguousarray(np.frombuffer(data[:usable], "<u2").reshape(-1, 2)[:, ::-1])
            return (words.view("<f4")[:, 0] / np.float32(4)).astype(np.float32)
        return np.frombuffer(data[:usable], ">f4" if processor == _MIPS else "<f4").astype(np.float32)


def parse_sections(path: str | os.PathLike[str], data: bytes) -> Sections:
    """Header and parameters of a whole file.

    Raises
    ------
    MotionFileError : not a C3D file, cut off, or a parameter section that points outside.
    """
    if len(data) < 2 or data[1] != _MAGIC:
        raise MotionFileError(path, "not a C3D file: the second byte must be 0x50; check the name")
    if len(data) < 2 * BLOCK:
        raise MotionFileError(
            path, f"expected a header of 1,024 bytes or more, got {len(data)}; is it truncated?"
        )
    start = (max(data[0], 2) - 1) * BLOCK  # a pointer of 0 or 1 means the usual place
    if start + 4 > len(data):
        raise MotionFileError(path, "the parameter section lies beyond the end; is the file truncated?")
    processor = data[start + 3]
    if processor not in (_INTEL, _DEC, _MIPS):
        raise MotionFileError(
            path, f"expected processor type 84, 85 or 86, got {processor}; the file is damaged"
        )
    header = _parse_header(data, processor)
    # The section's own block count is one byte, too small for the largest files: the data section ends it.
    data_start = (header.data_block - 1) * BLOCK
    end = min(data_start, len(data)) if data_start > start else len(data)
    return Sections(
        os.fspath(path), header, _parse_parameters(path, data[start + 4 : end], processor), processor
    )


def _parse_header(data: bytes, processor: int) -> Header:
    words = np.frombuffer(data[:BLOCK], ">u2" if processor == _MIPS else "<u2")
    scale, rate = decode_floats(data[12:16], processor)[0], decode_floats(data[20:24], processor)[0]
    return Header(
        n_points=int(words[1]),
        n_analog=int(words[2]),
        first_frame=int(words[3]),
        last_frame=int(words[4]),
        scale=float(scale),
        data_block=int(words[8]),
        frame_rate=float(rate),
    )


def _parse_parameters(path: str | os.PathLike[str], section: bytes, processor: int) -> dict[str, Parameter]:
    groups: dict[int, str] = {}
    found: list[tuple[int, str, Parameter]] = []
    order = "big" if processor == _MIPS else "little"
    place = 0
    while place + 2 <= len(section):
        # A negative length marks a locked entry, a negative number a group.
        length = abs(int.from_bytes(section[place : place + 1], signed=True))
        number = int.from_bytes(section[place + 1 : place + 2], signed=True)
        if length == 0 or number == 0:
            break
        name = _decode_text(section[place + 2 : place + 2 + length]).upper()
        link = place + 2 + length
        offset = int.from_bytes(section[link : link + 2], order)  # type: ignore[arg-type]
        if number < 0:
            groups.setdefault(-number, name)
        else:
            stop = link + offset if offset else len(section)
            found.append((number, name, _parse_parameter(section[link + 2 : stop], processor)))
        if offset == 0:
            break
        if len(found) > _MOST_PARAMETERS:
            raise MotionFileError(path, f"more than {_MOST_PARAMETERS} parameters; the file is damaged")
        if offset < 2 or link + offset > len(section):
            raise MotionFileError(path, f"parameter {name!r} points outside its section; the file is damaged")
        place = link + offset
    parameters: dict[str, Parameter] = {}
    for number, name, parameter in found:
        parameters.setdefault(f"{groups.get(number, number)}:{name}", parameter)
    return parameters


def _parse_parameter(entry: bytes, processor: int) -> Parameter:
    """A parameter from the bytes after its link, which may hold more than it."""
    if len(entry) < 2:
        return Parameter(1, (), None, processor)
    item_size = int.from_bytes(entry[:1], signed=True)
    n_axes = entry[1]
    shape = tuple(entry[2 : 2 + n_axes])
    size = abs(item_size)
    for length in shape:
        size *= length
    start = 2 + n_axes
    whole = len(shape) == n_axes and start + size <= len(entry) and item_size in (-1, 1, 2, 4)
    return Parameter(item_size, shape, entry[start : start + size] if whole else None, processor)
