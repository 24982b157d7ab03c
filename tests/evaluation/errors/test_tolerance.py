"""Tolerance: least and most, steadier and less steady performers, and what errors do to it."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pytest
from oracles.wrong_dances import ARM, EVEN, be_late, compare_dances, get_dance, thin, turn_limb

from dousa.evaluation import assess
from dousa.evaluation.errors.deviations import compute_deviations, merge_takes
from dousa.evaluation.errors.evidence import SLACK_S, Tolerance, measure_unsteadiness
from dousa.evaluation.grade.references import choose_tolerance, prepare_references
from dousa.evaluation.posture.posture import compute_postures
from dousa.motion import CanonicalMotion
from lab.injection.injection import simulate_performer

MOTION = get_dance()
LEFT_ARM, RIGHT_ARM = ([f"{side}_{joint}" for joint in ARM] for side in ("left", "right"))


def measure(performance: CanonicalMotion) -> Tolerance:
    return measure_unsteadiness(compare_dances(performance, MOTION))


def test_of_the_steadiest_the_least_is_tolerated() -> None:
    tolerance = measure(MOTION)
    assert np.degrees(tolerance.angle) == pytest.approx(10.0)
    assert tolerance.lag_s == SLACK_S


def test_of_the_less_steady_more_is_tolerated_up_to_a_bound() -> None:
    steadiness = [
        measure(simulate_performer(MOTION, 1, noise_deg=noise, bias_deg=0.0, timing_ms=5.0)).angle.mean()
        for noise in (2.0, 7.0, 12.0, 40.0)
    ]
    assert all(a <= b + 1e-12 for a, b in pairwise(steadiness))
    assert np.degrees(steadiness[0]) < 11.0 < np.degrees(steadiness[1])
    assert np.degrees(steadiness[-1]) == pytest.approx(21.6, abs=0.5)


def test_an_error_hardly_moves_the_tolerance() -> None:
    clean = simulate_performer(MOTION, 3, noise_deg=6.0)
    wrong = turn_limb(clean, LEFT_ARM, 60.0, 4.0, 8.0)
    assert measure(wrong).angle == pytest.approx(measure(clean).angle, rel=0.25)
    assert measure(be_late(MOTION, 0.3, 4.0, 8.0)).lag_s == SLACK_S


def test_no_lag_is_forgiven_without_bound() -> None:
    for performance in (be_late(MOTION, 0.45, 1.0, 19.0), simulate_performer(MOTION, 2, timing_ms=200.0)):
        assert SLACK_S <= measure(performance).lag_s <= 0.3


def test_one_take_widens_nothing_and_unlike_takes_do() -> None:
    habit = turn_limb(MOTION, LEFT_ARM, 35.0, 2.0, 18.0)
    takes = [thin(one) for one in (MOTION, habit, MOTION)]
    clock = np.arange(float(takes[0].n_frames))
    played = thin(simulate_performer(MOTION, 5))
    each = [compute_deviations(take, played, clock, EVEN) for take in takes]
    alone, two = choose_tolerance(merge_takes(each[:1])), choose_tolerance(merge_takes(each[:2]))
    assert (alone.angle == measure_unsteadiness(each[0]).angle).all()
    assert (two.angle[[1, 2]] > alone.angle[[1, 2]]).all()
    # Of three takes, one with a habit is outvoted.
    assert choose_tolerance(merge_takes(each)).angle[[1, 2]] == pytest.approx(alone.angle[[1, 2]], rel=0.3)


def test_what_one_take_does_is_tolerated_in_the_next() -> None:
    habit = turn_limb(MOTION, LEFT_ARM, 35.0, 6.0, 8.0)
    takes = [MOTION, simulate_performer(habit, 1), simulate_performer(MOTION, 2)]
    performance = simulate_performer(habit, 5)

    def accuses_the_arm(references: Sequence[CanonicalMotion]) -> bool:
        return any("left_upper_arm" in event.segments for event in assess(references, performance).events)

    assert accuses_the_arm(takes[:1])
    assert not accuses_the_arm(takes)


def test_a_slip_of_one_take_excuses_nobody() -> None:
    """Both arms wrong for more than a second are seen, though one of five takes has a glitch elsewhere."""
    glitch = turn_limb(MOTION, LEFT_ARM, 140.0, 11.0, 11.4)
    takes = [MOTION, *(simulate_performer(MOTION, seed) for seed in (1, 2, 3)), simulate_performer(glitch, 4)]
    wrong = turn_limb(turn_limb(MOTION, LEFT_ARM, 60.0, 5.0, 7.0), RIGHT_ARM, 60.0, 5.0, 7.0)
    events = assess(takes, simulate_performer(wrong, 9)).events
    assert any(4.0 < event.start_s < 6.0 and {"left_forearm", "right_forearm"} & {*event.segments} for event in events)


def test_takes_keep_the_clock_of_most_of_them() -> None:
    """The first take hurries for a while; the others do not: theirs is the clock."""
    hurried = be_late(MOTION, -0.25, 6.0, 10.0)
    takes = [hurried, MOTION, simulate_performer(MOTION, 1), simulate_performer(MOTION, 2)]
    references = prepare_references([compute_postures(take) for take in takes], "same", EVEN)
    rate = references.working[0].frame_rate
    early = (np.arange(len(references.clock)) - references.clock)[round(7.0 * rate) : round(9.0 * rate)] / rate
    assert np.median(early) == pytest.approx(0.25, abs=0.06)
    alone = prepare_references([compute_postures(MOTION)], "same", EVEN)
    assert (alone.clock == np.arange(len(alone.clock))).all() and not alone.time_spread.any()
