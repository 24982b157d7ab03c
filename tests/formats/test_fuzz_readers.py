"""Random damage to small files: every outcome is a motion or a DousaError, in bounded time and memory.

``DOUSA_FUZZ_SECONDS`` seconds over all formats, 3 by default. The cases are numbered and come in the same order
every time, so that a failure is found again; its file is kept and named in the message.
"""

from __future__ import annotations

import faulthandler
import io
import itertools
import json
import os
import pickle
import random
import re
import struct
import sys
import time
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest
from oracles.c3d_file import DEC, MIPS, make_c3d, random_points

from dousa.errors import DousaError
from dousa.formats.registry import SUFFIXES, read_motion, write_motion
from dousa.motion import Motion, Skeleton, Trajectories, compute_trajectories
from dousa.motion.rotations import normalise
from formats import fake_programs, made_mmd, made_usd
from formats import made_files as made
from formats import made_points as points

pytestmark = pytest.mark.fuzz

SECONDS = float(os.environ.get("DOUSA_FUZZ_SECONDS", "3")) / len(SUFFIXES)
CASE_SECONDS = 5  # one damaged file of a few kB; a reader that needs longer hangs
CASE_BYTES = 64 << 20

ASF = """# AST/ASF file
:version 1.10
:name VICON
:units
  mass 1.0
  length 0.45
  angle deg
:root
   order TX TY TZ RX RY RZ
   axis XYZ
   position 0 0 0
   orientation 0 0 0
:bonedata
  begin
     id 1
     name lhipjoint
     direction 0.6 -0.7 0.2
     length 2.4
     axis 0 0 0 XYZ
  end
  begin
     id 2
     name lfemur
     direction 0.34 -0.93 0
     length 7.1
     axis 0 0 20 XYZ
     dof rx ry rz
     limits (-160.0 20.0)
            (-70.0 70.0)
            (-60.0 70.0)
  end
  begin
     id 3
     name ltibia
     direction 0.34 -0.93 0
     length 7.4
     axis 0 0 20 XYZ
     dof rx
     limits (-10.0 170.0)
  end
:hierarchy
  begin
    root lhipjoint
    lhipjoint lfemur
    lfemur ltibia
  end
"""

AMC = "#!OML:ASF made.asf\n:FULLY-SPECIFIED\n:DEGREES\n" + "".join(
    f"{frame}\nroot 1.5 {frame}.25 -3e-1 1 2 3\nlfemur -10.5 2 {frame}\nltibia 4{frame}.0\n" for frame in range(1, 6)
)

BVH = """HIERARCHY
ROOT Hips
{
\tOFFSET 0.0 0.0 0.0
\tCHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
\tJOINT Chest
\t{
\t\tOFFSET 0.0 10.5 -1e-3
\t\tCHANNELS 3 Zrotation Xrotation Yrotation
\t\tEnd Site
\t\t{
\t\t\tOFFSET 0.0 5.0 0.0
\t\t}
\t}
\tJOINT LeftUpLeg
\t{
\t\tOFFSET 3.9 0.0 0.0
\t\tCHANNELS 6 Xposition Yposition Zposition Xrotation Yrotation Zrotation
\t}
}
MOTION
Frames: 4
Frame Time: 0.0333333
""" + "".join(f"{frame}.5 90 -2 {frame} 2 3.25 10 20 30 3.9 0 0 1e1 -0.5 nan\n" for frame in range(4))


def make_motion():
    rng = np.random.default_rng(0)
    skeleton = Skeleton(("hips", "spine", "head", "leg"), [-1, 0, 1, 0], rng.normal(size=(4, 3)))
    rotations = normalise(rng.normal(size=(5, 4, 4)))
    return Motion(skeleton, rotations, rng.normal(size=(5, 4, 3)), 30.0)


def make_seeds(folder: Path) -> dict[str, list[dict[str, bytes]]]:
    """By suffix: sets of files, the motion last."""
    paths = compute_trajectories(make_motion())
    gaps = paths.positions.copy()
    gaps[1, 2] = np.nan
    paths = Trajectories(paths.names, gaps, 30.0)
    files = {}
    for name, moving in {
        "m.bvh": make_motion(),
        "m.npz": make_motion(),
        "t.npz": paths,
        "t.trc": paths,
        "m.csv": make_motion(),
        "m.glb": make_motion(),
    }.items():
        write_motion(moving, folder / name)
        files[name] = (folder / name).read_bytes()
    write_motion(paths, folder / "t.c3d")
    labels = ["LASI", "RASI", "SACR"]
    stored = [make_c3d(random_points(), labels, processor=DEC, n_analog=2)]
    stored += [make_c3d(random_points(), labels, processor=MIPS, scale=0.5)]
    rng = np.random.default_rng(1)
    smpl = made.make_npz(**made.make_smpl(), mocap_framerate=np.array(60.0))
    joints = made.make_npz(joints=rng.normal(size=(3, 24, 3)), fps=np.array(25.0))
    rounded = {t: np.round(points.make_points(t, 2)[0], 3) for t in (points.OPENPOSE, points.MEDIAPIPE, points.H36M)}
    landmarks = [json.loads(points.openpose_frames(rounded[points.OPENPOSE])[0]), rounded[points.H36M].tolist()]
    landmarks += [points.mediapipe_list(rounded[points.MEDIAPIPE]), points.mmpose(rounded[points.H36M])]
    steps = [
        made_mmd.make_key(bone, frame, (0, frame, 0)) for bone in ("センター", "左足ＩＫ", "左腕") for frame in (0, 9)
    ]
    vmd = made_mmd.make_vmd(steps, [(0, {"左足ＩＫ": True}), (5, {"左足ＩＫ": False})])
    return {
        ".bvh": [{"x.bvh": BVH.encode()}, {"x.bvh": files["m.bvh"]}],
        ".amc": [{"x.asf": ASF.encode(), "x.amc": AMC.encode()}],
        ".trc": [{"x.trc": files["t.trc"]}],
        ".npz": [{"x.npz": files["m.npz"]}, {"x.npz": files["t.npz"]}, {"x.npz": joints}, {"x.npz": smpl}],
        ".amass.npz": [{"x.amass.npz": smpl}],
        ".npy": [{"x.npy": made.make_npy(rng.normal(size=(3, count, 3)))} for count in (22, 25, 17)],
        ".pkl": [{"x.pkl": made.make_aist()}, {"x.pkl": pickle.dumps({"keypoints3d": rng.normal(size=(3, 17, 3))})}],
        ".csv": [{"x.csv": made.make_motive()}, {"x.csv": files["m.csv"]}],
        ".tsv": [{"x.tsv": made.make_qualisys()}, {"x.tsv": made.make_qualisys_skeleton()}],
        **{suffix: [{f"x{suffix}": files["m.glb"]}] for suffix in (".glb", ".gltf", ".vrm", ".vrma")},
        ".json": [{"x.json": json.dumps(content).encode()} for content in landmarks],
        ".vmd": [{"x.vmd": vmd}, {"x.pmx": made_mmd.make_pmx(), "x.vmd": vmd}],
        **{suffix: [{f"x{suffix}": made_usd.make_usda()}] for suffix in (".usd", ".usda", ".usdc", ".usdz")},
        ".fbx": [{"x.fbx": fake_programs.FBX_MARK + files["m.glb"]}],
        ".dae": [{"x.dae": fake_programs.DAE_MARK + files["m.glb"]}],
        ".mvnx": [{"x.mvnx": made.make_mvnx()}],
        ".c3d": [{"x.c3d": data} for data in ((folder / "t.c3d").read_bytes(), *stored)],
    }


NUMBER = re.compile(rb"-?\d+(\.\d*)?([eE][+-]?\d+)?")
NASTY_TEXTS = [
    b"1000000000",
    b"-1",
    b"0",
    b"1e999",
    b"-1e308",
    b"nan",
    b"inf",
    b"9" * 400,
    b"1e",
    b"0x10",
    b"",
    b"{",
]
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


DAMAGES = (
    flip,
    flip,
    cut,
    remove,
    repeat,
    overwrite,
    overwrite,
    insert,
    swap_number,
    swap_number,
    swap_lines,
)


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


def make_case(seeds: list[dict[str, bytes]], suffix: str, number: int) -> dict[str, bytes]:
    """The files of one case, one of them damaged."""
    rng = random.Random(f"{suffix} {number}")
    files = dict(rng.choice(seeds))
    chosen = rng.choice(sorted(files))
    data = bytearray(files[chosen])
    if suffix.endswith(".npz") and rng.random() < 0.7:
        damage_array(rng, data)
    else:
        for _ in range(rng.choice((1, 1, 1, 2, 3))):
            if data:
                rng.choice(DAMAGES)(rng, data)
    return files | {chosen: bytes(data)}


def save(folder: Path, files: dict[str, bytes]) -> None:
    for name, data in files.items():
        (folder / name).write_bytes(data)


def run_case(folder: Path, files: dict[str, bytes]) -> str:
    """Reads the last of the files: "read" or "refused"; an AssertionError for a hang or a wordless error."""
    save(folder, files)
    # Inside a kernel no signal is served: then the whole run ends with a traceback that shows the case.
    faulthandler.dump_traceback_later(4 * CASE_SECONDS, exit=True)
    start = time.monotonic()
    try:
        moving = read_motion(folder / list(files)[-1])
        assert isinstance(moving, Motion | Trajectories)
        outcome = "read"
    except DousaError as error:
        assert str(error), "an error without words"
        outcome = "refused"
    finally:
        faulthandler.cancel_dump_traceback_later()
    assert time.monotonic() - start < CASE_SECONDS, "took too long"
    return outcome


def run_traced_case(folder: Path, files: dict[str, bytes]) -> str:
    """As ``run_case``, counting memory too, which is slow."""
    tracemalloc.start()
    try:
        outcome = run_case(folder, files)
        assert tracemalloc.get_traced_memory()[1] < CASE_BYTES, "took too much memory"
        return outcome
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_damaged_files_are_read_or_refused(tmp_path, monkeypatch, suffix):
    seeds = make_seeds(tmp_path)[suffix]
    if suffix in (".fbx", ".dae"):  # through a program that takes a mark off
        fake_programs.install_quick(tmp_path, monkeypatch)
    if suffix.startswith(".usd"):
        pytest.importorskip("pxr", reason="usd-core is not installed: pip install 'dousa[usd]'", exc_type=ImportError)
        seeds = [{f"x{suffix}": made_usd.pack(tmp_path, suffix)}]
        # Of a damaged count usd-core thinks for long: its process is stopped.
        monkeypatch.setenv("DOUSA_PROGRAM_SECONDS", "15")
        monkeypatch.setattr(sys.modules[__name__], "CASE_SECONDS", 30)
    for files in seeds:  # the whole files are sound, and kernels are compiled before the clock starts
        assert run_case(tmp_path, files) == "read"
    outcomes = dict.fromkeys(("read", "refused"), 0)
    end = time.monotonic() + SECONDS
    for number in itertools.count():
        files = make_case(seeds, suffix, number)
        try:
            outcomes[(run_traced_case if number % 5 == 0 else run_case)(tmp_path, files)] += 1
        except Exception as error:
            kept = ", ".join(str(tmp_path / name) for name in files)
            problem = f"{suffix} case {number}, {kept}: {type(error).__name__}: {error}"
            raise AssertionError(problem) from error
        if time.monotonic() > end:
            break
    print(f"{suffix}: {outcomes}")


def test_every_format_is_fuzzed(tmp_path):
    assert set(make_seeds(tmp_path)) == set(SUFFIXES)
