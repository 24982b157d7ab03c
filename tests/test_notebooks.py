"""In a notebook: the examples run, reprs are short, answers become tables and frames, motions play offline."""

import json
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import dousa
import dousa.notebooks
from dousa.errors import MissingExtraError
from dousa.evaluation import assess
from dousa.motion import canonicalise
from dousa.motion.synthetic import draw_performer, make_motion

EXAMPLES = sorted((Path(__file__).parents[1] / "docs" / "examples").glob("*.ipynb"))


@pytest.fixture(scope="module")
def judged():
    takes = [canonicalise(make_motion("kick_left", draw_performer(1), seed)) for seed in range(4)]
    return assess(takes[:3], canonicalise(make_motion("kick_right", draw_performer(2))), side="same")


def test_there_is_one_for_each_method():
    assert [path.stem for path in EXAMPLES] == ["estimate", "evaluate", "search"]


@pytest.mark.parametrize(
    "path",
    [pytest.param(path, marks=[pytest.mark.slow] if path.stem == "estimate" else []) for path in EXAMPLES],
    ids=lambda path: path.stem,
)
def test_it_runs_from_top_to_bottom(path, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(dousa.notebooks, "require", lambda package, extra: SimpleNamespace(DataFrame=dict))
    known: dict[str, object] = {}
    for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
        if cell["cell_type"] == "code":
            assert not cell["outputs"], "what it shows is made where it is run"
            exec(compile("".join(cell["source"]), path.name, "exec"), known)


@pytest.mark.parametrize("make", [lambda m: m, lambda m: m.skeleton, dousa.compute_trajectories, canonicalise])
def test_reprs_are_one_short_line(make):
    said = repr(make(make_motion("walk", draw_performer(3))))
    assert len(said) < 300 and "\n" not in said and re.search(r"<float64 [\d x]+>", said)


def test_an_assessment_is_short_a_table_and_plays(judged, tmp_path):
    assert len(repr(judged)) < 2500 and "array(" not in repr(judged)
    assert judged._repr_html_().count("<tr>") == 1 + len(judged.events)
    figure = dousa.plot(judged)
    assert figure._repr_html_().startswith("<iframe srcdoc=")
    figure.save(tmp_path / "played.html")
    page = (tmp_path / "played.html").read_text(encoding="utf-8")
    assert "createPlayer(" in page and not re.search(r'(?:src|href)="?https?:', page)


@pytest.mark.parametrize("make", [lambda m: m, dousa.compute_trajectories, canonicalise])
def test_a_motion_plays_as_the_last_value_of_a_cell(make):
    assert make(make_motion("walk", draw_performer(3)))._repr_html_().startswith("<iframe srcdoc=")
    nobody = dousa.motion.Trajectories(("a", "b"), np.zeros((2, 2, 3)), 30.0)
    assert nobody._repr_html_() is None


@pytest.mark.parametrize("package", ["pandas", "polars"])
def test_rows_become_a_frame(package, judged, monkeypatch):
    frames = pytest.importorskip(package)
    monkeypatch.setattr(dousa.notebooks, "find_spec", lambda name: True if name == package else None)
    found = judged.to_frame()
    assert isinstance(found, frames.DataFrame) and len(found) == len(judged.events)
    assert list(found["kind"]) == [event.kind for event in judged.events]


def test_columns_are_plain_and_a_missing_package_is_said(judged, monkeypatch):
    monkeypatch.setattr(dousa.notebooks, "require", lambda package, extra: SimpleNamespace(DataFrame=dict))
    columns = judged.to_frame()
    assert {"kind", "start_s", "severity"} <= set(columns) and "segments" not in columns
    nothing = dousa.to_frame(replace(judged, events=()))
    assert list(nothing) == list(columns) and not any(nothing.values())

    def refuse(package, extra):
        raise MissingExtraError(package, extra)

    monkeypatch.setattr(dousa.notebooks, "require", refuse)
    with pytest.raises(MissingExtraError, match=r"pip install 'dousa\[frames\]'"):
        dousa.to_frame(judged)
