"""Joints and SMPL poses as arrays: real files of others, layouts told apart, pickles that are programs."""

import os
import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from dousa.errors import MotionFileError, OptionError
from dousa.formats.registry import read_motion, write_motion
from dousa.formats.smpl import mean_body
from dousa.motion import Motion, canonicalise, compute_trajectories
from formats import made_files as made
from formats.made_files import refused, save


def codes(motion):
    return {note.code for note in motion.provenance.notes}


def smpl_joints(poses, trans):
    """(T, J, 3) joints of SMPL poses, by matrices: the equations of Loper et al. taken literally."""
    body = mean_body(poses.shape[1] // 3)
    result = np.empty((len(poses), len(body.names), 3))
    for frame, pose in enumerate(poses):
        matrices = Rotation.from_rotvec(pose.reshape(-1, 3)).as_matrix()
        world = {}
        for joint, parent in enumerate(body.parents):
            before, at = world[parent] if parent >= 0 else (np.eye(3), trans[frame])
            world[joint] = before @ matrices[joint], at + before @ body.offsets[joint]
            result[frame, joint] = world[joint][1]
    return result


@pytest.mark.parametrize("count", [22, 24, 52, 55])
def test_smpl_poses_are_the_model_s(tmp_path, count):
    arrays = made.make_smpl(n_joints=count)
    path = save(tmp_path / "x.npz", made.make_npz(**arrays, mocap_framerate=np.array(120.0)))
    motion = read_motion(path, up="y")
    assert motion.frame_rate == 120.0
    expected = smpl_joints(arrays["poses"], arrays["trans"])
    np.testing.assert_allclose(compute_trajectories(motion).positions, expected, atol=1e-9)
    turned = compute_trajectories(read_motion(path, up="z")).positions
    np.testing.assert_allclose(turned[..., 1], expected[..., 2], atol=1e-9)


def test_amass_as_published(shared_data):
    motion = read_motion(shared_data("foreign/unsupported/amass_sample.npz"))
    assert (motion.n_frames, motion.frame_rate, motion.skeleton.n_joints) == (601, 120.0, 52)
    assert (motion.provenance.up, codes(motion)) == ("z", {"smpl.mean_body"})
    found = canonicalise(motion)
    assert found.mapping.sides == "agree"
    assert not found.mapping.derived
    assert 1.4 < found.height < 1.7
    # A woman or man who walks on the floor: the feet come near it, and never below.
    assert -0.03 < found.positions[..., 1].min() < 0.05
    with np.load(shared_data("foreign/unsupported/amass_sample.npz")) as file:
        expected = smpl_joints(file["poses"][::100], file["trans"][::100])
        markers = file["marker_data"][::100].mean(axis=1)
    positions = compute_trajectories(motion).positions[::100]
    np.testing.assert_allclose(positions[..., 1], expected[..., 2], atol=1e-9)
    # The recording's own markers, which no body model has touched, lie around the same place.
    centre = positions[:, :22].mean(axis=1)
    np.testing.assert_allclose(centre[:, 1], markers[:, 2], atol=0.15)


def test_aist_as_published(shared_data):
    motion = read_motion(shared_data("foreign/unsupported/aistpp_smpl.pkl"))
    assert isinstance(motion, Motion)
    assert (motion.n_frames, motion.frame_rate, motion.provenance.up) == (720, 60.0, "y")
    found = canonicalise(motion)
    assert found.mapping.sides == "agree"
    steps = np.linalg.norm(np.diff(found.positions, axis=0), axis=2)
    assert steps.max() < 0.25  # m in 1/60 s: a dancer's hand, no leap


def test_humanml3d_as_published(shared_data):
    path = shared_data("foreign/unsupported/humanml3d_new_joints.npy")
    motion = read_motion(path)
    assert (motion.n_frames, motion.frame_rate) == (170, 20.0)
    assert codes(motion) == {"arrays.layout", "arrays.assumed_rate"}
    np.testing.assert_array_equal(motion.positions[:, 1:], np.load(path)[:, 1:])
    found = canonicalise(motion)
    assert 1.3 < found.height < 1.8
    assert found.mapping.sides == "agree"
    assert read_motion(path, frame_rate=25).frame_rate == 25.0


def test_a_layout_is_told_by_its_limbs(tmp_path, shared_data):
    whole = canonicalise(read_motion(shared_data("foreign/unsupported/humanml3d_new_joints.npy")))
    named = dict(zip(whole.to_trajectories().names, np.moveaxis(whole.positions, 1, 0), strict=True))
    body, sides = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle"), ("left", "right")
    coco = [named["head"]] * 5 + [named[f"{side}_{joint}"] for joint in body for side in sides]
    h36m = [named["pelvis"], *(named[f"{side}_{joint}"] for side in sides[::-1] for joint in body[3:])]
    h36m += [named["spine"], named["neck"], named["head"], named["head"]]
    h36m += [named[f"{side}_{joint}"] for side in sides for joint in body[:3]]
    for points, layout in ((coco, "COCO (17)"), (h36m, "Human3.6M (17)")):
        path = save(tmp_path / "x.npy", made.make_npy(np.stack(points, axis=1)))
        motion = read_motion(path)
        assert next(n for n in motion.provenance.notes if n.code == "arrays.layout").values["layout"] == layout
        assert canonicalise(motion).mapping.sides == "agree"


def test_axes_of_length_one_and_frames_last(tmp_path):
    points = smpl_joints(**made.make_smpl(5, 22))
    for shaped in (points, points[None], points[:, None], np.moveaxis(points, 0, 2)):
        motion = read_motion(save(tmp_path / "x.npy", made.make_npy(shaped)), unit="m", up="y")
        np.testing.assert_array_equal(motion.positions, points)


def test_a_mesh_beside_the_poses_is_not_read(tmp_path):
    mesh = np.full((3, 6890, 3), 1234.5)
    content = made.make_npz(**made.make_smpl(n_joints=22), vertices=mesh)
    damaged = content.replace(mesh.tobytes(), (mesh + 1).tobytes())
    assert damaged != content and read_motion(save(tmp_path / "x.npz", damaged)).skeleton.n_joints == 22


def test_a_body_model(tmp_path):
    """Three vertices, joints that are means of them, one shape that moves a vertex up."""
    regressor = np.zeros((24, 3))
    regressor[:, 0], regressor[4, :2] = 1, (0.5, 0.5)
    template, shapes = np.array([[0, 0, 0], [2.0, 0, 0], [0, 0, 9]]), np.zeros((3, 3, 2))
    shapes[1, 1, 0] = 1.0
    model = save(tmp_path / "m.npz", made.make_npz(v_template=template, shapedirs=shapes, J_regressor=regressor))
    arrays = made.make_smpl() | {"betas": np.array([3.0, 0, 0])}
    path = save(tmp_path / "x.npz", made.make_npz(**arrays))
    motion = read_motion(path, skeleton=model, up="y")
    np.testing.assert_allclose(motion.skeleton.offsets[4], (1.0, 1.5, 0.0))
    assert "smpl.mean_body" not in codes(motion)
    assert "smpl.mean_body" in codes(read_motion(path))
    for broken, code in ((arrays, "smpl.model_lacks"), ({"v_template": template[:2]}, "smpl.model_shape")):
        parts = {"v_template": template, "shapedirs": shapes, "J_regressor": regressor} | broken
        kept = parts if code == "smpl.model_shape" else broken
        with pytest.raises(MotionFileError) as caught:
            read_motion(path, skeleton=save(tmp_path / "bad.npz", made.make_npz(**kept)))
        assert caught.value.code == code


@settings(deadline=None, max_examples=15)
@given(seed=st.integers(0, 2**31), rate=st.floats(1, 500))
def test_amass_there_and_back(tmp_path_factory, seed, rate):
    path = save(tmp_path_factory.mktemp("amass") / "x.npz", made.make_npz(**made.make_smpl(n_joints=52, seed=seed)))
    motion = read_motion(path, frame_rate=rate)
    write_motion(motion, path.with_name("y.amass.npz"))
    again = read_motion(path.with_name("y.amass.npz"))
    assert again.frame_rate == rate
    there, back = (compute_trajectories(m).positions for m in (motion, again))
    np.testing.assert_allclose(back, there, atol=1e-6)


class Danger:
    def __reduce__(self):
        return os.system, ("touch danger",)


def test_a_pickle_is_not_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "x.pkl"
    refused(path, pickle.dumps({"poses": Danger()}), "pickles.refused")
    refused(path, pickle.dumps({"poses": np.array([Danger()], object)}), "pickles.refused")
    assert not (tmp_path / "danger").exists()
    refused(path, pickle.dumps([1, 2]), "pickles.no_dictionary")
    refused(path, pickle.dumps({"a": 1}), "pickles.no_motion")
    refused(path, b"\x80\x04" + b"\x8e" + (2**40).to_bytes(8, "little") + b"x.", "pickles.damaged")
    refused(path, b"\x80\x05" + b"\x96" + (2**34).to_bytes(8, "little") + b"x.", "pickles.damaged")
    refused(path, b"\x80\x04N" + b"r\xff\xff\xff\xff" + b"0.", "pickles.damaged")


@pytest.mark.parametrize("protocol", range(6))
def test_pickles_of_every_age(tmp_path, protocol):
    arrays = made.make_smpl() | {"smpl_scaling": np.array([2.0]), "fps": np.float64(25)}
    motion = read_motion(save(tmp_path / "x.pkl", pickle.dumps(arrays, protocol)))
    assert motion.frame_rate == 25.0
    by_list = {"smpl_poses": arrays["poses"].tolist(), "smpl_trans": arrays["trans"].tolist(), "fps": 25}
    other = read_motion(save(tmp_path / "y.pkl", pickle.dumps(by_list, protocol)), up="y")
    np.testing.assert_array_equal(other.rotations, motion.rotations)


def test_what_is_no_motion_is_said_in_one_sentence(tmp_path):
    path = tmp_path / "x.npy"
    refused(path, b"no array", "arrays.no_npy")
    refused(path, made.make_npy(np.zeros((4, 264))), "arrays.shape")
    refused(path, made.make_npy(np.zeros((0, 2, 22, 3))), "arrays.shape")  # samples of which there are none
    refused(path, made.make_npy(np.random.default_rng(0).normal(size=(9, 263))), "arrays.features")
    refused(path, made.make_npy(np.zeros((4, 7, 3))), "arrays.joints")
    refused(path, made.make_npy(np.zeros((4, 22, 3)))[:-1], "arrays.size")
    refused(path, made.make_npy(np.array(["a"])), "arrays.not_plain")
    huge = made.make_npy(np.zeros((4, 22, 3))).replace(b"(4, 22, 3)", b"(9999999999999, 22, 3)")
    refused(path, huge, "arrays.size")
    path = tmp_path / "x.npz"
    refused(path, made.make_npz(keypoints=np.zeros((4, 17, 2))), "guard.flat")
    refused(path, made.make_npz(poses=np.zeros((4, 70))), "smpl.width")
    refused(path, made.make_npz(poses=np.full((4, 72), np.nan)), "smpl.not_finite")
    refused(path, made.make_npz(poses=np.zeros((4, 72)), trans=np.zeros((3, 3))), "smpl.places")
    unscaled = {"smpl_poses": np.zeros((4, 72)), "smpl_trans": np.zeros((4, 3)), "smpl_scaling": np.zeros(1)}
    refused(path, made.make_npz(**unscaled), "smpl.scaling")
    with pytest.raises(OptionError, match="rate"):
        read_motion(save(path, made.make_npz(**made.make_smpl())), frame_rate=-1)


def test_an_array_alone_is_read_from_any_container(tmp_path):
    """Places with and without scores, and lists; and the same rotations as vectors, matrices, and vectors in a row."""
    arrays = made.make_smpl(n_joints=24)
    joints = smpl_joints(arrays["poses"], arrays["trans"])
    scored = np.concatenate((joints, np.ones((*joints.shape[:2], 1))), axis=2)
    path = tmp_path / "x.pkl"
    for content in (joints, scored, joints.tolist(), [*joints]):
        found = read_motion(save(path, pickle.dumps(content)), up="y", unit=1.0)
        np.testing.assert_allclose(found.positions, joints, atol=1e-12)
    blank = joints.copy()
    blank[len(blank) // 2] = 0.0  # a frame in which nobody was seen makes no rotations of the rest
    found = read_motion(save(tmp_path / "x.npy", made.make_npy(blank)), up="y", unit=1.0)
    assert np.isnan(found.positions).all(axis=(1, 2)).sum() == 1
    turns = arrays["poses"].reshape(-1, 24, 3)
    matrices = Rotation.from_rotvec(turns.reshape(-1, 3)).as_matrix().reshape(-1, 24, 3, 3)
    named = read_motion(save(tmp_path / "y.pkl", pickle.dumps({"poses": turns})), up="y")
    for content in (turns, arrays["poses"], matrices):
        for found in (
            read_motion(save(path, pickle.dumps(content)), up="y"),
            read_motion(save(tmp_path / "x.npy", made.make_npy(content)), up="y"),
        ):
            np.testing.assert_allclose(found.rotations, named.rotations, atol=1e-9)
            assert "arrays.poses" in codes(found)
    flat = read_motion(save(path, pickle.dumps(joints.reshape(len(joints), -1))), up="y", unit=1.0)
    np.testing.assert_allclose(flat.positions, joints, atol=1e-12)


def test_an_array_for_each_frame(tmp_path):
    arrays = made.make_smpl(n_joints=24)
    joints = smpl_joints(arrays["poses"], arrays["trans"])
    frames = {f"frame_{number}": places for number, places in enumerate(joints)}
    shuffled = dict(sorted(frames.items(), key=lambda item: item[0][::-1]))
    for name, content in (("x.npz", made.make_npz(**shuffled)), ("x.pkl", pickle.dumps(shuffled))):
        found = read_motion(save(tmp_path / name, content), up="y", unit=1.0)
        np.testing.assert_allclose(found.positions, joints, atol=1e-12)
        assert "arrays.frames" in codes(found)
    refused(tmp_path / "x.pkl", pickle.dumps([[1, 2], [3]]), "pickles.no_dictionary")
    hands = {"left_hand": joints[0], "right_hand": joints[1]}
    refused(tmp_path / "x.pkl", pickle.dumps(hands), "pickles.no_motion")
    refused(tmp_path / "x.npy", made.make_npy(joints[:0]), "markers.damaged")
    refused(tmp_path / "x.npy", made.make_npy(np.float64(1)), "arrays.shape")
