"""The demonstration's second act: the dance and its pupil, and an honest comparison with what was injected."""

from __future__ import annotations

import io
import itertools
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from rich.console import Console

import dousa.evaluation
from app.fake_assessment import make_assessment
from dousa.app.demo.evaluation import compare_with_truth, run_dance_demo, write_dance
from dousa.errors import OptionError
from dousa.evaluation import ErrorEvent
from dousa.formats.registry import read_motion
from dousa.motion import canonicalise
from lab.injection.injection import Error

KINDS = ["global", "incomplete", "partial", "shift"]


def make_error(kind, start, end, **sizes):
    return Error(kind, "any", start, end, ("left_upper_arm", "left_forearm"), **sizes)


def make_event(kind, start, end, lag=None, short=None):
    return ErrorEvent(kind, start, end, ("left_forearm",), lag, short, short, 2.0, start, start, None, "says")


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    folder = tmp_path_factory.mktemp("dance")
    return write_dance(folder, seed=0)


@pytest.mark.parametrize("seed", range(6))
def test_there_is_one_error_of_each_class_whatever_the_seed(tmp_path, seed):
    _, _, errors = write_dance(tmp_path, seed)
    assert sorted(error.kind for error in errors) == KINDS
    starts = [error.start_s for error in errors]
    assert starts == sorted(starts)
    for before, after in itertools.pairwise(errors):
        assert after.start_s - before.end_s > 2


def test_the_same_seed_writes_the_same_files(written, tmp_path):
    again = write_dance(tmp_path, seed=0)
    for first, second in zip(written[:2], again[:2], strict=True):
        assert first.read_bytes() == second.read_bytes()
    assert written[2] == again[2]


def test_the_pupil_is_somebody_else_but_dances_this_dance(written):
    reference, pupil = (canonicalise(read_motion(path)) for path in written[:2])
    assert reference.n_frames == pupil.n_frames
    assert abs(reference.height / pupil.height - 1) > 0.01
    bones = [np.diff(motion.positions[:, [4, 5]], axis=1)[:, 0, 1] / motion.height for motion in (reference, pupil)]
    assert np.corrcoef(*bones)[0, 1] > 0.8  # how the left upper arm rises and falls


def test_errors_and_events_are_paired():
    errors = [make_error("shift", 1, 3), make_error("global", 5, 7), make_error("partial", 9, 10)]
    errors.append(make_error("incomplete", 14, 16))
    events = [
        make_event("shift", 1.1, 3.0),
        make_event("shift", 1.0, 2.2),  # covers the same error less well
        make_event("partial", 5.5, 7.5),
        make_event("partial", 9.7, 11),  # of the right class, but hardly there
        make_event("incomplete", 19, 21),
    ]
    pairs, others = compare_with_truth(errors, events)
    assert pairs == [
        (errors[0], events[0], True),
        (errors[1], events[2], False),
        (errors[2], events[3], False),
        (errors[3], None, False),
    ]
    assert others == [events[1], events[4]]
    assert compare_with_truth([], events) == ([], events)
    assert compare_with_truth(errors, []) == ([(error, None, False) for error in errors], [])


@pytest.fixture
def told(monkeypatch, tmp_path):
    """Runs the act with a made-up assessment; returns what it prints."""

    def write_report(assessment, folder, language="en"):
        Path(folder).mkdir(exist_ok=True)
        page = Path(folder) / "report.html"
        page.write_text("page")
        return page

    monkeypatch.setitem(dousa.evaluation.__dict__, "assess", lambda *_, **__: make_assessment())
    monkeypatch.setitem(sys.modules, "dousa.app.report", SimpleNamespace(write_report=write_report))

    def run(output):
        console = Console(file=io.StringIO(), width=200)
        run_dance_demo(console, output)
        return console.file.getvalue()

    return run


def test_what_is_printed_and_written(told, tmp_path):
    for _ in range(2):  # it can be run again
        text = told(tmp_path / "out")
    for word in (
        "dance_reference.bvh",
        "grade 71 of 100",
        "injected",
        "of 4 found and named right",
        f"dousa evaluate {tmp_path / 'out/dance_reference.bvh'} --performance",
        str(tmp_path / "out/report/report.html"),
    ):
        assert word in text
    names = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert names == ["dance_pupil.bvh", "dance_reference.bvh", "report"]


def test_where_it_cannot_write_is_said(told, tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(OptionError, match="choose another with --output"):
        told(tmp_path / "file" / "out")


def test_the_real_assessment_of_the_demonstration(tmp_path):
    console = Console(file=io.StringIO(), width=200)
    run_dance_demo(console, tmp_path / "out")
    text = console.file.getvalue()
    found = int(text.partition(" of 4 found and named right")[0].rpartition("\n")[2])
    assert found >= 3  # what is found may change with the limits, most of it is
    assert (tmp_path / "out/report/report.html").stat().st_size > 100_000
