"""3D points of people as JSON: the forms of several programs, gaps, people, folders and archives, what is no motion."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dousa.errors import DousaError, MotionFileError
from dousa.formats import find_motion_files, is_frame_folder
from dousa.formats.registry import find_reader, is_motion_file, read_motion
from dousa.motion import JOINT_INDEX, Motion, Trajectories, canonicalise
from formats import made_points as made
from formats.made_files import code_of


def save(path, content):
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


def save_frames(folder, texts):
    folder.mkdir(parents=True)
    for number, text in enumerate(texts):
        (folder / f"take1_{number:012d}_keypoints.json").write_text(text)
    return folder


def codes(motion):
    return {note.code for note in motion.provenance.notes}


def assert_places(motion, expected, *, about_hips=False, joints=("left_knee", "right_wrist", "left_shoulder")):
    """Canonical joints where they were put; distances do not depend on the heading that the axes gave."""
    found = canonicalise(motion)
    for first in joints:
        for second in joints:
            got = found.positions[:, JOINT_INDEX[first]] - found.positions[:, JOINT_INDEX[second]]
            wanted = expected[first] - expected[second]
            np.testing.assert_allclose(np.linalg.norm(got, axis=1), np.linalg.norm(wanted, axis=1), atol=2e-5)
    if not about_hips:
        got = found.positions[:, JOINT_INDEX["left_knee"], 1]
        np.testing.assert_allclose(got, expected["left_knee"][:, 1], atol=2e-5)


@pytest.mark.parametrize("title", [made.OPENPOSE, made.MEDIAPIPE, made.COCO, made.H36M, "SMPL", "HALPE (26)"])
def test_nested_lists_tell_their_layout_by_number_and_limbs(tmp_path, title):
    points, expected = made.make_points(title)
    motion = read_motion(save(tmp_path / "x.json", points.tolist()))
    assert (motion.n_frames, len(motion.names)) == points.shape[:2]
    assert codes(motion) >= {"arrays.layout", "arrays.assumed_rate"}
    assert_places(motion, expected)
    flat = read_motion(save(tmp_path / "flat.json", points.reshape(len(points), -1).tolist()))
    np.testing.assert_array_equal(flat.positions, motion.positions)


def test_openpose_folder_archive_and_file(tmp_path):
    points, expected = made.make_points(made.OPENPOSE)
    texts = made.openpose_frames(points, missing={(3, 4), (3, 0)})
    folder = save_frames(tmp_path / "walk" / "take1", texts)
    (tmp_path / "x.zip").write_bytes(made.zip_frames(texts))
    motion = read_motion(folder)
    assert motion.names[:3] == ("Nose", "Neck", "RShoulder")
    assert codes(motion) == {"arrays.assumed_rate"}
    assert np.isnan(motion.positions[3, [0, 4]]).all()
    assert np.isfinite(np.delete(motion.positions, 3, axis=0)).all()
    assert_places(motion, expected, joints=("left_knee", "left_wrist", "left_shoulder"))
    packed = read_motion(tmp_path / "x.zip", frame_rate=25.0)
    np.testing.assert_array_equal(packed.positions, motion.positions)
    assert (packed.frame_rate, packed.provenance.path) == (25.0, str(tmp_path / "x.zip"))
    one = read_motion(folder / "take1_000000000005_keypoints.json")
    assert one.positions.shape == (1, 25, 3)


def test_a_folder_of_frames_is_one_motion_among_others(tmp_path):
    texts = made.openpose_frames(made.make_points(made.OPENPOSE, 8)[0])
    texts[0] = '{"version": 1.3, "people": []}'
    folder = save_frames(tmp_path / "walk" / "take1", texts)
    save(tmp_path / "walk" / "b.json", made.make_points(made.H36M)[0].tolist())
    save(tmp_path / "walk" / "report.json", {"accuracy": 0.5})
    files, missing = find_motion_files([tmp_path])
    assert ([file.path for file in files], missing) == ([tmp_path / "walk" / "b.json", folder], [])
    assert [file.path for file in find_motion_files([folder])[0]] == [folder]
    assert is_frame_folder(folder)
    assert not is_frame_folder(tmp_path)
    assert find_reader(folder).name == "landmarks"
    motion = read_motion(folder)
    assert np.isnan(motion.positions[0]).all()


def test_mediapipe_is_upright_and_does_not_travel(tmp_path):
    points, expected = made.make_points(made.MEDIAPIPE)
    frames = made.mediapipe_list(points)
    for number, content in enumerate((
        frames,
        [{"pose_landmarks": [{"x": 0.5, "y": 0.5, "z": 0.1}] * 33, "pose_world_landmarks": frame} for frame in frames],
        {"fps": 25, "frames": [{"worldLandmarks": [frame]} for frame in frames]},
        [[list(point.values()) for point in frame] for frame in frames],
    )):  # fmt: skip
        path = save(tmp_path / f"{number}.json", content)
        assert is_motion_file(path) or number == 3
        motion = read_motion(path)
        assert motion.provenance.up == "-y"
        assert motion.provenance.unit == 1.0
        assert codes(motion) >= {"landmarks.hips_fixed"}
        assert ("arrays.assumed_rate" in codes(motion)) == (number != 2)
        assert "canonical.mirrored" not in {note.code for note in canonicalise(motion).warnings}
        assert_places(motion, expected, about_hips=True)
    lines = "\n".join(json.dumps(frame) for frame in frames)
    assert read_motion(save(tmp_path / "lines.json", lines)).n_frames == len(frames)


def test_names_of_the_file_count(tmp_path):
    points, expected = made.make_points(made.COCO)
    names = next(y.names for y in made.list_layouts() if y.title == made.COCO)
    order = np.random.default_rng(0).permutation(17)
    shuffled = [
        {"keypoints": [{"x": 1, "y": 2}], "keypoints3D": [
            {"name": names[i], "x": row[i][0], "y": row[i][1], "z": row[i][2], "score": 0.8} for i in order]}
        for row in points.tolist()
    ]  # fmt: skip
    by_name = [{names[i]: row[i] for i in order} for row in points.tolist()]
    paths = {names[i]: points[:, i].tolist() for i in order}
    listed = {"joint_names": [names[i] for i in order], "joints": points[:, order].tolist(), "fps": 50}
    for number, content in enumerate((shuffled, by_name, paths, listed)):
        motion = read_motion(save(tmp_path / f"{number}.json", content))
        assert motion.names == tuple(names[i] for i in order)
        assert_places(motion, expected)
    assert motion.frame_rate == 50


def test_mmpose_and_people(tmp_path):
    points, expected = made.make_points(made.H36M)
    content = made.mmpose(points)
    motion = read_motion(save(tmp_path / "x.json", content))
    assert motion.provenance.up == "z"
    assert_places(motion, expected)
    far = (points + 3).tolist()
    for number, info in enumerate(content["instance_info"]):
        own = {**info["instances"][0], "track_id": 7}
        other = {"keypoints": far[number], "keypoint_scores": [1.0] * 17, "track_id": 2}
        info["instances"] = [other, own] if number < 30 else [own]
    several = read_motion(save(tmp_path / "y.json", content))
    np.testing.assert_array_equal(several.positions, motion.positions)
    assert "parts.person" in codes(several)


def save_numbered(folder, contents, pattern="{:06d}.json", step=1):
    folder.mkdir(parents=True)
    for number, content in enumerate(contents):
        if content is not None:
            save(folder / pattern.format(step * number), content)
    return folder


def test_easymocap(tmp_path):
    """A folder of two people, one of whom comes later; a frame without a file is a gap."""
    points, expected = made.make_points(made.OPENPOSE)
    scored = np.concatenate((points, np.ones((*points.shape[:2], 1))), axis=2).tolist()
    frames = [[{"id": 3, "keypoints3d": frame}] for frame in scored]
    for frame in frames[20:]:
        frame.insert(0, {"id": 0, "keypoints3d": scored[0]})
    frames[10] = None
    folder = save_numbered(tmp_path / "a" / "keypoints3d", frames)
    assert [file.path for file in find_motion_files([tmp_path])[0]] == [folder]
    motion = read_motion(folder)
    assert motion.n_frames == 40
    assert np.isnan(motion.positions[10]).all()
    kept = np.arange(40) != 10
    assert_places(motion.replace(positions=motion.positions[kept]), {k: v[kept] for k, v in expected.items()})


def test_panoptic(tmp_path):
    """Centimetres, Y down, every second frame of the scene; -1 is the score of what was not seen."""
    points, expected = made.make_points("Panoptic (19)")
    scored = np.concatenate((100 * points * (1, -1, -1), np.ones((*points.shape[:2], 1))), axis=2)
    scored[4, 1, 3] = -1
    scenes = [
        {"version": 0.7, "univTime": 100 + 33.3667 * n, "bodies": [{"id": 5, "joints19": frame.ravel().tolist()}]}
        for n, frame in enumerate(scored)
    ]
    folder = save_numbered(tmp_path / "hdPose3d_stage1_coco19", scenes, "body3DScene_{:08d}.json", 2)
    motion = read_motion(folder)
    assert (motion.n_frames, motion.provenance.up, motion.provenance.unit) == (40, "-y", 0.01)
    assert np.isnan(motion.positions[4, 1]).all()
    assert_places(motion, expected)


def test_azure_kinect(tmp_path):
    points, expected = made.make_points("Azure Kinect")
    names = next(y.names for y in made.list_layouts() if y.title == "Azure Kinect")
    rows = (1000 * points * (1, -1, -1)).tolist()
    frames = [
        {"bodies": [{"body_id": 2, "joint_positions": frame}], "frame_id": n, "timestamp_usec": 40_000 * n}
        for n, frame in enumerate(rows)
    ]
    motion = read_motion(save(tmp_path / "x.json", {"frames": frames, "joint_names": names}))
    assert (motion.names, motion.frame_rate) == (names, 25.0)
    assert is_motion_file(tmp_path / "x.json")
    assert not is_frame_folder(tmp_path)
    assert_places(motion, expected)
    del frames[7:9]
    gap = read_motion(save(tmp_path / "y.json", {"frames": frames, "joint_names": names}))
    assert (gap.n_frames, gap.frame_rate) == (40, 25.0)
    assert np.isnan(gap.positions[7:9]).all()


def test_smpl_poses_of_easymocap(tmp_path):
    rng = np.random.default_rng(0)
    poses = np.concatenate((np.zeros((5, 3)), 0.1 * rng.normal(size=(5, 69))), axis=1)
    frames = [
        [{"id": 0, "Rh": [[0.1 * n, 0, 0]], "Th": [[n, 0, 1]], "poses": [row]}] for n, row in enumerate(poses.tolist())
    ]
    frames[2] = None
    folder = save_numbered(tmp_path / "smpl", frames)
    motion = read_motion(folder, up="y")
    assert isinstance(motion, Motion)
    assert (motion.n_frames, find_reader(folder).name) == (5, "landmarks")
    assert np.isnan(motion.translations[2, 0]).all()
    np.testing.assert_allclose(motion.rotations[3, 0], [np.cos(0.15), np.sin(0.15), 0, 0], atol=1e-9)
    one = read_motion(folder / "000003.json", up="y")
    np.testing.assert_allclose(one.rotations[0], motion.rotations[3])
    arrays = {"poses": poses.tolist(), "trans": np.zeros((5, 3)).tolist()}
    assert isinstance(read_motion(save(tmp_path / "x.json", arrays)), Motion)


def test_what_lies_in_a_picture_is_sent_to_its_command(tmp_path):
    rng = np.random.default_rng(0)
    flat = [*rng.uniform(0, 900, 50), *rng.uniform(0, 1, 25)]
    openpose = {"people": [{"pose_keypoints_2d": flat, "pose_keypoints_3d": []}]}
    coco = [{"image_id": f"{n}.png", "keypoints": rng.uniform(0, 900, (17, 2)).tolist()} for n in range(4)]
    scored = np.concatenate((rng.uniform(0, 900, (5, 17, 2)), rng.uniform(0, 1, (5, 17, 1))), axis=2)
    landmarks = [{"x": x, "y": y, "z": z} for x, y, z in rng.uniform(0.3, 0.7, (33, 3))]
    for number, (content, code) in enumerate((
        (openpose, "guard.flat"),
        (coco, "guard.flat"),
        (scored.tolist(), "guard.flat"),
        (scored.reshape(5, -1).tolist(), "guard.flat"),
        ([[{"x": 1, "y": 2}] * 17] * 3, "guard.flat"),
        ([[{"x": 1, "y": 2, "z": 0}] * 17] * 3, "guard.flat"),
        ([{"pose_landmarks": landmarks}] * 3, "landmarks.picture"),
        ([landmarks] * 3, "landmarks.picture"),
    )):  # fmt: skip
        assert code_of(save(tmp_path / f"{number}.json", content)) == code, number


def test_damage(tmp_path):
    points = made.make_points(made.H36M, 5)[0].tolist()
    for number, (content, code) in enumerate((
        ("{", "landmarks.broken"),
        ("[" * 100_000, "landmarks.broken"),
        ("{}", "landmarks.unknown"),
        ("[1, 2]", "landmarks.unknown"),
        ('"hello"', "landmarks.unknown"),
        ({"frames": []}, "landmarks.unknown"),
        ([[], None], "landmarks.nobody"),
        ([[[0, 0, 0]] * 17] * 3, "guard.flat"),
        ([[[None] * 3] * 17] * 3, "guard.flat"),
        ([[{"x": 1, "y": 1, "z": 1, "visibility": 0}] * 17] * 3, "landmarks.nobody"),
        ([*points, points[0][:16]], "guard.uneven"),
        ([*points, [*points[0][:-1], points[0][-1][:2]]], "landmarks.frame"),
        ([*points, [[*points[0][0], 1.0], *points[0][1:]]], "landmarks.frame"),
        ([*points, [[True, *points[0][0][1:]], *points[0][1:]]], "landmarks.frame"),
        ([*points, np.ravel(points[0]).tolist()[:-1]], "landmarks.frame"),
        ([{"pose_keypoints_3d": np.ravel(frame).tolist()[n:]} for n, frame in enumerate(points)], "landmarks.frame"),
        ([frame[:16] for frame in points], "arrays.joints"),
        ([[[1e400, 0, -1], *frame[1:]] for frame in points], "guard.no_place"),
        ([points * 100], "landmarks.frame"),
    )):  # fmt: skip
        assert code_of(save(tmp_path / f"{number}.json", content)) == code, number
    huge = json.dumps(points).replace(str(points[0][0][0]), "9" * 400, 1)
    assert code_of(save(tmp_path / "huge.json", huge)) == "formats.damaged"
    texts = made.openpose_frames(made.make_points(made.OPENPOSE, 4)[0])
    texts[2] = texts[2][:-5]
    assert code_of(save_frames(tmp_path / "cut", texts)) == "landmarks.in_frame"
    (tmp_path / "cut.zip").write_bytes(made.zip_frames(texts))
    assert code_of(tmp_path / "cut.zip") == "landmarks.in_frame"
    (tmp_path / "none").mkdir()
    with pytest.raises(DousaError):
        read_motion(tmp_path / "none")


numbers = st.none() | st.integers(-3, 3) | st.floats(allow_nan=True) | st.just(10**400) | st.text(max_size=2)
keys = st.sampled_from(
    ["x", "y", "z", "keypoints", "pose_keypoints_3d", "people", "instances", "instance_info", "frames", "image_id",
     "track_id", "visibility", "keypoint_scores", "pose_world_landmarks", "fps", "names", "nose", "meta_info",
     "poses", "Rh", "id"]
)  # fmt: skip
points_of_one = st.lists(st.lists(numbers, min_size=2, max_size=4), min_size=17, max_size=17)
contents = st.recursive(
    numbers | points_of_one, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(keys, inner, max_size=4)
)


@settings(max_examples=100, deadline=None)
@given(contents)
def test_any_json_is_read_or_refused(tmp_path_factory, content):
    path = tmp_path_factory.mktemp("any") / "x.json"
    try:
        assert isinstance(read_motion(save(path, content)), Motion | Trajectories)
    except MotionFileError as error:
        assert error.code != "formats.damaged" or str(error)
