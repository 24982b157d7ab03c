"""Slow literal kinematics with 4 x 4 matrices, one joint of one frame at a time."""

import math

import numpy as np


def axis_matrix(axis: str, angle: float) -> np.ndarray:
    c, s = math.cos(angle), math.sin(angle)
    return np.array(
        {
            "X": [[1, 0, 0], [0, c, -s], [0, s, c]],
            "Y": [[c, 0, s], [0, 1, 0], [-s, 0, c]],
            "Z": [[c, -s, 0], [s, c, 0], [0, 0, 1]],
        }[axis]
    )


def euler_matrix(angles, order: str) -> np.ndarray:
    matrix = np.eye(3)
    for axis, angle in zip(order, angles, strict=True):
        matrix = matrix @ axis_matrix(axis, angle)
    return matrix


def world_positions(parents, matrices, translations) -> np.ndarray:
    """(J, 3) from local rotation matrices (J, 3, 3) and translations (J, 3)."""
    frames = []
    for parent, rotation, translation in zip(parents, matrices, translations, strict=True):
        local = np.eye(4)
        local[:3, :3] = rotation
        local[:3, 3] = translation
        frames.append(local if parent < 0 else frames[parent] @ local)
    return np.array([frame[:3, 3] for frame in frames])
