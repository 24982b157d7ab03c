"""Units and up axes: inferred, declared, given, and taken back."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from oracles.bodies import walking_body
from oracles.marker_bodies import MARKER_SETS, wear

from dousa.errors import OptionError
from dousa.formats.registry import read_motion
from dousa.motion import CANONICAL_JOINTS, Motion, Trajectories, canonicalise, compute_trajectories, thin
from dousa.motion.canonical.reference_frame import (
    CMU_UNIT,
    ReferenceFrame,
    change_arrays,
    from_reference_frame,
    infer_reference_frame,
    parse_unit,
    parse_up,
)
from dousa.motion.canonical.upright import find_fall

AXES = ["x", "y", "z", "-x", "-y", "-z"]


def _in_file(moving: Trajectories | Motion, unit: float, up: str) -> Trajectories:
    """The motion as a file of that unit and axis would hold it."""
    turned = from_reference_frame(moving, ReferenceFrame(unit=unit, up=up))
    return turned if isinstance(turned, Trajectories) else compute_trajectories(turned)


def _sample(moving: Trajectories) -> Trajectories:
    return moving.replace(positions=thin(moving.positions, 10))


@pytest.mark.parametrize("unit", [1.0, 0.01, 0.001, CMU_UNIT, 0.0254, 0.3048])
@pytest.mark.parametrize("names_known", [True, False])
def test_usual_units_are_inferred(unit: float, names_known: bool) -> None:
    body = _in_file(walking_body(), unit, "y")
    if not names_known:
        body = body.replace(names=tuple(f"j{i}" for i in range(len(body.names))))
    frame = infer_reference_frame(body)
    assert (frame.unit, frame.unit_source, frame.up) == (pytest.approx(unit), "inferred", "y")


def test_a_body_of_no_usual_unit_is_made_of_usual_height() -> None:
    frame = infer_reference_frame(_in_file(walking_body(), 1e-5, "y"))
    assert frame.unit_source == "assumed"
    assert frame.unit == pytest.approx(1e-5, rel=0.1)


def test_declared_units_are_used_unless_absurd() -> None:
    body = _in_file(walking_body(), 0.01, "y")
    frame = infer_reference_frame(body, declared_unit=0.0075)
    assert (frame.unit, frame.unit_source) == (0.0075, "declared")
    frame = infer_reference_frame(body, declared_unit=0.001)
    assert (frame.unit, frame.unit_source) == (0.01, "inferred")
    frame = infer_reference_frame(body, unit=0.001, declared_unit=0.01, up="+Z")
    assert frame == ReferenceFrame(0.001, "given", "z", "given")


@pytest.mark.parametrize("up", AXES)
@pytest.mark.parametrize("default_up", ["y", "z", None])
def test_up_is_where_the_body_stands(up: str, default_up: str | None) -> None:
    body = _in_file(walking_body(), 0.01, up)
    body = body.replace(rest_positions=None, parents=None)
    frame = infer_reference_frame(body, default_up=default_up)
    assert frame.up == up
    assert frame.up_source == ("assumed" if up == default_up else "inferred")


def test_unknown_points_keep_the_habit() -> None:
    cloud = Trajectories(("a", "b"), [[[0, 0, 0], [0.1, 0.2, 1.5]]], 30.0)
    assert infer_reference_frame(cloud).up == "y"
    guessed = infer_reference_frame(cloud, default_up=None)
    assert (guessed.up, guessed.up_source) == ("z", "guessed")
    assert [note.code for note in guessed.notes] == ["units.guessed_up"]
    nothing = Trajectories(("a", "b"), np.full((1, 2, 3), np.nan), 30.0)
    assert infer_reference_frame(nothing) == ReferenceFrame(1.0, "assumed", "y", "assumed")


@pytest.mark.parametrize("axis", [0, 2])
def test_a_person_who_lies_does_not_turn_the_world(axis: int) -> None:
    # The whole clip lies 3 m from the origin on a floor at y = 0; the rest pose stands along y.
    body = walking_body()
    turned = _in_file(body, 1.0, "xyz"[axis]).positions.copy()
    turned[..., axis] += 3.0
    turned[..., 1] += 0.15 - turned[..., 1].mean()
    lying = body.replace(positions=turned)
    assert infer_reference_frame(lying).up == "y"


@pytest.mark.parametrize("axis", [0, 2])
def test_lying_with_a_rest_pose_that_does_not_stand(axis: int) -> None:
    # As in LAFAN1: all bones of the rest pose point along x.
    body = walking_body()
    assert body.parents is not None
    rest = np.zeros((len(body.names), 3))
    for joint, parent in enumerate(body.parents):
        if parent >= 0:
            length = np.linalg.norm(body.positions[0, joint] - body.positions[0, parent])
            rest[joint] = rest[parent] + (length, 0, 0)
    body = body.replace(rest_positions=rest)
    turned = _in_file(body, 1.0, "xyz"[axis]).positions.copy()
    assert infer_reference_frame(body.replace(positions=turned)).up == "xyz"[axis]  # on a floor at 0: stands
    turned[..., axis] += 3.0  # no floor there, but below the body
    turned[..., 1] = 0.05 + 0.2 * (turned[..., 1] - turned[..., 1].min())
    assert infer_reference_frame(body.replace(positions=turned)).up == "y"


@pytest.mark.parametrize("default_up", ["y", None])
@pytest.mark.parametrize("axis", [0, 2])
def test_markers_of_a_person_who_lies(axis: int, default_up: str | None) -> None:
    body = walking_body().replace(rest_positions=None, parents=None)
    turned = _in_file(body, 1.0, "xyz"[axis]).positions.copy()
    turned[..., axis] += 3.0
    turned[..., 1] = 0.1 + 0.2 * (turned[..., 1] - turned[..., 1].min())
    assert infer_reference_frame(body.replace(positions=turned), default_up=default_up).up == "y"


@pytest.mark.parametrize("default_up", ["y", None])
@pytest.mark.parametrize("up", ["y", "-y", "z"])
def test_markers_around_the_pelvis_or_before_a_camera(up: str, default_up: str | None) -> None:
    body = _in_file(walking_body(), 0.01, up).replace(rest_positions=None, parents=None)
    pelvis = body.positions[:, [body.names.index("Hips")]]
    centred = body.replace(positions=body.positions - pelvis)
    assert infer_reference_frame(centred, default_up=default_up).up == up
    if up != "z":  # at the height of the camera, 3 m before it
        seen = centred.replace(positions=centred.positions + np.array([0, 0, 300]))
        assert infer_reference_frame(seen, default_up=default_up).up == up


@pytest.mark.parametrize("folder", ["hdm05", "bandai", "utd_mhad/skeleton"])
def test_recordings(folder: str, shared_data) -> None:
    files = sorted(p for p in shared_data(folder).rglob("*") if p.suffix.lower() in (".amc", ".bvh", ".c3d"))
    for file in files[:: max(1, len(files) // 25)]:
        motion = read_motion(file)
        moving = motion if isinstance(motion, Trajectories) else compute_trajectories(motion)
        default_up = None if isinstance(motion, Trajectories) else "y"
        for unit in (0.01, CMU_UNIT):
            frame = infer_reference_frame(_sample(_in_file(moving, unit, "y")), default_up=default_up)
            assert (frame.unit, frame.up) == (pytest.approx(unit), "y"), file
        if "lieDown" in file.name or "deposit" in file.name:
            continue
        assert infer_reference_frame(_sample(_in_file(motion, 0.01, "z")), default_up=default_up).up == "z", file


def test_an_absurd_declared_unit_is_said() -> None:
    body = _in_file(walking_body(), 0.01, "y")
    frame = infer_reference_frame(body, declared_unit=238.0)
    assert (frame.unit, [note.code for note in frame.notes]) == (0.01, ["units.other_unit"])
    assert frame.notes[0].values["stature"] > 10_000


def test_a_declared_axis_along_which_nobody_stands_is_not_believed() -> None:
    body = _in_file(walking_body(), 0.01, "z").replace(rest_positions=None, parents=None)
    frame = infer_reference_frame(body, declared_up="-z", default_up=None)
    assert (frame.up, frame.up_source, [note.code for note in frame.notes]) == ("z", "inferred", ["units.other_up"])
    frame = infer_reference_frame(body, declared_up="z", default_up=None)
    assert (frame.up, frame.up_source, frame.notes) == ("z", "declared", ())


def test_bodies_fall_against_the_up_axis() -> None:
    """A body in the air for 0.4 s, tumbling so that its posture tells nothing."""
    times = np.arange(60) / 60.0
    rng = np.random.default_rng(1)
    body = rng.normal(size=(1, 20, 3))
    path = np.zeros((60, 3))
    path[:, 1] = np.where(times < 0.5, 2.0 * times - 0.5 * 9.81 * times**2, 0.0)
    found = find_fall(body + path[:, None], 60.0, 1.0)
    assert found is not None
    np.testing.assert_allclose(found, [0, -1, 0], atol=0.05)
    assert find_fall(body + np.zeros((60, 1, 3)), 60.0, 1.0) is None
    assert find_fall(body + 0.01 * path[:, None], 60.0, 1.0) is None


@pytest.mark.parametrize(
    ("name", "up"),
    [
        ("emre_mixed/Cartwheel.bvh", "z"),
        ("emre_mixed/HopScotch.bvh", "z"),
        ("emre_mixed/01_01.bvh", "y"),
        ("acclaim_male1_accad/Male1_A9_LieDown.bvh", "y"),
        ("acclaim_male1_accad/Male1_A10_LieToCrouch.bvh", "y"),
        ("cheo_vietnam_style/HaiChanDuoiThang.bvh", "z"),
        ("cheo_vietnam_style/test.bvh", "y"),  # stands along y, unlike its siblings
        ("pybvh/bvh_test3.bvh", "z"),
        ("smpl_tram/sample.bvh", "-y"),
        ("c3d_org/ART-Human_hands_real_no6dof.c3d", "z"),  # declares y
        ("ezc3d_testfiles/Qualisys.c3d", "z"),  # declares -z
        ("c3d_org/giant.c3d", "z"),  # a giant circle on the high bar, a guess
    ],
)
def test_the_up_axis_of_foreign_files(foreign, name: str, up: str) -> None:
    assert read_motion(foreign(name)).provenance.up == up


@pytest.mark.parametrize("name", ["dab", "jesse_dance", "jumping", "jumping_jacks", "wave_hello", "zombie"])
def test_people_of_files_without_a_unit_are_as_tall_as_people(foreign, name: str) -> None:
    motion = canonicalise(read_motion(foreign(f"animateddrawings/{name}.bvh")))
    assert 1.4 < motion.height < 1.9
    hips = motion.positions[:, [CANONICAL_JOINTS.index(f"{side}_hip") for side in ("left", "right")]]
    assert 0.08 < np.linalg.norm(hips[:, 0] - hips[:, 1], axis=1).mean() < 0.35


@given(st.sampled_from(AXES), st.floats(1e-4, 1e3))
def test_there_and_back(up: str, unit: float) -> None:
    body = walking_body()
    frame = ReferenceFrame(unit=unit, up=up)
    there = from_reference_frame(body, frame)
    for name in ("positions", "rest_positions"):
        back = frame.place(getattr(there, name))
        np.testing.assert_allclose(back, getattr(body, name), rtol=1e-12, atol=1e-12)
    axis = "xyz".index(up[-1])
    sign = -1.0 if up.startswith("-") else 1.0
    np.testing.assert_allclose(sign * unit * there.positions[..., axis], body.positions[..., 1], rtol=1e-12)
    assert np.linalg.det(frame.rotation) == pytest.approx(1.0)


@pytest.mark.parametrize("up", AXES)
def test_motions_turn_like_their_trajectories(up: str, shared_data) -> None:
    motion = read_motion(sorted(shared_data("bandai/walk/youthful").iterdir())[0])
    frame = ReferenceFrame(unit=0.01, up=up)
    turned = from_reference_frame(motion, frame)
    direct = from_reference_frame(compute_trajectories(motion), frame)
    np.testing.assert_allclose(compute_trajectories(turned).positions, direct.positions, atol=1e-7)
    arrays = turned.skeleton, turned.rotations, turned.translations
    skeleton, _, translations = change_arrays(*arrays, frame.unit, frame.rotation)
    np.testing.assert_allclose(translations, motion.translations, atol=1e-9)
    np.testing.assert_allclose(skeleton.offsets, motion.skeleton.offsets, atol=1e-9)


@pytest.mark.parametrize(
    ("text", "unit"),
    [("mm", 0.001), (" CM ", 0.01), ("m", 1.0), ("inch", 0.0254), ("ft", 0.3048), ("0.05", 0.05), (2, 2.0),
     ("cmu", CMU_UNIT), ("Meters", 1.0), ("metre", 1.0), ("millimetres", 0.001), ("Centimeter", 0.01)],
)  # fmt: skip
def test_parse_unit(text: str | float, unit: float) -> None:
    assert parse_unit(text) == unit


@pytest.mark.parametrize("text", ["", "yard", "0", "-1", "nan", "inf"])
def test_parse_unit_refuses(text: str) -> None:
    with pytest.raises(OptionError, match="expected m, dm, cm"):
        parse_unit(text)


def test_parse_up() -> None:
    assert [parse_up(text) for text in ("Y", "+z", " -X ")] == ["y", "z", "-x"]
    with pytest.raises(OptionError, match="expected one of x, y, z"):
        parse_up("w")


@pytest.mark.parametrize("habit", ["y", "z", None])
@pytest.mark.parametrize("up", ["y", "z"])
@pytest.mark.parametrize(
    "title",
    ["Plug-in Gait, lower body", "Rizzoli, old names", "Plug-in Gait, upper body", "One leg, six degrees of freedom",
     "One arm", "One arm and trunk, ISB", "Plug-in Gait, no wrists"],
)  # fmt: skip
def test_up_of_a_part_of_a_body(title: str, up: str, habit: str | None) -> None:
    points = canonicalise(walking_body(60)).positions
    points = points + np.array([0.4, 0.0, 0.3])
    worn = _in_file(wear(MARKER_SETS[title], points, 30.0), 0.001, up)
    frame = infer_reference_frame(_sample(worn), declared_unit=0.001, default_up=habit, whole=lambda: worn.positions)
    assert frame.up == up or frame.up_source == "guessed"
    if "arm" not in title.lower():
        assert frame.up == up


def test_up_of_points_that_nobody_knows_is_a_guess_where_they_stand_otherwise() -> None:
    cloud = np.random.default_rng(0).uniform(-1, 1, (20, 9, 3)) * [0.3, 0.3, 0.9]
    points = Trajectories(tuple(f"p{i}" for i in range(9)), cloud, 30.0)
    frame = infer_reference_frame(points, default_up="y")
    assert (frame.up, frame.up_source) == ("y", "guessed")
    assert frame.notes[-1].values["second"] == "z"
    assert infer_reference_frame(points, default_up="z").up_source == "assumed"


@pytest.mark.parametrize(("scale", "source"), [(1.0, "inferred"), (0.75, "assumed"), (1.35, "assumed")])
def test_a_normalised_body_of_a_pose_estimator_is_made_as_tall_as_people_are(scale: float, source: str) -> None:
    worn = wear(MARKER_SETS["Human3.6M"], canonicalise(walking_body()).positions, 30.0)
    frame = infer_reference_frame(worn.replace(positions=scale * worn.positions))
    assert frame.unit_source == source
    true = 1.0 / scale
    assert frame.unit == pytest.approx(true, rel=0.12)
    if source == "assumed":
        (note,) = [one for one in frame.notes if one.code == "units.normalised"]
        assert note.values["share"] * 1.7 == pytest.approx(frame.unit)
    # Of a file that says its unit, or with the names of a rig, nothing is assumed.
    assert infer_reference_frame(worn.replace(positions=scale * worn.positions), declared_unit=1.0).unit == 1.0
    rig = walking_body()
    assert infer_reference_frame(rig.replace(positions=scale * rig.positions)).unit_source == "inferred"
