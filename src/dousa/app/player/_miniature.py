"""A motion as a tiny loop for thumbnails: a kilobyte and a half, whatever its length."""

from __future__ import annotations

import numpy as np

from dousa.app.player._figures import FEET, HIPS, Posed, interpolate, mean_heading, read_figure, turn_about_y
from dousa.motion.joints import CANONICAL_JOINTS

__all__ = ["MINIATURE_BYTES", "MINIATURE_FRAMES", "encode_miniature"]

MINIATURE_FRAMES = 24
"""Poses of a loop."""
_HEADER_BYTES = 16
MINIATURE_BYTES = _HEADER_BYTES + MINIATURE_FRAMES * len(CANONICAL_JOINTS) * 3
"""Length of every loop, 1,456."""
_FACING = -0.6  # rad: on average the body looks past the viewer, to the left of the picture
_STEPS = 127


def encode_miniature(motion: Posed) -> bytes:
    """A motion as a loop of 24 poses, evenly spread over the whole of it, in place, in a three-quarter view.

    Parameters
    ----------
    motion : canonical joints; gaps are bridged.

    Returns
    -------
    1,456 bytes, little-endian:

    ====== ============ =====================================================================================
    offset type         what
    ====== ============ =====================================================================================
    0      float32      metres per unit of the positions
    4      float32      duration, s, from the first pose to the last
    8      float32      height, m over the floor, where y is 0
    12     float32      the most telling pose (farthest from the mean pose), as a share of the loop, 0 to 1
    16     int8 x 1,440 positions (24, 20, 3): poses, canonical joints, x right, y up, z to the viewer, from
                        the point over the middle of the hips; -127 to 127
    ====== ============ =====================================================================================

    Raises
    ------
    InvalidMotionError : no frame, or anything but 20 canonical joints.
    """
    figure = read_figure(motion)
    poses = interpolate(figure.positions, np.linspace(0, figure.n_frames - 1, MINIATURE_FRAMES))
    turn_about_y(poses, _FACING - mean_heading(poses))
    hips = 0.5 * (poses[:, HIPS[0]] + poses[:, HIPS[1]])
    poses[..., [0, 2]] -= hips[:, None, [0, 2]]
    poses[..., 1] -= poses[:, FEET, 1].min()
    middle = 0.5 * (poses[..., 1].min() + poses[..., 1].max())
    away = poses - poses.mean(axis=0)
    still = np.einsum("tjk,tjk->t", away, away).argmax() / (MINIATURE_FRAMES - 1)
    poses[..., 1] -= middle
    unit = max(float(np.abs(poses).max()), 1e-3) / _STEPS
    duration = (figure.n_frames - 1) / figure.frame_rate
    header = np.array([unit, duration, middle, still], "<f4")
    return header.tobytes() + np.rint(poses / unit).astype(np.int8).tobytes()
