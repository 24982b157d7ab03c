"""A trained library learns what is added to it, at once and all or nothing; large ones from kept examples."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from dousa.errors import LibraryDamagedError
from dousa.library import Library
from dousa.library import add as add_module
from dousa.library.learning import insert as _insert
from dousa.library.learning import lesson
from dousa.library.search import renewal
from dousa.library.search.parts import read_part
from dousa.library.store.features import load_features
from dousa.retrieval.forest import trees
from library.database_server import run_sql, seal_again


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
    for trained, counts in ((False, (10, 5, False)), (True, (15, 0, True))):
        if trained:
            two_categories.train(n_trees=20)
        stats = two_categories.stats()
        assert (stats.n_trained, stats.n_learned, stats.forest_is_current) == counts


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


def tell_all(library):
    """What a library says of its clips, by their files."""
    clips = sorted(library.clips(), key=lambda clip: clip.path)
    queries = [(Path(clip.path).name, clip.predicted_category, library.search(clip.id, 100)) for clip in clips]
    return [
        (name, guess, found.verdict.to_json(), [(hit.path, hit.distance, hit.rank_distance) for hit in found.results])
        for name, guess, found in queries
    ]


@pytest.mark.parametrize(
    "how",
    [
        pytest.param("slow", marks=pytest.mark.slow),
        pytest.param("workers", marks=pytest.mark.slow),
        "stopped",
        "killed",
        pytest.param("in turns", marks=pytest.mark.slow),
        "backwards",
    ],
)
def test_the_same_clips_give_the_same_forest(two_categories, write_move, tmp_path, monkeypatch, how):
    """However fast they are read, in whatever order and portions, and where a program was stopped and run again."""
    for seed in range(5):
        for name in ("squat", "bow"):
            write_move(tmp_path / "new" / name / f"{name}{seed}.bvh", name, 200 + seed)
    monkeypatch.setitem(add_module._is_full.__kwdefaults__, "n_clips", 2)
    two_categories.close()
    files = sorted((tmp_path / "new").rglob("*.bvh"))
    rules = {"category_from": "name:([a-z]+)", "n_jobs": 1}

    def stop_once(done, total, path):
        if done == 4:
            raise KeyboardInterrupt

    seen = []
    for which in ("at once", how):
        with Library.open(shutil.copy(tmp_path / "two.dousa", tmp_path / f"{which}.dousa")) as library:
            portions = [[tmp_path / "new"]]
            if which == "slow":
                monkeypatch.setitem(add_module.Adding._read.__kwdefaults__, "at_most_s", 0.0)
            elif which == "workers":
                rules["n_jobs"] = 2
            elif which == "stopped":
                with pytest.raises(KeyboardInterrupt):
                    library.add(tmp_path / "new", **rules, progress=stop_once)
            elif which == "killed":
                with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
                    patch.setattr("dousa.retrieval.forest.growth.grow_forest", interrupt)
                    library.add(tmp_path / "new", **rules)
            elif which == "in turns":
                portions = [files[:3], files[3:4], files[4:]]
            elif which == "backwards":
                portions = [[path] for path in reversed(files)]
            reports = [library.add(some, **rules) for some in portions]
            assert sum(report.n_learned for report in reports) == library.stats().n_learned == 10
            seen.append(tell_all(library))
            assert library.check().is_sound
    assert seen[0] == seen[1]


@pytest.mark.parametrize("searched", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_a_library_whose_index_lies_in_a_file_learns_the_same(
    two_categories, nods, write_move, tmp_path, monkeypatch, searched
):
    """Also where clips were removed, relabelled and added since the file was made; only these are read again."""
    two_categories.close()
    seen, read = [], []
    for name in ("plain", "file"):
        with Library.open(shutil.copy(tmp_path / "two.dousa", tmp_path / f"{name}.dousa")) as library:
            if name == "file":
                monkeypatch.setattr(renewal, "FEWEST_CLIPS", 1)
                monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
                if searched:
                    library.search(1)
            library.remove(2)
            library.relabel(3, category="curtsey")
            library.relabel(4, category="bow")
            library.add(write_move(tmp_path / "more" / "a.bvh", "wave", 400), category_from="none")
            if name == "file" and searched:
                monkeypatch.setattr(renewal, "read_part", lambda *given: read.append(given) or read_part(*given))
            assert library.add(nods).n_learned == 5
            write_move(tmp_path / "late" / "bow" / "b.bvh", "bow", 401)
            assert library.add(tmp_path / "late").n_learned == 1
            seen.append((tell_all(library), forest_row(tmp_path / f"{name}.dousa")[2:]))
            assert library.check().is_sound
    assert seen[0] == seen[1]
    assert len(read) == (2 if searched else 0)


def test_clips_without_a_category_and_takes_teach_nothing(library, library_file, nods, write_move, tmp_path):
    before = forest_row(library_file)
    report = library.add(write_move(tmp_path / "a.bvh", "wave", 400), category_from="none")
    assert (report.n_learned, report.new_categories) == (0, ())
    assert library.add(nods, kind="take").n_learned == 0
    assert forest_row(library_file) == before
    assert library.clips(report.added)[0].predicted_category == "wave"


def interrupt(*args, **options):
    raise KeyboardInterrupt


def test_interrupted_while_it_writes_nothing_has_changed(library, library_file, nods, monkeypatch):
    before = answers(library_file), forest_row(library_file), library.stats()
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(_insert, "save_answers", interrupt)
        library.add(nods, n_jobs=1)
    assert (answers(library_file), forest_row(library_file), library.stats()) == before
    assert library.add(nods).n_learned == 5


@pytest.mark.parametrize("part", ["retrieval.forest.growth.grow_forest", "library.learning.lesson.update_rows"])
def test_interrupted_while_it_learns_the_clips_are_there(library, library_file, nods, monkeypatch, part):
    """They are found as the forest sees them as it is, and learned when anything is added again."""
    before = answers(library_file), forest_row(library_file)
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(f"dousa.{part}", interrupt)
        library.add(nods, n_jobs=1)
    assert forest_row(library_file) == before[1]
    assert answers(library_file)[:15] == before[0]
    assert len(library.search(1, 100).results) == 20
    assert library.check().is_sound
    report = library.add(nods)
    assert (report.n_learned, report.new_categories, len(report.unchanged)) == (5, ("squat_down",), 5)
    assert library.search(next(nods.rglob("*.bvh")), 1).verdict.guess == "squat_down"
    assert library.add(nods).n_learned == 0


def test_what_waits_may_be_renamed_and_removed(library, nods, monkeypatch):
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr("dousa.retrieval.forest.growth.grow_forest", interrupt)
        library.add(nods, n_jobs=1)
    first, second, *_ = library.clips(nods)
    library.remove(first.id)
    library.relabel(second.id, category=None)
    assert library.add(nods / "squat_down" / "n4.bvh").n_learned == 3
    assert library.add(nods / "squat_down" / "n4.bvh").n_learned == 0


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
    run_sql(library_file, f"UPDATE clip_leaves SET leaves = x'{'ffffff00' * 20}'")
    seal_again(library_file)
    with pytest.raises(LibraryDamagedError, match="dousa train"):
        library.add(nods)
    assert library.train(n_trees=5).n_clips == 20
    assert library.add(nods).n_learned == 0


def test_a_changed_file_teaches_again(library, write_move, tmp_path):
    path = write_move(tmp_path / "in" / "wave" / "x.bvh", "wave", 500)
    library.add(tmp_path / "in")
    write_move(path, "wave", 501)
    report = library.add(tmp_path / "in")
    assert (report.replaced, report.n_learned) == ((str(path),), 1)


@pytest.mark.parametrize("gone", [True, False])
def test_a_forest_whose_clips_are_all_gone_or_renamed_learns_too(two_categories, nods, gone):
    numbers = [clip.id for clip in two_categories.clips()]
    two_categories.remove(numbers) if gone else two_categories.relabel(numbers, category="other")
    assert two_categories.add(nods).new_categories == ("squat_down",)
    assert two_categories.search(next(nods.rglob("*.bvh")), 1).verdict.guess == "squat_down"


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


@pytest.mark.parametrize(
    "how",
    [
        pytest.param("in turns", marks=pytest.mark.slow),
        "backwards",
        "examples gone",
    ],
)
def test_the_same_clips_give_the_same_large_forest(large, files, tmp_path, how):
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
        with Library.open(path) as library:
            assert sum(library.add(some, **RULES).n_learned for some in portions) == 8
            seen.append((tell_all(library), read_examples(path)))
            assert library.check().is_sound
    assert seen[0] == seen[1]


@pytest.mark.slow
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
