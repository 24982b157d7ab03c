"""The whole assessment: what must not matter, known errors, several takes, figures."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.answers import CURVES, check, kinds
from oracles.answers import judge as judge_answer
from oracles.wandering import stretch
from oracles.wrong_dances import ARM, be_late, get_dance, mirror, place, shrink_arm, swap_section, turn_limb

from dousa.errors import OptionError
from dousa.evaluation import Assessment, Furi, assess
from dousa.evaluation.errors.evidence import measure_ranges
from dousa.evaluation.posture.posture import SEGMENTS
from dousa.messages import LANGUAGES
from dousa.motion import CanonicalMotion
from lab.injection.injection import simulate_performer

LEFT_ARM = [f"left_{joint}" for joint in ARM]
LEFT_LEG = ["left_hip", "left_knee", "left_ankle", "left_toe"]
LEFT_ARM_SEGMENTS = {"left_upper_arm", "left_forearm"}
NO_LEGS = {"left_leg": 0.0, "right_leg": 0.0}
MOTION = get_dance()
SHORT = get_dance(10.0)


def judge(performance: CanonicalMotion, reference: CanonicalMotion = MOTION, **options: object) -> Assessment:
    return judge_answer(performance, reference, **options)


# --- what must not matter -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rate", [30.0, 120.0])
def test_identity_is_zero_everywhere_and_scores_100(rate: float) -> None:
    motion = get_dance(20.0, rate)
    found = judge(motion, motion)
    assert found.score == 100.0
    assert found.events == () and found.lapses == () and found.gaps == () and found.warnings == ()
    for name in ("lag", "facing", "d_within", "d_path", "residual"):
        assert np.abs(getattr(found, name)).max() < 1e-6, name
    # d# keeps what the space leaves over of the reference itself: 1 % of the variance.
    assert np.nanmax(found.d_space) < np.nanmin(found.d_space_limit)
    assert found.same_time == pytest.approx(np.arange(motion.n_frames) / rate)
    assert found.matched_time == pytest.approx(found.same_time)
    assert np.array_equal(found.path[:, 0], found.path[:, 1])
    assert found.tempo == pytest.approx(1.0)
    assert not found.calibrated and found.n_references == 1
    for furi in found.furi:
        assert furi.score == 100.0 and furi.lag_s == pytest.approx(0.0, abs=1e-9)
        assert np.nanmax(np.abs(furi.gain - 1.0)) < 1e-6


@given(yaw=st.floats(-3.1, 3.1), x=st.floats(-5.0, 5.0), z=st.floats(-5.0, 5.0), stature=st.floats(0.6, 1.6))
@settings(max_examples=5, deadline=None)
def test_heading_place_and_stature_do_not_matter(yaw: float, x: float, z: float, stature: float) -> None:
    wrong = turn_limb(simulate_performer(SHORT, 5), LEFT_ARM, 50.0, 6.0, 8.0)
    one, other = judge(wrong, SHORT), judge(place(wrong, yaw, x, z, stature), SHORT)
    assert one.events
    assert other.score == pytest.approx(one.score, abs=1e-4)
    assert [(e.kind, e.start_s, e.end_s, e.segments) for e in one.events] == [
        (e.kind, e.start_s, e.end_s, e.segments) for e in other.events
    ]
    for name in CURVES:
        assert getattr(other, name) == pytest.approx(getattr(one, name), abs=1e-5, nan_ok=True), name


def test_frame_rates_do_not_matter() -> None:
    slow, fast = get_dance(12.0), get_dance(12.0, 120.0)
    for reference, performance in ((slow, fast), (fast, slow), (fast, get_dance(12.0, 24.0))):
        found = judge(performance, reference)
        assert found.events == () and found.lapses == ()
        assert found.score > 99.0
        assert found.frame_rate == performance.frame_rate == found.reference.frame_rate
    for reference, performance in ((slow, fast), (fast, slow)):
        (event,) = judge(turn_limb(performance, LEFT_ARM, 45.0, 6.0, 8.0), reference).events
        assert event.kind == "partial" and set(event.segments) <= LEFT_ARM_SEGMENTS
        assert [event.start_s, event.end_s] == pytest.approx([6.1, 7.9], abs=0.15)
        (event,) = judge(be_late(performance, 0.3, 5.0, 10.0), reference).events
        assert event.kind == "shift" and event.lag_ms == pytest.approx(300.0, abs=20.0)


def test_a_mirrored_pupil_is_as_good_as_the_pupil_in_the_mirror() -> None:
    pupil = shrink_arm(simulate_performer(MOTION, 9), "left", 0.5, 5.0, 8.0)
    straight, mirrored = judge(pupil), judge(mirror(pupil), side="mirrored")
    assert mirrored.score == pytest.approx(straight.score, abs=1e-6)
    assert [(e.kind, e.start_s, e.segments) for e in mirrored.events] == [
        (e.kind, e.start_s, e.segments) for e in straight.events
    ]
    assert mirrored.residual == pytest.approx(straight.residual, abs=1e-9)


def test_who_is_mirrored_unasked_is_told() -> None:
    found = judge(mirror(MOTION), side="same")
    assert found.score < 85.0
    (warning,) = (one for one in found.warnings if one.code == "assessment.mirrored")
    assert all("--mirror" in warning.render(language) for language in LANGUAGES)


def test_who_is_mirrored_needlessly_is_told_to_leave_it_out() -> None:
    found = judge(MOTION, side="mirrored")
    codes = [warning.code for warning in found.warnings]
    assert "assessment.unmirrored" in codes and "assessment.mirrored" not in codes
    warning = found.warnings[codes.index("assessment.unmirrored")]
    assert "--mirror no" in str(warning) and "--mirror no を付ける" in warning.render("ja")


@pytest.mark.slow
def test_performers_who_waver_are_hardly_ever_wrong() -> None:
    found = [judge(simulate_performer(MOTION, seed)) for seed in range(6)]
    assert sum(len(one.events) for one in found) <= 2
    assert all(one.score > 80.0 and one.lapses == () for one in found)


# --- known errors ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("lag_s", [-0.4, -0.2, 0.2, 0.35, 0.6])
def test_a_known_shift_has_that_lag(lag_s: float) -> None:
    found = judge(be_late(MOTION, lag_s, 5.0, 11.0))
    (event,) = found.events
    assert event.kind == "shift"
    assert event.lag_ms == pytest.approx(1000.0 * lag_s, abs=20.0)
    assert event.start_s == pytest.approx(5.2, abs=0.3) and event.end_s == pytest.approx(10.8, abs=0.35)
    assert np.median(found.lag[200:290]) == pytest.approx(lag_s, abs=0.02)
    assert np.abs(found.lag[:140]).max() < 0.04
    # What is resembled is another moment than the one that is due.
    late = found.same_time[200:290] - found.matched_time[200:290]
    assert np.median(late) == pytest.approx(lag_s, abs=0.02)
    assert found.lapses == ()


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_shrunk_limb_is_incomplete(side: str) -> None:
    found = judge(shrink_arm(MOTION, side, 0.5, 5.0, 8.0))
    (event,) = found.events
    assert event.kind == "incomplete"
    assert set(event.segments) == {f"{side}_upper_arm", f"{side}_forearm"}
    span = slice(round(30.0 * event.start_s), round(30.0 * event.end_s))
    columns = [SEGMENTS.index(name) for name in event.segments]
    whole, part = (
        np.degrees(measure_ranges(one.segments[span][:, columns])) for one in (found.reference, found.performance)
    )
    assert event.shortfall_deg == pytest.approx((whole - part).max(), abs=8.0)
    assert event.shortfall_deg > 25.0
    assert event.shortfall_percent == pytest.approx(100.0 * ((whole - part) / whole).max(), abs=10.0)
    assert f"{side} arm" in str(event.says)


def test_a_wrong_limb_is_partial() -> None:
    for chain, segments in ((LEFT_ARM, LEFT_ARM_SEGMENTS), (LEFT_LEG, {"left_thigh", "left_shank"})):
        found = judge(turn_limb(MOTION, chain, 45.0, 6.0, 8.0))
        (event,) = found.events
        assert event.kind == "partial" and set(event.segments) <= segments
        inside = found.residual[200:220]
        wrong = [SEGMENTS.index(name) for name in event.segments]
        right = [index for index, name in enumerate(SEGMENTS) if name not in segments]
        assert np.degrees(inside[:, wrong].max(axis=1).min()) > 20.0
        assert np.degrees(inside[:, right].max()) < 3.0


def test_another_section_is_global() -> None:
    found = judge(swap_section(MOTION, 5.0, 7.0, 13.0))
    (event,) = found.events
    assert event.kind == "global" and event.segments == SEGMENTS
    assert (found.d_space[165:195] > found.d_space_limit[165:195]).mean() > 0.8


def test_limbs_without_weight_are_not_judged() -> None:
    wrong = turn_limb(simulate_performer(MOTION, 1), LEFT_LEG, 50.0, 6.0, 8.0)
    assert "partial" in kinds(judge(wrong))
    found = judge(wrong, weights=NO_LEGS)
    assert not any({"left_thigh", "left_shank"} & set(e.segments) for e in found.events if len(e.segments) < 9)
    assert "partial" not in kinds(found) and "global" not in kinds(found)
    assert found.score > judge(wrong).score
    # The arms are judged as ever.
    arm = judge(turn_limb(wrong, LEFT_ARM, 45.0, 10.0, 12.0), weights=NO_LEGS)
    assert any(e.kind == "partial" and set(e.segments) <= LEFT_ARM_SEGMENTS for e in arm.events)


def test_leaving_limbs_out_makes_nobody_stricter_with_the_rest() -> None:
    alone = {name: 0.0 for name in ("trunk", "right_arm", "left_leg", "right_leg")}
    found = [judge(simulate_performer(MOTION, seed), weights=alone) for seed in range(5)]
    assert sum(len(one.events) for one in found) <= 1


def test_only_the_ratios_of_weights_count() -> None:
    wrong = turn_limb(SHORT, LEFT_ARM, 40.0, 6.0, 8.0)
    plain = judge(wrong, SHORT)
    for factor in (0.1, 30.0):
        found = judge(wrong, SHORT, weights=dict.fromkeys(SEGMENTS, factor))
        assert found.score == pytest.approx(plain.score)
        assert kinds(found) == kinds(plain) == ["partial"]


# --- several takes, figures -----------------------------------------------------------------------------------------


def test_what_the_takes_do_is_tolerated() -> None:
    habit = turn_limb(MOTION, LEFT_ARM, 35.0, 6.0, 8.0)
    performance = simulate_performer(habit, 7)
    assert any(set(e.segments) <= LEFT_ARM_SEGMENTS for e in judge(performance).events)
    takes = [MOTION, *(simulate_performer(motion, k) for k, motion in enumerate((habit, MOTION)))]
    found = assess(takes, performance, names=("first", "second", "third", "pupil"))
    check(found)
    assert not any(set(e.segments) & LEFT_ARM_SEGMENTS for e in found.events if len(e.segments) < 9)
    assert found.calibrated and found.n_references == 3
    assert found.reference.name == "first" and found.performance.name == "pupil"
    # The mean of the takes is 100.
    assert found.score > 85.0


def test_given_figures_are_respected() -> None:
    fast = get_dance(20.0, 120.0)
    given = (Furi(120, 600, "a"), Furi(600, 1200, "b"), Furi(1200, 1680, "a"))
    found = judge(MOTION, fast, furi=given)
    spans = [(one.reference_start_s, one.reference_end_s, one.label) for one in found.furi]
    assert spans == [(1.0, 5.0, "a"), (5.0, 10.0, "b"), (10.0, 14.0, "a")]
    assert found.furi[0].eigenspace is found.furi[2].eigenspace
    assert [one.start_s for one in found.furi] == pytest.approx([1.0, 5.0, 10.0])
    # Outside them there is no eigenspace, but there are angles.
    assert np.isnan(found.d_space[:30]).all() and np.isfinite(found.residual[:30]).all()
    assert any("7.0 s" in str(warning) for warning in found.warnings)
    wrong = judge(turn_limb(MOTION, LEFT_ARM, 45.0, 6.0, 8.0), fast, furi=given)
    assert [event.furi for event in wrong.events] == [1]
    assert wrong.furi[1].score < wrong.furi[0].score


def test_figures_that_overlap_are_counted_once() -> None:
    found = judge(MOTION, furi=(Furi(0, 300, "a"), Furi(100, 400, "b")))
    assert any("6.7 s" in str(warning) for warning in found.warnings)


@pytest.mark.parametrize("furi", [Furi(0, 601, "a"), Furi(700, 800, "a")])
def test_figures_outside_the_reference_are_refused(furi: Furi) -> None:
    with pytest.raises(OptionError, match="between 0 and 600"):
        assess(MOTION, MOTION, furi=(furi,))


def test_a_free_tempo_is_no_error() -> None:
    slow = stretch(MOTION, 690)
    found = judge(slow, tempo="free")
    assert found.tempo == pytest.approx(1.15, abs=0.02)
    assert found.events == () and found.score > 90.0
    strict = judge(slow)
    assert strict.score < found.score
    assert any("--tempo free" in str(warning) for warning in strict.warnings)


def test_a_grade_of_a_part_says_so():
    """Who sits down after the kick is graded for the kick; nobody should believe it unwarned."""
    from dousa.motion import canonicalise
    from dousa.motion.synthetic.performers import draw_performer, make_motion

    def perform(performer: int, *categories: str) -> CanonicalMotion:
        parts = [make_motion(category, draw_performer(performer), seed=performer) for category in categories]
        rotations, translations = (
            np.concatenate([getattr(one, name) for one in parts]) for name in ("rotations", "translations")
        )
        return canonicalise(parts[0].replace(rotations=rotations, translations=translations))

    takes = [perform(number, "kick_left") for number in range(5)]
    longer, same = (
        assess(takes, perform(7, *categories), tempo="free")
        for categories in (("kick_left", "sit_down"), ("kick_left",))
    )
    assert np.isfinite(longer.score)
    assert any(warning.code == "assessment.compared" for warning in longer.warnings)
    assert not any(warning.code == "assessment.compared" for warning in same.warnings)
