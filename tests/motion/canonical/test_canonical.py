"""The canonical mapping as a whole: derived joints, sides, gaps, errors."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.bodies import walking_body
from oracles.name_lists import NAME_LISTS

from dousa.errors import JointMappingError
from dousa.formats.registry import read_motion
from dousa.motion import CANONICAL_JOINTS, JOINT_INDEX, Trajectories, canonicalise
from dousa.motion.canonical.geometry import hips_from_markers


def _canonical_points(n_frames: int = 20) -> np.ndarray:
    return canonicalise(walking_body(n_frames)).positions


def _joint(positions: np.ndarray, name: str) -> np.ndarray:
    return positions[:, JOINT_INDEX[name]]


def _coco() -> Trajectories:
    points = _canonical_points()
    names = NAME_LISTS["COCO"][1].split(",")
    columns = [_joint(points, n if n in JOINT_INDEX else "head") for n in names]
    return Trajectories(tuple(names), np.stack(columns, axis=1), 30.0)


def test_positions_are_the_named_points() -> None:
    body = walking_body()
    canonical = canonicalise(body)
    np.testing.assert_array_equal(_joint(canonical.positions, "left_knee"), body.select(["LeftLeg"])[:, 0])
    np.testing.assert_array_equal(_joint(canonical.positions, "head"), body.select(["Head_end"])[:, 0])
    assert canonical.mapping.sources["right_wrist"] == ("RightHand",)
    assert canonical.mapping.derived == ()
    assert canonical.mapping.sides == "agree"
    assert canonical.warnings == ()
    assert (canonical.height, canonical.height_source) == (pytest.approx(1.68), "rest pose")
    assert canonical.duration == pytest.approx(20 / 30)
    assert canonical.to_trajectories().names == CANONICAL_JOINTS
    assert not canonical.positions.flags.writeable
    one = canonicalise(walking_body(1))
    assert (one.n_frames, one.mapping.sides) == (1, "agree")


def test_canonical_is_its_own_canonical_form() -> None:
    first = canonicalise(walking_body())
    again = canonicalise(first.to_trajectories())
    np.testing.assert_array_equal(again.positions, first.positions)
    assert again.mapping.table == "dousa"


@settings(max_examples=25)
@given(st.randoms(use_true_random=False), st.floats(-np.pi, np.pi), st.floats(0.5, 2.0))
def test_order_yaw_and_scale(random, yaw: float, scale: float) -> None:
    body = walking_body()
    order = list(range(len(body.names)))
    random.shuffle(order)
    turn = np.array([[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]])
    moved = Trajectories(
        tuple(body.names[i] for i in order), scale * body.positions[:, order] @ turn.T, body.frame_rate
    )
    plain = canonicalise(Trajectories(body.names, body.positions, body.frame_rate))
    canonical = canonicalise(moved)
    np.testing.assert_allclose(canonical.positions, scale * plain.positions @ turn.T, atol=1e-9)
    assert canonical.height == pytest.approx(scale * plain.height)
    assert canonical.mapping.sides == "agree"


def test_mirrored_coordinates_are_mirrored_back_and_said() -> None:
    body = walking_body()
    mirrored = body.replace(positions=body.positions * [1.0, 1.0, -1.0])
    canonical = canonicalise(mirrored)
    assert canonical.mapping.sides == "disagree"
    assert canonical.warnings[0].code == "canonical.mirrored"
    assert canonical.mapping.sources["left_knee"] == ("LeftLeg",)
    np.testing.assert_array_equal(canonical.positions, canonicalise(body).positions)


def test_derived_joints_are_made_and_reported() -> None:
    canonical = canonicalise(_coco())
    points = canonical.positions
    assert set(canonical.mapping.derived) == {
        *("pelvis", "spine", "neck", "left_hand", "right_hand", "left_toe", "right_toe")
    }
    hips = 0.5 * (_joint(points, "left_hip") + _joint(points, "right_hip"))
    np.testing.assert_allclose(_joint(points, "pelvis"), hips)
    wrist, elbow = _joint(points, "left_wrist"), _joint(points, "left_elbow")
    np.testing.assert_allclose(_joint(points, "left_hand"), wrist + 0.4 * (wrist - elbow))
    ahead = _joint(points, "left_toe") - _joint(points, "left_ankle")
    assert (ahead[:, 2] > 0.0).all()
    np.testing.assert_allclose(np.linalg.norm(ahead, axis=1), 0.35 * np.hypot(0.41, 0.01), rtol=1e-3)
    assert canonical.warnings[-1].code == "canonical.made_toes"
    assert np.isfinite(points).all()


def test_end_sites_of_no_length_are_no_hands(shared_data) -> None:
    canonical = canonicalise(read_motion(sorted(shared_data("bandai/walk/youthful").iterdir())[0]))
    assert canonical.mapping.derived == ("left_hand", "right_hand")
    assert "left_hand" not in canonical.mapping.sources
    assert canonical.height_source == "bone chain"
    assert 1.2 < canonical.height < 1.45


def test_plug_in_gait_hips_come_from_the_pelvis() -> None:
    names = tuple(NAME_LISTS["Plug-in-Gait with subject"][1].split(","))
    points = _canonical_points()
    pelvis = _joint(points, "pelvis")
    places = {"LASI": [0.125, 0, 0.1], "RASI": [-0.125, 0, 0.1], "LPSI": [0.04, 0, -0.05], "RPSI": [-0.04, 0, -0.05]}
    parts = dict(SHO="shoulder", ELB="elbow", WRA="wrist", WRB="wrist", FIN="hand", KNE="knee", ANK="ankle", TOE="toe")
    columns = []
    for name in names:
        marker = name.removeprefix("Bob:")
        side = "left_" if marker.startswith("L") else "right_"
        if marker in places:
            columns.append(pelvis + places[marker])
        elif marker[1:] in parts:
            columns.append(_joint(points, side + parts[marker[1:]]))
        else:
            columns.append(_joint(points, "head" if marker.endswith("HD") else "neck"))
    canonical = canonicalise(Trajectories(names, np.stack(columns, axis=1), 30.0))
    assert canonical.mapping.table == "Plug-in-Gait"
    assert canonical.mapping.sides == "agree"
    assert {"pelvis", "left_hip", "right_hip"} <= set(canonical.mapping.derived)
    assert canonical.warnings[-1].code == "canonical.skin_markers"
    knees = 0.5 * (_joint(points, "left_knee") + _joint(points, "right_knee"))
    sacrum = pelvis + np.array([0, 0, -0.05])
    hips = hips_from_markers(pelvis + places["LASI"], pelvis + places["RASI"], sacrum, knees, metres=True)
    np.testing.assert_allclose(_joint(canonical.positions, "left_hip"), hips[:, 0])
    np.testing.assert_allclose(_joint(canonical.positions, "pelvis"), hips.mean(axis=1))


@pytest.mark.parametrize("rate", [25.0, 120.0])
def test_a_leap_for_one_frame_is_said(rate: float) -> None:
    body = walking_body()
    body = body.replace(frame_rate=rate)
    quiet = canonicalise(body)
    assert quiet.warnings == ()
    positions = body.positions.copy()
    positions[7, body.names.index("LeftHand")] += (0.0, 0.6, 0.0)
    positions[12] += (0.0, 0.0, 0.9)
    (note,) = [one for one in canonicalise(body.replace(positions=positions)).warnings if one.code == "canonical.leaps"]
    assert (note.values["n"], note.values["frame"], note.values["joints"]) == (2, 7, ("left_wrist",))
    positions = body.positions.copy()
    positions[9:] += (0.0, 0.0, 0.9)  # a cut in the take does not come back
    assert canonicalise(body.replace(positions=positions)).warnings == ()


def test_a_joint_never_seen_is_missing() -> None:
    body = walking_body()
    positions = body.positions.copy()
    positions[:, body.names.index("RightForeArm")] = np.nan
    part = canonicalise(body.replace(positions=positions))
    assert part.absent == ("right_elbow",)
    assert np.isnan(_joint(part.positions, "right_elbow")).all()
    assert part.missing is not None
    assert part.missing.sum() == part.n_frames
    assert "canonical.part" in [note.code for note in part.warnings]
    with pytest.raises(JointMappingError, match="without right_elbow"):
        canonicalise(body.replace(positions=positions), whole=True)
    positions = body.positions.copy()
    positions[:, body.names.index("Spine1")] = np.nan
    assert canonicalise(body.replace(positions=positions)).mapping.sources["spine"] == ("Spine",)


def test_unknown_markers_ask_for_a_joint_map() -> None:
    names = tuple(f"M{i}" for i in range(30))
    with pytest.raises(JointMappingError, match=r"no known family.*--read joint_map") as caught:
        canonicalise(Trajectories(names, np.zeros((2, 30, 3)), 30.0))
    assert caught.value.joints == names


def test_a_point_body_is_refused() -> None:
    body = walking_body()
    with pytest.raises(JointMappingError, match="no height"):
        canonicalise(Trajectories(body.names, np.zeros_like(body.positions), 30.0))


@pytest.mark.parametrize("scale", [1e12, 1e300])
def test_a_body_beyond_any_measure_is_refused(scale: float) -> None:
    body = walking_body()
    with np.errstate(over="ignore"), pytest.raises(JointMappingError, match="impossibly far away"):
        canonicalise(body.replace(positions=body.positions * scale, rest_positions=None))


@pytest.mark.parametrize(("scale", "doubted"), [(0.1, True), (0.5, False), (1.5, False), (10.0, True)])
def test_a_height_that_no_person_has_is_doubted(scale: float, doubted: bool) -> None:
    body = walking_body()
    scaled = body.replace(positions=body.positions * scale, rest_positions=body.rest_positions * scale)
    codes = [warning.code for warning in canonicalise(scaled).warnings]
    assert ("canonical.no_person" in codes) == doubted


def test_positions_that_are_all_missing() -> None:
    body = walking_body()
    with pytest.raises(JointMappingError, match="no frame shows where any joint is"):
        canonicalise(body.replace(positions=np.full_like(body.positions, np.nan)))


def test_gaps_are_filled_and_marked() -> None:
    body = walking_body()
    positions = body.positions.copy()
    knee = body.names.index("LeftLeg")
    positions[5:9, knee, 1] = np.nan
    gappy = canonicalise(Trajectories(body.names, positions, body.frame_rate, body.parents))
    assert np.isfinite(gappy.positions).all()
    between = (4 * body.positions[4, knee] + body.positions[9, knee]) / 5
    np.testing.assert_allclose(_joint(gappy.positions, "left_knee")[5], between)
    expected = np.zeros(gappy.positions.shape[:2], bool)
    expected[5:9, JOINT_INDEX["left_knee"]] = True
    np.testing.assert_array_equal(gappy.missing, expected)
    assert canonicalise(body).missing is None
