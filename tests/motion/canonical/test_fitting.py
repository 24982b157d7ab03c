"""Rotations fitted to positions reproduce them."""

import numpy as np
import pytest
from oracles.bodies import walking_body

from dousa.formats.registry import read_motion
from dousa.motion import CANONICAL_JOINTS, canonicalise, compute_trajectories, fit_motion


def _error(canonical) -> float:
    fitted = compute_trajectories(fit_motion(canonical)).positions
    return float(np.linalg.norm(fitted - canonical.positions, axis=-1).mean())


def test_a_rigid_figure_is_reproduced() -> None:
    motion = fit_motion(walking_body())
    assert motion.skeleton.names == CANONICAL_JOINTS
    assert motion.n_frames == 20
    assert _error(canonicalise(walking_body())) < 1e-6


@pytest.mark.parametrize(
    ("folder", "limit"), [("hdm05/squat1Reps", 0.02), ("bandai/walk/youthful", 0.005), ("utd_mhad/skeleton/walk", 0.03)]
)
def test_recordings_are_followed(folder: str, limit: float, shared_data) -> None:
    for file in sorted(shared_data(folder).iterdir())[::5]:
        assert _error(canonicalise(read_motion(file))) < limit


def test_one_frame_and_a_folded_limb() -> None:
    canonical = canonicalise(walking_body(1))
    assert _error(canonical) < 1e-6
    moving = canonicalise(walking_body()).to_trajectories()
    positions = moving.positions.copy()
    positions[5, CANONICAL_JOINTS.index("left_wrist")] = positions[5, CANONICAL_JOINTS.index("left_elbow")]
    motion = fit_motion(moving.replace(positions=positions))
    assert np.isfinite(motion.rotations).all()
