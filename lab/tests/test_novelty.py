"""The experiment with unknown motions and new categories: on made motions whose answer is plain."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from dousa.app.tables.lines import print_tables
from dousa.errors import OptionError, TrainingError
from dousa.motion.canonical.joints import CANONICAL_JOINTS, JOINT_INDEX
from dousa.retrieval import LabelledClip
from lab.novelty.experiment import run_novelty_experiment

MOVED = (
    "left_hand",
    "right_hand",
    "left_ankle",
    "right_ankle",
    "head",
    "left_elbow",
    "right_elbow",
    "right_knee",
)


def make_clip(category: int, performer: int, seed: int) -> LabelledClip:
    """One joint swings up, a little differently each time."""
    rng = np.random.default_rng([category, performer, seed])
    frames = int(rng.integers(30, 50))
    pose = np.zeros((len(CANONICAL_JOINTS), 3))
    for number, joint in enumerate(CANONICAL_JOINTS):
        side = 0.2 if joint.startswith("left") else -0.2 if joint.startswith("right") else 0.0
        pose[number] = side, 1.0 + 0.04 * number * (-1) ** number, 0.02 * performer
    positions = np.repeat(pose[None], frames, axis=0) + 0.005 * rng.normal(size=(frames, len(pose), 3))
    swing = np.sin(np.linspace(0, np.pi, frames)) * rng.uniform(0.3, 0.5)
    positions[:, JOINT_INDEX[MOVED[category]], 1] += swing
    return LabelledClip(f"{category}-{performer}-{seed}", MOVED[category], f"p{performer}", positions, 30.0, 1.7)


CLIPS = [make_clip(c, p, k) for c in range(8) for p in range(3) for k in range(3)]
OPTIONS = {"repeats": 1, "n_trees": 20}


@pytest.fixture(scope="module")
def result():
    return run_novelty_experiment(CLIPS, **OPTIONS)


@pytest.fixture(scope="module")
def answer(result):
    return result.to_json()


def test_plain_motions_are_told(answer):
    unknown = answer["unknown"]
    assert answer["split"] == "leave-performer-out"
    assert unknown["n_trials"] == 3
    assert unknown["auroc"] > 0.9
    assert unknown["accuracy"] > 0.9
    thresholds, alarms, misses = zip(*unknown["curve"], strict=True)
    assert thresholds[4] == 0.5
    # What is less sure than that is called unknown, and what is as sure but unlike all that is known.
    assert alarms[4] <= unknown["false_alarms"] and misses[4] >= unknown["misses"]
    assert sorted(alarms) == list(alarms)
    assert sorted(misses, reverse=True) == list(misses)


def test_new_categories_are_taken_up(answer):
    rows = {row["forest"]: row for row in answer["new"] if row["n_new"] == 1}
    assert rows["before"]["recall_new"] == 0.0
    assert rows["grown"]["recall_new"] > 0.8
    assert rows["grown"]["accuracy"] > rows["trained anew"]["accuracy"] - 0.05
    assert rows["grown"]["called_unknown"] < rows["before"]["called_unknown"]


def test_one_seed_gives_one_answer_however_many_workers(answer):
    again = run_novelty_experiment(CLIPS, **OPTIONS, n_jobs=2).to_json()

    def without_times(data):
        if isinstance(data, dict):
            return {key: without_times(value) for key, value in data.items() if "seconds" not in key}
        return [without_times(value) for value in data] if isinstance(data, list | tuple) else data

    assert without_times(again) == without_times(answer)


def test_without_performers_half_of_the_clips_are_tested():
    told: list[str] = []
    nobody = [replace(clip, performer=None) for clip in CLIPS]
    result = run_novelty_experiment(nobody, **OPTIONS, progress=lambda *what: told.append(what[2].code))
    assert result.split == "half"
    assert told == ["trial_progress.features", "trial_progress.half", "trial_progress.done"]


def test_its_tables_and_json(result, answer):
    console = Console(width=120, record=True)
    print_tables(console, result.to_tables())
    text = console.export_text()
    for words in ("AUROC", "known called unknown", "retrained", "72 clips of 8 categories"):
        assert words in text
    assert json.loads(json.dumps(answer))["n_categories"] == 8


def test_refusals():
    with pytest.raises(TrainingError, match="at least 6 categories"):
        run_novelty_experiment(CLIPS[:20])
    with pytest.raises(TrainingError, match="got 0"):
        run_novelty_experiment([])
    with pytest.raises(OptionError, match="repeats: expected 1 or more"):
        run_novelty_experiment(CLIPS, repeats=0)
    with pytest.raises(OptionError, match="features"):
        run_novelty_experiment(CLIPS, feature_set="other")
