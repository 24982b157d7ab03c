"""Beats of files and recordings, and the timing of accents against them."""

import json
import math

import numpy as np
import pytest

from dousa.errors import InvalidMotionError, MotionFileError, OptionError
from dousa.evaluation import Beats, assess_timing, read_beats
from evaluation.beats.accented import make_body, wave

EXPECTED = [0.5, 1.0, 1.5, 2.0, 2.5]


@pytest.mark.parametrize(
    "text",
    [
        "0.5\n1.0\n1.5\n2\n2.5\n",
        "time\n0.5\n1.0\n1.5\n2\n2.5\n",
        "# beats of a song\n\n0.5\n1.0\n\n1.5\n2\n2.5",
        "TIME,LABEL\r\n0.5,1\r\n1.0,2\r\n1.5,3\r\n2.0,4\r\n2.5,1\r\n",
        '"0.5";"1"\n"1.0";"2"\n"1.5";"3"\n"2.0";"4"\n"2.5";"1"\n',
        "0.500000\t0.500000\t1\n1.0\t1.0\t2\n\\\t100.0\t2000.0\n1.5\t1.5\t3\n2.0\t2.0\t4\n2.5\t2.5\tlast beat\n",
        "0.50 1\n1.00 2\n1.50 3\n2.00 4\n2.50 1\n",
        "\ufeff0.5\n1.0\n1.5\n2\n25e-1\n",
    ],
)
def test_beats_are_read(tmp_path, text):
    (tmp_path / "beats.csv").write_bytes(text.encode("utf-8"))
    np.testing.assert_allclose(read_beats(tmp_path / "beats.csv").times, EXPECTED)


@pytest.mark.parametrize(
    ("content", "code", "line"),
    [
        (b"", "beats.too_few", None),
        (b"time\n", "beats.too_few", None),
        (b"0.5\nsoon\n", "beats.no_time", 2),
        (b"one\ntwo\nthree\n", "beats.no_time", 2),
        (b"time\n0.5\nnan\n", "beats.no_time", 3),
        (b"0.5\n1\n1.5\ninf\n", "beats.no_time", 4),
        (b"0.5\n1.5\n1\n2\n", "beats.unsorted", None),
        (b"RIFF\x00\x00\x00WAVE", "small_text.zero_bytes", None),
        (b"\xff\xfe\x30", "small_text.not_utf8", None),
    ],
)
def test_files_that_are_no_beats(tmp_path, content, code, line):
    path = tmp_path / "beats.csv"
    path.write_bytes(content)
    with pytest.raises(MotionFileError) as caught:
        read_beats(path)
    assert (caught.value.code, caught.value.line) == (code, line)
    assert str(path) in str(caught.value)


RATE = 60.0
BEATS = np.arange(0.0, 40.0, 0.5)
TOLERATED_MS = 25.0


def dance(times):
    """A performance whose left hand comes to rest at these times."""
    return make_body({"left_hand": wave(np.asarray(times), RATE)}, RATE)


@pytest.mark.parametrize("late_ms", [-150.0, -80.0, 0.0, 60.0, 140.0, 200.0])
def test_lateness_throughout(late_ms):
    timing = assess_timing(dance(BEATS[2:50:2] + late_ms / 1000.0), BEATS, music_start_s=0.0)
    assert timing.follows and timing.subdivision == 1 and not timing.start_estimated
    assert timing.median_ms == pytest.approx(late_ms, abs=TOLERATED_MS)
    assert timing.spread_ms < 5.0 and not timing.drift_distinguishable
    assert timing.agreement > 0.98
    assert len(timing.on_beat) == 24
    assert [one.beat for one in timing.on_beat] == list(range(3, 51, 2))
    assert timing.tempo == pytest.approx(120.0)
    said = " ".join(str(message) for message in timing.messages)
    assert "estimated" not in said
    if abs(late_ms) > 50.0:
        assert ("late" if late_ms > 0 else "early") in said


def test_the_start_of_the_music_is_counted():
    timing = assess_timing(dance(BEATS[2:50:2] + 3.2 + 0.06), BEATS, music_start_s=3.2)
    assert timing.median_ms == pytest.approx(60.0, abs=TOLERATED_MS)
    assert timing.on_beat[0].beat == 3
    begun = assess_timing(dance(BEATS[10:50:2] - 3.2 + 0.06), BEATS, music_start_s=-3.2)
    assert begun.median_ms == pytest.approx(60.0, abs=TOLERATED_MS)
    assert begun.on_beat[0].beat == 11


def test_spread():
    scatter = np.random.default_rng(3).normal(0.0, 0.04, 35)
    timing = assess_timing(dance(BEATS[2:72:2] + scatter), BEATS, music_start_s=0.0)
    assert timing.follows
    assert timing.spread_ms == pytest.approx(0.6745 * 40.0, abs=10.0)
    off = np.array([one.off_ms for one in timing.on_beat])
    assert np.median(np.abs(off - 1000.0 * scatter)) <= TOLERATED_MS


@pytest.mark.parametrize("drift_ms_per_min", [-400.0, 150.0, 1200.0])
def test_drift(drift_ms_per_min):
    times = BEATS[2:72:2]
    timing = assess_timing(dance(times + drift_ms_per_min / 60_000.0 * times), BEATS, music_start_s=0.0)
    assert timing.follows and timing.drift_distinguishable
    assert timing.drift_ms_per_min == pytest.approx(drift_ms_per_min, rel=0.1)
    assert "behind" in str(timing.messages[1]) if drift_ms_per_min > 0 else "ahead" in str(timing.messages[1])


def test_beats_of_a_tempo_that_changes():
    beats = np.cumsum(np.linspace(0.6, 0.45, 70))
    timing = assess_timing(dance(beats[1:50:2] + 0.05), beats, music_start_s=0.0)
    assert timing.median_ms == pytest.approx(50.0, abs=TOLERATED_MS)
    assert timing.spread_ms < 8.0


def test_half_beats():
    slow = np.arange(0.0, 60.0, 1.2)
    timing = assess_timing(dance(np.arange(1.2, 30.0, 0.6) + 0.04), slow, music_start_s=0.0)
    assert timing.subdivision == 2 and timing.follows
    assert timing.median_ms == pytest.approx(40.0, abs=TOLERATED_MS)
    assert [one.beat for one in timing.on_beat][:3] == [2.0, 2.5, 3.0]


@pytest.mark.parametrize("start_s", [-2.3, 0.0, 0.17, 4.4])
def test_the_start_is_estimated_up_to_whole_beats_and_says_so(start_s):
    timing = assess_timing(dance(BEATS[12:60:2] + start_s), BEATS)
    assert timing.start_estimated and timing.follows
    whole = (timing.start_s - start_s) / 0.5
    assert abs(whole - round(whole)) * 500.0 <= TOLERATED_MS
    assert math.isnan(timing.median_ms)  # what the estimate has taken away cannot be told
    assert timing.to_json()["median_ms"] is None
    assert timing.spread_ms < 5.0
    assert np.median([one.off_ms for one in timing.on_beat]) == pytest.approx(0.0, abs=1e-6)
    assert timing.messages[-1].code == "beats.start_estimated"


def test_a_tempo_that_changes_gives_the_start_itself():
    beats = np.cumsum(np.linspace(0.7, 0.4, 60))
    timing = assess_timing(dance(beats[8:58:2] + 2.0), beats)
    assert timing.start_s == pytest.approx(2.0, abs=0.03)


@pytest.mark.parametrize("start_s", [0.0, None])
def test_another_tempo_is_no_agreement(start_s):
    rng = np.random.default_rng(5)
    timing = assess_timing(dance(1.0 + np.cumsum(rng.uniform(0.5, 1.1, 40))), BEATS, music_start_s=start_s)
    assert not timing.follows
    assert [message.code for message in timing.messages] == ["beats.no_agreement"]


def test_chance_is_rarely_taken_for_agreement():
    from dousa.evaluation.beats.accents import Accent
    from dousa.evaluation.beats.beats import _measure

    beats, follows = Beats(BEATS), 0
    for seed in range(300):
        times = np.sort(np.random.default_rng(seed).uniform(0.0, 39.0, 30))
        accents = [Accent(float(time), "stop", ("left_hand",), 1.0) for time in times]
        follows += _measure(accents, beats, 0.0, False).follows
    assert follows <= 9  # 3 expected of 300 at p < 0.01


def test_the_answer_as_json():
    timing = assess_timing(dance(BEATS[2:50:2] + 0.1), BEATS, music_start_s=0.0)
    answer = json.loads(json.dumps(timing.to_json("ja")))
    assert answer["n_on_beat"] == len(answer["accents"]) == 24
    assert answer["accents"][0]["kind"] == "stop" and answer["accents"][0]["parts"] == ["left_hand"]
    assert answer["accents"][0]["beat_s"] == 1.0
    assert "遅れ" in answer["says"][0] and answer["says_codes"][0] == "beats.late"


@pytest.mark.parametrize(
    ("beats", "code"),
    [
        ([], "beats.too_few"),
        ([1.0, 2.0, 3.0], "beats.too_few"),
        ([[1.0, 2.0], [3.0, 4.0]], "beats.too_few"),
        ([1.0, 3.0, 2.0, 4.0], "beats.unsorted"),
        ([1.0, 2.0, 2.0, 4.0], "beats.unsorted"),
        ([1.0, 1.01, 2.0, 4.0], "beats.too_close"),
        ([1.0, 2.0, math.nan, 4.0], "beats.not_finite"),
        ([1.0, 2.0, 3.0, math.inf], "beats.not_finite"),
        (["one", "two"], "beats.no_numbers"),
    ],
)
def test_beats_that_cannot_be(beats, code):
    with pytest.raises(OptionError) as caught:
        assess_timing(dance(BEATS[2:20:2]), beats)
    assert caught.value.code == code
    assert str(caught.value)


def test_music_that_does_not_fit():
    performance = dance(BEATS[2:50:2])
    with pytest.raises(InvalidMotionError, match="shorter than the dance"):
        assess_timing(performance, BEATS[:20])
    with pytest.raises(OptionError, match="--music-start"):
        assess_timing(performance, BEATS, music_start_s=300.0)
    with pytest.raises(OptionError, match="expected seconds"):
        assess_timing(performance, BEATS, music_start_s=math.nan)
    with pytest.raises(InvalidMotionError, match="at least 5 accents"):
        assess_timing(make_body({"left_hand": np.zeros((300, 3))}, RATE), BEATS)
