"""Labels of a motion while it happens, and its frames as lines of JSON."""

import json

import numpy as np
import pytest
from oracles.short_actions import learned_labeller, shown_take
from oracles.standing import standing

from dousa.errors import InvalidMotionError, OptionError
from dousa.experiments.metrics import TrueSegment, compare_timeline
from dousa.motion.canonical.joints import CANONICAL_JOINTS
from dousa.retrieval.takes.label import label_take
from dousa.retrieval.takes.live import LiveFrameParser, LiveLabeller, read_live_frames


def true_segments():
    return [TrueSegment(p.start / 30, p.stop / 30, p.category) for p in shown_take().pieces]


POSE = standing()[0]


def play(live, positions, rate=30.0, start=0.0):
    answers = [live.push(frame, start + k / rate) for k, frame in enumerate(positions)]
    return [answer for answer in answers if answer is not None]


def test_live_labels_are_right_and_settle_within_a_window():
    live = LiveLabeller(learned_labeller(), height=shown_take().height)
    answers = play(live, shown_take().positions)
    last = live.finish()
    assert last is not None
    settled = [segment for answer in [*answers, last] for segment in answer.settled]
    assert settled[0].start == 0.0
    assert settled[-1].stop == pytest.approx(len(shown_take().positions) / 30)
    assert [one.stop for one in settled[:-1]] == [one.start for one in settled[1:]]
    live_scores = compare_timeline(settled, true_segments(), len(shown_take().positions) / 30).scores()
    offline = label_take(learned_labeller(), shown_take())
    offline_scores = compare_timeline(offline.segments, true_segments(), offline.duration).scores()
    assert live_scores.frame_accuracy > offline_scores.frame_accuracy - 0.12
    assert all(answer.time - one.stop <= 10.0 for answer in answers for one in answer.settled)


def test_the_action_that_just_ended_is_named():
    live = LiveLabeller(learned_labeller(), height=shown_take().height)
    answers = play(live, shown_take().positions)
    for piece in true_segments()[:-1]:
        about = [a for a in answers if piece.stop - 0.4 <= a.time <= piece.stop + 0.6]
        assert piece.category in [answer.category for answer in about]


def test_other_frame_rates_and_clocks_give_the_same():
    often = np.repeat(shown_take().positions, 4, axis=0)
    settled = []
    for positions, rate, start in ((shown_take().positions, 30.0, 0.0), (often, 120.0, 1000.0)):
        live = LiveLabeller(learned_labeller(), height=shown_take().height)
        answers = [*play(live, positions, rate, start), live.finish()]
        settled.append([one.category for answer in answers for one in answer.settled])
    assert settled[0] == settled[1]


def test_memory_and_room_do_not_grow():
    live = LiveLabeller(learned_labeller(), height=shown_take().height)
    sizes = []
    for k in range(3000):
        answer = live.push(shown_take().positions[k % len(shown_take().positions)], k / 30)
        if answer is not None:
            sizes.append((len(live._scores), live._sampler._filled))
    assert max(size for size, _ in sizes[len(sizes) // 2 :]) <= 2 * max(size for size, _ in sizes[: len(sizes) // 2])
    assert max(filled for _, filled in sizes) <= len(live._sampler._room)


def test_a_missing_height_is_measured_in_the_first_second():
    live = LiveLabeller(learned_labeller())
    assert play(live, shown_take().positions[:30]) == []
    play(live, shown_take().positions[30:60], start=1.0)
    assert live.height == pytest.approx(shown_take().height, rel=0.08)


def test_streams_of_nothing_and_of_little_end_quietly():
    assert LiveLabeller(learned_labeller()).finish() is None
    live = LiveLabeller(learned_labeller())
    live.push(POSE, 0.0)
    last = live.finish()
    assert last is not None
    assert [one.category for one in last.settled] == [None]
    assert json.loads(json.dumps(last.to_json()))["unknown"]


def test_slow_frames_are_bridged():
    live = LiveLabeller(learned_labeller(), height=shown_take().height)
    play(live, shown_take().positions[::3], rate=10.0)
    live.finish()
    assert live._sampler.count == pytest.approx(len(shown_take().positions), abs=3)


@pytest.mark.parametrize(
    ("positions", "time", "message"),
    [
        (POSE[:19], 0.1, "shape"), (POSE * np.nan, 0.1, "NaN"), (POSE, 0.0, "order of time"), (POSE, 9.0, "longer gap"),
        (POSE, float("nan"), "order of time"),
    ],
)  # fmt: skip
def test_frames_that_cannot_be_are_refused(positions, time, message):
    live = LiveLabeller(learned_labeller())
    live.push(POSE, 0.0)
    with pytest.raises(InvalidMotionError, match=message):
        live.push(positions, time)


@pytest.mark.parametrize("options", [{"height": 0.0}, {"height": np.nan}, {"threshold": 2.0}])
def test_options_out_of_range_are_refused(options):
    with pytest.raises(OptionError):
        LiveLabeller(learned_labeller(), **options)


def joints(**changes):
    named = {name: list(map(float, POSE[k])) for k, name in enumerate(CANONICAL_JOINTS)}
    return {**named, **changes}


def test_lines_of_both_kinds_are_frames():
    lines = [
        json.dumps({"height": 1.7, "frame_rate": 60}),
        json.dumps({"time": 0.5, "joints": joints()}),
        "",
        json.dumps({"positions": POSE.tolist()}),
    ]
    parser = LiveFrameParser()
    frames = list(read_live_frames(lines, parser))
    assert (parser.height, parser.frame_rate) == (1.7, 60.0)
    assert [frame.time for frame in frames] == [0.5, 1 / 60]
    np.testing.assert_array_equal(frames[1].positions, POSE)


@pytest.mark.parametrize("missing", [None, [None, 1.0, 2.0], [float("nan")] * 3, "left out"])
def test_missing_joints_stay_where_they_were(missing):
    moved = joints(left_hand=missing, head=[0.0, 2.0, 0.0])
    if missing == "left out":
        del moved["left_hand"]
    first, second = read_live_frames(
        [json.dumps({"time": 0, "joints": joints()}), json.dumps({"time": 1, "joints": moved})]
    )
    assert second.held == ("left_hand",)
    np.testing.assert_array_equal(second.positions[7], first.positions[7])
    np.testing.assert_array_equal(second.positions[3], (0.0, 2.0, 0.0))


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("{", "line 2: expected one JSON object"),
        ("[1]", "line 2: expected a JSON object, got list"),
        ('{"time": 1}', "line 2: expected a frame with 'joints' or 'positions'"),
        ('{"height": -1}', "line 2: expected a frame|height in m"),
        ('{"time": 1, "positions": [[0, 0, 0]]}', "'positions' of 20 joints, got 1"),
        ('{"time": 1, "joints": {"hand": [0, 0, 0]}}', "no joint 'hand'"),
        ('{"time": 1, "joints": {"head": [0, 0]}}', r"expected \[x, y, z\] for head"),
        ('{"time": 1, "joints": {"head": [0, 0, "1"]}}', r"expected \[x, y, z\] in m for head"),
        ('{"time": 1, "joints": {"head": [0, 0, 1e400]}}', "head"),
        ('{"time": 1, "joints": {"head": [1e300, 1e300, 1e300]}}', r"expected \[x, y, z\] in m for head"),
        ('{"time": 1, "joints": {"head": [true, true, true]}}', r"expected \[x, y, z\] in m for head"),
        (f'{{"time": 1, "joints": {{"head": [0, 0, {10**400}]}}}}', r"for head, got \[0, 0, 1.{,60}\]$"),
        ('{"time": 1, "joints": 3}', "'joints' as an object"),
        ('{"joints": {}}', "expected 'time'"),
        ('{"time": true, "joints": {}}', "expected time in s"),
    ],
)
def test_lines_that_are_no_frames_are_refused_with_their_number(line, message):
    lines = [json.dumps({"time": 0, "joints": joints()}), line]
    with pytest.raises(InvalidMotionError, match=message) as raised:
        list(read_live_frames(lines))
    assert "line 2" in str(raised.value)


def test_the_first_frame_needs_all_joints():
    named = joints()
    del named["right_toe"]
    with pytest.raises(InvalidMotionError, match="line 1: the first frame needs all 20 joints; missing: right_toe"):
        list(read_live_frames([json.dumps({"time": 0, "joints": named})]))
