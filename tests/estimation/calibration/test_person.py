"""Cameras found from a made-up performer whose true cameras are known, and what cannot be found."""

from dataclasses import replace

import numpy as np
import pytest
from oracles.made_films import NAMES, Performance, film, make_cameras

from dousa.errors import CalibrationError, OptionError
from dousa.estimation import PersonTrack, ViewKeypoints, calibrate_from_person, make_view, read_cameras, write_cameras
from dousa.estimation.calibration.person import find_world, measure_stature
from dousa.estimation.sync.synchronise import rig_of

ACTS = ("punch", "turn_around", "kick_left", "raise_hands")


@pytest.fixture(scope="module")
def performance():
    return Performance(ACTS)


def angle_between(first, second):
    return np.degrees(np.arccos(np.clip((np.trace(first @ second.T) - 1) / 2, -1, 1)))


def place_on(points, truth):
    """Scale, rotation and offset that bring points (N, 3) nearest to others (Umeyama 1991)."""
    a, b = points - points.mean(axis=0), truth - truth.mean(axis=0)
    left, sizes, right = np.linalg.svd(b.T @ a)
    sign = np.diag([1, 1, np.sign(np.linalg.det(left @ right))])
    rotation = left @ sign @ right
    scale = (sizes * np.diag(sign)).sum() / (a**2).sum()
    return scale, rotation, truth.mean(axis=0) - scale * rotation @ points.mean(axis=0)


@pytest.mark.parametrize("known", ["lenses", pytest.param("focals", marks=pytest.mark.slow), "nothing"])
def test_cameras_stand_where_they_stood(performance, known, tmp_path):
    cameras = make_cameras(3)
    views = [film(performance, camera, 0.5, 5.0, seed=2) for camera in cameras]
    given = {"lenses": {"cameras": cameras}, "focals": {"focals": [1500.0] * 3}, "nothing": {}}[known]
    found = calibrate_from_person(views, performance.stature, **given)
    for one in range(3):
        for other in range(one):
            expected = cameras[one].rotation @ cameras[other].rotation.T
            made = found.cameras[one].rotation @ found.cameras[other].rotation.T
            assert angle_between(made, expected) < (1.0 if known != "nothing" else 3.0)
    true = np.stack([camera.position for camera in cameras])
    made = np.stack([camera.position for camera in found.cameras])
    scale, rotation, offset = place_on(made, true)
    assert scale == pytest.approx(1.0, abs=0.08)  # limbs of a made-up person are not those of the tables
    assert np.degrees(np.arccos(rotation[1, 1])) < 5.0  # up is up
    assert abs(offset[1]) < 0.12  # the floor
    assert np.abs(scale * made @ rotation.T + offset - true).max() < (0.15 if known != "nothing" else 0.5)
    assert all(view.share > 0.9 and 0.5 < view.residual < 6.0 for view in found.views)
    assert found.points.shape[1:] == (len(found.names), 3) and not found.warnings
    write_cameras(tmp_path / "calib.toml", found.cameras)
    again = read_cameras(tmp_path / "calib.toml")
    np.testing.assert_allclose(again[2].position, found.cameras[2].position, atol=1e-9)


def test_offsets_and_the_person_are_taken(performance):
    cameras = make_cameras(2)
    views = [film(performance, camera, begin, 4.0) for camera, begin in zip(cameras, (0.5, 1.3), strict=True)]
    both = ViewKeypoints(
        views[1].names, (film(Performance(ACTS, seed=6), cameras[1], 0, 4.0).people[0], *views[1].people),
        views[1].times, views[1].size, "both",
    )  # fmt: skip
    found = calibrate_from_person(
        [views[0], both], performance.stature, cameras=cameras, offsets=(0.0, 0.8), people=(0, 1)
    )
    expected = cameras[1].rotation @ cameras[0].rotation.T
    assert angle_between(found.cameras[1].rotation @ found.cameras[0].rotation.T, expected) < 1.5


@pytest.mark.slow
def test_films_of_other_people_agree_with_no_cameras(performance):
    cameras = make_cameras(3)
    others = [performance, Performance(("squat", "lunge", "sit_down"), seed=8), Performance(("jump", "bow"), seed=9)]
    views = [film(who, camera, 0.2, 4.0) for who, camera in zip(others, cameras, strict=True)]
    with pytest.raises(CalibrationError) as caught:
        calibrate_from_person(views, 1.7, cameras=cameras)
    assert caught.value.code == "calibration.no_agreement"


@pytest.mark.slow
def test_wrong_times_are_doubted_or_refused(performance):
    cameras, begins = make_cameras(3), (0.5, 1.3, 0.1)
    views = [film(performance, camera, begin, 4.0) for camera, begin in zip(cameras, begins, strict=True)]
    try:
        found = calibrate_from_person(views, performance.stature, cameras=cameras)
    except CalibrationError as error:
        assert error.code in ("calibration.no_agreement", "calibration.unsure")
    else:
        assert "calibration.few_agree" in [note.code for note in found.warnings]


@pytest.mark.slow
def test_cameras_side_by_side_tell_no_depth(performance):
    near = [make_view((x, 1.4, 4.5), (x, 0.9, 0.0), size=(1920, 1080), focal=1500.0) for x in (0.0, 0.1)]
    near = [replace(camera, name=f"film{place}") for place, camera in enumerate(near)]
    views = [film(performance, camera, 0.5, 4.0, noise=1.0) for camera in near]
    with pytest.raises(CalibrationError) as caught:
        calibrate_from_person(views, 1.7, cameras=near)
    assert caught.value.code in ("calibration.no_parallax", "calibration.unsure")


def test_what_cannot_be_calibrated_is_said(performance):
    cameras = make_cameras(2)
    views = [film(performance, camera, 0.5, 2.0) for camera in cameras]
    empty = ViewKeypoints(views[0].names, (), views[0].times, views[0].size, "empty")
    unseen = PersonTrack(np.full((60, 17, 2), np.nan), np.zeros((60, 17)))
    nobody = ViewKeypoints(views[0].names, (unseen,), views[0].times, (640, 480), "nobody")
    for wrong, stature, given, code in (
        (views[:1], 1.7, {}, "calibration.one_view"),
        (views, 17.0, {}, "calibration.stature"),
        (views, 1.7, {"focals": (1500.0,)}, "sync.count"),
        (views, 1.7, {"focals": (1500.0, -1.0)}, "calibration.focal"),
        ([views[0], empty], 1.7, {}, "calibration.nobody"),
        ([views[0], nobody], 1.7, {}, "calibration.nobody"),
        (views, 1.7, {"offsets": (0.0, 60.0)}, "calibration.no_overlap"),
    ):
        with pytest.raises((CalibrationError, OptionError)) as caught:
            calibrate_from_person(wrong, stature, **given)
        assert caught.value.code == code


def test_stature_and_world_of_a_known_body(performance):
    times = np.arange(0.0, 3.0, 1 / 30)
    points = performance.at(times)
    assert measure_stature(points, NAMES) == pytest.approx(performance.stature, rel=0.08)
    assert measure_stature(points[:, :1], NAMES[:1]) is None
    rig = rig_of(make_cameras(2))
    assert find_world(rig, points[:, :1], NAMES[:1], 1.7, times) is None
    turned, placed = find_world(rig, points, NAMES, performance.stature, times)
    seen, expected = turned.project(placed), rig.project(points)
    np.testing.assert_allclose(seen, expected, atol=1e-6)  # the pictures do not change
