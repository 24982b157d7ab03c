"""Stature and girths from silhouettes: a thick person is found thick, and nothing breaks without a body."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dousa.errors import BodyModelError, SilhouetteError
from dousa.estimation.body.body import widen
from dousa.estimation.body.human import make_human
from dousa.estimation.body.kinematics import compute_points
from dousa.estimation.body.posing import fit_pose, standing_state
from dousa.estimation.body.skeleton_body import fit_body
from dousa.estimation.cameras.camera import Camera
from dousa.estimation.raster.rasteriser import draw_body
from dousa.estimation.tracking.person_size import fit_girths, measure_stature

BODY = make_human(1.7)


def camera(name, turn, distance=3.5, size=(200, 150)):
    """A camera that looks level at the middle of a person from so many radians round."""
    c, s = np.cos(turn), np.sin(turn)
    rotation = np.array([[c, 0, -s], [0, -1, 0], [-s, 0, -c]])
    matrix = np.array([[200.0, 0, size[0] / 2], [0, 200.0, size[1] / 2], [0, 0, 1]])
    return Camera(name, *size, matrix, rotation, -rotation @ [distance * s, 0.85, distance * c])


CAMERAS = [camera("front", 0.0), camera("side", 1.5)]
ROUND = [camera(f"at{degrees}", np.radians(degrees)) for degrees in (10, 100, 190, 280)]


def posed(body):
    """Arms and legs off the trunk, where every girth shows."""
    pose = standing_state(body)
    for name, angle in (("shoulder.2", 0.7), ("hip.2", 0.25), ("elbow.1", 0.5)):
        for side in ("left", "right"):
            sign = -1.0 if side == "right" and name != "elbow.1" else 1.0
            pose[7 + body.angle_names.index(f"{side}_{name}")] += sign * angle
    return pose


def masks_of(body, pose):
    return [draw_body(body, pose, view)[0] for view in CAMERAS]


def overlap(one, other):
    both = [(np.asarray(a) & b, np.asarray(a) | b) for a, b in zip(one, other, strict=True)]
    return sum(meet.sum() for meet, _ in both) / sum(union.sum() for _, union in both)


@given(share=st.floats(0.75, 1.6))
@settings(max_examples=12, deadline=None)
def test_a_person_of_another_girth_is_found(share):
    pose = posed(BODY)
    wanted = masks_of(widen(BODY, share), pose)
    found = fit_girths(BODY, pose, wanted, CAMERAS)
    assert overlap(masks_of(found, pose), wanted) > 0.95
    trunk = slice(*BODY.sphere_starts[1:3])
    np.testing.assert_allclose(found.spheres[trunk, 3] / BODY.spheres[trunk, 3], share, rtol=0.12)
    np.testing.assert_array_equal(found.offsets, BODY.offsets)
    np.testing.assert_array_equal(found.tip_offsets, BODY.tip_offsets)


def test_thick_legs_alone_are_found_on_both_sides():
    shares = np.array([1.2 if name.endswith("thigh") else 1.0 for name in BODY.names])
    pose = posed(BODY)
    found = fit_girths(BODY, pose, masks_of(widen(BODY, shares), pose), CAMERAS)
    grown = (found.spheres[:, 3] / BODY.spheres[:, 3])[BODY.sphere_starts[:-1]]
    left, right, arm = (BODY.names.index(name) for name in ("left_thigh", "right_thigh", "left_upper_arm"))
    assert grown[left] == grown[right] == pytest.approx(1.2, abs=0.06)
    assert grown[arm] == pytest.approx(1.0, abs=0.1)


def test_the_right_body_is_left_as_it_is():
    pose = posed(BODY)
    found = fit_girths(BODY, pose, masks_of(BODY, pose), CAMERAS)
    np.testing.assert_array_equal(found.spheres, BODY.spheres)


def test_several_frames_and_one_view_do():
    poses = np.stack([posed(BODY), standing_state(BODY)])
    view = draw_body(widen(BODY, 1.3), poses, CAMERAS[0])
    found = fit_girths(BODY, poses, [view], CAMERAS[:1])
    assert overlap([draw_body(found, poses, CAMERAS[0])], [view]) > 0.95


def test_left_and_right_stay_mirror_images_and_ends_grow_along():
    grown = widen(BODY, 1.5)
    head, thigh = (slice(*BODY.sphere_starts[part : part + 2]) for part in (2, BODY.names.index("left_thigh")))
    np.testing.assert_allclose(grown.spheres[head], 1.5 * BODY.spheres[head])
    np.testing.assert_array_equal(grown.spheres[thigh, 1], BODY.spheres[thigh, 1])
    np.testing.assert_allclose(grown.spheres[thigh, 3], 1.5 * BODY.spheres[thigh, 3])
    np.testing.assert_array_equal(compute_points(grown, posed(BODY)), compute_points(BODY, posed(BODY)))


def test_silhouettes_of_nothing_are_refused():
    pose = standing_state(BODY)
    empty = [np.zeros((view.height, view.width), bool) for view in CAMERAS]
    with pytest.raises(SilhouetteError, match="got empty masks"):
        fit_girths(BODY, pose, empty, CAMERAS)
    with pytest.raises(SilhouetteError, match="masks of 2 cameras, got 1"):
        fit_girths(BODY, pose, empty[:1], CAMERAS)
    with pytest.raises(SilhouetteError, match="masks of 0 cameras"):
        fit_girths(BODY, pose, [], [])
    with pytest.raises(SilhouetteError, match=r"view 'front': expected masks \(1, 150, 200\), got \(1, 9, 9\)"):
        fit_girths(BODY, pose, [np.ones((9, 9), bool)] * 2, CAMERAS)
    with pytest.raises(BodyModelError, match="rows of 37 numbers"):
        fit_girths(BODY, np.zeros(9), empty, CAMERAS)


def test_masks_that_are_all_body_stay_within_what_people_are():
    full = [np.ones((view.height, view.width), bool) for view in CAMERAS]
    found = fit_girths(BODY, standing_state(BODY), full, CAMERAS)
    assert (found.spheres[:, 3] / BODY.spheres[:, 3]).max() <= 1.8 + 1e-9


def test_girths_of_the_first_frame_serve_the_later_ones(shared_data):
    with np.load(shared_data("silhouette_bench/bk_rotatearms_clean.npz")) as data:
        masks = np.unpackbits(data["mask_packed"], axis=3)[..., :320].astype(bool)
        names, positions = [str(name) for name in data["joint_names"]], data["joint_positions"]
        views = [
            Camera(str(v), 320, 240, data["camera_matrix"][v], data["world_to_camera_rotation"][v], t)
            for v, t in enumerate(data["world_to_camera_translation"])
        ]
        stature = float(data["stature"])
    first = dict(zip(names, positions[0], strict=True))
    body = fit_body(make_human(stature), first)
    own = fit_girths(body, fit_pose(body, first)[0], list(masks[:, 0]), views)
    later = dict(zip(names, positions[18], strict=True))

    def fit(tried):
        pose = fit_pose(tried, later)[0]
        return overlap([draw_body(tried, pose, view)[0] for view in views], list(masks[:, 18]))

    assert fit(own) > max(fit(body), 0.83)


def test_several_views_tell_the_stature_and_one_does_not():
    body = make_human(1.87)
    masks = [draw_body(body, standing_state(body), view)[0] for view in ROUND]
    assert abs(measure_stature(ROUND, masks) - 1.87) < 0.03
    assert measure_stature(ROUND[:1], masks[:1]) is None
