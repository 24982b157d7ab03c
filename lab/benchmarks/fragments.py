"""In what form the arrays of clips are kept beside a database: rows of SQLite, plain fragments, Parquet or Lance.

    python -m lab.benchmarks.fragments [--clips N] [--folder FOLDER]

The clips are made as by ``search.py``, 60 frames each: 14 kB of positions, described by 17 kB of features.
Both are written in portions of 256 clips, each on the disk before the next begins, as ``dousa add`` writes them; then
read one clip at a time (of 300 in random order, opened once), and all in turn. Plain fragments are the blocks one after
the other, as they are or compressed by zlib; their places are kept in the rows of the database, as for all forms.
pyarrow and pylance are measured where they are installed, and nothing else needs them: 55 MB and 85 MB to download.
Prints clips a second to write (on the clock, and of processors), the milliseconds of one clip, clips a second to read
all, and the bytes compared with the arrays.
"""

from __future__ import annotations

import argparse
import os
import random
import sqlite3
import tempfile
import time
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, Protocol

from dousa.library import Library
from dousa.library.store.features import describe_clip, load_motions, pack_positions
from dousa.library.store.schema import pack
from dousa.retrieval import DEFAULT_FEATURE_SET
from lab.benchmarks.search import make_library

PORTION = 256
N_READ = 300


class Form(Protocol):
    """A way of keeping blocks of bytes, numbered from 0."""

    def write(self, portions: Iterator[Sequence[bytes]]) -> None:
        """Write portions, each on the disk before the next is asked for."""

    def open(self) -> Callable[[int], bytes]:
        """What reads one block."""

    def stream(self) -> Iterator[bytes]:
        """All blocks in turn."""


class Rows:
    """Rows of an SQLite file, as small libraries keep them."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / "rows.db"

    def write(self, portions: Iterator[Sequence[bytes]]) -> None:
        """One transaction for each portion."""
        with closing(sqlite3.connect(self.path, isolation_level=None)) as connection:
            connection.execute("PRAGMA journal_mode = WAL")
            connection.execute("PRAGMA synchronous = FULL")
            connection.execute("CREATE TABLE blocks (id INTEGER PRIMARY KEY, data BLOB NOT NULL)")
            number = 0
            for portion in portions:
                connection.execute("BEGIN IMMEDIATE")
                connection.executemany("INSERT INTO blocks VALUES (?, ?)", enumerate(portion, number))
                connection.execute("COMMIT")
                number += len(portion)

    def open(self) -> Callable[[int], bytes]:
        """One query for each."""
        connection = sqlite3.connect(self.path)
        return lambda n: bytes(connection.execute("SELECT data FROM blocks WHERE id = ?", (n,)).fetchone()[0])

    def stream(self) -> Iterator[bytes]:
        """One query for all."""
        with closing(sqlite3.connect(self.path)) as connection:
            yield from (row[0] for row in connection.execute("SELECT data FROM blocks ORDER BY id"))


class Plain:
    """Blocks one after the other in a file that only grows."""

    def __init__(self, folder: Path, level: int = 0) -> None:
        self.path, self.level = folder / f"plain{level}", level
        self.places: list[tuple[int, int]] = []

    def write(self, portions: Iterator[Sequence[bytes]]) -> None:
        """One write and one fsync for each portion."""
        with open(self.path, "ab", buffering=0) as file:
            for portion in portions:
                kept = [zlib.compress(block, self.level) if self.level else block for block in portion]
                end = file.tell()
                for block in kept:
                    self.places.append((end, len(block)))
                    end += len(block)
                file.write(b"".join(kept))
                os.fsync(file.fileno())

    def _unpack(self, data: bytes) -> bytes:
        return zlib.decompress(data) if self.level else data

    def open(self) -> Callable[[int], bytes]:
        """One pread for each."""
        descriptor = os.open(self.path, os.O_RDONLY)
        return lambda n: self._unpack(os.pread(descriptor, self.places[n][1], self.places[n][0]))

    def stream(self) -> Iterator[bytes]:
        """Through a buffer."""
        with open(self.path, "rb", buffering=1 << 20) as file:
            yield from (self._unpack(file.read(length)) for _, length in self.places)


class Parquet:
    """One file of pyarrow, a row group for each portion, with or without zstd; it can be read once it is closed."""

    def __init__(self, folder: Path, compression: str = "none") -> None:
        import pyarrow
        from pyarrow import parquet

        self.arrow, self.parquet = pyarrow, parquet
        self.path, self.compression = folder / f"{compression}.parquet", compression

    def write(self, portions: Iterator[Sequence[bytes]]) -> None:
        """One row group for each portion."""
        kind = self.arrow.schema([("data", self.arrow.binary())])
        options: dict[str, Any] = {"compression": self.compression, "use_dictionary": False}
        with (
            open(self.path, "wb") as file,
            self.parquet.ParquetWriter(file, kind, write_statistics=False, **options) as writer,
        ):
            for portion in portions:
                writer.write_table(self.arrow.table({"data": self.arrow.array(portion, self.arrow.binary())}, kind))
                file.flush()
                os.fsync(file.fileno())

    def open(self) -> Callable[[int], bytes]:
        """A row group has to be read for each."""
        file = self.parquet.ParquetFile(self.path)
        return lambda n: file.read_row_group(n // PORTION)["data"][n % PORTION].as_py()

    def stream(self) -> Iterator[bytes]:
        """Row groups in turn."""
        for batch in self.parquet.ParquetFile(self.path).iter_batches(PORTION):
            yield from (one.as_py() for one in batch["data"])


class Lance:
    """A data set of pylance, one version for each portion."""

    def __init__(self, folder: Path) -> None:
        import lance
        import pyarrow

        self.arrow, self.lance, self.path = pyarrow, lance, folder / "blocks.lance"

    def write(self, portions: Iterator[Sequence[bytes]]) -> None:
        """Appended portion by portion."""
        for portion in portions:
            table = self.arrow.table({"data": self.arrow.array(portion, self.arrow.large_binary())})
            self.lance.write_dataset(table, self.path, mode="append" if self.path.exists() else "create")

    def open(self) -> Callable[[int], bytes]:
        """``take`` of one row."""
        kept = self.lance.dataset(self.path)
        return lambda n: kept.take([n])["data"][0].as_py()

    def stream(self) -> Iterator[bytes]:
        """Batches in turn."""
        for batch in self.lance.dataset(self.path).to_batches(batch_size=PORTION):
            yield from (one.as_py() for one in batch["data"])


def make_blocks(folder: Path, n_clips: int) -> list[bytes]:
    """Positions and features of clips, each clip one block; the features are those of a few, disturbed."""
    path = folder / "clips.dousa"
    make_library(path, n_clips, min(70, n_clips))
    with Library.open(path) as library, library.database.reading() as connection:
        ids = [clip.id for clip in library.clips()]
        known = [describe_clip(one, DEFAULT_FEATURE_SET).features for one in load_motions(connection, ids[:200])]
        rounded = [pack(features, "<f4") for features in known]
        return [
            pack_positions(motion) + rounded[place % len(rounded)]
            for place, motion in enumerate(load_motions(connection, ids))
        ]


def measure(name: str, form: Form, blocks: Sequence[bytes], size: Callable[[], int]) -> None:
    """Write and read all blocks in one form, and print what it took."""
    portions = (blocks[start : start + PORTION] for start in range(0, len(blocks), PORTION))
    wall, processors = time.perf_counter(), time.process_time()
    form.write(portions)
    wall, processors = time.perf_counter() - wall, time.process_time() - processors
    read = form.open()
    chosen = random.Random(1).choices(range(len(blocks)), k=N_READ)
    start = time.perf_counter()
    found = [read(number) for number in chosen]
    one = (time.perf_counter() - start) / N_READ
    if found != [blocks[number] for number in chosen]:
        raise AssertionError(name)
    start = time.perf_counter()
    total = sum(len(block) for block in form.stream())
    stream = time.perf_counter() - start
    n = len(blocks)
    share = size() / sum(map(len, blocks))
    rates = f"{n / wall:9.0f} {n / processors:9.0f} {1000 * one:10.3f} {n / stream:10.0f}"
    print(f"{name:22} {rates} {share:8.3f}", flush=True)
    if total != sum(map(len, blocks)):
        raise AssertionError(name)


def main() -> None:
    """Measure all forms that are installed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--clips", type=int, default=10_000)
    parser.add_argument("--folder", help="where to write (default: that of temporary files)")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=options.folder) as name:
        folder = Path(name)
        blocks = make_blocks(folder, options.clips)
        mean = sum(map(len, blocks)) / len(blocks) / 1000
        print(f"{len(blocks)} clips of {mean:.1f} kB")
        print(f"{'form':22} {'written/s':>9} {'of proc.':>9} {'one, ms':>10} {'streamed/s':>10} {'bytes':>8}")
        forms: list[tuple[str, Callable[[], Form], Path]] = [
            ("rows of SQLite", lambda: Rows(folder), folder / "rows.db"),
            ("plain fragment", lambda: Plain(folder), folder / "plain0"),
            ("plain, zlib 1", lambda: Plain(folder, 1), folder / "plain1"),
            ("Parquet", lambda: Parquet(folder), folder / "none.parquet"),
            ("Parquet, zstd", lambda: Parquet(folder, "zstd"), folder / "zstd.parquet"),
            ("Lance", lambda: Lance(folder), folder / "blocks.lance"),
        ]
        for label, make, path in forms:
            try:
                form = make()
            except ImportError as error:
                print(f"{label:22} {error.name} is not installed")
                continue
            measure(label, form, blocks, lambda path=path: _size(path))


def _size(path: Path) -> int:
    files = path.rglob("*") if path.is_dir() else [path]
    return sum(file.stat().st_size for file in files if file.is_file())


if __name__ == "__main__":
    main()
