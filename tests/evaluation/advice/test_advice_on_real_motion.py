"""Advice on a real dance in which one limb was moved by a known angle: which way, and how far, is found again."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dousa.evaluation import SEGMENTS
from dousa.evaluation.advice.directions import PairedDancers, find_corrections
from dousa.evaluation.posture.posture import compute_postures
from dousa.formats.registry import read_motion
from dousa.motion import JOINT_INDEX as J
from dousa.motion import CanonicalMotion, canonicalise, compute_trajectories
from lab.injection.injection import simulate_performer

DANCE = "bandai_dance/dataset-1_dance-short_normal_001.bvh"
ARM, LEG = ("shoulder", "elbow", "wrist", "hand"), ("hip", "knee", "ankle", "toe")
N_TRIALS, HALF_S, FADE_S, AROUND_S, UNTIL_S = 60, 0.7, 0.25, 1.5, 40.0


@pytest.fixture(scope="module")
def dance() -> CanonicalMotion:
    path = Path(__file__).resolve().parents[3].parent / "shared" / "data" / DANCE
    if not path.exists():
        pytest.skip(f"{path} is not here")
    return canonicalise(compute_trajectories(read_motion(path)))


def turn(positions: np.ndarray, joint: str, moved: tuple[str, ...], vectors: np.ndarray) -> np.ndarray:
    """Joints turned about another one, by a rotation vector (T, 3) of each frame."""
    side = joint.split("_", maxsplit=1)[0]
    places, root = [J[f"{side}_{name}"] for name in moved], positions[:, [J[joint]]]
    spin = Rotation.from_rotvec(vectors).as_matrix()
    out = positions.copy()
    out[:, places] = np.einsum("tij,tkj->tki", spin, positions[:, places] - root) + root
    return out


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-9)


def spoil(
    positions: np.ndarray, what: str, side: str, limb: tuple[str, ...], degrees: np.ndarray
) -> tuple[np.ndarray, tuple[str, ...], np.ndarray]:
    """A limb lowered, or an elbow or knee less bent, by an angle (T,); the wrong segments, and (T,) how the limb was:
    its elevation or bend, degrees."""
    root, middle, end = (f"{side}_{name}" for name in limb[:3])
    names = ("upper_arm", "forearm") if limb == ARM else ("thigh", "shank")
    segments = tuple(f"{side}_{name}" for name in names)
    upper, lower = positions[:, J[middle]] - positions[:, J[root]], positions[:, J[end]] - positions[:, J[middle]]
    if what == "up":
        axis = unit(np.cross((upper + lower) * [1.0, 0.0, 1.0], [0.0, 1.0, 0.0]))
        before = np.degrees(np.arcsin(unit(upper + lower)[:, 1]))
        vectors = -axis * np.radians(degrees)[:, None]
        return turn(positions, root, limb[1:], vectors), segments, before
    before = np.degrees(np.arccos(np.clip((unit(upper) * unit(lower)).sum(axis=1), -1.0, 1.0)))
    vectors = -unit(np.cross(upper, lower)) * np.radians(degrees)[:, None]
    return turn(positions, middle, limb[2:], vectors), segments[1:], before


def test_the_direction_and_the_amount_are_found_again(dance: CanonicalMotion) -> None:
    rng = np.random.default_rng(7)
    performed = simulate_performer(dance, rng, noise_deg=3.0)
    reference, rate = compute_postures(dance), dance.frame_rate
    count = min(performed.n_frames, dance.n_frames)
    times = np.arange(count) / rate
    said, errors, tried = 0, [], 0
    while tried < N_TRIALS:
        what, side = rng.choice(["up", "bend"]), rng.choice(["left", "right"])
        limb = ARM if rng.random() < 0.6 else LEG
        middle, amount = rng.uniform(AROUND_S, min(UNTIL_S, dance.duration) - AROUND_S - 0.1), rng.uniform(20.0, 45.0)
        span = slice(round((middle - AROUND_S) * rate), round((middle + AROUND_S) * rate))
        share = np.clip((HALF_S - np.abs(times[span] - middle)) / FADE_S, 0.0, 1.0)
        ours, segments, before = spoil(performed.positions[span], what, side, limb, amount * share)
        there = before[share > 0.0]
        if np.abs(there).max() > 45.0 if what == "up" else there.min() < amount + 5.0:
            continue  # it would pass the vertical, or bend the wrong way
        tried += 1
        ours = ours @ Rotation.from_rotvec([0.0, rng.uniform(-3.0, 3.0), 0.0]).as_matrix().T
        postures = compute_postures(dataclasses.replace(performed, positions=ours, missing=None))
        dancers = PairedDancers(reference, postures, times[span], span.start / rate)
        pairs = dancers.pair(middle - HALF_S, middle + HALF_S)
        assert pairs is not None
        found = find_corrections(pairs.find_worst([SEGMENTS.index(name) for name in segments]), segments)
        if found and found[0].direction == what:
            said += 1
            errors.append(abs(found[0].amount_deg - amount))
    assert said >= 0.95 * tried
    assert np.mean(errors) < 5.0
