"""Where keypoints lie on a body, and what a network says of the ways between them, against slow copies."""

import numpy as np
import pytest

from dousa.estimation import make_human, make_ring
from dousa.estimation.body.kinematics import compute_points, place_parts, point_names, step_poses
from dousa.estimation.body.posing import standing_state
from dousa.estimation.multiview.landmarks import place_landmarks
from dousa.estimation.multiview.pose_residuals import list_bones, place_points, point_slopes, world_terms

POINTS = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle", "toe", "heel", "ear", "mouth")
NAMES = ("nose", *(f"{side}_{point}" for point in POINTS for side in ("left", "right")))


@pytest.fixture(scope="module")
def body():
    return make_human(1.6)


@pytest.fixture(scope="module")
def poses(body):
    rng = np.random.default_rng(0)
    return step_poses(np.tile(standing_state(body), (5, 1)), rng.normal(0, 0.2, (5, 6 + body.n_angles)))


def test_a_shoulder_lies_above_its_joint_and_goes_with_the_trunk(body, poses):
    places = place_points(body, poses, place_landmarks(body, NAMES))
    joints = compute_points(body, poses)[:, point_names(body).index("left_shoulder")]
    trunk = place_parts(body, poses)[0][:, body.names.index("trunk")]
    own = np.einsum("tij,ti->tj", trunk, places[:, NAMES.index("left_shoulder")] - joints)
    np.testing.assert_allclose(own, np.tile(own[0], (5, 1)), atol=1e-12)
    assert 0.01 < own[0, 1] < 0.05
    hanging = poses.copy()
    hanging[:, 7 + body.angle_starts[body.names.index("left_upper_arm")]] += 0.5
    moved = place_points(body, hanging, place_landmarks(body, NAMES))
    row = NAMES.index("left_shoulder")
    np.testing.assert_allclose(moved[:, row], places[:, row], atol=1e-12)


def test_joints_of_another_network_than_blazepose_are_the_joints(body, poses):
    names = [name for name in NAMES if "mouth" not in name]
    places = place_points(body, poses, place_landmarks(body, names))
    joints = compute_points(body, poses)
    for joint in ("left_shoulder", "right_hip", "left_knee", "right_wrist"):
        np.testing.assert_allclose(places[:, names.index(joint)], joints[:, point_names(body).index(joint)], atol=1e-12)


def test_sides_are_mirror_images_on_the_standing_body(body):
    places = place_points(body, standing_state(body)[None], place_landmarks(body, NAMES))[0]
    for row, name in enumerate(NAMES):
        if name.startswith("left_"):
            other = places[NAMES.index("right_" + name[5:])]
            np.testing.assert_allclose(other * (-1, 1, 1), places[row], atol=1e-9)


class TestWorld:
    def told(self, body, places, camera):
        """What a network of the measured errors says: bone by bone from the hips, slowly."""
        bones, _, biases = list_bones(NAMES)
        truth = places @ camera.rotation.T
        wanted = np.einsum("bl,tli->tbi", bones, truth) / body.stature + biases
        world = np.stack([np.linalg.lstsq(bones, one, rcond=None)[0] for one in wanted])
        return 1.73 * world

    def test_the_measured_errors_are_taken_off_and_the_size_does_not_matter(self, body, poses):
        camera = make_ring(3)[1]
        landmarks = place_landmarks(body, NAMES)
        places, slopes = point_slopes(body, poses, landmarks)
        off, _ = world_terms(camera, self.told(body, places, camera), NAMES, places, slopes, body.stature)
        assert off.shape[1] == len(list_bones(NAMES)[0]) == 17
        np.testing.assert_allclose(off, 0.0, atol=1e-9)
        grown = self.told(body, places, camera) * 1.1
        assert np.abs(world_terms(camera, grown, NAMES, places, slopes, body.stature)[0]).max() > 0.5

    def test_slopes_are_those_of_small_steps(self, body, poses):
        camera = make_ring(3)[1]
        landmarks = place_landmarks(body, NAMES)
        places, slopes = point_slopes(body, poses, landmarks)
        world = np.random.default_rng(1).normal(0, 0.3, places.shape)
        off, ways = world_terms(camera, world, NAMES, places, slopes, body.stature)
        for axis in (0, 4, 9, 20):
            step = np.zeros(6 + body.n_angles)
            step[axis] = 1e-4
            moved = place_points(body, step_poses(poses, np.tile(step, (5, 1))), landmarks)
            other = world_terms(camera, world, NAMES, moved, slopes, body.stature)[0]
            np.testing.assert_allclose((other - off) / 1e-4, ways[..., axis], rtol=1e-2, atol=0.05)

    def test_a_point_that_is_missing_leaves_the_other_bones(self, body, poses):
        camera = make_ring(3)[0]
        landmarks = place_landmarks(body, NAMES)
        places, slopes = point_slopes(body, poses, landmarks)
        world = self.told(body, places, camera)
        world[2, NAMES.index("left_elbow")] = np.nan
        off, _ = world_terms(camera, world, NAMES, places, slopes, body.stature)
        lacking = np.isnan(off).any(axis=-1)
        assert lacking[2].sum() == 2 and not lacking[[0, 1, 3, 4]].any()
        np.testing.assert_allclose(off[~lacking], 0.0, atol=1e-9)
