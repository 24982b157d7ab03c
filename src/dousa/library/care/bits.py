"""Single flipped bits, found by the checksum of the original bytes.

Of random damage to a block of 61,440 bytes, one in nine thousand looks like a flipped bit; so this is a last resort.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import sqlalchemy as sa

from dousa.library.store.checksums import Seal

_LONGEST_TEXT = 4000  # bytes of a value; longer ones are too slow


def is_one_bit(first: int, second: int) -> bool:
    """Return whether two checksums differ in one bit, so that the checksum itself is damaged."""
    return (first ^ second).bit_count() == 1


def mend_bytes(data: bytes, difference: int) -> bytes | None:
    """Return the bytes before one bit flipped; None if no single bit explains the damage.

    ``difference`` is their CRC-32 exclusive-or the stored one.
    """
    # The checksum changes by a value that only depends on the bit's distance from the end.
    table = np.array([zlib.crc32(bytes([n])) ^ zlib.crc32(b"\0") for n in range(256)], np.uint32)
    effects = table[1 << np.arange(8)]
    for place in range(len(data) - 1, -1, -1):
        found = np.flatnonzero(effects == difference)
        if len(found):
            return data[:place] + bytes([data[place] ^ (1 << int(found[0]))]) + data[place + 1 :]
        effects = table[effects & 0xFF] ^ (effects >> 8)
    return None


def mend_values(seal: Seal, stored: Sequence[Any]) -> list[Any] | None:
    """Return the values of a row before one bit flipped; None if no single bit explains the damage.

    ``stored`` has the columns of the seal, texts as bytes, the checksum last.
    """
    columns = [*map(_kind_of, seal.covered)]
    *raw, checksum = stored
    values = [_read(kind, value) for kind, value in zip(columns, raw, strict=True)]
    broken = [place for place, value in enumerate(values) if value is _UNREADABLE]
    if len(broken) > 1 or checksum is None:
        return None
    if not broken and is_one_bit(seal.compute(values), checksum):
        return values
    for place in broken or range(len(values)):
        for candidate in _flip(columns[place], raw[place]):
            changed = [*values[:place], candidate, *values[place + 1 :]]
            if _fits(seal, changed, checksum):
                return changed
    return None


_UNREADABLE = object()


def _kind_of(column: sa.Column[Any]) -> type[Any]:
    kinds = (sa.LargeBinary, sa.Double, sa.Boolean, sa.Integer, sa.JSON, sa.Text, sa.String)
    return next(kind for kind in kinds if isinstance(column.type, kind))


def _read(kind: type[Any], value: Any) -> Any:
    try:
        if value is None or not isinstance(value, bytes):
            return value
        if kind is sa.JSON:
            return json.loads(value)
        return value if kind is sa.LargeBinary else value.decode()
    except ValueError:
        return _UNREADABLE


def _flip(kind: type[Any], value: Any) -> Iterator[Any]:
    if isinstance(value, bytes) and len(value) <= _LONGEST_TEXT:
        for place in range(len(value)):
            for bit in range(8):
                candidate = _read(kind, value[:place] + bytes([value[place] ^ (1 << bit)]) + value[place + 1 :])
                if candidate is not _UNREADABLE:
                    yield candidate
    elif isinstance(value, float):
        word = np.float64(value).view(np.uint64)
        yield from (float((word ^ np.uint64(1 << bit)).view(np.float64)) for bit in range(64))
    elif isinstance(value, int):
        yield from (value ^ (1 << bit) for bit in range(40))


def _fits(seal: Seal, values: Sequence[Any], checksum: int) -> bool:
    try:
        return seal.compute(values) == checksum
    except (TypeError, ValueError):
        return False
