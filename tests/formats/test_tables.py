"""Tables with a header: the forms of many programs on one walking body, what is no motion, damage, folders."""

import numpy as np
import pytest

from dousa.errors import MotionFileError
from dousa.formats import find_motion_files
from dousa.formats.registry import is_motion_file, read_motion
from dousa.formats.tables.columns import find_columns
from dousa.motion import JOINT_INDEX, Motion, Trajectories, canonicalise
from formats import made_points as made
from formats.made_files import code_of, save
from formats.made_tables import (
    KINECT,
    MEDIAPIPE,
    SMPL,
    at_times_of_day,
    count_points,
    join,
    long_table,
    nexus,
    table,
    two_rows,
    visual3d,
)

FORMS = {
    "commas": (MEDIAPIPE, lambda: table(MEDIAPIPE), 50.0),
    "azure": (KINECT, lambda: table(KINECT, "{}_{}", axes="XYZ", rate=30, scale=1000), 30.0),
    "tabs and dots": (MEDIAPIPE, lambda: table(MEDIAPIPE, "{}.{}", "\t", axes="XYZ"), 50.0),
    "semicolons and decimal commas": (MEDIAPIPE, lambda: table(MEDIAPIPE, "{} {}", ";").replace(".", ","), 50.0),
    "blanks": (SMPL, lambda: table(SMPL, "{}_{}", " "), 50.0),
    "units in titles": (SMPL, lambda: table(SMPL, "{} {} (mm)", scale=1000), 50.0),
    "no separator": (SMPL, lambda: table(SMPL, "{}{}", axes="XYZ"), 50.0),
    "axis first": (SMPL, lambda: table(SMPL, "{1}_{0}"), 50.0),
    "words for places": (SMPL, lambda: table(SMPL, "{}.Position.{}", axes="XYZ"), 50.0),
    "frames only": (MEDIAPIPE, lambda: table(MEDIAPIPE, columns=("Frame",)), 30.0),
    "milliseconds": (MEDIAPIPE, lambda: table(MEDIAPIPE, columns=("Frame", "time (ms)")), 50.0),
    "rate above": (
        MEDIAPIPE,
        lambda: table(MEDIAPIPE, columns=(), before=(["Frame rate", 120],)),
        120.0,
    ),
    "nexus": (SMPL, lambda: nexus(SMPL), 100.0),
    "long": (MEDIAPIPE, lambda: long_table(MEDIAPIPE), 30.0),
    "visual3d": (SMPL, lambda: visual3d(SMPL), 20.0),
    "times of day": (MEDIAPIPE, lambda: at_times_of_day(table(MEDIAPIPE)), 50.0),
    "deeplabcut": (MEDIAPIPE, lambda: two_rows(MEDIAPIPE), 30.0),
    "numbers for names": (MEDIAPIPE, lambda: count_points(table(MEDIAPIPE)), 50.0),
}


@pytest.mark.parametrize("form", FORMS)
def test_forms(tmp_path, form):
    title, text, rate = FORMS[form]
    path = save(tmp_path / "x.csv", text().encode())
    motion = read_motion(path)
    expected = made.make_points(title)[1]
    assert isinstance(motion, Trajectories)
    assert motion.frame_rate == pytest.approx(rate, rel=1e-6)
    assert is_motion_file(path)
    found = canonicalise(motion).positions
    for first, second in (("left_knee", "left_ankle"), ("left_knee", "right_wrist"), ("left_shoulder", "right_hip")):
        got = found[:, JOINT_INDEX[first]] - found[:, JOINT_INDEX[second]]
        wanted = expected[first] - expected[second]
        np.testing.assert_allclose(np.linalg.norm(got, axis=1), np.linalg.norm(wanted, axis=1), atol=2e-4)
    np.testing.assert_allclose(found[:, JOINT_INDEX["left_knee"], 1], expected["left_knee"][:, 1], atol=2e-4)


NOT_MOTIONS = {
    "labels": (lambda: "file,category\na.bvh,walk\n", "tables.no_points"),
    "sensors": (lambda: "time,acc_x,acc_y,acc_z,gyro_x,gyro_y,gyro_z\n0,1,2,3,4,5,6\n", "tables.no_points"),
    "worn sensors": (lambda: table(SMPL, "{}_acc_{}"), "tables.no_points"),
    "angles": (lambda: table(SMPL, "{}_angle_{}"), "tables.no_points"),
    "picture": (lambda: table(SMPL).replace("_z", "_score"), "guard.flat"),
    "nothing": (lambda: "", "disk.empty"),
    "prose": (lambda: "Dear all,\n\nplease find x, y and z.\n", "tables.no_points"),
    "no rows": (lambda: table(SMPL).split("\n")[0] + "\n", "tables.no_frames"),
}


@pytest.mark.parametrize("kind", NOT_MOTIONS)
def test_what_is_no_motion(tmp_path, kind):
    text, code = NOT_MOTIONS[kind]
    path = save(tmp_path / "x.csv", text().encode())
    assert code_of(path) == code
    assert kind == "no rows" or not is_motion_file(path)


def test_points_of_a_picture(tmp_path):
    points = np.random.default_rng(0).uniform(0.3, 0.6, size=(20, 33, 3))
    path = save(tmp_path / "x.csv", table(MEDIAPIPE, points=points).encode())
    assert code_of(path) == "landmarks.picture"


def test_other_tables_of_a_folder_are_left(tmp_path):
    for kind, (text, _) in NOT_MOTIONS.items():
        save(tmp_path / f"{kind}.csv", text().encode())
    places = "time,ball_x,ball_y,ball_z,bat_x,bat_y,bat_z\n0,1,2,3,4,5,6\n"
    save(tmp_path / "ball.csv", places.encode())
    save(tmp_path / "walk.csv", FORMS["nexus"][1]().encode())
    files, _ = find_motion_files([tmp_path])
    assert {file.path.name for file in files} <= {"walk.csv", "no rows.csv"}


def test_blanks_and_points_that_were_not_seen(tmp_path):
    lines = two_rows(MEDIAPIPE).split("\n")
    cells = lines[5].split(",")
    cells[1:4], cells[8] = ["", "NaN", "-"], "0"
    motion = read_motion(save(tmp_path / "x.csv", "\n".join([*lines[:5], ",".join(cells), *lines[6:]]).encode()))
    assert np.isnan(motion.positions[2, :2]).all()
    assert np.isfinite(np.delete(motion.positions, 2, axis=0)).all()


def test_damage(tmp_path):
    text = table(SMPL)
    lines = text.split("\n")
    place = lines[4].split(",")[7]
    path = save(tmp_path / "x.csv", text.replace(place, "high", 1).encode())
    with pytest.raises(MotionFileError, match=r"x.csv:\d+: expected a number, got 'high'"):
        read_motion(path)
    first = lines[0].split(",")
    for titles in (first[:5] + first[6:], [*first[:5], "more", *first[5:]]):  # one is missing, or too many
        moved = "\n".join((",".join(titles), *lines[1:]))
        assert code_of(save(tmp_path / "w.csv", moved.encode())) == "tables.width"
    ends = text.rstrip("\n")
    for bytes_off in (3, 200):  # in the last number, in the middle of the row
        cut = read_motion(save(tmp_path / "y.csv", ends[:-bytes_off].encode()))
        assert "guard.cut_off" in {note.code for note in cut.provenance.notes}, bytes_off
    assert code_of(save(tmp_path / "z.csv", text.replace(place, "1e999", 1).encode())) == "guard.no_place"


def test_people_by_a_column(tmp_path):
    lines = table(SMPL).strip().split("\n")
    rows = [line for n, line in enumerate(lines[1:]) for line in (f"7,{line}", *([f"9,{line}"] if n < 20 else []))]
    path = save(tmp_path / "x.csv", join([["body_id," + lines[0]], *([row] for row in rows)]).encode())
    motion = read_motion(path)
    assert motion.n_frames == len(lines) - 1
    assert "parts.person" in {note.code for note in motion.provenance.notes}
    assert read_motion(path, person="9").n_frames == 20
    assert code_of(path, person="Ann") == "parts.no_person"


def test_clips_by_a_column(tmp_path):
    titles, *rows = table(SMPL).strip().split("\n")
    lines = ["id,label," + titles, *(f"{3 if n < 15 else 7},WALK,{row}" for n, row in enumerate(rows))]
    path = save(tmp_path / "x.csv", "\n".join(lines).encode())
    motion = read_motion(path)
    assert motion.n_frames == len(rows) - 15
    assert "parts.animation" in {note.code for note in motion.provenance.notes}
    assert read_motion(path, animation="3").n_frames == 15
    each = ["id," + titles, *(f"{n},{row}" for n, row in enumerate(rows))]
    assert read_motion(save(tmp_path / "y.csv", "\n".join(each).encode())).n_frames == len(rows)


def test_people_by_the_beginnings_of_names(tmp_path):
    text = table(SMPL)
    titles, *rows = text.strip().split("\n")
    own = titles.split(",")
    both = [own[0], *(f"{who}:{cell}" for who in ("Ann", "Ben") for cell in own[1:])]
    lines = [row.split(",") for row in rows]
    path = save(tmp_path / "x.csv", join([both, *([*cells, *cells[1:]] for cells in lines)]).encode())
    motion = read_motion(path)
    assert len(motion.names) == 22
    assert "parts.person" in {note.code for note in motion.provenance.notes}
    ben = read_motion(path, person="Ben")
    np.testing.assert_array_equal(ben.positions, motion.positions)


def test_angles_of_bvh_toolbox(tmp_path):
    tree = "joint,parent,offset.x,offset.y,offset.z\nHips,,0,90,0\nThigh,Hips,10,0,0\nThigh_End,Thigh,0,-40,0\n"
    turns = "time,Hips.z,Hips.x,Hips.y,Thigh.z,Thigh.x,Thigh.y\n0,0,0,0,0,0,0\n0.04,90,0,0,0,-90,0\n"
    places = "time,Hips.x,Hips.y,Hips.z\n0,1,90,3\n0.04,2,90,3\n"
    path = save(tmp_path / "w_rot.csv", turns.encode())
    assert code_of(path) == "tables.no_hierarchy"
    save(tmp_path / "w_hierarchy.csv", tree.encode())
    save(tmp_path / "w_pos.csv", places.encode())
    motion = read_motion(path, unit="cm", up="y")
    assert isinstance(motion, Motion)
    assert motion.frame_rate == pytest.approx(25)
    np.testing.assert_allclose(motion.translations[1, 0], [0.02, 0.9, 0.03])
    np.testing.assert_allclose(motion.rotations[1, 0], [0.5**0.5, 0, 0, 0.5**0.5], atol=1e-12)
    np.testing.assert_allclose(motion.rotations[1, 1], [0.5**0.5, -(0.5**0.5), 0, 0], atol=1e-12)
    assert not is_motion_file(path)


@pytest.mark.parametrize(
    ("titles", "names"),
    [
        (["LHip_x", "LHip_y", "LHip_z", "max", "may"], ["LHip"]),
        (["Head rotation x", "Head rotation y", "Head rotation z", "Head x", "Head y", "Head z"], ["Head"]),
        (["Hip x", "Hip y", "Hip z", "Hip_q_x", "Hip_q_y", "Hip_q_z", "Hip_q_w"], ["Hip"]),
        (["Hip_x", "Hip_y", "Hip_z", "Hip_w"], []),
        (["Ann:LASI:X", "Ann:LASI:Y", "Ann:LASI:Z"], ["Ann:LASI"]),
        (["hip-x [m]", "hip-z [m]", "hip-y [m]"], ["hip"]),
    ],
)
def test_columns(titles, names):
    assert list(find_columns(titles).points) == names
