"""How often legs or arms are exchanged and nothing says so, where they cross on purpose.

    python -m lab.trials.crossings --mesh FOLDER --kept FOLDER [--people tuned|kept] [--clips N] [--start START]

Made-up people (see `lab.trials.person_maker`; ``--mesh`` as in `lab.trials.made_people`) walk, run, turn, jog, kick,
sneak, throw and bring elbow to knee before four cameras of 320 x 240 at 30 frames/s, cut at a random place. ``tuned``
wear recordings of HDM05's bd and bk, on which the tracker was chosen; ``kept`` those of its dg and of Bandai Namco.
Only the stature is told, and the first pose with ``--start truth``, or with knees and ankles exchanged with ``--start
exchanged``. Limbs are exchanged in a frame where their ends (knees and ankles; elbows and wrists) are off by more than
150 mm in the mean as named, and by less than half if exchanged. Prints each clip, and the counts. Clips are kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from dousa.arrays import BoolArray, FloatArray
from dousa.estimation import estimate, make_human, make_ring
from dousa.estimation.body.kinematics import compute_points, point_names
from dousa.estimation.body.posing import fit_pose
from dousa.estimation.silhouettes.mask_npz import write_silhouettes
from lab.estimation.clips import BenchClip, choose_views, read_clip, take_part
from lab.trials.person_maker import N_BODY, Mesh, draw_mask, list_kinds, make_parser, move_person, open_mesh

_RATE, _FRAMES, _SIZE = 30.0, 45, (320, 240)
_KINDS = ("elbowToKnee", "jog", "kick", "sneak", "throw")
# fmt: off
_PEOPLE = {"tuned": [f"hdm05/{kind}*/HDM_{who}_*.amc" for kind in _KINDS for who in ("bd", "bk")],
           "kept": [*(f"hdm05/{kind}*/HDM_dg_*.amc" for kind in _KINDS),
                    *(f"bandai/{kind}/*/*.bvh" for kind in ("walk", "run", "walk-turn-left", "walk-turn-right"))]}
# fmt: on
_BONES = {
    "shoulder": "upperarm01",
    "elbow": "lowerarm01",
    "wrist": "wrist",
    "hip": "upperleg01",
    "knee": "lowerleg01",
    "ankle": "foot",
}  # fmt: skip
LIMBS = {"legs": ("knee", "ankle"), "arms": ("elbow", "wrist")}
OFF = 0.15


def make_clip(path: Path, mesh: Mesh, motions: Sequence[Path], number: int) -> None:
    """Draw one person before four cameras, and write silhouettes, cameras and true joints."""
    rng = np.random.default_rng(7000 + number)
    moved = move_person(mesh, motions, rng, _RATE, _FRAMES)
    distance = rng.uniform(3.6, 4.6) + 1.5 * max(0.0, moved.reach - 0.4)
    cameras = make_ring(4, distance=distance, height=rng.uniform(0.9, 1.8), size=_SIZE, first_angle=rng.uniform(0, 6))
    faces = mesh.faces[(mesh.faces < N_BODY).all(axis=1)]
    masks = [[draw_mask(camera, faces, vertices) for vertices in moved.vertices] for camera in cameras]
    bones = {f"{side}_{joint}": f"{bone}.{side[0].upper()}" for joint, bone in _BONES.items()
             for side in ("left", "right")}  # fmt: skip
    joints = np.stack([[heads[bone] for bone in bones.values()] for heads in moved.heads])
    path.parent.mkdir(parents=True, exist_ok=True)
    truth, stature = (list(bones), joints), moved.person.stature
    write_silhouettes(path, np.array(masks), cameras, moved.frame_rate, stature=stature, truth=truth)


class Outcome(NamedTuple):
    """Of each frame (T,): error as named and with the best exchange of limbs, m; exchanged limbs; lost."""

    named: FloatArray
    best: FloatArray
    exchanged: dict[str, BoolArray]
    lost: BoolArray
    rate: float


def track_clip(clip: BenchClip, count: int, start: str) -> Outcome:
    """Track a clip with ``count`` views and compare."""
    views = choose_views(clip.cameras, count)
    body, places = make_human(clip.stature), dict(clip.joints_at(0))
    if start == "exchanged":
        for end in LIMBS["legs"]:
            left, right = f"left_{end}", f"right_{end}"
            places[left], places[right] = places[right], places[left]
    first = None if start == "auto" else fit_pose(body, places)[0]
    cameras = [clip.cameras[view] for view in views]
    found = estimate(take_part(clip.silhouettes, views), cameras, body, first, n_threads=1)
    names = point_names(found.body)
    ours = compute_points(found.body, found.poses)[:, [names.index(name) for name in clip.joints]]
    return compare(clip.joints, ours, clip.truth, found.lost, found.frames_per_second)


def compare(joints: Sequence[str], ours: FloatArray, truth: FloatArray, lost: BoolArray, rate: float) -> Outcome:
    """Compare joints (T, K, 3) with the truth, as named and with limbs exchanged."""
    errors = np.linalg.norm(ours - truth, axis=-1)
    best, exchanged = errors.copy(), {}
    for limb, ends in LIMBS.items():
        left, right = ([joints.index(f"{side}_{end}") for end in ends] for side in ("left", "right"))
        both, other = left + right, right + left
        crossed = np.linalg.norm(ours[:, other] - truth[:, both], axis=-1)
        own = errors[:, both].mean(axis=1)
        exchanged[limb] = (own > OFF) & (crossed.mean(axis=1) < 0.5 * own)
        better = crossed.mean(axis=1) < own
        best[np.ix_(better, both)] = crossed[better]
    return Outcome(errors.mean(axis=1), best.mean(axis=1), exchanged, lost, rate)


def print_outcomes(rows: dict[tuple[str, int], Outcome]) -> None:
    """Print a line for each clip, and the counts for each number of views."""
    print("| clip | views | as named, mm | if exchanged, mm | legs, arms exchanged, frames | of these unsaid | lost |")
    print("| --- " * 7 + "|")
    for (name, count), row in rows.items():
        limbs = np.stack(list(row.exchanged.values()))
        unsaid = (limbs.any(axis=0) & ~row.lost).sum()
        print(f"| {name} | {count} | {1e3 * row.named.mean():.0f} | {1e3 * row.best.mean():.0f} | "
              f"{', '.join(str(n) for n in limbs.sum(axis=1))} | {unsaid} | {row.lost.sum()} |")  # fmt: skip
    print("\n| views | clips | as named, mm | if exchanged, mm | clips with exchanged limbs | of these unsaid | "
          "frames off | said of these | said of the others | frames/s |\n" + "| --- " * 10 + "|")  # fmt: skip
    for count in dict.fromkeys(count for _, count in rows):
        mine = [row for (_, views), row in rows.items() if views == count]
        limbs = [np.any(list(row.exchanged.values()), axis=0) for row in mine]
        some = sum(bool(limb.any()) for limb in limbs)
        unsaid = sum(bool((limb & ~row.lost).any()) for limb, row in zip(limbs, mine, strict=True))
        named, best, lost = (np.concatenate([getattr(row, key) for row in mine]) for key in ("named", "best", "lost"))
        off = named > OFF
        said = f"{100 * lost[off].mean():.0f} %" if off.any() else ""
        print(f"| {count} | {len(mine)} | {1e3 * named.mean():.0f} | {1e3 * best.mean():.0f} | {some} | {unsaid} | "
              f"{off.sum()} of {len(off)} | {said} | {100 * lost[~off].mean():.1f} % | "
              f"{np.mean([row.rate for row in mine]):.0f} |")  # fmt: skip


def main() -> None:
    """Read the command line."""
    parser = make_parser(__doc__)
    parser.add_argument("--people", choices=list(_PEOPLE), default="kept")
    parser.add_argument("--clips", type=int, default=30)
    parser.add_argument("--views", default="2,4")
    parser.add_argument("--start", choices=("auto", "truth", "exchanged"), default="auto")
    given = parser.parse_args()
    kinds, rows = list_kinds(given.data, _PEOPLE[given.people]), {}
    for number in range(given.clips):
        path = given.kept / f"{given.people}_{number:03d}.npz"
        if not path.is_file():
            seed = 1000 * list(_PEOPLE).index(given.people) + number
            make_clip(path, open_mesh(given.mesh), kinds[number % len(kinds)], seed)
        for count in map(int, given.views.split(",")):
            rows[path.stem, count] = track_clip(read_clip(path), count, given.start)
    print_outcomes(rows)


if __name__ == "__main__":
    main()
