"""The real networks on real people, where the models are installed and the recordings are there."""

from __future__ import annotations

import numpy as np
import pytest

from dousa.errors import KeypointError
from dousa.estimation import MEDIAPIPE_NAMES, read_cameras
from dousa.estimation.keypoints.films import FilmFrames
from dousa.estimation.keypoints.pose_models import find_pose_model
from dousa.estimation.keypoints.pose_networks import LandmarkNetwork, PersonCrop, PersonDetector, Shrinker
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
