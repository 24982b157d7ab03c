"""Motive CSV, Qualisys TSV, Xsens MVNX: values by hand, files of the systems, damage."""

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dousa.errors import MotionFileError
from dousa.formats.assembly import localise, order_tree
from dousa.formats.registry import read_motion, write_motion
from dousa.motion import Motion, Skeleton, Trajectories, canonicalise, compute_trajectories, forward_kinematics
from dousa.motion.rotations import normalise
from dousa.motion.synthetic import draw_performer, make_motion
from formats import made_files as made
from formats.made_files import refused, save


def test_motive_markers(tmp_path):
    motion = read_motion(save(tmp_path / "x.csv", made.make_motive()))
    assert (motion.names, motion.frame_rate, motion.provenance.unit) == (("Bob:WaistL", "Bob:Head"), 120.0, 0.001)
    np.testing.assert_allclose(motion.positions[0], [[0.001, 1, 0.003], [0.004, 1.7, 0.006]])
    assert np.isnan(motion.positions[1, 1]).all()


def test_motive_bones_there_and_back(tmp_path):
    motion = make_motion("walk", draw_performer(1))
    write_motion(motion, tmp_path / "x.csv")
    again = read_motion(tmp_path / "x.csv")
    assert isinstance(again, Motion)
    assert (again.provenance.unit, again.frame_rate) == (1.0, motion.frame_rate)
    # Its joints come in the same order, end sites as joints.
    assert again.skeleton.names == motion.skeleton.names
    there, back = (compute_trajectories(m).positions for m in (motion, again))
    np.testing.assert_allclose(back, there, atol=1e-9)
    np.testing.assert_allclose(np.abs((again.rotations * motion.rotations).sum(axis=2)), 1, atol=1e-9)


@settings(deadline=None, max_examples=20)
@given(seed=st.integers(0, 2**31), joints=st.integers(1, 9))
def test_any_tree_survives_the_world(seed, joints):
    rng = np.random.default_rng(seed)
    parents = [-1, *(int(rng.integers(j)) for j in range(1, joints))]
    rotations, translations = normalise(rng.normal(size=(3, joints, 4))), rng.normal(size=(3, joints, 3))
    positions, world = forward_kinematics(parents, rotations, translations)
    back = localise(parents, world, positions)
    np.testing.assert_allclose(back[1], translations, atol=1e-9)
    np.testing.assert_allclose(np.abs((back[0] * rotations).sum(axis=2)), 1, atol=1e-9)
    names = [f"j{joint}" for joint in range(joints)]
    shuffled = [names[joint] for joint in rng.permutation(joints)]
    above = {names[joint]: names[parent] for joint, parent in enumerate(parents) if parent >= 0}
    order, tree = order_tree(tuple(shuffled), above)
    assert sorted(order) == list(range(joints))
    for place, parent in enumerate(tree):
        assert parent < place
        assert above.get(shuffled[order[place]]) == (shuffled[order[parent]] if parent >= 0 else None)


def test_motive_skeleton_by_its_names(tmp_path):
    """Bones of version 1.23, which has no parents: a chain of a leg and of the trunk."""
    names = ["Hip", "Ab", "Chest", "LThigh", "LShin"]
    skeleton = Skeleton(
        tuple(names), [-1, 0, 1, 0, 3], [[0, 1, 0], [0, 0.1, 0], [0, 0.2, 0], [0.1, 0, 0], [0, -0.4, 0]]
    )
    rotations = normalise(np.random.default_rng(0).normal(size=(4, 5, 4)))
    motion = Motion(skeleton, rotations, np.tile(skeleton.offsets, (4, 1, 1)), 100.0)
    write_motion(motion, tmp_path / "x.csv")
    lines = (tmp_path / "x.csv").read_text().splitlines()
    text = "\n".join(line for line in lines if not line.startswith(",Parent")).replace("1.24", "1.23")
    for name in names:
        text = text.replace(f",{name}", f",Ann:{name}")
    again = read_motion(save(tmp_path / "y.csv", text.encode()), up="y")
    np.testing.assert_array_equal(again.skeleton.parents, skeleton.parents)
    np.testing.assert_allclose(again.translations, motion.translations, atol=1e-9)


def test_motive_damage(tmp_path):
    path, good = tmp_path / "x.csv", made.make_motive()
    refused(path, b"a,b,c\n1,2,3\n", "tables.no_points")
    refused(path, good.partition(b",Name")[0], "motive.no_names")
    refused(path, good.partition(b"0,0.0")[0], "tables.no_frames")
    refused(path, good.replace(b",1700", b",high"), "tables.number")
    refused(path, good.replace(b",1700", b",1e999"), "guard.no_place")
    refused(path, made.make_motive("Force Plate"), "motive.nothing")
    with pytest.raises(MotionFileError, match="no place"):
        write_motion(Trajectories(("a,b",), np.zeros((1, 1, 3)), 1.0), path)


def test_qualisys_markers(tmp_path):
    motion = read_motion(save(tmp_path / "x.tsv", made.make_qualisys()))
    assert (motion.names, motion.frame_rate, motion.provenance.up) == (("LASI", "RASI"), 100.0, "z")
    # Z up becomes Y up: x, y, z are x, z, -y.
    np.testing.assert_allclose(motion.positions[0], [[0.001, 0.9, -0.002], [-0.001, 0.901, -0.002]])
    assert np.isnan(motion.positions[1, 1]).all()


def test_qualisys_skeleton(tmp_path):
    motion = read_motion(save(tmp_path / "x.tsv", made.make_qualisys_skeleton()))
    assert isinstance(motion, Motion)
    np.testing.assert_array_equal(motion.skeleton.parents, [-1, 0, 1, 2])
    np.testing.assert_allclose(compute_trajectories(motion).positions[0, :, 1], [1, 0.7, 0.4, 0.1], atol=1e-12)


def test_qualisys_damage(tmp_path):
    path, good = tmp_path / "x.tsv", made.make_qualisys()
    refused(path, b"a\tb\n", "tables.no_points")
    refused(path, good.replace(b"FREQUENCY\t100", b"FREQUENCY\t0"), "guard.rate")
    refused(path, good.partition(b"1\t2\t900")[0], "tables.no_frames")
    refused(path, good.replace(b"\tRASI", b"\tRASI\tSACR"), "tables.width")
    refused(path, good.replace(b"MARKER_NAMES", b"BODY_NAMES"), "qualisys.bodies")
    refused(path, good.replace(b"MARKER_NAMES\tLASI\tRASI\n", b""), "qualisys.no_names")


def test_mvnx_by_hand(tmp_path):
    motion = read_motion(save(tmp_path / "x.mvnx", made.make_mvnx(turn=0.5)))
    assert (motion.frame_rate, motion.provenance.up, motion.n_frames) == (60.0, "z", 3)
    np.testing.assert_array_equal(motion.skeleton.parents, [-1, 0, 0, 2])
    np.testing.assert_allclose(compute_trajectories(motion).positions[0, :, 1], made.PLACES[:, 2], atol=1e-8)
    # The whole body turns: nothing turns against its parent.
    np.testing.assert_allclose(motion.rotations[:, 1:, 0], 1, atol=1e-12)


def test_mvnx_beside_the_bvh_of_the_same_system(shared_data):
    """Xsens MVN exported the recording twice; its BVH is in cm and begins with a T-pose."""
    motion = read_motion(shared_data("foreign/xsens_mvnx/test_mocap.mvnx"))
    assert (motion.n_frames, motion.frame_rate, motion.skeleton.n_joints) == (112, 60.0, 23 + 5)
    other = read_motion(shared_data("foreign/xsens_mvnx/test_mocap.bvh"), unit="cm")
    ours, theirs = (canonicalise(m) for m in (motion, other))
    arms = [
        ours.to_trajectories().names.index(f"{side}_{joint}")
        for side in ("left", "right")
        for joint in ("elbow", "wrist")
    ]
    length = min(len(ours.positions), len(theirs.positions) - 1)
    a, b = ours.positions[:length], theirs.positions[-length:]
    # Independent of where and how the body stands: distances between joints of the arms.
    first = np.linalg.norm(a[:, arms, None] - a[:, None, arms], axis=-1)
    second = np.linalg.norm(b[:, arms, None] - b[:, None, arms], axis=-1)
    assert np.abs(first - second).max() < 0.02
    assert ours.mapping.sides == "agree"


def test_mvnx_damage(tmp_path):
    path, good = tmp_path / "x.mvnx", made.make_mvnx()
    refused(path, good[:-40], "markup.broken_xml")
    refused(path, b"<mvnx></mvnx>", "mvnx.no_subject")
    refused(path, good.replace(b'label="L5" id', b'label="Pelvis" id'), "mvnx.segments")
    refused(path, good.replace(b'frameRate="60"', b'frameRate="-1"'), "guard.rate")
    refused(path, good.replace(b'"normal"', b'"tpose"'), "mvnx.no_frames")
    refused(path, good.replace(b'type="normal"><orientation>', b'type="normal"><orientation>x '), "mvnx.number")
    refused(path, good.replace(b'type="normal"><orientation>', b'type="normal"><orientation/><other>').replace(
        b"</orientation><position>", b"</other><position>").replace(b'type="identity"><orientation>',
        b'type="identity"><other>'
    ), "mvnx.count")  # fmt: skip
    entity = b'<?xml version="1.0"?><!DOCTYPE a [<!ENTITY b "b">]><mvnx/>'
    refused(path, entity, "markup.doctype")


@pytest.mark.parametrize(
    ("left_out", "code", "near"),
    [
        ("joints", None, 1e-6),
        ("joints|segments", None, 1e-6),
        ("orientation", "mvnx.no_orientation", 1e-6),
        ("position", "mvnx.mean_body", 0.15),
        ("position|joints", "mvnx.mean_body", 0.15),
    ],
)
def test_mvnx_with_parts_of_its_data(tmp_path, shared_data, left_out, code, near):
    """What is exported is a choice in MVN; the tree and the order of the 23 segments are known."""
    text = shared_data("reported/mvnx_without_joints/with_joints.mvnx").read_text()
    expected = canonicalise(read_motion(save(tmp_path / "x.mvnx", text.encode()))).positions
    part = re.sub(rf"<({left_out})>.*?</\1>", "", text, flags=re.DOTALL)
    motion = read_motion(save(tmp_path / "y.mvnx", part.encode()))
    found = canonicalise(motion).positions
    np.testing.assert_allclose(found - found[:, :1], expected - expected[:, :1], atol=near)
    assert [note.code for note in motion.provenance.notes if note.code.startswith("mvnx")] == [code] * bool(code)
    if isinstance(motion, Motion):
        assert (motion.skeleton.parents < 0).sum() == 1
    nothing = re.sub(r"<(orientation|position)>.*?</\1>", "", text, flags=re.DOTALL).encode()
    refused(tmp_path / "z.mvnx", nothing, "mvnx.no_pose")


def test_mvnx_of_orientations_has_the_lengths_of_its_points(tmp_path, shared_data):
    text = shared_data("foreign/xsens_mvnx/test_mocap.mvnx").read_text(errors="replace")
    expected = canonicalise(read_motion(save(tmp_path / "x.mvnx", text.encode()))).positions
    part = re.sub(r"<position>.*?</position>", "", text, flags=re.DOTALL)
    motion = read_motion(save(tmp_path / "y.mvnx", part.encode()))
    found = canonicalise(motion).positions
    np.testing.assert_allclose(found - found[:, :1], expected - expected[:, :1], atol=3e-3)
    assert "mvnx.no_position" in [note.code for note in motion.provenance.notes]
