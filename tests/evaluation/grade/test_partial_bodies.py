"""What both bodies have is judged; what one of them lacks is left out and told."""

from __future__ import annotations

import json

import numpy as np
import pytest

from dousa.errors import InvalidMotionError
from dousa.evaluation import advise, assess
from dousa.evaluation.posture.posture import LIMBS, SEGMENTS
from dousa.motion import CANONICAL_JOINTS, canonicalise
from dousa.motion.synthetic import draw_performer, make_dance

SIDES = ("left", "right")
ARMS = tuple(f"{side}_{joint}" for side in SIDES for joint in ("elbow", "wrist", "hand"))
UPPER = ("spine", "neck", "head", "left_shoulder", "right_shoulder", *ARMS)
LOWER = ("pelvis", "spine", *(f"{side}_{joint}" for side in SIDES for joint in ("hip", "knee", "ankle", "toe")))
DANCE = canonicalise(make_dance(draw_performer(1)).motion).to_trajectories()
WHOLE = canonicalise(DANCE)


def cut(absent, seed=0):
    positions = DANCE.positions + np.random.default_rng(seed).normal(0, 0.005, (1, 20, 3))
    positions[:, [CANONICAL_JOINTS.index(joint) for joint in absent]] = np.nan
    return canonicalise(DANCE.replace(positions=positions))


def segments_of(*limbs):
    return {SEGMENTS[index] for limb in limbs for index in LIMBS[limb]}


@pytest.mark.parametrize(
    ("absent", "left_out"),
    [
        (ARMS, segments_of("left_arm", "right_arm")),
        (UPPER, segments_of("trunk", "left_arm", "right_arm")),
        (LOWER, segments_of("trunk", "left_leg", "right_leg")),
    ],
)
@pytest.mark.parametrize("swap", [False, True])
def test_the_rest_is_judged(absent, left_out, swap):
    part = cut(absent)
    reference, performance = (part, WHOLE) if swap else (WHOLE, part)
    found = assess(reference, performance)
    assert set(found.not_judged) == left_out
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
    found = assess(WHOLE, canonicalise(DANCE.replace(positions=late)))
    assert found.score < assess(WHOLE, cut(UPPER)).score
    assert any(set(event.segments) & segments_of("left_leg") for event in found.events)


def test_bodies_without_anything_in_common_are_told():
    with pytest.raises(InvalidMotionError, match="no segment in common"):
        assess(cut(UPPER), cut(LOWER))
