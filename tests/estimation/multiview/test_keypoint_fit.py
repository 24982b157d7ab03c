"""A made-up performer seen by made cameras, the truth known: triangulation, sides, people, and the body's motion."""

from dataclasses import replace

import numpy as np
import pytest

from dousa.errors import KeypointError
from dousa.estimation import (
    MEDIAPIPE_NAMES,
    PersonTrack,
    fit_keypoints,
    make_human,
    make_ring,
    match_people,
    poses_from_motion,
    repair_sides,
    triangulate,
)
from dousa.estimation.body.kinematics import compute_points, point_names, step_poses
from dousa.estimation.body.posing import standing_state
from dousa.estimation.body.skeleton_body import fit_body
from dousa.estimation.multiview.body_fit import _solve, find_covariance, force_weights
from dousa.estimation.multiview.contours import contour_errors, list_cones, trace_contour
from dousa.estimation.multiview.keypoint_fit import _move_joints, fit_some_girths
from dousa.estimation.multiview.landmarks import find_sources, gather, place_landmarks
from dousa.estimation.multiview.people import resample_track
from dousa.estimation.multiview.pose_residuals import place_points, point_slopes
from dousa.estimation.raster.rendering import render
from dousa.estimation.silhouettes.silhouettes import PackedSilhouettes
from dousa.motion import canonicalise
from dousa.motion.synthetic.performers import draw_performer, make_motion

RATE = 30.0
NAMES = tuple(name for name in MEDIAPIPE_NAMES if name in find_sources(MEDIAPIPE_NAMES) or "foot_index" in name)


@pytest.fixture(scope="module")
def body():
    human = make_human(1.80, measures={"thigh": 0.44, "upper_arm": 0.30})
    return _move_joints(human)  # hips and shoulders where people have them


@pytest.fixture(scope="module")
def poses(body):
    motion = make_motion("punch", draw_performer(3), frame_rate=RATE)
    # with the performer's own bones: onto another trunk the back would be bent by 66 degrees in every frame
    own = fit_body(body, canonicalise(motion).positions)
    return poses_from_motion(own, motion)[10:70]


@pytest.fixture(scope="module")
def cameras():
    return make_ring(4, size=(640, 480), focal=600.0)


def film(body, poses, cameras, noise=2.0, seed=0):
    """What a network would say, with errors in px that last for some frames."""
    rng = np.random.default_rng(seed)
    own = tuple(name.replace("foot_index", "toe") for name in NAMES)
    places = place_points(body, poses, place_landmarks(body, own))
    tracks = []
    for camera in cameras:
        points = camera.project(places)
        slow = rng.normal(0, noise, (len(poses) // 10 + 2, *points.shape[1:]))
        points += np.repeat(slow, 10, axis=0)[: len(poses)]
        world = (places - places.mean(axis=1, keepdims=True)) @ camera.rotation.T
        world += rng.normal(0, 0.02, (1, *world.shape[1:]))
        tracks.append(PersonTrack(points, np.full(points.shape[:2], 0.95), world))
    return tracks, places


def swap(track, frames, points=NAMES):
    """Left and right exchanged in some frames."""
    order = [
        NAMES.index(name.replace("left", "?").replace("right", "left").replace("?", "right")) if name in points else row
        for row, name in enumerate(NAMES)
    ]
    changed = track.points.copy()
    changed[frames] = changed[frames][:, order]
    return PersonTrack(changed, track.visibility, track.world)


def joint_error(fit, body, poses, aligned=False):
    """Distances (T, N) m, but for joints that no keypoint is near; with the hips in place where that is asked for."""
    names = point_names(body)
    found, truth = compute_points(fit.estimate.body, fit.estimate.poses), compute_points(body, poses)
    if aligned:
        hips = [names.index("left_hip"), names.index("right_hip")]
        found = found - found[:, hips].mean(axis=1, keepdims=True) + truth[:, hips].mean(axis=1, keepdims=True)
    rows = [row for row, name in enumerate(names) if name not in ("pelvis", "spine", "head")]
    return np.linalg.norm(found[:, rows] - truth[:, rows], axis=2)


class TestTriangulate:
    def test_points_without_errors_are_met(self, cameras):
        places = np.random.default_rng(1).normal((0, 1, 0), 0.4, (5, 7, 3))
        found = triangulate(cameras, np.stack([camera.project(places) for camera in cameras]))
        np.testing.assert_allclose(found.points, places, atol=1e-6)
        assert found.used.all()

    def test_a_view_that_is_wrong_is_left_out(self, cameras):
        places = np.random.default_rng(2).normal((0, 1, 0), 0.4, (30, 3))
        points = np.stack([camera.project(places) for camera in cameras])
        points[2] += 80.0
        found = triangulate(cameras, points)
        np.testing.assert_allclose(found.points, places, atol=1e-6)
        assert not found.used[2].any() and found.used[[0, 1, 3]].all()

    def test_one_view_tells_nothing_and_two_tell(self, cameras):
        points = np.stack([camera.project(np.array([[0.1, 1.0, 0.2]])) for camera in cameras])
        points[1:] = np.nan
        assert np.isnan(triangulate(cameras, points).points).all()
        points[1] = cameras[1].project(np.array([[0.1, 1.0, 0.2]]))
        np.testing.assert_allclose(triangulate(cameras, points).points[0], (0.1, 1.0, 0.2), atol=1e-6)

    def test_the_covariance_is_that_of_the_errors(self, cameras):
        rng = np.random.default_rng(3)
        place = np.array([0.0, 1.0, 0.0])
        exact = np.stack([camera.project(np.tile(place, (4000, 1))) for camera in cameras])
        scale = 600.0 / np.linalg.norm(cameras[0].position - place)
        found = triangulate(cameras, exact + rng.normal(0, 0.01 * scale, exact.shape), spread=0.01)
        measured = np.cov((found.points - place).T)
        np.testing.assert_allclose(
            np.sqrt(np.diag(found.covariance.mean(axis=0))), np.sqrt(np.diag(measured)), rtol=0.1
        )


def test_exchanged_sides_are_put_right(body, poses, cameras):
    tracks, places = film(body, poses, cameras)
    wrong = [swap(tracks[0], slice(20, 35)), tracks[1], swap(tracks[2], slice(0, 60)), tracks[3]]
    seen = gather(wrong, NAMES, len(poses))
    repaired, exchanged = repair_sides(cameras, seen)
    expected = np.zeros((4, 60), bool)
    expected[0, 20:35] = expected[2] = True
    assert (exchanged == expected[..., None]).mean() > 0.98
    assert (repair_sides(cameras, gather(tracks, NAMES, len(poses)))[1]).sum() == 0
    found = triangulate(cameras, repaired.points)
    assert np.nanmedian(np.linalg.norm(found.points - places, axis=2)) < 0.02


class TestFit:
    def test_four_views_find_body_and_motion(self, body, poses, cameras):
        fit = fit_keypoints(cameras, film(body, poses, cameras)[0], NAMES, RATE)
        assert joint_error(fit, body, poses).mean() < 0.02
        row = point_names(body).index("head")  # a stature is how high the head stands
        true = np.divide(
            *(compute_points(own, standing_state(own))[row, 1] for own in (body, _move_joints(make_human(1.0))))
        )
        found, spread = fit.estimate.lengths["stature"]
        assert fit.estimate.body.stature == found and abs(found - true) < 0.03 and 0.02 < spread < 0.05
        thigh, spread = fit.estimate.lengths["thigh"]
        true = np.linalg.norm(body.offsets[body.joints.index("left_knee")])
        assert abs(thigh - true) < max(3 * spread, 0.01) and 0 < spread < 0.03
        assert not fit.estimate.lost.any()
        limits = body.angle_limits
        assert (fit.estimate.poses[:, 7:] >= limits[:, 0] - 1e-9).all()

    def test_outliers_swaps_and_hidden_views_do_little(self, body, poses, cameras):
        tracks, _ = film(body, poses, cameras)
        rng = np.random.default_rng(7)
        points = tracks[1].points.copy()
        wild = rng.random(points.shape[:2]) < 0.15
        points[wild] += rng.normal(0, 150, (int(wild.sum()), 2))
        tracks[1] = PersonTrack(points, tracks[1].visibility, tracks[1].world)
        tracks[0] = swap(tracks[0], slice(15, 40))
        hidden = tracks[3].points.copy()
        hidden[25:50] = np.nan
        tracks[3] = PersonTrack(hidden, tracks[3].visibility, tracks[3].world)
        fit = fit_keypoints(cameras, tracks, NAMES, RATE)
        assert joint_error(fit, body, poses).mean() < 0.025

    def test_what_no_view_shows_is_carried_by_time_and_known_less_well(self, body, poses, cameras):
        tracks, _ = film(body, poses, cameras)
        rows = [NAMES.index(name) for name in ("left_wrist", "left_elbow", "left_index", "left_pinky") if name in NAMES]
        gone = []
        for track in tracks:
            points = track.points.copy()
            points[28:34, rows] = np.nan
            gone.append(PersonTrack(points, track.visibility, track.world))
        fit = fit_keypoints(cameras, gone, NAMES, RATE)
        wrist = point_names(fit.estimate.body).index("left_wrist")
        assert fit.estimate.uncertainty[31, wrist] > 1.5 * fit.estimate.uncertainty[10, wrist]
        assert fit.estimate.occluded[31, fit.estimate.body.names.index("left_forearm")]

    def test_frames_without_anybody_are_lost(self, body, poses, cameras):
        tracks = []
        for track in film(body, poses, cameras)[0]:
            points = track.points.copy()
            points[20:45] = np.nan
            tracks.append(PersonTrack(points, track.visibility, track.world))
        lost = fit_keypoints(cameras, tracks, NAMES, RATE).estimate.lost
        assert lost[20:45].all() and not lost[:20].any() and not lost[45:].any()

    def test_hips_and_shoulders_of_another_build_follow_keypoints_that_are_joints(self, body, poses, cameras):
        offsets = body.offsets.copy()
        for part, move in (("thigh", (0.02, 0.02, 0.01)), ("upper_arm", (0.015, -0.015, 0.0))):
            for side, mirror in (("left_", 1.0), ("right_", -1.0)):
                offsets[body.names.index(side + part)] += np.array(move) * (mirror, 1.0, 1.0)
        other = replace(body, offsets=offsets)
        assert "left_mouth" not in NAMES
        fit = fit_keypoints(cameras, film(other, poses, cameras, noise=0.5)[0], NAMES, RATE)
        assert joint_error(fit, other, poses).mean() < 0.006
        at = dict(zip(other.names, other.offsets, strict=True))
        true = {
            "hip_breadth": 2.0 * at["left_thigh"][0],
            "shoulder_breadth": 2.0 * at["left_upper_arm"][0],
            "trunk": at["trunk"][1] + at["head"][1] - at["left_thigh"][1],
        }
        assert {name: abs(fit.estimate.lengths[name][0] - length) < 0.015 for name, length in true.items()} == (
            dict.fromkeys(true, True)
        )

    def test_one_view_keeps_the_posture_and_says_that_depth_is_unsure(self, body, poses, cameras):
        tracks, _ = film(body, poses, cameras)
        fit = fit_keypoints(cameras[:1], tracks[:1], NAMES, RATE, stature=1.80)
        assumed = fit_keypoints(cameras[:1], tracks[:1], NAMES, RATE)
        places = compute_points(assumed.estimate.body, assumed.estimate.poses)
        away = np.linalg.norm(places + cameras[0].rotation.T @ cameras[0].translation, axis=-1)
        assert (assumed.estimate.uncertainty >= 0.03 * away).all()
        assert assumed.estimate.expected_error.mean() > fit.estimate.expected_error.mean()
        assert joint_error(fit, body, poses, aligned=True).mean() < 0.06
        assert (assumed.estimate.depth_spread > fit.estimate.depth_spread).all()
        four = fit_keypoints(cameras, tracks, NAMES, RATE, stature=1.80)
        assert four.estimate.depth_spread is None

    @pytest.mark.slow
    def test_a_long_film_is_fitted_in_stretches(self, body, poses, cameras):
        tracks, _ = film(body, poses, cameras)
        whole = fit_keypoints(cameras, tracks, NAMES, RATE)
        parts = fit_keypoints(cameras, tracks, NAMES, RATE, window=20, margin=8)
        apart = np.linalg.norm(parts.points - whole.points, axis=2)
        assert parts.estimate.n_frames == 60 and apart.max() < 0.01
        np.testing.assert_allclose(parts.estimate.uncertainty, whole.estimate.uncertainty, rtol=0.1)

    def test_nobody_is_one_error(self, cameras):
        nothing = PersonTrack(np.full((9, len(NAMES), 2), np.nan), np.zeros((9, len(NAMES))))
        with pytest.raises(KeypointError, match="nobody"):
            fit_keypoints(cameras, [nothing] * 4, NAMES, RATE)
        with pytest.raises(KeypointError, match="points of a body"):
            fit_keypoints(cameras, [nothing] * 4, [f"point {k}" for k in range(len(NAMES))], RATE)
        with pytest.raises(KeypointError, match="one track for each"):
            fit_keypoints(cameras, [nothing] * 3, NAMES, RATE)


def test_people_are_matched_whatever_their_order_in_each_view(body, poses, cameras):
    other = poses.copy()
    other[:, 0] += 1.1
    ones, others = film(body, poses, cameras)[0], film(body, other, cameras, seed=1)[0]
    views = [[a, b] if number % 2 else [b, a] for number, (a, b) in enumerate(zip(ones, others, strict=True))]
    people = match_people(cameras, views, NAMES)
    assert len(people) == 2
    assert {person.members for person in people} == {((0,), (1,), (0,), (1,)), ((1,), (0,), (1,), (0,))}


def test_a_person_who_was_lost_in_a_view_is_one_person_again(body, poses, cameras):
    tracks = film(body, poses, cameras)[0]
    halves = []
    for part in (slice(0, 25), slice(35, 60)):
        points = np.full(tracks[0].points.shape, np.nan)
        points[part] = tracks[0].points[part]
        halves.append(PersonTrack(points, tracks[0].visibility, tracks[0].world))
    people = match_people(cameras, [halves, *([track] for track in tracks[1:])], NAMES)
    assert len(people) == 1 and people[0].members[0] == (0, 1)
    assert people[0].tracks[0].present.sum() == 50


def test_a_track_between_its_frames():
    points = np.arange(12.0).reshape(6, 1, 2)
    points[3] = np.nan
    track = PersonTrack(points, np.ones((6, 1)))
    moved = resample_track(track, np.arange(6) / 10, np.array([0.0, 0.15, 0.25, 0.4, 0.9]))
    np.testing.assert_allclose(moved.points[[0, 1, 3], 0], [[0, 1], [3, 4], [8, 9]])
    assert moved.present.tolist() == [True, True, False, True, False]


def test_the_banded_equations_are_those_of_the_whole_matrix(body):
    rng = np.random.default_rng(0)
    force, size = force_weights(body, RATE), 6 + body.n_angles
    for n_frames in (1, 2, 5, 6):
        roots = rng.normal(size=(n_frames, size, size))
        square, gradient = np.einsum("tij,tkj->tik", roots, roots), rng.normal(size=(n_frames, size))
        bend = np.zeros((max(n_frames - 2, 0), n_frames))
        for t in range(n_frames - 2):
            bend[t, t : t + 3] = 1, -2, 1
        whole = np.kron(bend.T @ bend, np.diag(force))
        for t in range(n_frames):
            whole[t * size : (t + 1) * size, t * size : (t + 1) * size] += square[t] + 1e-9 * np.eye(size)
        step = np.linalg.solve(whole, -gradient.ravel()).reshape(n_frames, size)
        np.testing.assert_allclose(_solve(square, gradient, force, 0.0), step, rtol=1e-6, atol=1e-9)
        inverse = np.linalg.inv(whole).reshape(n_frames, size, n_frames, size)
        for t in range(n_frames):
            np.testing.assert_allclose(find_covariance(square, force)[t], inverse[t, :, t], rtol=1e-5, atol=1e-9)


def test_contours_lie_on_the_body_and_their_slopes_are_its_movements(body, poses, cameras):
    camera, cones, pose = cameras[0], list_cones(body), poses[20:21]
    mask = render(body, pose, [camera])[0][0]
    points = trace_contour(mask, camera.size)[None]
    places, slopes = point_slopes(body, pose, cones.centres)
    errors, ways = contour_errors(camera, cones, points, places, slopes)
    assert np.nanmax(np.abs(errors)) < 0.02  # of parts that a pixel of 6 mm and the edge between two parts cut
    step = 1e-4 * np.random.default_rng(0).normal(size=ways.shape[-1])
    moved, _ = contour_errors(
        camera, cones, points, place_points(body, step_poses(pose, step[None]), cones.centres), slopes
    )
    # slopes leave out that a disc grows as it comes nearer, and that another place of the cone is the nearest
    assert np.abs(moved - errors - ways @ step).mean() < 0.2 * np.abs(ways @ step).mean()
    assert np.isnan(trace_contour(None, camera.size)).all()


@pytest.mark.parametrize("views", [pytest.param([0, 1, 2, 3], marks=pytest.mark.slow), [0, 1]])
def test_silhouettes_put_right_what_keypoints_leave_open(body, poses, cameras, views):
    tracks, _ = film(body, poses, cameras, noise=10.0)
    cameras, tracks = [cameras[view] for view in views], [tracks[view] for view in views]
    silhouettes = PackedSilhouettes(render(body, poses, cameras), RATE)
    fits = [
        fit_keypoints(cameras, tracks, NAMES, RATE, stature=1.80, silhouettes=masks) for masks in (None, silhouettes)
    ]
    alone, both = (joint_error(fit, body, poses).mean() for fit in fits)
    assert both < 0.95 * alone


def test_girths_are_fitted_where_the_person_is_seen(body, poses, cameras):
    masks = np.array(render(body, poses, cameras))
    missing = np.zeros(masks.shape[:2], bool)
    missing[:, : len(poses) // 3] = missing[0] = True  # comes late, and is never in the first view
    thin = replace(body, spheres=body.spheres * (1.0, 1.0, 1.0, 0.8))
    fitted = fit_some_girths(thin, poses, PackedSilhouettes(masks, RATE, missing=missing), cameras)
    assert fitted.spheres[:, 3].mean() == pytest.approx(body.spheres[:, 3].mean(), rel=0.1)


def test_an_interrupted_fit_goes_on_where_it_stopped(body, poses, cameras):
    tracks = [replace(track, points=track.points[:24], visibility=track.visibility[:24], world=None)
              for track in film(body, poses, cameras[:2])[0]]  # fmt: skip
    given = {"body": body, "silhouettes": PackedSilhouettes(render(body, poses[:24], cameras[:2]), RATE)}
    kept = []
    whole = fit_keypoints(cameras[:2], tracks, NAMES, RATE, **given, window=12, margin=4,
                          on_checkpoint=lambda make: kept.append(make()))  # fmt: skip
    assert [(partial.stage, len(partial.poses)) for partial in kept] == [(0, 12), (0, 24), (1, 12), (1, 24)]
    for partial in (kept[0], kept[2]):
        again = fit_keypoints(cameras[:2], tracks, NAMES, RATE, **given, window=12, margin=4, resume=partial)
        np.testing.assert_allclose(again.estimate.poses, whole.estimate.poses, atol=1e-9)
        np.testing.assert_allclose(again.estimate.uncertainty, whole.estimate.uncertainty, atol=1e-9)
