"""Random damage to files that are small: what it is, and how a reader takes it."""

import faulthandler
import io
import itertools
import os
import random
import re
import struct
import time
import tracemalloc
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from dousa.errors import DousaError
from patience import PATIENCE

SECONDS = float(os.environ.get("DOUSA_FUZZ_SECONDS", "1"))
MOST_MEMORY = 1 << 30
CASE_SECONDS = 5  # processor seconds for one damaged file of a few kB; a reader that needs longer hangs


def count_tries(whole: int) -> int:
    """So many tries where there is time for all of them, as in `make fuzz`; else a sixth."""
    return whole if SECONDS >= 60 else max(1, whole // 6)


NUMBER = re.compile(rb"-?\d+(\.\d*)?([eE][+-]?\d+)?")
NASTY_TEXTS = [b"1000000000", b"-1", b"0", b"1e999", b"-1e308", b"nan", b"inf", b"9" * 400, b"1e", b"0x10", b"", b"{"]
NASTY_BYTES = [
    bytes(4),
    b"\xff" * 4,
    b"\x00\x80",
    b"\xff\x7f",
    struct.pack("<f", np.inf),
    struct.pack("<f", np.nan),
    struct.pack("<f", 3e38),
    struct.pack("<f", 1e-40),
    struct.pack("<d", 1e300),
    struct.pack("<I", 10**9),
    b"\n",
    b"\t",
    b"\0",
    b"{" * 3000,
]


def flip(rng, data):
    for _ in range(rng.choice((1, 1, 2, 5, 20))):
        data[rng.randrange(len(data))] = rng.randrange(256)


def cut(rng, data):
    del data[rng.randrange(len(data)) :]


def remove(rng, data):
    start = rng.randrange(len(data))
    del data[start : start + rng.choice((1, 2, 10, 100))]


def repeat(rng, data):
    start, target = rng.randrange(len(data)), rng.randrange(len(data))
    chunk = data[start : start + rng.choice((1, 4, 50, 500))]
    data[target:target] = chunk * rng.choice((1, 1, 2, 30))


def overwrite(rng, data):
    start, new = rng.randrange(len(data)), rng.choice(NASTY_BYTES)
    data[start : start + len(new)] = new


def insert(rng, data):
    start = rng.randrange(len(data))
    data[start:start] = rng.choice(NASTY_BYTES + NASTY_TEXTS)


def swap_number(rng, data):
    numbers = list(NUMBER.finditer(bytes(data[:20_000])))
    if numbers:
        # The first numbers of a file are its header.
        chosen = rng.choice(numbers[: rng.choice((10, len(numbers)))])
        data[chosen.start() : chosen.end()] = rng.choice(NASTY_TEXTS)


def swap_lines(rng, data):
    lines = bytes(data).split(b"\n")
    a, b = rng.randrange(len(lines)), rng.randrange(len(lines))
    lines[a], lines[b] = lines[b], lines[a]
    data[:] = b"\n".join(lines)


DAMAGES = (flip, flip, cut, remove, repeat, overwrite, overwrite, insert, swap_number, swap_number, swap_lines)


def damage_array(rng, data):
    """One array of an npz, under a right checksum; else zipfile would stop nearly every case."""
    with zipfile.ZipFile(io.BytesIO(data)) as source:
        members = {name: bytearray(source.read(name)) for name in source.namelist()}
    rng.choice(DAMAGES)(rng, members[rng.choice(sorted(members))])
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as target:
        for name, member in members.items():
            target.writestr(name, bytes(member))
    data[:] = packed.getvalue()


def damage(rng: random.Random, content: bytes, *, zipped: bool = False) -> bytes:
    """A file after one to three damages; of an archive mostly of what is inside."""
    data = bytearray(content)
    if zipped and rng.random() < 0.7:
        damage_array(rng, data)
    else:
        for _ in range(rng.choice((1, 1, 1, 2, 3))):
            if data:
                rng.choice(DAMAGES)(rng, data)
    return bytes(data)


def outcome_of(read: Callable[[], object], seconds: float = CASE_SECONDS) -> str:
    """What became of a reading, "read" or "refused"; an AssertionError for a hang or a wordless error."""
    # Inside a kernel no signal is served: then the whole run ends with a traceback that shows the case.
    faulthandler.dump_traceback_later(PATIENCE, exit=True)
    start = time.process_time()
    try:
        read()
        outcome = "read"
    except DousaError as error:
        assert str(error), "an error without words"
        outcome = "refused"
    finally:
        faulthandler.cancel_dump_traceback_later()
    assert time.process_time() - start < seconds, "took too long"
    return outcome


def traced_outcome_of(read: Callable[[], object], seconds: float = CASE_SECONDS, most: int = MOST_MEMORY) -> str:
    """As ``outcome_of``, counting memory too, which is slow."""
    tracemalloc.start()
    try:
        outcome = outcome_of(read, seconds)
        assert tracemalloc.get_traced_memory()[1] < most, "took too much memory"
        return outcome
    finally:
        tracemalloc.stop()


def fuzz(
    folder: Path,
    files: Sequence[Path],
    read: Callable[[Path], object],
    *,
    share: float = 1.0,
    seconds: float = CASE_SECONDS,
) -> None:
    """Damage files until the time is over; an outcome that should not be names its case.

    Parameters
    ----------
    folder : where damaged ones are written.
    files : sound ones.
    read : reads all of one.
    share : of the time.
    seconds : of the processor that a reading may take.
    """
    outcomes = {"read": 0, "refused": 0}
    for file in files:
        assert outcome_of(lambda file=file: read(file), seconds) == "read"
    end = time.monotonic() + share * SECONDS
    for number in itertools.count():
        rng = random.Random(f"{files[0].name} {number}")
        file = rng.choice(files)
        target = folder / file.name
        target.write_bytes(damage(rng, file.read_bytes(), zipped=file.suffix == ".npz"))
        try:
            look = traced_outcome_of if number % 5 == 0 else outcome_of
            outcomes[look(lambda target=target: read(target), seconds)] += 1
        except Exception as error:
            raise AssertionError(f"case {number}, {target}: {type(error).__name__}: {error}") from error
        if time.monotonic() > end:
            break
    print(outcomes)
