"""The rasteriser against the slow oracle; pixels whose centre lies on the border to a millionth are free."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from oracles.parts import run_part
from oracles.slow_rasteriser import depth_in_hull, part_depths, project

from dousa.estimation.body.body import BodyModel
from dousa.estimation.body.kinematics import place_parts
from dousa.estimation.cameras.camera import Camera
from dousa.estimation.raster.rasteriser import draw_body, draw_parts, pack_bits, unpack_bits

FREE = 1e-6
TO_IMAGE = np.diag([1.0, -1.0, -1.0])


def body_of(*parts):
    """Stuck parts of spheres (x, y, z, r), all in the root's axes."""
    count = len(parts)
    return BodyModel(
        names=tuple(f"part{k}" for k in range(count)),
        joints=tuple(f"joint{k}" for k in range(count)),
        parents=[-1] + [0] * (count - 1),
        offsets=np.zeros((count, 3)),
        rest=np.tile([1.0, 0, 0, 0], (count, 1)),
        n_axes=np.zeros(count, int),
        axes=np.zeros((count, 3, 3)),
        limits=np.zeros((count, 3, 2)),
        spheres=np.concatenate([np.reshape(part, (-1, 4)) for part in parts]),
        sphere_starts=np.cumsum([0] + [len(part) for part in parts]),
        tips=(),
        tip_parts=[],
        tip_offsets=np.zeros((0, 3)),
        stature=1.0,
    )


def flat_camera(width, height):
    """One pixel a metre: the sphere (x, -y, 0, r) is the disc (x, y, r)."""
    return Camera("flat", width, height, np.eye(3), TO_IMAGE, np.zeros(3), kind="orthographic")


def pinhole(width, height, focal=60.0, distortion=None, matrix=None, translation=(0.0, 0.0, 3.0)):
    matrix = [[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]] if matrix is None else matrix
    return Camera("pinhole", width, height, matrix, TO_IMAGE, translation, distortion)


def poses_at(*places):
    return np.array([[*place, 1.0, 0.0, 0.0, 0.0] for place in places])


def draw_discs(discs, width, height):
    body = body_of([(x, -y, 0.0, r) for x, y, r in discs])
    return draw_body(body, poses_at((0, 0, 0)), flat_camera(width, height))[0]


def assert_agrees(mask, depths):
    counted = np.abs(depths) > FREE
    wrong = (mask != (depths > 0)) & counted
    assert not wrong.any(), f"pixels {np.argwhere(wrong)[:5].tolist()}, px deep {depths[wrong][:5]}"


places = st.one_of(st.floats(-30, 110), st.integers(-10, 80).map(float), st.integers(-20, 160).map(lambda k: k / 2))
radii = st.one_of(st.just(0.0), st.floats(0, 40), st.integers(0, 20).map(float))
many_discs = st.lists(st.tuples(places, places, radii), min_size=1, max_size=7)


@settings(max_examples=60, deadline=None)
@given(many_discs, st.integers(1, 130), st.integers(1, 24))
@example([(0.0, 0.0, 0.0), (0.0, 2.0, 2.0)], 2, 2)  # a point on top of a disc
@example([(2.0, 0.0, 5e-324), (0.5, 2.0, 2.0)], 3, 3)  # next to nothing, next to nothing higher
@example([(1e-9, 1e-20, 1.0), (1e-20, 1.0, 2.0)], 3, 3)  # a disc that touches the one it lies in, on top
def test_hull_of_discs_is_the_oracles(discs, width, height):
    assert_agrees(draw_discs(discs, width, height), depth_in_hull(discs, width, height))


@settings(max_examples=30, deadline=None)
@given(st.lists(st.tuples(places, places), min_size=1, max_size=6), radii)
@example([(0.0, -1.2e-7), (12.0, 0.0), (14.0, 0.0)], 0.0)  # edges whose cosines differ by less than rounding
def test_discs_in_a_row_and_of_one_size(points, radius):
    """Several discs touch one tangent: no edge may get lost."""
    discs = [(x, y, radius) for x, y in points] + [(x, 7.0, radius) for x, _ in points]
    assert_agrees(draw_discs(discs, 70, 20), depth_in_hull(discs, 70, 20))


@settings(max_examples=30, deadline=None)
@given(st.tuples(places, places, st.floats(5, 40)), st.lists(st.tuples(*[st.floats(0, 1)] * 3), max_size=4))
def test_contained_discs_change_nothing(outer, inner):
    x, y, r = outer
    held = [
        (x + r * (1 - size) * share * np.cos(7 * turn), y + r * (1 - size) * share * np.sin(7 * turn), r * size * 0.999)
        for turn, share, size in inner
    ]
    np.testing.assert_array_equal(draw_discs([outer, *held], 90, 40), draw_discs([outer], 90, 40))


@settings(max_examples=25, deadline=None)
@given(st.lists(st.tuples(st.floats(-5e6, 5e6), st.floats(-5e6, 5e6), st.floats(0, 1e6)), min_size=2, max_size=5))
def test_discs_millions_of_pixels_away(discs):
    depths = depth_in_hull(discs, 66, 8)
    mask = draw_discs(discs, 66, 8)
    counted = np.abs(depths) > 1e-2
    np.testing.assert_array_equal(mask[counted], depths[counted] > 0)


@pytest.mark.parametrize("far", [1e12, 1e25, 1e300, float("inf"), float("nan")])
def test_what_is_beyond_all_numbers_of_pixels_draws_nothing_wrong(far):
    """A nonsensical calibration puts discs where no column number reaches: rows may be lost, never the program."""
    from dousa.estimation.raster.rasteriser import draw_intervals, outline_discs

    for sign in (-1.0, 1.0):
        discs = np.array([[sign * far, 3.0, 2.0], [sign * 2 * far, 5.0, 1.0], [3.0, sign * far, 0.0]])
        low, high = np.empty(9, np.int64), np.empty(9, np.int64)
        first, last = run_part(outline_discs)(discs, 3, 70, 9, np.empty((3, 3, 2)), low, high)
        assert 0 <= first <= max(first, last) <= 9
        bits = np.zeros((9, 2), np.uint64)
        run_part(draw_intervals)(bits, low, high, first, last)
        assert not (bits[:, 1] >> np.uint64(6)).any()


@pytest.mark.parametrize(
    ("disc", "pixels"),
    [((3, 2, 0), 1), ((3.25, 2, 0), 0), ((3, 2, 1), 5), ((3, 2, 0.999), 1), ((0, 0, 1), 3), ((-1, 2, 1), 1)],
)
def test_centres_on_the_border_belong_to_the_disc(disc, pixels):
    assert draw_discs([disc], 9, 5).sum() == pixels


def test_a_polyhedron_without_radius_holds_its_border():
    mask = draw_discs([(1, 1, 0), (6, 1, 0), (6, 3, 0), (1, 3, 0)], 9, 5)
    assert mask[1:4, 1:7].all() and mask.sum() == 18


def test_a_level_line_without_radius_is_drawn_and_a_slanted_one_only_where_it_meets_centres():
    assert draw_discs([(2, 3, 0), (70, 3, 0)], 100, 6).sum() == 69
    assert np.argwhere(draw_discs([(0, 0, 0), (8, 4, 0)], 10, 6)).tolist() == [[k, 2 * k] for k in range(5)]


numbers = st.floats(-1, 1)
spheres = st.lists(st.tuples(numbers, numbers, numbers, st.floats(0, 0.5)), min_size=1, max_size=4)


@settings(max_examples=25, deadline=None)
@given(
    st.lists(spheres, min_size=1, max_size=3),
    st.tuples(*[st.floats(-0.3, 0.3)] * 2, *[st.floats(-0.02, 0.02)] * 2, st.floats(-0.05, 0.05)),
    st.tuples(st.floats(20, 80), st.floats(20, 80), st.floats(-4, 4)),
    st.sampled_from(["pinhole", "orthographic"]),
    st.tuples(*[numbers] * 4).filter(lambda q: np.linalg.norm(q) > 0.1),
)
def test_parts_through_any_camera_are_the_oracles(parts, distortion, lens, kind, turn):
    width, height = 67, 20
    fx, fy, skew = lens
    matrix = [[fx, skew, 31.0], [0, fy, 11.0], [0, 0, 1]]
    camera = Camera("any", width, height, matrix, TO_IMAGE, (0.1, -0.2, 3.0), distortion, kind)
    body = body_of(*parts)
    pose = np.array([[0.2, -0.1, 0.3, *(np.array(turn) / np.linalg.norm(turn))]])
    rotations, positions = place_parts(body, pose)
    depths = part_depths(body, rotations[0], positions[0], camera)
    layers = draw_parts(body, pose, camera)[0]
    for layer, depth in zip(layers, depths, strict=True):
        assert_agrees(layer, depth)
    np.testing.assert_array_equal(draw_body(body, pose, camera)[0], layers.any(axis=0))


def test_oracle_projects_as_opencv_does():
    cv2 = pytest.importorskip("cv2")
    points = np.random.default_rng(1).uniform(-1, 1, (20, 3)) + np.array([0, 0, 4.0])
    camera = Camera(
        "cv", 64, 48, [[70, 0, 31], [0, 65, 22], [0, 0, 1]], np.eye(3), np.zeros(3), (0.2, -0.1, 0.01, -0.02, 0.03)
    )
    there, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), camera.matrix, camera.distortion)
    here = [project(camera, point, 0.0)[:2] for point in points]
    np.testing.assert_allclose(here, there[:, 0], atol=1e-9)


def test_oracles_few_directions_are_enough():
    """Against very many directions: the slack is nowhere less."""
    discs = [(3.0, 4.0, 2.0), (12.0, 5.5, 1.0), (8.0, 11.0, 3.0), (7.0, 6.0, 0.5)]
    turns = np.linspace(0, 2 * np.pi, 200_000)
    u = np.stack((np.cos(turns), np.sin(turns)))
    reach = np.max([u.T @ (x, y) + r for x, y, r in discs], axis=0)
    depths = depth_in_hull(discs, 18, 16)
    for row in range(0, 16, 3):
        for column in range(0, 18, 4):
            assert depths[row, column] == pytest.approx((reach - u.T @ (column, row)).min(), abs=2e-4)


def test_a_part_behind_the_camera_is_not_drawn_and_the_others_are():
    body = body_of([(0, 0, 0, 0.3)], [(0, 0, 0, 0.2), (0, 0, 4.0, 0.2)])
    layers = draw_parts(body, poses_at((0, 0, 0)), pinhole(64, 48))[0]
    assert layers[0].any() and not layers[1].any()


@pytest.mark.parametrize(("depth", "seen"), [(0.06, True), (0.04, False), (0.0, False), (-2.0, False)])
def test_a_sphere_nearer_than_five_centimetres_is_behind_the_camera(depth, seen):
    mask = draw_body(body_of([(0, 0, 0, 0.3)]), poses_at((0, 0, 3.0 - depth)), pinhole(64, 48))
    assert mask.any() == seen


def test_camera_inside_the_body_gives_a_full_picture():
    mask = draw_body(body_of([(0, 0, 0, 0.5)]), poses_at((0, 0, 2.9)), pinhole(64, 48))
    assert mask.all()


def test_a_body_out_of_sight_gives_an_empty_picture():
    for place in [(50, 0, 0), (-50, 0, 0), (0, 50, 0), (0, -50, 0), (1e9, 1e9, 0)]:
        assert not draw_body(body_of([(0, 0, 0, 0.5)]), poses_at(place), pinhole(65, 48)).any()


@settings(max_examples=30, deadline=None)
@given(st.integers(1, 200), st.integers(1, 5), st.integers(0, 3), st.integers(0, 2**32 - 1))
def test_bits_go_there_and_back(width, height, frames, seed):
    masks = np.random.default_rng(seed).random((frames, height, width)) < 0.5
    bits = pack_bits(masks)
    assert bits.shape == (frames, height, -(-width // 64)) and bits.dtype == np.uint64
    np.testing.assert_array_equal(unpack_bits(bits, width), masks)


def test_column_i_is_bit_i_of_its_word():
    mask = np.zeros((1, 130), bool)
    mask[0, [0, 65, 129]] = True
    assert pack_bits(mask).tolist() == [[1, 2, 2]]


@settings(max_examples=60, deadline=None)
@given(st.integers(1, 200), st.integers(0, 199), st.integers(-1, 199), st.integers(0, 2**32 - 1))
def test_counting_an_interval_is_counting_its_pixels(width, low, high, seed):
    from dousa.estimation.tracking.search_kernels import count_alone, count_unseen

    low, high = min(low, width), min(high, width - 1)
    plus, minus, drawn = np.random.default_rng(seed).random((3, 1, width)) < 0.5
    columns = np.arange(width)
    inside = (columns >= low) & (columns <= high)
    interval = np.array([low]), np.array([high]), 0, 1
    expected = int(plus[0, inside].sum()) - int(minus[0, inside].sum())
    assert run_part(count_alone)(pack_bits(plus), pack_bits(minus), *interval) == expected
    new = inside & ~drawn[0]
    bits = pack_bits(drawn)
    expected = int(plus[0, new].sum()) - int(minus[0, new].sum())
    assert run_part(count_unseen)(pack_bits(plus), pack_bits(minus), bits, *interval) == expected
    np.testing.assert_array_equal(bits, pack_bits(drawn | inside))


def test_the_bits_beyond_the_last_column_stay_clear():
    from dousa.estimation.raster.rasteriser import draw_intervals

    bits = np.zeros((2, 2), np.uint64)
    run_part(draw_intervals)(bits, np.array([0, 5]), np.array([69, 4]), 0, 2)
    assert bits.tolist() == [[2**64 - 1, 2**6 - 1], [0, 0]]
