"""What a body model refuses, and what it tells of itself."""

from dataclasses import replace

import numpy as np
import pytest

from dousa.errors import BodyModelError
from dousa.estimation import BodyModel
from dousa.estimation.body.human import make_human

BODY = make_human()


def changed(field, row, value):
    array = np.array(getattr(BODY, field))
    array[row] = value
    return {field: array}


WRONG = {
    "no part": ({"names": ()}, "at least one part"),
    "a joint too few": ({"joints": BODY.joints[1:]}, "15 joint names, got 14"),
    "two roots": (changed("parents", 3, -1), "one root"),
    "no root": (changed("parents", 0, 0), "one root"),
    "a parent after its child": (changed("parents", 1, 2), "part 'trunk': expected its parent before it"),
    "its own parent": (changed("parents", 1, 1), "part 'trunk'"),
    "a part without a solid": (changed("sphere_starts", 3, BODY.sphere_starts[2]), "at least one sphere"),
    "spheres left over": ({"spheres": np.ones((99, 4))}, "at least one sphere"),
    "a negative radius": (changed("spheres", (0, 3), -0.01), "radii of 0 m or more"),
    "no number": (changed("offsets", (2, 1), np.nan), "offsets: expected finite numbers"),
    "words": ({"offsets": [["a", "b", "c"]] * 15}, "offsets: expected numbers"),
    "another shape": ({"rest": np.ones((15, 3))}, r"rest: expected shape \(15, 4\), got \(15, 3\)"),
    "a free root with axes": (changed("n_axes", 0, 1), "no axes for the root"),
    "four axes": (changed("n_axes", 4, 4), "0 to 3 axes, got 4"),
    "an axis without length": (changed("axes", (4, 0), 0.0), "part 'left_forearm': expected axes of unit length"),
    "slanted axes": (changed("axes", (3, 1), [0.8, 0.0, 0.6]), "square to each other"),
    "limits the wrong way round": (changed("limits", (4, 0), [1.0, 0.0]), "part 'left_forearm': expected limits"),
    "limits over a turn": (changed("limits", (4, 0), [0.0, 7.0]), "within one turn"),
    "a rest that is no rotation": (changed("rest", 2, [0.5, 0, 0, 0]), "unit quaternions"),
    "a tip of no part": (changed("tip_parts", 0, 15), "a tip belongs to a part that is not there"),
    "no stature": ({"stature": 0.0}, "stature in metres above 0"),
    "a joint that may not move": (changed("agility", 3, 0.0), "an agility above 0"),
    "agilities of another body": ({"agility": np.ones(14)}, r"agility: expected shape \(15,\), got \(14,\)"),
    "a negative stiffness": (changed("stiffness", 3, -0.1), "a stiffness of 0 or more"),
    "a stiffness without end": (changed("stiffness", 3, np.inf), "stiffness: expected finite numbers"),
    "one angle at ease for each": ({"neutral": np.zeros(15)}, r"neutral: expected shape \(15, 3\)"),
    "ease that is no number": (changed("neutral", (3, 0), np.nan), "neutral: expected finite numbers"),
    "stature not finite": ({"stature": float("nan")}, "stature"),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_makes_no_body_is_refused(case):
    fields, message = WRONG[case]
    with pytest.raises(BodyModelError, match=message):
        replace(BODY, **fields)


def test_angles_are_named_after_their_joints_in_order():
    assert BODY.n_angles == 30 == len(BODY.angle_names) == len(BODY.angle_limits)
    assert BODY.angle_names[:3] == ("spine.1", "spine.2", "spine.3")
    assert BODY.angle_starts[0] == 0 and BODY.angle_starts[-1] == 30
    elbow = BODY.angle_names.index("left_elbow.1")
    np.testing.assert_array_equal(BODY.angle_limits[elbow], BODY.limits[BODY.names.index("left_forearm"), 0])


def test_a_single_rigid_part_is_a_body_without_angles():
    ball = BodyModel(
        names=("ball",),
        joints=("ball",),
        parents=[-1],
        offsets=[[0, 0, 0]],
        rest=[[1, 0, 0, 0]],
        n_axes=[0],
        axes=np.zeros((1, 3, 3)),
        limits=np.zeros((1, 3, 2)),
        spheres=[[0, 0, 0, 0.5]],
        sphere_starts=[0, 1],
        tips=(),
        tip_parts=[],
        tip_offsets=[],
        stature=1.0,
    )
    assert ball.n_angles == 0 and ball.angle_limits.shape == (0, 2) and ball.tip_offsets.shape == (0, 3)
    # What nobody told: it moves as others do and prefers nothing.
    assert ball.agility.tolist() == [1.0] and ball.stiffness.tolist() == [0.0]
    assert ball.neutral.tolist() == [[0.0, 0.0, 0.0]]


def test_arrays_cannot_be_written_to():
    with pytest.raises(ValueError, match="read-only"):
        BODY.offsets[0, 0] = 1.0
    with pytest.raises(ValueError, match="read-only"):
        BODY.neutral[0, 0] = 1.0
