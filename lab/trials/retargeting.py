"""Motions on other skeletons: foot skating and limb directions of dousa, of upc-pymotion and of copied rotations.

Walking and turning on six skeletons of foreign producers, each onto the other five. Contacts are found in the source by
a rule of this program's own, not by dousa's: a joint of the foot at most 5 cm above the 5th percentile of its heights
and slower than 0.25 m/s, for a tenth of a second. Skating is how far the joint of the character is from its median
place in each contact: the 95th percentile over the frames of a pair; likewise how far standing toes are over or under
the height at which the character's stand. Direction: mean angle between upper and lower arms
and legs of source and character.

The peers: upc-pymotion's ``from_root_positions`` turns each joint to where the source's next joint is (it moves no
feet); the plain copy gives each joint the turn of the joint of the same meaning since the rest pose. Both move the
pelvis in proportion to the legs. Run: python -m lab.trials.retargeting [--pairs N] [--picture strip.png]

``--air PERSON`` : legs in the air instead. Kicks, hops and jogging of a person of HDM05 onto five characters: the
greatest angle of thigh or shank in frames in which ankle and toe are 15 and 10 cm above the 5th percentile of their
heights, skating as dousa tells it, and the root mean square jerk of knees and ankles over the source's. The numbers of
the feet were chosen on bd and bk; dg was left out.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Callable
from pathlib import Path

import numpy as np

from dousa.formats import read_character
from dousa.formats.registry import read_motion
from dousa.motion import CANONICAL_JOINTS, CANONICAL_PARENTS, canonicalise, compute_trajectories, retarget
from dousa.motion.canonical.joints import JOINT_INDEX as J
from dousa.motion.kinematics import forward_kinematics
from dousa.motion.retargeting import measure_directions
from dousa.motion.retargeting.rig import LIMB_NAMES, SIDES, build_rig
from dousa.motion.retargeting.transfer import find_floor
from dousa.motion.rotations import conjugate, multiply, rotate
from lab.places import SHARED_DATA

DATA = SHARED_DATA / "foreign"
SKELETONS = {
    "Mixamo": "mixamo_ganimator/Walk-In-Circle.bvh",
    "CMU": "pybvh/cmu_12_01_walk.bvh",
    "Xia": "xia_deepmotionediting/neutral_16_000.bvh",
    "ACCAD": "acclaim_male1_accad/Male1_B14_WalkTurnRight135.bvh",
    "SMPL": "unsupported/amass_sample.npz",
    "Vietnam": "cheo_vietnam_style/GatLua.bvh",
}
LOW, SLOW, SHORTEST, LONGEST = 0.05, 0.25, 0.1, 6.0  # m, m/s, s, s
AIR = np.array([0.15, 0.10])  # m, ankle and toe
AIR_KINDS = ("kickLFront1Reps", "hopBothLegs1hops", "jogLeftCircle4StepsRstart")
AIR_CHARACTERS = ("Mixamo", "CMU", "Xia", "ACCAD")
FEET = [f"{side}_{joint}" for side in ("left", "right") for joint in ("ankle", "toe")]


class Body:
    """A file: its motion, at most six seconds of it, canonical joints and rig."""

    def __init__(self, path: Path) -> None:
        self.character = read_character(path)
        motion = read_motion(path)
        n_frames = round(LONGEST * motion.frame_rate)
        self.motion = motion.replace(rotations=motion.rotations[:n_frames], translations=motion.translations[:n_frames])
        self.canonical = canonicalise(self.motion, whole=True)
        self.rig = build_rig(self.motion, self.canonical)

    def pelvis_for(self, source: Body) -> np.ndarray:
        """Where the middle of the hips goes (T, 3) m: in proportion to the legs, over the floor of the source's."""
        points = source.canonical.positions
        middle = 0.5 * (points[:, J["left_hip"]] + points[:, J["right_hip"]])
        start = middle[0].copy()
        start[1] = np.percentile(points[..., 1], 1)
        return start + self.rig.leg / source.rig.leg * (middle - start)


def by_dousa(source: Body, target: Body) -> np.ndarray:
    """Canonical joints (T, 20, 3) m of the character."""
    made = retarget(source.motion, target.character).motion
    places = compute_trajectories(made).positions
    return np.stack([places[:, target.rig.joints.get(name, 0)] for name in CANONICAL_JOINTS], axis=1)


def by_copying(source: Body, target: Body) -> np.ndarray:
    """Each joint turns since the reference pose as its counterpart does; the others stay to their parent."""
    rig, motion = target.rig, source.motion
    _, world = forward_kinematics(motion.skeleton.parents, motion.rotations, motion.translations)
    turns = multiply(world, conjugate(source.rig.world))
    facing = multiply(source.rig.body, conjugate(rig.body))
    counterpart = {joint: source.rig.joints[name] for name, joint in rig.joints.items() if name in source.rig.joints}
    counterpart |= {rig.pelvis: source.rig.pelvis, rig.chest: source.rig.chest, rig.head: source.rig.head}
    made = np.empty((motion.n_frames, len(rig.parents), 4))
    places = np.zeros((motion.n_frames, len(rig.parents), 3))
    for joint, parent in enumerate(rig.parents):
        if joint in counterpart:
            made[:, joint] = multiply(turns[:, counterpart[joint]], multiply(facing, rig.world[joint]))
        elif parent >= 0:
            made[:, joint] = multiply(made[:, parent], multiply(conjugate(rig.world[parent]), rig.world[joint]))
        else:
            made[:, joint] = multiply(turns[:, source.rig.pelvis], multiply(facing, rig.world[joint]))
        if parent >= 0:
            places[:, joint] = places[:, parent] + rotate(made[:, parent], rig.offsets[joint])
    joints = np.stack([places[:, rig.joints.get(name, 0)] for name in CANONICAL_JOINTS], axis=1)
    return joints + (target.pelvis_for(source) - _middle(joints))[:, None]


def by_pymotion(source: Body, target: Body) -> np.ndarray:
    """The canonical skeleton of the character, turned to the source's joints by upc-pymotion."""
    from pymotion.ops.skeleton_np import fk_quat, from_root_positions

    parents = np.array(CANONICAL_PARENTS)
    rest = np.stack([target.rig.places[target.rig.joints.get(name, 0)] for name in CANONICAL_JOINTS])
    for name, joint in J.items():  # joints that the character lacks lie at the one above
        if name not in target.rig.joints:
            rest[joint] = rest[parents[joint]] + 1e-3
    offsets = rest - rest[parents]
    offsets[0] = 0
    points = source.canonical.positions - source.canonical.positions[:, :1]
    rotations = from_root_positions(points, np.array([0, *parents[1:]]), offsets)
    joints, _ = fk_quat(rotations, np.zeros((len(points), 3)), offsets, np.array([0, *parents[1:]]))
    return joints + (target.pelvis_for(source) - _middle(joints))[:, None]


def _middle(joints: np.ndarray) -> np.ndarray:
    return 0.5 * (joints[:, J["left_hip"]] + joints[:, J["right_hip"]])


def find_contacts(points: np.ndarray, rate: float) -> list[slice]:
    """Stretches in which a point (T, 3) stands, by the rule above."""
    speed = np.linalg.norm(np.gradient(points, axis=0), axis=1) * rate
    stands = (points[:, 1] < np.percentile(points[:, 1], 5) + LOW) & (speed < SLOW)
    edges = np.flatnonzero(np.diff(np.concatenate(([False], stands, [False])).astype(int)))
    pairs = zip(edges[::2], edges[1::2], strict=True)
    return [slice(start, end) for start, end in pairs if end - start >= SHORTEST * rate]


def measure(source: Body, target: Body, joints: np.ndarray) -> tuple[float, float, float]:
    """Skating in cm, direction error in degrees, and how far standing toes are beside the floor, in cm."""
    away, off = [], [np.zeros(1)]
    floor = find_floor(source.canonical, source.rig) + target.rig.foot_heights()[1]
    for name in FEET:
        if name in source.rig.joints and name in target.rig.joints:
            for stretch in find_contacts(source.canonical.positions[:, J[name]], source.motion.frame_rate):
                stand = joints[stretch, J[name]]
                away.append(np.linalg.norm(stand - np.median(stand, axis=0), axis=1))
                off += [np.abs(stand[:, 1] - floor)] if name.endswith("toe") else []
    angles = measure_directions(source.canonical, joints, J)
    least, high = (100 * float(np.percentile(np.concatenate(some), 95)) for some in (away, off))
    return least, float(np.degrees(angles.mean())), high


def measure_air(person: str) -> None:
    """Print how far legs in the air point beside the source's, by kind of motion."""
    paths = [DATA / SKELETONS[name] for name in AIR_CHARACTERS] + [DATA / "unsupported/mixamo.glb"]
    characters = [read_character(path) for path in paths]
    rigs = [build_rig(one, canonicalise(one, any_skeleton=True, whole=True)) for one in characters]
    legs = {side: [LIMB_NAMES.index(f"{side}_{name}") for name in ("thigh", "shank")] for side in SIDES}
    print(
        "| motion | pairs | worst angle: median, largest (deg); over 5 | skating (cm) | jerk |\n" + "| --- " * 5 + "|"
    )
    for kind in AIR_KINDS:
        rows = []
        for path in sorted((SHARED_DATA / "hdm05" / kind).glob(f"HDM_{person}_*.amc")):
            motion = read_motion(path)
            source = canonicalise(motion, whole=True)
            points = source.positions
            for character, rig in zip(characters, rigs, strict=True):
                made = retarget(motion, character)
                places = compute_trajectories(made.motion).positions
                angles, worst = np.degrees(measure_directions(source, places, rig.joints)), 0.0
                for side in SIDES:
                    heights = points[:, [J[f"{side}_ankle"], J[f"{side}_toe"]], 1]
                    air = (heights > np.percentile(heights, 5, axis=0) + AIR).all(axis=1)
                    worst = max(worst, angles[air][:, legs[side]].max(initial=0.0))
                names = [f"{side}_{joint}" for side in SIDES for joint in ("knee", "ankle")]
                jerks = (np.diff(places[:, [rig.joints[name] for name in names]], 3, axis=0),
                         np.diff(points[:, [J[name] for name in names]], 3, axis=0))  # fmt: skip
                jerk = np.sqrt(np.square(jerks[0]).mean() / np.square(jerks[1]).mean()) / made.scale
                rows.append((worst, 100 * made.skating, jerk))
        angle, skating, jerk = np.array(rows).T
        print(f"| {kind} | {len(rows)} | {np.median(angle):.1f}, {angle.max():.1f}; {(angle > 5).sum()} "
              f"| {skating.mean():.2f} | {jerk.mean():.2f} |")  # fmt: skip


def draw(bodies: dict[str, Body], path: Path) -> None:
    """A row for each skeleton: the walk of the first on it, and its own on the first; the source is grey."""
    import matplotlib.pyplot as plt

    first, *others = bodies
    figure, axes = plt.subplots(len(others), 2, figsize=(11, 1.9 * len(others)), dpi=60)
    for row, name in zip(axes, others, strict=True):
        for axis, (start, end) in zip(row, ((first, name), (name, first)), strict=True):
            source, target = bodies[start], bodies[end]
            made = canonicalise(retarget(source.motion, target.character).motion, whole=True).positions
            for column, frame in enumerate(np.linspace(0, source.motion.n_frames - 1, 7).astype(int)):
                axes_of = source.canonical.positions[frame], made[frame]
                across = axes_of[0][J["left_hip"]] - axes_of[0][J["right_hip"]]
                ahead = np.cross(across, [0, 1, 0])
                ahead /= np.linalg.norm(ahead)
                for shift, points, colour in zip((0.0, 0.55), axes_of, ("0.65", "C0"), strict=True):
                    flat = (points - points[0]) @ ahead + 1.25 * column + shift
                    for joint, parent in enumerate(CANONICAL_PARENTS):
                        if parent >= 0:
                            axis.plot(flat[[joint, parent]], points[[joint, parent], 1], color=colour, linewidth=1.6)
            axis.axhline(np.percentile(made[:, [J[foot] for foot in FEET], 1], 1), color="0.85", linewidth=1, zorder=0)
            axis.set_title(f"{start} onto {end}", fontsize=9)
            axis.set_aspect("equal")
            axis.axis("off")
    figure.tight_layout()
    figure.savefig(path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", type=int, help="only so many pairs")
    parser.add_argument("--picture", type=Path, help="draw five skeletons each way, and measure nothing")
    parser.add_argument("--air", metavar="PERSON", help="legs in the air: bd, bk or dg")
    options = parser.parse_args()
    if not DATA.is_dir():
        print(f"{DATA} is not there")
        return
    if options.air:
        measure_air(options.air)
        return
    bodies = {name: Body(DATA / path) for name, path in SKELETONS.items()}
    if options.picture:
        draw(bodies, options.picture)
        return
    methods: dict[str, Callable[[Body, Body], np.ndarray]] = {"dousa": by_dousa, "copied rotations": by_copying}
    try:
        import pymotion  # noqa: F401

        methods["upc-pymotion"] = by_pymotion
    except ImportError:
        print("upc-pymotion is not installed; run: pip install 'dousa[bench]'")
    pairs = list(itertools.permutations(bodies.values(), 2))[: options.pairs]
    heads = ("skating", "direction (deg)", "standing toes beside the floor")
    print("| method | " + " | ".join(f"{head}: mean, worst pair" for head in heads) + " |\n" + "| --- " * 4 + "|")
    own = np.array([measure(body, body, body.canonical.positions) for body in bodies.values()])
    print(f"| the recordings themselves | {own[:, 0].mean():.2f}, {own[:, 0].max():.2f} | | |")
    for name, method in methods.items():
        cells = np.array([measure(*pair, method(*pair)) for pair in pairs]).T
        print(f"| {name} | " + " | ".join(f"{values.mean():.2f}, {values.max():.2f}" for values in cells) + " |")


if __name__ == "__main__":
    main()
