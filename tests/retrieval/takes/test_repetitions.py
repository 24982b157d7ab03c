"""How often an action is repeated: made cycles are counted, single motions and rests are one."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from oracles.short_actions import make_clip
from oracles.standing import standing

from dousa.motion.canonical.joints import JOINT_INDEX
from dousa.retrieval.takes.label import Chosen, count_all
from dousa.retrieval.takes.made_takes import join_clips
from dousa.retrieval.takes.repetitions import correlate, count_repetitions, is_rest

HEIGHT = 1.7


def raise_arms(times, seconds=1.2, rest=0.0, noise=0.0):
    """Both hands up and down, with rests between."""
    draw = np.random.default_rng(times)
    up = 0.5 * (1.0 - np.cos(np.linspace(0.0, 2.0 * np.pi, round(seconds * 30), endpoint=False)))
    strength = np.tile(np.concatenate([up, np.zeros(round(rest * 30))]), times)
    body = np.repeat(standing(), len(strength), axis=0)
    for side in ("left", "right"):
        for joint, share in (("elbow", 0.5), ("wrist", 0.9), ("hand", 1.0)):
            body[:, JOINT_INDEX[f"{side}_{joint}"], 1] += share * strength
    return body + noise * draw.normal(size=body.shape)


@pytest.mark.parametrize("times", [1, 2, 3, 5, 8])
@pytest.mark.parametrize("options", [{}, {"noise": 0.005}, {"seconds": 0.7}, {"rest": 0.2}])
def test_made_cycles_are_counted(times, options):
    assert count_repetitions(raise_arms(times, **options), HEIGHT) == times


@pytest.mark.parametrize("action", ["bow", "kick", "raise left", "spread"])
def test_a_single_action_is_done_once(action):
    assert count_repetitions(make_clip(action, 1).positions, HEIGHT) == 1


@pytest.mark.parametrize("n_frames", [1, 5, 60])
def test_nothing_is_repeated_in_a_rest(n_frames):
    assert count_repetitions(np.repeat(standing(), n_frames, axis=0), HEIGHT) == 1


def test_the_correlation_is_that_of_its_definition():
    velocities = np.random.default_rng(0).normal(size=(40, 3))
    ours = correlate(velocities)
    assert ours[0] == pytest.approx(1.0)
    for lag in range(len(ours)):
        before, after = velocities[: 40 - lag], velocities[lag:]
        plain = (before * after).sum() / np.sqrt((before**2).sum() * (after**2).sum())
        assert ours[lag] == pytest.approx(plain)


def test_three_neighbours_without_a_rest_are_one_action_repeated():
    often, scores = raise_arms(6), np.ones(1, np.float32)
    edges = [round(len(often) * share / 3) for share in range(4)]
    parts = [Chosen(start, stop, 0, scores) for start, stop in pairwise(edges)]
    (one,) = count_all(parts, often, HEIGHT)
    assert (one.start, one.stop, one.repetitions) == (0, len(often), 6)
    assert [part.repetitions for part in count_all(parts[:2], often, HEIGHT)] == [2, 2]


def test_rests_part_what_is_repeated():
    clips = [make_clip("bow", 1, trial) for trial in range(3)]
    joined = join_clips(clips, np.random.default_rng(0))
    parts = [Chosen(round(p.start), round(p.stop), 0, np.ones(1, np.float32)) for p in joined.pieces]
    assert all(is_rest(joined.positions, HEIGHT, part.start) for part in parts[1:])
    assert [part.repetitions for part in count_all(parts, joined.positions, HEIGHT)] == [1, 1, 1]
