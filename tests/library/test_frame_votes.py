"""Files of one skeleton vote on up axis and unit; what no reader takes is counted; empty folders make no library."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
from oracles.bodies import walking_body

from dousa import read_motion, write_motion
from dousa.app.cli.library import _check_before_making
from dousa.app.requests.library import LabelRules
from dousa.errors import OptionError
from dousa.formats.motion_files import Elected, FrameClaim, FrameVotes, ReadOptions
from dousa.library import Library
from dousa.motion import Trajectories, canonicalise, compute_trajectories

CLAIM = FrameClaim(("bvh", ("Hips",)), "y", "assumed", 0.01, "inferred", 160.0)


def _votes(*claims: FrameClaim) -> FrameVotes:
    votes = FrameVotes()
    for claim in claims:
        votes.count(claim)
    return votes


def test_those_that_know_decide() -> None:
    guess = replace(CLAIM, up="z", up_source="guessed")
    found = _votes(CLAIM, CLAIM, CLAIM, guess).elect(guess)
    assert (found.up, found.unit, [note.code for note in found.notes]) == ("y", None, ["units.voted_up"])
    assert not _votes(guess, replace(guess, up="y")).elect(guess).decides  # guesses have no vote
    assert _votes(CLAIM, replace(CLAIM, up="z"), guess).elect(guess).up is None  # nor have those that disagree
    other = replace(guess, skeleton=("bvh", ("Root",)))
    assert not _votes(CLAIM, CLAIM, other).elect(other).decides


def test_a_guess_that_is_right_is_confirmed() -> None:
    guess = replace(CLAIM, up_source="guessed")
    assert _votes(CLAIM, guess).elect(guess) == Elected("y")


def test_bodies_of_one_program_get_one_unit() -> None:
    first, second = (replace(CLAIM, unit_source="assumed", unit=1.55 / h, height=h) for h in (38.0, 45.0))
    votes = _votes(first, second)
    assert votes.elect(first).unit == pytest.approx(votes.elect(second).unit)
    assert votes.elect(first).unit == pytest.approx(1.55 / np.sqrt(38 * 45))
    giant = replace(first, height=4000.0)
    assert _votes(first, giant).elect(giant).unit is None  # another unit altogether


def test_joints_or_markers_are_one_question_for_all_files_of_the_same_names() -> None:
    joints, markers = replace(CLAIM, markers=False), replace(CLAIM, markers=True)
    assert _votes(joints, joints, joints, markers).elect(markers).markers is False
    assert _votes(markers, markers, markers, joints).elect(joints).markers is True
    assert not _votes(joints, joints, markers, markers).elect(markers).decides  # no clear majority
    assert not _votes(CLAIM, CLAIM, CLAIM, markers).elect(markers).decides  # where the names decide there is no vote
    odd = replace(CLAIM, is_person=False)
    assert _votes(CLAIM, CLAIM, CLAIM, odd).elect(odd).is_person
    assert not _votes(CLAIM, odd, odd).elect(odd).is_person


def _write_joints(path, wide: float, thigh: float = 1.0) -> None:
    """Twelve joints of a walk, without a pelvis; hips so many times as wide, thighs so many times as long."""
    body = canonicalise(walking_body(), any_skeleton=True).to_trajectories()
    names = [f"{side}_{joint}" for side in ("left", "right")
             for joint in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")]  # fmt: skip
    places = body.select(names).copy()
    hips = [names.index(f"{side}_hip") for side in ("left", "right")]
    middle = places[:, hips].mean(axis=1, keepdims=True)
    places[:, hips] = middle + wide * (places[:, hips] - middle)
    places[:, hips, 1] += thigh
    write_motion(Trajectories(tuple(names), places, 30.0), path)


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_folder_is_joints_or_markers_and_people_as_a_whole(tmp_path, jobs) -> None:
    """One of six files has hips as wide as trochanters, another none of a person's legs."""
    folder = tmp_path / "walks"
    folder.mkdir()
    for number in range(4):
        _write_joints(folder / f"a{number}.trc", 1.0 + 0.01 * number, 0.0)
    _write_joints(folder / "b.trc", 1.8, 0.0)
    _write_joints(folder / "c.trc", 1.0, 2.0)
    with Library.open(tmp_path / "moves.dousa", create=True) as library:
        report = library.add([folder], n_jobs=jobs)
        assert not report.skipped
        said = {path.rpartition("/")[2]: set() for path, _ in report.warnings}
        for path, note in report.warnings:
            said[path.rpartition("/")[2]].add(note.code)
        assert "canonical.voted_joints" in said["b.trc"] and "canonical.skin_markers" not in said["b.trc"]
        assert "canonical.voted_person" in said["c.trc"]
        assert not said.get("a1.trc", set()) & {"canonical.voted_joints", "canonical.skin_markers"}
        assert library.check().damage == ()
    alone = tmp_path / "alone.dousa"
    with Library.open(alone, create=True) as library:
        assert [one.path.rpartition("/")[2] for one in library.add([folder / "c.trc"]).skipped] == ["c.trc"]
    marked = canonicalise(read_motion(folder / "b.trc"))
    assert "canonical.skin_markers" in [note.code for note in marked.warnings]
    kept = canonicalise(read_motion(folder / "b.trc"), markers=False)
    assert "canonical.skin_markers" not in [note.code for note in kept.warnings]


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
