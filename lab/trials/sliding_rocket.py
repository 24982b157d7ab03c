"""A sliding MiniRocket for `label_takes.py`: aeon's features of two seconds around every moment, dousa's decoding.

The classifier is MiniRocket's own, a ridge on 10,000 features (Dempster, Schmidt, Webb, KDD 2021), of what a moment
shows: a category in one of three phases, or nothing. Its penalty and how sharp its answers are come from a third of the
people left out. The likeliest sequence, with the lengths and weights that dousa has learned from the same takes, makes
segments of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from dousa.arrays import FloatArray, IntArray
from dousa.experiments.annotated_takes import LabelTake
from dousa.motion.canonical.joints import JOINT_INDEX
from dousa.retrieval.features.channels import sample_positions
from dousa.retrieval.features.posed_motion import AnnotatedTake
from dousa.retrieval.takes.label import Segment
from dousa.retrieval.takes.labeller_training import train_labeller
from dousa.retrieval.takes.moment_model import HOP, sharpen
from dousa.retrieval.takes.sequence import N_PHASES, PHASE_FRAMES
from dousa.retrieval.takes.windows import TAKE_RATE

HALF = 30  # frames to either side
PENALTIES, SHARPNESSES = (1e2, 1e3, 1e4, 1e5), (3.0, 4.5, 6.5, 9.0, 13.0, 19.0, 28.0)
HIPS = [JOINT_INDEX["left_hip"], JOINT_INDEX["right_hip"]]


def cut_windows(take: AnnotatedTake) -> FloatArray:
    """(M, 57, 60) joints from the pelvis, turned to face ahead, in body heights, around every fifth of a second."""
    joints = sample_positions(take.positions, take.frame_rate) / take.height
    joints = joints - joints[:, :1]
    across = joints[:, HIPS[0]] - joints[:, HIPS[1]]
    turn = np.arctan2(across[:, 2], across[:, 0])[:, None]
    x = joints[..., 0] * np.cos(turn) + joints[..., 2] * np.sin(turn)
    z = joints[..., 2] * np.cos(turn) - joints[..., 0] * np.sin(turn)
    flat = np.stack([x, joints[..., 1], z], axis=2)[:, 1:].reshape(len(joints), -1)
    padded = np.pad(flat, ((HALF, HALF), (0, 0)), "edge")
    starts = np.minimum(np.arange(0, len(flat), HOP) + HOP // 2, len(flat) - 1)
    return np.stack([padded[start : start + 2 * HALF].T for start in starts])


def name_moments(take: AnnotatedTake, count: int, names: Sequence[str]) -> IntArray:
    """(M,) 3 c + phase of category c, 3 C for nothing, -1 where nobody can say."""
    states, at = np.full(count, -1), (np.arange(count) + 0.5) * HOP / TAKE_RATE
    for one in take.stretches:
        inside = (at >= one.start) & (at < one.stop) & one.counted
        if one.category is None:
            states[inside] = N_PHASES * len(names)
        else:
            edge = min(PHASE_FRAMES / TAKE_RATE, 0.5 * (one.stop - one.start))
            phase = 1 - (at[inside] < one.start + edge) + (at[inside] >= one.stop - edge)
            states[inside] = N_PHASES * names.index(one.category) + phase
    return states


def solve(seen: FloatArray, wanted: FloatArray, penalty: float) -> FloatArray:
    """Ridge regression, by the moments."""
    return seen.T @ np.linalg.solve(seen @ seen.T + penalty * np.eye(len(seen)), wanted)


def learn(takes: Sequence[AnnotatedTake]) -> LabelTake:
    """MiniRocket on every second moment; ImportError without aeon."""
    from aeon.transformations.collection.convolution_based import MiniRocket

    labeller = train_labeller([], takes)
    windows = [cut_windows(take) for take in takes]
    named = [name_moments(take, len(own), labeller.classes) for take, own in zip(takes, windows, strict=True)]
    people = np.repeat([str(take.performer) for take in takes], [len(own) for own in windows])
    states = np.concatenate(named)
    rows = np.flatnonzero(states >= 0)[::2]
    rocket: Any = MiniRocket(random_state=0)
    raw = np.asarray(rocket.fit_transform(np.concatenate(windows)[rows].astype(np.float32)), np.float32)
    middle, spread = raw.mean(axis=0), raw.std(axis=0) + 1e-6
    seen, wanted = (raw - middle) / spread, np.eye(N_PHASES * len(labeller.classes) + 1, dtype=np.float32)[states[rows]]
    out = np.isin(people[rows], sorted(set(people))[::3])
    best = (-np.inf, 0.0, 0.0)
    for penalty in PENALTIES:
        said = (seen[out] @ solve(seen[~out], wanted[~out], penalty)).astype(np.float32)
        for one in SHARPNESSES:
            right = (sharpen(said, one) * wanted[out]).sum(axis=1)
            best = max(best, (float(np.log(right + 1e-2).sum()), penalty, one))
    weights, sharpness = solve(seen, wanted, best[1]), best[2]

    def label(take: AnnotatedTake) -> dict[str, list[Segment]]:
        found = np.asarray(rocket.transform(cut_windows(take).astype(np.float32)), np.float32)
        shares = sharpen((((found - middle) / spread) @ weights).astype(np.float32), sharpness)
        names = (*labeller.classes, None)
        return {
            name: [
                Segment(run.start * HOP / TAKE_RATE, run.stop * HOP / TAKE_RATE, names[run.state], 1.0)
                for run in labeller.sequence.find_runs(shares, never_nothing=never)
            ]
            for name, never in (("sliding MiniRocket", False), ("sliding MiniRocket, never nothing", True))
        }

    return label
