"""Damage to files: bytes inserted, deleted and changed, in the structure and in the values, and what is said of it.

``python -m lab.reliability.file_damage [--copies 4000] [--formats glb c3d ...]`` makes small files of every format and
damages copies of them. A copy is *silent* if it is read without an error and without a note that the good file does not
have, and yet is another motion. Values are the numbers of the frames, in BVH those of OFFSET too, in GLB those of nodes
at rest; structure is all else. What is inserted is random bytes, or in every second copy a piece of the file itself.
"""

from __future__ import annotations

import argparse
import re
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from dousa.errors import DousaError
from dousa.formats.exchange.programs import find_program
from dousa.formats.registry import read_motion, write_motion
from dousa.motion import Motion, compute_trajectories
from dousa.motion.kinematics import forward_kinematics
from dousa.motion.synthetic import draw_performer, make_motion
from lab.places import SHARED_DATA

FORMATS = ("glb", "fbx", "c3d", "trc", "csv", "mvnx", "bvh", "amc", "npz")
KINDS = ("insert", "delete", "flip")
VERDICTS = ("refused", "noted", "the same motion", "silent")

# Where the values of a file begin; in MVNX and GLB they are several spans.
_BODY = {
    "trc": rb"\n1\t",
    "csv": rb"\n0,",
    "bvh": rb"Frame Time:[^\n]*\n",
    "amc": rb"\n1\r?\n",
    "npz": rb"rotations\.npy",
}
_SPANS = {
    "bvh": rb"OFFSET([^\r\n]*)",
    "mvnx": rb"<(?:orientation|position)>([^<]*)",
    "fbx": rb"(?s)Key(?:Time|ValueFloat)[lf](.{4,4000}?)(?=.{25}Key)",  # 25 bytes before the name of a record
    "glb": rb'"(?:translation|rotation|scale|matrix|min|max)":(\[[^]]*\])',
}


def make_files(folder: Path, suffix: str) -> list[bytes]:
    """Write two short clips of different bodies in a format; their bytes. None of AMC and FBX without recordings."""
    if suffix == "fbx":
        take = SHARED_DATA / "foreign/unsupported/mixamo_left_turn_90.fbx"
        return [take.read_bytes()] if take.exists() and find_program("assimp") else []
    if suffix == "amc":
        asf, take = SHARED_DATA / "cmu86/86.asf", SHARED_DATA / "cmu86/86_01.amc"
        if not take.exists():
            return []
        (folder / "86.asf").write_bytes(asf.read_bytes())
        return [take.read_bytes().partition(b"\n13")[0] + b"\n"]
    files = []
    for seed, category in enumerate(("throw", "walk")):
        motion = make_motion(category, draw_performer(seed))
        short = motion.replace(rotations=motion.rotations[:12], translations=motion.translations[:12])
        path = folder / f"{seed}.{suffix}"
        if suffix == "mvnx":
            path.write_text(write_mvnx(short))
        else:
            write_motion(compute_trajectories(short) if suffix in ("c3d", "trc") else short, path)
        files.append(path.read_bytes())
    return files


def write_mvnx(motion: Motion) -> str:
    """The MVNX of a motion, Z up."""
    skeleton = motion.skeleton
    places, turns = forward_kinematics(skeleton.parents, motion.rotations, motion.translations)
    places, turns = places[..., [2, 0, 1]], turns[..., [0, 3, 1, 2]]
    names = skeleton.names
    segments = "".join(f'<segment label="{name}" id="{n}"/>' for n, name in enumerate(names, 1))
    joints = "".join(
        f'<joint label="j{name}"><connector1>{names[above]}/p</connector1><connector2>{name}/p</connector2></joint>'
        for name, above in zip(names, skeleton.parents, strict=True)
        if above >= 0
    )
    frames = "".join(
        f'<frame time="{1000 * n / motion.frame_rate:.0f}" index="{n}" type="normal">'
        f"<orientation>{' '.join(map(repr, q.ravel().tolist()))}</orientation>"
        f"<position>{' '.join(map(repr, p.ravel().tolist()))}</position></frame>\n"
        for n, (p, q) in enumerate(zip(places, turns, strict=True))
    )
    return (
        f'<?xml version="1.0"?><mvnx version="4"><subject label="a" frameRate="{motion.frame_rate:g}" segmentCount='
        f'"{len(names)}"><segments>{segments}</segments><joints>{joints}</joints><frames segmentCount="{len(names)}">'
        f"{frames}</frames></subject></mvnx>"
    )


def list_values(suffix: str, data: bytes) -> Iterator[tuple[int, int]]:
    """First byte and end of each part of a file that is values."""
    if suffix in _SPANS:
        yield from (found.span(1) for found in re.finditer(_SPANS[suffix], data))
    if suffix == "glb":
        yield 20 + int.from_bytes(data[12:16], "little") + 8, len(data)
    elif suffix == "c3d":
        yield 512 * (int.from_bytes(data[16:18], "little") - 1), len(data)
    if suffix in _BODY:
        found = re.search(_BODY[suffix], data)
        assert found is not None
        yield found.end() + (128 if suffix == "npz" else 0), data.rindex(b"PK\1\2") if suffix == "npz" else len(data)


def damage(data: bytes, kind: str, place: int, rng: np.random.Generator) -> bytes:
    """Insert or delete 1 to 64 bytes at a place, or change one bit of it."""
    size = int(rng.integers(1, 65))
    if kind == "insert":
        other = int(rng.integers(len(data)))
        return data[:place] + (rng.bytes(size) if rng.random() < 0.5 else data[other : other + size]) + data[place:]
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
    notes = motion.provenance.notes if motion.provenance else ()
    points = compute_trajectories(motion) if isinstance(motion, Motion) else motion
    return points.positions, tuple(note.code for note in notes)


def judge(
    good: tuple[np.ndarray, tuple[str, ...]], found: tuple[np.ndarray, tuple[str, ...]] | None, same: float = 1e-3
) -> str:
    """What became of a copy; positions within ``same`` m are the same motion."""
    if found is None:
        return "refused"
    if good[0].shape == found[0].shape and np.allclose(good[0], found[0], atol=same, equal_nan=True):
        return "the same motion"
    return "noted" if set(found[1]) - set(good[1]) else "silent"


def try_format(suffix: str, copies: int) -> Counter[tuple[str, str, str]]:
    """Number of copies by damage, part and verdict."""
    rng = np.random.default_rng(0)
    counts: Counter[tuple[str, str, str]] = Counter()
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / f"86_01.{suffix}"
        files, whole = make_files(path.parent, suffix), []
        for data in files:
            path.write_bytes(data)
            whole.append(read(path))
        values = [list(list_values(suffix, data)) for data in files]
        for kind in KINDS:
            for number in range(copies if files else 0):
                data, good = files[number % len(files)], whole[number % len(files)]
                assert good is not None
                first = max(values[number % len(files)], key=lambda span: span[1] - span[0])[0]
                # Half of the changes hit what is before the values, a small part of a file.
                place = int(rng.integers(first) if number % 4 < 2 else rng.integers(first, len(data)))
                valued = any(start <= place < end for start, end in values[number % len(files)])
                path.write_bytes(damage(data, kind, place, rng))
                counts[kind, "values" if valued else "structure", judge(good, read(path))] += 1
    return counts


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--copies", type=int, default=4000, help="of each kind and format")
    parser.add_argument("--formats", nargs="+", choices=FORMATS, default=FORMATS)
    options = parser.parse_args()
    print("| format | damage | copies | " + " | ".join(VERDICTS) + " |\n" + "| --- " * 7 + "|")
    for suffix in options.formats:
        counts = try_format(suffix, options.copies)
        for kind, part in sorted({key[:2] for key in counts}):
            row = [counts[kind, part, verdict] for verdict in VERDICTS]
            print(f"| {suffix} | {kind}, {part} | {sum(row)} | " + " | ".join(map(str, row)) + " |", flush=True)


if __name__ == "__main__":
    main()
