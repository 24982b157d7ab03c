"""A small world of actions: performers of different height and noise, who raise arms, kick, bow and wave."""

import functools

import numpy as np
from oracles.standing import standing

from dousa.motion.canonical.joints import JOINT_INDEX as J
from dousa.retrieval.features.posed_motion import LabelledClip
from dousa.retrieval.takes.labeller_training import train_labeller
from dousa.retrieval.takes.made_takes import join_clips

ACTIONS = ("bow", "kick", "raise left", "raise right", "spread", "wave")
RATE = 30.0


def make_clip(action, performer=0, trial=0, seconds=None, frame_rate=RATE):
    """An action from rest to rest, of about two seconds, with a little noise of its own."""
    draw = np.random.default_rng([ACTIONS.index(action), performer, trial])
    length = seconds or draw.uniform(1.6, 2.4)
    count = round(length * frame_rate)
    phase = (np.arange(count) + 0.5) / count
    strength = np.sin(np.pi * phase) ** 2 * draw.uniform(0.9, 1.1)
    size = 1.0 + 0.05 * (performer % 3)
    body = np.repeat(standing(), count, axis=0)
    swing = 0.12 * np.sin(6 * np.pi * phase)
    for joint, way in _ways(action):
        for axis in range(3):
            body[:, J[joint], axis] += strength * way[axis]
    if action == "wave":
        body[:, [J["right_hand"], J["right_wrist"]], 0] += (strength * swing)[:, None]
    sway = 0.004 * np.cumsum(draw.normal(size=(count, 1, 3)), axis=0) / np.sqrt(count)
    body = (body + sway + 0.001 * draw.normal(size=body.shape)) * size
    return LabelledClip(f"{action} {performer} {trial}", action, str(performer), body, frame_rate, 1.7 * size)


def _ways(action):
    """Joints and where they go at the height of an action, m."""
    if action == "raise left":
        return _arm("left", (0.1, 1.0, 0.1))
    if action == "raise right":
        return _arm("right", (-0.1, 1.0, 0.1))
    if action == "spread":
        return _arm("left", (0.6, 0.5, 0.0)) + _arm("right", (-0.6, 0.5, 0.0))
    if action == "wave":
        return _arm("right", (-0.3, 0.8, 0.3))
    if action == "kick":
        return [(f"right_{part}", [0.0, 0.4 * share, 0.6 * share]) for part, share in _LEG]
    upper = ("neck", "head", "left_shoulder", "right_shoulder", "left_hand", "right_hand")
    return [(part, [0.0, -0.3, 0.4]) for part in (*upper, "left_elbow", "right_elbow")]


_ARM = (("elbow", 0.5), ("wrist", 0.9), ("hand", 1.0))
_LEG = (("knee", 0.5), ("ankle", 1.0), ("toe", 1.1))


def _arm(side, way):
    return [(f"{side}_{part}", [share * v for v in way]) for part, share in _ARM]


def make_library(performers=(0, 1, 2), trials=3):
    """All actions, by some performers, a few times each."""
    return [make_clip(a, p, t) for p in performers for a in ACTIONS for t in range(trials)]


@functools.cache
def shown_take():
    """Every action once, by somebody who is not in the library."""
    return join_clips([make_clip(action, 7) for action in ACTIONS], np.random.default_rng(3))


@functools.cache
def learned_labeller():
    """What learned from the library; made when a test asks, once in a process."""
    return train_labeller(make_library())
