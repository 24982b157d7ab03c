"""Slow, literal answers: frame by frame, one question at a time, straight from the definitions."""

import math

import numpy as np

from dousa.motion.canonical.joints import JOINT_INDEX


def hysteresis(weak: list[bool], strong: list[bool]) -> list[bool]:
    """An answer that a strong yes switches on and a weak no switches off."""
    state, answers = False, []
    for is_weak, is_strong in zip(weak, strong, strict=True):
        if is_strong:
            state = True
        elif not is_weak:
            state = False
        answers.append(state)
    return answers


def median_length(positions: np.ndarray, one: str, other: str) -> float:
    lengths = [math.dist(frame[JOINT_INDEX[one]], frame[JOINT_INDEX[other]]) for frame in positions]
    return float(np.median(lengths))


def humerus(positions: np.ndarray) -> float:
    return 0.5 * sum(median_length(positions, f"{s}_shoulder", f"{s}_elbow") for s in ("left", "right"))


def smoothed(points: list[np.ndarray], half: int) -> list[np.ndarray]:
    """Mean of 2 half + 1 frames; beyond the ends the end frames are repeated."""
    last = len(points) - 1
    return [
        sum(points[min(max(k, 0), last)] for k in range(t - half, t + half + 1)) / (2 * half + 1)
        for t in range(len(points))
    ]


def velocities(points: list[np.ndarray], rate: float, window: float) -> list[np.ndarray]:
    """Central differences inside, one-sided at the ends."""
    if len(points) == 1:
        return [np.zeros(3)]
    soft = smoothed(points, round(window * rate) // 2)
    last = len(points) - 1
    return [
        (soft[min(t + 1, last)] - soft[max(t - 1, 0)]) * rate / (min(t + 1, last) - max(t - 1, 0))
        for t in range(len(points))
    ]


def unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)


def hand_moving_forwards(positions: np.ndarray, rate: float, side: str) -> list[bool]:
    """F1, F2: speed of the wrist from the neck along the normal of the plane neck - hips, 250 ms window."""
    j = JOINT_INDEX
    relative = [frame[j[f"{side}_wrist"]] - frame[j["neck"]] for frame in positions]
    speeds = []
    for frame, velocity in zip(positions, velocities(relative, rate, 0.25), strict=True):
        middle = 0.5 * (frame[j["left_hip"]] + frame[j["right_hip"]])
        lateral = unit(frame[j["left_hip"]] - frame[j["right_hip"]])
        speeds.append(float(velocity @ unit(np.cross(lateral, frame[j["neck"]] - middle))))
    arm = humerus(positions)
    return hysteresis([v > 1.3 * arm for v in speeds], [v > 1.8 * arm for v in speeds])


def elbow_bent(positions: np.ndarray, side: str) -> list[bool]:
    """F7, F8: the inner angle at the elbow is below 110 (stays until 120) degrees."""
    j = JOINT_INDEX
    angles = []
    for frame in positions:
        elbow = frame[j[f"{side}_elbow"]]
        upper, lower = frame[j[f"{side}_shoulder"]] - elbow, frame[j[f"{side}_wrist"]] - elbow
        angles.append(math.degrees(math.acos(np.clip(unit(upper) @ unit(lower), -1, 1))))
    return hysteresis([a < 120 for a in angles], [a < 110 for a in angles])


def hand_fast(positions: np.ndarray, rate: float, side: str) -> list[bool]:
    """F13, F14: speed of the wrist above 2.5 (stays until 2.0) upper arms per second."""
    wrist = [frame[JOINT_INDEX[f"{side}_wrist"]] for frame in positions]
    speeds = [float(np.linalg.norm(v)) for v in velocities(wrist, rate, 0.1)]
    arm = humerus(positions)
    return hysteresis([v > 2.0 * arm for v in speeds], [v > 2.5 * arm for v in speeds])
