"""Files with the windows of some takes, and sketches: few bytes that approximate the cost of a window as an answer.

A file holds the sketches and marks of all windows, by ascending length, so that a query reads one run of bytes; then
one row of leaf codes per window, in the same order; then the poses of the takes in blocks. Rows and blocks have
checksums. The sketches of a length have one that only ``check_portion`` compares, as it would make a scan longer by
half, and a flipped bit only moves one window among the candidates.
"""

from __future__ import annotations

import json
import os
import struct
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray, IndexArray, IntArray
from dousa.files.disk import create_alone
from dousa.library.search.kernels import encode_leaves, find_owners
from dousa.library.search.parts import order_table
from dousa.retrieval.takes.find import cost_windows
from dousa.retrieval.takes.windows import N_PARTS, N_SMALL, TakeWindows, WindowGrid, count_windows, hop_of

# Measured by python -m lab.benchmarks.find (lab/notes/takes.md): half as many marks are of no use, and 31
# coordinates find 0.02 to 0.09 more of the places where few windows are compared.
N_VALUES = 15
"""Coordinates of a sketch, measured as above."""

N_MARKS = 32
"""Trees whose leaves are in the marks, measured as above."""


@dataclass(frozen=True, slots=True, eq=False)
class Sketcher:
    """Makes sketches of windows: coordinates along principal axes, and the rest, the distance from these.

    Parameters
    ----------
    centre : (P,) mean of the mean poses of the parts of windows.
    axes : (P, R) for the coordinates.
    steps : (2,) of the coordinates and of the rests.
    """

    centre: FloatArray
    axes: FloatArray
    steps: FloatArray

    @classmethod
    def fit(cls, means: FloatArray, *, within: float = 0.9999) -> Sketcher:
        """Fit to the mean poses of the parts of some windows (N, 8, 27).

        Coordinates and rests beyond the quantile ``within`` are clipped; a lower one makes the steps finer.
        """
        flat = means.reshape(len(means), -1)
        centre = flat.mean(axis=0)
        whole = _expand((flat - centre).reshape(means.shape))
        basis = np.linalg.eigh(whole.T @ whole)[1][:, : -N_VALUES - 1 : -1]
        axes = _expand(np.eye(flat.shape[1]).reshape(-1, *means.shape[1:])) @ basis
        known = cls(centre, axes, np.ones(2))
        placed, rests = known.place(means)
        steps = np.quantile(np.abs(placed), within) / 127, np.quantile(rests, within) / 255
        return cls(centre, axes, np.maximum(steps, 1e-9))  # above zero

    def place(self, means: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Compute coordinates (N, R) and rests (N,) of mean poses of parts (N, 8, 27)."""
        apart = means.reshape(len(means), len(self.centre)) - self.centre
        placed = apart @ self.axes
        parts = apart.reshape(means.shape)
        changes = np.diff(parts, axis=1)
        squares = np.einsum("ijk,ijk->i", parts, parts) + np.einsum("ijk,ijk->i", changes, changes)
        squares *= len(parts) / max(parts.size + changes.size, 1)
        squares -= np.einsum("ij,ij->i", placed, placed)
        return placed, np.sqrt(np.maximum(squares, 0.0))

    def sketch(self, means: FloatArray) -> NDArray[np.int8]:
        """Return sketches (R + 1, N) for ``scanning.scan_sketches``."""
        placed, rests = self.place(means)
        sketches = np.empty((placed.shape[1] + 1, len(means)), np.int8)
        sketches[:-1] = np.clip(np.rint(placed.T / self.steps[0]), -127, 127)
        sketches[-1] = np.clip(np.rint(rests / self.steps[1]), 0, 255) - 128
        return sketches

    def ask(self, parts: FloatArray, *, cosine: float = 0.4) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return the coordinates (R,) of a query (8, 27), and the squared distance (256,) each rest adds, in steps.

        The ``cosine`` between the rests of a query and of similar windows was chosen on joined takes of UTD-MHAD.
        """
        placed, rests = self.place(parts[None])
        own, theirs = float(rests[0]), np.arange(256) * self.steps[1]
        added = (theirs - own) ** 2 + 2.0 * (1.0 - cosine) * theirs * own
        step = self.steps[0]
        return (placed[0] / step).astype(np.float32), (added / step**2).astype(np.float32)


def cost_marks(n_marks: int, *, usual: float = 0.25) -> FloatArray:
    """Return the cost (S + 1,) of the leaves by the number of equal marks.

    The share of all trees is estimated from the marks and one more tree with the ``usual`` share.
    """
    shares = (np.arange(n_marks + 1) + usual) / (n_marks + 1)
    costs: FloatArray = cost_windows(0.0, shares)
    return costs


def cut_windows(windows: TakeWindows, rows: slice | NDArray[np.intp]) -> FloatArray:
    """Return (N, 8, 27) mean poses of the parts of some windows of a take, as in ``compare_poses``."""
    starts, lengths = windows.starts[rows, None], (windows.stops - windows.starts)[rows, None]
    edges = starts + (np.arange(N_PARTS + 1) * lengths * 2 + N_PARTS) // (2 * N_PARTS)
    means: FloatArray = np.diff(windows.sums[edges], axis=1) / np.diff(edges, axis=1)[..., None]
    return means


def sketch_windows(sketcher: Sketcher, windows: TakeWindows, rows: slice) -> NDArray[np.int8]:
    """Return (R + 1, N) sketches of some windows of a take, computed in portions as it may be long."""
    parts = [sketcher.sketch(cut_windows(windows, some)) for some in _cut(rows, len(windows.starts))]
    return np.concatenate([np.empty((sketcher.axes.shape[1] + 1, 0), np.int8), *parts], axis=1)


def _cut(rows: slice, count: int, *, at_once: int = 16_384) -> Iterator[slice]:
    """Yield rows among ``count`` in portions: the mean poses of 16,384 windows take 28 MB, and more for a moment."""
    first, last, _ = rows.indices(count)
    for start in range(first, last, at_once):
        yield slice(start, min(start + at_once, last))


def _expand(means: FloatArray) -> FloatArray:
    """Return mean poses and their changes, scaled so that distances are those of ``compare_poses``."""
    count, n_parts, n_values = means.shape
    whole = np.concatenate([means, np.diff(means, axis=1)], axis=1).reshape(count, (2 * n_parts - 1) * n_values)
    scaled: FloatArray = whole / np.sqrt((2 * n_parts - 1) * n_values)
    return scaled


BLOCK = 64  # frames with one checksum, by definition of the files
_MAGIC = b"dousa windows 2\n"
_START = struct.Struct("<16sQQI")  # magic; place, length and checksum of the header at the end
_BLOCK_BYTES = BLOCK * N_SMALL * 2 + 4  # of float16 and the checksum, by definition of the files
_MISSING = np.iinfo(np.uint16).max  # the code of leaves without windows


class PortionGoneError(Exception):
    """A file cannot be read or is damaged."""

    def __init__(self, path: Path, *, damaged: bool = True) -> None:
        super().__init__(str(path))
        self.path, self.damaged = path, damaged


@dataclass(frozen=True, slots=True, eq=False)
class Portion:
    """The header of a file of T takes.

    Parameters
    ----------
    forest : identity of the forest (``side_file.name_forest``).
    ids, stamps : (T,) number of each take, and checksum of its content.
    n_frames : (T,) at ``TAKE_RATE``.
    durations : (T,) s.
    lengths : of windows, in frames.
    table, codes : (L,) leaves in ascending order, and the code of each within its tree.
    n_trees, code_type : of the rows.
    places : first bytes of the sketches of each length, of rows and of poses.
    sums : checksums of the sketches of each length.

    Attributes
    ----------
    ends : (lengths, T + 1) number of windows of a length in the takes before each.
    blocks : (T + 1,) number of blocks of poses before each.
    """

    path: Path
    forest: list[int]
    ids: IntArray
    stamps: IntArray
    n_frames: IntArray
    durations: NDArray[np.float64]
    lengths: IntArray
    sketcher: Sketcher
    table: NDArray[np.int32]
    codes: NDArray[np.uint16]
    n_trees: int
    code_type: np.dtype[Any]
    places: IntArray
    sums: tuple[int, ...]
    ends: IntArray = field(init=False, repr=False)
    blocks: IntArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "ends", _count_ends(self.lengths.tolist(), self.n_frames.tolist()))
        object.__setattr__(self, "blocks", np.concatenate([[0], np.cumsum(-(-self.n_frames // BLOCK))]))

    def encode(self, leaves: IntArray) -> NDArray[Any]:
        """Return (n_trees,) codes of leaves, with an unused code for leaves without windows."""
        rows = np.minimum(np.searchsorted(self.table, leaves), len(self.table) - 1)
        codes = np.where(self.table[rows] == leaves, self.codes[rows], np.iinfo(self.code_type).max)
        return codes.astype(self.code_type)

    def sketches(self, data: NDArray[np.int8], place: int) -> tuple[NDArray[np.int8], NDArray[np.uint8]]:
        """Return the sketches and marks of the windows of a length, from their bytes."""
        count = int(self.ends[place, -1])
        size = (N_VALUES + 1) * count
        marks = data[size:].view(np.uint8).reshape(count, min(N_MARKS, self.n_trees))
        return data[:size].reshape(N_VALUES + 1, count), marks

    def locate(self, place: int, windows: IndexArray) -> tuple[IntArray, IntArray, IntArray]:
        """Return takes, rows in these and first frames of windows (M,) of the ``place``-th length."""
        ends = self.ends[place]
        takes = np.searchsorted(ends, windows, side="right") - 1
        own = windows - ends[takes]
        before = np.diff(self.ends[:place], axis=1).sum(axis=0)
        length = int(self.lengths[place])
        starts = np.minimum(own * hop_of(length), self.n_frames[takes] - length)
        return takes, before[takes] + own, starts

    def read_rows(self, file: IO[bytes], places: IntArray, windows: IntArray) -> NDArray[Any]:
        """Read (M, n_trees) codes of windows, by the places of their lengths and their numbers within these."""
        first = np.concatenate([[0], np.cumsum(self.ends[:, -1])])
        begin, size = int(self.places[-2]), self.n_trees * self.code_type.itemsize + 4
        data = np.empty((len(windows), size), np.uint8)
        for row, number in enumerate((first[places] + windows).tolist()):
            file.seek(begin + number * size)
            own = memoryview(data[row])
            if file.readinto(own) != size or zlib.crc32(own[:-4]) != int.from_bytes(own[-4:], "little"):  # type: ignore[attr-defined]
                raise PortionGoneError(self.path)
        return np.ascontiguousarray(data[:, :-4]).view(self.code_type)

    def read_frames(self, file: IO[bytes], take: int, first: int, last: int) -> tuple[int, NDArray[np.float16]]:
        """Read the blocks with some frames of a take; return their first frame and their poses."""
        first, last = max(first, 0) // BLOCK, -(-min(last, int(self.n_frames[take])) // BLOCK)
        count = max(last - first, 0)
        file.seek(int(self.places[-1]) + (int(self.blocks[take]) + first) * _BLOCK_BYTES)
        data = memoryview(file.read(count * _BLOCK_BYTES))
        if len(data) != count * _BLOCK_BYTES:
            raise PortionGoneError(self.path)
        table = np.frombuffer(data, np.uint8).reshape(count, _BLOCK_BYTES)
        sums = np.ascontiguousarray(table[:, -4:]).view("<u4")[:, 0].tolist()
        ends = range(_BLOCK_BYTES, len(data) + 1, _BLOCK_BYTES)
        if sums != [zlib.crc32(data[end - _BLOCK_BYTES : end - 4]) for end in ends]:
            raise PortionGoneError(self.path)
        poses = np.ascontiguousarray(table[:, :-4]).view(np.float16).reshape(-1, N_SMALL)
        return first * BLOCK, poses[: int(self.n_frames[take]) - first * BLOCK]


def _count_ends(lengths: Sequence[int], n_frames: Sequence[int]) -> IntArray:
    counts = [[count_windows(length, count) for count in n_frames] for length in lengths]
    return np.pad(np.cumsum(np.array(counts, np.int64), axis=1), ((0, 0), (1, 0)))


def write_portion(
    path: Path,
    forest: list[int],
    takes: Sequence[tuple[int, int, TakeWindows]],
    n_leaves: int,
    *,
    n_fitted: int = 20_000,
) -> bool:
    """Write the windows of takes (number, stamp, windows) of one grid; OSError if the file cannot be written.

    Sketches are fitted to about ``n_fitted`` windows: more take longer. Return False if another program is writing the
    file, or a leaf is in two trees.
    """
    windows = [own for _, _, own in takes]
    lengths = windows[0].grid.lengths
    ends = _count_ends(lengths, [own.n_frames for own in windows])
    step = max(int(ends[:, -1].sum()) // n_fitted, 1)
    sketcher = Sketcher.fit(np.concatenate([cut_windows(own, slice(None, None, step)) for own in windows]))
    ranks = _rank_leaves(windows, n_leaves)
    if ranks is None:
        return False
    table = np.flatnonzero(ranks >= 0)
    code_type = np.dtype(np.uint8 if int(ranks.max(initial=0)) < 255 else "<u2")
    with create_alone(path) as file:
        if file is None:
            return False
        file.write(bytes(_START.size))
        places, sums = [], []
        for length in lengths:
            places.append(file.tell())
            checksum = 0
            for part in _sketch(sketcher, windows, length, ranks):
                file.write(part.data)
                checksum = zlib.crc32(part.data, checksum)
            sums.append(checksum)
        places.append(file.tell())
        for length in lengths:
            for one in windows:
                for some in _cut(_rows(one, length), len(one.starts)):
                    file.write(_pack_rows(one.leaves[some], ranks, code_type))
        places.append(file.tell())
        for one in windows:
            file.write(_pack_poses(one.poses))
        header = {
            "forest": forest,
            "ids": [number for number, _, _ in takes],
            "stamps": [stamp for _, stamp, _ in takes],
            "n_frames": [one.n_frames for one in windows],
            "durations": [one.duration for one in windows],
            "lengths": list(lengths),
            "n_trees": windows[0].leaves.shape[1],
            "code_type": code_type.str,
            "places": places,
            "sums": sums,
            "steps": sketcher.steps.tolist(),
            "n_leaves": len(table),
        }
        arrays = sketcher.centre, sketcher.axes, table.astype("<i4"), ranks[table].astype("<u2")
        _write_header(file, header, arrays)
    return True


def _write_header(file: IO[bytes], header: dict[str, Any], arrays: Sequence[NDArray[Any]]) -> None:
    """Write the header at the end, and its place at the start."""
    text = json.dumps(header).encode()
    whole = b"".join([len(text).to_bytes(8, "little"), text, *(np.ascontiguousarray(a).tobytes() for a in arrays)])
    place = file.tell()
    file.write(whole)
    file.seek(0)
    file.write(_START.pack(_MAGIC, place, len(whole), zlib.crc32(whole)))


def _rank_leaves(windows: Sequence[TakeWindows], n_leaves: int) -> IntArray | None:
    """Return the rank of every leaf in its tree, -1 for one without windows; None if damaged or too many."""
    owners = np.full(n_leaves, -1, np.int32)
    if not all(find_owners(one.leaves, owners) for one in windows):
        return None  # damaged
    ranks = order_table(owners, windows[0].leaves.shape[1])[2]
    ranks[owners < 0] = -1
    return ranks if int(ranks.max(initial=0)) < _MISSING else None


def _rows(windows: TakeWindows, length: int) -> slice:
    return windows.rows_within(WindowGrid((length,)))


def _sketch(
    sketcher: Sketcher, takes: Sequence[TakeWindows], length: int, ranks: IntArray
) -> Iterator[NDArray[np.int8 | np.uint8]]:
    """Yield the sketches of the windows of a length, and then their marks, take after take."""
    own = [sketch_windows(sketcher, one, _rows(one, length)) for one in takes]
    yield np.ascontiguousarray(np.concatenate(own, axis=1))
    for one in takes:
        for some in _cut(_rows(one, length), len(one.starts)):
            yield np.ascontiguousarray(ranks[one.leaves[some, :N_MARKS]].astype(np.uint8))


def _pack_rows(leaves: NDArray[Any], ranks: IntArray, code_type: np.dtype[Any]) -> bytes:
    codes = np.empty(leaves.shape, code_type)
    encode_leaves(leaves, ranks, codes)
    return _seal(codes.view(np.uint8).reshape(len(codes), leaves.shape[1] * code_type.itemsize))


def _pack_poses(poses: NDArray[np.float16]) -> bytes:
    whole = np.zeros((-(-len(poses) // BLOCK) * BLOCK, N_SMALL), np.float16)
    whole[: len(poses)] = poses
    return _seal(whole.view(np.uint8).reshape(-1, _BLOCK_BYTES - 4))


def _seal(rows: NDArray[np.uint8]) -> bytes:
    """Return rows of bytes, each followed by its checksum."""
    sealed = np.empty((len(rows), rows.shape[1] + 4), np.uint8)
    sealed[:, :-4] = rows
    sums = np.fromiter((zlib.crc32(row) for row in rows), "<u4", len(rows))
    sealed[:, -4:] = sums.view(np.uint8).reshape(-1, 4)
    return sealed.tobytes()


def read_portion(path: Path) -> Portion | None:
    """Read the header of a file; None if it is missing, damaged or of another dousa."""
    try:
        with open(path, "rb") as file:
            magic, place, length, checksum = _START.unpack(file.read(_START.size))
            if magic != _MAGIC or place + length > os.fstat(file.fileno()).st_size:
                return None
            file.seek(place)
            whole = file.read(length)
        if zlib.crc32(whole) != checksum:
            return None
        start = 8 + int.from_bytes(whole[:8], "little")
        header: dict[str, Any] = json.loads(whole[8:start])
        n_values, n_leaves = N_PARTS * N_SMALL, header["n_leaves"]
        arrays = []
        for kind, count in (("<f8", n_values), ("<f8", n_values * N_VALUES), ("<i4", n_leaves), ("<u2", n_leaves)):
            arrays.append(np.frombuffer(whole, kind, count, start))
            start += arrays[-1].nbytes
        sketcher = Sketcher(arrays[0], arrays[1].reshape(n_values, N_VALUES), np.array(header["steps"]))
        ids, stamps, n_frames = (np.array(header[name], np.int64) for name in ("ids", "stamps", "n_frames"))
        return Portion(
            path,
            header["forest"],
            ids,
            stamps,
            n_frames,
            np.array(header["durations"], np.float64),
            np.array(header["lengths"], np.int64),
            sketcher,
            arrays[2],
            arrays[3],
            header["n_trees"],
            np.dtype(header["code_type"]),
            np.array(header["places"], np.int64),
            tuple(map(int, header["sums"])),
        )
    except (OSError, ValueError, OverflowError, KeyError, TypeError, struct.error):
        return None


def check_portion(path: Path) -> bool:
    """Whether a file is undamaged, by all its checksums; also True if it is gone."""
    portion = read_portion(path)
    try:
        if portion is None:
            return not path.exists()
        with open(path, "rb") as file:
            return _is_whole(portion, file)
    except FileNotFoundError:
        return True
    except (OSError, ValueError, PortionGoneError):
        return False


def _is_whole(portion: Portion, file: IO[bytes], *, at_once: int = 1 << 20) -> bool:
    """Compare sketches, rows and poses with their checksums; PortionGoneError for damaged rows or poses.

    ``at_once`` bytes of sketches are read.
    """
    for place, expected in enumerate(portion.sums):
        checksum, left = 0, int(portion.places[place + 1] - portion.places[place])
        file.seek(int(portion.places[place]))
        while left and (data := file.read(min(left, at_once))):
            checksum, left = zlib.crc32(data, checksum), left - len(data)
        if left or checksum != expected:
            return False
    for place, count in enumerate(portion.ends[:, -1].tolist()):
        for some in _cut(slice(None), count):
            windows = np.arange(some.start, some.stop)
            portion.read_rows(file, np.full(len(windows), place), windows)
    for take, n_frames in enumerate(portion.n_frames.tolist()):
        for some in _cut(slice(None), n_frames):
            portion.read_frames(file, take, some.start, some.stop)
    return True
