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
from dousa.formats.guard.sizes import compare_bytes
from dousa.messages import Message

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
    buffers : bytes of each buffer, as many as it declares; None of one that only an extension can read.
    notes : for the user, on declarations that the bytes contradict.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        tree: dict[str, Any],
        buffers: list[bytes | None],
        notes: tuple[Message, ...] = (),
    ) -> None:
        self.path, self.tree, self.buffers, self.notes = path, tree, buffers, notes

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
        self._check_extensions(accessor)
        view, data = self._view(accessor["bufferView"], index)
        dtype, scale = np.dtype(kind[0]), kind[1]
        row = width * dtype.itemsize
        start, stride = _whole(accessor.get("byteOffset", 0)), _whole(view.get("byteStride", row)) or row
        if start < 0 or start % dtype.itemsize or stride < row:
            raise MotionFileError(self.path, "gltf.short", number=index)
        if count and start + stride * (count - 1) + row > len(data):
            raise MotionFileError(self.path, "gltf.short", number=index)
        raw = (
            np.ndarray((count, width), dtype, data, start, (stride, dtype.itemsize)) if count else np.empty((0, width))
        )
        values: NDArray[Any] = raw.astype(np.float64)
        if accessor.get("normalized") and scale > 1:
            values = np.maximum(values / scale, -1.0)
        if not np.isfinite(values).all():
            raise MotionFileError(self.path, "gltf.finite", number=index)
        self._compare_limits(accessor, index, raw.astype(np.float64))
        return values

    def _view(self, index: object, accessor: object) -> tuple[dict[str, Any], bytes]:
        """A view and its bytes, which must lie in its buffer."""
        view = self.item("bufferViews", index)
        self._check_extensions(view)
        number = _whole(view.get("buffer", 0))
        if not 0 <= number < len(self.buffers):
            raise MotionFileError(self.path, "gltf.index", name="buffers", found=str(number), count=len(self.buffers))
        data = self.buffers[number]
        if data is None:
            self._check_extensions(self.items("buffers")[number], fail=True)
        start, size = _whole(view.get("byteOffset", 0)), _whole(view.get("byteLength"))
        if data is None or start < 0 or size < 0 or start + size > len(data):
            raise MotionFileError(self.path, "gltf.short", number=accessor)
        return view, data[start : start + size]

    def _check_extensions(self, item: dict[str, Any], *, fail: bool = False) -> None:
        """Raise MotionFileError for an extension that changes what the bytes mean, if the file requires it."""
        extensions, required = item.get("extensions"), self.tree.get("extensionsRequired")
        for name in extensions if isinstance(extensions, dict) else ():
            if fail or (isinstance(required, list) and name in required):
                raise MotionFileError(self.path, "gltf.extension", name=str(name)[:40])

    def _compare_limits(
        self, accessor: dict[str, Any], index: object, values: NDArray[Any], near: float = 1e-4
    ) -> None:
        """Note values that are not those between the ``min`` and ``max`` that the file declares.

        ``near`` : share of the greatest value by which programs round them.
        """
        limits = [np.array(accessor.get(key, ()), np.float64) for key in ("min", "max")]
        if any(limit.shape != values.shape[1:] for limit in limits) or not len(values):
            return
        off = max(np.abs(limits[0] - values.min(axis=0)).max(), np.abs(limits[1] - values.max(axis=0)).max())
        if not off <= near * max(1.0, float(np.abs(values).max())):
            note = Message("gltf.limits", number=index)
            self.notes += () if note in self.notes else (note,)


def _whole(value: object) -> int:
    """A valid size as a whole number; -1 for anything else."""
    return value if isinstance(value, int) and not isinstance(value, bool) and abs(value) < 2**40 else -1


def load_document(path: str | os.PathLike[str]) -> GltfDocument:
    """Parse a GLB or glTF file and load its buffers; MotionFileError if damaged, or buffers lie outside its folder."""
    data = read_bytes(path)
    rest: bytes | None = None
    notes: tuple[Message, ...] = ()
    if data[:4] == MAGIC:
        data, rest, notes = _split_chunks(path, data)
    try:
        tree = json.loads(data.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise MotionFileError(path, "gltf.no_json", reason=str(error)[:80]) from error
    asset = tree.get("asset") if isinstance(tree, dict) else None
    if not isinstance(asset, dict):
        raise MotionFileError(path, "gltf.no_asset")
    if str(asset.get("version", "")).partition(".")[0] != "2":
        raise MotionFileError(path, "gltf.version", found=str(asset.get("version"))[:20])
    document = GltfDocument(path, tree, [], notes)
    for number, buffer in enumerate(document.items("buffers")):
        uri, found = buffer.get("uri"), rest if number == 0 else None
        if found is None and (uri is not None or "extensions" not in buffer):
            found = _load_buffer(path, uri)
        size = _whole(buffer.get("byteLength"))
        if found is not None and not 0 <= size <= len(found):
            raise MotionFileError(path, "gltf.buffer_size", number=number, declared=size, found=len(found))
        if found is not None and len(found) - size > (_PADDING if found is rest else 0):
            document.notes += compare_bytes(size, len(found))
        document.buffers.append(None if found is None else found[:size])
    return document


# Bytes, less than which may fill a chunk: glTF 2.0 specification, section 4.4.3.
_PADDING = 3


def _split_chunks(path: str | os.PathLike[str], data: bytes) -> tuple[bytes, bytes | None, tuple[Message, ...]]:
    """JSON, binary and notes: the chunks fill the file to its end, which is where its header says."""
    chunks: dict[int, bytes] = {}
    place = 12
    if len(data) < 12 or struct.unpack_from("<I", data, 4)[0] != 2:
        raise MotionFileError(path, "gltf.version", found=str(data[4] if len(data) > 4 else ""))
    declared = struct.unpack_from("<I", data, 8)[0]
    while place + 8 <= len(data) and place != declared:
        length, kind = struct.unpack_from("<II", data, place)
        if place + 8 + length > len(data):
            raise MotionFileError(path, "gltf.truncated")
        chunks.setdefault(kind, data[place + 8 : place + 8 + length])
        place += 8 + length
    if data[place:].strip(b"\0 \r\n"):  # not only padding
        raise MotionFileError(path, "gltf.surplus", n=len(data) - place)
    if JSON_CHUNK not in chunks:
        raise MotionFileError(path, "gltf.no_json_chunk")
    return chunks[JSON_CHUNK], chunks.get(BIN_CHUNK, b""), compare_bytes(declared, len(data))


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
