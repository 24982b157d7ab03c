"""The exam of angles: its own degrees and baselines, on poses that are known."""

import numpy as np
import pytest

from lab.exams import angles
from lab.exams import angles_films as films
from lab.exams.angles_measures import ANGLES, AT, JOINTS, differ, find_angles, lift, read_angles, to_rays, triangulate
from lab.exams.sides_people import Camera


def make_pose(bend: float) -> np.ndarray:
    """Who stands upright, faces +z, and has the left knee bent by so many degrees, the left arm out to the side."""
    pose = np.zeros((1, 14, 3))
    for sign, side in ((1, "left"), (-1, "right")):
        for joint, height in (("hip", 0.9), ("knee", 0.5), ("ankle", 0.1), ("toe", 0.1), ("shoulder", 1.4)):
            pose[0, AT[f"{side}_{joint}"]] = [0.1 * sign, height, 0.15 * (joint == "toe")]
        pose[0, [AT[f"{side}_elbow"], AT[f"{side}_wrist"]]] = [[0.1 * sign, 1.1, 0], [0.1 * sign, 1.1, 0.25]]
    back = np.deg2rad(bend)
    pose[0, AT["left_ankle"]] = [0.1, 0.5 - 0.4 * np.cos(back), -0.4 * np.sin(back)]
    pose[0, AT["left_elbow"]] = [0.4, 1.4, 0]
    pose[0, AT["left_wrist"]] = [0.7, 1.4, 0]
    return pose


def test_known_poses_have_their_angles():
    found = find_angles(make_pose(70.0))
    wanted = {"hip": (0, 0), "knee": (70, 0), "arm": (90, 0), "elbow": (0, 90), "arm adduction": (-90, 0)}
    for name, values in wanted.items():
        np.testing.assert_allclose(found[name][0], values, atol=1e-5, err_msg=name)
    assert found["ankle"][0, 1] == pytest.approx(0)


def test_columns_of_opensim_say_the_same():
    columns = {f"lumbar_{word}": np.zeros(1) for word in ("extension", "bending", "rotation")}
    for side, knee in (("l", 20.0), ("r", 0.0)):
        values = {"hip_flexion_": 30, "hip_adduction_": 10, "knee_angle_": knee, "ankle_angle_": 5}
        values |= {"arm_flex_": -40, "arm_add_": -20, "elbow_flex_": 90}
        columns |= {name + side: np.array([float(value)]) for name, value in values.items()}
    found = read_angles(columns)
    assert set(found) == set(ANGLES)
    np.testing.assert_allclose(found["hip flexion"], 30)
    np.testing.assert_allclose(found["hip adduction"], 10)
    np.testing.assert_allclose(found["arm flexion"], -40)
    np.testing.assert_allclose(found["arm adduction"], -20)
    np.testing.assert_allclose(found["knee"], [[20, 0]])
    # A trunk that leans forward by 15 degrees over a thigh that hangs is a hip bent by some of it; an arm stays.
    leaning = read_angles({name: np.zeros(1) for name in columns} | {"lumbar_extension": np.array([-15.0])})
    np.testing.assert_allclose(leaning["hip flexion"], 10.5, atol=0.2)
    np.testing.assert_allclose(leaning["arm flexion"], -4.5, atol=0.2)
    assert differ(found, find_angles(make_pose(0.0)))["knee"] == pytest.approx(10)


def test_the_baselines_find_x_without_noise():
    matrix = np.array([[1440.0, 0, 720], [0, 1440, 540], [0, 0, 1]])
    ahead, side = np.diag([-1.0, -1, 1]), np.array([[0.0, 0, 1], [0, -1, 0], [1, 0, 0]])
    cameras = [Camera(matrix, turn, np.array([0, 0.9, 3.5])) for turn in (ahead, side)]
    truth = np.repeat(make_pose(40.0), 9, axis=0)
    lens = np.array([-0.1, 0.02, 0.001, 0])
    seen = [films.see(truth, JOINTS, camera, lens, False, np.random.default_rng(k)) for k, camera in enumerate(cameras)]
    rays = np.stack([to_rays(s[..., :2], camera, lens) for s, camera in zip(seen, cameras, strict=True)])
    trust = np.stack([s[..., 2] for s in seen])
    assert np.abs(triangulate(rays, trust, cameras) - truth).max() < 0.05
    assert np.isfinite(lift(rays[0], trust[0], cameras[0], 1.7, truth[0])).all()


def test_a_film_without_an_answer_has_a_row_of_its_baseline(capsys):
    plain = differ(find_angles(make_pose(30.0)), find_angles(make_pose(0.0))) | {"mm": 12.0}
    angles.tell([{"plain": plain}], ("keypoints", 4, False))
    assert capsys.readouterr().out.startswith("keypoints, 4 views, clean | - / 7.5 (4)* | - / 0.0 (7)* |")
