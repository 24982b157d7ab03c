"""A library whose trees grew from samples learns from examples of its leaves: of the training nothing else is read."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from dousa.library import Library
from dousa.library.learning import lesson
from dousa.library.store import opening
from dousa.library.store.features import load_features
from dousa.retrieval.forest import trees
from library.database_server import run_sql
from library.learning.test_learning import tell_all

RULES = {"category_from": r"name:([a-z]+)", "n_jobs": 1}


@pytest.fixture
def large(moves, tmp_path, monkeypatch) -> Path:
    """A library of ten clips, of which each tree grew from half."""
    monkeypatch.setattr(trees, "MOST_GROWN", 5)
    with Library.open(tmp_path / "large.dousa", create=True) as library:
        library.add([moves / "wave", moves / "bow"], **RULES)
        library.train(n_trees=20)
    return tmp_path / "large.dousa"


@pytest.fixture
def files(write_move, tmp_path) -> list[Path]:
    """Clips of a new category, and of a known one."""
    for seed in range(4):
        for name in ("squat", "bow"):
            write_move(tmp_path / "new" / name / f"{name}{seed}.bvh", name, 200 + seed)
    return sorted((tmp_path / "new").rglob("*.bvh"))


def read_examples(path) -> list[tuple]:
    return run_sql(path, "SELECT revision, clips FROM leaf_examples")


def leaves_of(path, last: int) -> list[tuple]:
    return run_sql(path, f"SELECT clip_id, leaves FROM clip_leaves WHERE clip_id <= {last} ORDER BY clip_id")


def test_what_the_training_left_is_neither_read_nor_moved(large, files, monkeypatch):
    before, read = leaves_of(large, 10), []
    monkeypatch.setattr(lesson, "load_features", lambda c, kind, ids: read.extend(ids) or load_features(c, kind, ids))
    ((_, kept),) = read_examples(large)
    with Library.open(large) as library:
        assert library.add(files, **RULES).new_categories == ("squat",)
        assert {clip.predicted_category for clip in library.clips(category="squat")} == {"squat"}
        assert library.check().is_sound
    assert leaves_of(large, 10) == before
    assert {number for number in read if number <= 10} <= set(np.frombuffer(kept, "<i4").tolist())


@pytest.mark.parametrize("how", ["in turns", "backwards", "examples gone", "trained by an older dousa"])
def test_the_same_clips_give_the_same_forest(large, files, tmp_path, how):
    seen = []
    for which in ("at once", how):
        path = shutil.copy(large, tmp_path / f"{which}.dousa")
        portions = [files]
        if which == "in turns":
            portions = [files[:3], files[3:4], files[4:]]
        elif which == "backwards":
            portions = [[file] for file in reversed(files)]
        elif which == "examples gone":
            run_sql(path, "DELETE FROM leaf_examples")
        elif which == "trained by an older dousa":
            run_sql(path, "DROP TABLE leaf_examples")
            run_sql(path, "DROP INDEX ix_clips_size")
            run_sql(path, "DELETE FROM dousa_migrations WHERE number > 15")
        with Library.open(path) as library:
            assert sum(library.add(some, **RULES).n_learned for some in portions) == 8
            seen.append((tell_all(library), read_examples(path)))
            assert library.check().is_sound
    assert seen[0] == seen[1]


def test_a_training_chooses_them_anew_and_a_small_one_needs_none(large, files, monkeypatch):
    before = read_examples(large)
    with Library.open(large) as library:
        library.add(files, **RULES)
        library.train(n_trees=20)
        assert [row[0] for row in read_examples(large)] > [row[0] for row in before]
        monkeypatch.setattr(trees, "MOST_GROWN", 100)
        library.train(n_trees=20)
        assert read_examples(large) == []


def test_damaged_examples_are_told_and_chosen_again(large, files):
    ((_, kept),) = read_examples(large)
    run_sql(large, "UPDATE leaf_examples SET clips = ?", kept[:-1] + b"\x7f")
    with Library.open(large) as library:
        assert [one.what.code for one in library.check().damage] == ["library_damage.examples"]
        assert library.check(repair=True).damage[0].repaired
        assert library.check().is_sound
        library.add(files, **RULES)
    assert [row[1] for row in read_examples(large)] == [kept]


def test_examples_may_be_removed_and_renamed(large, files):
    with Library.open(large) as library:
        first, *others = library.clips(category="wave")
        library.remove(first.id)
        library.relabel([clip.id for clip in others[1:]], category=None)
        assert library.add(files, **RULES).n_learned == 8
        assert {clip.predicted_category for clip in library.clips(category="squat")} == {"squat"}
        library.remove([clip.id for clip in library.clips(category="wave")])
        library.add(files[0].rename(files[0].with_name("bow9.bvh")), **RULES)
        assert library.check().is_sound


def test_clips_without_a_category_stay_too_and_later_ones_go(large, files, write_move, tmp_path):
    with Library.open(large) as library:
        library.relabel(1, category=None)
        late = library.add(write_move(tmp_path / "late.bvh", "squat", 300), category_from="none").added
        before = leaves_of(large, 1)
        library.add(files, **RULES)
        assert leaves_of(large, 1) == before
        (clip,) = library.clips(late)
        stored = library.search(clip.id, 100)
        fresh = library.search(shutil.copy(clip.path, tmp_path / "copy.bvh"), 100)
        assert stored.results == fresh.results
        assert stored.histogram == fresh.histogram


def test_an_older_dousa_says_that_it_is_newer(large, monkeypatch):
    monkeypatch.setattr(opening, "MIGRATIONS", opening.MIGRATIONS[:15])
    with pytest.raises(opening.LibraryVersionError, match=f"tables {len(opening.MIGRATIONS) + 1}"):
        Library.open(large)
