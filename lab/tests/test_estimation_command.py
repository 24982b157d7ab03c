"""The program lab.estimation: tables, JSON, and what it refuses."""

from __future__ import annotations

import json
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from oracles.made_clips import write_clip

from dousa.errors import BodyModelError
from dousa.estimation.body.kinematics import point_names
from dousa.estimation.tracking.settings import PAPER, Estimate


def hold_start(silhouettes, cameras, body, start=None, *, settings, girths="fit", n_threads=None):
    """A tracker that finds nothing of its own."""
    if start is None:
        raise BodyModelError("text.verbatim", text="no start was found")
    n_frames = silhouettes.n_frames
    nothing = np.zeros((n_frames, len(point_names(body))))
    hidden = np.zeros((n_frames, body.n_parts), bool)
    iou = np.full((n_frames, len(cameras)), 0.8)
    poses = np.tile(start, (n_frames, 1))
    return Estimate(body, poses, 30.0, iou, nothing, hidden, hidden[:, 0], (), 44.0)


@pytest.fixture
def run(monkeypatch, program):
    module = SimpleNamespace(estimate=hold_start, PAPER=PAPER)
    monkeypatch.setitem(sys.modules, "dousa.estimation.tracking.tracker", module)

    def ask(*words):
        code, out, err = program("estimation", *words)
        return SimpleNamespace(exit_code=code, stdout=out, stderr=err)

    return ask


@pytest.fixture(scope="module")
def clip(tmp_path_factory):
    return write_clip(tmp_path_factory.mktemp("bench") / "wave_clean.npz")


def test_tables_show_the_estimate_beside_what_needs_no_image(run, clip):
    answer = run(clip, "--views", "1,2", "--jobs", 1)
    assert answer.exit_code == 0, answer.stderr
    for words in (
        "clean: mean over 1 clips",
        "estimated",
        "first pose held",
        "constant velocity",
        "44 frames/s",
    ):
        assert words in answer.stdout
    assert "2 views: 0 of 1 clips lost; nearer than the first pose held in 0" in answer.stdout


def test_json_holds_the_means_and_every_clip(run, clip):
    answer = json.loads(run(clip, "--views", "2", "--choice", "all", "--json", "--jobs", 1).stdout)
    assert [row["views"] for row in answer["clips"]] == [[0, 1], [0, 2], [1, 2]]
    assert answer["summary"][0]["n_clips"] == 1
    assert answer["settings"]["reading"] == "masked"


def test_what_the_tracker_refuses_is_a_note_and_a_lost_clip(run, clip):
    answer = run(clip, "--views", "1", "--start", "auto", "--jobs", 1)
    assert answer.exit_code == 0
    assert "1 of 1 clips lost" in answer.stdout
    assert "wave clean, views 0: no start was found" in answer.stderr


def test_the_papers_experiment_is_a_table_of_readings(run, clip):
    words = ("--paper", "--frames", "0:3", "--views", "1,2", "--reading", "masked", "--reading", "literal")
    answer = run(clip, *words, "--jobs", 1)
    assert answer.exit_code == 0, answer.stderr
    for text in (
        "frames 0 to 2",
        "with 1 / 2 views (those numbered 0 / 0, 2)",
        "literal",
        "W = 1",
        "says 4.61",
    ):
        assert text in answer.stdout
    told = json.loads(run(clip, *words, "--evidence", "local", "--json", "--jobs", 1).stdout)
    assert {(row["reading"], row["evidence"]) for row in told["rows"]} == {
        ("masked", "local"),
        ("literal", "local"),
    }


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        (("--views", "none"), "such as 1,2,4"),
        (("--views", "0"), "such as 1,2,4"),
        (("--views", "9"), "at most 3, got 9"),
        (("--frames", "0:4"), "requires --paper"),
        (("--paper", "--frames", "4"), "such as 40:76"),
        (("--paper", "--frames", "2:99"), "some of 0 to 6"),
        (("--paper", "--start", "auto"), "cannot be combined with --start"),
        (("--reading", "plain", "--reading", "masked"), "with --paper only"),
    ],
)
def test_what_cannot_be_is_said(run, clip, words, problem):
    answer = run(clip, *words)
    assert answer.exit_code == 2 and problem in answer.stderr


def test_the_paper_takes_one_file(run, clip):
    assert "name one .npz file" in run(clip.parent, "--paper").stderr
