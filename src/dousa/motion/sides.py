"""Which side of a body is left, told by its geometry and not by names.

A body has a front: toes point there, knees bend that way and elbows the other, hands work there. Together with
the trunk that fixes left and right in right-handed axes. Measured on real recordings (UTD-MHAD from a Kinect,
HDM05, Bandai-Namco 2) the toes alone are right in 99.3 to 100 % of the clips; the other signs settle the rest.
"""

from __future__ import annotations

import numpy as np

from dousa.motion._types import FloatArray
from dousa.motion.joints import CANONICAL_JOINTS
from dousa.motion.joints import JOINT_INDEX as J

__all__ = ["compare_sides", "compute_forward", "score_sides"]

_CLEAR = 0.08  # below this score the geometry is said to be unclear
_MAX_FRAMES = 32
_SLACK = 0.05  # a limb straighter than this share of its length has no bend worth counting

# Weights that make one toe-length, one bent knee ... comparable; forward parts are in trunk lengths.
_TOE, _HAND, _KNEE, _ELBOW = 4.0, 0.5, 2.0, 1.0


def _rows(*terms: tuple[float, str]) -> FloatArray:
    row = np.zeros(len(CANONICAL_JOINTS))
    for weight, name in terms:
        row[J[name]] += weight
    return row


# Across hips and shoulders; the trunk; mean foot; mean reach of the arms; then for both legs and both arms the
# upper bone (hip to knee, shoulder to elbow) and the whole limb.
_ROWS = np.stack(
    [
        _rows((1, "left_hip"), (-1, "right_hip")),
        _rows((1, "left_shoulder"), (-1, "right_shoulder")),
        _rows((1, "neck"), (-1, "pelvis")),
        _rows((0.5, "left_toe"), (0.5, "right_toe"), (-0.5, "left_ankle"), (-0.5, "right_ankle")),
        _rows((0.5, "left_wrist"), (0.5, "right_wrist"), (-0.5, "left_shoulder"), (-0.5, "right_shoulder")),
        *(
            _rows((1, f"{side}_{end}"), (-1, f"{side}_{start}"))
            for ends in (("knee", "elbow"), ("ankle", "wrist"))
            for start, end in zip(("hip", "shoulder"), ends, strict=True)
            for side in ("left", "right")
        ),
    ]
)
_OUTWARD_WEIGHTS = np.array([_TOE, _HAND])
_BEND_WEIGHTS = 0.5 * np.array([_KNEE, _KNEE, -_ELBOW, -_ELBOW])


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Cross product (..., 3), several times faster than numpy's on small arrays."""
    result = np.empty(np.broadcast(a, b).shape)
    result[..., 0] = a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1]
    result[..., 1] = a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2]
    result[..., 2] = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return result


def _forward(vectors: FloatArray, sizes: FloatArray) -> FloatArray:
    """Unit vectors (T, 3) to the front, from the rows of `_ROWS` (T, 13, 3) and their lengths."""
    across = vectors[:, :2] / sizes[:, :2, None]
    forward = _cross(across[:, 0] + across[:, 1], vectors[:, 2])
    size = np.sqrt(np.einsum("tk,tk->t", forward, forward))
    size[size == 0] = np.nan
    return forward / size[:, None]


def _measure(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The vectors of `_ROWS` (T, 13, 3) and their lengths (T, 13), NaN instead of 0."""
    vectors = _ROWS @ points
    sizes = np.sqrt(np.einsum("tjk,tjk->tj", vectors, vectors))
    sizes[sizes == 0] = np.nan
    return vectors, sizes


def compute_forward(points: FloatArray) -> FloatArray:
    """Unit vectors (T, 3) to the front of the body if left is left and the axes are right-handed; NaN if unclear."""
    return _forward(*_measure(points))


def score_sides(points: FloatArray) -> float:
    """How clearly the named left is the geometrical left.

    Parameters
    ----------
    points : (T, 20, 3) canonical points in right-handed axes, any unit; at most 32 frames, evenly spread, are used.

    Returns
    -------
    Around +1 if they agree, around -1 if the body looks mirrored, near 0 if nothing tells (0 if nothing is seen).
    """
    if len(points) > _MAX_FRAMES:
        points = points[np.linspace(0, len(points) - 1, _MAX_FRAMES).round().astype(np.intp)]
    vectors, sizes = _measure(points)
    ahead = np.einsum("tjk,tk->tj", vectors, _forward(vectors, sizes))
    # How far the knee or elbow is off the line from hip to ankle or shoulder to wrist, to the front.
    upper, whole = slice(5, 9), slice(9, 13)
    share = np.einsum("tjk,tjk->tj", vectors[:, upper], vectors[:, whole]) / sizes[:, whole] ** 2
    bend = (ahead[:, upper] - share * ahead[:, whole]) / (2.0 * sizes[:, upper])
    bend -= np.clip(bend, -_SLACK, _SLACK)
    bend[np.isnan(bend)] = 0.0  # a bone of no length does not bend
    scores = (ahead[:, 3:5] @ _OUTWARD_WEIGHTS) / sizes[:, 2] + bend @ _BEND_WEIGHTS
    total = float(scores.mean())
    if np.isnan(total):
        scores = scores[~np.isnan(scores)]
        total = float(scores.mean()) if len(scores) else 0.0
    return total


def compare_sides(points: FloatArray) -> str:
    """Whether the named left and right are the geometrical ones: ``"agree"``, ``"disagree"`` or ``"unclear"``."""
    score = score_sides(points)
    if abs(score) < _CLEAR:
        return "unclear"
    return "agree" if score > 0 else "disagree"
