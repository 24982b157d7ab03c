"""Crops, letterboxes and anchors against slow transcriptions, and the real networks on real people."""

import math

import numpy as np
import pytest

from dousa.errors import KeypointError
from dousa.estimation import MEDIAPIPE_NAMES, read_cameras
from dousa.estimation.keypoints import pose_networks as pc
from dousa.estimation.keypoints.films import FilmFrames
from dousa.estimation.keypoints.pose_models import find_pose_model
from dousa.estimation.keypoints.pose_networks import (
    LandmarkNetwork,
    PersonCrop,
    PersonDetector,
    Shrinker,
    paint_over,
    refine_landmarks,
)
from dousa.formats import read_motion

POINTS = {
    f"{side}_{part}": f"{side[0].upper()}{part.capitalize()}"
    for side in ("left", "right")
    for part in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
}
PLACES = [MEDIAPIPE_NAMES.index(name) for name in POINTS]
MIRRORED = [
    MEDIAPIPE_NAMES.index(name.replace("left", "@").replace("right", "left").replace("@", "right"))
    for name in MEDIAPIPE_NAMES
]


@pytest.fixture(scope="module")
def networks():
    for package in ("cv2", "av", "ai_edge_litert"):
        pytest.importorskip(package, reason=f"{package} is not installed (dousa[film])")
    for model in ("detector", "full"):
        try:
            find_pose_model(model)
        except KeypointError as error:
            pytest.skip(str(error))
    return PersonDetector(1), LandmarkNetwork("full", 1)


@pytest.fixture
def picture(shared_data):
    """A frame of a man on one leg, with the camera and the reference joints (K, 3) m."""
    folder = shared_data("pose2sim")
    with FilmFrames(folder / "videos" / "cam03.mp4") as film:
        shown = next(shown for number, _, shown in film.read() if number == 21)
    camera = {camera.name: camera for camera in read_cameras(folder / "calibration" / "Calib.qca.txt")}["cam03"]
    reference = read_motion(folder / "Balancing_for_IK.trc")
    joints = reference.positions[20, [reference.names.index(name) for name in POINTS.values()]]
    return shown, camera.project(joints)


def test_a_man_is_found_where_he_stands(networks, picture):
    detector, network = networks
    shrinker = Shrinker(picture[0])
    found = detector.find(shrinker)
    assert len(found) == 1 and found[0].score > 0.8
    landmarks = network.find(shrinker, found[0].crop)
    landmarks = network.find(shrinker, landmarks.next_crop)
    off = np.linalg.norm(landmarks.points[PLACES] - picture[1], axis=1)
    assert landmarks.score > 0.9 and np.mean(off) < 30  # px of 1920; the reference is some 3 cm off, 10 px
    assert 0.05 < landmarks.mask.mean() < 0.2
    inside = (landmarks.points[PLACES] - [landmarks.crop.x, landmarks.crop.y]) / landmarks.crop.size
    assert np.abs(inside).max() < 0.5


def test_a_mirrored_man_is_found_mirrored(networks, picture):
    """Left and right, crop and world turn over together; the network itself differs by a pixel or two of its crop."""
    detector, network = networks
    shown = picture[0]
    shrinker, width = Shrinker(shown), shown.shape[1]
    crop = network.find(shrinker, detector.find(shrinker)[0].crop).next_crop
    one = network.find(shrinker, crop)
    mirrored = PersonCrop(width - 1 - crop.x, crop.y, crop.size, -crop.angle)
    other = network.find(Shrinker(np.ascontiguousarray(shown[:, ::-1])), mirrored)
    back = other.points[MIRRORED] * (-1, 1) + (width - 1, 0)
    sure = one.visibility > 0.8
    cell = crop.size / 256
    assert np.abs(np.median(back[sure] - one.points[sure], axis=0)).max() < 3 * cell
    np.testing.assert_allclose(other.world[MIRRORED] * (-1, 1, 1), one.world, atol=0.15)


pytest.importorskip("cv2", reason="OpenCV is not installed (dousa[film])")


def make_ramp(width, height):
    """A picture whose red is the column and green the row, a fifth of a pixel of 1000 being one step of blue."""
    picture = np.zeros((height, width, 3), np.uint8)
    picture[..., 0], picture[..., 1] = np.arange(width)[None], np.arange(height)[:, None]
    return picture


@pytest.mark.parametrize(
    ("end", "angle"),
    [
        ((100, 100), 0),
        ((200, 200), math.pi / 2),
        ((0, 200), -math.pi / 2),
        ((100 + 70.7107, 200 - 70.7107), math.pi / 4),
    ],
)
def test_the_square_stands_with_the_body(end, angle):
    crop = pc.crop_around(np.array([100.0, 200.0]), np.array(end, float))
    assert (crop.x, crop.y) == (100, 200)
    assert crop.size == pytest.approx(250, abs=0.01)
    assert crop.angle == pytest.approx(angle, abs=1e-6)
    top = pc.transform(crop.matrix(), np.array([127.5, 127.5 - 256 / 2.5]))  # in the crop the body is upright
    np.testing.assert_allclose(top, end, atol=0.01)


@pytest.mark.parametrize("end", [(100.0, 200.0), (np.nan, 0.0), (101.0, 200.0)])
def test_no_square_of_nothing(end):
    assert pc.crop_around(np.array([100.0, 200.0]), np.array(end)) is None


def test_the_corners_of_a_crop_are_those_of_its_square():
    crop = pc.PersonCrop(50, 60, 40, 0.3)
    for side in (128, 256):
        corners = np.array([[-0.5, -0.5], [side - 0.5, -0.5], [side - 0.5, side - 0.5], [-0.5, side - 0.5]])
        found = pc.transform(crop.matrix(side), corners)
        turn = np.array([[math.cos(0.3), -math.sin(0.3)], [math.sin(0.3), math.cos(0.3)]])
        expected = np.array([[-20, -20], [20, -20], [20, 20], [-20, 20]]) @ turn.T + (50, 60)
        np.testing.assert_allclose(found, expected, atol=1e-9)


@pytest.mark.parametrize("size", [64.0, 180.0, 256.0])
@pytest.mark.parametrize("angle", [0.0, 0.5])
def test_a_crop_shows_what_lies_there(size, angle):
    """A ramp looked at through a crop has the picture's coordinates as its colours, pixel by pixel."""
    crop = pc.PersonCrop(120.25, 130.5, size / 1.5, angle)
    shown = pc.Shrinker(make_ramp(250, 255)).cut(crop).astype(float)
    for row, column in ((0, 0), (10, 250), (128, 77), (255, 255)):
        scale, half = crop.size / 256, 127.5
        across, down = (column - half) * scale, (row - half) * scale
        x = 120.25 + math.cos(angle) * across - math.sin(angle) * down
        y = 130.5 + math.sin(angle) * across + math.cos(angle) * down
        assert shown[row, column, 0] == pytest.approx(x, abs=1.01)
        assert shown[row, column, 1] == pytest.approx(y, abs=1.01)


def test_large_crops_are_sampled_without_a_shift():
    """Halved levels are used: the mean of the ramp's error must not be half a pixel off."""
    picture = np.repeat(np.repeat(make_ramp(250, 250), 8, axis=0), 8, axis=1)  # 2000 px wide, a step every 8
    crop = pc.PersonCrop(1000.0, 900.0, 1500.0, 0.0)
    shown = pc.Shrinker(picture).cut(crop).astype(float)
    columns = pc.transform(crop.matrix(), np.stack([np.arange(256), np.zeros(256)], axis=1))[:, 0]
    off = shown[:, :, 0].mean(axis=0) - ((columns + 0.5) / 8 - 0.5)
    assert abs(off.mean()) < 0.05 and abs(off).max() < 1


@pytest.mark.parametrize(("size", "part"), [((250, 120), None), ((97, 251), None), ((240, 200), (30, 20, 111, 111))])
def test_the_letterbox_leads_back_to_the_picture(size, part):
    square, matrix = pc.Shrinker(make_ramp(*size)).letterbox(part)
    assert square.shape == (224, 224, 3)
    seen = np.argwhere(square[..., :2].sum(axis=2) > 0)
    inner = [(row, column) for row, column in seen[:: len(seen) // 50]]
    places = pc.transform(matrix, np.array([(column, row) for row, column in inner], float))
    colours = np.array([square[row, column, :2] for row, column in inner], float)
    left, top, width, height = part or (0, 0, *size)
    places = np.clip(places, (left, top), (left + width - 1, top + height - 1))
    np.testing.assert_allclose(colours, places, atol=1.2)


def test_anchors_by_loops():
    expected = []
    for cells, count in ((28, 2), (14, 2), (7, 6)):
        for row in range(cells):
            for column in range(cells):
                expected += [((column + 0.5) / cells, (row + 0.5) / cells)] * count
    np.testing.assert_allclose(pc.make_anchors(), expected)


def plant(anchors, people):
    """What the detector would return for people: anchor, logit, and six points in its square."""
    raw, logits = np.zeros((len(anchors), 12), np.float32), np.full(len(anchors), -10, np.float32)
    for anchor, logit, box, points in people:
        origin = anchors[anchor] * 224
        low, high = np.array(box[:2]), np.array(box[2:])
        raw[anchor] = np.concatenate([(low + high) / 2 - origin, high - low, (np.array(points) - origin).reshape(-1)])
        logits[anchor] = logit
    return raw, logits


def test_detections_are_decoded_and_merged():
    anchors = pc.make_anchors()
    points = np.array([[50, 100], [50, 60], [50, 70], [50, 50]], float)
    people = [
        (100, 3.0, (40, 40, 60, 60), points),
        (900, 1.0, (41, 40, 61, 60), points + np.array([1, 0])),
        (2000, 2.0, (140, 140, 160, 160), points + 100),
        (2100, -3.0, (180, 10, 200, 30), points),
    ]
    raw, logits = plant(anchors, people)
    found = pc.decode_detections(raw, logits, anchors, np.array([[2.0, 0, 10], [0, 2.0, 20]]))
    assert [round(one.score, 3) for one in found] == [0.953, 0.881]
    weight = 0.7310586 / (0.7310586 + 0.9525741)  # of the second, by its score
    x = 2 * (50 + weight - 0.5) + 10
    assert found[0].crop.x == pytest.approx(x, abs=1e-3)
    assert found[0].crop.y == pytest.approx(2 * 99.5 + 20, abs=1e-3)
    assert found[0].crop.size == pytest.approx(1.25 * 2 * 2 * 40, abs=1e-3)
    np.testing.assert_allclose(found[1].box, [289, 299, 329, 339], atol=1e-3)
    assert pc.decode_detections(raw, np.full_like(logits, -9), anchors, np.eye(3)[:2]) == []


def test_parts_cover_the_picture_and_overlap():
    for size, side in (((1080, 1920), 1080), ((1920, 1080), 540), ((300, 300), 300), ((301, 300), 300)):
        parts = pc.list_parts(size, side)
        covered = np.zeros((size[1], size[0]), int)
        for x, y, width, height in parts:
            assert x >= 0 and y >= 0 and x + width <= size[0] and y + height <= size[1]
            covered[y : y + height, x : x + width] += 1
        assert covered.min() >= 1


def test_overlaps_by_counting_pixels():
    boxes = np.array([[0, 0, 10, 10], [5, 5, 15, 15], [20, 20, 30, 30], [2, 3, 4, 9]], float)
    grid = np.stack(np.meshgrid(np.arange(40) + 0.5, np.arange(40) + 0.5), axis=-1)
    inside = [((grid > box[:2]) & (grid < box[2:])).all(axis=2) for box in boxes]
    expected = [(inside[0] & one).sum() / (inside[0] | one).sum() for one in inside]
    np.testing.assert_allclose(pc.measure_overlap(boxes[0], boxes), expected)


def test_landmarks_are_refined_as_by_loops():
    rng = np.random.default_rng(0)
    places, heatmaps = rng.uniform(-20, 280, (39, 2)), rng.normal(-4, 2.5, (64, 64, 39)).astype(np.float32)
    expected = places.copy()
    for point in range(39):
        column, row = math.floor(places[point, 0] / 4), math.floor(places[point, 1] / 4)
        if not (0 <= column < 64 and 0 <= row < 64):
            continue
        total = x = y = best = 0.0
        for r in range(max(0, row - 3), min(64, row + 4)):
            for c in range(max(0, column - 3), min(64, column + 4)):
                sure = 1 / (1 + math.exp(-float(heatmaps[r, c, point])))
                total, x, y, best = total + sure, x + c * sure, y + r * sure, max(best, sure)
        if best >= 0.5:
            expected[point] = (4 * x / total, 4 * y / total)
    found = refine_landmarks(places, heatmaps)
    np.testing.assert_allclose(found, expected, atol=1e-9)
    assert 0 < (found == places).all(axis=1).sum() < 39


def test_other_people_are_painted_over_but_not_the_person():
    crop = pc.PersonCrop(128, 128, 256, 0.0)
    colours = np.full((256, 256, 3), 200, np.uint8)
    colours[100:200, 100:200] = 50
    other, own = np.zeros((128, 128), bool), np.zeros((128, 128), bool)
    other[50:100, 50:100] = True  # the dark square
    own[50:75, 50:100] = True  # its upper half
    painted = paint_over(colours, crop, [(other, crop)], (own, crop))
    assert (painted[110:140, 110:190] == 50).all()
    assert (painted[160:190, 110:190] > 100).all()
    assert paint_over(colours, crop, [(np.zeros((128, 128), bool), crop)]) is colours
