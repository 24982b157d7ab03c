"""The container of glTF: JSON with binary buffers, in one file (GLB) or in several (glTF); no size in it is trusted.

Reference: Khronos Group, glTF 2.0 specification, sections 3 and 4.4.
"""

from __future__ import annotations

import base64
import binascii
import json
import os
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa.errors import MotionFileError
from dousa.files.disk import read_bytes

MAGIC, JSON_CHUNK, BIN_CHUNK = b"glTF", 0x4E4F534A, 0x004E4942
FLOAT, USHORT, UINT = 5126, 5123, 5125
# Component types and what normalised integers are divided by: glTF 2.0 specification, section 3.6.2.
_TYPES: dict[int, tuple[str, float]] = {
    5120: ("<i1", 127.0), 5121: ("<u1", 255.0), 5122: ("<i2", 32767.0), 5123: ("<u2", 65535.0), 5125: ("<u4", 1.0),
    FLOAT: ("<f4", 1.0),
}  # fmt: skip
# Columns: glTF 2.0 specification, section 3.6.2.
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}


class GltfDocument:
    """A parsed file.

    Parameters
    ----------
    path : for messages.
    tree : the JSON object.
    buffers : bytes of each buffer.
    """

    def __init__(self, path: str | os.PathLike[str], tree: dict[str, Any], buffers: list[bytes]) -> None:
        self.path, self.tree, self.buffers = path, tree, buffers

    def fail(self, code: str, **values: Any) -> MotionFileError:
        """Return an error about this file."""
        return MotionFileError(self.path, code, **values)

    def items(self, name: str) -> list[dict[str, Any]]:
        """Return the list of objects of a name: nodes, skins ...; empty if there is none."""
        found = self.tree.get(name, [])
        if not isinstance(found, list) or len(found) > 100_000 or not all(isinstance(x, dict) for x in found):
            raise MotionFileError(self.path, "gltf.list", name=name)
        return found

    def item(self, name: str, index: object) -> dict[str, Any]:
        """Return one object of a list."""
        found = self.items(name)
        if isinstance(index, bool) or not isinstance(index, int) or not 0 <= index < len(found):
            raise MotionFileError(self.path, "gltf.index", name=name, found=repr(index)[:20], count=len(found))
        return found[index]

    def numbers(self, index: object) -> NDArray[Any]:
        """Return the numbers (n, width) of an accessor as float64; normalised integers are scaled."""
        accessor = self.item("accessors", index)
        kind = _TYPES.get(_whole(accessor.get("componentType")))
        width = _WIDTHS.get(str(accessor.get("type")))
        count = _whole(accessor.get("count"))
        if kind is None or width is None or count < 0 or "sparse" in accessor or "bufferView" not in accessor:
            raise MotionFileError(self.path, "gltf.accessor", number=index)
        view = self.item("bufferViews", accessor["bufferView"])
        number = _whole(view.get("buffer", 0))
        if not 0 <= number < len(self.buffers):
            raise MotionFileError(self.path, "gltf.index", name="buffers", found=str(number), count=len(self.buffers))
        dtype, scale = np.dtype(kind[0]), kind[1]
        row = width * dtype.itemsize
        start = _whole(view.get("byteOffset", 0)) + _whole(accessor.get("byteOffset", 0))
        stride = _whole(view.get("byteStride", row)) or row
        data = self.buffers[number]
        if start < 0 or stride < row or (count and start + stride * (count - 1) + row > len(data)):
            raise MotionFileError(self.path, "gltf.short", number=index)
        raw = (
            np.ndarray((count, width), dtype, data, start, (stride, dtype.itemsize)) if count else np.empty((0, width))
        )
        values: NDArray[Any] = raw.astype(np.float64)
        if accessor.get("normalized") and scale > 1:
            values = np.maximum(values / scale, -1.0)
        if not np.isfinite(values).all():
            raise MotionFileError(self.path, "gltf.finite", number=index)
        return values


def _whole(value: object) -> int:
    """A valid size as a whole number; -1 for anything else."""
    return value if isinstance(value, int) and not isinstance(value, bool) and abs(value) < 2**40 else -1


def load_document(path: str | os.PathLike[str]) -> GltfDocument:
    """Parse a GLB or glTF file and load its buffers; MotionFileError if damaged, or buffers lie outside its folder."""
    data = read_bytes(path)
    rest = b""
    if data[:4] == MAGIC:
        data, rest = _split_chunks(path, data)
    try:
        tree = json.loads(data.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise MotionFileError(path, "gltf.no_json", reason=str(error)[:80]) from error
    asset = tree.get("asset") if isinstance(tree, dict) else None
    if not isinstance(asset, dict):
        raise MotionFileError(path, "gltf.no_asset")
    if str(asset.get("version", "")).partition(".")[0] != "2":
        raise MotionFileError(path, "gltf.version", found=str(asset.get("version"))[:20])
    document = GltfDocument(path, tree, [])
    for number, buffer in enumerate(document.items("buffers")):
        uri = buffer.get("uri")
        document.buffers.append(rest if uri is None and number == 0 else _load_buffer(path, uri))
    return document


def _split_chunks(path: str | os.PathLike[str], data: bytes) -> tuple[bytes, bytes]:
    chunks: dict[int, bytes] = {}
    place = 12
    while place + 8 <= len(data):
        length, kind = struct.unpack_from("<II", data, place)
        if place + 8 + length > len(data):
            raise MotionFileError(path, "gltf.truncated")
        chunks.setdefault(kind, data[place + 8 : place + 8 + length])
        place += 8 + length
    if len(data) < 12 or struct.unpack_from("<I", data, 4)[0] != 2 or JSON_CHUNK not in chunks:
        raise MotionFileError(path, "gltf.version", found=str(data[4] if len(data) > 4 else ""))
    return chunks[JSON_CHUNK], chunks.get(BIN_CHUNK, b"")


def _load_buffer(path: str | os.PathLike[str], uri: object) -> bytes:
    if not isinstance(uri, str):
        raise MotionFileError(path, "gltf.buffer", found=repr(uri)[:40])
    if uri.startswith("data:"):
        try:
            return base64.b64decode(uri.partition(",")[2], validate=True)
        except (binascii.Error, ValueError) as error:
            raise MotionFileError(path, "gltf.buffer", found=uri[:20]) from error
    from urllib.parse import unquote

    name = unquote(uri)
    # Only what lies beside the file: a motion must not read the rest of the disk, or of the net.
    if ":" in name or "\\" in name or name.startswith("/") or ".." in name.split("/"):
        raise MotionFileError(path, "gltf.buffer", found=name[:40])
    return read_bytes(os.path.join(os.path.dirname(os.fspath(path)), name))


def pack_document(tree: dict[str, Any], binary: bytes) -> bytes:
    """Return the bytes of a GLB file with one buffer."""
    text = json.dumps(tree, separators=(",", ":"), ensure_ascii=False).encode()
    text += b" " * (-len(text) % 4)
    binary += b"\0" * (-len(binary) % 4)
    head = struct.pack("<4sIIII", MAGIC, 2, 12 + 8 + len(text) + 8 + len(binary), len(text), JSON_CHUNK)
    return b"".join((head, text, struct.pack("<II", len(binary), BIN_CHUNK), binary))
