"""The trial of long takes: joined takes have no jumps and a known truth, and the result is plain and repeatable."""

import json
from itertools import pairwise

import numpy as np
import pytest
from oracles.short_actions import ACTIONS, make_clip, make_library

from dousa.errors import OptionError, TrainingError
from dousa.experiments.takes import (
    AS_RECORDED,
    BOTH,
    FRAMEWISE,
    KNOWN_QUERIES,
    NEW_QUERIES,
    OTHER_TEMPO,
    OURS,
    WITH_UNKNOWN,
    run_takes_experiment,
)
from dousa.messages import Message
from dousa.retrieval.takes.made_takes import join_clips, shuffle_into_takes

CLIPS = make_library((0, 1, 2), 3)


def test_joined_takes_have_no_jumps_and_known_pieces():
    clips = [make_clip(action, 3) for action in ACTIONS]
    take = join_clips(clips, np.random.default_rng(0))
    steps = np.abs(np.diff(take.positions, axis=0)).max(axis=(1, 2))
    alone = max(np.abs(np.diff(clip.positions, axis=0)).max() for clip in clips)
    assert steps.max() <= 1.2 * alone
    assert [piece.category for piece in take.pieces] == list(ACTIONS)
    assert take.pieces[0].start == 0
    assert take.pieces[-1].stop == len(take.positions)
    assert all(a.stop == b.start for a, b in pairwise(take.pieces))
    blends = len(take.positions) - sum(len(clip.positions) for clip in clips)
    assert 9 * 5 <= blends <= 15 * 5


def test_joining_keeps_the_clip_but_for_a_turn_and_a_shift():
    clips = [make_clip("bow", 3), make_clip("kick", 3)]
    take = join_clips(clips, np.random.default_rng(0))
    count = len(clips[1].positions)
    moved, first = take.positions[-count:], clips[1].positions
    np.testing.assert_allclose(moved[..., 1], first[..., 1], atol=1e-12)
    apart = np.linalg.norm(moved[:, :, None] - moved[:, None], axis=3)
    np.testing.assert_allclose(apart, np.linalg.norm(first[:, :, None] - first[:, None], axis=3), atol=1e-9)
    alone = join_clips(clips[:1], np.random.default_rng(0))
    np.testing.assert_allclose(alone.positions, clips[0].positions, atol=1e-12)
    double = join_clips(clips[:1], np.random.default_rng(0), tempos=[2.0])
    assert len(double.positions) == round(len(clips[0].positions) / 2)
    with pytest.raises(TrainingError, match="clips to join"):
        join_clips([], np.random.default_rng(0))


def test_takes_are_of_one_performer_and_use_every_clip_once():
    groups = shuffle_into_takes(CLIPS, np.random.default_rng(0), 5)
    assert sorted(k for group in groups for k in group) == list(range(len(CLIPS)))
    assert all(len({CLIPS[k].performer for k in group}) == 1 for group in groups)


@pytest.mark.slow
def test_takes_of_somebody_new_are_labelled_and_searched():
    steps = []
    result = run_takes_experiment(CLIPS, n_trees=30, n_queries=6, progress=lambda *step: steps.append(step))
    assert set(result.labelled) == {AS_RECORDED, OTHER_TEMPO, WITH_UNKNOWN, BOTH}
    ours, plain = result.labelled[AS_RECORDED][OURS], result.labelled[AS_RECORDED][FRAMEWISE]
    assert ours.frame_accuracy > 0.8
    assert ours.f_measure > plain.f_measure
    assert result.found[KNOWN_QUERIES].mean_average_precision > 0.8
    assert result.found[NEW_QUERIES].n_queries == 18
    assert result.performers == ("0", "1", "2")
    assert steps[-1] == (6, 6, Message("trial_progress.done"))
    said = json.loads(json.dumps(result.to_json()))
    assert said["labelled"][AS_RECORDED][OURS]["n_events"] == len(CLIPS)
    again = run_takes_experiment(CLIPS, n_trees=30, n_queries=6, n_jobs=2).to_json()
    for changing in ("seconds", "label_frames_per_second"):
        del said[changing], again[changing]
    assert said == json.loads(json.dumps(again))


def test_impossible_trials_are_refused():
    with pytest.raises(OptionError, match="set_aside"):
        run_takes_experiment(CLIPS, set_aside=1.0)
    with pytest.raises(TrainingError):
        run_takes_experiment([clip for clip in CLIPS if clip.performer == "0"])
