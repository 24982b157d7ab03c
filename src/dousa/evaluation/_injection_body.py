"""A motion taken apart into what an error changes: place, directions of the bones, lengths of the bones.

Directions are edited as unit vectors, by slerp, so that there is no joint-angle trouble; positions are rebuilt
after that. "Heading-free" means turned so that the body's left is +X and its front +Z.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dousa.evaluation.posture import compute_segments
from dousa.evaluation.yaw import estimate_yaw, rotate_yaw
from dousa.motion._types import FloatArray
from dousa.motion.canonical import CanonicalMotion
from dousa.motion.joints import CANONICAL_PARENTS, JOINT_INDEX

__all__ = [
    "LIMB_BONES",
    "TRUNK_BONES",
    "Body",
    "Take",
    "find_bones",
    "measure_angles",
    "measure_segments",
    "prepare_take",
    "put_together",
    "rotate",
    "sample_body",
    "slerp",
    "smooth",
    "smooth_noise",
    "take_apart",
    "turn",
    "turn_onto",
]

_HEADING_S = 0.3  # smoothing of the heading: a twist of the shoulders is no turn of the body
_PARENTS = np.array(CANONICAL_PARENTS[1:])


def find_bones(*names: str) -> tuple[int, ...]:
    """Indices of the bones (0 to 18) that end in these joints."""
    return tuple(JOINT_INDEX[name] - 1 for name in names)


TRUNK_BONES = find_bones("spine", "neck", "left_shoulder", "right_shoulder", "left_hip", "right_hip")
LIMB_BONES: dict[str, tuple[int, ...]] = {
    f"{side}_{limb}": find_bones(*(f"{side}_{joint}" for joint in joints))
    for side in ("left", "right")
    for limb, joints in (("arm", ("elbow", "wrist", "hand")), ("leg", ("knee", "ankle", "toe")))
}


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """Place of the pelvis (T, 3) m, unit directions (T, 19, 3) and lengths (T, 19) m of the bones.

    Bone k runs from the parent of canonical joint k + 1 to that joint.
    """

    root: FloatArray
    directions: FloatArray
    lengths: FloatArray

    def cut(self, start: int, stop: int) -> Body:
        """The frames from ``start`` up to ``stop``."""
        return Body(self.root[start:stop], self.directions[start:stop], self.lengths[start:stop])


@dataclass(frozen=True, slots=True, eq=False)
class Take:
    """A clean motion, ready to be edited.

    Parameters
    ----------
    body : (T, ...).
    segments : (T, 9, 3) unit vectors, world.
    heading : (T,) rad about the vertical, unwrapped; turning by ``-heading`` makes the body face +Z.
    frame_rate : Hz.
    """

    body: Body
    segments: FloatArray
    heading: FloatArray
    frame_rate: float

    @property
    def n_frames(self) -> int:
        """Number of poses."""
        return len(self.segments)


def take_apart(positions: FloatArray) -> Body:
    """Canonical positions (T, 20, 3) m as place, directions and lengths; `put_together` is the inverse."""
    bones = positions[:, 1:] - positions[:, _PARENTS]
    lengths = np.linalg.norm(bones, axis=2)
    # A bone without length points down: its direction shows nowhere.
    directions = np.where(lengths[..., None] > 1e-9, bones, (0.0, -1.0, 0.0))
    return Body(positions[:, 0].copy(), _unit(directions), lengths)


def put_together(body: Body) -> FloatArray:
    """Canonical positions (T, 20, 3) m."""
    bones = body.directions * body.lengths[..., None]
    positions = np.empty((len(body.root), len(_PARENTS) + 1, 3))
    positions[:, 0] = body.root
    for bone, parent in enumerate(_PARENTS):
        positions[:, bone + 1] = positions[:, parent] + bones[:, bone]
    return positions


def prepare_take(motion: CanonicalMotion) -> Take:
    """Take a motion apart and find its heading."""
    positions = np.asarray(motion.positions, dtype=np.float64)
    joint = JOINT_INDEX
    across = (positions[:, joint["left_hip"]] - positions[:, joint["right_hip"]]) + (
        positions[:, joint["left_shoulder"]] - positions[:, joint["right_shoulder"]]
    )
    horizontal = smooth(np.stack([across[:, 2], across[:, 0]], axis=1), _HEADING_S * motion.frame_rate)
    heading = np.unwrap(np.arctan2(horizontal[:, 1], horizontal[:, 0]) - 0.5 * np.pi)
    return Take(take_apart(positions), measure_segments(positions), heading, motion.frame_rate)


def sample_body(body: Body, frames: FloatArray) -> Body:
    """The body at fractional frames (N,), held at its ends; directions stay unit vectors."""
    low, share = _neighbours(frames, len(body.root))
    high = np.minimum(low + 1, len(body.root) - 1)

    def mix(values: FloatArray) -> FloatArray:
        part = share.reshape(-1, *(1,) * (values.ndim - 1))
        return (1.0 - part) * values[low] + part * values[high]

    return Body(mix(body.root), _unit(mix(body.directions)), mix(body.lengths))


def _neighbours(frames: FloatArray, n_frames: int) -> tuple[np.ndarray, FloatArray]:
    inside = np.clip(frames, 0.0, n_frames - 1.0)
    low = inside.astype(np.intp)
    return low, inside - low


def _unit(vectors: FloatArray) -> FloatArray:
    norms = np.linalg.norm(vectors, axis=-1, keepdims=True)
    unit: FloatArray = vectors / np.maximum(norms, 1e-12)
    return unit


def slerp(start: FloatArray, end: FloatArray, share: FloatArray) -> FloatArray:
    """Unit vectors on the great circle from ``start`` to ``end`` (..., 3); ``share`` broadcasts to (..., 1)."""
    cosine = np.clip((start * end).sum(axis=-1, keepdims=True), -1.0, 1.0)
    across = end - cosine * start
    norms = np.linalg.norm(across, axis=-1, keepdims=True)
    # Opposite or equal vectors have no circle of their own: any one will do.
    spare = np.where(np.abs(start[..., :1]) < 0.9, (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    spare = spare - (spare * start).sum(axis=-1, keepdims=True) * start
    across = np.where(norms > 1e-9, across, spare)
    angle = np.arccos(cosine) * share
    return np.cos(angle) * start + np.sin(angle) * _unit(across)


def turn(vectors: FloatArray, angle: FloatArray) -> FloatArray:
    """Turn vectors (T, ..., 3) about the vertical by ``angle`` (T,) or () rad."""
    angle = np.asarray(angle)
    angle = angle.reshape(*angle.shape, *(1,) * (vectors.ndim - 1 - angle.ndim))
    cosine, sine = np.cos(angle), np.sin(angle)
    x, y, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    return np.stack([cosine * x + sine * z, np.broadcast_to(y, x.shape), cosine * z - sine * x], axis=-1)


def turn_onto(segments: FloatArray, target: FloatArray) -> FloatArray:
    """Turn each posture (T, 9, 3) about the vertical so that it agrees best with ``target`` (eq. 5-7)."""
    return rotate_yaw(segments, estimate_yaw(target, segments))


def measure_segments(positions: FloatArray) -> FloatArray:
    """`compute_segments`, with segments of no length pointing down."""
    segments = compute_segments(positions)
    return np.where(np.isnan(segments), (0.0, -1.0, 0.0), segments)


def rotate(vectors: FloatArray, axis: FloatArray, angle: FloatArray) -> FloatArray:
    """Rotate vectors (T, K, 3) about a unit axis (3,) by ``angle`` (T,) rad (Rodrigues)."""
    angle = angle[:, None, None]
    along = (vectors @ axis)[..., None] * axis
    return vectors * np.cos(angle) + np.cross(axis, vectors) * np.sin(angle) + along * (1.0 - np.cos(angle))


def measure_angles(a: FloatArray, b: FloatArray) -> FloatArray:
    """Angles in degrees between unit vectors (..., 3)."""
    # The chord is exact for small angles, where the cosine is not.
    chord = np.linalg.norm(a - b, axis=-1)
    angles: FloatArray = np.degrees(2.0 * np.arcsin(np.clip(0.5 * chord, 0.0, 1.0)))
    return angles


def smooth(values: FloatArray, sigma: float) -> FloatArray:
    """Gaussian smoothing over axis 0, ``sigma`` in frames; ends are mirrored."""
    reach = min(int(4.0 * sigma) + 1, len(values) - 1)
    if sigma <= 0.0 or reach < 1:
        return values
    offsets = np.arange(-reach, reach + 1)
    kernel = np.exp(-0.5 * (offsets / sigma) ** 2)
    kernel /= kernel.sum()
    padded = np.concatenate([values[reach:0:-1], values, values[-2 : -reach - 2 : -1]])
    columns = padded.reshape(len(padded), -1)
    smoothed = np.stack([np.convolve(column, kernel, mode="valid") for column in columns.T], axis=1)
    return smoothed.reshape(values.shape)


def smooth_noise(
    n_frames: int, shape: tuple[int, ...], correlation_frames: float, rng: np.random.Generator
) -> FloatArray:
    """Gaussian noise (n_frames, *shape) of variance 1 whose autocorrelation falls to 1/e in the given time."""
    sigma = max(0.5 * correlation_frames, 1e-3)  # of the kernel; autocorrelation exp(-t^2 / 4 sigma^2)
    length = n_frames + int(8.0 * sigma) + 2
    white = rng.standard_normal((length, *shape))
    response = np.exp(-0.5 * (2.0 * np.pi * np.fft.rfftfreq(length) * sigma) ** 2)
    mirrored = response[1 : (length + 1) // 2]
    power = (response @ response + mirrored @ mirrored) / length
    spectrum = np.fft.rfft(white, axis=0) * response.reshape(-1, *(1,) * len(shape))
    noise: FloatArray = np.fft.irfft(spectrum, n=length, axis=0)[:n_frames] / np.sqrt(power)
    return noise
