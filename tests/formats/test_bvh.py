"""Reading and writing BVH: every kind of file in use, nothing lost, damage named with its line."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles import plain_bvh

from dousa.errors import MotionFileError, MotionWriteError
from dousa.formats.bvh.reading import CHANNEL_NAMES, BvhLayout, read_bvh
from dousa.formats.bvh.writing import write_bvh
from dousa.motion import Motion, Provenance, Skeleton, compute_trajectories
from dousa.motion.rotations import from_euler

SMALL = """HIERARCHY
ROOT Hips
{
\tOFFSET 0 95 0
\tCHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
\tJOINT Spine
\t{
\t\tOFFSET 0 20.5 0
\t\tCHANNELS 3 Yrotation Xrotation Zrotation
\t\tEnd Site
\t\t{
\t\t\tOFFSET 0 55 1e-3
\t\t}
\t}
\tJOINT LeftUpLeg
\t{
\t\tOFFSET 9 -5 0
\t\tCHANNELS 1 Xrotation
\t\tEnd Site
\t\t{
\t\t\tOFFSET 0 -90 0
\t\t}
\t}
}
MOTION
Frames: 3
Frame Time: 0.0333333
1 90 0 10 20 30 1 2 3 -45
2 91 0.5 11 21 31 1 2 3 -46.25
3 92 1 12 22 32 1 2 3 nan
"""


@pytest.fixture
def bvh(tmp_path):
    """Writes text or bytes as a file; gives the path."""

    def make(content, name="walk.bvh"):
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return make


def same_numbers(first, second):
    """Equal to the last bit; any NaN equals any NaN."""
    a, b = np.ascontiguousarray(first), np.ascontiguousarray(second)
    return a.shape == b.shape and bool(((a.view(np.uint64) == b.view(np.uint64)) | (np.isnan(a) & np.isnan(b))).all())


def assert_same_rotations(first, second, tolerance=1e-9):
    assert np.abs(np.abs((first * second).sum(-1)) - 1).max() < tolerance


def test_the_parts_of_a_file(bvh):
    motion = read_bvh(bvh(SMALL), unit=0.01)
    assert motion.skeleton.names == ("Hips", "Spine", "Spine_end", "LeftUpLeg", "LeftUpLeg_end")
    assert motion.skeleton.parents.tolist() == [-1, 0, 1, 0, 3]
    assert motion.skeleton.end_sites.tolist() == [False, False, True, False, True]
    np.testing.assert_allclose(motion.skeleton.offsets[2], [0, 0.55, 1e-5])
    np.testing.assert_allclose(motion.translations[:, 0], [[0.01, 0.9, 0], [0.02, 0.91, 0.005], [0.03, 0.92, 0.01]])
    assert motion.frame_rate == 30.0
    wanted = from_euler(np.radians([11, 21, 31]), "ZXY")
    assert_same_rotations(motion.rotations[1, 0], wanted)
    assert np.isnan(motion.rotations[2, 3]).all()
    layout = motion.provenance.layout
    assert layout.channels[1] == ("Yrotation", "Xrotation", "Zrotation")
    assert layout.channels[2] == ()
    assert layout.frame_time == "0.0333333"
    assert motion.provenance.values.shape == (3, 10)
    assert motion.provenance.unit_source == "given"


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text.replace("\n", "\r\n"),
        lambda text: text.replace("\n", "\r"),
        lambda text: text.replace("\t", "  "),
        lambda text: text.replace(" ", "\t"),
        lambda text: "\ufeff" + text,
        lambda text: text.lower(),
        lambda text: text.upper(),
        lambda text: text + "\n \n\t\n",
        lambda text: text.rstrip(),
        lambda text: text.replace("\n\t{", " {").replace("Hips\n{", "Hips {"),
        lambda text: text.replace("Frames: 3", "Frames:\t3").replace("Frame Time: ", "Frame Time:\t"),
        lambda text: text.replace("HIERARCHY\n", "\n\nHIERARCHY \n\n").replace("MOTION", " MOTION "),
        lambda text: text.replace("1 2 3 -45", "  +1.0 2e0  0.3E+01 \t-45.0 "),
        lambda text: text.replace("nan", "-NaN"),
        lambda text: text.replace("nan", "-1.#IND"),
    ],
)
def test_spellings_in_use(bvh, change):
    plain, other = read_bvh(bvh(SMALL), unit=0.01), read_bvh(bvh(change(SMALL), "other.bvh"), unit=0.01)
    assert [name.lower() for name in other.skeleton.names] == [name.lower() for name in plain.skeleton.names]
    assert same_numbers(other.provenance.values, plain.provenance.values)
    assert same_numbers(other.rotations, plain.rotations)
    assert other.provenance.layout.channels == plain.provenance.layout.channels


@pytest.mark.parametrize(
    "name",
    [
        "mixamorig:Hips", "Bip01 Pelvis", "腰", "Hüfte", "Hips.001", "End", "the End Site", "JOINT", "Offset",
        "OFFSET 1", "Channels 3", "MOTION x",
    ],
)  # fmt: skip
@pytest.mark.parametrize("encoding", ["utf-8", "latin-1"])
def test_joint_names(bvh, tmp_path, name, encoding):
    if encoding == "latin-1" and name == "腰":
        pytest.skip("not in Latin-1")
    motion = read_bvh(bvh(SMALL.replace("Spine", name).encode(encoding)), unit=0.01)
    assert motion.skeleton.names[1:3] == (name, f"{name}_end")
    write_bvh(motion, tmp_path / "out.bvh")
    assert read_bvh(tmp_path / "out.bvh", unit=0.01).skeleton.names == motion.skeleton.names
    assert f"JOINT {name}\n".encode(encoding) in (tmp_path / "out.bvh").read_bytes()


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text.replace("CHANNELS 3 ", "CHANNELS 3\n\t"),
        lambda text: text.replace("CHANNELS ", "CHANNELS\n\n"),
        lambda text: text.replace("Zposition Zrotation", "Zposition\r\n \tZrotation"),
        lambda text: text.replace("OFFSET ", "OFFSET\n").replace("20.5 0", "20.5\n0"),
        lambda text: text.replace("0\n\tCHANNELS", "0 CHANNELS").replace("0\n\t\tCHANNELS", "0\tCHANNELS"),
        lambda text: text.replace("JOINT Spine", "JOINT\nSpine").replace("End Site", "End\nSite"),
        lambda text: " ".join(text.partition("MOTION")[0].split()) + "\nMOTION" + text.partition("MOTION")[2],
    ],
)
def test_statements_split_over_lines_or_joined(bvh, change):
    wanted, got = read_bvh(bvh(SMALL)), read_bvh(bvh(change(SMALL)))
    assert got.skeleton.names == wanted.skeleton.names
    assert got.provenance.layout == wanted.provenance.layout
    assert same_numbers(got.provenance.values, wanted.provenance.values)


def test_end_site_names_are_unique(bvh):
    extra = "\t\tEnd Site\n\t\t{\n\t\t\tOFFSET 0 0 1\n\t\t}\n"
    text = SMALL.replace("\t}\n\tJOINT LeftUpLeg", extra + "\t}\n\tJOINT Spine_end2")
    names = read_bvh(bvh(text), unit=0.01).skeleton.names
    assert names == ("Hips", "Spine", "Spine_end", "Spine_end3", "Spine_end2", "Spine_end2_end")


def test_position_channels_replace_the_offset_one_by_one(bvh):
    text = SMALL.replace("CHANNELS 1 Xrotation", "CHANNELS 1 Zposition")
    motion = read_bvh(bvh(text.replace("nan", "7")), unit=1.0)
    np.testing.assert_array_equal(motion.translations[:, 3], [[9, -5, -45], [9, -5, -46.25], [9, -5, 7]])
    np.testing.assert_array_equal(motion.rotations[:, 3], [[1, 0, 0, 0]] * 3)


@pytest.mark.parametrize(
    ("text", "rate"),
    [
        ("0.0333333", 30), ("0.008333", 120), (".0083", 120), ("0.04", 25), ("0.033", 30), ("0.017", 60),
        ("0.0166667", 60), ("0.01", 100), ("8.3333e-03", 120), ("0.0166", 60), ("0.016666", 60), ("0.041666", 24),
    ],
)  # fmt: skip
def test_a_frame_time_that_is_a_rounded_usual_rate(bvh, text, rate):
    assert read_bvh(bvh(SMALL.replace("0.0333333", text))).frame_rate == rate


DAMAGE = [
    (lambda t: t.replace("-46.25", ""), 29, "expected 10 channel values, got 9; is the file truncated?"),
    (lambda t: t.replace("-46.25", "-46.25 7"), 29, "expected 10 channel values, got 11"),
    (lambda t: t.replace("-46.25", "abc"), 29, "expected a number, got 'abc'"),
    (lambda t: t.replace("-46.25", "1_0"), 29, "expected a number, got '1_0'"),
    (lambda t: t.replace("-46.25", "-inf"), 29, "expected a finite number, got '-inf'"),
    (lambda t: t.replace("-46.25", "1e999"), 29, "expected a finite number"),
    (lambda t: t.replace("2 91 0.5", "garbage"), 29, "expected a number, got 'garbage'"),
    (lambda t: t.replace("Frames: 3", "Frames: 0"), 26, "no motion"),
    (lambda t: t.replace("Frames: 3", "Frames: -3"), 26, "expected 'Frames: N'"),
    (lambda t: t.replace("Frames: 3", "Frames: many"), 26, "after MOTION, got 'Frames: many'"),
    (lambda t: t[: t.index("0.0333333") + 10], 26, "but none follow; is it truncated or edited?"),
    (lambda t: t.replace("Frames: 3\n", ""), 26, "expected 'Frames: N'"),
    (lambda t: t.replace("Frame Time: 0.0333333\n", ""), 27, "expected 'Frame Time: SECONDS'"),
    (lambda t: t.replace("0.0333333", "0"), 27, "expected a frame time above 0"),
    (lambda t: t.replace("0.0333333", "-0.1"), 27, "expected a frame time above 0"),
    (lambda t: t.replace("0.0333333", "1e300"), 27, "from 1e-6 to 1e6, got '1e300'"),
    (lambda t: t.replace("0.0333333", "nan"), 27, "expected a frame time above 0"),
    (lambda t: t[: t.index("MOTION")], 25, "expected MOTION after the HIERARCHY"),
    (lambda t: t[: t.index("JOINT Left")] + t[t.index("MOTION") :], 15, "'}' missing"),
    (lambda t: t.replace("}\nMOTION", "}}\nMOTION"), 24, "the braces do not pair up"),
    (lambda t: t.replace("Hips\n{", "Hips\n"), 4, "expected '{' after 'Hips'"),
    (lambda t: t.replace("ROOT Hips", "ROOT"), 2, "ROOT without a name"),
    (lambda t: t.replace("JOINT Spine", "JOINT  "), 6, "JOINT without a name"),
    (lambda t: t.replace("ROOT", "JOINT"), 2, "JOINT outside of any ROOT"),
    (lambda t: t.replace("JOINT Spine", "ROOT Spine"), 6, "ROOT inside another joint"),
    (lambda t: t.replace("0 20.5 0", "0 20.5"), 8, "expected 3 numbers after OFFSET, got 2"),
    (lambda t: t.replace("0 20.5 0", "0 x 0"), 8, "expected a finite number in OFFSET, got 'x'"),
    (lambda t: t.replace("0 20.5 0", "0 nan 0"), 8, "expected a finite number in OFFSET, got 'nan'"),
    (lambda t: t.replace("\t\tOFFSET 0 20.5 0\n", ""), 6, "'Spine' has no OFFSET"),
    (lambda t: t.replace("CHANNELS 3 Y", "CHANNELS 4 Y"), 9, "CHANNELS says 4, but 3 names follow"),
    (lambda t: t.replace("CHANNELS 3 Y", "CHANNELS Y"), 9, "expected a number of channels"),
    (lambda t: t.replace("CHANNELS 3 Yrot", "CHANNELS 3 Wrot"), 9, "unknown channel 'Wrotation'"),
    (lambda t: t.replace("6 Xposition", "6 Yposition"), 5, "'Yposition' is there twice"),
    (lambda t: t.replace("Xrotation", "Zrotation", 1), 5, "'Zrotation' is there twice"),
    (lambda t: t.replace("OFFSET 0 20.5 0", "SIZE 3"), 8, "got 'SIZE 3'"),
    (lambda t: "hello\n" + t, 1, "expected HIERARCHY"),
    (lambda t: "HIERARCHY\nMOTION\nFrames: 1\nFrame Time: 1\n1\n", 1, "expected a ROOT joint"),
    (
        lambda t: "HIERARCHY\nROOT a\n{\nOFFSET 0 0 0\n}\nMOTION\nFrames: 1000000000\nFrame Time: 1\n",
        1,
        "no joint has CHANNELS",
    ),
]


@pytest.mark.parametrize(("damage", "line", "problem"), DAMAGE, ids=[problem for _, _, problem in DAMAGE])
@pytest.mark.parametrize("line_end", ["\n", "\r\n"])
def test_damage_is_named_with_its_line(bvh, damage, line, problem, line_end):
    path = bvh(damage(SMALL).replace("\n", line_end))
    with pytest.raises(MotionFileError) as caught:
        read_bvh(path)
    assert problem in str(caught.value)
    assert str(caught.value).startswith(f"{path}:{line}: ")


@pytest.mark.parametrize("row", ["1 2 3 4 5 6 7\n", "1 2 3 4 5 6 7 8 9 10 11\n"])
def test_rows_of_another_skeleton_are_left_out(bvh, row):
    motion = read_bvh(bvh(SMALL + row * 3))
    assert motion.n_frames == 3
    assert [(note.code, note.values["left_out"]) for note in motion.provenance.notes] == [("bvh.other_rows", 3)]


@pytest.mark.parametrize(
    ("name", "frames", "code"),
    [
        ("assimp/Boxing_Toes.bvh", 3070, "guard.frame_count"),
        ("nite_mae/bk_cut_single_01.bvh", 8960, "guard.frame_count"),
        ("motive_blobixx/Take006.bvh", 1, "guard.frame_count"),
        ("smpl_tram/sample.bvh", 613, "bvh.other_rows"),
    ],
)
def test_files_with_a_wrong_number_of_frames(foreign, name, frames, code):
    motion = read_bvh(foreign(name))
    assert motion.n_frames == frames
    assert code in [note.code for note in motion.provenance.notes]


def chain(count):
    head = "".join(f"JOINT j{k}\n{{\nOFFSET 0 1 0\nCHANNELS 1 Xrotation\n" for k in range(1, count))
    values = " ".join("1" for _ in range(count))
    return (
        "HIERARCHY\nROOT j0\n{\nOFFSET 0 1 0\nCHANNELS 1 Xrotation\n"
        + head
        + "}\n" * count
        + f"MOTION\nFrames: 1\nFrame Time: 0.01\n{values}\n"
    )


def test_deep_hierarchies(bvh, tmp_path):
    motion = read_bvh(bvh(chain(3000)))
    assert motion.skeleton.n_joints == 3000
    write_bvh(motion, tmp_path / "out.bvh")
    assert same_numbers(read_bvh(tmp_path / "out.bvh").provenance.values, motion.provenance.values)
    with pytest.raises(MotionFileError, match=r"walk\.bvh:40002: more than 10000 joints"):
        read_bvh(bvh(chain(10_001)))


def test_end_sites_are_no_joints(bvh):
    ends = "End Site\n{\nOFFSET 0 1 0\n}\n"
    text = chain(6_000).replace("}\n", ends + "}\n")  # one in each joint
    assert read_bvh(bvh(text)).skeleton.n_joints == 12_000
    with pytest.raises(MotionFileError, match="more than 10000 joints"):
        read_bvh(bvh(chain(3).replace("}\n", 20_000 * ends + "}\n")))


def test_values_beyond_the_largest_float_make_no_motion(bvh):
    with pytest.raises(MotionFileError, match="'Hips' is at 1e\\+308 in frame 2"):
        read_bvh(bvh(SMALL.replace("2 91", "1e308 91")))


NUMBER = st.floats(-1e10, 1e10) | st.just(math.nan)
ANGLE = st.floats(allow_nan=True, allow_infinity=False)
NAME = st.text(
    st.characters(codec="utf-8", exclude_categories=["C", "Z"], exclude_characters="{}"), min_size=1, max_size=8
)


@st.composite
def bvh_files(draw):
    """Text of a random BVH file and what it holds."""
    count = draw(st.integers(1, 6))
    names = [draw(NAME) for _ in range(count)]
    parents = [-1] + [draw(st.integers(0, joint - 1)) for joint in range(1, count)]
    finite = st.floats(-1e10, 1e10)
    offsets = [[draw(finite) for _ in range(3)] for _ in range(count)]
    channels = [draw(st.permutations(CHANNEL_NAMES))[: draw(st.integers(0, 6))] for _ in range(count)]
    channels[0] = channels[0] or ["Yrotation"]
    flat = [name for joint in _nested(parents) for name in channels[joint]]
    frames = draw(st.integers(1, 3))
    rows = [[draw(NUMBER if name.endswith("position") else ANGLE) for name in flat] for _ in range(frames)]
    return names, parents, offsets, channels, rows


def _nested(parents, joint=0):
    yield joint
    for child, parent in enumerate(parents):
        if parent == joint:
            yield from _nested(parents, child)


def _text(names, parents, offsets, channels, rows):
    def block(joint, indent):
        inner = indent + "  "
        lines = [f"{indent}{'JOINT' if parents[joint] >= 0 else 'ROOT'} {names[joint]}", indent + "{"]
        lines.append(f"{inner}OFFSET {' '.join(map(repr, offsets[joint]))}")
        lines.append(f"{inner}CHANNELS {len(channels[joint])} {' '.join(channels[joint])}")
        children = [child for child, parent in enumerate(parents) if parent == joint]
        for child in children:
            lines += block(child, inner)
        if not children:
            lines += [inner + "End Site", inner + "{", f"{inner}OFFSET 0 1 0", inner + "}"]
        return [*lines, indent + "}"]

    values = "\n".join(" ".join(map(repr, row)) for row in rows)
    return "\n".join(["HIERARCHY", *block(0, ""), "MOTION", f"Frames: {len(rows)}", "Frame Time: 0.01", values, ""])


@pytest.mark.slow
@settings(deadline=None, max_examples=150)
@given(bvh_files())
def test_any_file_is_read_and_written_without_loss(tmp_path_factory, content):
    names, parents, offsets, channels, rows = content
    folder = tmp_path_factory.getbasetemp()
    first, second = folder / "first.bvh", folder / "second.bvh"
    first.write_text(_text(*content), encoding="utf-8", newline="\n")
    motion = read_bvh(first, unit=0.01, up="y")
    order = list(_nested(parents))
    joints = np.flatnonzero(~motion.skeleton.end_sites)
    assert [motion.skeleton.names[joint] for joint in joints] == [names[joint] for joint in order]
    assert same_numbers(motion.provenance.values, np.array(rows))
    layout = motion.provenance.layout
    assert [layout.channels[joint] for joint in joints] == [tuple(channels[joint]) for joint in order]
    assert [layout.offsets[joint] for joint in joints] == [tuple(offsets[joint]) for joint in order]
    write_bvh(motion, second)
    again = read_bvh(second, unit=0.01, up="y")
    assert again.skeleton.names == motion.skeleton.names
    assert again.skeleton.parents.tolist() == motion.skeleton.parents.tolist()
    assert again.provenance.layout == layout
    assert same_numbers(again.provenance.values, motion.provenance.values)
    assert same_numbers(again.rotations, motion.rotations)
    assert same_numbers(again.skeleton.offsets, motion.skeleton.offsets)


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 2**32 - 1), st.sampled_from(["y", "z", "-x"]))
def test_a_motion_without_numbers_of_its_own(tmp_path_factory, seed, up):
    rng = np.random.default_rng(seed)
    joints, frames = 5, 20
    turns = np.cumsum(rng.normal(0, 0.3, (frames, joints, 3)), axis=0)
    offsets = rng.normal(0, 1, (joints, 3))
    moves = np.tile(offsets, (frames, 1, 1))
    moves[:, 3] += rng.normal(0, 0.1, (frames, 3))
    skeleton = Skeleton(tuple("abcde"), [-1, 0, 1, 0, 2], offsets, [False, False, False, False, True])
    rotations = from_euler(turns, "YXZ")
    rotations[:, 4] = [1, 0, 0, 0]
    rotations[:, 1] = from_euler(turns[:, 1, :1], "X")
    layout = BvhLayout(
        (
            ("Yrotation", "Xposition", "Xrotation", "Zrotation"),
            ("Xrotation",),
            ("Xrotation",),
            ("Zrotation", "Yrotation"),
            (),
        ),
        ((0.0, 0.0, 0.0),) * 5,
        "0.01",
    )
    path = tmp_path_factory.getbasetemp() / "made.bvh"
    for provenance in (None, Provenance("x.bvh", "bvh", unit=0.0254, up=up, layout=layout)):
        motion = Motion(skeleton, rotations, moves, 100.0, provenance)
        write_bvh(motion, path)
        again = read_bvh(path, unit=0.0254 if provenance else 0.01, up=up if provenance else "y")
        first, second = compute_trajectories(motion), compute_trajectories(again)
        np.testing.assert_allclose(second.select(first.names[:4]), first.positions[:, :4], atol=1e-8)
        np.testing.assert_allclose(second.positions[:, again.skeleton.end_sites], first.positions[:, 4:], atol=1e-8)
        assert again.frame_rate == 100.0
        if provenance is not None:
            assert again.provenance.layout.channels[1] == ("Xrotation",)


def test_default_layout_and_continuous_angles(tmp_path):
    angle = np.linspace(0, 6 * math.pi, 200)
    skeleton = Skeleton(("root", "arm", "hand"), [-1, 0, 1], [[0, 1, 0], [0, 1, 0], [1, 0, 0]], [False, False, True])
    rotations = np.zeros((200, 3, 4))
    rotations[:, :2] = from_euler(np.stack((0 * angle, angle, 0.1 + 0 * angle), -1), "ZXY")[:, None]
    rotations[:, 2, 0] = 1
    motion = Motion(skeleton, rotations, np.tile(skeleton.offsets, (200, 1, 1)), 50.0)
    write_bvh(motion, tmp_path / "turn.bvh")
    again = read_bvh(tmp_path / "turn.bvh", unit=0.01)
    six = (*CHANNEL_NAMES[:3], "Zrotation", "Xrotation", "Yrotation")
    assert again.provenance.layout.channels == (six, six[3:], ())
    assert np.abs(np.diff(again.provenance.values[:, 3:], axis=0)).max() < 10
    assert_same_rotations(again.rotations, motion.rotations)
    assert "OFFSET 0.0 100.0 0.0" in (tmp_path / "turn.bvh").read_text()


def test_joints_out_of_depth_first_order_are_nested(tmp_path):
    skeleton = Skeleton(("r", "a", "b", "a2", "b2"), [-1, 0, 0, 1, 2], np.arange(15.0).reshape(5, 3))
    rng = np.random.default_rng(1)
    rotations = from_euler(rng.normal(0, 1, (4, 5, 3)), "ZXY")
    motion = Motion(skeleton, rotations, np.tile(skeleton.offsets, (4, 1, 1)), 25.0)
    write_bvh(motion, tmp_path / "x.bvh")
    again = read_bvh(tmp_path / "x.bvh", unit=0.01, up="y")
    assert again.skeleton.names == ("r", "a", "a2", "b", "b2")
    for name in skeleton.names:
        a, b = skeleton.index(name), again.skeleton.index(name)
        assert_same_rotations(again.rotations[:, b], rotations[:, a])


@pytest.mark.parametrize("name", ["", " a", "a{b", "two\nlines"])
def test_names_that_bvh_cannot_hold(tmp_path, name):
    motion = Motion(Skeleton((name,), [-1], np.zeros((1, 3))), [[[1.0, 0, 0, 0]]], [[[0.0, 0, 0]]], 25.0)
    with pytest.raises(MotionWriteError, match="cannot hold the joint name"):
        write_bvh(motion, tmp_path / "x.bvh")
    assert not list(tmp_path.iterdir())


def test_bandai_values_and_kinematics(shared_data):
    path = shared_data("bandai/walk/youthful/dataset-2_walk_youthful_017.bvh")
    motion, (joints, values) = read_bvh(path), plain_bvh.read(path)
    assert same_numbers(motion.provenance.values, values)
    assert (motion.provenance.unit, motion.provenance.up, motion.frame_rate) == (0.01, "y", 30.0)
    positions = compute_trajectories(motion).positions
    for frame in (0, 7, len(values) - 1):
        wanted = plain_bvh.world_positions(joints, values[frame])
        np.testing.assert_allclose(positions[frame], 0.01 * wanted, atol=1e-9)
    left, right = (compute_trajectories(motion).select([f"UpperLeg_{side}"]) for side in "LR")
    assert positions[..., 1].min() > -0.1
    assert np.linalg.norm(left - right, axis=-1).min() > 0.05


@pytest.mark.parametrize(
    ("old", "new"), [("1 90 0", "1 \x190 0"), ("ROOT Hips", "ROOT Hi\x10s"), ("-46.25", "-46.\x125")]
)
def test_a_byte_that_no_text_has_is_refused_and_padding_is_not(bvh, old, new):
    """A changed bit makes such a byte of a digit, and half of a number would be another one."""
    with pytest.raises(MotionFileError) as caught:
        read_bvh(bvh(SMALL.replace(old, new)))
    assert caught.value.code == "numbers.control"
    assert read_bvh(bvh(SMALL + "\0\0\x1a")).n_frames == 3
