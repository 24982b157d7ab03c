"""The demonstration's second act: the dance, its pupil, and an honest comparison with the mistakes put in."""

import io
import itertools

import numpy as np
import pytest
from rich.console import Console

from dousa.app.demo import match_mistakes, run_dance_demo, write_dance
from dousa.evaluation import ErrorEvent
from dousa.formats.registry import read_motion
from dousa.motion import canonicalise
from dousa.motion.synthetic import Mistake

KINDS = ["global", "incomplete", "partial", "shift"]


def make_mistake(kind, start, end):
    return Mistake(kind, start, end, ("left_upper_arm", "left_forearm"))


def make_event(kind, start, end, lag=None, short=None):
    return ErrorEvent(kind, start, end, ("left_forearm",), lag, short, short, 2.0, start, start, None, "says")


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    folder = tmp_path_factory.mktemp("dance")
    return write_dance(folder, seed=0)


@pytest.mark.parametrize("seed", range(6))
def test_there_is_one_mistake_of_each_kind_whatever_the_seed(tmp_path, seed):
    _, _, mistakes = write_dance(tmp_path, seed)
    assert sorted(mistake.kind for mistake in mistakes) == KINDS
    starts = [mistake.start_s for mistake in mistakes]
    assert starts == sorted(starts)
    for before, after in itertools.pairwise(mistakes):
        assert after.start_s - before.end_s > 2


def test_the_same_seed_writes_the_same_files(written, tmp_path):
    again = write_dance(tmp_path, seed=0)
    for first, second in zip(written[:2], again[:2], strict=True):
        assert first.read_bytes() == second.read_bytes()
    assert written[2] == again[2]


def test_the_pupil_has_another_body_but_dances_this_dance(written):
    reference, pupil = (canonicalise(read_motion(path)) for path in written[:2])
    assert reference.n_frames == pupil.n_frames
    assert abs(reference.height / pupil.height - 1) > 0.01
    bones = [np.diff(motion.positions[:, [4, 5]], axis=1)[:, 0, 1] / motion.height for motion in (reference, pupil)]
    assert np.corrcoef(*bones)[0, 1] > 0.8  # how the left upper arm rises and falls


def test_mistakes_and_events_are_paired():
    mistakes = [make_mistake("shift", 1, 3), make_mistake("global", 5, 7), make_mistake("partial", 9, 10)]
    mistakes.append(make_mistake("incomplete", 14, 16))
    events = [
        make_event("shift", 1.1, 3.0),
        make_event("shift", 1.0, 2.2),  # covers the same mistake less well
        make_event("partial", 5.5, 7.5),
        make_event("partial", 9.7, 11),  # of the right kind, but overlaps little
        make_event("incomplete", 19, 21),
    ]
    assert match_mistakes(mistakes, events) == [events[0], events[2], events[3], None]
    assert match_mistakes([], events) == []
    assert match_mistakes(mistakes, []) == [None] * 4


def test_the_real_assessment_of_the_demonstration(tmp_path):
    console = Console(file=io.StringIO(), width=200)
    run_dance_demo(console, tmp_path / "out")
    text = console.file.getvalue()
    found = int(text.partition(" of 4 found and named right")[0].rpartition("\n")[2])
    assert found >= 3  # what is found may change with the limits, most of it is
    assert (tmp_path / "out/report/report.html").stat().st_size > 100_000
