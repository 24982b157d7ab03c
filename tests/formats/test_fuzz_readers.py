"""Random damage to small files: every outcome is a motion or a DousaError, in bounded time and memory.

``DOUSA_FUZZ_SECONDS`` seconds over all formats, 1 by default. The cases are numbered and come in the same order
every time, so that a failure is found again; its file is kept and named in the message.
"""

import itertools
import json
import pickle
import random
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from oracles.c3d_file import DEC, MIPS, make_c3d, random_points

import fuzzing
from dousa.formats.opensim import list_coordinates
from dousa.formats.registry import SUFFIXES, read_motion, write_motion
from dousa.motion import Motion, Skeleton, Trajectories, compute_trajectories
from dousa.motion.rotations import normalise
from formats import fake_programs, made_mmd, made_usd
from formats import made_files as made
from formats import made_points as points
from formats.made_tables import nexus
from formats.test_asf_amc import AMC, ASF
from formats.test_bvh import SMALL as BVH
from fuzzing import damage, outcome_of, traced_outcome_of

pytestmark = pytest.mark.fuzz

SECONDS = fuzzing.SECONDS / len(SUFFIXES)
CASE_SECONDS = fuzzing.CASE_SECONDS
CASE_BYTES = 64 << 20


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
        ".npy": [{"x.npy": made.make_npy(rng.normal(size=(3, count, 3)))} for count in (22, 25, 17)],
        ".pk": [{"x.pk": made.make_aist()}],
        ".pickle": [{"x.pickle": made.make_aist()}],
        ".joblib": [{"x.joblib": made.make_joblib({1: made.make_smpl()})}],
        ".pt": [{"x.pt": made.make_torch({"smpl_params_global": made.make_smpl()})}],
        ".pkl": [{"x.pkl": made.make_aist()}, {"x.pkl": pickle.dumps({"keypoints3d": rng.normal(size=(3, 17, 3))})}],
        ".csv": [{"x.csv": made.make_motive()}, {"x.csv": files["m.csv"]}, {"x.csv": nexus(points.COCO).encode()}],
        ".tsv": [{"x.tsv": made.make_qualisys()}, {"x.tsv": made.make_qualisys_skeleton()}],
        **{suffix: [{f"x{suffix}": files["m.glb"]}] for suffix in (".glb", ".gltf", ".vrm", ".vrma")},
        ".json": [{"x.json": json.dumps(content).encode()} for content in landmarks],
        ".mot": [{"x.mot": made.make_mot({name: np.arange(5.0) for name in list_coordinates()})}],
        ".vmd": [{"x.vmd": vmd}, {"x.pmx": made_mmd.make_pmx(), "x.vmd": vmd}],
        **{suffix: [{f"x{suffix}": made_usd.make_usda()}] for suffix in (".usd", ".usda", ".usdc", ".usdz")},
        ".fbx": [{"x.fbx": fake_programs.FBX_MARK + files["m.glb"]}],
        ".dae": [{"x.dae": fake_programs.DAE_MARK + files["m.glb"]}],
        ".mvnx": [{"x.mvnx": made.make_mvnx()}],
        ".c3d": [{"x.c3d": data} for data in ((folder / "t.c3d").read_bytes(), *stored)],
    }


def make_case(seeds: list[dict[str, bytes]], suffix: str, number: int) -> dict[str, bytes]:
    """The files of one case, one of them damaged."""
    rng = random.Random(f"{suffix} {number}")
    files = dict(rng.choice(seeds))
    chosen = rng.choice(sorted(files))
    return files | {chosen: damage(rng, files[chosen], zipped=suffix.endswith(".npz"))}


def save(folder: Path, files: dict[str, bytes]) -> None:
    for name, data in files.items():
        (folder / name).write_bytes(data)


def run_case(folder: Path, files: dict[str, bytes], *, traced: bool = False) -> str:
    """Reads the last of the files: "read" or "refused"; an AssertionError for a hang or a wordless error."""
    save(folder, files)

    def read() -> None:
        assert isinstance(read_motion(folder / list(files)[-1]), Motion | Trajectories)

    return traced_outcome_of(read, CASE_SECONDS, CASE_BYTES) if traced else outcome_of(read, CASE_SECONDS)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_damaged_files_are_read_or_refused(tmp_path, monkeypatch, suffix):
    seeds = make_seeds(tmp_path)[suffix]
    if suffix in (".fbx", ".dae"):  # through a program that takes a mark off
        fake_programs.install_quick(tmp_path, monkeypatch)
    if suffix.startswith(".usd"):
        pytest.importorskip("pxr", reason="usd-core is not installed: pip install 'dousa[usd]'", exc_type=ImportError)
        seeds = [{f"x{suffix}": made_usd.pack(tmp_path, suffix)}]
    for files in seeds:  # the whole files are sound, and kernels are compiled before the clock starts
        assert run_case(tmp_path, files) == "read"
    if suffix.startswith(".usd"):  # of a damaged count usd-core thinks for long: its process is stopped
        monkeypatch.setenv("DOUSA_PROGRAM_SECONDS", "15")
        monkeypatch.setattr(sys.modules[__name__], "CASE_SECONDS", 30)
    outcomes = dict.fromkeys(("read", "refused"), 0)
    end = time.monotonic() + SECONDS
    for number in itertools.count():
        files = make_case(seeds, suffix, number)
        try:
            outcomes[run_case(tmp_path, files, traced=number % 5 == 0)] += 1
        except Exception as error:
            kept = ", ".join(str(tmp_path / name) for name in files)
            problem = f"{suffix} case {number}, {kept}: {type(error).__name__}: {error}"
            raise AssertionError(problem) from error
        if time.monotonic() > end:
            break
    print(f"{suffix}: {outcomes}")


def test_every_format_is_fuzzed(tmp_path):
    assert set(make_seeds(tmp_path)) == set(SUFFIXES)
