"""What a binary FBX file declares against its bytes: ends of records, lengths of arrays, numbers of objects, links.

The programs that convert a file go on over much of this: a record whose name was damaged is left out without a word.
Reference: Blender Foundation, "FBX binary file format specification" (code.blender.org, 2013).
"""

from __future__ import annotations

import os
import struct
import zlib
from collections import Counter
from collections.abc import Iterator

import numpy as np

from dousa.errors import MotionFileError
from dousa.formats.guard.sizes import check_memory
from dousa.messages import Message

MAGIC = b"Kaydara FBX Binary  \0\x1a\0"
# Kinds whose objects all have the properties of one template (cameras and bones share a kind, but no template).
_PLAIN = ("Model", "AnimationCurveNode")
_PARTS = ("AnimationCurve KeyTime", "AnimationCurve KeyValueFloat", *(f"{kind} Properties70" for kind in _PLAIN))
_DAY = 24 * 3600 * 46_186_158_000.0  # of the ticks of FBX, by the definition of its SDK
_END = bytes.fromhex("f85a8c6adef5d97eece90ce3758f290b")
_VERSIONS = (6100, 7999)  # those of which programs write binary files, times 1000, by the specification
# Bytes of a number, and of an item of an array, by the letter of their type, by the specification.
_NUMBERS = dict(zip(b"YCIFDLB", (2, 1, 4, 4, 8, 8, 1), strict=True))
_ITEMS = dict(zip(b"fdlibc", (4, 8, 8, 4, 1, 1), strict=True))  # by the specification


def check_fbx(path: str | os.PathLike[str], data: bytes) -> tuple[Message, ...]:
    """Note objects that are not as many as declared, and links to what is not there.

    Files of text and of unknown versions are left to the programs.

    Raises
    ------
    MotionFileError : records or arrays that end elsewhere than declared.
    """
    version = int.from_bytes(data[len(MAGIC) : len(MAGIC) + 4], "little")
    if not data.startswith(MAGIC) or not _VERSIONS[0] <= version <= _VERSIONS[1]:
        return ()
    declared, found, parts = (Counter[str]() for _ in range(3))
    kinds: dict[bytes, str] = {bytes(8): ""}
    linked: set[bytes] = set()
    animated: set[str] = set()
    usual: dict[str, set[str]] = {}
    strange: set[str] = set()
    section = kind = ""
    for depth, name, values in _walk(path, data, wide=version >= 7500):
        words = [value[:100].decode("latin-1") for value in values[:4]]
        if depth == 0:
            section = kind = name
        elif section == "Definitions" and name == "ObjectType" and words:
            kind = words[0]
        elif section == "Definitions" and name == "Count" and depth == 2 and values:
            declared[kind] = int.from_bytes(values[0], "little")
        elif section == "Objects" and depth == 1 and values:
            kind = kinds[values[0]] = name
            found[kind] += 1
        elif section == "Objects" and depth == 2:
            parts[f"{kind} {name}"] += 1
            _check_times(path, values[0] if name == "KeyTime" and values else b"")
        elif name == "P" and len(words) == 4 and _is_strange(kind, words, usual, section == "Definitions"):
            strange.add(words[0])
        elif section == "Connections" and name == "C" and len(values) > 2:
            linked.update(values[1:3])
            animated.update(words[3:] if kinds.get(values[1]) == "AnimationCurveNode" else ())
    notes = [*_compare(declared, found, parts)]
    if lost := linked - kinds.keys():
        notes.append(Message("exchange.fbx_links", n=len(lost)))
    if usual.get("Model") and (strange := strange | (animated - usual["Model"])):
        notes.append(Message("exchange.fbx_property", n=len(strange), name=min(strange)[:40]))
    if not data.rstrip(b"\n").endswith(_END):
        notes.append(Message("exchange.fbx_end"))
    return tuple(notes)


def _is_strange(kind: str, words: list[str], usual: dict[str, set[str]], is_shared: bool) -> bool:
    """Whether a property of an object is none of its kind; what all have and what users add goes to the usual ones."""
    names = usual.setdefault(kind, set())
    if is_shared or "U" in words[3]:
        names.add(words[0])
        return False
    return kind in _PLAIN and bool(names) and words[0].partition("|")[0] not in names  # d|X is a part of d


def _check_times(path: str | os.PathLike[str], data: bytes) -> None:
    """MotionFileError for times that fall, or over a day, in which converters would make keys without end."""
    times = np.frombuffer(data[: len(data) // 8 * 8], "<i8").astype(np.float64)
    if not (np.diff(times) >= 0).all() or (len(times) and not times[-1] - times[0] < _DAY):
        raise MotionFileError(path, "exchange.fbx_times")


def _compare(declared: Counter[str], found: Counter[str], parts: Counter[str]) -> Iterator[Message]:
    """Notes on numbers of objects and of their parts that are not as declared."""
    # Some programs declare numbers at will; of a damaged file all but one agree.
    odd = [kind for kind in declared if declared[kind] != found[kind] and kind != "GlobalSettings"]
    pairs = [(kind, declared[kind], found[kind]) for kind in odd[:1] if len(odd) == 1]
    pairs += [(part, found[part.partition(" ")[0]], parts[part]) for part in _PARTS]
    for kind, expected, there in pairs:
        if expected != there:
            yield Message("exchange.fbx_count", kind=kind[:40], declared=expected, found=there)


def _walk(path: str | os.PathLike[str], data: bytes, *, wide: bool) -> Iterator[tuple[int, str, list[bytes]]]:
    """Depth, name and values of each record, those above before those within."""
    head = struct.Struct("<QQQB" if wide else "<IIIB")
    place, ends = len(MAGIC) + 4, [len(data)]
    while ends:
        if place + head.size > ends[-1]:
            raise MotionFileError(path, "exchange.fbx_record", place=place)
        end, count, length, letters = head.unpack_from(data, place)
        first = place + head.size + letters
        if not end:  # a record of zeros ends a list
            place += head.size
            if (count, length, letters) != (0, 0, 0) or (len(ends) > 1 and place != ends[-1]):
                raise MotionFileError(path, "exchange.fbx_record", place=place)
            ends.pop()
            continue
        stop, name = first + length, data[place + head.size : first]
        if not (stop <= end <= ends[-1] and name.isascii() and name.decode("ascii").isprintable()):
            raise MotionFileError(path, "exchange.fbx_record", place=place)
        values = _read_values(path, data[first:stop], count)
        if values is None:
            raise MotionFileError(path, "exchange.fbx_record", place=place)
        yield len(ends) - 1, name.decode("ascii"), values
        place = stop
        if stop < end:
            ends.append(end)
        while len(ends) > 1 and place == ends[-1]:  # a list may lack its end
            ends.pop()


def _read_values(path: str | os.PathLike[str], data: bytes, count: int) -> list[bytes] | None:
    """The bytes of so many values, which are all that is there; None if they are not."""
    values: list[bytes] = []
    place = unpacked = 0
    try:
        for _ in range(count):
            kind, place = data[place], place + 1
            size, needed, squeezed = _NUMBERS.get(kind, -1), -1, 0
            if kind in b"SR":
                (size,) = struct.unpack_from("<I", data, place)
                place += 4
            elif kind in _ITEMS:
                needed, squeezed, size = struct.unpack_from("<III", data, place)
                needed, place = needed * _ITEMS[kind], place + 12
            held = data[place : place + size]
            if size < 0 or len(held) != size:
                return None
            place += size
            if squeezed:
                unpacked += needed
                check_memory(path, unpacked, len(data))
                unpacker = zlib.decompressobj()
                held = unpacker.decompress(held, needed + 1)
                if not unpacker.eof:
                    return None
            if len(held) != needed >= 0:
                return None
            values.append(held)
    except (IndexError, struct.error, zlib.error):  # what is squeezed has a checksum
        return None
    return values if place == len(data) else None
