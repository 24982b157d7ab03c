"""Reading ASF and AMC: kinematics against truth, the skeleton found, damage named with its line."""

import math

import numpy as np
import pytest
from oracles import plain_bvh

from dousa.errors import MotionFileError
from dousa.formats.asf_amc.reading import read_amc
from dousa.formats.asf_amc.skeleton import read_asf
from dousa.motion import compute_trajectories
from dousa.motion.rotations import to_matrix

ASF = """# made for a test
:version 1.10
:name test
:units
  mass 1.0
  length 0.45
  angle deg
:documentation
   made for a test
:root
   order TX TY TZ RX RY RZ
   axis XYZ
   position 0 0 0
   orientation 0 0 0
:bonedata
  begin
     id 1
     name thigh
     direction 0 -1 0
     length 7
     axis 0 0 20 XYZ
     dof rx ry rz
     limits (-160.0 20.0)
            (-70.0 70.0)
            (-60.0 70.0)
  end
  begin
     id 2
     name shin
     direction 0 -2 0
     length 8
     axis 0 0 0 XYZ
     dof rx
  end
  begin
     id 3
     name trunk
     direction 0 1 0
     length 10
     axis 10 20 30 ZXY
     dof rz rx
  end
  begin
     id 4
     name skull
     direction 0 1 0
     length 4
     axis 0 0 0 XYZ
  end
:hierarchy
  begin
    root thigh trunk
    thigh shin
    trunk skull
  end
"""
AMC = """#!OML:ASF X:\\fur Bonn\\x.ASF
:FULLY-SPECIFIED
:DEGREES
1
root 1 15 2 10 20 30
thigh 5 6 7
shin 40
trunk 11 12
2
root 1.5 15 2 11 21 31
thigh 5 6 7
shin 41
trunk 11 12.25
3
root 2 15 2 12 22 32
thigh 5 6 7
shin 42
trunk 11 1.2e1
"""


@pytest.fixture
def take(tmp_path):
    """Writes a skeleton and a motion; gives the path of the motion."""

    def make(amc=AMC, asf=ASF, name="a_b.amc", skeleton="a.asf"):
        (tmp_path / skeleton).write_bytes(asf.encode("latin-1"))
        (tmp_path / name).write_bytes(amc.encode("latin-1"))
        return tmp_path / name

    return make


def turn(letters, degrees):
    """Matrix of turns about fixed axes, the first letter first."""
    matrix = np.eye(3)
    for letter, angle in zip(letters, degrees, strict=True):
        matrix = plain_bvh.turn(letter, angle)[:3, :3] @ matrix
    return matrix


def test_joints_and_bones(take):
    motion = read_amc(take())
    assert motion.skeleton.names == ("root", "thigh", "shin", "trunk", "skull", "shin_end", "skull_end")
    assert motion.skeleton.parents.tolist() == [-1, 0, 1, 0, 3, 2, 4]
    assert motion.skeleton.end_sites.tolist() == [False] * 5 + [True] * 2
    unit = 0.0254 / 0.45
    assert motion.provenance.unit == pytest.approx(unit)
    assert motion.provenance.unit_source == "declared"
    np.testing.assert_allclose(
        motion.skeleton.offsets[[1, 2, 4, 5]] / unit, [[0, 0, 0], [0, -7, 0], [0, 10, 0], [0, -8, 0]]
    )
    np.testing.assert_allclose(motion.translations[:, 0] / unit, [[1, 15, 2], [1.5, 15, 2], [2, 15, 2]])
    assert motion.frame_rate == 120.0


def test_rotations_in_the_axes_of_the_bones(take):
    turned = to_matrix(read_amc(take()).rotations[1])
    np.testing.assert_allclose(turned[0], turn("XYZ", [11, 21, 31]), atol=1e-12)
    axis = turn("XYZ", [0, 0, 20])
    np.testing.assert_allclose(turned[1], axis @ turn("XYZ", [5, 6, 7]) @ axis.T, atol=1e-12)
    axis = turn("ZXY", [30, 10, 20])  # 10 about x, 20 about y, 30 about z; z first
    np.testing.assert_allclose(turned[3], axis @ turn("ZX", [11, 12.25]) @ axis.T, atol=1e-12)
    np.testing.assert_allclose(turned[4], np.eye(3), atol=1e-12)


def test_radians(take):
    wanted = read_amc(take()).rotations

    def in_radians(line):
        words = line.split()
        if len(words) < 2 or line.startswith("#"):
            return line
        keep = 4 if words[0] == "root" else 1
        return " ".join(words[:keep] + [repr(math.radians(float(word))) for word in words[keep:]])

    text = "\n".join(map(in_radians, AMC.splitlines()))
    np.testing.assert_allclose(read_amc(take(text.replace(":DEGREES", ":RADIANS"))).rotations, wanted, atol=1e-14)
    asf = ASF.replace("angle deg", "angle rad").replace("0 0 20 XYZ", f"0 0 {math.radians(20)!r} XYZ")
    asf = asf.replace("10 20 30 ZXY", " ".join(repr(math.radians(angle)) for angle in (10, 20, 30)) + " ZXY")
    path = take(text.replace(":DEGREES\n", ""), asf, "b.amc", "b.asf")
    np.testing.assert_allclose(read_amc(path).rotations, wanted, atol=1e-14)
    np.testing.assert_allclose(read_amc(take(AMC, asf, "c.amc", "c.asf")).rotations, wanted, atol=1e-14)


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text.replace("\n", "\r\n"),
        lambda text: text.replace("\n", "\r"),
        lambda text: text.replace(" ", "\t"),
        lambda text: text + "\n \n",
        lambda text: text.rstrip(),
        lambda text: text.replace("\\fur", "\\f\xfcr"),
        lambda text: text.replace("thigh 5 6 7\nshin 41", "shin 41.0\nthigh +5 6e0 7."),
        lambda text: text.replace("\n2\n", "\n\n2 \n").replace("shin", "  shin"),
    ],
)
def test_spellings_in_use(take, change):
    plain = read_amc(take())
    other = read_amc(take(change(AMC), ASF.replace("\n", "\r\n"), "o.amc", "o.asf"))
    assert other.skeleton.names == plain.skeleton.names
    np.testing.assert_array_equal(other.rotations, plain.rotations)
    np.testing.assert_array_equal(other.translations, plain.translations)


def test_any_first_frame_number_and_nan(take):
    text = (
        AMC.replace("\n3\n", "\n1003\n").replace("\n2\n", "\n1002\n").replace("\n1\n", "\n1001\n").replace("41", "nan")
    )
    motion = read_amc(take(text))
    assert motion.n_frames == 3
    assert np.isnan(motion.rotations[1, 2]).all()
    assert np.isfinite(motion.rotations[[0, 2]]).all()


def test_bones_that_move_and_stretch(take):
    asf = ASF.replace("dof rx\n", "dof tz rx l tx\n").replace("axis 0 0 0 XYZ", "axis 0 90 0 XYZ", 1)
    asf = asf.replace("position 0 0 0", "position 1 2 3")
    text = (
        AMC.replace("shin 40", "shin 1 40 0.5 2").replace("shin 41", "shin 0 0 0 0").replace("shin 42", "shin 0 0 1 0")
    )
    motion = read_amc(take(text, asf), unit=1.0)
    np.testing.assert_allclose(motion.translations[0, 0], [2, 17, 5])
    # The bone's z axis points to the world's x, its x axis to -z.
    np.testing.assert_allclose(motion.translations[:2, 2], [[1, -7, -2], [0, -7, 0]], atol=1e-12)
    np.testing.assert_allclose(motion.translations[:, 5], [[0, -8.5, 0], [0, -8, 0], [0, -9, 0]], atol=1e-12)


def test_a_scale_that_makes_a_giant_is_not_believed(take):
    motion = read_amc(take(asf=ASF.replace("length 0.45", "length 0.0001")))
    assert motion.provenance.unit_source != "declared"
    assert read_asf(take().parent / "a.asf").unit == pytest.approx(0.0254 / 0.45)


@pytest.mark.parametrize(
    ("motion", "skeletons", "wanted"),
    [
        ("HDM_bd_walk_001_120.amc", ["HDM_bd.asf", "HDM_bk.asf"], "HDM_bd.asf"),
        ("HDM_bd_walk_001_120.AMC", ["hdm_BD.ASF", "HDM_bk.asf"], "hdm_BD.ASF"),
        ("86_01.amc", ["86.asf", "8.asf"], "86.asf"),
        ("walk.amc", ["walk.asf", "other.asf"], "walk.asf"),
        ("walk.amc", ["subject.asf"], "subject.asf"),
        ("deep/er/86_01.amc", ["86.asf", "87.asf"], "86.asf"),
        ("deep/86_01.amc", ["86.asf", "deep/other.asf"], "86.asf"),
        ("deep/walk.amc", ["a.asf", "b.asf", "deep/other.asf"], "deep/other.asf"),
    ],
)
def test_the_skeleton_is_found(tmp_path, motion, skeletons, wanted):
    for number, name in enumerate([*skeletons, "../unrelated.txt"]):
        path = tmp_path / "x" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(ASF if name == wanted else ASF.replace("thigh", f"bone{number}"))
    path = tmp_path / "x" / motion
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(AMC)
    assert "thigh" in read_amc(path).skeleton.names


def test_no_or_several_skeletons(take):
    path = take(skeleton="other.asf")
    (path.parent / "third.asf").write_text(ASF)
    with pytest.raises(
        MotionFileError, match=r"several skeletons may fit: other\.asf, third\.asf .*--read skeleton=FILE"
    ):
        read_amc(path)
    assert read_amc(path, skeleton=path.parent / "third.asf").n_frames == 3
    deep = path.parent / "1" / "2" / "3" / "4"
    deep.mkdir(parents=True)
    (deep / "walk.amc").write_text(AMC)
    with pytest.raises(MotionFileError, match=r"no \.asf skeleton found .*--read skeleton=FILE"):
        read_amc(deep / "walk.amc")


def test_a_changed_skeleton_is_read_again(take):
    path = take()
    assert "skull" in read_amc(path).skeleton.names
    take(asf=ASF.replace("skull", "cranium"))
    assert "cranium" in read_amc(path).skeleton.names


AMC_DAMAGE = [
    (lambda t: t.replace("shin 41", "shin"), 12, "expected 1 values for 'shin', got 0; is the file truncated?"),
    (lambda t: t.replace("shin 41", "shin 41 42"), 12, "expected 1 values for 'shin', got 2"),
    (lambda t: t.replace("shin 41", "shin x"), 12, "expected a number, got 'x'"),
    (lambda t: t.replace("shin 41", "shin inf"), 12, "expected a finite number, got 'inf'"),
    (lambda t: t.replace("shin 41", "tail 41"), 12, "bone 'tail' is not in "),
    (lambda t: t.replace("shin 41\n", ""), 13, "frame 2 of the file has no values for bone 'shin'"),
    (lambda t: t.replace("shin 41", "shin 41\nshin 41"), 13, "bone 'shin' comes twice in one frame"),
    (lambda t: t.replace("\n3\n", "\n3x\n"), 14, "expected a frame number or a bone, got '3x'"),
    (lambda t: t[: t.index("trunk 11 1.2e1")], 18, "frame 3 of the file has no values for bone 'trunk'"),
    (lambda t: t[: t.index("\n1\n")], 4, "no frames"),
    (lambda t: t.replace(":DEGREES", "DEGREES"), 3, "expected a comment, a keyword or the number"),
]


@pytest.mark.parametrize(("damage", "line", "problem"), AMC_DAMAGE, ids=[problem for _, _, problem in AMC_DAMAGE])
@pytest.mark.parametrize("line_end", ["\n", "\r\n"])
def test_a_damaged_motion_is_named_with_its_line(take, damage, line, problem, line_end):
    path = take(damage(AMC).replace("\n", line_end))
    with pytest.raises(MotionFileError) as caught:
        read_amc(path)
    assert problem in str(caught.value)
    assert str(caught.value).startswith(f"{path}:{line}: ")


ASF_DAMAGE = [
    (lambda t: t.replace("thigh shin\n", "thigh shin\n    shin thigh\n"), 54, "bone 'thigh' has two parents"),
    (
        lambda t: t.replace("root thigh trunk", "root trunk").replace("thigh shin\n", "thigh shin\n shin thigh\n"),
        54,
        "a cycle",
    ),
    (
        lambda t: t.replace("    thigh shin\n", ""),
        27,
        "bones not connected to the root (a cycle, or a parent missing): shin",
    ),
    (lambda t: t.replace("trunk skull", "trunk skul"), 54, "the hierarchy names 'skul', which is no bone"),
    (lambda t: t.replace("trunk skull", "trunk root"), 54, "the hierarchy names 'root'"),
    (lambda t: t.replace("name shin", "name thigh"), 27, "a second bone 'thigh'"),
    (lambda t: t.replace("     name shin\n", ""), 27, "a bone without a name"),
    (lambda t: t.replace("length 8", "length eight"), 31, "expected 1 finite number(s) after 'length', got 'eight'"),
    (lambda t: t.replace("length 0.45", "length 0"), 6, "expected a length above 0"),
    (lambda t: t.replace("direction 0 -2 0", "direction 0 nan 0"), 30, "expected 3 finite number(s)"),
    (lambda t: t.replace("ZXY", "ZXX"), 40, "expected an axis order such as XYZ, got 'ZXX'"),
    (lambda t: t.replace("dof rz rx", "dof rz rw"), 41, "unknown channel 'rw'"),
    (lambda t: t.replace("dof rz rx", "dof rz rz"), 41, "a channel twice"),
    (lambda t: t[: t.index("  end\n:hierarchy")], 43, "a bone has no 'end'; is the file truncated?"),
    (lambda t: t[: t.index(":bonedata")], None, "expected bones in a :bonedata section"),
    (lambda t: t.replace("   order TX TY TZ RX RY RZ\n", ""), None, "in the :root section"),
]


@pytest.mark.parametrize(("damage", "line", "problem"), ASF_DAMAGE, ids=[problem for _, _, problem in ASF_DAMAGE])
def test_a_damaged_skeleton_is_named_with_its_line(take, damage, line, problem):
    path = take(asf=damage(ASF)).parent / "a.asf"
    with pytest.raises(MotionFileError) as caught:
        read_asf(path)
    assert problem in str(caught.value)
    assert str(caught.value).startswith(f"{path}:{line}: " if line else f"{path}: ")


def test_a_missing_skeleton(take, tmp_path):
    with pytest.raises(MotionFileError, match=r"none\.asf: no such file"):
        read_amc(take(), skeleton=tmp_path / "none.asf")


def test_a_long_chain_of_bones(take):
    count = 3000
    bones = "".join(f"begin\nname b{k}\ndirection 0 1 0\nlength 1\naxis 0 0 0 XYZ\ndof rx\nend\n" for k in range(count))
    tree = "root b0\n" + "".join(f"b{k} b{k + 1}\n" for k in range(count - 1))
    asf = ASF[: ASF.index(":bonedata")] + ":bonedata\n" + bones + ":hierarchy\nbegin\n" + tree + "end\n"
    text = "1\nroot 0 0 0 0 0 0\n" + "".join(f"b{k} 0.5\n" for k in range(count))
    assert read_amc(take(text, asf)).skeleton.n_joints == count + 2


TRUE_JOINTS = {
    "pelvis": "root", "neck": "upperneck", "head": "head_end", "left_shoulder": "lhumerus", "left_elbow": "lradius",
    "left_wrist": "lhand", "right_shoulder": "rhumerus", "right_elbow": "rradius", "right_wrist": "rhand",
    "left_hip": "lfemur", "left_knee": "ltibia", "left_ankle": "lfoot", "left_toe": "ltoes", "right_hip": "rfemur",
    "right_knee": "rtibia", "right_ankle": "rfoot", "right_toe": "rtoes",
}  # fmt: skip


@pytest.mark.parametrize(
    ("truth", "take_path", "first"),
    [
        ("cmu86_walk", "cmu86/86_01.amc", 0),
        ("cmu86_punch", "cmu86/86_01.amc", 2010),
        ("bd_squat", "hdm05/squat1Reps/HDM_bd_squat1Reps_007_120.amc", 0),
        ("bk_elbowtoknee", "hdm05/elbowToKnee1RepsLelbowStart/HDM_bk_elbowToKnee1RepsLelbowStart_008_120.amc", 0),
        ("dg_throw", "hdm05/throwBasketball/HDM_dg_throwBasketball_008_120.amc", 0),
    ],
)
def test_joints_are_where_the_rendered_truth_has_them(shared_data, truth, take_path, first):
    with np.load(shared_data(f"silhouette_bench/{truth}_clean.npz")) as bench:
        names, wanted = [str(name) for name in bench["joint_names"]], bench["joint_positions"]
    trajectories = compute_trajectories(read_amc(shared_data(take_path)))
    found = trajectories.select([TRUE_JOINTS[name] for name in names])[first::4]  # 120 Hz to 30 Hz
    count = min(len(found), len(wanted))
    assert count > 30
    np.testing.assert_allclose(found[:count], wanted[:count], atol=1e-6)
