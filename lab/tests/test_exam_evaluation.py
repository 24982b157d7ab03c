"""The exam of the evaluation, where it can be wrong without anybody noticing: clips joined, and marks given."""

from __future__ import annotations

import dataclasses
import importlib
from types import ModuleType

import numpy as np
import pytest

from dousa.motion import canonicalise
from dousa.motion.synthetic.performers import draw_performer, make_motion

MODULES = ("bodies", "placing", "cases", "marks")


@pytest.fixture
def exam() -> dict[str, ModuleType]:
    """Its modules by their names."""
    return {name: importlib.import_module(f"lab.exams.dance.{name}") for name in MODULES}


def make_bodies(exam):
    names = ("wave_left", "wave_right")
    return [exam["bodies"].Body.of(canonicalise(make_motion(name, draw_performer(1)))) for name in names]


def test_a_body_is_the_motion_that_it_is_made_of(exam):
    motion = canonicalise(make_motion("wave_left", draw_performer(1)))
    body = exam["bodies"].Body.of(motion)
    step = round(motion.frame_rate / body.rate)
    np.testing.assert_allclose(body.positions(), motion.positions[::step], atol=1e-9)


def test_clips_are_joined_without_a_leap(exam):
    first, second = make_bodies(exam)
    whole = exam["bodies"].medley([first, second], pause_s=0.4)
    assert len(whole) == len(first) + len(second) + round(0.4 * first.rate)
    np.testing.assert_allclose(whole.root[: len(first)], first.root)
    step = np.linalg.norm(np.diff(whole.root, axis=0), axis=1)
    assert step.max() < 0.05 + max(np.linalg.norm(np.diff(one.root, axis=0), axis=1).max() for one in (first, second))
    joint = len(whole) - len(second)
    np.testing.assert_allclose(whole.root[joint, [0, 2]], first.root[-1, [0, 2]], atol=1e-9)
    assert abs(whole.heading()[joint] - first.heading()[-1]) < 1e-6


def make_case(exam, body, truths):
    return exam["cases"].Case("synthetic", "HDM05", [body], body, body, truths)


@pytest.fixture
def truths(exam):
    make = exam["placing"].Truth
    return [
        make("limb shift", 1.0, 2.0, ("left_forearm",), lag_ms=200.0),
        make("global", 3.0, 4.0, ("trunk", "left_forearm")),
    ]


def name_class(exam, truths):
    """Truths as a candidate would tell them."""
    return [_Told(exam["placing"].CLASS_OF[t.kind], t.start_s, t.end_s, t.segments, t.lag_ms) for t in truths]


@dataclasses.dataclass
class _Told:
    kind: str
    start_s: float
    end_s: float
    segments: tuple[str, ...]
    lag_ms: float | None = None
    shortfall_deg: float | None = None


def mark(exam, truths, told, twin=()):
    tally = exam["marks"].Tally()
    tally.add(make_case(exam, make_bodies(exam)[0], truths), told, list(twin))
    return tally


def test_the_truth_itself_has_full_marks(exam, truths):
    told = name_class(exam, truths)
    told[0].lag_ms = 150.0
    tally = mark(exam, truths, told)
    assert tally.macro() == tally.micro() == 1.0 and tally.wrong() == 0
    assert tally.lags == [50.0] and tally.kinds["limb shift"] == [1, 1]


def test_silence_has_none(exam, truths):
    tally = mark(exam, truths, [])
    assert tally.macro() == 0.0 and tally.wrong() == 0


@pytest.mark.parametrize(
    "change", [{"kind": "partial"}, {"start_s": 2.1, "end_s": 2.9}, {"end_s": 3.5}, {"segments": ("right_shank",)}]
)
def test_another_class_time_or_limb_is_no_find(exam, truths, change):
    told = name_class(exam, truths)
    told[0] = dataclasses.replace(told[0], **change)
    tally = mark(exam, truths, told)
    assert tally.right.total() == 1 and tally.wrong() == 1


def test_one_report_answers_one_error_and_reports_on_the_clean_twin_are_wrong(exam, truths):
    told = name_class(exam, truths)
    tally = mark(exam, truths, [*told, told[1]], twin=told[:1])
    assert tally.right.total() == 2 and tally.wrong() == 2 and tally.alarms == 1
