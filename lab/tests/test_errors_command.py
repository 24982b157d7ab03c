"""The program lab.errors: its table, its JSON, and what it refuses."""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from dousa.evaluation import ErrorEvent
from dousa.formats.registry import write_motion
from dousa.motion.synthetic.performers import draw_performer, make_motion


@pytest.fixture(scope="session")
def takes(tmp_path_factory) -> Path:
    """BVH files of one synthetic person: takes/t0.bvh ... t2.bvh, and pupil.bvh beside the folder."""
    folder = tmp_path_factory.mktemp("evaluate")
    (folder / "takes").mkdir()
    for number in range(3):
        write_motion(make_motion("squat", draw_performer(1), number), folder / "takes" / f"t{number}.bvh")
    write_motion(make_motion("squat", draw_performer(2)), folder / "pupil.bvh")
    return folder


@pytest.fixture
def blind(monkeypatch):
    """A made-up `assess` that always finds a time shift from 0.5 to 1.5 s."""

    def assess(references, performance, **_):
        calls.append(len(references))
        event = ErrorEvent("shift", 0.5, 1.5, ("trunk",), 100.0, None, None, 1.5, 1.0, 0.9, None, "late")
        return SimpleNamespace(events=(event,))

    calls: list[int] = []
    monkeypatch.setitem(sys.modules, "dousa.evaluation.grade.assessment", SimpleNamespace(assess=assess))
    return calls


def test_the_experiment_tells_what_is_found(program, takes, blind):
    code, out, _ = program("errors", takes / "takes", "--jobs", 1)
    assert code == 0
    for word in ("precision", "shift", "incomplete", "partial", "global", "mean", "a minute", "Recall by kind",
                 "no error", "median onset error"):  # fmt: skip
        assert word in out


def test_the_experiment_as_json_and_second_takes(program, takes, blind, tmp_path):
    shutil.copy(takes / "pupil.bvh", tmp_path / "alone_0.bvh")
    (tmp_path / "bad.bvh").write_text("")
    for path in (takes / "takes").iterdir():
        shutil.copy(path, tmp_path)
    words = ("--jobs", 1, "--takes-from", "name:^(.*?)_?[0-9]", "--references", 2, "--json")
    code, out, err = program("errors", tmp_path, "--repeats", 2, *words)
    assert code == 0 and "left out" in err
    answer = json.loads(out)
    assert answer["sets"]["all"]["n_motions"] == 4 and answer["repeats"] == 2
    second = answer["second_takes"]
    assert (second["n_takes"], second["n_groups"], second["n_alone"]) == (3, 1, 1)
    assert second["per_minute"] == pytest.approx(3 / second["minutes"])
    assert second["n_with_fewer_references"] == 0
    assert Path(answer["skipped"][0]["path"]).name == "bad.bvh"
    code, out, _ = program("errors", tmp_path, "--repeats", 0, *words[:-1])
    assert code == 0 and "Other takes of the same, 2 references: 3 takes" in out and "precision" not in out
    assert set(blind) == {1, 2}


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("{dir}",), "no motion found below"),
        (("{dir}/none",), "no motion found below"),
        (("{takes}", "--repeats", "0"), "leaves nothing to do"),
        (("{takes}", "--takes-from", "mood", "--repeats", "0"), "rule for the takes: expected folder"),
        (("{takes}", "--takes-from", "name:(t.)", "--repeats", "0"), "expected two or more takes"),
    ],
)
def test_mistakes_of_the_experiment(program, takes, blind, tmp_path, words, says):
    code, out, err = program("errors", *(word.format(takes=takes / "takes", dir=tmp_path) for word in words))
    assert code == 2 and out == "" and says in err and len(err.splitlines()) == 1


@pytest.mark.parametrize("words", [("--noise", "inf"), ("--noise", "1e9"), ("--timing", "inf"), ("--noise", "nan")])
def test_a_performer_beyond_all_measure_is_refused(program, takes, words):
    code, out, err = program("errors", takes / "pupil.bvh", *words)
    assert code == 2 and not out and words[0] in err
