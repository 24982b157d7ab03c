"""Every name family of the issue is recognised, and the points it gives are the right ones."""

import functools

import pytest
from hypothesis import given
from hypothesis import strategies as st
from oracles.name_lists import NAME_LISTS

from dousa.motion.canonical.naming import REQUIRED_JOINTS, match_names, normalise_names

# label -> some canonical joints and the names they must come from
EXPECTED = {
    "HDM05 ASF": {
        "head": "head_end", "left_toe": "ltoes", "left_hand": "lfingers", "left_wrist": "lhand", "neck": "upperneck",
    },
    "Bandai": {"pelvis": "Hips", "left_wrist": "Hand_L", "right_knee": "LowerLeg_R", "left_hip": "UpperLeg_L"},
    "CMU by cgspeed": {"left_hip": "LeftUpLeg", "left_shoulder": "LeftArm", "spine": "Spine"},
    "Mixamo": {"head": "mixamorig:HeadTop_End", "right_toe": "mixamorig:RightToeBase"},
    "MotionBuilder": {"left_ankle": "Character1_LeftFoot", "spine": "Character1_Spine1"},
    "Xsens MVN": {"left_shoulder": "LeftUpperArm", "spine": "L3"},
    "SMPL": {"left_toe": "left_foot", "spine": "spine2"},
    "Kinect v1": {"neck": "ShoulderCenter", "right_toe": "FootRight", "pelvis": "HipCenter"},
    "Kinect v2": {"neck": "SpineShoulder", "pelvis": "SpineBase"},
    "Unreal mannequin": {"left_toe": "ball_l", "left_knee": "calf_l"},
    "Biped": {"left_hip": "Bip01 L Thigh", "right_wrist": "Bip01 R Hand"},
    "Poser": {"pelvis": "hip", "left_shoulder": "lShldr"},
    "Rigify": {"left_elbow": "forearm.L", "pelvis": "spine"},
    "Human3.6M": {"left_ankle": "LFoot", "pelvis": "Hip"},
    "Motive": {"left_shoulder": "LUArm", "right_elbow": "RFArm", "spine": "Chest"},
    "iPi": {"left_shoulder": "LShoulder", "left_elbow": "LForearm", "pelvis": "Hip"},
    "DeepMotion": {"left_hip": "l_upleg_JNT", "right_wrist": "r_hand_JNT"},
    "Trinity gestures": {"left_wrist": "b_l_wrist", "left_shoulder": "b_l_arm"},
    "MakeHuman": {"left_hip": "upperleg01.L", "left_wrist": "wrist.L"},
    "Daz friendly joints": {"left_wrist": "lhand", "left_ankle": "lfoot", "left_hip": "lhip"},
    "VRM": {"left_shoulder": "J_Bip_L_UpperArm", "pelvis": "J_Bip_C_Hips"},
}  # fmt: skip


@pytest.mark.parametrize("label", NAME_LISTS)
def test_family_is_recognised(label: str) -> None:
    table, text = NAME_LISTS[label]
    names = tuple(text.split(","))
    match = match_names(names)
    assert match is not None
    assert (match.table, match.missing) == (table, ())
    for joint, name in EXPECTED.get(label, {}).items():
        assert [names[i] for i in match.sources[joint]] == [name]


@pytest.mark.parametrize("label", NAME_LISTS)
def test_right_mirrors_left(label: str) -> None:
    names = tuple(NAME_LISTS[label][1].split(","))
    keys = normalise_names(names)
    match = match_names(names)
    assert match is not None
    for joint in REQUIRED_JOINTS:
        if joint in match.sources:
            sides = {keys[i][0] for i in match.sources[joint]}
            assert sides == {joint[0]}


@given(st.sampled_from(sorted(NAME_LISTS)), st.randoms(use_true_random=False))
def test_order_of_the_names_does_not_matter(label: str, random) -> None:
    names = NAME_LISTS[label][1].split(",")
    shuffled = names[:]
    random.shuffle(shuffled)
    first, second = match_names(tuple(names)), match_names(tuple(shuffled))
    assert first is not None and second is not None
    assert first.table == second.table
    for joint, indices in first.sources.items():
        assert {names[i] for i in indices} == {shuffled[i] for i in second.sources[joint]}


@pytest.mark.parametrize(
    ("names", "keys"),
    [
        (("LeftUpLeg", "Bob:RightUpLeg"), (("l", "upleg"), ("r", "upleg"))),
        (("lfemur", "rfemur", "root"), (("l", "femur"), ("r", "femur"), ("", "root"))),
        (("L5", "T12", "Spine1", "spine_01"), (("", "l5"), ("", "t12"), ("", "spine1"), ("", "spine1"))),
        (
            ("hand_l", "Hand.R", "R.Toe", "shoulderLeft"),
            (("l", "hand"), ("r", "hand"), ("r", "toe"), ("l", "shoulder")),
        ),
        (("lowerback", "root", "radius"), (("", "lowerback"), ("", "root"), ("", "radius"))),
    ],
)
def test_normalise(names: tuple[str, ...], keys: tuple[tuple[str, str], ...]) -> None:
    assert normalise_names(names) == keys


def test_missing_arm_is_named() -> None:
    names = tuple(n for n in NAME_LISTS["Bandai"][1].split(",") if not n.endswith("_L") or "Leg" in n or "Foot" in n)
    match = match_names(names)
    assert match is not None
    assert match.missing == ("left_shoulder", "left_elbow", "left_wrist")


@given(st.lists(st.text(max_size=12), max_size=40))
def test_any_names_are_survived(names: list[str]) -> None:
    match_names(tuple(names))
    assert len(normalise_names(names)) == len(names)


def test_unknown_names() -> None:
    assert match_names(tuple(f"j{i}" for i in range(30))) is None


AFFIXES = {
    "_JNT": "{}_JNT", "_bind": "{}_bind", "glued behind": "{}jnt", "Bip01_": "Bip01_{}", "namespaces": "Char:rig:{}",
    "path": "|grp|{}", "many words": "rp_nathan_animated_003_walking_{}", "both ends": "Skeleton1_{}_01",
    "glued before": "xbot{}", "capital": "Hero{}", "count": "{n:02d}_{}", "a rig's helpers": "DEF-{}",
}  # fmt: skip


match_plainly = functools.cache(match_names)


@pytest.mark.parametrize("affix", AFFIXES)
def test_what_all_names_share_says_nothing(affix: str) -> None:
    """End sites have it in the middle, as readers name them: ``Head_JNT_end``; and a rig has bones without it."""
    for label, (_, text) in NAME_LISTS.items():
        names = text.split(",")
        spelled = [AFFIXES[affix].format(name, n=number) for number, name in enumerate(names)]
        for number, name in enumerate(names):
            if name.removesuffix("_end") in names and name.endswith("_end"):
                spelled[number] = spelled[names.index(name.removesuffix("_end"))] + ("_end", "_End")[number % 2]
        helpers = [f"MCH-x{number}" for number in range(40)] if affix == "a rig's helpers" else []
        plain, found = match_plainly(tuple(names)), match_names((*spelled, *helpers))
        assert plain is not None and found is not None
        assert (found.table, found.sources, found.skin) == (plain.table, plain.sources, plain.skin), label
