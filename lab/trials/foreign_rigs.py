"""Whether bodies of foreign producers are understood when their names and trees are not as they were.

The rigs and point sets of ``../shared/data``, one file of each skeleton: as they are, with what programs put before and
behind all names, cut to a part of the body, exchanged left and right, and (rigs) with names that say nothing. Truth is
what the untouched file gives, where its names are known. A row for each change: right; fewer joints than the file has;
refused; wrong, but with a note of it; WRONG without one. Twice: for the half of the producers on which rules may be
chosen, and for the half kept back (by the SHA-256 of the producer's name). Run: python -m lab.trials.foreign_rigs
[--bodies N] [--shown N], which prints the first N that are not right.
"""

from __future__ import annotations

import argparse
import hashlib
from collections import Counter, defaultdict
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dousa.errors import DousaError
from dousa.formats.guard import check_body
from dousa.formats.registry import read_motion
from dousa.motion import JOINT_INDEX, CanonicalMotion, Motion, Trajectories, canonicalise, compute_trajectories, thin
from dousa.motion.canonical.naming import REQUIRED_JOINTS
from dousa.motion.canonical.reference_frame import infer_reference_frame
from lab.places import SHARED_DATA

FOLDERS = ("bandai", "cmu86", "foreign", "hdm05", "irds", "pose2sim", "uiprmd", "utd_mhad", "utkinect")
SIDES = ("left", "right")
LIMBS = {"arm": ("shoulder", "elbow", "wrist"), "leg": ("hip", "knee", "ankle")}
NEAR = 0.06  # m: joints that lie on each other's place
USUAL = {"canonical.part", "canonical.skin_markers", "canonical.made_toes", "canonical.leaps"}  # say nothing of the map

SPELLINGS: dict[str, Callable[[str], str]] = {
    "as it is": lambda name: name,
    "NAME_JNT": lambda name: f"{name}_JNT",
    "NAMEbind": lambda name: f"{name}bind",
    "Bip01_NAME": lambda name: f"Bip01_{name}",
    "Hero:rig:NAME": lambda name: f"Hero:rig:{name}",
    "rp_anna_003_NAME": lambda name: f"rp_anna_003_{name}",
    "DEF-NAME and helpers": lambda name: f"DEF-{name}",
}
CUTS: dict[str, tuple[str, ...]] = {
    "without arms": ("left_arm", "right_arm"),
    "without legs": ("left_leg", "right_leg"),
    "without left arm": ("left_arm",),
    "without right leg": ("right_leg",),
    "one arm": ("left_arm", "left_leg", "right_leg"),
    "one leg": ("left_arm", "right_arm", "right_leg"),
    "left arm, right leg": ("right_arm", "left_leg"),
}
EXCHANGED = {"arms exchanged": ("arm",), "legs exchanged": ("leg",)}


@dataclass(frozen=True)
class Body:
    """A file: its points, and which of them are joints."""

    producer: str
    name: str
    points: Trajectories
    found: CanonicalMotion
    joints: dict[str, tuple[int, ...]]

    def limb(self, limb: str) -> set[int]:
        """Points of a limb: of a tree all below its first joint, else its joints and the points that lie next to it."""
        side, kind = limb.split("_")
        own = {p for joint in LIMBS[kind] for p in self.joints.get(f"{side}_{joint}", ())}
        if self.points.parents is not None:
            for point, parent in enumerate(self.points.parents):
                if parent in own:
                    own.add(point)
            return own
        joints = self.found.positions
        outer = [JOINT_INDEX[f"{side}_{joint}"] for joint in (*LIMBS[kind][1:], "hand" if kind == "arm" else "toe")]
        for point in range(len(self.points.names)):
            far = np.linalg.norm(self.points.positions[:, point, None] - joints, axis=2)
            if not np.isnan(far).all() and int(np.nanmedian(far, axis=0).argmin()) in outer:
                own.add(point)
        return own


def read_bodies(most: int = 1000) -> list[Body]:
    """One file of each producer and skeleton that holds all required joints, with a map by names; the first of them."""
    bodies, seen = [], set()
    for folder in FOLDERS:
        for path in sorted((SHARED_DATA / folder).rglob("*")):
            producer = path.parent.name if folder == "foreign" else folder
            if (
                len(bodies) == most
                or not path.is_file()
                or path.stat().st_size > 20_000_000
                or sum(one[0] == producer for one in seen) > 4
            ):
                continue
            try:
                motion = read_motion(path)
                points = compute_trajectories(motion) if isinstance(motion, Motion) else motion
                points = points.replace(positions=thin(points.positions, min(60, points.n_frames)))
                found = canonicalise(points)
            except DousaError:
                continue
            joints = {
                joint: tuple(points.names.index(n) for n in names) for joint, names in found.mapping.sources.items()
            }
            if found.mapping.table == "tree shape" or set(found.absent) & set(REQUIRED_JOINTS):
                continue
            if (producer, points.names) not in seen:
                seen.add((producer, points.names))
                bodies.append(Body(producer, path.name, points, found, joints))
    return bodies


def rename(body: Body, spell: Callable[[str], str], helpers: bool = False) -> Trajectories:
    """The points with other names; names of ends stay those of their bones, as readers give them."""
    names = body.points.names
    spelled = [
        f"{spell(name.removesuffix('_end'))}_end" if name.removesuffix("_end") in names and name.endswith("_end")
        else spell(name)
        for name in names
    ]  # fmt: skip
    points = body.points.replace(names=tuple(spelled))
    if not helpers:
        return points
    extra = 20
    places = np.repeat(points.positions[:, :1], extra, axis=1)
    return Trajectories(
        (*spelled, *(f"MCH-x{number}" for number in range(extra))),
        np.concatenate((points.positions, places), axis=1),
        points.frame_rate,
        None if points.parents is None else np.concatenate((points.parents, np.zeros(extra, np.intp))),
    )


def cut(body: Body, limbs: tuple[str, ...]) -> tuple[Trajectories, set[str]]:
    """The points without some limbs, and the required joints that are left."""
    gone = set().union(*(body.limb(limb) for limb in limbs))
    kept = [point for point in range(len(body.points.names)) if point not in gone]
    places = {old: new for new, old in enumerate(kept)}
    parents = body.points.parents
    tree = None if parents is None else np.array([places.get(int(parents[point]), -1) for point in kept])
    names = tuple(body.points.names[point] for point in kept)
    left = {joint for joint in REQUIRED_JOINTS if not set(body.joints.get(joint, ())) & gone}
    return Trajectories(names, body.points.positions[:, kept], body.points.frame_rate, tree), left


def exchange(body: Body, kinds: tuple[str, ...]) -> Trajectories:
    """The points with the names of left and right joints exchanged."""
    names = list(body.points.names)
    for kind in kinds:
        for joint in (*LIMBS[kind], {"arm": "hand", "leg": "toe"}[kind]):
            for a, b in zip(*(body.joints.get(f"{side}_{joint}", ()) for side in SIDES), strict=True):
                names[a], names[b] = names[b], names[a]
    return body.points.replace(names=tuple(names), parents=None, rest_positions=None)


def judge(body: Body, points: Trajectories, there: set[str]) -> str:
    """What is made of changed points of which these joints can be known."""
    try:
        found = canonicalise(points)
    except DousaError:
        limbs = [{f"{side}_{joint}" for joint in joints} for side in SIDES for joints in LIMBS.values()]
        return "refused" if any(limb <= there for limb in limbs) else "right"
    have = {joint for joint in REQUIRED_JOINTS if joint not in found.absent}
    off = np.linalg.norm(found.positions - body.found.positions[-found.n_frames :], axis=2)
    wrong = [joint for joint in have if not np.median(off[:, JOINT_INDEX[joint]]) < NEAR]
    if wrong:
        return "noted" if {note.code for note in found.warnings} - USUAL else "WRONG"
    return "right" if have >= there else "fewer"


def judge_exchange(points: Trajectories) -> str:
    """Whether the guard says that left and right contradict each other."""
    sample = points.replace(positions=thin(points.positions, min(10, points.n_frames)))
    notes = check_body(points.names, infer_reference_frame(sample, unit=1.0, up="y").body)
    return "right" if {note.code for note in notes} & {"guard.crossed", "guard.exchanged"} else "WRONG"


def try_all(body: Body) -> dict[str, str]:
    """Verdicts by change."""
    every = {joint for joint in REQUIRED_JOINTS if joint not in body.found.absent}
    answers = {}
    for title, spell in SPELLINGS.items():
        answers[title] = judge(body, rename(body, spell, "helpers" in title), every)
    for title, limbs in CUTS.items():
        answers[title] = judge(body, *cut(body, limbs))
    answers["one frame alone"] = judge(body, body.points.replace(positions=body.points.positions[-1:]), every)
    for title, kinds in EXCHANGED.items():
        answers[title] = judge_exchange(exchange(body, kinds))
    if body.points.parents is not None:
        numbered = body.points.replace(names=tuple(f"b{number}" for number in range(len(body.points.names))))
        answers["b1 b2 b3 (by the tree)"] = judge(body, numbered, every)
    return answers


def main() -> None:
    """Read the command line, try, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--shown", type=int, default=0, metavar="N", help="print the first N that are not right")
    parser.add_argument("--bodies", type=int, default=1000, metavar="N", help="take the first N only")
    given = parser.parse_args()
    shown, bodies = given.shown, read_bodies(given.bodies)
    counts: dict[str, tuple[Counter[str], Counter[str]]] = defaultdict(lambda: (Counter(), Counter()))
    for body in bodies:
        held = int(hashlib.sha256(body.producer.encode()).hexdigest(), 16) % 2
        for title, answer in try_all(body).items():
            counts[title][held][answer] += 1
            if answer != "right" and shown > 0:
                shown -= 1
                print(f"{answer}: {body.producer}/{body.name}, {title}")
    producers = {body.producer for body in bodies}
    print(f"{len(bodies)} skeletons and point sets of {len(producers)} producers; n: right/fewer/refused/noted/WRONG\n")
    print("| change | producers to choose on | producers kept back |\n| --- | --- | --- |")
    kinds = ("right", "fewer", "refused", "noted", "WRONG")
    for title, halves in counts.items():
        cells = (f"{half.total()}: " + "/".join(str(half[kind]) for kind in kinds) for half in halves)
        print(f"| {title} |", " | ".join(cells), "|")


if __name__ == "__main__":
    main()
