"""Files of one skeleton vote on up axis and unit; what no reader takes is counted; empty folders make no library."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

from dousa.app.cli.library import _check_before_making
from dousa.app.requests.library import LabelRules
from dousa.errors import OptionError
from dousa.formats.motion_files import FrameClaim, FrameVotes, ReadOptions
from dousa.library import Library
from dousa.motion import Trajectories, compute_trajectories

CLAIM = FrameClaim(("bvh", ("Hips",)), "y", "assumed", 0.01, "inferred", 160.0)


def _votes(*claims: FrameClaim) -> FrameVotes:
    votes = FrameVotes()
    for claim in claims:
        votes.count(claim)
    return votes


def test_those_that_know_decide() -> None:
    guess = replace(CLAIM, up="z", up_source="guessed")
    up, unit, notes = _votes(CLAIM, CLAIM, CLAIM, guess).elect(guess)
    assert (up, unit, [note.code for note in notes]) == ("y", None, ["units.voted_up"])
    assert _votes(guess, replace(guess, up="y")).elect(guess) == (None, None, ())  # guesses have no vote
    assert _votes(CLAIM, replace(CLAIM, up="z"), guess).elect(guess)[0] is None  # nor have those that disagree
    other = replace(guess, skeleton=("bvh", ("Root",)))
    assert _votes(CLAIM, CLAIM, other).elect(other) == (None, None, ())


def test_a_guess_that_is_right_is_confirmed() -> None:
    guess = replace(CLAIM, up_source="guessed")
    assert _votes(CLAIM, guess).elect(guess) == ("y", None, ())


def test_bodies_of_one_program_get_one_unit() -> None:
    first, second = (replace(CLAIM, unit_source="assumed", unit=1.55 / h, height=h) for h in (38.0, 45.0))
    votes = _votes(first, second)
    assert votes.elect(first)[1] == pytest.approx(votes.elect(second)[1])
    assert votes.elect(first)[1] == pytest.approx(1.55 / np.sqrt(38 * 45))
    giant = replace(first, height=4000.0)
    assert _votes(first, giant).elect(giant)[1] is None  # another unit altogether


def test_the_vote_in_a_library(foreign, tmp_path) -> None:
    with Library.open(tmp_path / "moves.dousa", create=True) as library:
        report = library.add([foreign("animateddrawings"), foreign("acclaim_male1_accad")])
        assert not report.skipped
        said = {}
        for path, note in report.warnings:
            said.setdefault(path.rpartition("/")[2], set()).add(note.code)
        for name in ("dab", "jumping", "wave_hello", "zombie"):
            assert "units.voted_unit" in said[f"{name}.bvh"]
        assert "units.guessed_up" not in said.get("Male1_A9_LieDown.bvh", set())
        again = library.add([foreign("animateddrawings"), foreign("acclaim_male1_accad")])
        assert not again.added
        assert not again.replaced


def test_what_no_reader_takes_is_counted(tmp_path) -> None:
    folder = tmp_path / "moves"
    folder.mkdir()
    for name in ("a.bip", "b.BIP", "c.mot", "notes"):
        (folder / name).write_bytes(b"x")
    with Library.open(tmp_path / "moves.dousa", create=True) as library:
        assert dict(library.add([folder]).passed_over) == {".bip": 2, ".mot": 1, "": 1}


def test_a_folder_without_motions_makes_no_library(tmp_path) -> None:
    folder = tmp_path / "empty"
    folder.mkdir()
    with pytest.raises(OptionError, match="no motion file"):
        _check_before_making(str(tmp_path / "moves.dousa"), [folder], LabelRules(), ReadOptions())
    shutil.rmtree(folder)
    with pytest.raises(OptionError, match="empty"):
        _check_before_making(str(tmp_path / "moves.dousa"), [folder], LabelRules(), ReadOptions())


def test_trajectories_of_trajectories() -> None:
    given = Trajectories(("a",), np.zeros((2, 1, 3)), 30.0)
    assert compute_trajectories(given) is given
