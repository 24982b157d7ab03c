"""The channels of the extended features, written with whole arrays of NumPy and SciPy's Gaussian filter.

The joints and pairs are written out again, and not imported: stored forests ask for channels by their place, so that a
change of the table or of its order has to be noticed here.
"""

import numpy as np
from scipy.ndimage import gaussian_filter1d

from dousa.motion.canonical.joints import JOINT_INDEX

RATE = 30.0
_POSE_SMOOTHING, _HEADING_SMOOTHING, _SLOW = 1.0, 8.0, 0.3
_PLANES = ((0, 1), (1, 2), (2, 0))
_PLACED = (
    "head", "neck", "left_shoulder", "right_shoulder", "left_elbow", "right_elbow", "left_hand", "right_hand",
    "left_knee", "right_knee", "left_ankle", "right_ankle",
)  # fmt: skip
_APART = (
    ("left_hand", "right_hand"), ("left_hand", "head"), ("right_hand", "head"), ("left_hand", "left_shoulder"),
    ("right_hand", "right_shoulder"), ("left_hand", "right_shoulder"), ("right_hand", "left_shoulder"),
    ("left_ankle", "right_ankle"), ("left_hip", "left_ankle"), ("right_hip", "right_ankle"),
    ("left_elbow", "right_elbow"),
)  # fmt: skip
_FAST = ("head", "left_elbow", "right_elbow", "left_hand", "right_hand", "left_ankle", "right_ankle")
_POINTING = ("left_hand", "right_hand")
_PLACED_INDEX = [JOINT_INDEX[joint] for joint in _PLACED]
_APART_FROM = [JOINT_INDEX[one] for one, _ in _APART]
_APART_TO = [JOINT_INDEX[other] for _, other in _APART]
_FAST_INDEX = [JOINT_INDEX[joint] for joint in _FAST]
_POINTING_INDEX = [JOINT_INDEX[joint] for joint in _POINTING]
_FEET = [JOINT_INDEX["left_ankle"], JOINT_INDEX["right_ankle"]]


def compute_channels(positions: np.ndarray, height: float) -> np.ndarray:
    """The channels of every frame.

    Parameters
    ----------
    positions : (n, 20, 3) m, canonical joints at ``RATE``, Y up, finite.
    height : m.

    Returns
    -------
    (n, C) in the order of ``CHANNELS``.
    """
    points = _smooth(positions, _POSE_SMOOTHING) / height
    posed = points - points[:, :1]
    left = _smooth(find_lateral_axis(posed), _HEADING_SMOOTHING)
    left /= np.maximum(np.hypot(left[:, 0], left[:, 1]), 1e-9)[:, None]
    body = _turn(posed, left)
    travel = _rate(points[:, :1])
    heading = np.unwrap(np.arctan2(-left[:, 1], left[:, 0]))
    apart = body[:, _APART_FROM] - body[:, _APART_TO]
    velocity = _rate(body)[:, _FAST_INDEX]
    even = _rate(_smooth(body, _POSE_SMOOTHING))
    pointing = even[:, _POINTING_INDEX]
    speed = np.sqrt(np.einsum("tjk,tjk->tj", pointing, pointing))
    return np.concatenate(
        [
            body[:, _PLACED_INDEX].reshape(len(points), -1),
            np.sqrt(np.einsum("tdk,tdk->td", apart, apart)),
            -body[:, _FEET, 1].min(axis=1, keepdims=True),
            _turn(travel, left)[:, 0],
            _rate(heading)[:, None],
            np.sqrt(np.einsum("tjk,tjk->tj", velocity, velocity)),
            _curving(even[:, _FAST_INDEX]),
            (pointing / np.maximum(speed, _SLOW)[:, :, None]).reshape(len(points), -1),
        ],
        axis=1,
    )


def find_lateral_axis(points: np.ndarray) -> np.ndarray:
    """(T, 2) unit x and z of the direction to the left of points (T, 20, 3) from the pelvis."""
    left, certain = _find_horizontal(points, "left_hip", "right_hip")
    shoulders, shoulders_certain = _find_horizontal(points, "left_shoulder", "right_shoulder")
    left = np.where(certain[:, None], left, shoulders)
    certain |= shoulders_certain
    if not certain.any():
        return np.broadcast_to([1.0, 0.0], left.shape)
    known = np.maximum.accumulate(np.where(certain, np.arange(len(points)), -1))
    return left[np.where(known < 0, certain.argmax(), known)]


def _find_horizontal(points: np.ndarray, tip: str, base: str) -> tuple[np.ndarray, np.ndarray]:
    line = points[:, JOINT_INDEX[tip]] - points[:, JOINT_INDEX[base]]
    length = np.hypot(line[:, 0], line[:, 2])
    whole = np.hypot(length, line[:, 1])
    certain = (whole > 1e-6) & (length >= 0.1 * whole)
    return line[:, ::2] / np.where(certain, length, 1.0)[:, None], certain


def _smooth(values: np.ndarray, deviation: float) -> np.ndarray:
    smooth: np.ndarray = gaussian_filter1d(values, deviation, axis=0, mode="nearest", truncate=3.0)
    return smooth


def _rate(values: np.ndarray) -> np.ndarray:
    """Central differences a second; 0 where there is one frame only."""
    return np.gradient(values, 1.0 / RATE, axis=0) if len(values) > 1 else np.zeros_like(values)


def _turn(points: np.ndarray, left: np.ndarray) -> np.ndarray:
    """(n, J, 3) with Y up to body axes: left, up, forward."""
    turned = np.empty_like(points)
    across, along = left[:, :1], left[:, 1:]
    x, z = points[:, :, 0], points[:, :, 2]
    turned[:, :, 0] = x * across + z * along
    turned[:, :, 1] = points[:, :, 1]
    turned[:, :, 2] = z * across - x * along
    return turned


def _curving(velocity: np.ndarray) -> np.ndarray:
    """(n, J * 3) for each joint and plane how fast the direction of its movement turns; less where it is slow."""
    columns = []
    for a, b in _PLANES:
        direction = np.unwrap(np.arctan2(velocity[:, :, b], velocity[:, :, a]), axis=0)
        turn = np.clip(_rate(direction), -RATE, RATE)
        speed = np.hypot(velocity[:, :, a], velocity[:, :, b])
        columns.append(turn * np.minimum(speed / _SLOW, 1.0))
    return np.stack(columns, axis=2).reshape(len(velocity), -1)
