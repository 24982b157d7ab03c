"""Body files: a person in three lines, any tree of parts, and what is said about a wrong one."""

from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dousa.errors import BodyModelError, MotionFileError, MotionWriteError
from dousa.estimation.body.body_file import read_body, write_body
from dousa.estimation.body.human import SEXES, make_human
from dousa.estimation.body.kinematics import compute_points

# A crane: a mast, a jib that turns and lifts, and a hook that is a box without any sphere.
CRANE = """# metres
stature = 1.2

[[part]]
name = "mast"
spheres = [[0, 0, 0, 0.1], [0, 1, 0, 0.05]]

[[part]]
name = "jib"
joint = "slew"
parent = "mast"
offset = [0, 1, 0]
rest = [0.7071, 0, 0, -0.7071]
axes = [[1, 0, 0], [0, 0, 1]]
limits_degrees = [[-170, 170], [-10, 60]]
spheres = [[0, 0, 0, 0.05], [0, 0.8, 0, 0.02]]

[[part]]
name = "hook"
parent = "jib"
offset = [0, 0.8, 0]
spheres = [[-0.1, 0, -0.1], [0.1, 0, -0.1], [0.1, 0.2, 0.1], [-0.1, 0.2, 0.1, 0]]

[[tip]]
name = "load"
part = "hook"
offset = [0, 0.3, 0]
"""


def same(one, other):
    return all(np.array_equal(getattr(one, f.name), getattr(other, f.name)) for f in fields(one))


def write(tmp_path, text):
    path = tmp_path / "body.toml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def test_a_tree_that_is_no_person(tmp_path):
    body = read_body(write(tmp_path, CRANE))
    assert body.names == ("mast", "jib", "hook") and body.joints == ("mast", "slew", "hook")
    assert body.n_axes.tolist() == [0, 2, 0] and body.parents.tolist() == [-1, 0, 1]
    np.testing.assert_allclose(body.angle_limits, np.radians([[-170, 170], [-10, 60]]))
    np.testing.assert_array_equal(body.spheres[4:, 3], 0.0)
    assert body.sphere_starts.tolist() == [0, 2, 4, 8]
    pose = np.array([0, 0, 0, 1, 0, 0, 0, 0, 0.0])
    np.testing.assert_allclose(compute_points(body, pose)[-1], (1.1, 1, 0), atol=1e-6)
    write_body(body, tmp_path / "again.toml")
    assert same(body, read_body(tmp_path / "again.toml"))


def test_how_a_joint_moves_may_be_told_or_left_out(tmp_path):
    plain = read_body(write(tmp_path, CRANE))
    assert plain.agility.tolist() == [1, 1, 1] and not plain.stiffness.any() and not plain.neutral.any()
    write_body(plain, tmp_path / "plain.toml")
    assert not {"agility", "neutral", "stiffness"} & set((tmp_path / "plain.toml").read_text().split())
    told = "agility = 0.3\nneutral = [0.1, -0.7]\nstiffness = 2\nlimits_degrees"
    body = read_body(write(tmp_path, CRANE.replace("limits_degrees", told)))
    assert body.agility.tolist() == [1, 0.3, 1] and body.stiffness.tolist() == [0, 2, 0]
    assert body.neutral.tolist() == [[0, 0, 0], [0.1, -0.7, 0], [0, 0, 0]]
    write_body(body, tmp_path / "again.toml")
    assert same(body, read_body(tmp_path / "again.toml"))


@given(
    agility=st.floats(1e-300, 1e300),
    stiffness=st.floats(0, 1e300),
    neutral=st.lists(st.floats(-1e300, 1e300), min_size=30, max_size=30),
)
@settings(max_examples=25, deadline=None)
def test_how_joints_move_comes_back_bit_for_bit(tmp_path_factory, agility, stiffness, neutral):
    path = tmp_path_factory.mktemp("bodies") / "person.toml"
    body = make_human()
    angles = np.zeros((15, 3))
    angles[np.arange(3) < body.n_axes[:, None]] = neutral
    body = replace(body, agility=np.full(15, agility), stiffness=np.full(15, stiffness), neutral=angles)
    write_body(body, path)
    assert same(body, read_body(path))


@given(stature=st.floats(0.5, 2.3), sex=st.sampled_from(SEXES), share=st.floats(0.5, 2.0), girth=st.floats(0.5, 2.0))
@settings(max_examples=25, deadline=None)
def test_every_person_comes_back_bit_for_bit(tmp_path_factory, stature, sex, share, girth):
    path = tmp_path_factory.mktemp("bodies") / "person.toml"
    measures = {"thigh": 0.238 * share * stature, "chest_girth": 0.5 * girth * stature}
    body = make_human(stature, sex, measures)
    write_body(body, path)
    assert same(body, read_body(path))


def test_names_of_any_letters_come_back(tmp_path):
    text = CRANE.replace('"hook"', r'"h\"o\\ok\t\u007f釣"').replace('"load"', '"荷 物"')
    body = read_body(write(tmp_path, text))
    assert body.names[2] == 'h"o\\ok\t\x7f釣'
    write_body(body, tmp_path / "again.toml")
    assert same(body, read_body(tmp_path / "again.toml"))


def test_a_person_in_three_lines(tmp_path):
    path = write(tmp_path, '\ufeffstature = 1.65\r\nsex = "female"\r\n[measures]\r\nthigh = 0.4\r\n')
    assert same(read_body(path), make_human(1.65, "female", {"thigh": 0.4}))
    assert same(read_body(write(tmp_path, "stature = 2")), make_human(2.0))


# ruff: noqa: E501 - a case a line
WRONG = {
    "no TOML": ("stature = 1.7\nsex = female\n", r"body.toml:2: expected TOML"),
    "nothing told": ('sex = "male"', "expected 'stature = ' in metres"),
    "centimetres": ("# me\nstature = 172", "body.toml:2: stature: .*centimetres, write 1.72"),
    "another sex": ("stature = 1.7\nsex = 'f'", "body.toml:2: sex: expected one of"),
    "a sex that is none": ("stature = 1.7\nsex = ['f']", "body.toml:2: sex: expected one of"),
    "a word too much": ("stature = 1.7\nweight = 70", "body.toml:2: a body file has no entry 'weight'"),
    "an unknown measure": ("stature = 1.7\n[measures]\nleg = 0.8", "body.toml:3: no measure is called 'leg'"),
    "an absurd measure": ("stature = 1.7\n[measures]\nthigh = 4", "body.toml:3: thigh: expected"),
    "measures no table": ("stature = 1.7\nmeasures = 3", "body.toml:2: measures: expected a table"),
    "a tree without stature": (CRANE.replace("stature = 1.2", ""), "expected 'stature = ' in metres"),
    "a stature of words": (CRANE.replace("1.2", '"tall"', 1), "body.toml:2: stature: expected metres"),
    "a person's word in a tree": ("sex = 'male'\n" + CRANE, "has no entry 'sex'"),
    "a part as a table": ("stature = 1.0\n[part]\nname = 'x'", "body.toml:2: .*one \\[\\[part\\]\\] for each part"),
    "an unknown entry": (CRANE.replace("rest =", "turn ="), "body.toml:13: part 'jib' has no entry 'turn'"),
    "no such parent": (CRANE.replace('parent = "jib"', 'parent = "jab"'), "body.toml:20: .*no part called 'jab'"),
    "two roots": (CRANE.replace('parent = "jib"\n', ""), "body.toml:18: part 'hook': expected a 'parent'"),
    "its own parent": (CRANE.replace('parent = "jib"', 'parent = "hook"'), "body.toml:18: part 'hook': .*before it"),
    "no name": (CRANE.replace('name = "mast"\n', ""), "body.toml:4: part 1: expected 'name' as text, got None"),
    "the same name": (CRANE.replace('"hook"', '"jib"'), "body.toml:19: part 'jib': a second part"),
    "no solid": (CRANE.replace("spheres = [[0, 0, 0, 0.05], [0, 0.8, 0, 0.02]]", ""), "'jib': spheres: .*got nothing"),
    "an empty solid": (CRANE.replace("[[0, 0, 0, 0.05], [0, 0.8, 0, 0.02]]", "[]"), "'jib': spheres: expected"),
    "a ragged solid": (CRANE.replace("[0, 0.8, 0, 0.02]", "[0, 0.8]"), "body.toml:16: part 'jib': spheres: expected n x 4"),
    "a negative radius": (CRANE.replace("0.02]", "-0.02]"), "radii of 0 m or more"),
    "a long axis": (CRANE.replace("[[1, 0, 0], [0", "[[2, 0, 0], [0"), "body.toml:14: part 'jib': axes: expected unit length"),
    "slanted axes": (CRANE.replace("[[1, 0, 0], [0, 0, 1]]", "[[1, 0, 0], [0.6, 0, 0.8]]"), "body.toml:8: .*square to each"),
    "four axes": (CRANE.replace("[[1, 0, 0], [0, 0, 1]]\n", "[[1, 0, 0], [0, 0, 1], [0, 1, 0], [1, 0, 0]]\n").replace("[-10, 60]]", "[-10, 60], [0, 1], [0, 1]]"), "0 to 3 axes, got 4"),
    "a limit too few": (CRANE.replace(", [-10, 60]]", "]"), "limits_degrees: expected 2 x 2"),
    "no limits": (CRANE.replace("limits_degrees = [[-170, 170], [-10, 60]]\n", ""), "'jib': expected either limits"),
    "limits reversed": (CRANE.replace("[-10, 60]", "[60, -10]"), "body.toml:8: .*expected limits"),
    "an agility of nothing": (CRANE.replace("limits_degrees", "agility = 0\nlimits_degrees"), "agility above 0"),
    "an agility of words": (CRANE.replace("limits_degrees", "agility = 'much'\nlimits_degrees"), "body.toml:15: part 'jib': agility: expected a finite number, got 'much'"),
    "two agilities": (CRANE.replace("limits_degrees", "agility = [1, 2]\nlimits_degrees"), "body.toml:15: .*a finite number, got"),
    "a negative stiffness": (CRANE.replace("limits_degrees", "stiffness = -1\nlimits_degrees"), "stiffness of 0 or more"),
    "an angle at ease too few": (CRANE.replace("limits_degrees", "neutral = [1]\nlimits_degrees"), "body.toml:15: part 'jib': neutral: expected 2 finite"),
    "ease where nothing turns": (CRANE + "[[part]]\nname = 'x'\nparent = 'hook'\nneutral = [1]\nspheres = [[0, 0, 0]]", "part 'x': neutral: expected 0 finite"),
    "no number": (CRANE.replace("offset = [0, 1, 0]", "offset = [0, nan, 0]"), "body.toml:12: .*offset: expected 3 finite"),
    "a huge number": (CRANE.replace("offset = [0, 1, 0]", "offset = [0, 1e999, 0]"), "offset: expected 3 finite"),
    "a tip of nothing": (CRANE.replace('part = "hook"', 'part = "crook"'), "body.toml:26: tip 'load': part: there is no"),
    "a tip without a place": (CRANE.replace("offset = [0, 0.3, 0]", ""), "tip 'load': offset: expected 3"),
    "latin letters": ("stature = 1.7 # gr\xf6\xdfe".encode("latin-1"), "expected text in UTF-8"),
    "brackets without end": ("a = " + "[" * 50_000, "expected TOML"),
    "a film": (b"a" * 1_000_001, "file of over 1 MB"),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_file_is_refused_with_its_place(tmp_path, case):
    text, message = WRONG[case]
    with pytest.raises(BodyModelError, match=message) as caught:
        read_body(write(tmp_path, text))
    assert "\n" not in str(caught.value) and str(caught.value).startswith(str(tmp_path))


def test_a_missing_or_empty_file_is_said(tmp_path):
    with pytest.raises(MotionFileError, match="no such file"):
        read_body(tmp_path / "none.toml")
    with pytest.raises(MotionFileError, match="empty"):
        read_body(write(tmp_path, ""))


def test_a_folder_that_is_not_there_cannot_be_written_to(tmp_path):
    with pytest.raises(MotionWriteError, match="folder"):
        write_body(make_human(), tmp_path / "none" / "body.toml")
