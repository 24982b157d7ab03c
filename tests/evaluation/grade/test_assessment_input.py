"""Assessments of lapses and gaps, of bodies that lack joints, of what is no dance, and of real people."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from oracles.answers import check
from oracles.answers import judge as judge_answer
from oracles.wandering import make_wandering_motion
from oracles.wrong_dances import ARM, choose, cut, get_dance, lose, place, turn_limb

from dousa.errors import InvalidMotionError, OptionError
from dousa.evaluation import Assessment, advise, assess
from dousa.evaluation.posture.posture import LIMBS, SEGMENTS, spread_weights
from dousa.formats.registry import read_motion
from dousa.motion import CANONICAL_JOINTS, CanonicalMotion, canonicalise
from dousa.motion.synthetic import draw_performer, make_dance

LEFT_ARM = [f"left_{joint}" for joint in ARM]
LEFT_ARM_SEGMENTS = {"left_upper_arm", "left_forearm"}
MOTION = get_dance()
KICKS = [f"hdm05/kickLFront1Reps/HDM_bd_kickLFront1Reps_{number}_120.amc" for number in ("005", "006")]
REAL_FILES = ["bandai_dance/dataset-1_dance-short_normal_001.bvh", KICKS[0]]


def judge(performance: CanonicalMotion, reference: CanonicalMotion = MOTION, **options: object) -> Assessment:
    return judge_answer(performance, reference, **options)


# --- order and gaps -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("spans", "kind", "reference_span"),
    [
        (((4.0, 20.0),), "late start", (0.0, 4.0)),
        (((0.0, 14.0),), "early end", (14.0, 20.0)),
        (((0.0, 7.9), (11.5, 20.0)), "skip", (7.9, 11.5)),
        (((0.0, 11.5), (7.9, 20.0)), "repeat", (7.9, 11.5)),
    ],
)
def test_lapses_are_no_errors(
    spans: tuple[tuple[float, float], ...], kind: str, reference_span: tuple[float, float]
) -> None:
    found = judge(cut(MOTION, *spans))
    assert [lapse.kind for lapse in found.lapses] == [kind]
    (lapse,) = found.lapses
    assert lapse.reference_start_s == pytest.approx(reference_span[0], abs=0.3)
    assert lapse.reference_end_s == pytest.approx(reference_span[1], abs=0.3)
    assert found.events == ()
    assert (found.coverage > 0.97) == (kind == "repeat")
    assert found.score > 75.0 * found.coverage


def test_a_stop_is_a_lapse() -> None:
    frames = np.concatenate([np.arange(300), np.full(75, 300), np.arange(300, 600)])
    found = judge(choose(MOTION, frames))
    assert [lapse.kind for lapse in found.lapses] == ["stop"]
    assert found.lapses[0].start_s == pytest.approx(10.0, abs=0.4)
    assert found.lapses[0].end_s == pytest.approx(12.5, abs=0.4)
    assert len(found.events) <= 1


def test_errors_beside_a_lapse_are_found_at_their_place() -> None:
    wrong = turn_limb(MOTION, LEFT_ARM, 45.0, 14.0, 16.0)
    found = judge(cut(wrong, (0.0, 7.9), (11.5, 20.0)))
    assert [lapse.kind for lapse in found.lapses] == ["skip"]
    (event,) = found.events
    assert event.start_s == pytest.approx(14.1 - 3.6, abs=0.2)
    assert 14.0 <= event.reference_s <= 16.0


@pytest.mark.parametrize("joints", [["left_wrist"], LEFT_ARM, list(CANONICAL_JOINTS)])
def test_gaps_are_marked_and_not_judged(joints: list[str]) -> None:
    found = judge(lose(MOTION, joints, 6.0, 8.0))
    assert found.events == () and found.lapses == ()
    assert found.score > 80.0
    names = {name for *_, name in found.gaps}
    assert "left_forearm" in names and (len(names) == 9) == (len(joints) == 20)
    assert all((start, end) == pytest.approx((6.0, 8.0)) for start, end, _ in found.gaps)
    column = SEGMENTS.index("left_forearm")
    assert np.isnan(found.residual[180:240, column]).all() and np.isfinite(found.residual[:180]).all()
    assert np.isnan(found.d_space[180:240]).all() and np.isfinite(found.d_space[240:]).all()
    assert any("not seen" in str(warning) for warning in found.warnings)


def test_a_gap_hides_no_error_of_another_limb() -> None:
    found = judge(turn_limb(lose(MOTION, ["right_wrist"], 5.0, 9.0), LEFT_ARM, 45.0, 6.0, 8.0))
    (event,) = found.events
    assert event.kind == "partial" and set(event.segments) <= LEFT_ARM_SEGMENTS


def test_a_gap_in_a_reference_take_excuses_nobody() -> None:
    wrong = turn_limb(MOTION, LEFT_ARM, 45.0, 6.0, 8.0)
    gone = lose(MOTION, LEFT_ARM, 5.5, 8.5)
    # Of the only take: there is nothing to compare with.
    assert judge(wrong, gone).events == ()
    found = assess([MOTION, gone], wrong)
    check(found)
    assert any(LEFT_ARM_SEGMENTS & set(event.segments) for event in found.events)


def test_who_is_never_seen_is_not_judged() -> None:
    with pytest.raises(InvalidMotionError, match="body that is seen for at least"):
        judge(lose(MOTION, list(CANONICAL_JOINTS), 0.0, 20.0))
    never = judge(lose(MOTION, ["left_wrist"], 0.0, 20.0))
    assert never.events == () and np.isnan(never.d_space).all()
    assert never.score == pytest.approx(100.0, abs=0.1)


# --- input that is no dance -----------------------------------------------------------------------------------------


def test_nothing_in_common_is_told_instead_of_a_grade() -> None:
    for seed in range(4):
        found = judge(make_wandering_motion(12, seed))
        assert np.isnan(found.score) and found.score_formula.code == "grade.unlike"
        codes = {warning.code for warning in found.warnings}
        assert "assessment.unlike" in codes and "assessment.compared" not in codes, "no grade is for a part alone"
        assert len(found.events) + len(found.lapses) <= 4


def test_who_stands_still_is_told() -> None:
    still = choose(MOTION, np.zeros(300, int))
    found = judge(still)
    assert any("performer hardly moves" in str(warning) for warning in found.warnings)
    assert any("reference hardly moves" in str(warning) for warning in judge(MOTION, still).warnings)
    both = judge(still, still)
    assert both.score == 100.0 and both.events == () and both.lapses == ()


def test_a_reference_shorter_than_a_figure_is_enough() -> None:
    short = cut(MOTION, (0.0, 1.3))
    found = judge(MOTION, short)
    assert [lapse.kind for lapse in found.lapses] == ["lead-out"]
    assert len(found.furi) == 1 and found.furi[0].n_dims >= 1
    part = judge(cut(MOTION, (8.0, 9.0)))
    assert {lapse.kind for lapse in part.lapses} == {"late start", "early end"}
    assert part.coverage < 0.25
    assert not part.score >= 25.0


@pytest.mark.parametrize("rate", [0.5, 1.0, 2.0, 5.0, 12.0])
def test_slow_cameras_are_no_reason_to_fail(rate: float) -> None:
    slow = get_dance(20.0, rate)
    for reference, performance in ((slow, slow), (MOTION, slow)):
        assert judge(performance, reference).events == ()


def test_half_a_second_is_enough_and_less_is_not() -> None:
    assert judge(cut(MOTION, (4.0, 4.5)), cut(MOTION, (4.0, 4.5))).score == 100.0
    short = cut(MOTION, (4.0, 4.4))
    for reference, performance, who in ((MOTION, short, "performance"), (short, MOTION, "reference")):
        with pytest.raises(InvalidMotionError, match=f"{who}: expected a motion of at least 0.5 s"):
            assess(reference, performance)
    with pytest.raises(InvalidMotionError, match="2 frames"):
        assess(MOTION, replace(choose(MOTION, np.arange(2)), frame_rate=1.0))
    with pytest.raises(InvalidMotionError, match="reference"):
        assess([MOTION, short], MOTION)
    with pytest.raises(InvalidMotionError, match="at least one reference"):
        assess([], MOTION)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"side": "left"}, "side"),
        ({"tempo": "fast"}, "tempo"),
        ({"weights": {"tail": 1.0}}, "tail"),
        ({"weights": {"trunk": -1.0}}, "trunk"),
        ({"weights": {"trunk": float("nan")}}, "trunk"),
        ({"weights": dict.fromkeys(SEGMENTS, 0.0)}, "above 0"),
    ],
)
def test_options_that_there_are_not_are_refused(options: dict[str, object], message: str) -> None:
    with pytest.raises(OptionError, match=message):
        assess(MOTION, MOTION, **options)  # type: ignore[arg-type]


# --- real people ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", REAL_FILES)
def test_a_real_recording_is_like_itself_whoever_plays_it(name: str, shared_data: Callable[[str], Path]) -> None:
    motion = canonicalise(read_motion(shared_data(name)))
    same = judge(motion, motion)
    assert same.score == 100.0 and same.events == () and same.lapses == ()
    assert np.nanmax(same.residual) < 1e-6 and np.nanmax(np.abs(same.lag)) < 1e-6
    elsewhere = judge(place(motion, 2.0, 3.0, -1.0, 0.8), motion)
    assert elsewhere.score == pytest.approx(100.0, abs=0.001) and elsewhere.events == ()


def test_what_is_named_more_exactly_weighs_in_any_order() -> None:
    first = spread_weights({"left_forearm": 3.0, "left_arm": 1.0})
    assert np.array_equal(first, spread_weights({"left_arm": 1.0, "left_forearm": 3.0}))
    assert first[SEGMENTS.index("left_forearm")] == pytest.approx(3.0 * first[SEGMENTS.index("trunk")])
    for wrong in ("2", None, float("nan"), -1.0, 1e308):
        with pytest.raises(OptionError, match="left_arm: expected a number"):
            spread_weights({"left_arm": wrong})


def test_arms_and_legs_are_names_of_weights_everywhere():
    from dousa.evaluation.posture.posture import spread_weights

    both = spread_weights({"arms": 2.0, "left_forearm": 0.5})
    spelled = spread_weights({"left_arm": 2.0, "right_arm": 2.0, "left_forearm": 0.5})
    assert both.tolist() == spelled.tolist()


SIDES = ("left", "right")
ARMS = tuple(f"{side}_{joint}" for side in SIDES for joint in ("elbow", "wrist", "hand"))
UPPER = ("spine", "neck", "head", "left_shoulder", "right_shoulder", *ARMS)
LOWER = ("pelvis", "spine", *(f"{side}_{joint}" for side in SIDES for joint in ("hip", "knee", "ankle", "toe")))
DANCE = canonicalise(make_dance(draw_performer(1)).motion).to_trajectories()
WHOLE = canonicalise(DANCE)


def hide(absent, seed=0):
    positions = DANCE.positions + np.random.default_rng(seed).normal(0, 0.005, (1, 20, 3))
    positions[:, [CANONICAL_JOINTS.index(joint) for joint in absent]] = np.nan
    return canonicalise(DANCE.replace(positions=positions))


def segments_of(*limbs):
    return {SEGMENTS[index] for limb in limbs for index in LIMBS[limb]}


@pytest.mark.parametrize(
    ("absent", "left_out", "most"),
    [
        (ARMS, segments_of("left_arm", "right_arm"), True),
        (UPPER, segments_of("trunk", "left_arm", "right_arm"), True),
        (LOWER, segments_of("trunk", "left_leg", "right_leg"), False),
    ],
)
@pytest.mark.parametrize("swap", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_the_rest_is_judged(absent, left_out, most, swap):
    part = hide(absent)
    reference, performance = (part, WHOLE) if swap else (WHOLE, part)
    found = assess(reference, performance)
    assert set(found.not_judged) == left_out
    if most and not swap:  # of what moves in the reference
        assert np.isnan(found.score) and found.score_formula.code == "grade.unseen"
        assert [one.message.code for one in advise(found)] == ["grade.unseen"]
        found = assess(reference, performance, weights=dict.fromkeys(left_out, 0.0))
    assert found.score > 85
    assert not {name for event in found.events for name in event.segments} & left_out
    assert [one.code for one in found.warnings].count("assessment.not_judged") == 1
    assert "assessment.gaps" not in [one.code for one in found.warnings]
    assert found.gaps == ()
    written = json.loads(json.dumps(found.to_json(), allow_nan=False))
    assert set(written["not_judged"]) == left_out
    advise(found)


def test_an_error_of_what_is_there_is_found():
    late = np.array(DANCE.positions)
    knees = [CANONICAL_JOINTS.index(f"left_{joint}") for joint in ("knee", "ankle", "toe")]
    late[60:160, knees] += (0.25, 0.15, 0.0)
    late[:, [CANONICAL_JOINTS.index(joint) for joint in UPPER]] = np.nan
    legs = {"arms": 0.0, "trunk": 0.0}
    found = assess(WHOLE, canonicalise(DANCE.replace(positions=late)), weights=legs)
    assert found.score < assess(WHOLE, hide(UPPER), weights=legs).score
    assert any(set(event.segments) & segments_of("left_leg") for event in found.events)


def test_bodies_without_anything_in_common_are_told():
    with pytest.raises(InvalidMotionError, match="no segment in common"):
        assess(hide(UPPER), hide(LOWER))
