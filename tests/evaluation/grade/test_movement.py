"""How far one movement is from another: what does not matter, what does, and who does not move."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dousa.evaluation import assess, compute_postures
from dousa.evaluation.grade.movement import (
    N_PARTS,
    compare_movements,
    describe_movement,
    find_agreement,
    find_coverage,
    find_parts,
    find_side,
)
from dousa.formats.motion_files import read_canonical
from dousa.motion import CanonicalMotion, mirror_canonical
from dousa.motion.canonical.joints import JOINT_INDEX as J

Shared = Callable[[str], Path]
EQUAL = np.ones(9)


@pytest.fixture
def raises(shared_data: Shared) -> list[CanonicalMotion]:
    """Abductions of the left arm by one person."""
    return [read_canonical(path)[0] for path in sorted(shared_data("irds/g4/correct").glob("*.trc"))]


def measure(references: Sequence[CanonicalMotion], performance: CanonicalMotion) -> tuple[np.ndarray, float]:
    """The parts, and what was danced."""
    ours = describe_movement(compute_postures(performance))
    differences = [compare_movements(describe_movement(compute_postures(one)), ours) for one in references]
    return find_parts(differences, find_agreement(()), EQUAL), find_coverage(differences, EQUAL)


def turn(motion: CanonicalMotion, angle: float) -> CanonicalMotion:
    cos, sin = np.cos(angle), np.sin(angle)
    return replace(motion, positions=motion.positions @ np.array([[cos, 0.0, -sin], [0.0, 1.0, 0.0], [sin, 0.0, cos]]))


def slow_down(motion: CanonicalMotion) -> CanonicalMotion:
    return replace(motion, frame_rate=0.7 * motion.frame_rate)


def grow(motion: CanonicalMotion) -> CanonicalMotion:
    return replace(motion, positions=1.3 * motion.positions + [2.0, 0.0, -1.0], height=1.3 * motion.height)


def hold_arm_elsewhere(motion: CanonicalMotion) -> CanonicalMotion:
    """The idle right arm, bent throughout."""
    positions = motion.positions.copy()
    front = np.array([0.0, 0.0, 0.25])
    for joint in ("wrist", "hand"):
        positions[:, J[f"right_{joint}"]] = positions[:, J["right_elbow"]] + front
    return replace(motion, positions=positions)


@pytest.mark.parametrize("change", [lambda one: one, lambda one: turn(one, 1.0), slow_down, grow, hold_arm_elsewhere])
def test_place_heading_stature_tempo_and_an_idle_arm_are_no_way(
    raises: list[CanonicalMotion], change: Callable[[CanonicalMotion], CanonicalMotion]
) -> None:
    (path, extent, *_), danced = measure(raises[:1], change(raises[0]))
    other = measure(raises[:1], raises[1])[0]
    assert path < 0.6 * other[0] and extent < 0.15 and danced > 0.95


def test_a_trunk_that_leans_along_is_seen_beside_a_large_movement(raises: list[CanonicalMotion]) -> None:
    motion, positions = raises[0], raises[0].positions.copy()
    upper = [J[name] for name in J if not name.endswith(("hip", "knee", "ankle", "toe")) and name != "pelvis"]
    lean = 0.15 * np.sin(np.linspace(0.0, np.pi, motion.n_frames))
    positions[:, upper] += np.stack([lean, np.zeros_like(lean), np.zeros_like(lean)], axis=1)[:, None]
    leaning = describe_movement(compute_postures(replace(motion, positions=positions)))
    found = compare_movements(describe_movement(compute_postures(motion)), leaning)
    extra = np.sqrt(np.nanmean(((found.ours - found.theirs) ** 2).sum(axis=2), axis=0)) / found.noise
    assert extra.argmax() == 0 and extra[0] > 0.5


def test_no_single_reference_decides(raises: list[CanonicalMotion]) -> None:
    odd = mirror_canonical(raises[2])
    agreed, with_odd = (measure(some, raises[3])[0][0] for some in (raises[:3], [odd, *raises[:2]]))
    assert with_odd < 1.5 * agreed < measure([odd], raises[3])[0][0]


def test_who_stands_still_has_not_done_it(raises: list[CanonicalMotion]) -> None:
    motion = raises[0]
    jitter = 0.003 * np.random.default_rng(0).standard_normal(motion.positions.shape)
    still = replace(motion, positions=motion.positions[:1] + jitter)
    assert measure(raises[1:4], still)[1] < 0.05
    found = assess(raises[1:4], still)
    assert np.isnan(found.score) and found.score_formula.code == "grade.hardly"


def test_the_side_is_found(raises: list[CanonicalMotion]) -> None:
    takes = [compute_postures(one) for one in raises[:3]]
    assert find_side(takes, compute_postures(raises[3])) == "same"
    assert find_side(takes, compute_postures(mirror_canonical(raises[3]))) == "mirrored"
    found = assess(raises[:3], mirror_canonical(raises[3]), side="auto")
    assert found.side == "mirrored" and found.score == pytest.approx(assess(raises[:3], raises[3]).score, abs=1e-6)


@pytest.mark.parametrize(
    ("unseen", "code"),
    [
        (slice(None), "grade.unseen"),
        (slice(6, -6), "grade.unseen"),
        (slice(None, None, 5), "grade.calibrated"),
    ],
)
def test_an_arm_that_is_not_seen_has_no_grade(raises: list[CanonicalMotion], unseen: slice, code: str) -> None:
    positions = raises[3].positions.copy()
    positions[unseen, J["right_elbow"] : J["right_hand"] + 1] = np.nan  # it is this arm that moves
    found = assess(raises[:3], replace(raises[3], positions=positions))
    assert found.score_formula.code == code and np.isnan(found.score) == (code == "grade.unseen")


def test_a_part_that_is_never_seen_is_left_out(raises: list[CanonicalMotion]) -> None:
    positions = raises[1].positions.copy()
    positions[:, [J["right_wrist"], J["right_hand"], J["head"]]] = np.nan
    positions[1::2, J["left_knee"]] = np.nan  # how much it trembles is unknown
    distances, danced = measure(raises[:1], replace(raises[1], positions=positions))
    assert np.isfinite(distances).all() and danced > 0.9
    assert np.isnan(find_parts([], find_agreement(()), EQUAL)).all()
    assert find_agreement(()).shape == (N_PARTS,)
