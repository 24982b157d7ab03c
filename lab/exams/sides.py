"""The exam of sides: made people whose limbs cross, asked for through the command line, beside a plain baseline.

    python -m lab.exams.sides [--data DIR] [--clips N] [--frames N] [--work FOLDER]

Each line: what | target | dousa | baseline. Only cameras, silhouettes and stature are told; the baseline is the true
first pose, carried along by the point where the rays of the silhouettes' centres meet. mm: 12 limb joints. A frame is
exchanged where the truth with left and right exchanged (knees and ankles; elbows and wrists) is nearer by 50 mm and by
a third; that is said if `lost_frames`, or a list of frames under a key about sides, holds it. Written from the words
of the task alone, by somebody who had not seen the code. Some minutes of one core.
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

from lab.exams.sides_people import CLIPS, HEIGHT, RATE, SIDES, WIDTH, Array, Camera, film, make_joints, place_cameras

LIMBS = {"legs": ("hip", "knee", "ankle"), "arms": ("shoulder", "elbow", "wrist")}
JOINTS = [f"{side}_{joint}" for side in SIDES for limb in LIMBS.values() for joint in limb]
DOUSA, WHOSE = (sys.executable, "-m", "dousa", "estimate"), ("dousa", "plain")
FAR, MARGIN, NEARER = 0.150, 0.050, 2 / 3
TARGETS = {4: ("<= 36", "<= 38", "<= 5", "<= 7"), 2: ("-", "-", "<= 6", "<= 9")}  # clean, noisy, legs, arms


def ask(folder: Path, masks: Array, cameras: list[Camera], stature: float) -> tuple[Array, dict, str]:
    """Joints (T, 12, 3), what was said, and why nothing came, as a user asks for it; one thread."""
    folder.mkdir(parents=True)
    names = ("camera_matrix", "world_to_camera_rotation", "world_to_camera_translation")
    placed, packed = (
        dict(zip(names, map(np.stack, zip(*cameras, strict=True)), strict=True)),
        np.packbits(masks, axis=3),
    )
    np.savez(folder / "clip.npz", mask_packed=packed, width=WIDTH, height=HEIGHT, frame_rate=RATE, **placed)
    files = [f"{folder}/clip.npz", "--stature", str(stature), "-o", f"{folder}/out.trc", "--json"]
    env = os.environ | {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1", "DOUSA_LANG": "en"}
    done = subprocess.run([*DOUSA, *files], env=env, capture_output=True, text=True, check=False)
    if done.returncode:
        return np.zeros((0, 12, 3)), {}, f"exit {done.returncode}: {done.stderr.strip()[-120:]}"
    markers = (folder / "out.trc").read_text().splitlines()[3].split()[2:]
    found = np.loadtxt(folder / "out.trc", skiprows=5, ndmin=2)[:, 2:].reshape(-1, len(markers), 3)
    return found[:, [markers.index(joint) for joint in JOINTS]], json.loads(done.stdout), f"{len(found)} frames came"


def frames_said(node: object, about: bool = False) -> set[int]:
    """Whole numbers in any list under a key about lost frames, sides, exchanges, doubt."""
    if isinstance(node, dict):
        words = "lost|side|exchang|swap|doubt"
        return {t for key, value in node.items() for t in frames_said(value, about or bool(re.search(words, key)))}
    inner = node if isinstance(node, list) else []
    return {t for value in inner for t in ({value} if about and type(value) is int else frames_said(value, about))}


def angles(joints: Array, limb: str) -> Array:
    """Degrees (T, 4): thigh against trunk and knee, or upper arm against trunk and elbow; left, right."""
    at = {name: joints[:, k] for k, name in enumerate(JOINTS)}
    trunk, found = sum(at[f"{s}_shoulder"] - at[f"{s}_hip"] for s in SIDES), []
    for side in SIDES:
        top, middle, end = (at[f"{side}_{joint}"] for joint in LIMBS[limb])
        for a, b in ((trunk, middle - top), (middle - top, end - middle)):
            cosine = np.sum(a * b, axis=1) / np.linalg.norm(a, axis=1) / np.linalg.norm(b, axis=1)
            found.append(np.rad2deg(np.arccos(np.clip(cosine, -1, 1))))
    return np.stack(found, axis=1)


def carry_start(truth: Array, masks: Array, cameras: list[Camera]) -> Array:
    """The baseline (T, 12, 3)."""
    points = []
    for shots in masks.swapaxes(0, 1):
        total, right = np.zeros((3, 3)), np.zeros(3)
        for (matrix, rotation, translation), shot in zip(cameras, shots, strict=True):
            row, column = np.argwhere(shot).mean(axis=0)
            ray = rotation.T @ np.linalg.solve(matrix, [column, row, 1])
            across = np.eye(3) - np.outer(ray, ray) / (ray @ ray)
            total, right = total + across, right - across @ rotation.T @ translation
        points.append(np.linalg.solve(total, right))
    return truth[:1] + (np.array(points) - points[0])[:, None]


def judge(found: Array, said: dict, truth: Array, plain: Array) -> dict:
    """Of each frame the mean error in m, whether it is exchanged, said, lost; of the clip degrees, by limb."""
    mark: dict = {"said": np.isin(np.arange(len(truth)), list(frames_said(said)))}
    mark["lost"] = np.isin(np.arange(len(truth)), said.get("lost_frames", []))
    mark["warned"] = bool(re.search("exchang|swap|left and right", json.dumps(said.get("warnings", [])).lower()))
    for who, pose in zip(WHOSE, (found, plain), strict=True):
        mark[who] = np.linalg.norm(pose - truth, axis=-1).mean(axis=1)
        for limb in LIMBS:
            mark[who, limb] = np.abs(angles(pose, limb) - angles(truth, limb)).mean()
    for limb, joints in LIMBS.items():
        index = [k for k, name in enumerate(JOINTS) if name.endswith(joints[1:])]
        gaps = (np.linalg.norm(found - np.roll(truth, k, axis=1), axis=-1) for k in (0, len(JOINTS) // 2))
        named, other = (gap[:, index].mean(axis=1) for gap in gaps)
        mark[limb] = swapped = (other + MARGIN < named) & (other < NEARER * named)
        sums = (1e3 * miss[swapped].sum() / max(swapped.sum(), 1) for miss in (named, other))
        mark["as", limb] = " mm, exchanged ".join(f"{miss:.0f}" for miss in sums)
    return mark


def tell(what: str, target: str, dousa: str, baseline: str) -> None:
    print(f"{what:34s} | {target:7s} | {dousa:72s} | {baseline}", flush=True)


def tell_clip(what: str, mark: dict) -> None:
    mine, base = (f"{1e3 * mark[w].mean():3.0f} mm, {mark[w, 'legs']:.1f} / {mark[w, 'arms']:.1f} deg" for w in WHOSE)
    for limb in LIMBS:
        if mark[limb].any():
            mine += f"; {limb} {mark[limb].sum()}, unsaid {(mark[limb] & ~mark['said']).sum()} ({mark['as', limb]})"
    far, lost = mark["dousa"] > FAR, mark["lost"]
    mine += f"; off {far.sum()}, lost {lost.sum()}, both {(far & lost).sum()}" if (far | lost).any() else ""
    tell(what, "", mine, base)


def tell_sums(marks: list[dict], views: int) -> None:
    """The rows of the task's table."""
    for noisy, target in zip((False, True), TARGETS[views], strict=False):
        miss, plain = ([1e3 * m[who].mean() for m in marks if m["noisy"] == noisy] for who in WHOSE)
        text = f"{np.mean(miss):.0f} mean, {np.median(miss):.0f} median, {max(miss):.0f} worst of {len(miss)} clips"
        tell(f"{views} views, {('clean', 'noisy')[noisy]}: mm", target, text, f"{np.mean(plain):.0f} mean")
    wrong = sum(m["dousa"][0] > FAR or m["legs"][0] or m["arms"][0] for m in marks)
    tell(f"{views} views: starts off or exchanged", "0", f"{wrong} of {len(marks)}", "0 (given)")
    frames = {key: np.concatenate([m[key] for m in marks]) for key in ("dousa", "lost", "said", *LIMBS)}
    for limb, target in zip(LIMBS, TARGETS[views][2:], strict=True):
        unsaid = [m for m in marks if (m[limb] & ~m["said"]).any()]
        text = f"{(frames[limb] & ~frames['said']).sum()} of {frames[limb].sum()} (of {len(frames[limb])} frames)"
        text += f", in {len(unsaid)} clips, {sum(m['warned'] for m in unsaid)} warned of in words"
        tell(f"{views} views: {limb} exchanged, unsaid", "0", text, "-")
        mine, base = (f"{np.mean([m[who, limb] for m in marks]):.1f}" for who in WHOSE)
        tell(f"{views} views: {limb}, degrees", target, mine, base)
    far = frames["dousa"] > FAR
    for what, target, among in (("off > 150 mm", ">= 90 %", far), ("good frames", "<= 5 %", ~far)):
        flagged = (among & frames["lost"]).sum()
        share = f"{flagged} of {among.sum()} ({flagged / max(among.sum(), 1):.0%})"
        tell(f"{views} views: {what}, flagged", target, share, "0 %")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"), help="the folder of recordings")
    parser.add_argument("--clips", type=int, default=8, metavar="N", choices=range(1, len(CLIPS) + 1), help="of 16")
    parser.add_argument("--frames", type=int, default=45, help="at most, of each clip (30 Hz)")
    parser.add_argument("--work", type=Path, help="a new folder, where silhouettes and answers are kept")
    options, marks = parser.parse_args(), []
    with tempfile.TemporaryDirectory() as scratch:
        for number, clip in enumerate(CLIPS[: options.clips]):
            joints = make_joints(options.data, clip, options.frames)
            truth = np.stack([joints[name] for name in JOINTS], axis=1)
            cameras = place_cameras(joints, clip.turned, np.random.default_rng(number))
            for noisy in (False, True):
                masks = film(joints, clip.person, cameras, noisy, 100 + number)
                for views in TARGETS:
                    what = f"{clip.name}, {views}, {('clean', 'noisy')[noisy]}"
                    folder = (options.work or Path(scratch)).resolve() / re.sub("[, ]+", "_", what)
                    found, said, why = ask(folder, masks[:views], cameras[:views], clip.person.stature)
                    if len(found) == len(truth):
                        mark = judge(found, said, truth, carry_start(truth, masks[:views], cameras[:views]))
                        marks.append(mark | {"noisy": noisy, "views": views})
                        tell_clip(what, mark)
                    else:
                        tell(what, "", f"no answer, {why}", "-")
    for views in {m["views"]: 0 for m in marks}:
        tell_sums([m for m in marks if m["views"] == views], views)
    tell("runs", "all", f"{len(marks)} of {4 * options.clips}", "-")


if __name__ == "__main__":
    main()
