"""Films whose cameras or people are not what they are said to be: an error or a warning, never silence."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from app.made_landmarks import NAMES, OWN
from dousa.estimation import (
    PersonTrack,
    ViewKeypoints,
    make_human,
    make_ring,
    poses_from_motion,
    write_cameras,
    write_keypoints,
)
from dousa.estimation.multiview.landmarks import place_landmarks
from dousa.estimation.multiview.pose_residuals import place_points
from dousa.motion.synthetic.performers import draw_performer, make_motion

SIZE, RATE = (640, 480), 30.0
BODY, CAMERAS = make_human(1.75), make_ring(3, size=SIZE, focal=500.0)


@pytest.fixture(scope="module")
def poses():
    """Of a throw, and of somebody else who does something else a metre away."""
    one = poses_from_motion(BODY, make_motion("throw", draw_performer(3), frame_rate=RATE))[20:60]
    other = one[::-1].copy()
    other[:, 0] += 1.0
    return one, other


def look(camera, rows):
    """Points (T, K, 2) that a network would find."""
    places = place_points(BODY, rows, place_landmarks(BODY, OWN))
    return camera.project(places) + np.random.default_rng(0).normal(0, 1.0, (*places.shape[:2], 2))


@pytest.fixture
def run(dousa, tmp_path):
    """Estimate from points of each view; exit code, warnings and what is said of an error."""

    def estimate(points, cameras, *words):
        sources = []
        for camera, own in zip(CAMERAS, points, strict=False):
            people = () if own is None else (PersonTrack(own, np.full(own.shape[:2], 0.9)),)
            times = np.arange(len(points[0])) / RATE
            write_keypoints(tmp_path / f"{camera.name}.npz", ViewKeypoints(NAMES, people, times, SIZE))
            sources.append(tmp_path / f"{camera.name}.npz")
        write_cameras(tmp_path / "cameras.toml", cameras)
        given = ("--cameras", tmp_path / "cameras.toml", "--cues", "keypoints", "--offsets", "none", "--json")
        code, out, err = dousa("estimate", *sources, *given, *words, "-o", tmp_path / "x.bvh")
        assert (tmp_path / "x.bvh").exists() == (code == 0)
        return code, json.loads(out)["warnings"] if code == 0 else err

    return estimate


def test_right_films_and_cameras_raise_no_doubt(run, poses):
    code, said = run([look(camera, poses[0]) for camera in CAMERAS], CAMERAS)
    assert code == 0 and not [line for line in said if "check" in line or "left out" in line or "tall" in line]


def test_exchanged_cameras_are_doubted(run, poses):
    points = [look(camera, poses[0]) for camera in CAMERAS]
    code, said = run([points[1], points[0], points[2]], CAMERAS)
    assert code == 0 and any("check" in line and "calibration" in line for line in said)


def test_another_person_in_one_view_is_left_out_and_said(run, poses):
    code, said = run([look(CAMERAS[0], poses[1]), *(look(camera, poses[0]) for camera in CAMERAS[1:])], CAMERAS)
    assert code == 0 and any("view1" in line and "left out" in line for line in said)


def test_a_camera_that_moves_is_left_out_and_said(run, poses):
    points = [look(camera, poses[0]) for camera in CAMERAS]
    points[0] = points[0] + np.linspace(0, 1, len(poses[0]))[:, None, None] * np.array([250.0, 80.0])
    code, said = run(points, CAMERAS)
    assert code == 0 and any("view1" in line and "left out" in line for line in said)


def test_two_views_of_two_people_are_refused(run, poses):
    code, said = run([look(CAMERAS[0], poses[1]), look(CAMERAS[1], poses[0])], CAMERAS[:2])
    assert code == 2 and "view1 and view2" in said and "different people" in said


def test_two_cameras_at_one_place_are_refused(run, poses):
    twice = [CAMERAS[0], replace(CAMERAS[0], name=CAMERAS[1].name)]
    code, said = run([look(CAMERAS[0], poses[0])] * 2, twice)
    assert code == 2 and "do not agree" in said


def test_lenses_of_another_camera_make_an_odd_body(run, poses):
    longer = [replace(camera, matrix=camera.matrix * [[1.4, 1, 1], [1, 1.4, 1], [1, 1, 1]]) for camera in CAMERAS]
    code, said = run([look(camera, poses[0]) for camera in CAMERAS], longer)
    assert code == 0 and any("that tall" in line for line in said)


def test_a_view_without_anybody_does_no_harm(run, poses):
    code, said = run([look(CAMERAS[0], poses[0]), None, look(CAMERAS[2], poses[0])], CAMERAS)
    assert code == 0 and not any("left out" in line for line in said)


def test_one_frame_is_enough(run, poses):
    code, said = run([look(camera, poses[0][:1]) for camera in CAMERAS], CAMERAS)
    assert code == 0 and not any("left out" in line for line in said)
