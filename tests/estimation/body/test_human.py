"""The human body: canonical names, symmetry, sizes that people have, and measures."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dousa.errors import BodyModelError
from dousa.estimation.body.body import widen
from dousa.estimation.body.human import GIRTHS, LENGTHS, MEASURES, SEXES, make_human
from dousa.estimation.body.kinematics import compute_points, place_parts, point_names
from dousa.estimation.body.posing import standing_state
from dousa.estimation.body.skeleton_body import fit_body
from dousa.motion import CANONICAL_JOINTS

MIRRORED = [name.replace("left", "#").replace("right", "left").replace("#", "right") for name in make_human().names]


def spheres_at(body, pose):
    rotations, positions = place_parts(body, pose)
    owner = np.repeat(np.arange(body.n_parts), np.diff(body.sphere_starts))
    centres = positions[owner] + np.einsum("sij,sj->si", rotations[owner], body.spheres[:, :3])
    return owner, centres, body.spheres[:, 3]


def tape_length(body, parts, height):
    """Length of a tape round parts of the standing body at a height in m.

    Each solid is cut by sampling the cones between its spheres; the reach of all cuts gives the tape (Cauchy: the
    outline of a convex set is the integral of its reach).
    """
    owner, centres, radii = spheres_at(body, standing_state(body))
    turn = np.linspace(0, 2 * np.pi, 721)
    ways = np.stack((np.cos(turn), np.sin(turn)), axis=1)
    reach = np.full(len(turn), -np.inf)
    for part in parts:
        solid = np.column_stack((centres, radii))[owner == body.names.index(part)]
        for a in solid:
            for b in solid:
                for share in np.linspace(0, 1, 41):
                    x, y, z, radius = (1 - share) * a + share * b
                    if abs(height - y) < radius:
                        reach = np.maximum(reach, ways @ [x, z] + np.sqrt(radius**2 - (height - y) ** 2))
    return np.trapezoid(reach, turn)


def test_joints_and_tips_are_the_canonical_joints():
    body = make_human()
    assert body.n_parts == 15
    assert sorted(point_names(body)) == sorted(CANONICAL_JOINTS)
    assert body.joints[0] == "pelvis" and body.tips[0] == "head"
    assert np.bincount(body.n_axes, minlength=4).tolist() == [1, 4, 4, 6]
    counts = dict(zip(body.names, np.diff(body.sphere_starts), strict=True))
    assert sum(counts.values()) == 39 and max(counts.values()) == counts["trunk"] == 6


@pytest.mark.parametrize("sex", SEXES)
def test_joints_are_at_ease_in_the_standing_body(sex):
    body = make_human(1.6, sex, {"thigh": 0.42})
    used = np.arange(3) < body.n_axes[:, None]
    np.testing.assert_array_equal(body.neutral[used], standing_state(body)[7:])
    np.testing.assert_array_equal(body.neutral[~used], 0.0)


def test_arms_are_quicker_than_the_trunk_and_both_sides_alike():
    body = make_human()
    agility, stiffness = (dict(zip(body.names, values, strict=True)) for values in (body.agility, body.stiffness))
    assert agility["pelvis"] == agility["trunk"] < agility["head"] < agility["left_hand"] == 1.0
    assert agility["left_forearm"] > agility["left_upper_arm"] > agility["left_thigh"] > 1.0
    # Elbows and knees bend all the way in any walk; the root has no joint that could hold it.
    assert stiffness["pelvis"] == 0.0 and stiffness["left_shank"] < stiffness["left_thigh"] == 1.0
    other = [body.names.index(name) for name in MIRRORED]
    for values in (body.agility, body.stiffness, body.neutral):
        np.testing.assert_array_equal(values, values[other])


def test_a_reshaped_body_keeps_how_it_moves():
    body = make_human(1.7)
    points = dict(zip(point_names(body), 1.1 * compute_points(body, standing_state(body)), strict=True))
    for other in (widen(body, 1.4), fit_body(body, points)):
        assert (other.spheres != body.spheres).any()
        for field in ("agility", "neutral", "stiffness"):
            np.testing.assert_array_equal(getattr(other, field), getattr(body, field))


@given(stature=st.floats(0.5, 2.3), sex=st.sampled_from(SEXES))
@settings(max_examples=20, deadline=None)
def test_a_person_stands_on_the_floor_as_tall_as_said(stature, sex):
    body = make_human(stature, sex)
    _, centres, radii = spheres_at(body, standing_state(body))
    assert (centres[:, 1] - radii).min() == pytest.approx(0.0, abs=1e-9)
    assert (centres[:, 1] + radii).max() == pytest.approx(stature, rel=0.02)


@pytest.mark.parametrize("sex", SEXES)
def test_left_and_right_are_mirror_images_at_any_angles(sex):
    body = make_human(1.8, sex)
    other = [body.names.index(name) for name in MIRRORED]
    limits = body.angle_limits
    pose = standing_state(body)
    pose[7:] = limits[:, 0] + np.random.default_rng(1).uniform(size=len(limits)) * np.ptp(limits, axis=1)
    starts = body.angle_starts
    mirror = pose.copy()
    for part, twin in enumerate(other):
        angles = pose[7 + starts[part] : 7 + starts[part + 1]].copy()
        if part == twin and len(angles):
            angles[1:] *= -1.0  # to the side and round
        mirror[7 + starts[twin] : 7 + starts[twin + 1]] = angles
    names = point_names(body)
    twins = [names.index(n.replace("left", "#").replace("right", "left").replace("#", "right")) for n in names]
    points = compute_points(body, np.stack((pose, mirror)))
    np.testing.assert_allclose(points[0, twins] * [-1, 1, 1], points[1], atol=1e-9)


def test_the_standing_person_faces_forward_with_the_left_on_the_left():
    body = make_human(1.7)
    points = dict(zip(point_names(body), compute_points(body, standing_state(body)), strict=True))
    assert points["left_shoulder"][0] > 0.1 > -0.1 > points["right_shoulder"][0]
    assert points["left_toe"][2] > points["left_ankle"][2] + 0.05
    assert points["head"][1] > points["neck"][1] > points["spine"][1] > points["left_hip"][1]
    assert points["left_hand"][1] < points["left_elbow"][1] and points["left_hand"][0] > points["left_hip"][0]
    # An ASF root lies some 10 cm above the hips.
    assert 0.07 < points["pelvis"][1] - points["left_hip"][1] < 0.14
    limits, angles = body.angle_limits, standing_state(body)[7:]
    assert ((limits[:, 0] <= angles) & (angles <= limits[:, 1])).all()


@pytest.mark.parametrize(
    ("angle", "tip", "way"),
    [
        ("left_elbow.1", "left_hand", (0, 0, 1)), ("right_elbow.1", "right_hand", (0, 0, 1)),
        ("left_knee.1", "left_toe", (0, 0, -1)), ("right_knee.1", "right_toe", (0, 0, -1)),
        ("spine.1", "head", (0, 0, 1)), ("neck.1", "head", (0, 0, 1)), ("left_ankle.1", "left_toe", (0, -1, 0)),
        ("left_ankle.2", "left_toe", (1, 0, 0)), ("right_ankle.2", "right_toe", (-1, 0, 0)),
    ],
)  # fmt: skip
def test_joints_bend_the_way_people_do(angle, tip, way):
    body = make_human()
    pose = standing_state(body)
    bent = pose.copy()
    bent[7 + body.angle_names.index(angle)] += 0.5
    before, after = compute_points(body, np.stack((pose, bent)))[:, point_names(body).index(tip)]
    assert (after - before) @ np.array(way, float) > 0.3 * np.linalg.norm(after - before) > 0


def reachable(directions, hanging):
    """Directions an upper arm or a thigh of the left can point to; plain words on the angles of the sphere."""
    x, y, z = directions.T
    plane, raised = np.degrees(np.arctan2(z, x)), np.degrees(np.arccos(-y))  # 0: to the side, 90: forward
    if hanging == "left_upper_arm":
        behind = (plane < -30) & (plane > -130)
        return (raised < 170) & (((plane >= -30) & (plane < 130)) | (behind & (raised < 60)) | (raised < 40))
    side = (plane >= 0) & (plane <= 60) & (raised < 130)
    front = (plane > 60) & (plane <= 95) & (raised < 140)
    return side | front | (raised < 30) | ((plane < 0) & (plane > -120) & (raised < 45))


@pytest.mark.parametrize("part", ["left_upper_arm", "left_thigh"])
def test_swing_limits_hold_the_whole_reach_and_stay_off_the_half_turn(part):
    from dousa.estimation.body.posing import compute_angles
    from dousa.motion import rotations as rot

    body = make_human()
    index = body.names.index(part)
    directions = np.random.default_rng(0).normal(size=(3000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    directions = directions[reachable(directions, part)]
    down = np.array([0.0, -1.0, 0.0])
    for direction in directions:
        centre = rot.rotate(body.rest[index], down)
        rotation = rot.multiply(rot.between(centre, direction), body.rest[index])
        angles = compute_angles(body, index, rotation)
        swing = rot.from_axis_angle(angles[0] * body.axes[index, 0] + angles[1] * body.axes[index, 1])
        found = rot.rotate(rot.multiply(body.rest[index], swing), down)
        np.testing.assert_allclose(found, direction, atol=1e-6)
        assert np.linalg.norm(angles[:2]) < np.radians(165)


def test_women_and_men_differ_where_they_do():
    female, male = make_human(1.7, "female"), make_human(1.7, "male")
    shoulder, hip = (female.joints.index(name) for name in ("left_shoulder", "left_hip"))
    assert female.offsets[shoulder, 0] < male.offsets[shoulder, 0]
    assert female.offsets[hip, 0] > male.offsets[hip, 0]


def test_lengths_are_those_that_were_measured():
    told = {"upper_arm": 0.31, "forearm": 0.24, "thigh": 0.45, "shank": 0.41, "shoulder_breadth": 0.4}
    body = make_human(1.7, measures={**told, "hip_breadth": 0.2, "trunk": 0.5})
    points = dict(zip(point_names(body), compute_points(body, standing_state(body)), strict=True))

    def distance(one, other):
        return np.linalg.norm(points[one] - points[other])

    for side in ("left", "right"):
        assert distance(f"{side}_shoulder", f"{side}_elbow") == pytest.approx(0.31)
        assert distance(f"{side}_elbow", f"{side}_wrist") == pytest.approx(0.24)
        assert distance(f"{side}_hip", f"{side}_knee") == pytest.approx(0.45)
        assert distance(f"{side}_knee", f"{side}_ankle") == pytest.approx(0.41)
    assert distance("left_shoulder", "right_shoulder") == pytest.approx(0.4)
    assert distance("left_hip", "right_hip") == pytest.approx(0.2)
    assert points["neck"][1] - points["left_hip"][1] == pytest.approx(0.5, abs=1e-6)


@pytest.mark.parametrize("measure", ["hand", "foot", "head", *GIRTHS])
def test_solids_grow_with_their_measure(measure):
    usual = (LENGTHS | GIRTHS)[measure] * 1.7
    small, large = (make_human(1.7, measures={measure: share * usual}) for share in (0.8, 1.25))
    assert (small.spheres != large.spheres).any()
    assert np.abs(large.spheres).sum() > np.abs(small.spheres).sum()


@pytest.mark.parametrize(
    ("measure", "parts", "height"),
    [
        ("chest_girth", ["trunk"], 0.775),
        ("waist_girth", ["pelvis", "trunk"], 0.69),
        ("hip_girth", ["pelvis", "left_thigh", "right_thigh"], 0.51),
        ("thigh_girth", ["left_thigh"], 0.45),
        ("calf_girth", ["left_shank"], 0.22),
        ("upper_arm_girth", ["left_upper_arm"], 0.75),
        ("forearm_girth", ["left_forearm"], 0.65),
    ],
)
def test_the_girths_of_the_table_are_those_of_its_solids(measure, parts, height):
    assert tape_length(make_human(1.0), parts, height) == pytest.approx(GIRTHS[measure], rel=0.03)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((17.2,), "stature: expected 0.3 to 3 m, got 17.2"),
        ((172,), "looks like centimetres, write 1.72"),
        ((1720,), "looks like millimetres, write 1.72"),
        ((float("nan"),), "stature: expected"),
        ((-1.7,), "stature: expected"),
        (("tall",), "expected metres as a number"),
        ((True,), "expected metres as a number"),
        ((1.7, "man"), "expected one of average, female, male, got 'man'"),
        ((1.7, "male", {"tigh": 0.4}), "no measure is called 'tigh'; known measures: upper_arm"),
        ((1.7, "male", {"thigh": 41}), "thigh: expected .* got 41; this looks like centimetres, write 0.41"),
        ((1.7, "male", {"waist_girth": 0.1}), "waist_girth: expected"),
        ((1.7, "male", {"waist_girth": None}), "waist_girth: expected metres"),
    ],
)
def test_what_no_person_has_is_refused_with_the_remedy(arguments, message):
    with pytest.raises(BodyModelError, match=message):
        make_human(*arguments)


def test_every_measure_may_be_the_usual_one():
    usual = {name: share * 1.6 for name, share in (LENGTHS | GIRTHS).items()}
    assert set(usual) == set(MEASURES)
    body, plain = make_human(1.6, measures=usual), make_human(1.6)
    np.testing.assert_allclose(body.spheres, plain.spheres, atol=1e-12)
    np.testing.assert_allclose(body.offsets, plain.offsets, atol=1e-12)
