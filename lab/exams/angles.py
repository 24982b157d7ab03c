"""The exam of angles: made people filmed by 4, 2 and 1 phones, asked for by the command line, in degrees.

    python -m lab.exams.angles [--data DIR] [--clips N] [--frames N] [--seed N] [--work FOLDER] [--json FILE]

Given are a calibration with lenses, the stature, and silhouettes or keypoints as OpenPose writes them. Each cell: dousa
/ baseline, mean absolute error in degrees, of the written TRC; mm of 12 limb joints. legs: thigh against trunk, and
knee; arms: upper arm against trunk, and elbow; `*` misses its target (in brackets), `<` is behind the baseline. lost:
frames said to be; far: off by over 150 mm; said: share of the far ones that is lost; blank: without positions, left out
of the rest. Below, the same of the file of `--angles` and of a `.mot` (of the ankle without the median, its zero being
free), whether their hinges agree with the positions, and columns that jump by over 180 degrees. The baseline is the
true first pose, carried along (silhouettes); linear triangulation and a median (keypoints); bones lifted by their
lengths from the true first pose (one view). Written from the words of the task alone, by somebody who had not seen the
code. Minutes of one core.
"""

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

import dousa
from lab.exams import angles_films as films
from lab.exams.angles_measures import (
    ANGLES,
    AT,
    JOINTS,
    carry,
    differ,
    find_angles,
    lift,
    read_angles,
    to_rays,
    triangulate,
)
from lab.exams.sides_people import RATE, Array, Clip, film, make_joints, place_cameras

TARGETS = {("silhouettes", 4): (5, 7), ("silhouettes", 2): (6, 9)}  # degrees: legs, arms
TARGETS |= {("keypoints", 4): (4, 7), ("keypoints", 2): (5, 9), ("keypoints", 1): (8, 14)}
NOISE, SHARES = ("clean", "noisy"), ("lost", "far", "said", "blank")
INNER = [k for name, k in AT.items() if "toe" not in name]


def call(*words: str) -> subprocess.CompletedProcess[str]:
    env = os.environ | {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1", "DOUSA_LANG": "en", "COLUMNS": "80"}
    asked = [sys.executable, "-m", "dousa", "estimate", *words]
    return subprocess.run(asked, env=env, capture_output=True, text=True, check=False)


def read_table(path: Path) -> dict[str, Array]:
    """Columns of a CSV or a `.mot`, their unit left off their names."""
    lines = path.read_text().splitlines()
    if path.suffix == ".mot":
        if "inDegrees=yes" not in lines:
            raise ValueError("not said to be in degrees")
        lines = lines[lines.index("endheader") + 1 :]
    mark = "\t" if path.suffix == ".mot" else ","
    rows = [line.split(mark) for line in lines if line.strip()]
    values = np.array([[float(cell or "nan") for cell in row] for row in rows[1:]])
    return {name.strip().removesuffix("_deg"): values[:, k] for k, name in enumerate(rows[0])}


def read_pose(path: Path) -> Array:
    """The joints of a TRC (T, 14, 3); what is blank is nan."""
    lines = path.read_text().splitlines()
    markers, rows = lines[3].split()[2:], [line.split("\t") for line in lines[5:] if line.strip()]
    values = np.array(
        [[float(c or "nan") for c in (row + 3 * len(markers) * [""])[2 : 2 + 3 * len(markers)]] for row in rows]
    )
    return values.reshape(len(rows), -1, 3)[:, [markers.index(joint) for joint in JOINTS]]


def judge_file(path: Path, pose: dict[str, Array], truth: dict[str, Array]) -> dict:
    """Of a file of angles: errors, differences to the positions that were written with it, jumps."""
    columns = read_table(path)
    found = read_angles(columns)
    degrees = [
        v for name, v in columns.items() if not name.endswith(("_m", "_tx", "_ty", "_tz")) and "time" not in name
    ]
    jumps = sum(bool(np.any(np.abs(np.diff(values)) > 180)) for values in degrees)
    own = differ(found, pose)
    named = sum(name in columns for name in ("knee_angle_r", "hip_flexion_r", "elbow_flex_r", "arm_flex_r"))
    agree = {f"own {name}": own.get(name, np.nan) for name in ("knee", "elbow")}
    return differ(found, truth, level=True) | agree | {"jumps": jumps, "named": named / 4}


def judge(folder: Path, said: dict, truth: Array) -> dict[str, dict]:
    """Marks of positions and of the two files."""
    found, real = read_pose(folder / "out.trc"), find_angles(truth)
    if len(found) != len(truth):
        raise ValueError(f"{len(found)} of {len(truth)} frames came")
    known, pose = np.isfinite(found).all(axis=(1, 2)), find_angles(found)
    told, true = ({name: values[known] for name, values in angles.items()} for angles in (pose, real))
    miss = 1e3 * np.linalg.norm(found - truth, axis=-1)[:, INNER].mean(axis=1)
    lost, far = np.isin(np.arange(len(truth)), said.get("lost_frames", [])) | ~known, ~(miss <= 150)
    marks = {"dousa": differ(told, true) | {"mm": np.nanmean(miss), "lost": 100 * lost.mean(), "far": 100 * far.mean()}}
    marks["dousa"] |= {"said": 100 * np.mean(lost[far]) if far.any() else np.nan, "blank": 100 * np.mean(~known)}
    moved = dousa.read_motion(folder / "out.bvh")
    there = dousa.canonicalise(moved).positions[:, [dousa.CANONICAL_JOINTS.index(name) for name in JOINTS]]
    marks["dousa"]["bvh"] = 1e3 * np.nanmean(np.linalg.norm(there - found, axis=-1))
    dousa.write_motion(moved, folder / "out.mot")
    for name in ("out.csv", "out.mot"):
        marks[name[4:]] = judge_file(folder / name, pose, real)
    return marks


def ask(folder: Path, sources: list[str], truth: Array, told: list[str]) -> dict[str, dict]:
    """The marks of one film, or why there are none."""
    files = (f"{folder}/out.trc", "-o", f"{folder}/out.bvh", "--angles", f"{folder}/out.csv", "--json")
    done = call(*sources, "--calibration", f"{folder}/calib.toml", *told, "--offsets", "none", "-o", *files)
    if done.returncode:
        return {"why": f"exit {done.returncode}: {' '.join(done.stderr.split())[-150:]}"}
    try:
        return judge(folder, json.loads(done.stdout), truth)
    except (ValueError, OSError, LookupError, dousa.errors.DousaError) as reason:
        return {"why": f"{type(reason).__name__}: {reason}"}


def run_clip(number: int, clip: Clip, options: argparse.Namespace, folder: Path, cues: tuple[str, ...]) -> dict:
    """The marks of all films of a clip, by cue, views and noise."""
    luck, stature, marks = np.random.default_rng([options.seed, number]), clip.person.stature, {}
    joints = make_joints(options.data, clip, options.frames)
    truth = np.stack([joints[name] for name in JOINTS], axis=1)
    names, index = films.choose_scheme(number)
    cloud, cameras = films.make_points(joints, stature, names), place_cameras(joints, clip.turned, luck)
    lenses, large = films.draw_lenses(len(cameras), luck), [films.enlarge(camera) for camera in cameras]
    toes = [k for k, name in enumerate(JOINTS) if "toe" in name and index[k] is None]  # not asked for
    asked, index = np.where(np.isin(np.arange(14), toes)[:, None], np.nan, truth), [k or 0 for k in index]
    for noisy in (False, True):
        straight = film(joints, clip.person, cameras, noisy, int(luck.integers(1 << 30)))
        masks = np.stack([films.bend(*view) for view in zip(straight, cameras, lenses, strict=True)])
        middles = np.array([[np.argwhere(shot).mean(axis=0)[::-1] for shot in view] for view in masks])
        middles = np.stack([to_rays(*view) for view in zip(middles, cameras, lenses, strict=True)])
        seen = [films.see(cloud, names, *view, noisy, luck) for view in zip(large, lenses, strict=True)]
        rays = np.stack([to_rays(s[..., :2], *view) for s, *view in zip(seen, large, lenses, strict=True)])[:, :, index]
        trust = np.stack([s[:, index, 2] for s in seen])
        for views, cue in ((views, cue) for views in (4, 2, 1) for cue in cues):
            place = folder / f"{clip.name}_{cue}_{views}_{NOISE[noisy]}".replace(" ", "_")
            place.mkdir(parents=True)
            given, fine = (cameras, 1.0) if cue == "silhouettes" else (large, films.FINE)
            films.write_calibration(place / "calib.toml", given[:views], lenses[:views], fine)
            sources, told = [], ["--stature", str(stature), "--rate", str(RATE)]
            told += ["--cues", "both"] if cue == "both" else []
            if cue == "silhouettes":
                plain = carry(truth[0], middles[:views], cameras[:views])
            elif views > 1:
                plain = triangulate(rays[:views], trust[:views], cameras[:views])
            else:
                plain = lift(rays[0], trust[0], cameras[0], stature, truth[0])
            sources += films.write_keypoints(place, seen[:views]) if cue != "silhouettes" else []
            sources += films.write_masks(place, masks[:views], bool(number % 2)) if cue != "keypoints" else []
            real = truth if cue != "keypoints" else asked
            whole = 1e3 * np.linalg.norm(plain - truth, axis=-1)[:, INNER].mean()
            marks[cue, views, noisy] = ask(place, sources, real, told)
            marks[cue, views, noisy] |= {"plain": differ(find_angles(plain), find_angles(real)) | {"mm": whole}}
    return marks


def mean(marks: list[dict], who: str, key: str) -> float:
    values = [mark[who].get(key, np.nan) for mark in marks if who in mark]
    values = [value for value in values if np.isfinite(value)]
    return float(np.mean(values)) if values else np.nan


def show(value: float, digits: int = 1) -> str:
    return f"{value:.{digits}f}" if np.isfinite(value) else "-"


def label(key: tuple) -> str:
    return f"{key[0]}, {key[1]} view{'s' * (key[1] > 1)}, {NOISE[key[2]]}"


def tell(marks: list[dict], key: tuple) -> None:
    """The row of positions; "1 of 1": films that were answered."""
    cells = []
    for name in ("legs", "arms", *ANGLES, "mm"):
        mine, plain = (mean(marks, who, name) for who in ("dousa", "plain"))
        target = dict(zip(("legs", "arms"), TARGETS.get(key[:2], ()), strict=False)).get(name)
        text = " / ".join(show(value, int(name != "mm")) for value in (mine, plain)) + (
            f" ({target})" if target else ""
        )
        text += "*" if target and not mine <= target else ""
        cells.append(text + ("<" if name in ("legs", "arms") and mine >= plain else ""))
    shares = (show(mean(marks, "dousa", name), 0) for name in SHARES)
    answered = f"{sum('dousa' in mark for mark in marks)} of {len(marks)}"
    print(" | ".join([label(key), *cells, *shares, answered]), flush=True)


def tell_file(marks: list[dict], key: tuple, who: str) -> None:
    cells = [show(mean(marks, who, name)) for name in ("legs", "arms", *ANGLES, "own knee", "own elbow")]
    jumps = str(sum(mark[who]["jumps"] for mark in marks if who in mark))
    print(" | ".join([label(key), who, *cells, jumps, show(100 * mean(marks, who, "named"), 0)]), flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"), help="the folder of recordings")
    parser.add_argument("--clips", type=int, default=5, choices=range(1, len(films.CLIPS) + 1), help="of 12")
    parser.add_argument("--frames", type=int, default=36, help="at most, of each clip (30 Hz)")
    parser.add_argument("--seed", type=int, default=0, help="of cameras, lenses and noise")
    parser.add_argument("--work", type=Path, help="a new folder, where what is given and answered is kept")
    parser.add_argument("--json", type=Path, help="a file of every film's marks")
    options, films_of = parser.parse_args(), {}
    both = re.search(r"keypoints\W+silhouettes\W+both|both\W+keypoints|<both", call("--help").stdout)
    cues = ("silhouettes", "keypoints", "both") if both else ("silhouettes", "keypoints")
    with tempfile.TemporaryDirectory() as scratch:
        for number, clip in enumerate(films.CLIPS[: options.clips]):
            marks = run_clip(number, clip, options, (options.work or Path(scratch)).resolve(), cues)
            for key, mark in marks.items():
                films_of.setdefault(key, []).append(mark)
                if "why" in mark:
                    print(f"{clip.name}, {label(key)}: no answer: {mark['why']}", flush=True)
    order = sorted(films_of, key=lambda key: (cues.index(key[0]), -key[1], key[2]))
    print(
        " | ".join(
            ["positions: dousa / baseline", "legs", "arms", *ANGLES, "mm", *(f"{name} %" for name in SHARES), "films"]
        )
    )
    for key in order:
        tell(films_of[key], key)
    if not both:
        print("both, all views: left out, as --help offers no `--cues both`")
    print(
        " | ".join(["files", "", "legs", "arms", *ANGLES, "to own knee", "elbow (3)", "jumps (0)", "OpenSim's names %"])
    )
    for key in order:
        for who in ("csv", "mot"):
            if any(who in mark for mark in films_of[key]):
                tell_file(films_of[key], key, who)
    print(f"BVH beside TRC: {show(mean([mark for marks in films_of.values() for mark in marks], 'dousa', 'bvh'))} mm")


if __name__ == "__main__":
    main()
