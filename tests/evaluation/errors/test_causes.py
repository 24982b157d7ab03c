"""One cause in the place of the findings that it explains: a lag, sides exchanged, a limb of the other side."""

from dataclasses import replace

import numpy as np
import pytest
from oracles.wrong_dances import ARM, be_late, gather_dances, get_dance, mirror, turn_limb

from dousa.evaluation.errors.causes import explain_together
from dousa.evaluation.errors.findings import Finding, estimate_lag, follow_limb, measure_suspects
from dousa.evaluation.errors.judge import Suspect
from dousa.evaluation.posture.posture import LIMBS, SEGMENTS
from dousa.evaluation.words import describe_event
from dousa.motion import CanonicalMotion
from dousa.motion.canonical.joints import JOINT_INDEX as J
from lab.trials.causes import exchange

MOTION = get_dance(12.0)
BODY, LEFT, RIGHT, BOTH = (0, 1, 2, 3, 4), (1,), (2,), (1, 2)


def blend(motion: CanonicalMotion, other: CanonicalMotion, chains: list[str], start: int, end: int) -> CanonicalMotion:
    """Limbs of another motion, hung on the joints of this one, between two frames."""
    positions = motion.positions.copy()
    for name in chains:
        root, *rest = (J[f"{name}_{joint}"] for joint in ARM)
        for joint in rest:
            away = other.positions[start:end, joint] - other.positions[start:end, root]
            positions[start:end, joint] = positions[start:end, root] + away
    return replace(motion, positions=positions)


def explain(performance: CanonicalMotion, *suspects: tuple[str, float, float, tuple[int, ...]]) -> list[Finding]:
    """What is told of suspects (class, start and end in s, limbs)."""
    frames = np.arange(0, performance.n_frames, 2)
    found = [Suspect(kind, round(15 * start), round(15 * end), limbs, 1.0) for kind, start, end, limbs in suspects]
    evidence = gather_dances(performance, MOTION)
    return explain_together(evidence, measure_suspects(evidence, found, frames))


def hold(motion: CanonicalMotion) -> CanonicalMotion:
    """The first pose throughout."""
    return replace(motion, positions=np.repeat(motion.positions[:1], motion.n_frames, axis=0))


LATE_ARM = blend(MOTION, be_late(MOTION, 0.4, 0.0, 99.0), ["left"], 120, 240)
MIRRORED = mirror(MOTION)


def test_a_late_arm_is_not_told_again_as_different_or_short() -> None:
    suspects = [("partial", 4.0, 4.4, LEFT), ("shift", 4.5, 6.6, LEFT), ("incomplete", 6.7, 8.0, LEFT)]
    (found,) = explain(LATE_ARM, *suspects)
    assert (found.kind, found.segments, found.cause) == ("shift", LIMBS["left_arm"], None)
    assert found.lag_s == pytest.approx(0.4, abs=0.03)
    assert found.start < 150 and found.end > 225


def test_a_lag_has_an_error_that_is_large_where_nothing_moves() -> None:
    errors = []
    for performance, model in ((LATE_ARM, MOTION), (hold(LATE_ARM), hold(MOTION))):
        evidence, segments = gather_dances(performance, model), np.array(LIMBS["left_arm"])
        errors.append(estimate_lag(evidence, 130, segments, follow_limb(evidence, 130, 230, segments))[1])
    assert errors[0] < 0.03 and errors[1] > 0.3


def test_a_late_body_explains_its_limbs_but_not_one_that_is_wrong() -> None:
    late = be_late(MOTION, 0.4, 3.0, 9.0)
    (found,) = explain(late, ("shift", 3.0, 9.0, BODY), ("partial", 5.0, 7.0, LEFT))
    assert found.kind == "shift"
    wrong = turn_limb(late, [f"left_{joint}" for joint in ARM], 60.0, 5.0, 7.0)
    kinds = [one.kind for one in explain(wrong, ("shift", 3.0, 9.0, BODY), ("partial", 5.0, 7.0, LEFT))]
    assert sorted(kinds) == ["partial", "shift"]


@pytest.mark.parametrize(
    "suspects",
    [
        [("partial", 8.6, 9.4, BOTH), ("partial", 9.8, 11.5, LEFT), ("incomplete", 10.0, 11.4, RIGHT)],
        [("global", 8.6, 11.4, BODY)],
    ],
)
def test_exchanged_arms_are_one_finding(suspects: list[tuple[str, float, float, tuple[int, ...]]]) -> None:
    found = explain(exchange(MOTION, "arm", 8.5, 11.5), *suspects)
    assert [one.cause for one in found] in (["exchanged"], ["left_for_right"], ["right_for_left"])
    assert found[0].segments == (1, 2, 3, 4)


def test_an_arm_that_does_what_the_other_should_is_said_to() -> None:
    (found,) = explain(blend(MOTION, MIRRORED, ["left"], 255, 345), ("partial", 8.6, 11.4, LEFT))
    assert (found.kind, found.cause) == ("partial", "copied")


def test_what_is_merely_wrong_has_no_cause() -> None:
    wrong = turn_limb(MOTION, [f"left_{joint}" for joint in ARM], 60.0, 5.0, 7.0)
    (found,) = explain(wrong, ("partial", 5.0, 7.0, LEFT))
    assert (found.kind, found.cause) == ("partial", None)
    assert explain(MOTION) == []


@pytest.mark.parametrize(
    ("cause", "said"),
    [
        ("exchanged", "both arms: left and right exchanged"),
        ("left_for_right", "both arms: the left one used instead of the right one"),
        ("copied", "both arms: does what the other side should do"),
        ("compensation", "both arms: moves by 30 deg where the reference keeps still"),
    ],
)
def test_causes_have_words(cause: str, said: str) -> None:
    arms = (*LIMBS["left_arm"], *LIMBS["right_arm"])
    names = [SEGMENTS[k] for k in arms]
    assert describe_event("partial", names, shortfall_deg=-30.0, cause=cause).render("en") == said
