"""Several evaluations of one pupil: what became better is said, and what fails every time."""

import json
from typing import Any

import pytest

from app.fake_assessment import make_assessment
from dousa.errors import OptionError
from dousa.evaluation import SEGMENTS, compare_attempts, read_attempt


def event(kind: str, furi: int | None = 0, segments: tuple[str, ...] = ("left_upper_arm",), **sizes: float) -> dict:
    nothing = {"lag_ms": None, "shortfall_deg": None, "deviation_deg": None}
    return {"kind": kind, "start_s": 1.0, "end_s": 2.5, "segments": list(segments), "furi": furi, **nothing, **sizes}


def answer(score: float | None, *events: dict[str, Any], lapses: int = 0) -> dict[str, Any]:
    return {"score": score, "events": list(events), "lapses": [{}] * lapses}


def test_what_became_better_and_what_did_not() -> None:
    arm = event("incomplete", 4, ("left_upper_arm", "left_forearm"), shortfall_deg=20.0)
    first = answer(60.4, *(event("shift", k, SEGMENTS, lag_ms=-200.0) for k in range(3)), arm, lapses=2)
    second = answer(71.0, event("shift", 0, SEGMENTS, lag_ms=150.0), dict(arm, shortfall_deg=10.0))
    last = answer(80.0, event("global", 2, SEGMENTS), dict(arm, shortfall_deg=10.0))
    attempts = [read_attempt(one, f"{k}.bvh") for k, one in enumerate((first, second, last))]
    found = compare_attempts(attempts)
    assert (found.better, found.worse) == (("incomplete", "shift"), ("global",))
    assert found.still == (("incomplete", 4, "left_arm"),)
    assert found.summary.render("en") == (
        "the grade rose from 60 to 80; better: incomplete motion (20 deg, now 10 deg) and time shift (3, now 0); "
        "worse: global motion error (0, now 1); every time: incomplete motion of the left arm in figure 5"
    )
    plain = json.loads(json.dumps(found.to_json("en"), allow_nan=False))
    assert [one["score"] for one in plain["attempts"]] == [60.4, 71.0, 80.0]
    assert plain["attempts"][0]["sizes"] == {"global": None, "partial": None, "incomplete": 20.0, "shift": 200.0}
    assert plain["attempts"][2]["errors"] == {"global": 1, "partial": 0, "incomplete": 1, "shift": 0}
    assert [one["lapses"] for one in plain["attempts"]] == [2, 0, 0]
    assert plain["still"] == [{"kind": "incomplete", "furi": 4, "limb": "left_arm"}]


def test_the_same_again_is_neither() -> None:
    one = read_attempt(answer(70.0, event("partial", None, deviation_deg=30.0)), "a")
    found = compare_attempts([one, one])
    assert (found.better, found.worse, found.still) == ((), (), ())
    assert str(found.summary) == "the grade stayed at 70"
    unknown = compare_attempts([one, read_attempt(answer(None), "b")])
    assert str(unknown.summary) == "the grades cannot be compared; better: partial motion error (1, now 0)"


def test_what_fails_every_time_is_told_by_kind_and_figure() -> None:
    arms = ("left_upper_arm", "left_forearm", "right_upper_arm", "right_forearm")
    faults = [event("incomplete", 9, arms), event("shift", 0, SEGMENTS), event("global", 5, SEGMENTS)]
    attempt = read_attempt(answer(70.0, *faults), "a")
    found = compare_attempts([attempt, attempt])
    assert str(found.summary) == (
        "the grade stayed at 70; every time: global motion error of the whole body in figure 6, "
        "incomplete motion of both arms in figure 10 and time shift of the whole body in figure 1"
    )
    assert [one["limb"] for one in found.to_json()["still"]] == [None, "left_arm", "right_arm", None]
    many = read_attempt(answer(70.0, *(event("global", number, SEGMENTS) for number in range(6))), "b")
    assert compare_attempts([many, many]).summary.render("en").endswith("in figure 4, and 2 more")


def test_answers_of_assessments_can_be_read() -> None:
    attempt = read_attempt(make_assessment().to_json(), "pupil.bvh")
    assert attempt.score == 71.0 and attempt.lapses == 1
    assert attempt.counts == {"global": 1, "partial": 1, "incomplete": 1, "shift": 1}
    assert attempt.sizes["incomplete"] == 24.0 and attempt.sizes["shift"] == 200.0
    assert ("partial", 0, "right_arm") in attempt.faults
    assert set(attempt.segments) == set(SEGMENTS) and attempt.segments["right_forearm"] >= 1
    assert len(attempt.figures) == len(make_assessment().to_json()["furi"])


def test_errors_are_counted_by_segment_but_for_those_of_the_whole_body() -> None:
    events = [event("partial", 0, ("trunk", "left_thigh")), event("shift", 1, ("trunk",)), event("shift", 1, SEGMENTS)]
    given = {**answer(70.0, *events), "furi": [{"label": "a", "score": 71.0}, {"label": "b", "score": None}]}
    attempt = read_attempt(given, "x")
    assert {name: count for name, count in attempt.segments.items() if count} == {"trunk": 2, "left_thigh": 1}
    assert attempt.figures == (("a", 71.0), ("b", None))
    plain = compare_attempts([attempt, attempt]).to_json()["attempts"][0]
    assert plain["segments"]["trunk"] == 2 and plain["figures"][1] == {"label": "b", "score": None}


@pytest.mark.parametrize(
    "wrong", [{}, {"score": 1.0, "events": [3], "lapses": []}, {"score": "x", "events": [], "lapses": []}]
)
def test_something_else_is_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(OptionError, match=r"file: expected an answer of dousa evaluate --json"):
        read_attempt(wrong, "file")


def test_one_attempt_is_no_progress() -> None:
    with pytest.raises(OptionError, match="two evaluations or more, got 1"):
        compare_attempts([read_attempt(answer(70.0), "a")])
