"""Somebody before the camera whose keypoints were recorded, for tests of the live page: no model is needed."""

from collections.abc import Callable

import numpy as np

from dousa.app.studio.content.live import Finder, Seen
from dousa.arrays import FloatArray, Image
from dousa.estimation import MEDIAPIPE_NAMES, make_human, poses_from_motion
from dousa.estimation.multiview.landmarks import place_landmarks
from dousa.estimation.multiview.pose_residuals import place_points
from dousa.motion.synthetic.performers import draw_performer, make_motion

_STAND_INS = {"foot_index": "toe", "index": "hand", "pinky": "hand", "thumb": "hand"}


def _stand_in(name: str) -> str:
    if "eye" in name or "mouth" in name:
        return "nose"
    return next((name.replace(part, own) for part, own in _STAND_INS.items() if name.endswith(part)), name)


def record_landmarks(category: str, performer: int, rate: float) -> FloatArray:
    """(T, 33, 3) m, Y up, the landmarks of a synthetic motion."""
    body = make_human(1.72)
    poses = poses_from_motion(body, make_motion(category, draw_performer(performer), frame_rate=rate))
    return place_points(body, poses, place_landmarks(body, [_stand_in(name) for name in MEDIAPIPE_NAMES]))


def replay(landmarks: FloatArray) -> Callable[[], Finder]:
    """``open_finder()`` of a network that would see them in turn, again and again, in the middle of any picture."""

    def open_finder() -> Finder:
        n_seen, low = 0, landmarks.min(axis=(0, 1))
        longest = (landmarks.max(axis=(0, 1)) - low).max()

        def find(picture: Image) -> Seen:
            nonlocal n_seen
            points = landmarks[n_seen % len(landmarks)]
            n_seen += 1
            height = len(picture)
            share = 0.1 + 0.8 * (points - low) / longest
            places = np.stack([share[:, 0] * height, (1.0 - share[:, 1]) * height], axis=1)
            hips = points[[MEDIAPIPE_NAMES.index("left_hip"), MEDIAPIPE_NAMES.index("right_hip")]].mean(axis=0)
            return Seen(places, np.full(len(points), 0.95), (points - hips) * (1.0, -1.0, -1.0))

        return find

    return open_finder
