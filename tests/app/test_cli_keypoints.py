"""`dousa models`: what a person or a program is told of it."""

from __future__ import annotations

import json

import pytest


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("DOUSA_MODELS", str(tmp_path / "models"))
    return tmp_path / "models"


def test_models_are_listed(dousa, folder):
    code, out, _ = dousa("models", "--json")
    answer = json.loads(out)
    assert code == 0 and answer["folder"] == str(folder)
    assert {name: row["state"] for name, row in answer["models"].items()} == dict.fromkeys(
        ("detector", "lite", "full", "heavy"), "missing"
    )
    code, out, _ = dousa("models", "list")
    assert code == 0 and str(folder) in out and out.count("not installed") == 4 and "Apache-2.0" in out
    assert not folder.exists()


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("install", "--from", "none.tgz"), "none.tgz: no such file"),
        (("install", "huge"), "detector, lite, full or heavy"),
        (("list", "--from", "x.tgz"), "dousa models install"),
        (("remove",), "install"),
    ],
)
def test_mistakes_are_one_line(dousa, folder, words, says):
    code, out, error = dousa("models", *words)
    assert (code, out, error.count("\n")) == (2, "", 1)
    assert says in error
    assert not folder.exists()
