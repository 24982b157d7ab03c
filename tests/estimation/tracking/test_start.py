"""The first pose, and the stature, from the silhouettes of one frame."""

import numpy as np
import pytest

from dousa.errors import SilhouetteError
from dousa.estimation.body.body import BodyModel
from dousa.estimation.body.human import make_human
from dousa.estimation.body.kinematics import compute_points, point_names
from dousa.estimation.body.posing import standing_state
from dousa.estimation.cameras.camera import Camera
from dousa.estimation.raster.rasteriser import draw_body
from dousa.estimation.tracking.outlines import guess_place, lines_meet, measure_outline, move_onto, turn_about
from dousa.estimation.tracking.person_size import measure_stature
from dousa.estimation.tracking.search_setup import SearchSetup
from dousa.estimation.tracking.settings import TrackerSettings
from dousa.estimation.tracking.start import (
    exchange_pair,
    find_limbs,
    find_pairs,
    find_start,
    is_person,
    list_templates,
    mirror_twins,
)
from lab.estimation.clips import read_clip

BODY = make_human(1.7)
WIDTH, HEIGHT = 160, 120


def look_from(degrees, distance=4.0):
    """A camera at 1.1 m that looks at the vertical through the origin; from 0 degrees it sees +Z."""
    angle = np.radians(degrees)
    back = np.array([np.sin(angle), 0.0, np.cos(angle)])
    rotation = np.array([np.cross(back, (0, -1.0, 0)) * -1.0, (0, -1.0, 0), -back])
    rotation[0] = np.cross(rotation[1], rotation[2])
    centre = distance * back + np.array([0, 1.1, 0])
    matrix = np.array([[170.0, 0, 79.5], [0, 170.0, 59.5], [0, 0, 1]])
    return Camera(f"at{degrees}", WIDTH, HEIGHT, matrix, rotation, -rotation @ centre)


def make_setup(body, cameras, masks):
    setup = SearchSetup(body, cameras, TrackerSettings(), 30.0, float(np.mean([mask.sum() for mask in masks])))
    return setup, setup.pack(masks)


def draw(body, pose, cameras):
    return [draw_body(body, pose, camera)[0] for camera in cameras]


def joint_error(body, pose, truth):
    return np.linalg.norm(compute_points(body, pose) - compute_points(body, truth), axis=-1).mean()


def some_pose(yaw=2.0):
    """A template, turned, moved and bent a little: not a pose of the bank."""
    pose = turn_about(list_templates(BODY)[10:11], yaw)[0]
    pose[0] += 0.3
    limits = BODY.angle_limits
    pose[7:] = np.clip(pose[7:] + np.random.default_rng(3).uniform(-0.2, 0.2, len(limits)), *limits.T)
    return pose


VIEWS = [look_from(degrees) for degrees in (10, 100, 190, 280)]


def test_four_views_tell_the_pose():
    truth = some_pose()
    masks = draw(BODY, truth, VIEWS)
    (found,) = find_start(*make_setup(BODY, VIEWS, masks), masks)
    assert found.iou > 0.85
    assert joint_error(BODY, found.pose, truth) < 0.06
    assert np.isclose(np.linalg.norm(found.pose[3:7]), 1.0)
    limits = BODY.angle_limits
    assert ((found.pose[7:] >= limits[:, 0] - 1e-9) & (found.pose[7:] <= limits[:, 1] + 1e-9)).all()


def test_views_that_see_nobody_are_passed_over_and_the_best_come_first():
    truth = some_pose(0.5)
    masks = draw(BODY, truth, VIEWS[:3])
    setup, frame = make_setup(BODY, VIEWS, masks)
    steps = []
    found = find_start(
        setup, setup.pack([*masks, None]), [*masks, None], n_best=3, progress=lambda *step: steps.append(step)
    )
    assert frame.seen.tolist() == [True, True, True, False]
    assert 1 <= len(found) <= 3
    assert [start.score for start in found] == sorted((start.score for start in found), reverse=True)
    assert joint_error(BODY, found[0].pose, truth) < 0.08
    assert steps[0][0] == 0
    assert steps[-1][0] == steps[-1][1]


def test_the_same_call_gives_the_same_answer():
    masks = draw(BODY, some_pose(), VIEWS[:2])
    answers = [find_start(*make_setup(BODY, VIEWS[:2], masks), masks)[0] for _ in range(2)]
    np.testing.assert_array_equal(answers[0].pose, answers[1].pose)


def test_a_pose_of_some_time_ago_may_help():
    truth = some_pose(-1.0)
    masks = draw(BODY, truth, VIEWS[:1])
    setup, frame = make_setup(BODY, VIEWS[:1], masks)
    near = truth.copy()
    near[:3] += (0.05, 0.0, -0.05)
    (found,) = find_start(setup, frame, masks, near=near)
    assert found.iou > 0.85


def test_nobody_in_any_view_is_an_error():
    empty = [np.zeros((HEIGHT, WIDTH), bool), None]
    setup = SearchSetup(BODY, VIEWS[:2], TrackerSettings(), 30.0, 1000.0)
    with pytest.raises(SilhouetteError, match="expected somebody in at least one view"):
        find_start(setup, setup.pack(empty), empty)
    with pytest.raises(SilhouetteError, match="expected somebody in at least one view"):
        measure_stature(VIEWS[:2], empty)


def crane():
    """A post that is no person, with an arm of two hinges."""
    axes, limits = np.zeros((3, 3, 3)), np.zeros((3, 3, 2))
    axes[1, 0], axes[2, 0] = (1, 0, 0), (1, 0, 0)
    limits[1, 0], limits[2, 0] = (-0.5, 1.6), (0.0, 2.0)
    return BodyModel(
        names=("post", "arm", "claw"),
        joints=("post", "elbow", "wrist"),
        parents=[-1, 0, 1],
        offsets=[[0, 0, 0], [0, 0.9, 0], [0, 0.7, 0]],
        rest=np.tile([1.0, 0, 0, 0], (3, 1)),
        n_axes=[0, 1, 1],
        axes=axes,
        limits=limits,
        spheres=[(0, y, 0, r) for y, r in ((0, 0.2), (0.9, 0.1), (0, 0.08), (0.7, 0.06), (0, 0.05), (0.4, 0.03))],
        sphere_starts=[0, 2, 4, 6],
        tips=("claw_end",),
        tip_parts=[2],
        tip_offsets=[[0, 0.4, 0]],
        stature=2.0,
    )


def test_another_body_than_a_person_is_found_too():
    body = crane()
    truth = np.array([0.2, 0.2, 0.1, np.cos(0.4), 0, np.sin(0.4), 0, 0.8, 1.2])
    masks = draw(body, truth, VIEWS)
    (found,) = find_start(*make_setup(body, VIEWS, masks), masks)
    assert not is_person(body)
    assert joint_error(body, found.pose, truth) < 0.05


def test_templates_are_poses_within_the_limits_that_differ():
    templates = list_templates(BODY)
    assert 40 <= len(templates) <= 80
    assert list_templates(make_human(1.7)) is templates
    limits = BODY.angle_limits
    assert ((templates[:, 7:] >= limits[:, 0]) & (templates[:, 7:] <= limits[:, 1])).all()
    points = compute_points(BODY, templates)
    off = np.linalg.norm(points[:, None] - points[None], axis=-1).mean(axis=-1)
    assert off[~np.eye(len(off), dtype=bool)].min() > 0.02


def test_limbs_of_a_person_are_head_arms_and_legs():
    parts = {tuple(BODY.names[part] for part in limb[1]) for limb in find_limbs(BODY)}
    sides = ("left", "right")
    assert parts == {
        ("head",),
        *((f"{side}_upper_arm", f"{side}_forearm", f"{side}_hand") for side in sides),
        *((f"{side}_thigh", f"{side}_shank", f"{side}_foot") for side in sides),
    }


def test_twins_face_the_other_way_and_exchange_the_sides():
    pose = standing_state(BODY)
    names = point_names(BODY)
    left, right = names.index("left_shoulder"), names.index("right_shoulder")
    for twin in mirror_twins(BODY, pose, np.array([0.0, 0.0, 1.0])):
        points, turned = compute_points(BODY, pose), compute_points(BODY, twin)
        np.testing.assert_allclose(turned[left], points[right], atol=0.03)
        np.testing.assert_allclose(turned[right], points[left], atol=0.03)


def test_exchanged_legs_end_where_the_others_did():
    pose = some_pose()
    pairs = {BODY.names[pair.parts[0]]: pair for pair in find_pairs(BODY)}
    assert set(pairs) == {"left_upper_arm", "left_thigh"}
    names, legs = point_names(BODY), pairs["left_thigh"]
    points, other = (compute_points(BODY, row) for row in (pose, exchange_pair(BODY, pose, legs)))
    left, right = names.index("left_ankle"), names.index("right_ankle")
    for one, two in ((left, right), (right, left)):
        assert np.linalg.norm(other[one] - points[two]) < 0.5 * np.linalg.norm(points[one] - points[two])
    still = np.setdiff1d(np.arange(len(points)), legs.points)
    np.testing.assert_allclose(other[still], points[still], atol=1e-9)


def test_templates_are_laid_onto_the_silhouettes():
    pose = standing_state(BODY)
    pose[:3] += (0.4, 0.0, -0.2)
    outlines = [measure_outline(mask) for mask in draw(BODY, pose, VIEWS)]
    for views in (slice(0, 4), slice(0, 1)):
        place = guess_place(VIEWS[views], outlines[views], BODY.stature)
        moved = move_onto(BODY, pose[None] + 0.0, place, VIEWS[views], outlines[views])
        assert np.linalg.norm(moved[0, :3] - pose[:3]) < (0.03 if views.stop == 4 else 0.1)
    assert lines_meet(VIEWS, outlines)
    assert not lines_meet(VIEWS[:1], outlines[:1])


def test_specks_and_cut_sides_do_not_count():
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[40:120, 60:80] = True
    mask[3, 5] = mask[100, 150] = True
    outline = measure_outline(mask)
    np.testing.assert_array_equal(outline.box, [60, 79, 40, 119])
    assert outline.whole.tolist() == [True, True, True, False]
    assert measure_outline(None) is None


@pytest.mark.slow
def test_a_real_person_is_found(shared_data):
    clip = read_clip(shared_data("silhouette_bench/cmu86_punch_noisy.npz"))
    body = make_human(clip.stature)
    masks = clip.silhouettes.read(0)
    (found,) = find_start(*make_setup(body, clip.cameras, list(masks)), masks)
    order = [point_names(body).index(name) for name in clip.joints]
    off = np.linalg.norm(compute_points(body, found.pose)[order] - clip.truth[0], axis=1)
    assert off.mean() < 0.08
