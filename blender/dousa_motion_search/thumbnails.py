# SPDX-License-Identifier: GPL-3.0-or-later
"""Small pictures of motions. No Blender in this module."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

SIZE = 96  # pixels

_POSES, _JOINTS = 24, 20
_ABSENT = -128  # stored of joints that the body lacks
# The chains of the twenty joints, as dousa orders them.
_TRUNK, _LEFT, _RIGHT = (
    [[0, 1, 2, 3]],
    [[2, 4, 5, 6, 7], [0, 12, 13, 14, 15]],
    [[2, 8, 9, 10, 11], [0, 16, 17, 18, 19]],
)
_COLOURS = ((0.85, 0.85, 0.85), (0.95, 0.55, 0.25), (0.35, 0.65, 0.95))  # trunk, left, right
_GHOSTS = ((0, 0.25), (23, 0.45))  # first and last pose, and how strong they are


def draw(miniature: bytes) -> np.ndarray:
    """A motion as a picture: its most telling pose, and faintly its first and last one.

    miniature: 1,456 bytes of the studio (float32 unit, duration, height, share of the loop; int8 (24, 20, 3)).
    Returns (SIZE, SIZE, 4) float32 from the bottom row up; nothing is drawn for a clip that is gone.
    """
    picture = np.zeros((SIZE, SIZE, 4), np.float32)
    header = np.frombuffer(miniature, "<f4", 4)
    poses = np.frombuffer(miniature, np.int8, offset=16).reshape(_POSES, _JOINTS, 3)[..., :2].astype(np.float32)
    if not poses.any():
        return picture
    there = np.flatnonzero(poses[0, :, 0] != _ABSENT)
    low, high = poses[:, there].reshape(-1, 2).min(axis=0), poses[:, there].reshape(-1, 2).max(axis=0)
    scale = (SIZE - 8) / max(float((high - low).max()), 1.0)
    places = (poses - 0.5 * (low + high)) * scale + SIZE / 2
    telling = round(float(np.clip(header[3], 0, 1)) * (_POSES - 1))
    for pose, strength in (*_GHOSTS, (telling, 1.0)):
        for chains, colour in zip((_TRUNK, _LEFT, _RIGHT), _COLOURS, strict=True):
            for chain in chains:
                for start, end in pairwise(joint for joint in chain if joint in there):
                    _draw_line(picture, places[pose, start], places[pose, end], colour, strength)
    return picture


def _draw_line(
    picture: np.ndarray, start: np.ndarray, end: np.ndarray, colour: tuple[float, float, float], strength: float
) -> None:
    """A line two pixels wide."""
    n_steps = int(2 * np.abs(end - start).max()) + 2
    points = start + np.linspace(0, 1, n_steps)[:, None] * (end - start)
    for offset in ((0, 0), (1, 0), (0, 1), (1, 1)):
        columns, rows = np.clip(points.astype(int) + offset, 0, SIZE - 1).T
        fresh = picture[rows, columns, 3] <= strength
        picture[rows[fresh], columns[fresh]] = (*colour, strength)
