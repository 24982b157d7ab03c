"""The scripts behind the tutorial's table and pictures of the chain, without recordings."""

from __future__ import annotations

import importlib
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from dousa.motion import canonicalise
from dousa.motion.synthetic.performers import draw_performer, make_motion

SCRIPTS = ("measured_chain", "measure_chain", "make_chain_figures")


@pytest.fixture
def scripts() -> list[ModuleType]:
    """The three scripts."""
    return [importlib.import_module(f"lab.figures.{name}") for name in SCRIPTS]


def test_wrong_figures_are_others_and_stay_the_same(scripts):
    measured = scripts[0]
    chain = measured.Chain(Path(), Path(), ("1",), ("bow", "clap", "wave", "walk"), 2)
    clip = measured.Clip(Path("a1_s3_t1.npz"), Path(), "clap", "3", "1")
    drawn = measured.choose_wrong(chain, clip)
    assert len(set(drawn)) == 2 and "clap" not in drawn
    assert drawn == measured.choose_wrong(chain, clip)


@pytest.mark.parametrize(
    ("right", "wrong", "expected"),
    [(80, (20, 40), 1.0), (30, (20, 40), 0.5), (0, (0, 0), 0.5), (0, (9,), 0.0)],
)
def test_right_beats_wrong(scripts, right, wrong, expected):
    graded = [{"right": {"grade": right}, "wrong": {str(k): {"grade": one} for k, one in enumerate(wrong)}}]
    assert scripts[1].compare(graded, "grade", 1.0) == expected


def test_somebody_who_stands_upright_leans_little_and_one_who_is_tilted_leans(scripts):
    motion = canonicalise(make_motion("wave_left", draw_performer(1)))
    assert scripts[0].describe_lean(motion) < 10
    angle = np.radians(30)
    turn = np.array([[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]])
    tilted = type("Tilted", (), {"positions": motion.positions @ turn.T})
    assert scripts[0].describe_lean(tilted) == pytest.approx(30, abs=10)


def test_alike_places_have_no_correlation(scripts):
    assert np.isnan(scripts[1].correlate([0.1, 0.2], [1, 1]))
    assert scripts[1].correlate([0.1, 0.2, 0.5], [1, 2, 9]) == pytest.approx(1.0)


def test_pictures_stay_as_they_are_without_answers(scripts, tmp_path, capsys):
    scripts[2].make_all(tmp_path, tmp_path / "chain-output")
    assert "stay as they are" in capsys.readouterr().out
