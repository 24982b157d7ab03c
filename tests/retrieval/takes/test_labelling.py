"""Labelling takes: timelines without gaps, right where the truth is known, unknown where nothing is."""

from __future__ import annotations

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.short_actions import ACTIONS, make_clip, make_library

from dousa.errors import DousaError, InvalidMotionError, MotionWriteError, OptionError, TrainingError
from dousa.experiments.metrics import TrueSegment, add_counts, compare_timeline
from dousa.retrieval import FEATURE_SETS, MotionForest
from dousa.retrieval.takes.label import (
    Segment,
    TakeLabeller,
    Timeline,
    choose_segments,
    label_take,
    make_timeline,
    write_timeline_csv,
)
from dousa.retrieval.takes.labeller_training import fit_logistic, train_labeller
from dousa.retrieval.takes.leaf_weights import JoinedTake, Piece, covered_pieces, join_clips
from dousa.retrieval.takes.windows import TakeWindows, WindowGrid, describe_take, place_windows

SET = FEATURE_SETS["extended"]
CLIPS = make_library((0, 1, 2), 3)


def train(clips):
    forest = MotionForest(n_trees=30, thresholds="random", random_state=0)
    return forest.fit(
        np.stack([SET.compute(clip) for clip in clips]), [clip.category for clip in clips], feature_set=SET
    )


FOREST = train(CLIPS)
LABELLER = train_labeller(FOREST, SET, CLIPS)
TAKE = join_clips([make_clip(action, 7) for action in ACTIONS], np.random.default_rng(3))
WINDOWS = describe_take(FOREST, SET, TAKE, LABELLER.grid)
TRUTH = [TrueSegment(p.start / 30, p.stop / 30, p.category) for p in TAKE.pieces]


def test_actions_of_somebody_new_are_labelled_in_order():
    timeline = label_take(LABELLER, WINDOWS)
    scores = compare_timeline(timeline.segments, TRUTH, timeline.duration).scores()
    assert scores.frame_accuracy > 0.85
    assert scores.f_measure > 0.9
    assert scores.boundary_error_s < 0.35
    assert timeline.category_at(TRUTH[2].start + 1.0) == TRUTH[2].category
    assert timeline.category_at(-1.0) is None


def test_a_timeline_covers_the_take_without_gaps():
    for threshold in (0.0, 0.9, 1.0):
        timeline = label_take(LABELLER, WINDOWS, threshold=threshold)
        edges = [one.start for one in timeline.segments] + [timeline.segments[-1].stop]
        assert edges[0] == 0.0
        assert edges[-1] == pytest.approx(WINDOWS.duration)
        assert [one.stop for one in timeline.segments] == edges[1:]
        assert all(0.0 <= one.confidence <= 1.0 for one in timeline.segments)


def test_nothing_is_said_where_nothing_is_sure_enough():
    timeline = label_take(LABELLER, WINDOWS, threshold=1.0)
    assert [one.category for one in timeline.segments] == [None]


def test_an_action_never_trained_is_unknown():
    clips = [clip for clip in CLIPS if clip.category not in ("bow", "kick")]
    forest = train(clips)
    labeller = train_labeller(forest, SET, clips)
    pieces = [make_clip(action, 7) for action in ("spread", "bow", "wave", "kick", "raise left")]
    take = join_clips(pieces, np.random.default_rng(3))
    timeline = label_take(labeller, describe_take(forest, SET, take, labeller.grid))
    middles = [0.5 * (p.start + p.stop) / 30 for p in take.pieces]
    said = [timeline.category_at(middle) for middle in middles]
    assert said[::2] == ["spread", "wave", "raise left"]
    assert said[1::2].count(None) >= 1


@pytest.mark.parametrize("n_frames", [1, 10])
def test_a_take_too_short_for_windows_is_unknown(n_frames):
    short = JoinedTake(TAKE.positions[:n_frames], TAKE.height, ())
    timeline = label_take(LABELLER, describe_take(FOREST, SET, short, LABELLER.grid))
    assert timeline.segments == (Segment(0.0, n_frames / 30, None, 1.0),)


def test_a_take_with_more_window_lengths_gets_the_same_labels():
    from dousa.retrieval.takes.windows import choose_grid

    more = choose_grid([len(clip.positions) / 30 for clip in CLIPS])
    assert set(LABELLER.grid.lengths) < set(more.lengths)
    timeline = label_take(LABELLER, describe_take(FOREST, SET, TAKE, more))
    assert timeline == label_take(LABELLER, WINDOWS)


def test_a_seed_gives_one_labeller_however_many_threads():
    again = train_labeller(FOREST, SET, CLIPS, n_jobs=2)
    assert again.to_bytes() == LABELLER.to_bytes()


def test_clips_without_performers_and_of_few_categories_will_do():
    few = [replace(clip, performer=None) for clip in CLIPS if clip.category in ("bow", "kick")]
    labeller = train_labeller(train(few), SET, few)
    assert labeller.classes == ("bow", "kick")
    assert 0 <= labeller.threshold <= 1


def test_clips_that_did_not_train_are_refused():
    with pytest.raises(TrainingError, match="clips that trained the forest"):
        train_labeller(FOREST, SET, [replace(CLIPS[0], category="dance")])
    with pytest.raises(TrainingError, match="clips that trained the forest"):
        train_labeller(FOREST, SET, [])


def test_windows_of_another_forest_are_refused():
    strange = TakeWindows(WINDOWS.grid, WINDOWS.leaves[:, :3].copy(), WINDOWS.poses, WINDOWS.duration)
    with pytest.raises(InvalidMotionError, match="another forest"):
        label_take(LABELLER, strange)
    with pytest.raises(OptionError, match="threshold"):
        label_take(LABELLER, WINDOWS, threshold=1.5)


def test_a_labeller_comes_back_from_bytes():
    again = TakeLabeller.from_bytes(LABELLER.to_bytes())
    assert label_take(again, WINDOWS) == label_take(LABELLER, WINDOWS)
    assert again.to_bytes() == LABELLER.to_bytes()


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_damaged_bytes_are_refused_or_harmless(data):
    damaged = bytearray(LABELLER.to_bytes())
    for _ in range(data.draw(st.integers(1, 3))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    cut = data.draw(st.integers(0, len(damaged)))
    for some in (bytes(damaged), bytes(damaged[:cut])):
        try:
            labeller = TakeLabeller.from_bytes(some)
        except DousaError:
            continue
        with np.errstate(all="ignore"):
            try:
                label_take(labeller, WINDOWS)
            except DousaError:
                continue


def test_the_best_sequence_prefers_one_whole_action_to_its_pieces():
    starts, stops = np.array([0, 0, 30, 60]), np.array([90, 30, 60, 90])
    scores = np.array([[0.6, 0.0], [0.5, 0.0], [0.0, 0.55], [0.5, 0.0]], np.float32)
    assert [one.row for one in choose_segments(starts, stops, scores, 90)] == [0]
    scores[2, 1] = 0.9
    assert [one.row for one in choose_segments(starts, stops, scores, 90)] == [1, 2, 3]
    assert choose_segments(starts[:0], stops[:0], scores[:0], 90) == []


@settings(max_examples=80, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_any_scores_make_a_timeline_in_order(seed):
    draw = np.random.default_rng(seed)
    n_frames = int(draw.integers(16, 400))
    starts, stops = place_windows(WindowGrid((16, 48, 192)), n_frames)
    scores = draw.normal(0.1, 0.3, (len(starts), 3)).astype(np.float32) ** 3
    chosen = choose_segments(starts, stops, scores, n_frames)
    sure = draw.uniform(size=len(chosen))
    segments = make_timeline(chosen, sure, ("a", "b", "c"), n_frames / 30, 0.5).segments
    edges = [segments[0].start, *(one.stop for one in segments)]
    assert edges[0] == 0.0
    assert edges[-1] == pytest.approx(n_frames / 30)
    assert (np.diff(edges) > 0).all()
    assert [one.start for one in segments] == edges[:-1]


def test_edges_lie_between_those_of_the_grid():
    starts, stops = place_windows(WindowGrid((48, 64, 96)), 300)
    best, overlaps = covered_pieces(starts, stops, [Piece(100, 171, "a")])
    assert (best == 0).all()
    (one,) = choose_segments(starts, stops, np.maximum(overlaps - 0.4, 0).astype(np.float32)[:, None], 300)
    assert abs(one.start - 100) <= 2
    assert abs(one.stop - 171) <= 2


def test_timelines_are_plain_json_and_csv(tmp_path):
    timeline = Timeline((Segment(0.0, 1.5, "bow", 0.9), Segment(1.5, 2.0, None, 0.6)), 2.0, 0.5)
    said = json.loads(json.dumps(timeline.to_json()))
    assert said["segments"][1] == {
        "start_s": 1.5, "end_s": 2.0, "category": None, "unknown": True, "confidence": 0.6
    }  # fmt: skip
    write_timeline_csv(timeline, tmp_path / "take.csv")
    rows = list(csv.reader((tmp_path / "take.csv").read_text(encoding="utf-8").splitlines()))
    assert rows == [
        ["start_s", "end_s", "category", "confidence"],
        ["0.000", "1.500", "bow", "0.9000"],
        ["1.500", "2.000", "", "0.6000"],
    ]
    with pytest.raises(MotionWriteError, match="cannot write the timeline"):
        write_timeline_csv(timeline, tmp_path)


def test_perfect_labels_score_one_and_no_labels_nothing():
    segments = [Segment(one.start, one.stop, one.category, 1.0) for one in TRUTH]
    scores = compare_timeline(segments, TRUTH, WINDOWS.duration).scores()
    assert (scores.frame_accuracy, scores.precision, scores.recall, scores.f_measure) == (1, 1, 1, 1)
    assert scores.boundary_error_s == 0.0
    nothing = compare_timeline([], TRUTH, WINDOWS.duration).scores()
    assert (nothing.frame_accuracy, nothing.recall) == (0.0, 0.0)
    assert np.isnan(nothing.precision)
    assert nothing.to_json()["precision"] is None
    assert np.isnan(compare_timeline([], [], 0.0).scores().frame_accuracy)


def test_events_count_once_and_need_half_the_overlap():
    truth = [TrueSegment(0.0, 2.0, "a"), TrueSegment(2.0, 4.0, "b"), TrueSegment(4.0, 6.0, None)]
    said = [Segment(0.0, 1.0, "a", 1), Segment(1.0, 2.0, "a", 1), Segment(2.9, 4.0, "b", 1)]
    counts = compare_timeline(said, truth, 6.0)
    assert (counts.matched, counts.said, counts.true) == (2, 3, 2)
    both = add_counts([counts, counts])
    assert (both.matched, both.n_frames) == (4, 360)
    assert counts.scores().frame_accuracy == pytest.approx((60 + 33 + 60) / 180)


def test_what_nobody_can_say_does_not_count():
    truth = [TrueSegment(0.0, 1.0, "a"), TrueSegment(1.0, 2.0, None, counted=False)]
    counts = compare_timeline([Segment(0.0, 1.0, "a", 1), Segment(1.1, 2.0, "b", 1)], truth, 2.0)
    assert counts.scores().frame_accuracy == 1.0
    assert counts.said == 1


def test_logistic_weights_are_those_that_made_the_answers():
    draw = np.random.default_rng(0)
    evidence = draw.normal(size=(20000, 2))
    odds = 0.5 + evidence @ (2.0, -1.0)
    truth = (draw.uniform(size=len(odds)) < 1 / (1 + np.exp(-odds))).astype(float)
    np.testing.assert_allclose(fit_logistic(evidence, truth), (0.5, 2.0, -1.0), atol=0.1)
    apart = fit_logistic(np.array([[-1.0], [1.0]]), np.array([0.0, 1.0]))
    assert np.isfinite(apart).all()
