"""SMPL bodies as programs that watch films save them, and rows of features of text and motion."""

import pickle

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dousa.files.pickles import load_pickle
from dousa.formats.arrays import content
from dousa.formats.parts import are_all, list_untaken
from dousa.formats.registry import is_motion_file, read_motion
from dousa.motion import Motion, canonicalise, compute_trajectories
from formats import made_files as made
from formats import made_points as points
from formats.made_files import code_of, save

N_FRAMES = 6
TURNS = Rotation.from_rotvec(0.3 * np.random.default_rng(0).normal(size=(N_FRAMES * 24, 3)))
VECTORS = TURNS.as_rotvec().reshape(N_FRAMES, 72)
MATRICES = TURNS.as_matrix().reshape(N_FRAMES, 24, 3, 3)
PLACES = np.random.default_rng(1).normal(size=(N_FRAMES, 3))
OTHER = np.zeros((N_FRAMES - 2, 72))


def phalp():
    frames = {}
    for n in range(N_FRAMES):
        body = {"global_orient": MATRICES[n, :1], "body_pose": MATRICES[n, 1:], "betas": np.zeros(10)}
        frames[f"out/{n:06}.jpg"] = {"time": n, "tracked_ids": [4, 1] if n else [4], "smpl": [body] * (2 if n else 1)}
    return frames


FILMS = {
    "VIBE": {1: {"pose": VECTORS, "frame_ids": np.arange(N_FRAMES)}, 2: {"pose": OTHER}},
    "WHAM": {0: {"pose": 0 * VECTORS, "trans": 0 * PLACES, "pose_world": VECTORS, "trans_world": PLACES}},
    "TRAM": {"pred_rotmat": MATRICES, "pred_trans": PLACES[:, None], "pred_shape": np.zeros((N_FRAMES, 10))},
    "4DHumans": phalp(),
    "GVHMR": {
        "smpl_params_incam": {"global_orient": PLACES, "body_pose": VECTORS[:, 3:66], "transl": 0 * PLACES},
        "smpl_params_global": {"global_orient": VECTORS[:, :3], "body_pose": VECTORS[:, 3:66], "transl": PLACES},
        "K_fullimg": np.eye(3),
    },
    "PromptHMR": {
        "camera": {"pred_cam_R": np.zeros((N_FRAMES, 3, 3))},
        "people": {
            3: {"smplx_cam": {"pose": np.zeros((N_FRAMES, 165))}, "track_id": 3,
                "smplx_world": {"pose": np.pad(VECTORS[:, :66], ((0, 0), (0, 99))), "trans": PLACES}},
        },
    },
    "HybrIK": {"pred_thetas": [*MATRICES.reshape(N_FRAMES, 24, 9)], "pred_cam_root": [*PLACES], "img_path": ["a.jpg"]},
    "SLAHMR": {
        "root_orient": np.stack((VECTORS[:, :3], 0 * PLACES)), "pose_body": np.stack((VECTORS[:, 3:66],) * 2),
        "trans": np.stack((PLACES, 0 * PLACES)), "betas": np.zeros((2, 10)), "intrins": np.ones(4),
    },
    "ROMP": {
        f"{n:08}.jpg": {
            "global_orient": VECTORS[[n, 0], :3], "body_pose": VECTORS[[n, 0], 3:], "cam_trans": PLACES[[n, 0]],
            "cam": np.zeros((2, 3)), "joints": np.zeros((2, 71, 3)),
        }
        for n in range(N_FRAMES)
    },
    "rows of axes": {"poses": MATRICES[..., :2, :].reshape(N_FRAMES, 144), "trans": PLACES},
    "columns in turns": {"poses": MATRICES[..., :, :2].reshape(N_FRAMES, 144), "trans": PLACES},
    "flat matrices": {"poses": MATRICES.reshape(N_FRAMES, 216), "trans": PLACES},
}  # fmt: skip


@pytest.mark.parametrize("pack", ["joblib", "packed", "pickle", "torch", "npy", "npz"])
@pytest.mark.parametrize("film", FILMS)
def test_films(tmp_path, film, pack):
    content = FILMS[film]
    path = tmp_path / f"x.{ {'npy': 'npy', 'npz': 'npz', 'torch': 'pt'}.get(pack, 'pkl') }"
    data = {
        "joblib": lambda: made.make_joblib(content),
        "packed": lambda: made.make_joblib(content, compress=3),
        "pickle": lambda: pickle.dumps(content),
        "torch": lambda: made.make_torch(content),
        "npy": lambda: made.make_npy(np.array(content, object)),
        "npz": lambda: made.make_npz(results=np.array(content, object), faces=np.array(["a"], object)),
    }[pack]()
    motion = read_motion(save(path, data), up="y")
    assert isinstance(motion, Motion)
    assert (motion.n_frames, motion.frame_rate) == (N_FRAMES, 30.0)
    expected = TURNS.as_quat(scalar_first=True).reshape(N_FRAMES, 24, 4)[:, :22]
    off = 1 - np.abs((motion.rotations[:, :22] * expected).sum(axis=2))
    assert off.max() < 1e-6
    if film not in ("VIBE", "4DHumans"):
        moved = motion.translations[:, 0] - motion.skeleton.offsets[0]
        np.testing.assert_allclose(moved, PLACES, atol=1e-6)
    assert pack == "packed" or is_motion_file(path)


def test_easymocap_turns_the_pelvis_about_the_origin(tmp_path):
    poses = np.concatenate((np.zeros((N_FRAMES, 3)), VECTORS[:, 3:]), axis=1)
    content = {"Rh": VECTORS[:, :3], "Th": PLACES, "poses": poses}
    motion = read_motion(save(tmp_path / "x.pkl", pickle.dumps(content)), up="y")
    pelvis = np.array(motion.skeleton.offsets[0])
    expected = Rotation.from_rotvec(VECTORS[:, :3]).apply(pelvis) + PLACES
    np.testing.assert_allclose(compute_trajectories(motion).positions[:, 0], expected, atol=1e-9)


def test_people(tmp_path):
    path = save(tmp_path / "x.pkl", made.make_joblib(FILMS["VIBE"]))
    assert "parts.person" in {note.code for note in read_motion(path, up="y").provenance.notes}
    assert read_motion(path, up="y", person="id 2").n_frames == len(OTHER)
    assert code_of(path, person="Ann") == "parts.no_person"


@pytest.mark.parametrize(("film", "said"), [("VIBE", True), ("WHAM", False), ("GVHMR", False), ("PromptHMR", False)])
def test_bodies_before_a_camera_say_so(tmp_path, film, said):
    motion = read_motion(save(tmp_path / "x.pkl", made.make_joblib(FILMS[film])), up="y")
    assert ("smpl.camera" in {note.code for note in motion.provenance.notes}) == said


def test_joints_by_person(tmp_path):
    joints, _ = points.make_points("HumanML3D")
    path = save(tmp_path / "x.pkl", pickle.dumps({"person_1": joints[:20], "person_2": joints}))
    np.testing.assert_allclose(read_motion(path, unit="m", up="y").positions, joints)
    np.testing.assert_allclose(read_motion(path, unit="m", up="y", person="id 1").positions, joints[:20])


def test_frames_without_the_person(tmp_path):
    content = {1: {"pose": VECTORS, "trans": PLACES, "frame_ids": np.array([0, 1, 2, 5, 6, 7])}}
    motion = read_motion(save(tmp_path / "x.pkl", pickle.dumps(content)), up="y")
    assert motion.n_frames == 8
    assert np.isnan(motion.translations[3:5, 0]).all()
    assert "guard.gaps" in {note.code for note in motion.provenance.notes}


def test_motion_x(tmp_path):
    rows = np.zeros((N_FRAMES, 322))
    rows[:, :66], rows[:, 309:312] = VECTORS[:, :66], PLACES
    motion = read_motion(save(tmp_path / "x.npy", made.make_npy(rows)), up="y")
    assert motion.skeleton.n_joints == 52
    np.testing.assert_allclose(motion.translations[:, 0] - motion.skeleton.offsets[0], PLACES, atol=1e-9)
    expected = TURNS.as_quat(scalar_first=True).reshape(N_FRAMES, 24, 4)[:, :22]
    np.testing.assert_allclose(np.abs((motion.rotations[:, :22] * expected).sum(axis=2)), 1, atol=1e-9)


def make_rows(joints, turn):
    """Features of HumanML3D by its definition: joints (T, 22, 3), ``turn`` half of the heading's in each frame."""
    heading = np.concatenate(([0.0], np.cumsum(turn[:-1])))
    facing = Rotation.from_rotvec(np.stack((0 * heading, 2 * heading, 0 * heading), axis=1))
    root = joints[:, 0]
    steps = facing[1:].apply(np.diff(root, axis=0))
    seen = joints[:, 1:] - root[:, None] * (1, 0, 1)
    rows = np.zeros((len(joints), 263))
    rows[:, 0], rows[:-1, 1], rows[:-1, 2], rows[:, 3] = turn, steps[:, 0], steps[:, 2], root[:, 1]
    rows[:, 4:67] = np.stack([turned.apply(frame) for turned, frame in zip(facing, seen, strict=True)]).reshape(-1, 63)
    return rows


def test_features_of_humanml3d(tmp_path):
    joints, _ = points.make_points("HumanML3D")
    joints = joints - joints[0, 0] * (1, 0, 1)
    turn = 0.05 * np.random.default_rng(0).normal(size=len(joints))
    path = save(tmp_path / "x.npy", made.make_npy(make_rows(joints, turn).astype(np.float32)))
    motion = read_motion(path, unit="m", up="y")
    assert (motion.frame_rate, is_motion_file(path)) == (20.0, True)
    np.testing.assert_allclose(motion.positions, joints, atol=1e-5)
    assert not canonicalise(motion).absent
    rows = make_rows(joints, turn)
    normalised = (rows - rows.mean(axis=0)) / (rows.std(axis=0) + 1e-3)
    assert code_of(save(tmp_path / "y.npy", made.make_npy(normalised))) == "arrays.features"


def test_samples_of_mdm(tmp_path):
    joints, _ = points.make_points("HumanML3D")
    motion = np.moveaxis(np.stack((joints, joints[::-1])), 1, 3)
    content = {"motion": motion, "text": ["a walk", "back"], "lengths": np.array([30, 40]), "num_samples": 2}
    path = save(tmp_path / "results.npy", made.make_npy(np.array(content, object)))
    read = read_motion(path, unit="m", up="y", animation=1)
    assert (read.n_frames, read.frame_rate, is_motion_file(path)) == (30, 20.0, True)
    np.testing.assert_allclose(read.positions, joints[:30])
    longest = read_motion(path, unit="m", up="y")
    np.testing.assert_allclose(longest.positions, joints[::-1])
    np.testing.assert_allclose(read_motion(f"{path}#animation=back", unit="m", up="y").positions, joints[::-1])
    alone = read_motion(save(tmp_path / "motion.npy", made.make_npy(motion)), unit="m", up="y", animation=2)
    np.testing.assert_allclose(alone.positions, joints[::-1])
    assert [str(note.values["text"]) for note in read.provenance.notes if note.code == "arrays.text"] == ["a walk"]


def test_takes_by_person_and_action(tmp_path):
    """As the data sets of VideoPose3D have them."""
    joints = np.random.default_rng(0).normal(size=(9, 32, 3))
    takes = {"S1": {"Walking": joints, "Eating 1": joints[:5]}, "S5": {"Walking": joints[::-1]}}
    path = save(tmp_path / "data_3d_h36m.npz", made.make_npz(positions_3d=np.array(takes, object)))
    read = read_motion(path, unit="m", up="y", animation="S5 Walking")
    np.testing.assert_allclose(read.positions, joints[::-1])
    assert read.frame_rate == 50.0
    assert len(list_untaken(path, read_motion(path).provenance.notes)) == 3
    flat = {"S1": {"Walking": [joints[:, :17, :2], joints[:5, :17, :2]]}}
    assert code_of(save(path, made.make_npz(positions_2d=np.array(flat, object)))) == "guard.flat"
    assert code_of(save(path, made.make_npz(x=np.array([print], object)))) == "pickles.refused"


def test_many_samples_are_loaded_once(tmp_path, monkeypatch):
    """Each names its neighbours, which is enough to see whether all are there."""
    joints, _ = points.make_points("HumanML3D")
    motion = np.moveaxis(np.repeat(joints[None], 30, axis=0), 1, 3)
    path, loads = save(tmp_path / "results.pkl", pickle.dumps({"motion": motion})), []
    monkeypatch.setattr(content, "load_pickle", lambda file: [loads.append(file), load_pickle(file)][1])
    addresses = list_untaken(path, read_motion(path).provenance.notes)
    notes = {one: read_motion(one).provenance.notes for one in addresses}
    assert (len(notes), len(loads), are_all(notes)) == (30, 2, True)
    assert not are_all({one: notes[one] for one in addresses[:-1]})
    save(path, pickle.dumps({"motion": motion[:, :, :, :20]}))
    assert read_motion(addresses[3]).n_frames == 20


def test_scores_and_points_of_more_than_the_body(tmp_path):
    joints, _ = points.make_points("HumanML3D")
    scored = np.concatenate((joints, np.ones((*joints.shape[:2], 1))), axis=2)
    scored[3, 5, 3] = 0
    motion = read_motion(save(tmp_path / "x.npy", made.make_npy(scored)), unit="m", up="y")
    assert np.isnan(motion.positions[3, 5]).all()
    np.testing.assert_allclose(np.delete(motion.positions, 3, axis=0), np.delete(joints, 3, axis=0))
    turns = TURNS.as_quat().reshape(N_FRAMES, 24, 4)
    assert code_of(save(tmp_path / "y.npy", made.make_npy(turns))) == "arrays.shape"
    holistic = np.concatenate((points.make_points(points.MEDIAPIPE)[0], np.ones((40, 520, 3))), axis=1)
    body = read_motion(save(tmp_path / "z.npy", made.make_npy(holistic)))
    assert body.positions.shape == (40, 33, 3)


def test_a_pickle_keeps_what_is_nested(tmp_path):
    loop = []
    loop.append(loop)
    content = {1: {"a": [np.ones(2), {"b": (np.float32(3), "c")}]}, "loop": loop}
    loaded = load_pickle(save(tmp_path / "x.pkl", pickle.dumps(content)))
    np.testing.assert_array_equal(loaded[1]["a"][0], np.ones(2))
    assert loaded[1]["a"][1] == {"b": [3.0, "c"]}
