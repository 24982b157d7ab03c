"""``dousa evaluate --repetitions`` as a person uses it: table, JSON, CSV, picture, and mistakes in one line."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from dousa.formats.registry import write_motion
from dousa.motion import canonicalise, compute_trajectories
from dousa.motion.synthetic.performers import draw_performer, make_motion
from lab.trials.exercise_sets import join_repetitions


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> Path:
    """kick.trc, and kicks.trc: four more, of which one is broken off; bow.trc; still.trc."""
    folder = tmp_path_factory.mktemp("repetitions")
    performer = draw_performer(303)
    takes = [canonicalise(compute_trajectories(make_motion("kick_left", performer, take))) for take in range(14)]
    kick, *kicks = [take for take in takes if take.duration * performer.tempo < 2.7][:5]
    several = join_repetitions(kicks, np.random.default_rng(4), broken_off=[1]).motion
    write_motion(kick.to_trajectories(), folder / "kick.trc")
    write_motion(several.to_trajectories(), folder / "kicks.trc")
    still = kick.to_trajectories().replace(positions=np.repeat(kick.positions[:1], 90, axis=0))
    write_motion(still, folder / "still.trc")
    return folder


def test_the_table_and_the_report_as_csv(succeed, files, tmp_path):
    words = ("evaluate", files / "kick.trc", "--performance", files / "kicks.trc", "--repetitions")
    out, err = succeed(*words, "-o", tmp_path)
    assert out.startswith("3 repetitions, 1 incomplete")
    assert "left hip flexion" in out and "incomplete: reaches" in out
    assert "note: 3 repetitions: a trend can be told from chance from six repetitions on" in err
    rows = list(csv.DictReader((tmp_path / "repetitions.csv").read_text().splitlines()))
    assert [row["complete"] for row in rows] == ["1", "0", "1", "1"]
    assert rows[1]["score"] == "" and float(rows[0]["score"]) > 50
    assert float(rows[0]["left_hip_flexion_range_deg"]) > 40


def test_brief_is_the_answer_without_the_table(succeed, files):
    words = ("evaluate", files / "kick.trc", "--performance", files / "kicks.trc", "--repetitions")
    full, _ = succeed(*words)
    brief, _ = succeed(*words, "--detail", "brief")
    lines = brief.splitlines()
    assert lines[0].startswith("3 repetitions, 1 incomplete")
    assert lines[1].startswith("grade ")
    assert "repetition 2: broken off" in brief and "trend" not in brief, "of three a note says that it cannot be told"
    assert set(lines) < set(full.splitlines())
    assert "no. " in full and "no. " not in brief


def test_the_tempo_counts(dousa, files):
    words = ("evaluate", files / "kick.trc", "--performance", files / "kicks.trc", "--repetitions", "--json")
    usual = json.loads(dousa(*words)[1])
    assert usual["tempo"] == "free"
    assert usual["says_codes"][1] == "exercise_summary.broken_off"
    free, same = (json.loads(dousa(*words, "--tempo", tempo)[1]) for tempo in ("free", "same"))
    assert free == usual
    assert same["tempo"] == "same"
    scores = [[one["score"] for one in answer["repetitions"]] for answer in (usual, same)]
    assert scores[0] != scores[1]


@pytest.mark.parametrize(("language", "title"), [("en", "kicks.trc: repetitions"), ("ja", "kicks.trc：手本と")])
def test_the_report(dousa, files, tmp_path, language, title):
    words = ("--lang", language, "evaluate", files / "kick.trc", "--performance", files / "kicks.trc", "--repetitions")
    code, out, _ = dousa(*words, "-o", tmp_path / "report")
    assert code == 0 and str(tmp_path / "report" / "report.html") in out
    page = (tmp_path / "report" / "report.html").read_text(encoding="utf-8")
    assert f"<title>{title}" in page
    assert len((tmp_path / "report" / "repetitions.csv").read_text().splitlines()) == 5
    code, out, _ = dousa(*words, "-o", tmp_path / "report", "--json")
    assert json.loads(out)["report"] == str(tmp_path / "report" / "report.html")


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("kick.trc", "-p", "still.trc", "--repetitions"), "expected at least one repetition of the reference"),
        (("still.trc", "-p", "kicks.trc", "--repetitions"), "still.trc: reference: expected an exercise"),
        (("kick.trc", "-p", "kicks.trc", "--repetitions", "--furi", "a.txt"), "--furi cannot be combined"),
        (("kick.trc", "-p", "kicks.trc", "--repetitions", "-o", "kick.trc"), "kick.trc"),
    ],
)
def test_mistakes_are_one_line(dousa, files, monkeypatch, words, says):
    monkeypatch.chdir(files)
    code, out, err = dousa("evaluate", *words)
    assert code == 2
    assert out == ""
    assert says in err and "Traceback" not in err
    assert sum(not line.startswith("dousa: note:") for line in err.splitlines()) == 1
