"""The experiment counts what an assessment says: perfect, silent, confused and real ones."""

from __future__ import annotations

import math
import zlib
from dataclasses import replace
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from oracles.wandering import make_wandering_motion

from dousa.errors import InvalidMotionError, OptionError
from dousa.evaluation import ErrorEvent
from dousa.messages import Message
from lab.errors import experiment
from lab.errors.experiment import (
    NamedMotion,
    is_held_out,
    measure_false_alarms,
    run_error_experiment,
    run_severity_sweep,
)
from lab.errors.results import (
    Trial,
    compute_error_scores,
    compute_overlap,
    find_counterpart,
    match_events,
)
from lab.injection.injection import KINDS, Error

SILENT = SimpleNamespace(events=())


def make_event(kind, start_s, end_s, segments=("trunk",), lag_ms=None, short=None, percent=None):
    return ErrorEvent(kind, start_s, end_s, segments, lag_ms, short, percent, 2.0, start_s, start_s, None, "something")


def tell_truth(error):
    return make_event(
        error.kind,
        error.start_s,
        error.end_s,
        error.segments,
        error.lag_ms,
        error.shortfall_deg,
        error.shortfall_percent,
    )


def make_trial(errors=(), events=(), **changes):
    return replace(Trial("dance.bvh", False, 0, 60.0, tuple(errors), (), tuple(events)), **changes)


@pytest.fixture(scope="module")
def motions():
    return [
        NamedMotion(f"take_{k}.bvh", make_wandering_motion(seconds, seed=k))
        for k, seconds in enumerate((4.0, 5.0, 32.0))
    ]


@pytest.fixture
def oracle(monkeypatch):
    """An assessment that knows what was injected, since it looks over the shoulder of the experiment."""
    known = []

    def spy(function):
        def injecting(*args, **kwargs):
            injection = function(*args, **kwargs)
            known[:] = injection.errors if injection else ()
            return injection

        return injecting

    monkeypatch.setattr(experiment, "inject", spy(experiment.inject))
    monkeypatch.setattr(experiment, "inject_many", spy(experiment.inject_many))

    def assess(references, performance):
        assert len(references) == 1 and references[0].n_frames == performance.n_frames
        events = tuple(tell_truth(error) for error in known)
        known.clear()
        return SimpleNamespace(events=events)

    return assess


# Matching


def test_overlap_is_intersection_over_union():
    error = Error("shift", "late", 1.0, 3.0, ())
    assert compute_overlap(error, make_event("shift", 1.0, 3.0)) == 1.0
    assert compute_overlap(error, make_event("shift", 2.0, 4.0)) == pytest.approx(1 / 3)
    assert compute_overlap(error, make_event("shift", 3.0, 4.0)) == 0.0
    assert compute_overlap(Error("shift", "late", 1.0, 1.0, ()), make_event("shift", 1.0, 1.0)) == 0.0


def test_each_error_and_event_is_matched_once_best_first():
    errors = [Error("shift", "late", 0.0, 2.0, ()), Error("shift", "late", 2.0, 4.0, ())]
    events = [make_event("shift", 0.5, 2.2), make_event("shift", 0.0, 1.9), make_event("global", 2.0, 4.0)]
    assert match_events(errors, events) == ((0, 1),)
    assert match_events([], events) == () == match_events(errors, [])
    assert find_counterpart(errors[1], events).kind == "global"
    assert find_counterpart(Error("shift", "late", 8.0, 9.0, ()), events) is None


@given(st.lists(st.tuples(st.floats(0, 10), st.floats(0.1, 5), st.sampled_from(KINDS)), max_size=6))
def test_a_perfect_answer_matches_everything(spans):
    errors = [Error(kind, "some", start, start + length, ()) for start, length, kind in spans]
    assert len(match_events(errors, [tell_truth(error) for error in errors])) == len(errors)


# Scores


def test_scores_of_a_small_example_by_hand():
    errors = [
        Error("shift", "late", 1.0, 2.0, ("trunk",), lag_ms=200.0),
        Error("incomplete", "limb shrunk", 4.0, 6.0, ("trunk",), shortfall_deg=30.0, shortfall_percent=50.0),
        Error("partial", "limb held", 8.0, 9.0, ("left_forearm",)),
        Error("global", "section from elsewhere", 11.0, 13.0, ("trunk",)),
    ]
    events = [
        make_event("shift", 1.1, 2.0, lag_ms=180.0),
        make_event("incomplete", 4.2, 6.2, short=26.0, percent=45.0),
        make_event("global", 8.0, 9.0),
        make_event("global", 11.0, 12.9),
        make_event("shift", 20.0, 21.0, lag_ms=100.0),
    ]
    clean = make_trial(events=[make_event("partial", 0.0, 1.0)], duration_s=30.0)
    scores = compute_error_scores([make_trial(errors, events), clean])
    assert [scores.classes[kind].n_matched for kind in KINDS] == [1, 1, 0, 1]
    assert scores.classes["shift"].precision == 0.5 and scores.classes["shift"].recall == 1.0
    assert scores.classes["global"].f_measure == pytest.approx(2 / 3)
    assert scores.macro_precision == pytest.approx((0.5 + 1 + 0 + 0.5) / 4)
    assert scores.macro_recall == 0.75
    assert scores.macro_f == pytest.approx((2 / 3 + 1 + 0 + 2 / 3) / 4)
    assert scores.onset_s == pytest.approx(0.1) and scores.offset_s == pytest.approx(0.1)
    assert scores.lag_mae_ms == pytest.approx(20.0)
    assert scores.shortfall_mae_deg == pytest.approx(4.0)
    assert scores.shortfall_mae_percent == pytest.approx(5.0)
    assert scores.segment_jaccard == 1.0
    assert scores.confusion["partial"] == {"shift": 0, "incomplete": 0, "partial": 0, "global": 1, "none": 0}
    assert scores.confusion["no error"]["shift"] == 1
    assert scores.variants["limb held"] == (0, 1) and scores.variants["late"] == (1, 1)
    assert scores.false_alarms.per_minute == pytest.approx(2.0)
    assert scores.false_alarms.by_kind["partial"] == 1
    assert [sum(getattr(one, name) for one in scores.classes.values()) for name in ("n_errors", "n_events")] == [4, 5]
    table = scores.tabulate(Message("trial_errors.all"))
    assert [str(row[0]) for row in table.rows] == [*KINDS, "mean"]
    assert table.rows[-1][4:] == tuple(
        f"{x:.3f}" for x in (scores.macro_precision, scores.macro_recall, scores.macro_f)
    )


def test_scores_of_nothing_are_not_a_number():
    scores = compute_error_scores([])
    assert math.isnan(scores.macro_f) and math.isnan(scores.lag_mae_ms)
    assert scores.to_json()["macro_f"] is None
    assert scores.false_alarms.to_json()["per_minute"] is None


# The experiment


def test_perfect_answers_get_perfect_scores(motions, oracle):
    result = run_error_experiment(motions, repeats=2, seed=1, assess=oracle)
    scores = result.scores
    assert scores.macro_f == scores.macro_precision == scores.macro_recall == 1.0
    assert scores.onset_s == scores.lag_mae_ms == scores.shortfall_mae_deg == 0.0
    assert scores.segment_jaccard == 1.0
    assert scores.false_alarms.per_minute == 0.0 and scores.false_alarms.n_takes == 6
    assert all(scores.confusion[kind][kind] == scores.classes[kind].n_errors > 0 for kind in KINDS)
    assert set(result.to_json()["sets"]) <= {"all", "tuning", "held-out"}


def test_a_short_motion_gets_a_trial_a_class_and_a_long_one_gets_all_at_once(motions):
    trials = run_error_experiment(motions, assess=lambda references, performance: SILENT).trials
    assert [trial.name for trial in trials] == ["take_0.bvh"] * 5 + ["take_1.bvh"] * 5 + ["take_2.bvh"] * 2
    for trial in trials[:10]:
        assert len(trial.errors) + len(trial.missing) <= 1
    assert {error.kind for error in trials[10].errors} == set(KINDS) and not trials[11].errors


def test_silence_finds_nothing_and_alarms_nobody(motions):
    scores = run_error_experiment(motions, assess=lambda references, performance: SILENT).scores
    assert scores.macro_recall == scores.macro_precision == scores.macro_f == 0.0
    assert math.isnan(scores.onset_s) and scores.false_alarms.per_minute == 0.0


def test_a_refusal_is_told_and_not_hidden(motions):
    def refuse(references, performance):
        raise InvalidMotionError("text.verbatim", text="too odd")

    scores = run_error_experiment(motions[:1], assess=refuse).scores
    assert scores.problems and all(str(problem) == "take_0.bvh: too odd" for problem in scores.problems)


def test_trials_depend_on_the_seed_and_not_on_the_workers(motions):
    def assess(references, performance):
        # All names are local, so that the function can go to another process.
        from types import SimpleNamespace

        from dousa.evaluation import ErrorEvent

        start = float(abs(performance.positions[0, 0, 0]))
        event = ErrorEvent("shift", start, start + 1, (), 100.0, None, None, 2.0, start, start, None, "late")
        return SimpleNamespace(events=(event,))

    first = run_error_experiment(motions, seed=3, assess=assess)
    assert run_error_experiment(motions, seed=3, assess=assess).trials == first.trials
    assert run_error_experiment(motions, seed=4, assess=assess).trials != first.trials
    counted = []
    spread = run_error_experiment(motions, seed=3, assess=assess, n_jobs=2, progress=lambda *step: counted.append(step))
    assert spread.trials == first.trials
    assert counted[-1] == (len(first.trials), len(first.trials), Message("text.verbatim", text="take_2.bvh"))


def test_sets_are_told_by_the_name(motions):
    names = [f"walk_{k}.amc" for k in range(200)]
    assert 0.2 < sum(map(is_held_out, names)) / 200 < 0.4
    assert is_held_out("walk_1.amc") == (zlib.crc32(b"walk_1.amc") % 10 < 3)
    assert all(is_held_out(name) == is_held_out(f"/some/where\\else/{name}") for name in names)
    kept = next(name for name in names if is_held_out(name))
    tuned = next(name for name in names if not is_held_out(name))
    both = [NamedMotion(kept, motions[0].motion), NamedMotion(tuned, motions[1].motion)]

    def silent(references, performance):
        return SILENT

    for which, name in (("held-out", kept), ("tuning", tuned)):
        trials = run_error_experiment(both, which=which, assess=silent).trials
        assert {trial.name for trial in trials} == {name}
    assert set(run_error_experiment(both, assess=silent).to_json()["sets"]) == {"all", "tuning", "held-out"}
    with pytest.raises(OptionError, match="got none of 1"):
        run_error_experiment(both[:1], which="tuning", assess=silent)


@pytest.mark.parametrize(
    "wrong",
    [
        {"which": "some"},
        {"repeats": 0},
        {"seed": -1},
        {"noise_deg": -1.0},
        {"timing_ms": -5.0},
        {"n_jobs": 0},
    ],
)
def test_options_are_checked(motions, wrong):
    with pytest.raises(OptionError, match="expected"):
        run_error_experiment(motions, **wrong)


def test_a_sweep_has_a_row_a_size(motions, oracle):
    rows = run_severity_sweep(motions, sizes={"shift": (60.0, 200.0), "partial": (30.0,)}, assess=oracle)
    assert [(row.kind, row.size) for row in rows] == [("shift", 60.0), ("shift", 200.0), ("partial", 30.0)]
    assert all(row.n_found == row.n_noticed == row.n_errors > 0 for row in rows)
    with pytest.raises(OptionError, match="global"):
        run_severity_sweep(motions, sizes={"global": (1.0,)})


# Clean takes of real people


def test_every_take_is_performed_against_some_others(motions):
    asked = []

    def assess(references, performance):
        asked.append((len(references), performance))
        assert all(reference is not performance for reference in references)
        return SimpleNamespace(events=(make_event("partial", 0.0, 1.0),))

    alarms = measure_false_alarms(motions, n_references=1, assess=assess)
    assert [count for count, _ in asked] == [1, 1, 1]
    assert [performance for _, performance in asked] == [motion.motion for motion in motions]
    assert alarms.minutes == pytest.approx(41.0 / 60.0)
    assert alarms.per_minute == pytest.approx(3 * 60.0 / 41.0)
    assert alarms.by_kind == {"shift": 0, "incomplete": 0, "partial": 3, "global": 0}
    assert alarms.to_json()["events"][2]["name"] == "take_2.bvh"
    asked.clear()
    measure_false_alarms(motions, assess=assess)
    assert [count for count, _ in asked] == [2, 2, 2]


def test_one_take_has_nothing_to_be_compared_with(motions):
    with pytest.raises(OptionError, match="takes: expected 2 or more"):
        measure_false_alarms(motions[:1])
    with pytest.raises(OptionError, match="reference"):
        measure_false_alarms(motions, n_references=0)
