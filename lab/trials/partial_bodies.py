"""How well a body of which a part is missing is recognised, and finds whole bodies that do the same.

HDM05 and UTD-MHAD, one of the people left out at a time: joints of that person's clips are hidden, the clips of the
others are whole. ``forest`` is what ``dousa search`` and ``classify`` do: a forest learned from the clips of the others
as if they lacked the same joints. Beside it: the forest of whole bodies, where the features that need a hidden joint
have their mean of the training clips; the clip nearest by dynamic time warping of the joints that both have; the same
by the distance of the mean poses. Joints are seen from the pelvis in body axes, over the body height by the bones that
are left, for all alike. Columns: share of clips whose category is right; share of the five best clips that have it
(forest: the fused ranking). Run: python -m lab.trials.partial_bodies

    python -m lab.trials.partial_bodies --library LIB

tells instead how long somebody waits who searches a trained library, of which a copy is made, with each of these bodies
for the first time, for the second, and after clips were added: seconds on the clock, and of processors.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from dousa.app.pipelines.experiment_clips import read_labelled_clips
from dousa.formats import ReadOptions
from dousa.library import Library
from dousa.motion import CANONICAL_JOINTS, JOINT_INDEX
from dousa.retrieval import FEATURE_SETS, MotionForest, compute_pose_sequence
from dousa.retrieval.features.channels import sample_positions
from dousa.retrieval.features.feature_sets import FeatureSet
from dousa.retrieval.features.pose_features import turn_to_body
from dousa.retrieval.features.posed_motion import hide_joints
from dousa.retrieval.ranking.ranking import compute_with_poses, warp_distances
from lab.places import SHARED_DATA
from lab.ranking.dense import Gallery, rank_clips

DATA = SHARED_DATA
SETS = {
    "HDM05": ("hdm05", "folder", "name:HDM_(..)_"),
    "UTD-MHAD": ("utd_mhad/skeleton", "name:^(a\\d+)_", "name:_(s\\d+)_"),
}
SIDES = ("left", "right")
INSTANTS, FIRST, ADDED = 32, 5, 64
MEASURED = ("hip", "knee", "ankle", "shoulder", "elbow", "hand")


def name(*joints: str) -> tuple[str, ...]:
    return tuple(f"{side}_{joint}" for side in SIDES for joint in joints)


HIDDEN = {
    "whole body": (),
    "no hands": name("wrist", "hand"),
    "no left arm": ("left_elbow", "left_wrist", "left_hand"),
    "no arms": name("elbow", "wrist", "hand"),
    "upper body only": ("pelvis", "spine", *name("hip", "knee", "ankle", "toe")),
    "legs only": ("spine", "neck", "head", *name("shoulder", "elbow", "wrist", "hand")),
    "right arm and hips": tuple(
        joint
        for joint in CANONICAL_JOINTS
        if joint not in ("pelvis", "right_shoulder", "right_elbow", "right_wrist", "right_hand", *name("hip"))
    ),
}


def grow(kind: FeatureSet, features: np.ndarray, labels: np.ndarray, seed: int) -> MotionForest:
    forest = MotionForest(thresholds=kind.thresholds, random_state=seed, n_jobs=-1)
    return forest.fit(features, labels, feature_set=kind)


def place(clip: object, kind: FeatureSet) -> np.ndarray:
    """(INSTANTS, 3 J) float32 joints that are not hidden, in body axes and body heights."""
    seen = kind.complete(clip)
    points = sample_positions(seen.positions, seen.frame_rate)
    body = turn_to_body((points - points[:, :1]) / seen.height)
    joints = [JOINT_INDEX[one] for one in ("head", *name(*MEASURED)) if one not in kind.hidden]
    instants = ((np.arange(INSTANTS) + 0.5) * len(body) / INSTANTS).astype(int)
    return body[instants][:, joints].reshape(INSTANTS, -1).astype(np.float32)


def warp(query: np.ndarray, gallery: np.ndarray) -> np.ndarray:
    starts, distances = np.arange(len(gallery)) * INSTANTS, np.empty(len(gallery))
    warp_distances(query, gallery.reshape(-1, query.shape[1]), starts, starts + INSTANTS, 0.2 * INSTANTS, distances)
    return distances


def score(order: np.ndarray, labels: np.ndarray, own: str) -> tuple[float, float]:
    return float(labels[order[0]] == own), float(np.mean(labels[order[:FIRST]] == own))


def measure(clips: list, hidden: tuple[str, ...], n_seeds: int) -> dict[str, np.ndarray]:
    """(right category, precision of the first five) of each method, in percent."""
    whole = FEATURE_SETS["extended"]
    kind = whole.without(hidden)
    labels, people = (np.array([getattr(clip, field) for clip in clips]) for field in ("category", "performer"))
    parts = [hide_joints(clip, kind.hidden) for clip in clips]
    features = np.stack([kind.compute(part) for part in parts])
    full = np.stack([whole.compute(clip) for clip in clips])
    poses = compute_with_poses(parts, kind)[1]
    placed = np.stack([place(part, kind) for part in parts])
    answered = np.concatenate([np.tile(kind.answered, 1), [True], kind.answered, kind.answered])
    found: dict[str, list[tuple[float, float]]] = {
        "forest": [],
        "whole forest, means": [],
        "warping": [],
        "mean pose": [],
    }
    for person in sorted(set(people)):
        train, test = np.flatnonzero(people != person), np.flatnonzero(people == person)
        filled = np.where(answered, features[test], full[train].mean(axis=(0, 1)))
        for seed in range(n_seeds):
            forest = grow(kind, features[train], labels[train], seed)
            leaves, votes = forest.apply(features), forest.predict_proba(features)
            gallery = Gallery(votes[train], leaves[train], poses[train])
            guesses = forest.predict(features[test])
            naive = grow(whole, full[train], labels[train], seed)
            for row, clip in enumerate(test):
                order = rank_clips("fused", (votes[clip], leaves[clip], poses[clip]), gallery).order
                right = float(guesses[row] == labels[clip])
                found["forest"].append((right, score(order, labels[train], labels[clip])[1]))
            found["whole forest, means"] += [
                (float(said == own), np.nan) for said, own in zip(naive.predict(filled), labels[test], strict=True)
            ]
        for clip in test:
            near = warp(placed[clip], placed[train])
            mean = np.linalg.norm(placed[train].mean(axis=1) - placed[clip].mean(axis=0), axis=1)
            found["warping"].append(score(np.argsort(near, kind="stable"), labels[train], labels[clip]))
            found["mean pose"].append(score(np.argsort(mean, kind="stable"), labels[train], labels[clip]))
    return {method: 100.0 * np.array(values).mean(axis=0) for method, values in found.items()}


def time_first(path: Path, only: str) -> None:
    """Search a copy of a library with its first clip, of which joints are hidden: twice, and when more was added."""
    print("| joints of the query | first search, s | CPU s | second, s | after an add, s | CPU s |")
    print("| --- | --- | --- | --- | --- | --- |")
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / path.name
        shutil.copy(path, copy)
        with Library.open(copy) as library:
            clips = library.clips()
            library.search(clips[0].id)
            motion = library.trajectories(clips[0].id)
            for number, (case, hidden) in enumerate(HIDDEN.items()):
                if only not in case:
                    continue
                positions = np.array(motion.positions)
                positions[:, [JOINT_INDEX[joint] for joint in hidden]] = np.nan
                query = motion.replace(positions=positions, rest_positions=None)
                took = [time_search(library, query) for _ in range(2)]
                for clip in clips[number :: len(clips) // ADDED][:ADDED]:
                    again = library.trajectories(clip.id)
                    larger = again.replace(positions=np.array(again.positions) * 1.03, rest_positions=None)
                    library.add_motion(larger, f"{clip.path} larger", f"{clip.category} again")
                library.search(clips[0].id)
                took.append(time_search(library, query))
                (first, processors), (second, _), (later, more) = took
                print(
                    f"| {case} | {first:.1f} | {processors:.1f} | {second:.3f} | {later:.1f} | {more:.1f} |", flush=True
                )


def time_search(library: Library, query: object) -> tuple[float, float]:
    """Seconds on the clock, and of processors."""
    clock, processors = time.perf_counter(), time.process_time()
    library.search(query)
    return time.perf_counter() - clock, time.process_time() - processors


def main() -> None:
    parser = argparse.ArgumentParser(description="Bodies of which a part is missing, people held out.")
    parser.add_argument("--set", choices=SETS, help="only this data set")
    parser.add_argument("--only", default="", metavar="WORD", help="only bodies with this word in their name")
    parser.add_argument("--seeds", type=int, default=3, help="forests of each kind")
    parser.add_argument("--library", type=Path, metavar="LIB", help="time the first searches of this library instead")
    asked = parser.parse_args()
    if asked.library is not None:
        time_first(asked.library, asked.only)
        return
    for title, (folder, category, performer) in SETS.items():
        if asked.set not in (None, title):
            continue
        if not (DATA / folder).is_dir():
            print(f"{title}: no recordings in {DATA / folder}")
            continue
        clips = read_labelled_clips(
            [DATA / folder], category_from=category, performer_from=performer, options=ReadOptions()
        )[0]
        compute_pose_sequence(clips[0])
        print(f"\n{title}: {len(clips)} clips, {len({clip.category for clip in clips})} categories")
        print("| joints of the query | forest | whole forest, means | warping | mean pose |")
        print("| --- | --- | --- | --- | --- |")
        for case, hidden in HIDDEN.items():
            if asked.only not in case:
                continue
            started = time.perf_counter()
            found = measure(clips, hidden, asked.seeds)
            cells = [
                f"{right:.1f}" if np.isnan(first) else f"{right:.1f} / {first:.1f}" for right, first in found.values()
            ]
            print(f"| {case} | {' | '.join(cells)} |", flush=True)
            print(f"{case}: {time.perf_counter() - started:.0f} s", file=sys.stderr)


if __name__ == "__main__":
    main()
