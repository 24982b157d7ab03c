"""Training, searching and classifying."""

import json
import os
import shutil
import subprocess
import sys

import numpy as np
import pytest

from dousa import kernels
from dousa.errors import JointMappingError, LibraryError, MotionFileError, NotTrainedError, OptionError, TrainingError
from dousa.formats.registry import read_motion
from dousa.library import Library
from dousa.motion import Trajectories, canonicalise, compute_trajectories
from dousa.retrieval.ranking.ranking import RANKINGS


def test_training_reports_and_gives_histograms(empty_library, moves, write_move, tmp_path):
    empty_library.add(moves)
    empty_library.add([write_move(tmp_path / "x" / "a.bvh", "bow", 50)], category_from="none")
    empty_library.add([write_move(tmp_path / "jump" / "b.bvh", "squat", 60)], category_from="none")
    empty_library.relabel(tmp_path / "jump", category="jump")
    calls = []
    report = empty_library.train(n_trees=30, progress=lambda *call: calls.append(call))
    assert len(repr(report)) < 1000, "a person sees it at the prompt"
    assert (report.n_trees, report.n_clips, report.n_unlabelled) == (30, 16, 1)
    assert report.categories == {"bow": 5, "jump": 1, "squat": 5, "wave": 5}
    assert report.single == ("jump",)
    assert calls[-1][:2] == (6, 6)
    (unlabelled,) = empty_library.clips(tmp_path / "x")
    assert (unlabelled.category, unlabelled.predicted_category) == (None, "bow")
    stats = empty_library.stats()
    assert (stats.forest_is_current, stats.n_trained, stats.n_clips) == (True, 16, 17)
    assert stats.parameters["n_trees"] == 30
    json.dumps([stats.to_json(), report.to_json()])


def test_training_needs_two_categories(empty_library, moves):
    with pytest.raises(TrainingError, match="found 0 clips of no category"):
        empty_library.train()
    empty_library.add(moves / "wave")
    with pytest.raises(TrainingError, match="no category"):
        empty_library.train()
    empty_library.relabel(moves, category="wave")
    with pytest.raises(TrainingError, match=r"5 clips of one category \('wave'\)"):
        empty_library.train()


def test_training_does_not_depend_on_workers(library, moves):
    query = library.clips()[0].path
    results = []
    for jobs in (1, 2, None):
        library.train(n_trees=15, random_state=3, n_jobs=jobs)
        results.append(library.search(query, 15))
    assert results[0] == results[1] == results[2]


@pytest.mark.sqlite
def test_search_in_a_small_library_loads_no_compiler(library_file, moves):
    heavy = "numba scipy sklearn joblib dousa.library.learning dousa.motion.synthetic".split()
    code = f"import sys; from dousa.app.cli.main import main; main(); print([m for m in {heavy} if m in sys.modules])"
    words = ["search", str(library_file), str(moves / "squat" / "squat_p2.bvh")]
    out = subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True, check=True)
    assert out.stdout.splitlines()[-1] == "[]"


def test_search_answers_the_same_interpreted(library, moves, monkeypatch):
    query = moves / "squat" / "squat_p2.bvh"
    compiled = [library.search(query, 15, ranking=by) for by in RANKINGS]
    monkeypatch.setattr(kernels._depth, "interpreting", True)
    with Library.open(library.name, read_only=True) as again, np.errstate(all="ignore"):
        assert [again.search(query, 15, ranking=by) for by in RANKINGS] == compiled


def test_search_finds_the_category_and_the_query_itself(library, moves):
    path = moves / "squat" / "squat_p2.bvh"
    result = library.search(path, k=5)
    assert result.category == "squat"
    assert [hit.category for hit in result.results] == ["squat"] * 5
    distances = [hit.rank_distance for hit in result.results]
    assert distances == sorted(distances)
    assert any(hit.path == str(path) and hit.distance == 0 for hit in result.results)
    assert sum(result.histogram.values()) == pytest.approx(1)
    assert next(iter(result.histogram)) == "squat"


def test_the_json_of_a_search_is_the_promised_one(library, moves):
    answer = json.loads(json.dumps(library.search(moves / "bow" / "bow_p0.bvh", k=2).to_json()))
    keys = "query category histogram guess known confidence perhaps ranking alike_count results".split()
    assert list(answer) == keys
    keys = ["path", "category", "distance", "rank"]
    keys += ["clip_id", "leaf_share", "pose_distance", "rank_distance", "mirrored", "alike", "probability"]
    assert [list(hit) for hit in answer["results"]] == [keys] * 2
    assert answer["query"] == str(moves / "bow" / "bow_p0.bvh")
    assert (answer["category"], answer["guess"], answer["ranking"]) == ("bow", "bow", "fused")
    assert 0.5 < answer["known"] <= 1 and 0 < answer["confidence"] <= answer["known"]


def test_a_file_a_clip_and_a_motion_find_the_same(library, moves, tmp_path):
    path = moves / "wave" / "wave_p1.bvh"
    copy = shutil.copy(path, tmp_path / "copy.bvh")  # not in the library: read and run down the trees
    (clip,) = library.clips(path)
    motion = read_motion(path)
    trajectories = compute_trajectories(motion)
    queries = [path, copy, clip.id, motion, trajectories, canonicalise(trajectories)]
    answers = [library.search(query, 15) for query in queries]
    for answer in answers[1:]:
        assert answer.results == answers[0].results
        assert answer.histogram == answers[0].histogram
    assert [answer.query for answer in answers[:3]] == [str(path), str(copy), str(path)]


def test_a_name_that_is_no_unicode_is_searched_for(library, write_move, tmp_path):
    path = os.fsdecode(os.fsencode(tmp_path) + b"/\xff.bvh")
    write_move(tmp_path / "plain.bvh", "bow", 8).rename(path)
    assert library.search(path, 1).category == "bow"


def test_no_common_leaf_is_a_share_of_nothing(library):
    shares = [hit.leaf_share for hit in library.search(1, 100).results]
    assert min(shares) == 0.0
    assert not np.signbit(shares).any()


def test_bad_queries(library, tmp_path, moves):
    query = moves / "bow" / "bow_p0.bvh"
    with pytest.raises(OptionError, match="got 0"):
        library.search(query, 0)
    with pytest.raises(LibraryError, match="no clip or take 999"):
        library.search(999)
    with pytest.raises(MotionFileError, match="no such file"):
        library.search(tmp_path / "none.bvh")
    with pytest.raises(JointMappingError):
        library.search(Trajectories(("a", "b"), np.zeros((3, 2, 3)), 30.0))


def test_a_library_without_a_forest_says_how_to_train(empty_library, moves):
    empty_library.add(moves)
    for ask in (empty_library.search, empty_library.classify):
        with pytest.raises(NotTrainedError, match="dousa train"):
            ask(moves / "bow" / "bow_p0.bvh")


def test_a_trained_library_without_clips_finds_nothing(library, moves):
    library.remove([clip.id for clip in library.clips()])
    result = library.search(moves / "bow" / "bow_p0.bvh")
    assert (result.category, result.results) == ("bow", ())


def test_classify_answers_for_every_file(library, write_move, tmp_path):
    good = write_move(tmp_path / "in" / "b.bvh", "wave", 123)
    bad = tmp_path / "in" / "a.bvh"
    bad.write_text("nothing")
    first, second, third = library.classify([tmp_path / "none.bvh", tmp_path / "in"])
    assert (first.category, second.category, third.category) == (None, None, "wave")
    assert "no such file" in str(first.problem)
    assert (second.path, third.path) == (str(bad), str(good))
    assert third.histogram["wave"] > 0.5
    assert "problem" not in third.to_json() and "problem" in first.to_json()
    assert len(library.clips()) == 15


def test_another_program_is_seen(library, library_file, moves, write_move, tmp_path):
    query = moves / "bow" / "bow_p0.bvh"
    before = library.search(query, 100)
    with Library.open(library_file) as other:
        other.remove(category="wave")
        new = write_move(tmp_path / "bow" / "new.bvh", "bow", 77)
        other.add(tmp_path / "bow" / "new.bvh")
    after = library.search(query, 100)
    assert len(before.results) == 15
    assert {hit.path for hit in after.results} == {
        *(hit.path for hit in before.results if hit.category != "wave"),
        str(new),
    }
    with Library.open(library_file) as other:
        other.train(n_trees=10)
    assert set(library.search(query).histogram) == {"bow", "squat"}


def test_clips_that_change_while_the_trees_grow(library, library_file, write_move, tmp_path):
    new = write_move(tmp_path / "new.bvh", "bow", 78)

    def meddle(done: int, total: int, what: str) -> None:
        if done == 1:
            with Library.open(library_file) as other:
                other.add(new)
                other.remove(category="wave")

    library.train(n_trees=10, progress=meddle)
    assert not library.stats().forest_is_current
    assert len(library.search(new, 100).results) == 11
    assert all(clip.predicted_category for clip in library.clips())


def test_real_gestures_find_their_kind(empty_library, shared_data):
    root = shared_data("hdm05")
    kinds = sorted(folder for folder in root.iterdir() if folder.is_dir())[:3]
    files = [file for kind in kinds for actor in ("bd", "bk") for file in sorted(kind.glob(f"*_{actor}_*"))[:3]]
    empty_library.add(files, category_from="none")
    for kind in kinds:
        empty_library.relabel(kind, category=kind.name)
    empty_library.train(n_trees=50)
    right = [
        empty_library.search(query).verdict.guess == kind.name
        for kind in kinds
        for query in sorted(kind.glob("*_dg_*"))[:3]
    ]
    assert sum(right) >= len(right) - 1


def test_the_order_inside_a_category_is_a_ranking(empty_library, shared_data):
    root = shared_data("hdm05")
    kinds = sorted(folder for folder in root.iterdir() if folder.is_dir())[:3]
    for kind in kinds:
        empty_library.add(sorted(kind.glob("*.amc"))[::2], category_from="none")
        empty_library.relabel(kind, category=kind.name)
    empty_library.train(n_trees=60)
    clips = empty_library.clips(category=kinds[0].name)
    orders = []
    for clip in clips:
        results = empty_library.search(clip.id, len(clips), same_category=True).results
        assert (results[0].path, results[0].rank_distance, results[0].leaf_share) == (clip.path, 0.0, 1.0)
        keys = [hit.rank_distance for hit in results]
        assert keys == sorted(keys)
        # All at nearly one distance, as each tree learned from them or from their copies, and yet in an order.
        assert max(hit.distance for hit in results) < 0.25
        orders.append(tuple(hit.path for hit in results))
    assert len(set(orders)) == len(clips)
    assert all(list(order) != sorted(order) for order in orders)
