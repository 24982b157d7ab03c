"""OpenSim's joint angles: which way each turns, there and back, from other bodies, what is no motion."""

import csv

import numpy as np
import pytest

from dousa.estimation.body.human import make_human
from dousa.estimation.body.kinematics import to_motion
from dousa.estimation.body.posing import compute_angles, standing_state
from dousa.formats.opensim import compute_coordinates, list_coordinates
from dousa.formats.registry import is_motion_file, read_motion, write_motion
from dousa.motion import JOINT_INDEX, canonicalise, compute_trajectories
from dousa.motion.rotations import from_axis_angle
from dousa.motion.synthetic import draw_performer, make_motion
from formats.made_files import code_of, make_mot, save

PLACES = ("pelvis_tx", "pelvis_ty", "pelvis_tz")


def pose(tmp_path, **angles):
    """The places of canonical joints under some angles in degrees; X left, Y up, Z forward."""
    rows = {name: [angles.get(name, 0.0)] * 3 for name in (*list_coordinates(), *PLACES)}
    return read_motion(save(tmp_path / "x.mot", make_mot(rows)))


@pytest.mark.parametrize(
    ("angle", "start", "end", "axis", "sign"),
    [  # a positive angle takes the limb from start to end along the axis (0 left, 1 up, 2 forward)
        ("hip_flexion_r", "right_hip", "right_knee", 2, 1),
        ("hip_flexion_l", "left_hip", "left_knee", 2, 1),
        ("hip_adduction_r", "right_hip", "right_knee", 0, 1),
        ("hip_adduction_l", "left_hip", "left_knee", 0, -1),
        ("knee_angle_r", "right_knee", "right_ankle", 2, -1),
        ("ankle_angle_l", "left_ankle", "left_toe", 1, 1),
        ("hip_rotation_r", "right_ankle", "right_toe", 0, 1),
        ("hip_rotation_l", "left_ankle", "left_toe", 0, -1),
        ("arm_flex_r", "right_shoulder", "right_elbow", 2, 1),
        ("arm_add_l", "left_shoulder", "left_elbow", 0, -1),
        ("elbow_flex_l", "left_elbow", "left_wrist", 2, 1),
        ("lumbar_extension", "spine", "neck", 2, -1),
        ("lumbar_bending", "spine", "neck", 0, -1),
        ("pelvis_tilt", "pelvis", "neck", 2, -1),
        ("pelvis_list", "pelvis", "neck", 0, -1),
        ("pelvis_rotation", "right_ankle", "right_toe", 0, 1),
    ],
)
def test_which_way_an_angle_turns(tmp_path, angle, start, end, axis, sign):
    limbs = []
    for degrees in (0.0, 20.0):
        motion = pose(tmp_path, **{angle: degrees})
        positions = compute_trajectories(motion).positions[0]
        limbs.append(positions[motion.skeleton.names.index(end)] - positions[motion.skeleton.names.index(start)])
    change = (limbs[1] - limbs[0]) / np.linalg.norm(limbs[0])
    assert sign * change[axis] > 0.15


def test_there_and_back(tmp_path):
    """Angles of a file are written again as they were."""
    rng = np.random.default_rng(0)
    rows = {name: rng.uniform(-40, 40, 30) for name in list_coordinates()}
    rows |= {name: rng.uniform(5, 80, 30) for name in rows if name.startswith(("knee", "elbow"))}
    rows |= {name: rng.uniform(-1, 1, 30) for name in PLACES}
    path = save(tmp_path / "x.mot", make_mot(rows))
    assert is_motion_file(path)
    motion = read_motion(path)
    assert motion.frame_rate == 100.0
    write_motion(motion, tmp_path / "y.mot")
    lines = (tmp_path / "y.mot").read_text().split("endheader\n")[1].split("\n")
    titles, values = lines[0].split(), np.array([line.split() for line in lines[1:] if line], float)
    for name, expected in rows.items():
        found = values[:, titles.index(name)]
        np.testing.assert_allclose(found, expected, atol=1e-5, err_msg=name)


def test_radians_and_coordinates_that_lack(tmp_path):
    rows = {name: np.full(4, 0.5) for name in ("hip_flexion_r", "hip_flexion_l", "knee_angle_r", "knee_angle_l")}
    motion = read_motion(save(tmp_path / "x.mot", make_mot(rows, in_degrees="no")))
    assert {note.code for note in motion.provenance.notes} >= {"opensim.mean_body", "opensim.missing"}
    positions = compute_trajectories(motion).positions[0]
    names = motion.skeleton.names
    thigh = positions[names.index("left_knee")] - positions[names.index("left_hip")]
    assert np.arctan2(thigh[2], -thigh[1]) == pytest.approx(0.5)


def test_from_another_body(tmp_path):
    """Thighs, shanks, upper arms and forearms of a walk point where they did, but for what a hinge cannot do."""
    walk = make_motion("walk", draw_performer(2))
    write_motion(walk, tmp_path / "x.mot")
    again = read_motion(tmp_path / "x.mot")
    assert again.n_frames == walk.n_frames
    one, other = canonicalise(walk).positions, canonicalise(again).positions
    off = []
    for start, end in (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist")):
        for side in ("left_", "right_"):
            limbs = [p[:, JOINT_INDEX[side + end]] - p[:, JOINT_INDEX[side + start]] for p in (one, other)]
            limbs = [limb / np.linalg.norm(limb, axis=1, keepdims=True) for limb in limbs]
            off.append(np.degrees(np.arccos(np.clip((limbs[0] * limbs[1]).sum(axis=1), -1, 1))))
    assert np.mean(off) < 2.0
    np.testing.assert_allclose(other[:, 0], one[:, 0], atol=0.03)


def test_a_fitted_body_keeps_its_angles_without_jumps(tmp_path):
    """An arm goes up sideways to 150 degrees: through the lock of the turns, where two of them jump by half a turn."""
    body = make_human(1.7)
    raised = np.radians(np.linspace(8, 150, 72))
    poses = np.tile(standing_state(body), (len(raised), 1))
    part = body.names.index("left_upper_arm")
    own = slice(7 + body.angle_starts[part], 7 + body.angle_starts[part] + 3)
    for pose, angle in zip(poses, raised, strict=True):
        pose[own] = compute_angles(body, part, from_axis_angle(np.array([0.0, 0.0, angle])))
    motion = to_motion(body, poses, 30.0)
    found = compute_coordinates(motion)
    assert max(np.abs(values[0]).max() for name, values in found.items() if "_" in name and name[:3] != "arm") < 1.0
    np.testing.assert_allclose(found["arm_add_l"], -np.degrees(raised), atol=0.1)
    assert max(np.abs(np.diff(values)).max() for values in found.values()) < 2.1
    write_motion(motion, tmp_path / "x.bvh")
    again = compute_coordinates(read_motion(tmp_path / "x.bvh"))
    for name, values in found.items():
        np.testing.assert_allclose(again[name], values, atol=0.01, err_msg=name)


def test_the_same_angles_in_a_plain_table(tmp_path):
    walk = make_motion("walk", draw_performer(2))
    write_motion(walk, tmp_path / "x.angles.csv")
    with open(tmp_path / "x.angles.csv", encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    wanted = {"time_s": np.arange(walk.n_frames) / walk.frame_rate, **compute_coordinates(walk)}
    assert list(rows[0]) == list(wanted)
    for name, values in wanted.items():
        np.testing.assert_allclose([float(row[name]) for row in rows], values, atol=1e-6)
    assert not is_motion_file(tmp_path / "x.angles.csv")


def test_damage(tmp_path):
    rows = {name: np.zeros(4) for name in list_coordinates()}
    good = make_mot(rows)
    for number, (data, code) in enumerate((
        (b"time\t1\n", "opensim.no_header"),
        (b"name ground_reaction\nendheader\ntime\tground_force_vx\n0\t1\n", "opensim.no_coordinates"),
        (good[: good.index(b"pro_sup_r") + 10], "tables.no_frames"),
        (good.replace(b"0.000000000\n", b"high\n", 1), "tables.number"),
    )):  # fmt: skip
        assert code_of(save(tmp_path / f"{number}.mot", data)) == code, number


def test_joints_under_the_names_of_opencap_there_and_back(tmp_path):
    walk = make_motion("walk", draw_performer(2))
    write_motion(walk, tmp_path / "x.opencap.trc")
    found = read_motion(tmp_path / "x.opencap.trc")
    assert {"Neck", "midHip", "RShoulder", "LKnee", "RBigToe"} < set(found.names) and found.provenance.format == "trc"
    ours, theirs = canonicalise(walk), canonicalise(found)
    rows = [JOINT_INDEX[joint] for joint in ("neck", "pelvis", "left_wrist", "right_knee", "left_ankle", "right_toe")]
    np.testing.assert_allclose(theirs.positions[:, rows, 1], ours.positions[:, rows, 1], atol=1e-6)
    near = theirs.positions[:, rows] - theirs.positions[:1, :1], ours.positions[:, rows] - ours.positions[:1, :1]
    np.testing.assert_allclose(*(np.linalg.norm(part, axis=2) for part in near), atol=1e-6)
    assert theirs.mapping.sides == "agree"
    legs = ours.to_trajectories().replace(positions=np.where(np.arange(20)[:, None] < 12, np.nan, ours.positions))
    write_motion(legs, tmp_path / "legs.opencap.trc")
    assert "Neck" not in read_motion(tmp_path / "legs.opencap.trc").names
