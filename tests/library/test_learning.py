"""A trained library learns the clips that are added to it, at once and all or nothing."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from dousa.errors import LibraryDamagedError
from dousa.formats.motion_files import Skipped
from dousa.library import Library
from dousa.library import add as add_module
from dousa.library.growth import insert as _learning
from library.database_server import run_sql


@pytest.fixture
def nods(write_move, tmp_path) -> Path:
    """Five clips of a category that the library does not know: bows and waves at once are neither."""
    for seed in range(5):
        write_move(tmp_path / "new" / "squat_down" / f"n{seed}.bvh", "squat", 200 + seed)
    return tmp_path / "new"


@pytest.fixture
def two_categories(moves, tmp_path):
    """A library that knows how to wave and to bow."""
    with Library.open(tmp_path / "two.dousa", create=True) as library:
        library.add([moves / "wave", moves / "bow"], category_from=r"name:([a-z]+)_", performer_from=r"name:_(p\d)")
        library.train(n_trees=20)
        yield library


def answers(path: Path) -> list[tuple]:
    return run_sql(path, "SELECT * FROM clip_leaves ORDER BY clip_id")


def forest_row(path: Path) -> tuple:
    return run_sql(path, "SELECT revision, learned, n_learned, categories, data FROM forests")[0]


def test_a_new_category_is_known_at_once(two_categories, nods, write_move, tmp_path):
    query = write_move(tmp_path / "q.bvh", "squat", 300)
    assert "squat_down" not in two_categories.search(query).histogram
    report = two_categories.add(nods)
    assert (report.n_learned, report.new_categories) == (5, ("squat_down",))
    result = two_categories.search(query, 5)
    assert result.verdict.guess == "squat_down"
    assert {hit.category for hit in result.results} == {"squat_down"}
    assert {clip.predicted_category for clip in two_categories.clips(nods)} == {"squat_down"}
    for clip in two_categories.clips(category="wave"):  # what was known is not forgotten
        assert two_categories.search(clip.id, 1).verdict.guess == "wave"


def test_what_was_learned_is_told(two_categories, nods):
    two_categories.add(nods)
    stats = two_categories.stats()
    assert (stats.n_trained, stats.n_learned, stats.forest_is_current) == (10, 5, False)
    two_categories.train(n_trees=20)
    stats = two_categories.stats()
    assert (stats.n_trained, stats.n_learned, stats.forest_is_current) == (15, 0, True)


def test_stored_leaves_are_those_that_the_forest_gives(library, nods, write_move, tmp_path):
    """Also of clips that taught nothing, and of those whose category was changed."""
    library.add(write_move(tmp_path / "a.bvh", "wave", 400), category_from="none")
    library.relabel(library.clips(category="bow")[0].id, category="curtsey")
    library.add(nods)
    copies = tmp_path / "copies"
    copies.mkdir()
    for clip in library.clips():
        stored = library.search(clip.id, 100)
        fresh = library.search(shutil.copy(clip.path, copies / f"{clip.id}.bvh"), 100)
        assert fresh.results == stored.results
        assert fresh.histogram == stored.histogram
        assert clip.predicted_category == stored.verdict.guess


def test_it_does_not_matter_whether_clips_come_alone_or_together(two_categories, nods):
    for path in sorted(nods.rglob("*.bvh")):
        assert two_categories.add(path, category_from="path:(.)").n_learned == 1
    assert two_categories.stats().n_learned == 5


def test_the_forest_depends_on_the_files_and_not_on_the_clock(two_categories, nods, tmp_path, monkeypatch):
    """However fast the files are read, by however many workers, and where the program was stopped and run again."""
    monkeypatch.setattr(add_module, "_PORTION_CLIPS", 2)
    stored = list[int]()
    store = add_module.Adding._store_portion

    def count(self, portion):
        stored.append(sum(not isinstance(answer, Skipped) for answer in portion))
        return store(self, portion)

    monkeypatch.setattr(add_module.Adding, "_store_portion", count)

    def stop_once(done, total, path):
        if done == 4:
            raise KeyboardInterrupt

    seen = []
    two_categories.close()
    for name, n_jobs, seconds in (("fast", 1, 60.0), ("slow", 1, 0.0), ("workers", 2, 60.0), ("stopped", 1, 60.0)):
        path = Path(shutil.copy(tmp_path / "two.dousa", tmp_path / f"{name}.dousa"))
        monkeypatch.setattr(add_module, "_PORTION_SECONDS", seconds)
        with Library.open(path) as library:
            if name == "stopped":
                with pytest.raises(KeyboardInterrupt):
                    library.add(nods, n_jobs=n_jobs, progress=stop_once)
            library.add(nods, n_jobs=n_jobs)
        leaves = [(row[0], bytes(row[2])) for row in answers(path)]
        seen.append((*forest_row(path)[2:], leaves))
    assert len(stored) > 8 and max(stored) < 5  # in several portions
    assert seen[1:] == seen[:1] * 3


def test_clips_without_a_category_teach_nothing(library, library_file, write_move, tmp_path):
    before = forest_row(library_file)
    report = library.add(write_move(tmp_path / "a.bvh", "wave", 400), category_from="none")
    assert (report.n_learned, report.new_categories) == (0, ())
    assert forest_row(library_file) == before
    assert library.clips(report.added)[0].predicted_category == "wave"


def test_takes_teach_nothing(library, library_file, nods):
    before = forest_row(library_file)
    assert library.add(nods, kind="take").n_learned == 0
    assert forest_row(library_file) == before


@pytest.mark.parametrize("moment", ["grow", "after"])
def test_interrupted_while_it_learns_nothing_has_changed(library, library_file, nods, monkeypatch, moment):
    before = answers(library_file), forest_row(library_file), library.stats()

    def stop(*args, **options):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        if moment == "grow":
            patch.setattr("dousa.retrieval.forest.growth.grow_forest", stop)
        else:
            patch.setattr(_learning, "save_answers", stop)
        with pytest.raises(KeyboardInterrupt):
            library.add(nods, n_jobs=1)
    assert (answers(library_file), forest_row(library_file), library.stats()) == before
    assert library.add(nods).n_learned == 5
    assert library.search(1, 100).results


def test_another_program_sees_what_was_learned(library, library_file, nods):
    query = next(nods.rglob("*.bvh"))
    assert "squat_down" not in library.search(query).histogram
    with Library.open(library_file) as other:
        other.add(nods)
    assert library.search(query).verdict.guess == "squat_down"


def test_another_program_trains_while_files_are_read(library, library_file, nods):
    def meddle(done: int, total: int, path: str) -> None:
        if done == 1:
            with Library.open(library_file) as other:
                other.train(n_trees=7, feature_set="paper")

    report = library.add(nods, n_jobs=1, progress=meddle)
    assert report.n_learned == 5
    assert library.stats().parameters["feature_set"] == "paper"
    assert library.search(report.added[0], 1).verdict.guess == "squat_down"


def test_leaves_that_are_not_there_are_told(library, library_file, nods):
    run_sql(library_file, f"UPDATE clip_leaves SET checksum = NULL, leaves = x'{'ffffff00' * 20}'")
    with pytest.raises(LibraryDamagedError, match="dousa train"):
        library.add(nods)
    library.train(n_trees=5)
    assert library.add(nods).n_learned == 5


def test_a_changed_file_teaches_again(library, write_move, tmp_path):
    path = write_move(tmp_path / "in" / "wave" / "x.bvh", "wave", 500)
    library.add(tmp_path / "in")
    write_move(path, "wave", 501)
    report = library.add(tmp_path / "in")
    assert (report.replaced, report.n_learned) == ((str(path),), 1)


def test_growing_does_not_depend_on_workers(moves, nods, tmp_path):
    found = []
    for jobs in (1, 2):
        with Library.open(tmp_path / f"{jobs}.dousa", create=True) as library:
            library.add(moves, n_jobs=1)
            library.train(n_trees=10, n_jobs=jobs)
            library.add(nods, n_jobs=jobs)
            found.append([hit.to_json() for hit in library.search(1, 100).results])
    assert found[0] == found[1]
    assert np.isfinite([hit["rank_distance"] for hit in found[0]]).all()


def test_a_forest_whose_clips_are_all_gone_learns_too(two_categories, nods):
    two_categories.remove([clip.id for clip in two_categories.clips()])
    assert two_categories.add(nods).n_learned == 5
    assert two_categories.search(next(nods.rglob("*.bvh")), 1).verdict.guess == "squat_down"


def test_a_forest_whose_clips_have_all_been_renamed_learns_too(two_categories, nods):
    two_categories.relabel([clip.id for clip in two_categories.clips()], category="other")
    assert two_categories.add(nods).new_categories == ("squat_down",)
    assert two_categories.search(next(nods.rglob("*.bvh")), 1).verdict.guess == "squat_down"
