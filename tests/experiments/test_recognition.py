"""The experiment: four systems on the same splits, its JSON, its refusals."""

import json
from dataclasses import replace

import numpy as np
import pytest

from dousa.errors import OptionError, TrainingError
from dousa.experiments.recognition import SYSTEMS, ExperimentResult, run_experiment
from dousa.messages import Message
from dousa.motion.canonical.joints import JOINT_INDEX
from dousa.retrieval.features.posed_motion import LabelledClip

J = JOINT_INDEX
SCORES = ("recall", "precision", "f_measure", "accuracy")


def figure() -> np.ndarray:
    """(20, 3) a standing person, crude but with every joint in its place."""
    pose = np.zeros((20, 3))
    heights = {"pelvis": 0.95, "spine": 1.15, "neck": 1.45, "head": 1.7}
    for name, y in heights.items():
        pose[J[name], 1] = y
    parts = {"shoulder": 1.4, "elbow": 1.1, "wrist": 0.85, "hand": 0.75, "hip": 0.9, "knee": 0.5, "ankle": 0.1}
    for side, x in (("left", 0.18), ("right", -0.18)):
        for part, y in parts.items():
            pose[J[f"{side}_{part}"]] = (x, y, 0.0)
        pose[J[f"{side}_toe"]] = (x, 0.02, 0.15)
    return pose


def make_clip(category: str, performer: str | None, seed: int) -> LabelledClip:
    """Raise the right hand, raise the left hand, squat or stand, each a little different."""
    generator = np.random.default_rng(seed)
    frames = int(generator.integers(40, 70))
    bell = np.sin(np.linspace(0, np.pi, frames))[:, None] * generator.uniform(0.9, 1.1)
    motion = np.repeat(figure()[None], frames, axis=0)
    if category in ("right", "left"):
        for part, lift in {"elbow": 0.5, "wrist": 1.0, "hand": 1.15}.items():
            motion[:, J[f"{category}_{part}"], 1] += (bell * lift)[:, 0]
    elif category == "squat":
        for name, index in J.items():
            if not any(part in name for part in ("ankle", "toe")):
                motion[:, index, 1] -= 0.4 * bell[:, 0] * (0.5 if "knee" in name else 1.0)
        for side in ("left", "right"):
            motion[:, J[f"{side}_knee"], 2] += 0.3 * bell[:, 0]
    motion += generator.normal(0, 0.003, motion.shape)
    return LabelledClip(f"{category}-{seed}", category, performer, motion, 30.0, 1.68)


def clips(
    categories: str = "right left squat stand", performers: str = "al bo cy", each: int = 2
) -> list[LabelledClip]:
    return [
        make_clip(category, performer, seed=97 * c + 13 * p + k)
        for c, category in enumerate(categories.split())
        for p, performer in enumerate(performers.split())
        for k in range(each)
    ]


@pytest.fixture(scope="module")
def half() -> ExperimentResult:
    return run_experiment(clips(each=4), repeats=2, n_trees=10)


def test_easy_motions_are_all_told_apart(half: ExperimentResult) -> None:
    assert set(half.systems) == set(SYSTEMS)
    assert half.systems["forest"].scores.f_measure == 1.0
    assert half.systems["motion_templates"].scores.accuracy == 1.0
    # With so few clips some test of mere noise splits them as well as a good one, so one tree is worse.
    assert half.systems["full_tree"].scores.recall > 0.4
    assert (half.n_train, half.n_test) == (24, 24)


def test_json_has_the_promised_keys(half: ExperimentResult) -> None:
    answer = json.loads(json.dumps(half.to_json()))
    assert set(answer["systems"]) == {"forest", "full_tree", "random_tree", "motion_templates"}
    for system in answer["systems"].values():
        assert all(0 <= system[name] <= 1 and system[f"{name}_std"] >= 0 for name in SCORES)
        assert system["fit_seconds"] > 0 and system["query_seconds"] > 0
    assert answer["n_train"] == 24 and answer["n_test"] == 24
    assert answer["categories"] == ["left", "right", "squat", "stand"]
    assert answer["split"] == "half" and answer["repeats"] == 2


def without_times(result: ExperimentResult) -> dict:
    answer = result.to_json()
    return {
        name: {key: value for key, value in system.items() if "seconds" not in key}
        for name, system in answer["systems"].items()
    }


def test_the_seed_decides_and_the_workers_do_not(half: ExperimentResult) -> None:
    again = run_experiment(clips(each=4), repeats=2, n_trees=10, n_jobs=2)
    assert without_times(again) == without_times(half)


def test_performers_are_left_out_and_pooled() -> None:
    result = run_experiment(clips(), split="leave-performer-out", repeats=2, n_trees=5)
    assert (result.n_train, result.n_test) == (16, 24)
    forest = result.systems["forest"]
    assert [(fold.name, fold.n_train, fold.n_test) for fold in forest.folds] == [
        ("al", 16, 8),
        ("bo", 16, 8),
        ("cy", 16, 8),
    ]
    # Equal folds with equal categories: the pooled accuracy is the mean of the folds'.
    mean = np.mean([fold.scores.accuracy for fold in forest.folds])
    assert forest.scores.accuracy == pytest.approx(mean)
    templates = result.systems["motion_templates"]
    assert not templates.repeats_differ and templates.spread.f_measure == 0.0
    assert forest.repeats_differ


def test_given_test_clips_and_a_category_never_trained() -> None:
    train, test = clips("right left squat", "al"), clips("right squat stand", "bo")
    result = run_experiment(train, test_clips=test, n_trees=5)
    assert (result.n_train, result.n_test, result.split) == (6, 6, "given")
    assert result.untrained == {"stand": 2} and result.untested == ("left",)
    forest = result.systems["forest"]
    assert forest.scores.accuracy <= 4 / 6 and forest.spread is None
    assert any(one.truth == "stand" for one in forest.confusions)
    assert result.to_json()["systems"]["forest"]["recall_std"] is None


def test_predictions_do_not_depend_on_the_labels_of_the_test_clips() -> None:
    """If all test clips are said to be one category, the accuracy is how often it is named: these sum to 1."""
    train, test = clips(performers="al"), clips(performers="bo cy")
    named = dict.fromkeys(SYSTEMS, 0.0)
    for category in ("right", "left", "squat", "stand"):
        said = [replace(clip, category=category) for clip in test]
        result = run_experiment(train, test_clips=said, n_trees=7)
        for system, answer in result.systems.items():
            named[system] += answer.scores.accuracy
    assert named == pytest.approx(dict.fromkeys(SYSTEMS, 1.0))


def test_a_category_with_one_clip_trains_only() -> None:
    result = run_experiment([*clips("right left", "al", 4), make_clip("squat", "al", 5)], n_trees=3)
    assert result.untested == ("squat",) and result.n_train == 5


def test_a_category_only_one_performer_shows_counts_as_wrong() -> None:
    material = [*clips("right left", "al bo"), *clips("squat", "al")]
    result = run_experiment(material, split="leave-performer-out", systems=["motion_templates"])
    assert result.untrained == {"squat": 2}
    assert result.systems["motion_templates"].scores.accuracy <= 8 / 10


def test_some_systems_only_and_progress() -> None:
    heard: list[tuple[int, int, Message]] = []
    result = run_experiment(
        clips("right left"),
        split="leave-performer-out",
        systems=["full_tree", "random_tree"],
        repeats=2,
        progress=lambda done, total, doing: heard.append((done, total, doing)),
    )
    assert list(result.systems) == ["full_tree", "random_tree"]
    counts = [done for done, _, _ in heard]
    assert counts == sorted(counts) and heard[-1][:2] == (12, 12) and heard[-1][2].code == "trial_progress.done"


def test_an_interrupt_passes() -> None:
    def stop(done: int, total: int, doing: Message) -> None:
        if done == 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_experiment(clips("right left"), systems=["random_tree"], repeats=3, progress=stop)


def test_clips_that_cannot_train_are_refused() -> None:
    with pytest.raises(TrainingError, match="train on, got none"):
        run_experiment([])
    with pytest.raises(TrainingError, match="test on, got none"):
        run_experiment(clips(), test_clips=[])
    with pytest.raises(TrainingError, match="at least two categories"):
        run_experiment(clips("right"))
    with pytest.raises(TrainingError, match="-0: expected a category"):
        run_experiment([make_clip("", "al", 0)])
    with pytest.raises(TrainingError, match="have none"):
        run_experiment([make_clip(c, None, 1) for c in ("right", "left")], split="leave-performer-out")
    with pytest.raises(TrainingError, match="none is left to test"):
        run_experiment(clips("right left", "al", 1))
    with pytest.raises(TrainingError, match=r"fold 'al'.*only right is left"):
        run_experiment([*clips("right", "al bo"), *clips("left", "al")], split="leave-performer-out")


def test_wrong_options_are_refused() -> None:
    some = clips("right left", "al")
    with pytest.raises(OptionError, match="split"):
        run_experiment(some, split="thirds")
    with pytest.raises(OptionError, match="one or the other"):
        run_experiment(some, test_clips=some, split="leave-performer-out")
    with pytest.raises(OptionError, match="repeat"):
        run_experiment(some, repeats=0)
    with pytest.raises(OptionError, match="systems"):
        run_experiment(some, systems=["oracle"])
    with pytest.raises(OptionError, match="systems"):
        run_experiment(some, systems=[])
