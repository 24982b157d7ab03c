"""MikuMikuDance: keys and their curves by hand, models, IK beside a cyclic coordinate descent, damage."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from dousa.errors import MotionFileError, OptionError, UnknownFormatError
from dousa.formats.mmd.models import load_model, template
from dousa.formats.mmd.vmd import ease, load_vmd
from dousa.formats.registry import read_motion, write_motion
from dousa.library.store.ingest import look_at
from dousa.motion import JOINT_INDEX, canonicalise, compute_trajectories
from dousa.motion.synthetic import draw_performer, make_motion
from formats import made_mmd as made
from formats.made_files import code_of, save

UNIT = 0.08


def places(motion, name):
    points = compute_trajectories(motion)
    return points.positions[:, points.names.index(name)]


def rest(name):
    return next(bone.place for bone in template().bones if bone.name == name) * UNIT


def turn(axis, angle):
    """A quaternion x y z w in MMD's axes."""
    return Rotation.from_rotvec(np.array(axis) * angle).as_quat()


def test_a_body_at_rest(tmp_path):
    motion = read_motion(save(tmp_path / "x.vmd", made.make_vmd([made.make_key("左腕", 0)])))
    assert (motion.n_frames, motion.frame_rate, motion.skeleton.names[0]) == (1, 30.0, "腰")
    assert [note.code for note in motion.provenance.notes] == ["mmd.mean_body"]
    assert (motion.provenance.unit, motion.provenance.up) == (UNIT, "y")
    for name in ("左腕", "右手首", "左足", "右つま先", "頭"):
        np.testing.assert_allclose(places(motion, name)[0], rest(name), atol=2e-4)
    found = canonicalise(motion)
    assert found.mapping.table == "MMD"
    assert not found.mapping.derived
    assert {warning.code for warning in found.warnings} == {"mmd.mean_body"}
    assert 1.5 < found.height < 1.65


def test_turns_and_moves_by_hand(tmp_path):
    """An arm that is raised by 36 degrees is level, and points to the left; a step to MMD's front (-z) is one to +z."""
    up = turn((0, 0, 1), np.arctan2(0.588, 0.809))
    keys = [made.make_key("左腕", 0), made.make_key("左腕", 10, turn=up)]
    keys += [made.make_key("センター", 10, place=(1, 2, -3)), made.make_key("センター", 0)]
    motion = read_motion(save(tmp_path / "x.vmd", made.make_vmd(keys)))
    assert motion.n_frames == 11
    arm = places(motion, "左ひじ")[10] - places(motion, "左腕")[10]
    np.testing.assert_allclose(arm / np.linalg.norm(arm), [1, 0, 0], atol=1e-3)
    moved = places(motion, "頭")[[0, 5, 10]] - rest("頭")
    np.testing.assert_allclose(moved, np.array([(0, 0, 0), (0.5, 1, 1.5), (1, 2, 3)]) * UNIT, atol=1e-6)
    head = read_motion(save(tmp_path / "y.vmd", made.make_vmd([made.make_key("首", 0, turn=turn((1, 0, 0), 0.5))])))
    nose = places(head, "頭_end")[0] - places(head, "首")[0]  # a turn about x nods to the back in MMD: +z, here -z
    assert nose[2] * np.sin(-0.5) > 0


def test_curves(tmp_path):
    slow, linear = (127, 0, 127, 0), (20, 20, 107, 107)
    curve = made.spread_curve((slow, linear, linear, linear))
    # The switch of the physics stands in two bytes of the first row.
    curve = curve[:2] + b"\x63\x0f" + curve[4:]
    keys = [made.make_key("センター", 0), made.make_key("センター", 20, place=(10, 10, 10), curve=curve)]
    motion = load_vmd(save(tmp_path / "x.vmd", made.make_vmd(keys)))
    got, _ = motion.bones["センター"].sample(21)
    np.testing.assert_allclose(got[:, 1], np.arange(21) / 2, atol=1e-6)
    np.testing.assert_allclose(got[:, 2], -np.arange(21) / 2, atol=1e-6)
    # x(t) = 3 (1-t) t + t^3 (both handles at 1), y(t) = t^3
    t = np.linspace(0, 1, 2001)
    x = 3 * (1 - t) ** 2 * t + 3 * (1 - t) * t**2 + t**3
    np.testing.assert_allclose(got[:, 0], 10 * np.interp(np.arange(21) / 20, x, t**3), atol=1e-3)
    assert ease(np.array([0.0, 1.0]), np.array([[1.0, 0, 1, 0]] * 2)).tolist() == [0, 1]


@given(st.lists(st.integers(0, 127), min_size=4, max_size=4), st.floats(0, 1))
def test_curves_rise_from_0_to_1(handles, share):
    curve = np.array([handles]) / 127
    value = float(ease(np.array([share]), curve)[0])
    assert -1e-9 <= value <= 1 + 1e-9


def descend(hip, thigh, shank, goal, rounds=200):
    """Knee and ankle by cyclic coordinate descent, as MMD does it: first the knee, about x and never forwards."""
    bend, leg = np.deg2rad(0.5), Rotation.identity()
    for _ in range(rounds):
        knee = hip + leg.apply(thigh)
        ankle = knee + (leg * Rotation.from_rotvec([bend, 0, 0])).apply(shank)
        # In the plane across the hinge.
        now, wanted = ((leg.inv().apply(p - knee))[1:] for p in (ankle, goal))
        step = np.arctan2(now[0] * wanted[1] - now[1] * wanted[0], now @ wanted)
        bend = np.clip(bend + np.clip(step, -2, 2), np.deg2rad(0.5), np.pi)
        ankle = knee + (leg * Rotation.from_rotvec([bend, 0, 0])).apply(shank)
        start, end = ankle - hip, goal - hip
        axis = np.cross(start, end)
        size = np.linalg.norm(axis)
        if size > 1e-12:
            leg = Rotation.from_rotvec(axis / size * np.arctan2(size, start @ end)) * leg
    knee = hip + leg.apply(thigh)
    return knee, knee + (leg * Rotation.from_rotvec([bend, 0, 0])).apply(shank)


def test_legs_reach_their_goals_as_by_descent(tmp_path):
    rng = np.random.default_rng(0)
    steps = np.column_stack((rng.uniform(-1, 2, 12), rng.uniform(0.5, 4, 12), rng.uniform(-3, 1, 12)))
    keys = [made.make_key("左足ＩＫ", 5 * n, place=step) for n, step in enumerate(steps)]
    keys += [made.make_key("右足ＩＫ", 0), made.make_key("センター", 0, place=(0, -1, 0))]
    motion = read_motion(save(tmp_path / "x.vmd", made.make_vmd(keys)))
    hip, thigh = rest("左足") - (0, UNIT, 0), rest("左ひざ") - rest("左足")
    shank = rest("左足首") - rest("左ひざ")
    for n, step in enumerate(steps):
        goal = rest("左足首") + step * (1, 1, -1) * UNIT
        ankle = places(motion, "左足首")[5 * n]
        np.testing.assert_allclose(ankle, goal, atol=1e-5)
        knee, reached = descend(hip, thigh, shank, goal)
        np.testing.assert_allclose(reached, goal, atol=2e-3)
        np.testing.assert_allclose(places(motion, "左ひざ")[5 * n], knee, atol=5e-3)
    np.testing.assert_allclose(places(motion, "右足首"), np.tile(rest("右足首"), (56, 1)), atol=1e-5)
    np.testing.assert_allclose(places(motion, "右つま先"), np.tile(rest("右つま先"), (56, 1)), atol=1e-5)
    # Bones keep their lengths, and knees bend backwards.
    for ends in (("左足", "左ひざ"), ("左ひざ", "左足首"), ("右足", "右ひざ")):
        lengths = np.linalg.norm(places(motion, ends[0]) - places(motion, ends[1]), axis=1)
        np.testing.assert_allclose(lengths, np.linalg.norm(rest(ends[0]) - rest(ends[1])), rtol=1e-9)
    assert (places(motion, "右ひざ")[:, 2] > 0.1).all()


def test_switches_and_turned_legs(tmp_path):
    bent = turn((1, 0, 0), -0.8)  # a knee that bends: MMD's limits are -180 to -0.5 degrees
    keys = [made.make_key("左ひざ", 0, turn=bent), made.make_key("センター", 20)]
    forward = read_motion(save(tmp_path / "fk.vmd", made.make_vmd(keys)))
    assert places(forward, "左足首")[0, 2] < rest("左足首")[2] - 0.2  # without keys of the IK its turns count
    keys += [made.make_key("左足ＩＫ", 0)]
    motion = read_motion(
        save(tmp_path / "x.vmd", made.make_vmd(keys, [(0, {"左足ＩＫ": True}), (10, {"左足ＩＫ": False})]))
    )
    np.testing.assert_allclose(places(motion, "左足首")[9], rest("左足首"), atol=2e-4)
    np.testing.assert_allclose(places(motion, "左足首")[10:], places(forward, "左足首")[10:], atol=1e-9)


def test_cancelling_bones(tmp_path):
    """What 腰 and 肩P turn, the legs and the arm do not, as semi-standard models have it."""
    keys = [made.make_key("腰", 0, turn=turn((0, 1, 0), 0.6)), made.make_key("左ひざ", 0), made.make_key("右ひざ", 0)]
    keys += [made.make_key("右肩P", 0, turn=turn((0, 0, 1), 0.4))]
    motion = read_motion(save(tmp_path / "x.vmd", made.make_vmd(keys)))
    thigh = places(motion, "左ひざ")[0] - places(motion, "左足")[0]
    np.testing.assert_allclose(thigh, rest("左ひざ") - rest("左足"), atol=1e-7)
    assert abs(places(motion, "左腕")[0, 2]) > 0.05
    arm, other = (places(motion, f"{side}ひじ")[0] - places(motion, f"{side}腕")[0] for side in "右左")
    np.testing.assert_allclose(arm[1], other[1], atol=1e-6)


def test_models(tmp_path):
    keys = [made.make_key("センター", 0, place=(0, -2, 0)), made.make_key("左腕", 30, turn=turn((0, 0, 1), 0.5))]
    plain = read_motion(save(tmp_path / "x.vmd", made.make_vmd(keys)))
    for number, model in enumerate((made.make_pmx(), made.make_pmx(encoding=1, n_vertices=50))):
        folder = tmp_path / f"pmx{number}"
        save(folder / "model.pmx", model)
        beside = read_motion(save(folder / "x.vmd", made.make_vmd(keys)))
        assert [note.code for note in beside.provenance.notes] == ["mmd.model"]
        assert beside.skeleton.names == plain.skeleton.names
        np.testing.assert_allclose(beside.rotations, plain.rotations, atol=1e-6)
        np.testing.assert_allclose(beside.translations, plain.translations, atol=1e-6)
        assert look_at(str(folder / "x.vmd"), _options()).files[1:] == (str(folder / "model.pmx"),)
        save(folder / "other.pmx", model)  # which of the two?
        assert look_at(str(folder / "x.vmd"), _options()).files[1:] == ()
    tall = read_motion(tmp_path / "x.vmd", skeleton=save(tmp_path / "t" / "tall.pmx", made.make_pmx(scale=1.25)))
    np.testing.assert_allclose(places(tall, "頭")[0, 1], 1.25 * rest("頭")[1] - 2 * UNIT, atol=1e-4)
    old = read_motion(tmp_path / "x.vmd", skeleton=save(tmp_path / "t" / "old.pmd", made.make_pmd()))
    np.testing.assert_allclose(places(old, "左手首"), places(plain, "左手首"), atol=1e-5)
    with pytest.raises(UnknownFormatError, match=r"give a \.vmd"):
        read_motion(tmp_path / "t" / "tall.pmx")
    with pytest.raises(OptionError):
        write_motion(plain, tmp_path / "x.npz")
        read_motion(tmp_path / "x.npz", skeleton=tmp_path / "t" / "old.pmd", up="y", frame_rate=-1)


def _options():
    from dousa.formats import ReadOptions

    return ReadOptions()


def test_old_header_and_short_file(tmp_path):
    data = made.make_vmd([made.make_key("センター", 0), made.make_key("左腕", 3)])
    rows = data[50 : 50 + 4 + 2 * 111]
    old = b"Vocaloid Motion Data file".ljust(30, b"\0") + b"miku".ljust(10, b"\0") + rows
    assert load_vmd(save(tmp_path / "x.vmd", old)).model == "miku"
    assert read_motion(tmp_path / "x.vmd").n_frames == 4


def test_damage(tmp_path):
    good = made.make_vmd([made.make_key("センター", 0), made.make_key("左腕", 3)])
    path = tmp_path / "x.vmd"
    assert code_of(save(path, b"hello")) == "mmd.no_vmd"
    assert code_of(save(path, good[:40])) == "mmd.truncated"
    assert code_of(save(path, good[:100])) == "mmd.truncated"
    assert code_of(save(path, made.make_vmd([]))) == "mmd.no_bones"
    assert code_of(save(path, made.make_vmd([made.make_key("センター", 10**9)]))) == "mmd.frames"
    assert code_of(save(path, made.make_vmd([made.make_key("センター", 0, place=(0, np.nan, 0))]))) == "mmd.finite"
    assert code_of(save(path, made.make_vmd([made.make_key("ネクタイ", 0)]))) == "mmd.other_bones"
    for model, code in (
        (b"hello", "mmd.no_model"),
        (made.make_pmx()[:500], "mmd.truncated"),
        (made.make_pmx()[:-200], "mmd.truncated"),
        (b"PMX " + b"\0" * 100, "mmd.version"),
        (made.make_pmx(template().bones[:3]), "mmd.no_body"),
        (made.make_pmd(template().bones[:30][::-1]), "mmd.bone_number"),
    ):
        (tmp_path / "m.pmx").write_bytes(model)
        got = code_of(save(path, good), skeleton=tmp_path / "m.pmx")
        assert got == code or (code == "mmd.bone_number" and got in ("mmd.tree", "mmd.no_body")), got
    (tmp_path / "m.pmx").unlink()


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_damaged_models_are_read_or_refused(tmp_path_factory, data):
    path = tmp_path_factory.getbasetemp() / "fuzzed.pmx"
    content = bytearray(made.make_pmx() if data.draw(st.booleans()) else made.make_pmd())
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(bytes(content[: data.draw(st.integers(1, len(content)))]))
    try:
        assert load_model(path).bones
    except MotionFileError as error:
        assert error.code.startswith("mmd.")


def test_written_and_read_again(tmp_path):
    """A walk of another skeleton on the bones of MMD; read again, it is within 0.1 mm."""
    walk = make_motion("walk", draw_performer(2))
    write_motion(walk, tmp_path / "x.vmd")
    first = read_motion(tmp_path / "x.vmd")
    assert first.frame_rate == 30
    write_motion(first, tmp_path / "y.vmd")
    again = read_motion(tmp_path / "y.vmd")
    assert again.skeleton.names == first.skeleton.names
    there, back = (compute_trajectories(motion).positions for motion in (first, again))
    np.testing.assert_allclose(back, there, atol=1e-4)
    assert directions_between(walk, first).mean() < 3.0  # feet are held in place


def directions_between(one, other):
    """Degrees between the thighs, shanks, upper arms and forearms of two motions, (T, 8)."""
    angles = []
    for start, end in (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist")):
        for side in ("left_", "right_"):
            limbs = []
            for motion in (one, other):
                places = canonicalise(motion).positions
                limb = places[:, JOINT_INDEX[side + end]] - places[:, JOINT_INDEX[side + start]]
                limbs.append(limb / np.linalg.norm(limb, axis=1, keepdims=True))
            n = min(map(len, limbs))
            angles.append(np.degrees(np.arccos(np.clip((limbs[0][:n] * limbs[1][:n]).sum(axis=1), -1, 1))))
    return np.array(angles).T
