"""Another body: offsets that are there throughout are found and taken out, errors are not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from oracles.wandering import make_wandering_motion

from dousa.arrays import FloatArray
from dousa.evaluation import assess
from dousa.evaluation.grade.references import compare
from dousa.evaluation.posture.posture import SEGMENTS, Working, compute_postures, thin_postures
from dousa.evaluation.posture.yaw import (
    BETWEEN_DEG,
    Offset,
    estimate_offset,
    find_missing,
    learn_between,
    rotate_yaw,
    turn_segments,
)
from dousa.motion.canonical.joints import JOINT_INDEX as J

MOTION = make_wandering_motion(30, 1)
REFERENCE = thin_postures(compute_postures(MOTION, name="reference"))
FRAMES = np.arange(REFERENCE.n_frames)
PAIRS = np.column_stack([FRAMES, FRAMES])


def turn_body(vectors: FloatArray, frames: slice = slice(None)) -> Working:
    """The reference by a body whose segments are turned in its own frame, in some of the frames."""
    heading, segments = REFERENCE.heading[frames], np.array(REFERENCE.segments)
    segments[frames] = rotate_yaw(turn_segments(rotate_yaw(segments[frames], -heading), vectors), heading)
    return replace(REFERENCE, segments=segments)


def make_vectors(degrees: float, *names: str) -> FloatArray:
    """Rotation vectors about the front axis, of these segments."""
    vectors = np.zeros((9, 3))
    vectors[[SEGMENTS.index(name) for name in names], 2] = np.radians(degrees)
    return vectors


def test_the_same_body_has_no_offset() -> None:
    found = estimate_offset(REFERENCE, REFERENCE, PAIRS)
    np.testing.assert_allclose(found.measured, 0.0, atol=1e-6)
    assert not found.missing.any()


@pytest.mark.parametrize("facing", [0.0, 2.0])
def test_an_offset_is_found_whatever_the_heading(facing: float) -> None:
    vectors = make_vectors(8.0, "left_upper_arm", "left_forearm")
    body = turn_body(vectors)
    body = replace(body, segments=rotate_yaw(body.segments, facing), heading=body.heading + facing)
    found = estimate_offset(REFERENCE, body, PAIRS)
    sizes = np.degrees(np.linalg.norm(found.measured, axis=1))
    assert sizes[1:3] == pytest.approx(8.0, abs=1.0)
    assert sizes[[0, 5, 6, 7, 8]].max() < 1.0
    np.testing.assert_allclose(found.degrees[1:3], sizes[1:3], atol=1.0)


def test_errors_in_less_than_half_of_the_time_do_not_bend_it() -> None:
    wrong = turn_body(make_vectors(50.0, "right_upper_arm"), slice(0, 400))
    found = estimate_offset(REFERENCE, wrong, PAIRS)
    assert np.degrees(np.linalg.norm(found.measured[3])) < 2.0


def test_of_more_than_bodies_differ_by_the_rest_stays() -> None:
    found = estimate_offset(REFERENCE, turn_body(make_vectors(60.0, "left_upper_arm")), PAIRS)
    assert np.degrees(np.linalg.norm(found.measured[1])) == pytest.approx(60.0, abs=6.0)
    assert found.degrees[1] < 2.0 * BETWEEN_DEG[1]


def test_a_short_clip_hardly_determines_an_offset() -> None:
    vectors = make_vectors(8.0, "left_upper_arm")
    shares = [
        estimate_offset(REFERENCE, turn_body(vectors), PAIRS[: round(30 * seconds)]).degrees[1] / 8.0
        for seconds in (1.0, 3.0, 30.0)
    ]
    assert shares == sorted(shares)
    assert shares[0] < 0.7 and shares[2] > 0.9


def test_an_error_of_most_of_a_short_clip_is_still_seen() -> None:
    wrong = turn_body(make_vectors(40.0, "left_upper_arm"), slice(0, 36))
    short = replace(wrong, segments=wrong.segments[:60], seen=wrong.seen[:60], heading=wrong.heading[:60])
    found = compare([REFERENCE], short, "same", np.ones(9))
    chords = np.sqrt(found.deviations.squared[:36, found.deviations.center, 1])
    assert np.median(np.degrees(2.0 * np.arcsin(0.5 * chords))) > 25.0


def test_takes_of_several_people_widen_the_limit_and_those_of_one_narrow_it() -> None:
    nothing = np.zeros((9, 3))
    same = Offset(nothing, nothing, np.ones(9), np.zeros(9, bool))
    other = replace(same, measured=nothing + np.radians([20.0, 0.0, 0.0]))
    usual = np.radians(BETWEEN_DEG)
    assert (learn_between([same] * 4) < usual).all()
    assert (learn_between([other] * 4) > usual).all()


def sit(positions: FloatArray) -> FloatArray:
    """Thighs to the front, shanks down, both still."""
    seated = np.array(positions)
    for side in ("left", "right"):
        hip = seated[:, J[f"{side}_hip"]]
        seated[:, J[f"{side}_knee"]] = hip + np.array([0.0, -0.02, 0.4])
        seated[:, J[f"{side}_ankle"]] = hip + np.array([0.0, -0.42, 0.4])
    return seated


def test_who_sits_is_judged_by_the_arms() -> None:
    # The legs of this reference hardly move, and it does not turn.
    positions = np.array(MOTION.positions)
    for name in ("hip", "knee", "ankle"):
        for side in ("left", "right"):
            joint = J[f"{side}_{name}"]
            positions[:, joint] = positions[:, J["pelvis"]] + (positions[0, joint] - positions[0, J["pelvis"]])
    standing = replace(MOTION, positions=positions)
    found = assess(standing, replace(standing, positions=sit(positions)))
    assert np.isnan(found.residual[:, 5:]).all()
    assert found.events == ()
    assert found.score > 90.0


def test_a_limb_that_is_held_still_is_no_missing_part() -> None:
    # A breath of motion is enough: who does not move a limb that should move makes an error.
    segments = np.array(REFERENCE.segments)
    breath = 0.01 * np.sin(FRAMES / 7.0)
    segments[:, 1] = np.column_stack([breath, -np.sqrt(1.0 - breath**2), np.zeros(len(FRAMES))])
    assert not find_missing(REFERENCE, replace(REFERENCE, segments=segments)).any()
    segments[:, 1] = [0.0, -1.0, 0.0]
    assert np.flatnonzero(find_missing(REFERENCE, replace(REFERENCE, segments=segments))).tolist() == [1]


def test_what_is_never_seen_is_missing() -> None:
    seen = np.array(REFERENCE.seen)
    seen[:, [6, 8]] = False
    assert np.flatnonzero(find_missing(replace(REFERENCE, seen=seen), REFERENCE)).tolist() == [6, 8]
