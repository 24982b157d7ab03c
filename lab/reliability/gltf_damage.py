"""Damage to GLB files: bytes inserted, deleted and changed, in the structure and in the values, and what is said of it.

``python -m lab.reliability.gltf_damage [--copies 4000]`` makes small files (a clip of ours, one with a mesh, animations
with sparse keys) and damages copies of them. A copy is *silent* if it is read without an error and without a note that
the good file does not have, and yet is another motion. Values are the numbers of the binary chunk, of places and of
turns at rest; structure is all else.
"""

from __future__ import annotations

import argparse
import re
import tempfile
from collections import Counter
from pathlib import Path

import numpy as np

from dousa.errors import DousaError
from dousa.formats.registry import read_motion, write_motion
from dousa.motion import Motion, compute_trajectories
from dousa.motion.synthetic import draw_performer, make_motion

NUMBERS = re.compile(rb'"(?:translation|rotation|scale|matrix|min|max)":(\[[^]]*\])')
KINDS = ("insert", "delete", "flip")


def make_files(folder: Path) -> list[bytes]:
    """Write two short clips of different bodies as GLB; their bytes."""
    files = []
    for seed, category in enumerate(("throw", "walk")):
        motion = make_motion(category, draw_performer(seed))
        short = motion.replace(rotations=motion.rotations[:12], translations=motion.translations[:12])
        write_motion(short, folder / f"{seed}.glb")
        files.append((folder / f"{seed}.glb").read_bytes())
    return files


def damage(data: bytes, kind: str, place: int, rng: np.random.Generator) -> bytes:
    """Insert or delete 1 to 64 bytes at a place, or change one bit of it."""
    size = int(rng.integers(1, 65))
    if kind == "insert":
        return data[:place] + rng.bytes(size) + data[place:]
    if kind == "delete":
        return data[:place] + data[place + size :]
    changed = data[place] ^ (1 << int(rng.integers(8)))
    return data[:place] + bytes([changed]) + data[place + 1 :]


def read(path: Path) -> tuple[np.ndarray, tuple[str, ...]] | None:
    """Positions and codes of the notes of a file; None if it is refused."""
    try:
        motion = read_motion(path)
    except DousaError:
        return None
    assert isinstance(motion, Motion)
    notes = motion.provenance.notes if motion.provenance else ()
    return compute_trajectories(motion).positions, tuple(note.code for note in notes)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--copies", type=int, default=4000, help="of each kind")
    copies = parser.parse_args().copies
    rng = np.random.default_rng(0)
    counts: Counter[tuple[str, str, str]] = Counter()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        files = make_files(folder)
        whole = [read(folder / f"{seed}.glb") for seed in range(len(files))]
        values = [[match.span(1) for match in NUMBERS.finditer(data)] for data in files]
        path = folder / "damaged.glb"
        for kind in KINDS:
            for number in range(copies):
                data, good = files[number % len(files)], whole[number % len(files)]
                assert good is not None
                binary = 20 + int.from_bytes(data[12:16], "little") + 8
                # Half of the changes hit header and JSON, which are a small part of a file.
                place = int(rng.integers(binary) if number % 4 < 2 else rng.integers(binary, len(data)))
                valued = place >= binary or any(start <= place < end for start, end in values[number % len(files)])
                part = "values" if valued and kind == "flip" else "structure"
                path.write_bytes(damage(data, kind, place, rng))
                counts[kind, part, judge(good, read(path))] += 1
    verdicts = ("refused", "noted", "the same motion", "silent")
    print("| damage | copies | " + " | ".join(verdicts) + " |")
    for kind, part in sorted({key[:2] for key in counts}):
        row = [counts[kind, part, verdict] for verdict in verdicts]
        print(f"| {kind}, {part} | {sum(row)} | " + " | ".join(map(str, row)) + " |")


def judge(
    good: tuple[np.ndarray, tuple[str, ...]], found: tuple[np.ndarray, tuple[str, ...]] | None, same: float = 1e-3
) -> str:
    """What became of a copy; positions within ``same`` m are the same motion."""
    if found is None:
        return "refused"
    if good[0].shape == found[0].shape and np.allclose(good[0], found[0], atol=same):
        return "the same motion"
    return "noted" if set(found[1]) - set(good[1]) else "silent"


if __name__ == "__main__":
    main()
