"""Which map is taken: one that gives a person, a part of a body by names of markers, never an animal in silence."""

import numpy as np
import pytest
from oracles.bodies import walking_body

from dousa.errors import JointMappingError
from dousa.formats.registry import read_motion
from dousa.motion import CANONICAL_JOINTS, Trajectories, canonicalise
from dousa.motion.canonical.anthropometry import find_medians, measure_proportions, stature_of_parts
from dousa.motion.canonical.naming import match_names
from dousa.motion.canonical.recipes import JOINT_INDEX

LEGS = ("hip", "knee", "ankle")
ARMS = ("shoulder", "elbow", "wrist")


def _joints(joints: tuple[str, ...], sides: tuple[str, ...] = ("left", "right")) -> set[str]:
    return {f"{side}_{joint}" for side in sides for joint in joints}


def _of(points: np.ndarray, name: str) -> np.ndarray:
    return points[:, JOINT_INDEX[name]]


@pytest.mark.parametrize(
    ("names", "missing"),
    [
        # OpenCap and AddBiomechanics; Vicon with medial markers; Rizzoli and CAST as Qualisys exports them
        ("r.ASIS L.ASIS r.PSIS L.PSIS r_knee L_knee r_ankle L_ankle R_Shoulder L_Shoulder R_elbow_lat R_elbow_med "
         "L_elbow_lat L_elbow_med R_wrist_radius R_wrist_ulna L_wrist_radius L_wrist_ulna", set()),
        ("RASI LASI RPSI LPSI RFLE RFME RFAL RTAM LFLE LFME LFAL LTAM RSHO LSHO RELL RELM LELL LELM RWRL RWRM LWRL "
         "LWRM", set()),
        ("L_IAS L_IPS R_IPS R_IAS L_FLE L_FME L_FAL L_TAM R_FLE R_FME R_FAL R_TAM L_SAJ R_SAJ L_HLE L_HME R_HLE R_HME "
         "L_RSP L_USP R_RSP R_USP", set()),
        # Human Body Model; Helen Hayes of Cortex; OptiTrack; Xsens points; joint centres; augmented OpenCap
        ("LASIS RASIS LPSIS RPSIS LLEK RLEK LLM RLM LSHO RSHO LLEE RLEE LMEE RMEE LLW RLW LMW RMW", set()),
        ("R.ASIS L.ASIS V.Sacral R.Knee.Lat R.Knee.Med L.Knee.Lat L.Knee.Med R.Ankle.Lat R.Ankle.Med L.Ankle.Lat "
         "L.Ankle.Med R.Acromium L.Acromium R.Elbow L.Elbow R.Wrist.Med R.Wrist.Lat L.Wrist.Med L.Wrist.Lat", set()),
        ("WaistLFront WaistRFront WaistLBack WaistRBack LKneeOut RKneeOut LAnkleOut RAnkleOut LShoulderTop "
         "RShoulderTop LElbowOut RElbowOut LWristOut LWristIn RWristOut RWristIn", set()),
        ("pRightASI pLeftASI pRightCSI pLeftCSI pSacrum pRightAcromion pLeftAcromion pRightArmLatEpicondyle "
         "pLeftArmLatEpicondyle pRightRadialStyloid pLeftRadialStyloid pRightKneeLatEpicondyle "
         "pLeftKneeLatEpicondyle pRightLatMalleolus pLeftLatMalleolus", set()),
        ("RHJC LHJC RKJC LKJC RAJC LAJC RSJC LSJC REJC LEJC RWJC LWJC", set()),
        ("r_shoulder_study L_shoulder_study r_lelbow_study L_lelbow_study r_lwrist_study L_lwrist_study r.ASIS_study "
         "L.ASIS_study r.PSIS_study L.PSIS_study r_knee_study L_knee_study r_mknee_study L_mknee_study r_ankle_study "
         "L_ankle_study RHJC_study LHJC_study", set()),
        # legs only, an arm only, legs with trochanters only
        ("LASI RASI SACR LKNE RKNE LANK RANK LTOE RTOE", _joints(ARMS)),
        ("r_acromion r_humerus_epicondyle r_radius_styloid", _joints(LEGS) | _joints(ARMS, ("left",))),
        ("LGT RGT LKNE RKNE LANK RANK", _joints(ARMS)),
        # one side only: the first letter is the side, though lkne could be a lateral knee
        ("LSHO LUPA LELB LFRM LWRA LWRB LFIN", _joints(LEGS) | _joints(ARMS, ("right",))),
        ("LASI RASI LPSI RPSI LTHI LKNE LTIB LANK LHEE LTOE", _joints(ARMS) | _joints(("knee", "ankle"), ("right",))),
        ("lule rule luar ruar llar rlar lhan rhan pelv neck head", _joints(("knee", "ankle"))),
        ("luar ruar llar rlar lhan rhan neck head", _joints(LEGS)),
    ],
)  # fmt: skip
def test_marker_sets(names: str, missing: set[str]) -> None:
    match = match_names(tuple(names.split()))
    assert match is not None
    assert set(match.missing) == missing


def test_a_joint_is_the_middle_of_its_markers() -> None:
    names = ("LFLE", "LFME", "RFLE", "RFME")
    match = match_names(names)
    assert match is not None
    assert match.sources["left_knee"] == (0, 1)


def _dog() -> Trajectories:
    """A body whose arms are as long as its legs and whose trunk is long: a four-legged rig with names of people."""
    body = walking_body()
    places = {name: index for index, name in enumerate(body.names)}
    positions = body.positions.copy()
    trunk = positions[:, places["Neck"]] - positions[:, places["Hips"]]
    for name, index in places.items():
        if name not in ("Hips", "Spine") and not any(part in name for part in ("UpLeg", "Leg", "Foot", "Toe")):
            positions[:, index] += 1.6 * trunk
    for side in ("Left", "Right"):
        shoulder = positions[:, places[f"{side}Arm"]].copy()
        for part in ("ForeArm", "Hand", "HandMiddle1"):
            index = places[f"{side}{part}"]
            positions[:, index] = shoulder + 1.9 * (positions[:, index] - shoulder)
    return Trajectories(body.names, positions, body.frame_rate)


def test_an_animal_is_no_person() -> None:
    dog = _dog()
    with pytest.raises(JointMappingError, match="not a human skeleton"):
        canonicalise(dog)
    taken = canonicalise(dog, any_skeleton=True)
    assert "canonical.not_a_person" in [note.code for note in taken.warnings]
    assert canonicalise(walking_body()).warnings == ()


def test_who_stands_upright_is_a_person_however_the_skeleton_was_made() -> None:
    """All bones of one length, as tools for the points of cameras write them; lying down it could be anything."""
    body = walking_body()
    local = body.positions - body.positions[:, np.maximum(body.parents, 0)]
    size = np.linalg.norm(local, axis=2, keepdims=True)
    places = np.empty_like(local)
    for joint, parent in enumerate(body.parents):
        unit = np.divide(local[:, joint], size[:, joint], where=size[:, joint] > 0, out=np.zeros_like(local[:, joint]))
        places[:, joint] = body.positions[:, joint] if parent < 0 else places[:, parent] + 0.25 * unit
    made = Trajectories(body.names, places, 30.0, body.parents)
    found = canonicalise(made)
    assert [note.code for note in found.warnings] == ["canonical.odd_proportions"]
    assert found.mapping.sources["left_knee"] == ("LeftLeg",)


def _on_fours(tail: bool, arm_per_leg: float) -> Trajectories:
    """A dog that stands: the trunk level, fore legs straight down to the floor like the hind legs."""
    leg = np.array([[0.0, 0.5, 0.0], [0.0, 0.25, 0.03], [0.0, 0.05, 0.0], [0.0, 0.0, 0.06]])
    arm = np.array([1.0, arm_per_leg, 1.0]) * leg[:3] + [0.0, 0.5 - 0.5 * arm_per_leg, 0.55]
    rows = [("Hips", [0, 0.52, 0]), ("Spine", [0, 0.55, 0.2]), ("Spine1", [0, 0.55, 0.4]), ("Neck", [0, 0.55, 0.55]),
            ("Head", [0, 0.75, 0.7])]  # fmt: skip
    for side, x in (("Left", 0.06), ("Right", -0.06)):
        rows += [(side + part, [x, y, z]) for part, (_, y, z) in zip(("UpLeg", "Leg", "Foot", "Toe"), leg, strict=True)]
        rows += [(side + part, [x, y, z]) for part, (_, y, z) in zip(("Arm", "ForeArm", "Hand"), arm, strict=True)]
    if tail:
        rows.append(("Tail", [0, 0.5, -0.2]))
    points = np.array([row[1] for row in rows])
    walk = np.stack([points + np.array([0, 0.01 * np.sin(t), 0.02 * t]) for t in range(30)])
    return Trajectories(tuple(row[0] for row in rows), walk, 30.0)


@pytest.mark.parametrize(("tail", "arm_per_leg"), [(False, 1.0), (False, 0.85), (True, 0.7)])
def test_who_stands_on_four_legs_is_no_person(tail: bool, arm_per_leg: float) -> None:
    dog = _on_fours(tail, arm_per_leg)
    with pytest.raises(JointMappingError, match="not a human skeleton"):
        canonicalise(dog)
    assert canonicalise(dog, any_skeleton=True).absent == ()


def test_a_person_on_hands_and_knees_is_a_person() -> None:
    """Trunk level, arms and thighs down, shanks on the floor; arms of a person are shorter than the legs."""
    dog = _on_fours(False, 0.62)
    crawling = dog.positions.copy()
    for side in ("Left", "Right"):
        for part, z in (("Foot", -0.2), ("Toe", -0.3)):
            crawling[:, dog.names.index(side + part), 1:] += [0.2, z]
    assert canonicalise(dog.replace(positions=crawling)).absent == ()


def test_all_recorded_people_are_people(shared_data) -> None:
    files = [path for folder in ("hdm05", "cmu86") for path in sorted(shared_data(folder).rglob("*.amc"))[::12]]
    assert len(files) > 10
    for path in files:
        canonicalise(read_motion(path))


@pytest.mark.parametrize("numbered", [False, True])
def test_names_of_pose_estimators_are_a_person_even_on_a_made_up_skeleton(numbered: bool) -> None:
    names = ("nose left_eye right_eye left_ear right_ear left_shoulder right_shoulder left_elbow right_elbow "
             "left_wrist right_wrist left_index right_index left_hip right_hip left_knee right_knee left_ankle "
             "right_ankle left_heel right_heel left_foot_index right_foot_index").split()  # fmt: skip
    if numbered:
        names = [f"{name}_{number}" for number, name in enumerate(names)]
    chain = np.cumsum(np.full((len(names), 3), 0.1) * [1, 0.5, 0.2], axis=0)
    found = canonicalise(Trajectories(tuple(names), np.stack([chain, chain + 0.01]), 30.0))
    assert found.mapping.table == "MediaPipe"
    assert found.mapping.sources["left_toe"] == (names[-2],)
    assert "canonical.odd_proportions" in [note.code for note in found.warnings]


def test_names_that_give_no_person_are_passed_over() -> None:
    """Hips that coincide, by the names of one family; another point of the file is the hip."""
    body = walking_body()
    names = {"LeftUpLeg": "LeftHip", "LeftLeg": "LeftKnee", "LeftFoot": "LeftAnkle", "LeftArm": "LeftShoulder",
             "LeftShoulder": "LeftCollar", "LeftForeArm": "LeftElbow", "LeftHand": "LeftWrist"}  # fmt: skip
    both = names | {k.replace("Left", "Right"): v.replace("Left", "Right") for k, v in names.items()}
    renamed = tuple(both.get(name, name) for name in body.names)
    positions = body.positions.copy()
    for side in ("Left", "Right"):
        positions[:, renamed.index(f"{side}Hip")] = positions[:, 0]
    chosen = canonicalise(Trajectories(renamed, body.positions, 30.0, body.parents))
    assert chosen.mapping.table != "tree shape"
    with pytest.raises(JointMappingError, match="not a human skeleton"):
        canonicalise(Trajectories(renamed, positions, 30.0))


def test_the_stature_of_a_part_is_near_that_of_the_whole() -> None:
    points = canonicalise(walking_body()).positions
    whole = canonicalise(walking_body()).stature
    for gone in (ARMS, LEGS):
        part = points.copy()
        part[:, [JOINT_INDEX[joint] for joint in _joints(gone)]] = np.nan
        assert stature_of_parts(part) == pytest.approx(whole, rel=0.12)
    assert np.isnan(stature_of_parts(np.full_like(points, np.nan)))


def test_proportions_do_not_depend_on_unit_or_side() -> None:
    points = canonicalise(walking_body()).positions
    first, second = measure_proportions(points), measure_proportions(-100.0 * points)
    assert first.is_person
    assert first.ratios == pytest.approx(second.ratios)
    assert first.left_per_right == pytest.approx(1.0, abs=0.02)
    mirrored = points[:, [CANONICAL_JOINTS.index(_other(joint)) for joint in CANONICAL_JOINTS]]
    assert measure_proportions(mirrored).ratios == pytest.approx(first.ratios)


def _other(joint: str) -> str:
    return joint.replace("left_", "R_").replace("right_", "left_").replace("R_", "right_")


@pytest.mark.parametrize(
    ("name", "absent"),
    [
        ("addbiomechanics/DJ1.trc", set()),
        ("addbiomechanics/example2__markers.trc", set()),
        ("addbiomechanics/levelground_ccw_fast_01_01.trc", _joints(ARMS)),
        ("addbiomechanics/markers.trc", _joints(("elbow", "wrist"))),
        ("opensim/static_run.trc", set()),
        ("opensim/arm26_elbow_flex.trc", _joints(LEGS) | _joints(ARMS, ("left",))),
        ("c3d_org/ART-Human_hands_real_no6dof.c3d", set()),
        ("c3d_org/AlbertoREAL.c3d", set()),
        ("c3d_org/analogfpscale04.c3d", _joints(ARMS)),
        ("c3d_org/gait-pig.c3d", _joints(ARMS)),
        ("ezc3d_testfiles/Qualisys.c3d", set()),
    ],
)
def test_foreign_marker_sets(foreign, name: str, absent: set[str]) -> None:
    found = canonicalise(read_motion(foreign(name)))
    required = _joints(LEGS) | _joints(ARMS)
    assert set(found.absent) & required == absent
    assert 1.2 < found.stature < 2.2
    if not absent:
        head, feet = _of(found.positions, "neck"), _of(found.positions, "left_ankle")
        assert np.median(head[:, 1] - feet[:, 1]) > 0.6  # upright


@pytest.mark.parametrize("name", ["animateddrawings/jumping_jacks.bvh"])
def test_hips_that_coincide_are_not_taken(foreign, name: str) -> None:
    found = canonicalise(read_motion(foreign(name)))
    width = np.linalg.norm(_of(found.positions, "left_hip") - _of(found.positions, "right_hip"), axis=1)
    assert 0.08 < width.mean() < 0.3


def test_medians_of_what_is_seen_are_those_of_numpy():
    draw = np.random.default_rng(0)
    for n_rows in (1, 2, 3, 8, 51):
        values = draw.normal(size=(n_rows, 30))
        values[draw.random(values.shape) < 0.4] = np.nan
        values[:, 0] = np.nan
        values[0, 1:] = 1.0
        expected = np.concatenate([[np.nan], np.nanmedian(values[:, 1:], axis=0)])
        np.testing.assert_array_equal(find_medians(values), expected)
    assert np.isnan(find_medians(np.empty((0, 3)))).all()


@pytest.mark.parametrize(
    ("name", "segments"),
    [
        ("EB015PI", {"RFT", "LFT", "RSK", "LSK", "RTH", "LTH", "PV"}),
        ("dec_real", {"RFT", "LFT", "RSK", "LSK", "RTH", "LTH", "RPV", "RTA", "RAR", "RFA", "LAR", "LFA"}),
        ("Walking_Hybrid_1_1", {"R_THIGH", "L_THIGH", "R_SHANK", "L_SHANK"}),
    ],
)
def test_clusters_on_segments_are_called_so(foreign, name: str, segments: set[str]) -> None:
    with pytest.raises(JointMappingError) as caught:
        canonicalise(read_motion(foreign(f"c3d_org/{name}.c3d")))
    assert caught.value.problem.code == "canonical.clusters"
    assert set(caught.value.problem.values["names"]) == segments


@pytest.mark.parametrize("name", ["Dance", "MotionMonitorC3D", "golf"])
def test_numbered_points_are_no_clusters(foreign, name: str) -> None:
    with pytest.raises(JointMappingError) as caught:
        canonicalise(read_motion(foreign(f"c3d_org/{name}.c3d")))
    assert caught.value.problem.code == "canonical.unknown_names"
