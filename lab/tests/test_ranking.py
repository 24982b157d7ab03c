"""The ranking experiment: its rankings on the same queries, its JSON, its refusals."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from dousa.errors import OptionError, TrainingError
from dousa.messages import Message
from dousa.motion import canonicalise, compute_trajectories
from dousa.motion.synthetic.performers import draw_performer, make_motion
from dousa.retrieval.features.posed_motion import LabelledClip
from lab.ranking.experiment import run_ranking_experiment
from lab.ranking.metrics import RANKING_SCORES
from lab.ranking.systems import RANKING_SYSTEMS


def make_clip(category: str, number: int, seed: int) -> LabelledClip:
    motion = canonicalise(compute_trajectories(make_motion(category, draw_performer(number), seed=seed)))
    name = f"{category}-{number}-{seed}"
    return LabelledClip(name, category, f"p{number}", motion.positions, motion.frame_rate, motion.height)


@pytest.fixture(scope="module")
def clips() -> list[LabelledClip]:
    categories = ("walk", "squat", "clap", "bow")
    return [make_clip(c, number, 10 * number + k) for c in categories for number in range(3) for k in range(2)]


@pytest.fixture(scope="module")
def left_out(clips):
    return run_ranking_experiment(clips, split="leave-performer-out", n_trees=20, n_resamples=200)


def test_easy_motions_are_ranked_by_all(left_out):
    assert tuple(left_out.systems) == RANKING_SYSTEMS
    assert (left_out.n_queries, left_out.n_gallery) == (24, 16)
    for name in ("fused", "histogram", "leaves"):
        assert left_out.systems[name].scores["map"].mean > 0.9
    for system in left_out.systems.values():
        for interval in system.scores.values():
            assert 0 <= interval.low <= interval.mean <= interval.high <= 1
        assert system.query_milliseconds > 0 and system.times_faster_than_dtw > 0
        assert [(fold.name, fold.n_gallery, fold.n_queries) for fold in system.folds] == [
            (f"p{k}", 16, 8) for k in range(3)
        ]
        mean = np.mean([fold.mean_average_precision for fold in system.folds])
        assert system.scores["map"].mean == pytest.approx(mean)
    assert left_out.systems["dtw"].beyond_dtw is None
    assert left_out.systems["dtw"].times_faster_than_dtw == 1


def test_differences_are_those_of_the_means(left_out):
    for name, system in left_out.systems.items():
        if name != "dtw":
            beyond = system.scores["map"].mean - left_out.systems["dtw"].scores["map"].mean
            assert system.beyond_dtw.mean == pytest.approx(beyond)


def test_few_relevant_clips_cap_the_precision_at_10(left_out):
    assert (left_out.n_short, left_out.best_p_at_10) == (24, pytest.approx(0.4))
    assert left_out.systems["fused"].scores["p_at_10"].mean <= 0.4 + 1e-12


def test_json_has_the_promised_keys(left_out):
    answer = json.loads(json.dumps(left_out.to_json()))
    assert set(answer["systems"]) == set(RANKING_SYSTEMS)
    for name, system in answer["systems"].items():
        for score in RANKING_SCORES:
            low, high = system[f"{score}_interval"]
            assert low <= system[score] <= high
            assert len(system[f"{score}_interval_by_performer"]) == 2
        assert ("map_beyond_dtw" in system) == (name != "dtw")
    assert answer["split"] == "leave-performer-out" and answer["features"] == "extended"
    assert set(answer["describe_milliseconds"]) == {"forest", "poses", "motion_templates"}
    assert set(answer["fit_seconds"]) == {"forest", "motion_templates"}


def without_times(result):
    return {name: (system.scores, system.folds) for name, system in result.systems.items()}


def test_the_seed_decides_and_the_workers_do_not(clips, left_out):
    again = run_ranking_experiment(
        clips, split="leave-performer-out", n_trees=20, n_resamples=200, n_jobs=2, random_state=0
    )
    assert without_times(again) == without_times(left_out)


def test_half_with_the_paper_features_and_some_systems(clips):
    heard = []
    result = run_ranking_experiment(
        clips,
        systems=["leaves", "euclidean"],
        feature_set="paper",
        n_trees=10,
        n_resamples=50,
        progress=lambda done, total, doing: heard.append((done, total, doing)),
    )
    assert list(result.systems) == ["leaves", "euclidean"]
    assert (result.n_queries, result.n_gallery, result.split) == (12, 12, "half")
    assert result.systems["leaves"].beyond_dtw is None and not result.systems["leaves"].folds
    assert set(result.describe_milliseconds) == {"forest", "poses"}
    assert heard[-1] == (24, 24, Message("trial_progress.done"))
    counts = [done for done, total, _ in heard if total]
    assert counts == sorted(counts)


def test_given_queries_of_which_one_finds_nothing(clips):
    gallery = [clip for clip in clips if clip.performer == "p0" and clip.category != "bow"]
    queries = [clip for clip in clips if clip.performer == "p1"]
    result = run_ranking_experiment(gallery, test_clips=queries, systems=["dtw"], n_resamples=50)
    assert result.without_relevant == {"bow": 2}
    assert (result.n_queries, result.n_gallery, result.split) == (6, 6, "given")
    assert not result.systems["dtw"].scores_by_performer  # the queries are one performer's


def test_a_category_of_one_clip_is_left_out(clips):
    only = [clip for clip in clips if clip.category != "bow" or clip is clips[-1]]
    result = run_ranking_experiment(only, split="leave-performer-out", systems=["euclidean"], n_resamples=50)
    assert result.without_relevant == {"bow": 1} and result.n_queries == 18


def test_rankings_do_not_know_the_labels_of_the_queries(clips):
    """If all queries are said to be one category, P@1 is how often it comes first: over all these sum to 1."""
    gallery = [clip for clip in clips if clip.performer == "p0"]
    queries = [clip for clip in clips if clip.performer == "p1"]
    first = dict.fromkeys(RANKING_SYSTEMS, 0.0)
    for category in ("walk", "squat", "clap", "bow"):
        said = [replace(clip, category=category) for clip in queries]
        result = run_ranking_experiment(gallery, test_clips=said, n_trees=5, n_resamples=10)
        for name, system in result.systems.items():
            first[name] += system.scores["p_at_1"].mean
    assert first == pytest.approx(dict.fromkeys(RANKING_SYSTEMS, 1.0))


def test_an_interrupt_passes(clips):
    def stop(done, total, doing):
        if done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_ranking_experiment(clips, systems=["euclidean"], progress=stop)


def test_clips_that_cannot_be_ranked_are_refused(clips):
    with pytest.raises(TrainingError, match="at least two categories"):
        run_ranking_experiment([clip for clip in clips if clip.category == "walk"])
    with pytest.raises(TrainingError, match="got none"):
        run_ranking_experiment([])
    with pytest.raises(TrainingError, match="test on, got none"):
        run_ranking_experiment(clips, test_clips=[])
    with pytest.raises(TrainingError, match="expected a category"):
        run_ranking_experiment([replace(clips[0], category=""), *clips])
    with pytest.raises(TrainingError, match="have none"):
        run_ranking_experiment([replace(clips[0], performer=None), *clips], split="leave-performer-out")
    strangers = [replace(clip, category=f"{clip.category} {clip.performer}") for clip in clips]
    with pytest.raises(TrainingError, match="nothing to rank"):
        run_ranking_experiment(strangers, split="leave-performer-out")


def test_wrong_options_are_refused(clips):
    with pytest.raises(OptionError, match="split"):
        run_ranking_experiment(clips, split="thirds")
    with pytest.raises(OptionError, match="one or the other"):
        run_ranking_experiment(clips, test_clips=clips, split="half")
    with pytest.raises(OptionError, match="forest"):
        run_ranking_experiment(clips, systems=["forest"])
    with pytest.raises(OptionError, match="none"):
        run_ranking_experiment(clips, systems=[])
    with pytest.raises(OptionError, match="features"):
        run_ranking_experiment(clips, feature_set="all")
    for wrong in ({"random_state": -1}, {"n_resamples": 0}):
        with pytest.raises(OptionError, match="expected"):
            run_ranking_experiment(clips, **wrong)
