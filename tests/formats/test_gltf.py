"""glTF and GLB: what we write is read by others, what others write is read, damaged files are refused."""

import base64
import json
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dousa.errors import MotionFileError, MotionWriteError
from dousa.formats.gltf import read_gltf_character
from dousa.formats.gltf.curves import Curve, choose_times
from dousa.formats.gltf.document import FLOAT, load_document, pack_document
from dousa.formats.registry import read_motion, write_motion
from dousa.motion import Motion, Skeleton, canonicalise, compute_trajectories
from dousa.motion.rotations import from_axis_angle, normalise, to_matrix
from dousa.motion.synthetic import draw_performer, make_motion

TURN = np.array([0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)])  # x y z w: a quarter about Z


def make_walk():
    return make_motion("walk", draw_performer(3))


def make_random(seed=0, joints=6, frames=5):
    rng = np.random.default_rng(seed)
    parents = [-1, *(int(rng.integers(j)) for j in range(1, joints))]
    skeleton = Skeleton([f"j{j}" for j in range(joints)], parents, rng.normal(size=(joints, 3)))
    rotations = normalise(rng.normal(size=(frames, joints, 4)))
    return Motion(skeleton, rotations, rng.normal(size=(frames, joints, 3)), 25.0)


class Made:
    """A file by hand: nodes, and curves of numbers."""

    def __init__(self, nodes, curves, **more):
        self.binary, views, accessors = b"", [], []

        def add(values, kind):
            values = np.asarray(values, "<f4")
            views.append({"buffer": 0, "byteOffset": len(self.binary), "byteLength": values.nbytes})
            accessors.append({"bufferView": len(views) - 1, "componentType": FLOAT, "count": len(values), "type": kind})
            self.binary += values.tobytes()
            return len(accessors) - 1

        samplers, channels = [], []
        for node, path, times, values, how in curves:
            samplers.append({"input": add(times, "SCALAR"), "interpolation": how})
            samplers[-1]["output"] = add(values, f"VEC{np.shape(values)[1]}")
            channels.append({"sampler": len(samplers) - 1, "target": {"node": node, "path": path}})
        self.tree = {"asset": {"version": "2.0"}, "nodes": nodes, "accessors": accessors, "bufferViews": views, **more}
        if "skins" in more:
            for skin in more["skins"]:
                if "matrices" in skin:
                    skin["inverseBindMatrices"] = add(skin.pop("matrices"), "MAT4")
        if curves:
            self.tree["animations"] = [{"samplers": samplers, "channels": channels}]
        self.tree["buffers"] = [{"byteLength": len(self.binary)}]

    def save(self, path):
        path.write_bytes(pack_document(self.tree, self.binary))
        return path


def slow_world(made, node_poses):
    """Matrices of the nodes in the scene, multiplied one by one; poses by node: (translation, wxyz, scale)."""
    nodes, world = made.tree["nodes"], {}

    def visit(index, above):
        move, turn, scale = node_poses[index]
        local = np.eye(4)
        local[:3, :3] = to_matrix(turn) * np.asarray(scale)
        local[:3, 3] = move
        world[index] = above @ local
        for child in nodes[index].get("children", []):
            visit(child, world[index])

    children = {child for node in nodes for child in node.get("children", [])}
    for index in range(len(nodes)):
        if index not in children:
            visit(index, np.eye(4))
    return world


@settings(deadline=None, max_examples=20)
@given(seed=st.integers(0, 2**31), joints=st.integers(1, 8))
def test_any_motion_there_and_back(tmp_path_factory, seed, joints):
    path = tmp_path_factory.mktemp("glb") / "x.glb"
    motion = make_random(seed, joints)
    write_motion(motion, path)
    again = read_motion(path, unit="m", up="y")
    assert again.frame_rate == 25.0
    there, back = compute_trajectories(motion), compute_trajectories(again)
    order = [again.skeleton.names.index(name) for name in motion.skeleton.names]
    np.testing.assert_allclose(back.positions[:, order], there.positions, atol=2e-5)
    np.testing.assert_allclose(np.abs((again.rotations[:, order] * motion.rotations).sum(axis=2)), 1, atol=1e-6)


def test_nodes_with_axes_and_scales_of_their_own(tmp_path):
    """Above the joints a node that turns and shrinks, rest orientations in the joints, a skin: against matrices."""
    rng = np.random.default_rng(5)
    turns = normalise(rng.normal(size=(4, 4)))
    moves = rng.normal(size=(4, 3)) * 50
    scales = [[0.01] * 3, [1] * 3, [2.0] * 3, [1] * 3]
    nodes = [
        {"name": n, "translation": moves[i].tolist(), "rotation": turns[i][[1, 2, 3, 0]].tolist(), "scale": scales[i]}
        for i, n in enumerate("abcd")
    ]
    nodes[0]["children"], nodes[1]["children"], nodes[2]["children"] = [1], [2], [3]
    times = np.arange(4) / 30
    keys = normalise(rng.normal(size=(4, 4)))
    places = rng.normal(size=(4, 3))
    curves = [(2, "rotation", times, keys[:, [1, 2, 3, 0]], "LINEAR"), (1, "translation", times, places, "LINEAR")]
    made = Made(nodes, curves, skins=[{"joints": [1, 2, 3]}])
    motion = read_motion(made.save(tmp_path / "x.glb"), unit="m", up="y")
    assert motion.skeleton.names == ("b", "c", "d")
    positions = compute_trajectories(motion).positions
    rest = slow_world(made, dict(enumerate(zip(moves, turns, scales, strict=True))))
    for frame in range(4):
        poses = dict(enumerate(zip(moves, turns, scales, strict=True)))
        poses[1] = places[frame], turns[1], scales[1]
        poses[2] = moves[2], keys[frame], scales[2]
        world = slow_world(made, poses)
        expected = [world[node][:3, 3] for node in (1, 2, 3)]
        np.testing.assert_allclose(positions[frame], expected, atol=1e-4)
    # At rest the joints are turned as little as the scene: its offsets are those between the nodes.
    gaps = [rest[2][:3, 3] - rest[1][:3, 3], rest[3][:3, 3] - rest[2][:3, 3]]
    np.testing.assert_allclose(motion.skeleton.offsets[1:], gaps, atol=1e-4)


def test_the_skin_knows_the_rest_pose(tmp_path):
    """The nodes stand in some pose; the matrices of the skin say that the joint's bone points up."""
    nodes = [{"name": "a", "children": [1]}, {"name": "b", "translation": [1, 0, 0]}]
    nodes[0]["rotation"] = TURN.tolist()
    inverse = np.tile(np.eye(4), (2, 1, 1))
    inverse[1, 3, :3] = (-1, 0, 0)
    curve = (0, "rotation", [0, 1], [TURN, TURN], "LINEAR")
    made = Made(nodes, [curve], skins=[{"joints": [0, 1], "matrices": inverse.reshape(2, 16)}])
    motion = read_motion(made.save(tmp_path / "x.glb"), unit="m", up="y")
    np.testing.assert_allclose(motion.skeleton.offsets[1], (1, 0, 0), atol=1e-6)
    np.testing.assert_allclose(motion.rotations[0, 0], TURN[[3, 0, 1, 2]], atol=1e-6)
    np.testing.assert_allclose(compute_trajectories(motion).positions[0, 1], (0, 1, 0), atol=1e-6)


def test_interpolation():
    times = np.array([0.0, 1.0])
    quaternions = np.array([[0, 0, 0, 1.0], TURN])
    middle = Curve(times, quaternions, "LINEAR", True).sample(np.array([0.5]))[0]
    np.testing.assert_allclose(middle, [0, 0, np.sin(np.pi / 8), np.cos(np.pi / 8)])
    # The short way, whatever the sign.
    np.testing.assert_allclose(
        np.abs(Curve(times, quaternions * [[1], [-1]], "LINEAR", True).sample(np.array([0.5]))[0] @ middle), 1
    )
    values = np.array([[0, 0, 0], [1.0, 2, 3]])
    assert Curve(times, values, "STEP", False).sample(np.array([0.9]))[0].tolist() == [0, 0, 0]
    np.testing.assert_allclose(
        Curve(times, values, "LINEAR", False).sample(np.array([-1, 0.25, 2])), [[0, 0, 0], [0.25, 0.5, 0.75], [1, 2, 3]]
    )
    # A cubic with the tangents of t^2 is t^2.
    spline = np.array([[0.0] * 3, [0.0] * 3, [0.0] * 3, [2.0] * 3, [1.0] * 3, [0.0] * 3])
    np.testing.assert_allclose(Curve(times, spline, "CUBICSPLINE", False).sample(np.array([0.3]))[0], 0.09)


@pytest.mark.parametrize("rate", [24.0, 29.97, 60.0, 120.0, 33.3])
def test_the_rate_is_that_of_the_keys(rate):
    times = (np.arange(2000) / rate).astype("<f4").astype(float)
    found, got = choose_times([times, times[[0, -1]]])
    assert got == pytest.approx(rate, rel=1e-6 if rate in (24, 60, 120) else 2e-3)
    assert len(found) == 2000


def test_a_character_keeps_its_mesh(tmp_path, shared_data):
    """An animation goes into somebody's file: all but the animation stays."""
    source = shared_data("foreign/unsupported/mixamo.glb")
    character = read_gltf_character(source)
    skeleton = character.skeleton
    turns = np.tile(character.rotations, (3, 1, 1))
    bent = skeleton.names.index("Model_LeftForeArm")
    turns[:, bent] = from_axis_angle([[0, 0, 0.0], [0, 0.5, 0], [0, 1.0, 0]])
    places = np.tile(character.translations, (3, 1, 1))
    places[:, 0] += [[0, 0, 0], [0, 0.1, 0], [0, 0.2, 0.3]]
    moved = Motion(skeleton, turns, places, 30.0, character.provenance)
    write_motion(moved, tmp_path / "x.glb")
    old, new = load_document(source), load_document(tmp_path / "x.glb")
    for key in ("meshes", "materials", "skins", "nodes"):
        assert new.tree[key] == old.tree[key]
    for index in range(len(old.items("accessors"))):
        np.testing.assert_array_equal(new.numbers(index), old.numbers(index))
    again = read_motion(tmp_path / "x.glb")
    np.testing.assert_allclose(compute_trajectories(again).positions, compute_trajectories(moved).positions, atol=1e-4)
    assert 1.6 < canonicalise(character).height < 2.0


def test_humanoid_names(tmp_path):
    nodes = [{"name": "J_1", "children": [1]}, {"name": "J_2", "translation": [0, 1, 0]}]
    bones = {"hips": {"node": 0}, "leftUpperLeg": {"node": 1}}
    more = {"extensions": {"VRMC_vrm_animation": {"humanoid": {"humanBones": bones}}}}
    curve = (1, "rotation", [0, 1], [TURN, TURN], "LINEAR")
    made = Made(nodes, [curve, (0, "translation", [0, 1], [[0, 1, 0], [0, 1, 1]], "LINEAR")], **more)
    assert read_motion(made.save(tmp_path / "x.vrma"), unit="m").skeleton.names == ("hips", "leftUpperLeg")


def test_gltf_with_its_buffer_inside_and_beside(tmp_path):
    made = Made([{"name": "a"}], [(0, "rotation", [0, 1], [TURN, TURN], "LINEAR")])
    inside = {
        **made.tree,
        "buffers": [{"byteLength": len(made.binary), "uri": "data:;base64," + base64.b64encode(made.binary).decode()}],
    }
    (tmp_path / "x.gltf").write_text(json.dumps(inside))
    (tmp_path / "y z.bin").write_bytes(made.binary)
    (tmp_path / "y.gltf").write_text(
        json.dumps({**made.tree, "buffers": [{"byteLength": len(made.binary), "uri": "y%20z.bin"}]})
    )
    one, other = read_motion(tmp_path / "x.gltf", unit="m"), read_motion(tmp_path / "y.gltf", unit="m")
    np.testing.assert_array_equal(one.rotations, other.rotations)
    for uri in ("../x.bin", "/etc/passwd", "http://example.org/x.bin", "data:;base64,!"):
        (tmp_path / "z.gltf").write_text(
            json.dumps({**made.tree, "buffers": [{"byteLength": len(made.binary), "uri": uri}]})
        )
        with pytest.raises(MotionFileError) as caught:
            read_motion(tmp_path / "z.gltf")
        assert caught.value.code == "gltf.buffer"


def test_missing_poses_hold(tmp_path):
    motion = make_random()
    rotations = np.array(motion.rotations)
    rotations[[0, 3], 2] = np.nan
    write_motion(motion.replace(rotations=rotations), tmp_path / "x.glb")
    again = read_motion(tmp_path / "x.glb", unit="m", up="y")
    joint = again.skeleton.names.index("j2")
    for frame, like in ((0, 1), (3, 2)):
        assert abs(again.rotations[frame, joint] @ rotations[like, 2]) == pytest.approx(1, abs=1e-6)
    rotations[:, 2] = np.nan
    with pytest.raises(MotionWriteError, match="j2"):
        write_motion(motion.replace(rotations=rotations), tmp_path / "x.glb")


def change(tree, **changes):
    return {**tree, **changes}


@pytest.mark.parametrize(
    ("edit", "code"),
    [
        (lambda t: change(t, asset={"version": "1.0"}), "gltf.version"),
        (lambda t: change(t, asset=None), "gltf.no_asset"),
        (lambda t: change(t, nodes=[{"children": [1]}, {"children": [0]}]), "gltf.tree"),
        (lambda t: change(t, nodes=[{"children": [7]}]), "gltf.index"),
        (lambda t: change(t, nodes=[{"rotation": [0, 0, 0, 0]}]), "gltf.pose"),
        (lambda t: change(t, nodes=5), "gltf.list"),
        (lambda t: change(t, animations=[]), "gltf.no_joints"),
        (lambda t: change(t, accessors=[{**a, "count": 10**11} for a in t["accessors"]]), "gltf.short"),
        (lambda t: change(t, accessors=[{**a, "sparse": {}} for a in t["accessors"]]), "gltf.accessor"),
        (lambda t: change(t, accessors=[{**a, "componentType": 1} for a in t["accessors"]]), "gltf.accessor"),
        (
            lambda t: change(t, accessors=[{**a, "count": 1} for a in t["accessors"][:1]] + t["accessors"][1:]),
            "gltf.keys",
        ),
    ],
)
def test_damage(tmp_path, edit, code):
    made = Made([{"name": "a"}], [(0, "rotation", [0, 1], [TURN, TURN], "LINEAR")])
    made.tree = edit(made.tree)
    with pytest.raises(MotionFileError) as caught:
        read_motion(made.save(tmp_path / "x.glb"))
    assert caught.value.code == code


def test_truncated(tmp_path):
    path = Made([{"name": "a"}], [(0, "rotation", [0, 1], [TURN, TURN], "LINEAR")]).save(tmp_path / "x.glb")
    whole = path.read_bytes()
    for data, code in (
        (whole[:-9], "gltf.truncated"),
        (whole[:10], "gltf.version"),
        (b"glTF" + struct.pack("<I", 3) + whole[8:], "gltf.version"),
        (b"hello", "gltf.no_json"),
        (b"[" * 100_000, "gltf.no_json"),
    ):
        path.write_bytes(data)
        with pytest.raises(MotionFileError) as caught:
            read_motion(path)
        assert caught.value.code == code


BLOW = [[0.0, 0, 0], [0, 0, 0], [1, 0, 0], [0, 0, 0], [0, 0, 0]]


@pytest.mark.parametrize(
    ("keys", "rate"),
    [
        ([0, 1, 1.1, 1.2, 2], 30),  # on frames of 30 Hz
        ([0, 1, 1.05, 1.1, 2], 60),
        ([0, 1, 1.031, 1.071, 2.2], 60),  # on no frames at all
        ([0, 0.013, 0.5, 0.517, 3.1], 60),
        ([0, 0.2, 0.4, 0.6, 0.8], 30),  # even, and slower than any recording
        ([0, 1 / 15, 2 / 15, 3 / 15, 4 / 15], 15),
        ([0, 0.5, 1.0, 1.5, 2], 30),
    ],
)
@pytest.mark.parametrize("how", ["LINEAR", "STEP", "CUBICSPLINE"])
def test_sparse_and_uneven_keys_are_met(keys, rate, how):
    """A blow between keys far apart is there in full, whatever the rate."""
    keys = np.array(keys, "<f4").astype(float)
    values = np.array(BLOW)
    times, got = choose_times([keys, keys[[0, -1]]])
    assert got == rate
    if how == "CUBICSPLINE":
        values = np.stack([np.zeros_like(values), values, np.zeros_like(values)], axis=1).reshape(-1, 3)
    sampled = Curve(keys, values, how, False).sample(times)
    assert sampled[:, 0].max() == 1.0
    peak = times[np.argmax(sampled[:, 0])]
    assert peak == pytest.approx(keys[2], abs=0.51 / rate)
    np.testing.assert_allclose(sampled[[0, -1]], 0, atol=1e-9)


def test_several_animations_are_taken_by_name_or_number(tmp_path):
    made = Made([{"name": "a"}], [(0, "translation", [0, 1], [[0, 0, 0], [n, 0, 0]], "LINEAR") for n in (1, 2, 3)])
    curves = made.tree.pop("animations")[0]
    made.tree["animations"] = [
        {"name": name, "samplers": [curves["samplers"][n]], "channels": [{**curves["channels"][n], "sampler": 0}]}
        for n, name in enumerate(("Idle", "Walk", "Walk"))
    ]
    path = made.save(tmp_path / "x.glb")
    for wanted, end in ((None, 1), ("walk", 2), ("Walk 2", 3), (3, 3), ("1", 1)):
        motion = read_motion(path, unit="m", up="y", animation=wanted)
        assert motion.translations[-1, 0, 0] == pytest.approx(end)
        (note,) = [note for note in motion.provenance.notes if note.code.startswith("parts.")]
        assert (*note.values["others"], note.values["read"]).count("Walk") == 1
    with pytest.raises(MotionFileError) as caught:
        read_motion(path, animation="Kick")
    assert caught.value.message.values == {"found": "Kick", "known": ("Idle", "Walk", "Walk 2")}


def _insert(data, place, more):
    return data[:place] + more + data[place:]


@pytest.mark.parametrize(
    ("edit", "code"),
    [
        (lambda d: _insert(d, -300, bytes(range(16))), "gltf.surplus"),
        (lambda d: _insert(d, 60, b"    "), "gltf.truncated"),
        (lambda d: d[:-8], "gltf.truncated"),
        (lambda d: d[:-300] + d[-296:], "gltf.truncated"),
        (lambda d: d + b"<html>", "gltf.surplus"),
        (lambda d: d.replace(b'"rotation"}', b'"rotatiom"}', 1), "gltf.target"),
        (lambda d: d.replace(b'"children"', b'"childrem"', 1), "gltf.unknown_key"),
        (lambda d: d[:8] + struct.pack("<I", 77) + d[12:], "guard.bytes_over"),
        (lambda d: d + bytes(4), "guard.bytes_over"),
    ],
)
def test_what_a_file_declares_is_compared_with_what_came(tmp_path, edit, code):
    """Errors and notes: none of these is read in silence."""
    write_motion(make_walk(), tmp_path / "x.glb")
    data = edit((tmp_path / "x.glb").read_bytes())
    (tmp_path / "y.glb").write_bytes(data)
    try:
        codes = [note.code for note in read_motion(tmp_path / "y.glb").provenance.notes]
    except MotionFileError as error:
        codes = [error.code]
    assert code in codes


@pytest.mark.parametrize(
    ("place", "change", "code"),
    [
        (("bufferViews", 1), {"byteOffset": 4}, "gltf.across"),
        (("accessors", 1), {"componentType": 5122}, "gltf.accessor"),
        (("accessors", 1), {"max": [1, 1, 1, 7], "min": [0, 0, 0, 0]}, "gltf.limits"),
        (("animations", 0, "samplers", 0), {"interpolation": "LINEAS"}, "gltf.keys"),
        (("animations", 0, "samplers", 1), {"output": 1}, "gltf.unused_data"),
        (("animations", 0, "channels", 1), {"sampler": 0}, "gltf.unused"),
        (("animations", 0, "channels", 1, "target"), {"node": 0}, "gltf.target_twice"),
    ],
)
def test_what_gltf_does_not_allow_is_said(tmp_path, place, change, code):
    nodes = [{"name": "a", "children": [1]}, {"name": "b", "translation": [0, 1, 0]}]
    other = TURN[[0, 2, 1, 3]]
    made = Made(nodes, [(node, "rotation", [0, 1], [TURN, other], "LINEAR") for node in (0, 1)])
    item = made.tree
    for key in place:
        item = item[key]
    item.update(change)
    try:
        codes = [note.code for note in read_motion(made.save(tmp_path / "x.glb"), unit="m", up="y").provenance.notes]
    except MotionFileError as error:
        codes = [error.code]
    assert code in codes


@pytest.mark.parametrize(
    ("name", "code"), [("glb_mesh_only/statue.glb", "gltf.no_joints"), ("glb_meshopt/packed.glb", "gltf.extension")]
)
def test_messages_name_what_is_missing(shared_data, name, code):
    with pytest.raises(MotionFileError) as caught:
        read_motion(shared_data(f"reported/{name}"))
    assert caught.value.code == code
