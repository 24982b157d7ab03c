"""The bundle adjustment against scipy's least squares, and against scenes whose cameras are known."""

from dataclasses import replace

import numpy as np
import pytest
from oracles.made_films import NAMES, Performance, film, make_cameras
from scipy.optimize import least_squares

from dousa.estimation.calibration import bundle
from dousa.estimation.calibration.bundle import Freedom, Limb, Rig, Sightings, adjust
from dousa.estimation.calibration.rig_search import find_rig, triangulate
from dousa.estimation.calibration.sightings import list_limbs, make_track, read_sightings
from dousa.motion.rotations import from_axis_angle, to_matrix


def make_small(rng, noise=2.0):
    """Three cameras, four moments, five points of which some are not seen; two limbs of one kind."""
    cameras = make_cameras(3)
    rig = Rig(
        np.stack([camera.rotation for camera in cameras]),
        np.stack([camera.translation for camera in cameras]),
        np.array([camera.matrix[0, 0] for camera in cameras]),
        np.zeros(3),
    )
    points = rng.uniform((-0.5, 0.2, -0.5), (0.5, 1.7, 0.5), (4, 5, 3))
    points[:, 1] = points[:, 0] + 0.4 * _unit(rng.normal(size=(4, 3)))
    points[:, 3] = points[:, 2] + 0.4 * _unit(rng.normal(size=(4, 3)))
    weights = np.where(rng.random((3, 4, 5)) < 0.15, 0.0, rng.uniform(0.5, 1.0, (3, 4, 5)))
    seen = rig.project(points) + rng.normal(0, noise, (3, 4, 5, 2))
    velocities = rng.normal(0, 300, seen.shape)
    sightings = Sightings(seen, weights, np.array([3.0, 4.0, 5.0]), velocities, np.zeros(3))
    return sightings, rig, points, (Limb(0, 1, 0, 0.05), Limb(2, 3, 0, 0.05))


def _unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def unfold(x, rig, shape, free):
    """A state from plain numbers, by other means than the code under test."""
    cameras = np.zeros((3, 8))
    cameras.ravel()[free] = x[: free.sum()]
    turned = np.stack(
        [to_matrix(from_axis_angle(turn)) @ r for turn, r in zip(cameras[:, :3], rig.rotations, strict=True)]
    )
    moved = replace(rig, rotations=turned, translations=rig.translations + cameras[:, 3:6],
                    focals=rig.focals * np.exp(cameras[:, 6]), offsets=rig.offsets + cameras[:, 7])  # fmt: skip
    rest = x[free.sum() :]
    return moved, rest[:-1].reshape(shape), rest[-1]


def slow_residuals(x, sightings, rig, points, limbs, freedom):
    """Pairs of residuals as one number each, so that scipy's Cauchy loss is ours."""
    free = freedom.mask(3)
    moved, places, length = unfold(x, rig, points.shape, free)
    found = []
    for view in range(3):
        for t in range(points.shape[0]):
            for k in range(points.shape[1]):
                if (sightings.weights[:, t, k] > 0).sum() < 2 or sightings.weights[view, t, k] == 0:
                    continue
                local = moved.rotations[view] @ places[t, k] + moved.translations[view]
                seen = sightings.points[view, t, k] - moved.offsets[view] * sightings.velocities[view, t, k]
                off = (moved.focals[view] * local[:2] / local[2] - seen) / sightings.spreads[view]
                found.append((np.linalg.norm(off), sightings.weights[view, t, k]))
    known = (sightings.weights > 0).sum(axis=0) >= 2
    for limb in limbs:
        for t in range(points.shape[0]):
            if known[t, limb.first] and known[t, limb.second]:
                along = np.linalg.norm(places[t, limb.first] - places[t, limb.second])
                found.append(((np.log(along) - length) / limb.spread, 1.0))
    return np.array(found)


@pytest.mark.parametrize(
    "freedom",
    [
        pytest.param(Freedom(), marks=pytest.mark.slow),
        pytest.param(Freedom(offsets=True), marks=pytest.mark.slow),
        Freedom(focals=True, offsets=True, focal_spread=0.2),
    ],
)
def test_the_cost_has_no_better_place_nearby(freedom):
    """Our cost is that of the plain residuals, and scipy finds no lower one."""
    rng = np.random.default_rng(4)
    sightings, rig, points, limbs = make_small(rng)
    fit = adjust(sightings, rig, points, limbs, freedom, 200)
    known = sightings.seen_twice

    def cost(x, about):
        rows = slow_residuals(x, sightings, about, points, limbs, freedom)
        total = 0.5 * (rows[:, 1] * 4.0 * np.log1p(rows[:, 0] ** 2 / 4.0)).sum()
        if freedom.focals:
            moved = unfold(x, about, points.shape, freedom.mask(3))[0]
            total += 0.5 * ((np.log(moved.focals / rig.focals) / freedom.focal_spread) ** 2).sum()
        return total

    n_free = int(freedom.mask(3).sum())
    places = np.where(known[..., None], fit.points, 0.0)
    ours = np.concatenate((np.zeros(n_free), places.ravel(), np.log(fit.lengths)))
    assert cost(ours, fit.rig) == pytest.approx(fit.cost, rel=1e-9)
    start = np.concatenate((np.zeros(n_free), points.ravel(), [np.log(0.4)]))

    def rows(x):
        found = slow_residuals(x, sightings, rig, points, limbs, freedom)
        robust = np.sqrt(found[:, 1] * 4.0 * np.log1p(found[:, 0] ** 2 / 4.0))
        if not freedom.focals:
            return robust
        moved = unfold(x, rig, points.shape, freedom.mask(3))[0]
        return np.concatenate((robust, np.log(moved.focals / rig.focals) / freedom.focal_spread))

    best = least_squares(rows, start, max_nfev=20)
    assert fit.cost <= best.cost * (1 + 1e-3)


def test_the_first_camera_stays_and_what_nobody_saw_is_unknown():
    rng = np.random.default_rng(5)
    sightings, rig, points, limbs = make_small(rng)
    sightings.weights[1:, 2, 4] = 0.0
    fit = adjust(sightings, rig, points, limbs)
    assert np.array_equal(fit.rig.rotations[0], rig.rotations[0])
    assert np.isnan(fit.points[2, 4]).all() and np.isfinite(fit.points[3, 0]).all()
    assert not fit.covariance[:8].any()


def test_a_rig_is_found_from_nothing_but_points():
    performance, cameras = Performance(("punch", "turn_around", "kick_left")), make_cameras(3)
    views = [film(performance, camera, 0.0, 3.0, seed=1) for camera in cameras]
    tracks = [
        make_track(view.times, view.people[0].points, view.people[0].visibility, camera)
        for view, camera in zip(views, cameras, strict=True)
    ]
    sightings = read_sightings(tracks, np.zeros(3), np.arange(0.1, 2.8, 0.05))
    guess = find_rig(sightings, np.full(3, 1500.0), list_limbs(NAMES))
    assert guess is not None
    fit = adjust(sightings, guess.rig, triangulate(sightings, guess.rig), list_limbs(NAMES))
    for view in (1, 2):
        expected = cameras[view].rotation @ cameras[0].rotation.T
        turn = np.degrees(np.arccos((np.trace(fit.rig.rotations[view] @ expected.T) - 1) / 2))
        assert turn < 1.0
    assert len(fit.covariance) == bundle.CAMERA_UNKNOWNS * 3


def test_points_that_agree_with_no_rig_are_refused():
    rng = np.random.default_rng(0)
    few = np.zeros((2, 3, 2, 2))
    sightings = Sightings(few, np.ones((2, 3, 2)), np.ones(2), np.zeros_like(few), np.zeros(2))
    assert find_rig(sightings, np.full(2, 1000.0), ()) is None
    seen = rng.uniform(-1, 1, (2, 3, 2, 2))
    assert find_rig(replace(sightings, points=seen), np.full(2, 1000.0), ()) is None


def test_points_are_read_between_frames_with_their_velocity():
    times = np.sort(np.random.default_rng(0).uniform(0, 2, 90))
    curve = np.stack((300 * np.sin(3 * times), 200 * times), axis=-1)[:, None]
    camera = make_cameras(1)[0]
    track = make_track(times, curve + camera.matrix[:2, 2], np.ones((90, 1)), camera)
    moments = np.array([0.4, 1.0, 1.55])
    points, velocities, weights = track.read(moments)
    np.testing.assert_allclose(points[:, 0, 0], 300 * np.sin(3 * moments), atol=2.0)
    np.testing.assert_allclose(velocities[:, 0, 1], 200, atol=1.0)
    np.testing.assert_allclose(velocities[:, 0, 0], 900 * np.cos(3 * moments), atol=40.0)
    assert (weights > 0).all()
    assert not track.read(np.array([-0.5, 2.6]))[2].any()
