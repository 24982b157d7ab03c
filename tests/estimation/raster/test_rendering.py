"""Rendering a body that moves, spoiling what was rendered, and following a recorded motion."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.bodies import robot_arm

from dousa.errors import BodyModelError, OptionError, SilhouetteError
from dousa.estimation.body.human import make_human
from dousa.estimation.body.kinematics import compute_points, point_names, to_motion
from dousa.estimation.body.posing import standing_state
from dousa.estimation.cameras.camera import Camera
from dousa.estimation.raster.rasteriser import draw_body
from dousa.estimation.raster.rendering import Spoiling, poses_from_motion, render, spoil
from dousa.motion import CANONICAL_JOINTS, Trajectories, compute_trajectories
from dousa.motion.synthetic.performers import Performer, make_motion

CAMERAS = [
    Camera("front", 80, 60, [[65, 0, 40], [0, 65, 30], [0, 0, 1]], np.diag([1, -1, -1]), [0, 0.9, 2.8]),
    Camera("wide", 130, 50, [[50, 0, 65], [0, 50, 25], [0, 0, 1]], np.diag([1, -1, -1]), [0, 0.9, 2.5]),
]


@pytest.fixture(scope="module")
def body():
    return make_human()


@pytest.fixture(scope="module")
def poses(body):
    """Ten frames of small, lively movement about standing."""
    rng = np.random.default_rng(5)
    rows = np.tile(standing_state(body), (10, 1))
    rows[:, :3] += rng.normal(0, 0.05, (10, 3))
    limits = body.angle_limits
    rows[:, 7:] = np.clip(rows[:, 7:] + rng.normal(0, 0.2, rows[:, 7:].shape), limits[:, 0], limits[:, 1])
    return rows


@pytest.fixture(scope="module")
def masks(body):
    return render(body, np.tile(standing_state(body), (12, 1)), CAMERAS)[0]


def test_every_view_has_its_own_size_and_what_the_rasteriser_draws(body, poses):
    views = render(body, poses, CAMERAS)
    assert [view.shape for view in views] == [(10, 60, 80), (10, 50, 130)]
    for view, camera in zip(views, CAMERAS, strict=True):
        np.testing.assert_array_equal(view, draw_body(body, poses, camera))


def test_no_frames_and_no_views(body, poses):
    assert render(body, poses[:0], CAMERAS)[0].shape == (0, 60, 80)
    assert render(body, poses, []) == []


@pytest.mark.parametrize("damage", [lambda p: p[:, :-1], lambda p: p[0], lambda p: p * np.nan])
def test_poses_that_are_none_are_refused(body, poses, damage):
    with pytest.raises(BodyModelError, match="poses: expected"):
        render(body, damage(poses), CAMERAS)


def test_nothing_to_spoil_leaves_the_masks_alone(masks):
    np.testing.assert_array_equal(spoil(masks, np.random.default_rng(0), Spoiling()), masks)


def test_the_same_generator_gives_the_same_errors_and_the_input_stays(masks):
    before = masks.copy()
    first, again = (spoil(masks, np.random.default_rng(3)) for _ in range(2))
    np.testing.assert_array_equal(first, again)
    np.testing.assert_array_equal(masks, before)
    assert (first != spoil(masks, np.random.default_rng(4))).any()


def test_holes_and_speckle_come_in_the_share_that_was_asked_for(masks):
    long = np.tile(masks, (12, 1, 1))
    holed = spoil(long, np.random.default_rng(1), Spoiling(holes=0.05))
    assert not (holed & ~long).any() and 1 - holed.sum() / long.sum() == pytest.approx(0.05, abs=0.02)
    specked = spoil(long, np.random.default_rng(1), Spoiling(speckle=0.01))
    assert (specked & long).sum() == long.sum()
    assert specked[~long].mean() == pytest.approx(0.01, rel=0.3)


def test_a_ragged_edge_moves_only_what_is_near_it(masks):
    import cv2

    ragged = spoil(masks, np.random.default_rng(1), Spoiling(ragged=1.0))
    assert (ragged != masks).any()
    ring = np.ones((11, 11), np.uint8)
    for before, after in zip(masks, ragged, strict=True):
        near = cv2.dilate(before.astype(np.uint8), ring) - cv2.erode(before.astype(np.uint8), ring)
        assert not ((before != after) & (near == 0)).any()


def test_a_shadow_lies_on_the_floor_beside_the_feet(masks):
    added = spoil(masks, np.random.default_rng(1), Spoiling(shadow=0.8)) & ~masks
    rows, columns = np.nonzero(added.any(axis=0))
    floor = np.flatnonzero(masks[0].any(axis=1))[-1]
    middle = np.flatnonzero(masks[0].any(axis=0)).mean()
    assert floor - 8 < rows.min() and rows.max() <= floor + 1
    assert abs(columns.mean() - middle) > 5


def test_jitter_shifts_the_whole_picture(masks):
    shaken = spoil(masks, np.random.default_rng(2), Spoiling(jitter=3.0))
    centres = [np.argwhere(mask).mean(axis=0) for mask in shaken]
    assert np.std(centres, axis=0).min() > 1 and (shaken.sum(axis=(1, 2)) > 0.9 * masks[0].sum()).all()


@settings(max_examples=25, deadline=None)
@given(
    st.sampled_from(["empty", "full", "one pixel", "random"]),
    st.tuples(st.integers(0, 3), st.integers(1, 40), st.integers(1, 90)),
    st.integers(0, 99),
)
def test_any_mask_can_be_spoiled(kind, shape, seed):
    rng = np.random.default_rng(seed)
    masks = {"empty": np.zeros, "full": np.ones}.get(kind, np.zeros)(shape, bool)
    if kind == "one pixel" and masks.size:
        masks[:, shape[1] // 2, shape[2] // 2] = True
    if kind == "random":
        masks = rng.random(shape) < 0.5
    spoiled = spoil(masks, rng)
    assert spoiled.shape == masks.shape and spoiled.dtype == bool


def test_amounts_and_masks_out_of_range_are_refused(masks):
    with pytest.raises(OptionError, match="holes: expected 0 to 1"):
        Spoiling(holes=2.0)
    with pytest.raises(OptionError, match="ragged"):
        Spoiling(ragged=float("nan"))
    with pytest.raises(SilhouetteError, match="expected shape"):
        spoil(masks[0], np.random.default_rng(0))


def test_a_body_follows_its_own_motion(body, poses):
    motion = to_motion(body, poses, 30.0)
    followed = poses_from_motion(body, motion)
    off = compute_points(body, followed) - compute_points(body, poses)
    assert np.linalg.norm(off, axis=-1).mean() < 0.005


def test_another_tree_is_followed_by_its_names(body, poses):
    """Trajectories that hold the joints in another order, and others besides."""
    names = point_names(body)
    order = np.random.default_rng(0).permutation(len(names))
    points = compute_points(body, poses)
    more = np.concatenate((points[:, order], points[:, :1] + 1.0), axis=1)
    moving = Trajectories((*(names[k] for k in order), "lamp"), more, 30.0)
    off = compute_points(body, poses_from_motion(body, moving)) - points
    assert np.linalg.norm(off, axis=-1).mean() < 0.005


def test_a_person_with_other_bones_is_followed(body):
    motion = make_motion("throw", Performer(), frame_rate=10.0)
    followed = poses_from_motion(body, motion)
    truth = compute_trajectories(motion)
    limits = body.angle_limits
    assert followed.shape == (motion.n_frames, 7 + body.n_angles)
    assert ((followed[:, 7:] >= limits[:, 0] - 1e-9) & (followed[:, 7:] <= limits[:, 1] + 1e-9)).all()
    mine = compute_points(body, followed)
    shared = [name for name in CANONICAL_JOINTS if name in truth.names]
    rows = [point_names(body).index(name) for name in shared]
    off = mine[:, rows] - truth.positions[:, [truth.names.index(name) for name in shared]]
    assert np.linalg.norm(off, axis=-1).mean() < 0.08


def test_a_motion_without_the_bodys_joints_says_so():
    robot = Trajectories(("frame", "tool", "x"), np.random.default_rng(0).random((4, 3, 3)), 30.0)
    with pytest.raises(BodyModelError, match="expected joints of the body"):
        poses_from_motion(robot_arm(), robot)


def test_a_body_made_from_the_motion_follows_it_to_a_millimetre():
    from dousa.estimation.body.skeleton_body import body_from_motion

    motion = make_motion("walk", Performer(), frame_rate=15.0)
    made = body_from_motion(motion)
    truth = compute_trajectories(motion)
    points = compute_points(made, poses_from_motion(made, motion))
    off = points - truth.positions[:, [truth.names.index(name) for name in point_names(made)]]
    assert np.linalg.norm(off, axis=-1).mean() < 0.001


def test_a_recorded_person_is_followed(shared_data):
    """Spines that bend where the model is stiff cost a centimetre."""
    from dousa.estimation.body.skeleton_body import body_from_motion
    from dousa.formats.registry import read_motion
    from dousa.motion import canonicalise, resample

    path = shared_data("hdm05/grabHighR/HDM_bk_grabHighR_005_120.amc")
    motion = resample(read_motion(path), 15.0)
    made = body_from_motion(motion)
    points = compute_points(made, poses_from_motion(made, motion))
    rows = [point_names(made).index(name) for name in CANONICAL_JOINTS]
    assert np.linalg.norm(points[:, rows] - canonicalise(motion).positions, axis=-1).mean() < 0.012
