"""Keypoints of other programs are read: forms, units, who is who, and damage."""

import json

import numpy as np
import pytest

from dousa.errors import KeypointError
from dousa.estimation import MEDIAPIPE_NAMES, read_keypoints
from dousa.estimation.keypoints.keypoint_files import holds_keypoints
from dousa.estimation.keypoints.keypoint_json import BODY_25, COCO_17, HALPE_26, SCHEMES

SIZE = (640, 480)


def make_points(n_points, x=100.0, y=50.0):
    """x, y, confidence of a person."""
    rng = np.random.default_rng(n_points)
    return np.concatenate([rng.uniform(x, x + 80, (n_points, 1)), rng.uniform(y, y + 80, (n_points, 1)),
                           rng.uniform(0.3, 1, (n_points, 1))], axis=1)  # fmt: skip


def write(path, content):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content), encoding="utf-8")
    return path


def say_openpose(people):
    return {
        "version": 1.3,
        "people": [{"person_id": [-1], "pose_keypoints_2d": points.reshape(-1).tolist()} for points in people],
    }


@pytest.mark.parametrize("n_points", [17, 18, 25, 26, 33])
def test_a_folder_of_openpose_files(tmp_path, n_points):
    for frame in range(5):
        people = [make_points(n_points, 100 + 2 * frame), make_points(n_points, 400 - 2 * frame)]
        order = people[::-1] if frame % 2 else people  # who is first changes
        write(tmp_path / "view" / f"cam_{frame:012d}_keypoints.json", say_openpose(order))
    view = read_keypoints(tmp_path / "view", size=SIZE, frame_rate=50)
    assert view.names == SCHEMES[n_points] and view.n_people == 2 and view.frame_rate == pytest.approx(50)
    for person in view.people:
        assert np.abs(np.diff(person.points, axis=0)).max() == pytest.approx(2)
    left = min(view.people, key=lambda person: person.points[0, 0, 0])
    np.testing.assert_allclose(left.points[4], make_points(n_points, 108)[:, :2])
    np.testing.assert_allclose(left.visibility[4], make_points(n_points)[:, 2])


def test_points_that_are_zero_were_not_seen_and_missing_frames_have_nobody(tmp_path):
    points = make_points(25)
    points[3] = 0
    for frame in (0, 1, 3):
        write(tmp_path / "view" / f"{frame}.json", say_openpose([points]))
    view = read_keypoints(tmp_path / "view", size=SIZE, frame_rate=30)
    (person,) = view.people
    assert person.present.tolist() == [True, True, False, True]
    assert np.isnan(person.points[0, 3]).all() and person.visibility[0, 3] == 0


def test_alphapose_says_who_is_who(tmp_path):
    rows = []
    for frame in range(12):
        for who in (0, 1):
            points = make_points(26, 300 * (who ^ (frame > 9)))  # they jump, but are who they are
            if (frame, who) != (5, 1):
                rows.append({"image_id": f"{frame}.jpg", "keypoints": points.reshape(-1).tolist(), "idx": who})
    view = read_keypoints(write(tmp_path / "alphapose-results.json", rows), size=SIZE, frame_rate=30)
    assert view.names == HALPE_26 and view.n_frames == 12
    assert [int(person.present.sum()) for person in view.people] == [12, 11]
    assert view.people[0].points[11, 0, 0] == pytest.approx(make_points(26, 300)[0, 0])


def test_annotations_of_coco_have_flags_and_sizes(tmp_path):
    points = make_points(17)
    points[:, 2] = 2
    points[4, 2], points[5] = 1, 0
    content = {
        "images": [{"id": 1, "width": 640, "height": 480}],
        "annotations": [{"image_id": 1, "id": 7, "keypoints": points.reshape(-1).tolist()}],
    }
    view = read_keypoints(write(tmp_path / "coco.json", content))
    assert view.names == COCO_17 and view.size == SIZE
    assert view.people[0].visibility[0, 3:6].tolist() == [1, 0.5, 0]
    assert [warning.code for warning in view.warnings] == ["mask_npz.rate"]


def test_mmpose(tmp_path):
    points = make_points(133)
    person = {"keypoints": points[:, :2].tolist(), "keypoint_scores": points[:, 2].tolist()}
    content = {"instance_info": [{"frame_id": n + 1, "instances": [person] if n else []} for n in range(3)]}
    view = read_keypoints(write(tmp_path / "mmpose.json", content), size=SIZE, frame_rate=30)
    assert len(view.names) == 23 and view.people[0].present.tolist() == [False, True, True]
    np.testing.assert_allclose(view.people[0].points[1], points[:23, :2])
    np.testing.assert_allclose(view.people[0].visibility[2], points[:23, 2])


@pytest.mark.parametrize("form", ["list", "key", "several"])
def test_landmarks_of_mediapipe_are_shares_of_the_picture(tmp_path, form):
    shares = np.random.default_rng(0).uniform(0.1, 0.9, (33, 2))
    landmarks = [{"x": x, "y": y, "z": -0.1, "visibility": 0.8} for x, y in shares]
    frame = {"list": landmarks, "key": {"pose_landmarks": landmarks}, "several": {"pose_landmarks": [landmarks]}}[form]
    path = write(tmp_path / "mediapipe.json", {"frames": [frame, [] if form == "list" else {"pose_landmarks": []}]})
    view = read_keypoints(path, size=SIZE, frame_rate=30)
    assert view.names == MEDIAPIPE_NAMES and view.people[0].present.tolist() == [True, False]
    np.testing.assert_allclose(view.people[0].points[0], shares * SIZE - 0.5)
    assert set(view.people[0].visibility[0]) == {0.8}
    with pytest.raises(KeypointError, match="size of the pictures"):
        read_keypoints(path)


def test_left_is_the_persons_left_in_every_scheme():
    for names in SCHEMES.values():
        assert len(set(names)) == len(names)
        for name in names:
            if name.startswith("left_"):
                assert name.replace("left_", "right_") in names
    assert (BODY_25[2], BODY_25[5], BODY_25[8], BODY_25[19], BODY_25[24]) == (
        "right_shoulder", "left_shoulder", "mid_hip", "left_big_toe", "right_heel",
    )  # fmt: skip
    assert (HALPE_26[5], HALPE_26[17], HALPE_26[19], HALPE_26[25]) == (
        "left_shoulder", "head_top", "mid_hip", "right_heel",
    )  # fmt: skip


@pytest.mark.parametrize(
    ("content", "code"),
    [
        ({"people": [{"pose_keypoints_2d": [1.0] * 30}]}, "keypoint_json.points"),
        ({"people": [{"pose_keypoints_2d": ["a"] * 75}]}, "keypoint_json.unknown"),
        ({"people": [{"pose_keypoints_2d": None}]}, "keypoint_json.unknown"),
        ({"people": [{}]}, "keypoint_json.unknown"),
        ({"persons": 5}, "keypoint_json.unknown"),
        ({"hello": []}, "keypoint_json.unknown"),
        ([], "keypoint_json.unknown"),
        ("text", "keypoint_json.unknown"),
        ([{"people": [{"keypoints": [5.0] * 51}]}, {"people": [{"keypoints": [5.0] * 75}]}], "keypoint_json.mixed"),
        ([{"image_id": 0, "keypoints": [5.0] * 51}, {"image_id": 10**12, "keypoints": [5.0] * 51}], None),
    ],
)
def test_what_is_not_understood_is_one_clear_error(tmp_path, content, code):
    path = write(tmp_path / "view.json", content)
    if code is None:  # numbers that are no frame numbers
        assert read_keypoints(path, size=SIZE).n_frames == 2
        return
    with pytest.raises(KeypointError, match=r"view\.json") as caught:
        read_keypoints(path, size=SIZE)
    assert caught.value.code == code


def test_places_far_outside_any_picture_are_none(tmp_path):
    points = make_points(17)
    points[3, 0], points[4, 1] = 1e300, -1e9
    view = read_keypoints(write(tmp_path / "view.json", [{"keypoints": points.reshape(-1).tolist()}] * 2), size=SIZE)
    assert np.isnan(view.people[0].points[1, 3:5]).all() and view.people[0].present.all()


@pytest.mark.parametrize(
    "data",
    [
        b"", b"{", b"[" * 100_000, b"\xff\xfe", b"NaN", b"[[%s, 2]]" % (b"9" * 400),
        b'{"people": [{"keypoints": [NaN, 1]}]}',
    ],
)  # fmt: skip
def test_damaged_json_is_one_clear_error(tmp_path, data):
    (tmp_path / "view.json").write_bytes(data)
    with pytest.raises(KeypointError, match=r"view\.json"):
        read_keypoints(tmp_path / "view.json", size=SIZE)


def test_an_empty_folder_and_a_broken_frame_are_named(tmp_path):
    (tmp_path / "view").mkdir()
    with pytest.raises(KeypointError, match="found none"):
        read_keypoints(tmp_path / "view", size=SIZE)
    write(tmp_path / "view" / "000.json", say_openpose([make_points(25)]))
    (tmp_path / "view" / "001.json").write_text("{", encoding="utf-8")
    with pytest.raises(KeypointError, match=r"001\.json"):
        read_keypoints(tmp_path / "view", size=SIZE)


def test_nobody_in_any_frame(tmp_path):
    view = read_keypoints(write(tmp_path / "view.json", [{"people": []}] * 3), size=SIZE, frame_rate=30)
    assert view.people == () and view.n_frames == 3


DLC = """scorer,net,net,net,net,net,net,net,net,net
individuals,one,one,one,one,one,one,two,two,two
bodyparts,LShoulder,LShoulder,LShoulder,knee_r,knee_r,knee_r,LShoulder,LShoulder,LShoulder
coords,x,y,likelihood,x,y,likelihood,x,y,likelihood
img000.png,10,20,0.9,30,40,0.5,,,
img002.png,11,21,0.8,,,,50.5,60,1
"""


def test_the_table_of_deeplabcut(tmp_path):
    path = tmp_path / "view.csv"
    path.write_text(DLC)
    view = read_keypoints(path, size=SIZE, frame_rate=25)
    assert view.names == ("left_shoulder", "right_knee") and view.n_people == 2
    first = view.people[0]
    np.testing.assert_allclose(first.points[0], [(10, 20), (30, 40)])
    np.testing.assert_allclose(first.visibility, [(0.9, 0.5), (0.8, 0)])
    assert view.people[1].present.tolist() == [False, True]
    single = tmp_path / "single.csv"
    single.write_text("scorer,net,net\nbodyparts,nose,nose\ncoords,x,y\n0,1,2\n1,3,4\n")
    view = read_keypoints(single, size=SIZE, frame_rate=25)
    assert view.names == ("nose",) and view.people[0].points[1].tolist() == [[3, 4]]


SLEAP = """track,frame_idx,instance.score,nose.x,nose.y,nose.score,l_knee.x,l_knee.y,l_knee.score,r_knee.x,r_knee.y,r_knee.score
a,4,0.9,10,20,0.9,30,40,0.5,,,
b,4,0.9,11,21,0.9,31,41,0.5,51,61,.5
a,6,0.9,12,22,0.9,32,42,0.5,52,62,.5
"""  # noqa: E501
PIXELS = """PathFileType\t4\t(X/Y/Z)\tv_px.trc
DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames
30\t30\t2\t3\tpx\t30\t1\t2
Frame#\tTime\tNose\t\t\tLKnee\t\t\tRKnee\t\t
\t\tX1\tY1\tZ1\tX2\tY2\tZ2\tX3\tY3\tZ3

1\t0\t10\t20\t0\t30\t40\t0.0\t\t\t
2\t0.1\t12\t22\t0\t32\t42\t0\t52\t62\t0
"""


@pytest.mark.parametrize(("name", "text", "frames", "people"), [("v.csv", SLEAP, 2, 2), ("v_px.trc", PIXELS, 2, 1)])
def test_tables_with_titles(tmp_path, name, text, frames, people):
    path = tmp_path / name
    path.write_text(text)
    assert holds_keypoints(path)
    view = read_keypoints(path, size=SIZE, frame_rate=25)
    assert (view.names, view.n_frames, view.n_people) == (("nose", "left_knee", "right_knee"), frames, people)
    first = view.people[0].points
    assert first[[0, -1], :2].tolist() == [[[10, 20], [30, 40]], [[12, 22], [32, 42]]]
    assert np.isnan(first[0, 2]).all() and first[-1, 2].tolist() == [52, 62]
    path.write_text(text.replace("nose.score", "nose.z").replace("\t20\t0\t", "\t20\t5\t"))
    assert not holds_keypoints(path)


def test_rows_without_a_number_follow_each_other(tmp_path):
    path = tmp_path / "v.csv"
    rows = [[10 - frame + place for place in range(6)] for frame in range(3)]
    text = "\n".join(",".join(map(str, row)) for row in rows)
    path.write_text(f"nose.x,nose.y,l_knee.x,l_knee.y,r_knee.x,r_knee.y\n{text}")
    assert read_keypoints(path, size=SIZE, frame_rate=25).people[0].points.reshape(3, 6).tolist() == rows
    path.write_text(path.read_text().replace("nose.x", "track,nose.x").replace("\n", "\na,"))
    assert not holds_keypoints(path)  # nothing says which rows are of one frame
    path.write_text("frame,nose.x,nose.y,l_knee.x,l_knee.y,r_knee.x,r_knee.y,track\n0,1,2,3,4,5,6\n")
    with pytest.raises(KeypointError, match="values in each row"):
        read_keypoints(path, size=SIZE)


@pytest.mark.parametrize(
    ("old", "new", "code", "line"),
    [
        ("coords", "units", "keypoint_table.unknown", None),
        ("x,y,likelihood,x", "x,likelihood,likelihood,x", "keypoint_table.unknown", None),
        ("knee_r,knee_r,knee_r,", "knee_r,,knee_r,", "keypoint_table.column", None),
        ("10,20", "ten,20", "keypoint_table.number", 5),
        ("11,21,0.8,", "", "keypoint_table.row", 6),
        ("11,21,0.8,", "11,21,0.8,0.7,", "keypoint_table.row", 6),
        (DLC[DLC.index("img000") :], "", "keypoint_table.empty", None),
    ],
)
def test_a_damaged_table_is_one_clear_error(tmp_path, old, new, code, line):
    path = tmp_path / "view.csv"
    path.write_text(DLC.replace(old, new))
    with pytest.raises(KeypointError, match=r"view\.csv") as caught:
        read_keypoints(path, size=SIZE)
    assert caught.value.code == code and caught.value.line == line


def test_names_in_the_file_go_before_the_number_of_points(tmp_path):
    """Sets of 17 points in another order, such as that of Human3.6M."""
    names = ["root", "right_hip", "right_knee", "right_foot", "left_hip", "left_knee", "left_foot", "spine", "thorax"]
    names += ["neck_base", "head", "left_shoulder", "left_elbow", "left_wrist", "right_shoulder", "right_elbow"]
    points = make_points(17)
    person = {"keypoints": points[:, :2].tolist(), "keypoint_scores": points[:, 2].tolist()}
    about = {"keypoint_id2name": {str(number): name for number, name in enumerate([*names, "right_wrist"])}}
    content = {"meta_info": about, "instance_info": [{"frame_id": 1, "instances": [person]}]}
    view = read_keypoints(write(tmp_path / "view.json", content), size=SIZE, frame_rate=30)
    np.testing.assert_allclose(view.people[0].points[0, view.find(["right_knee"])[0]], points[2, :2])
