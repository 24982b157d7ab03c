"""Parts of bodies: what is hidden changes nothing, and a whole body looked at as a part is that part."""

import numpy as np
import pytest

from dousa.errors import InvalidMotionError, OptionError
from dousa.motion import CANONICAL_JOINTS, canonicalise
from dousa.motion.canonical.joints import find_absent
from dousa.motion.synthetic import draw_performer, make_motion
from dousa.retrieval import FEATURE_SETS, get_feature_set
from dousa.retrieval.features.channels import CHANNELS
from dousa.retrieval.features.posed_motion import complete_positions, hide_joints, is_comparable, name_parts
from dousa.retrieval.ranking.ranking import compute_with_poses
from dousa.retrieval.takes.windows import compute_small_poses

SIDES = ("left", "right")
HANDS = ("left_hand", "right_hand")
UPPER = ("head", "neck", *(f"{side}_{joint}" for side in SIDES for joint in ("shoulder", "elbow", "wrist", "hand")))
LOWER = ("pelvis", "spine", *(f"{side}_{joint}" for side in SIDES for joint in ("hip", "knee", "ankle", "toe")))
NO_HANDS = ("left_wrist", "right_wrist", *HANDS)
PARTS = (NO_HANDS, UPPER, LOWER, ("left_elbow", "left_wrist", "left_hand"))
MOTION = canonicalise(make_motion("wave_left", draw_performer(1), 2))
J = {joint: row for row, joint in enumerate(CANONICAL_JOINTS)}


@pytest.mark.parametrize("base", sorted(FEATURE_SETS))
@pytest.mark.parametrize("absent", PARTS)
def test_hidden_joints_count_for_nothing(base, absent):
    feature_set = FEATURE_SETS[base].without(absent)
    hidden = hide_joints(MOTION, feature_set.hidden)
    features = feature_set.compute(hidden)
    assert np.isfinite(features).all()
    noise = np.array(hidden.positions)
    for joint in feature_set.hidden:
        noise[:, J[joint]] = np.random.default_rng(0).normal(size=(len(noise), 3))
    other = type(hidden)(noise, hidden.frame_rate, hidden.height)
    np.testing.assert_array_equal(feature_set.compute(other), features)
    asked = set(feature_set.tests[:, 1].tolist())
    n_channels = len(feature_set.channels)
    silent = [row for row in range(n_channels) if row not in asked]
    assert silent
    assert not features[:, silent].any()
    assert all(set(feature_set.channels[row].joints) & set(absent) for row in silent)


@pytest.mark.parametrize("absent", PARTS)
def test_a_whole_body_looked_at_as_a_part_is_that_part(absent):
    points = MOTION.to_trajectories()
    positions = np.array(points.positions)
    positions[:, [J[joint] for joint in absent]] = np.nan
    part = canonicalise(points.replace(positions=positions))
    assert set(find_absent(part.positions)) >= set(absent)
    feature_set = FEATURE_SETS["extended"].without(part.absent)
    assert feature_set is FEATURE_SETS["extended"].without(absent)
    assert hide_joints(MOTION, feature_set.hidden).height == pytest.approx(part.height)
    seen = [feature_set.compute(hide_joints(one, feature_set.hidden)) for one in (MOTION, part)]
    np.testing.assert_allclose(*seen, atol=1e-9)


def test_distances_of_poses_are_means_over_the_joints_that_are_there():
    whole, legs = FEATURE_SETS["extended"], FEATURE_SETS["extended"].without(UPPER)
    moved = np.array(MOTION.positions)
    for joint in ("left_knee", "right_knee", "left_ankle", "right_ankle"):
        moved[:, J[joint], 1] += 0.1 * MOTION.height

    def distance(feature_set):
        kind = type(hide_joints(MOTION, HANDS))
        seen = [kind(positions, MOTION.frame_rate, MOTION.height) for positions in (MOTION.positions, moved)]
        poses = compute_with_poses(seen, feature_set)[1]
        return np.linalg.norm(poses[0] - poses[1], axis=1).mean()

    assert distance(legs) == pytest.approx(0.1, rel=0.05)  # all that is looked at is a tenth of a height away
    assert distance(whole) == pytest.approx(0.1 * np.sqrt(4 / 12), rel=0.05)
    small = compute_small_poses(np.asarray(MOTION.positions), MOTION.height, UPPER)
    assert (np.abs(small).max(axis=0) > 0).sum() == 12  # knees and ankles


def test_an_upper_body_stands_on_a_pelvis_below_its_neck():
    points = complete_positions(MOTION.positions, 1.0, LOWER, set())
    below = points[:, J["neck"]] - points[:, J["pelvis"]]
    np.testing.assert_allclose(below, np.broadcast_to([0.0, 0.288 * 1.1, 0.0], below.shape), atol=1e-12)
    hips = complete_positions(MOTION.positions, 1.0, ("pelvis",), set())
    middle = MOTION.positions[:, [J["left_hip"], J["right_hip"]]].mean(axis=1)
    np.testing.assert_allclose(hips[:, J["pelvis"]], middle)


def test_joints_that_are_needed_must_be_there():
    positions = np.array(MOTION.positions)
    positions[:, J["head"]] = np.nan
    motion = type(hide_joints(MOTION, HANDS))(positions, MOTION.frame_rate, MOTION.height)
    with pytest.raises(InvalidMotionError):
        FEATURE_SETS["extended"].compute(motion)
    assert np.isfinite(FEATURE_SETS["extended"].without(["head"]).compute(motion)).all()
    positions = np.array(MOTION.positions)
    positions[:, J["left_wrist"]] = np.nan  # nobody looks at wrists
    motion = type(motion)(positions, MOTION.frame_rate, MOTION.height)
    np.testing.assert_array_equal(FEATURE_SETS["extended"].compute(motion), FEATURE_SETS["extended"].compute(MOTION))


def test_names_of_sets():
    part = FEATURE_SETS["extended"].without(["right_hand", "left_wrist", "left_hand"])
    assert part.name == "extended without left_hand right_hand"
    assert get_feature_set(part.name) is part
    assert part.base == "extended"
    assert part.without(()) is part
    assert FEATURE_SETS["extended"].without(["left_wrist", "spine"]) is FEATURE_SETS["extended"]
    assert len(part.channels) == len(CHANNELS)
    for wrong in ("mine", "extended without tail", "other without head"):
        with pytest.raises(OptionError):
            get_feature_set(wrong)


def test_what_can_be_compared():
    assert is_comparable(UPPER)
    assert is_comparable(LOWER)
    assert not is_comparable((*UPPER, *LOWER))
    assert not is_comparable(("left_hip", "left_shoulder"))
    limbs = [f"{side}_{joint}" for side in SIDES for joint in ("elbow", "hand", "knee", "ankle")]
    assert not is_comparable(limbs)


def test_parts_have_the_names_that_people_use():
    assert [str(part) for part in name_parts(UPPER)] == ["the head", "the arms"]
    assert [str(part) for part in name_parts(LOWER)] == ["the legs", "the hips"]
    assert [str(part) for part in name_parts(HANDS)] == ["the hands"]
    assert [str(part) for part in name_parts(["left_elbow", "left_hand", "right_hand"])] == [
        "the left arm",
        "the right hand",
    ]
    assert [str(part) for part in name_parts(["left_ankle", "right_ankle"])] == ["the feet"]
