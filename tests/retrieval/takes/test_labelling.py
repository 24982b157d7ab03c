"""Labelling takes: timelines without gaps, right where the truth is known, unknown where nothing is."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.short_actions import ACTIONS, learned_labeller, make_clip, make_library, shown_take

from dousa.errors import DousaError, InvalidMotionError, MotionWriteError, OptionError, TrainingError
from dousa.experiments.metrics import TrueSegment, add_counts, compare_timeline
from dousa.formats.annotations.label_file import to_annotation
from dousa.formats.annotations.reading import read_label_file
from dousa.motion.annotation import Stretch
from dousa.retrieval.features.posed_motion import AnnotatedTake
from dousa.retrieval.takes.label import Segment, TakeLabeller, Timeline, label_take, make_timeline, write_timeline_csv
from dousa.retrieval.takes.labeller_training import train_labeller
from dousa.retrieval.takes.labeller_tuning import Answer, calibrate_places, fit_logistic
from dousa.retrieval.takes.made_takes import JoinedTake, disturb, join_with_rests


def true_segments():
    return [TrueSegment(p.start / 30, p.stop / 30, p.category) for p in shown_take().pieces]


def test_actions_of_somebody_new_are_labelled_in_order():
    timeline = label_take(learned_labeller(), shown_take())
    scores = compare_timeline(timeline.segments, true_segments(), timeline.duration).scores()
    assert scores.frame_accuracy > 0.85
    assert scores.f_measure > 0.9
    assert scores.boundary_error_s < 0.35
    assert timeline.category_at(true_segments()[2].start + 1.0) == true_segments()[2].category
    assert timeline.category_at(-1.0) is None


def test_a_timeline_covers_the_take_without_gaps():
    for threshold in (0.0, 0.9, 1.0):
        timeline = label_take(learned_labeller(), shown_take(), threshold=threshold)
        edges = [one.start for one in timeline.segments] + [timeline.segments[-1].stop]
        assert edges[0] == 0.0
        assert edges[-1] == pytest.approx(len(shown_take().positions) / 30)
        assert [one.stop for one in timeline.segments] == edges[1:]
        assert all(0.0 <= one.confidence <= 1.0 for one in timeline.segments)
    assert [one.category for one in timeline.segments] == [None]  # nothing is sure enough


def test_a_rest_between_actions_is_nothing():
    rest = np.repeat(shown_take().positions[:1], 240, axis=0)
    pieces = [make_clip(action, 7).positions for action in ("wave", "bow")]
    take = JoinedTake(np.concatenate([pieces[0], rest, pieces[1]]), shown_take().height, ())
    timeline = label_take(learned_labeller(), take)
    assert [timeline.category_at(when) for when in (1.0, len(pieces[0]) / 30 + 4.0)] == ["wave", None]


def test_the_same_is_said_of_a_noisy_slow_sensor():
    noisy = disturb(shown_take(), np.random.default_rng(5))
    assert noisy.frame_rate < 30 or np.abs(noisy.positions - shown_take().positions).max() > 0
    timeline = label_take(learned_labeller(), noisy)
    assert compare_timeline(timeline.segments, true_segments(), timeline.duration).scores().frame_accuracy > 0.75


@pytest.mark.parametrize("n_frames", [1, 10])
def test_a_very_short_take_is_one_segment(n_frames):
    timeline = label_take(learned_labeller(), JoinedTake(shown_take().positions[:n_frames], shown_take().height, ()))
    assert [(one.start, one.stop) for one in timeline.segments] == [(0.0, n_frames / 30)]


def test_long_takes_are_judged_in_parts_that_agree_whatever_the_threads():
    long = replace(shown_take(), positions=np.tile(shown_take().positions, (14, 1, 1)))
    assert len(long.positions) > 4092
    alone = learned_labeller().judge(long.positions, shown_take().height)
    np.testing.assert_array_equal(alone, learned_labeller().judge(long.positions, shown_take().height, n_jobs=2))
    # About the seam of two parts as if there were none.
    part = learned_labeller().judge(long.positions[3600:4500], shown_take().height)
    np.testing.assert_allclose(part[40:-40], alone[640 : 600 + len(part) - 40], atol=1e-6)


def test_annotated_takes_teach_categories_and_nothing():
    takes = []
    for performer in range(3):
        clips = [make_clip(action, performer, trial) for action in ACTIONS for trial in range(3)]
        draw = np.random.default_rng(performer)
        made = join_with_rests([clips[k] for k in draw.permutation(len(clips))], draw)
        stretches = tuple(Stretch(p.start / 30, p.stop / 30, p.category) for p in made.pieces)
        takes.append(AnnotatedTake(str(performer), str(performer), made.positions, 30.0, made.height, stretches))
    labeller = train_labeller([], takes)
    assert labeller.classes == ACTIONS
    said = label_take(labeller, shown_take())
    assert compare_timeline(said.segments, true_segments(), said.duration).scores().frame_accuracy > 0.75


def test_a_seed_gives_one_labeller_however_many_threads():
    again = train_labeller(make_library(), n_jobs=2)
    assert again.to_bytes() == learned_labeller().to_bytes()


def test_clips_without_performers_and_of_few_categories_will_do():
    few = [replace(clip, performer=None) for clip in make_library() if clip.category in ("bow", "kick")]
    for clips in (few, few[:1]):
        labeller = train_labeller(clips)
        assert labeller.classes == tuple(sorted({clip.category for clip in clips}))
        assert 0 <= labeller.threshold <= 1
        assert label_take(labeller, shown_take()).segments


def test_what_cannot_be_learned_from_or_labelled_is_refused():
    with pytest.raises(TrainingError, match="clips with categories, or annotated takes"):
        train_labeller([])
    with pytest.raises(InvalidMotionError, match="shape"):
        label_take(learned_labeller(), replace(shown_take(), positions=shown_take().positions[:, :3]))
    with pytest.raises(OptionError, match="threshold"):
        label_take(learned_labeller(), shown_take(), threshold=1.5)


def test_a_labeller_comes_back_from_bytes():
    again = TakeLabeller.from_bytes(learned_labeller().to_bytes())
    assert label_take(again, shown_take()) == label_take(learned_labeller(), shown_take())
    assert again.to_bytes() == learned_labeller().to_bytes()


def test_how_often_nothing_is_taken_for_an_action_is_learned_from_people_left_out():
    draw = np.random.default_rng(2)

    def answers(share, count=400):
        placed = draw.random(count) < share
        return [Answer(draw.normal(size=6) + there, 5, float(there), 0.0, bool(there), bool(there)) for there in placed]

    for share in (0.5, 0.95):
        some = answers(share)
        labeller = replace(learned_labeller(), placing=calibrate_places(some))
        said = labeller.place(np.stack([one.evidence for one in answers(share)]))
        assert said.mean() == pytest.approx(share, abs=0.06)
    # Of what was always there nobody is certain, and a few answers teach nothing.
    always = replace(learned_labeller(), placing=calibrate_places(answers(1.0, 40)))
    assert 0.9 < always.place(np.ones((1, 6)))[0] < 0.999
    assert calibrate_places(answers(0.5, 3)) == calibrate_places([])


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_damaged_bytes_are_refused_or_harmless(data):
    damaged = bytearray(learned_labeller().to_bytes())
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
                label_take(labeller, shown_take())
            except DousaError:
                continue


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_any_probabilities_make_a_timeline_in_order(seed):
    draw = np.random.default_rng(seed)
    n_frames = int(draw.integers(1, 900))
    shares = draw.dirichlet(np.full(3 * len(learned_labeller().classes) + 1, 0.2), -(-n_frames // 6)).astype(np.float32)
    chosen = learned_labeller().choose(shares, n_frames)
    segments = make_timeline(
        chosen, draw.uniform(size=len(chosen)) < 0.5, learned_labeller().classes, n_frames / 30, 0.5
    ).segments
    edges = [segments[0].start, *(one.stop for one in segments)]
    assert edges[0] == 0.0
    assert edges[-1] == pytest.approx(n_frames / 30)
    assert (np.diff(edges) > 0).all()
    assert [one.start for one in segments] == edges[:-1]


def test_timelines_are_plain_json_and_csv(tmp_path):
    perhaps = Segment(2.0, 3.0, None, 0.31, 2, guess="kick")
    timeline = Timeline((Segment(0.0, 1.5, "bow", 0.9), Segment(1.5, 2.0, None, 0.6), perhaps), 3.0, 0.5)
    said = json.loads(json.dumps(timeline.to_json()))
    assert said["segments"][1] == {
        "start_s": 1.5, "end_s": 2.0, "category": None, "unknown": True, "perhaps": False, "guess": None,
        "confidence": 0.6, "repetitions": 1, "mirrored": False,
    }  # fmt: skip
    doubtful = {"category": None, "unknown": True, "perhaps": True, "guess": "kick", "confidence": 0.31}
    assert said["segments"][2].items() >= doubtful.items()
    assert timeline.category_at(2.5) is None
    write_timeline_csv(timeline, tmp_path / "take.csv")
    rows = list(csv.reader((tmp_path / "take.csv").read_text(encoding="utf-8").splitlines()))
    assert rows == [
        ["start_s", "end_s", "category", "confidence", "repetitions", "perhaps"],
        ["0.000", "1.500", "bow", "0.9000", "1", ""],
        ["1.500", "2.000", "", "0.6000", "1", ""],
        ["2.000", "3.000", "", "0.3100", "2", "kick"],
    ]
    # A doubtful name is learned neither as a label nor as nothing.
    table = read_label_file(tmp_path / "take.csv")
    learned, notes = to_annotation(table, table.takes[""])
    assert [(one.start, one.stop, one.category) for one in learned.segments] == [(0.0, 1.5, "bow")]
    assert learned.unclear == ((2.0, 3.0),) and not notes
    with pytest.raises(MotionWriteError, match="expected the name of a file, this is a folder"):
        write_timeline_csv(timeline, tmp_path)


def test_perfect_labels_score_one_and_no_labels_nothing():
    segments = [Segment(one.start, one.stop, one.category, 1.0) for one in true_segments()]
    scores = compare_timeline(segments, true_segments(), (len(shown_take().positions) / 30)).scores()
    assert (scores.frame_accuracy, scores.precision, scores.recall, scores.f_measure) == (1, 1, 1, 1)
    assert scores.boundary_error_s == 0.0
    nothing = compare_timeline([], true_segments(), (len(shown_take().positions) / 30)).scores()
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
    np.testing.assert_allclose(fit_logistic(evidence, truth, np.ones(len(truth))), (0.5, 2.0, -1.0), atol=0.1)
    apart = fit_logistic(np.array([[-1.0], [1.0]]), np.array([0.0, 1.0]), np.ones(2))
    assert np.isfinite(apart).all()
