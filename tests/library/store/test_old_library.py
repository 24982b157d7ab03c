"""A library that dousa made before there were takes, sets of features and leaves that learn.

``library_of_tables_1.dousa.gz`` was made by that dousa: two performers who walk, squat and bow, 15 frames each, and a
forest of 10 trees. The answers it gave then stand below.
"""

import gzip
import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from dousa.errors import LibraryError, LibraryVersionError
from dousa.library import Library
from dousa.library.store import opening
from dousa.retrieval import FEATURE_SETS

pytestmark = pytest.mark.sqlite  # these are files

MADE = Path(__file__).with_name("library_of_tables_1.dousa.gz")

# Of clip 1 ... 6: the category and the order of all clips, by eq. 8, common leaves and pose features.
THEN = {
    1: ("bow", [1, 2, 5, 6, 3, 4]), 2: ("bow", [2, 1, 3, 4, 6, 5]), 3: ("squat", [3, 4, 6, 5, 1, 2]),
    4: ("squat", [4, 3, 2, 6, 1, 5]), 5: ("walk", [5, 6, 1, 3, 2, 4]), 6: ("walk", [6, 5, 1, 3, 2, 4]),
}  # fmt: skip


@pytest.fixture
def old_file(tmp_path) -> Path:
    path = tmp_path / "old.dousa"
    path.write_bytes(gzip.decompress(MADE.read_bytes()))
    return path


def tables(path: Path) -> set[str]:
    with closing(sqlite3.connect(path)) as connection:
        return {row[0] for row in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}


def test_it_opens_and_answers_as_it_did(old_file):
    with Library.open(old_file) as library:
        stats = library.stats()
        assert (stats.n_clips, stats.n_takes, stats.n_learned, stats.forest_is_current) == (6, 0, 0, True)
        assert stats.parameters["feature_set"] == "paper"
        assert {clip.kind for clip in library.clips()} == {"clip"}
        for clip_id, (category, order) in THEN.items():
            result = library.search(clip_id, 6, ranking="histogram")
            assert (result.category, result.verdict.known) == (category, None)
            assert [hit.distance for hit in result.results] == pytest.approx([0, 0, *[2**0.5] * 4])
            # Beyond the first two nothing but poses decided, and these were another measure then.
            assert {hit.clip_id for hit in result.results[:2]} == set(order[:2])
            assert [hit.clip_id for hit in library.search(clip_id, 2).results] == order[:2]
    assert "clip_histograms" not in tables(old_file)


def test_it_cannot_be_brought_up_to_date_where_nothing_may_change(old_file):
    before = old_file.read_bytes()
    with pytest.raises(LibraryVersionError, match=r"older dousa.*open it once for writing"):
        Library.open(old_file, read_only=True)
    assert old_file.read_bytes() == before


def test_a_step_that_is_interrupted_leaves_the_old_library(old_file, monkeypatch):
    steps = opening.MIGRATIONS

    def stop(connection):
        steps[1].apply(connection)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        broken = (steps[0], opening.Migration(2, steps[1].name, stop))
        patch.setattr(opening, "MIGRATIONS", broken)
        with pytest.raises(KeyboardInterrupt):
            Library.open(old_file)
    assert {"clip_histograms"} == tables(old_file) & {"clip_histograms", "clip_leaves", "take_windows"}
    with Library.open(old_file) as library:
        assert library.search(1, 1).category == "bow"


def test_training_describes_its_clips_anew(old_file):
    with Library.open(old_file) as library:
        calls = []
        report = library.train(n_trees=20, progress=lambda *call: calls.append(str(call[2])))
        assert (report.feature_set, report.n_clips) == ("extended", 6)
        assert "describing clips (6 of 6)" in calls
        assert {library.search(number, 1).verdict.guess for number in (1, 2)} == {"bow"}
        assert library.stats().parameters["feature_set"] == "extended"
        calls.clear()
        library.train(n_trees=5, progress=lambda *call: calls.append(str(call[2])))
        assert not any(call.startswith("describing clips (") for call in calls)  # they are kept


def test_its_forest_learns_new_clips(old_file, write_move, tmp_path):
    with Library.open(old_file) as library:
        assert library.add(write_move(tmp_path / "a.bvh", seed=3)).n_learned == 0  # nobody says what it is
        report = library.add(write_move(tmp_path / "in" / "wave" / "b.bvh").parent.parent)
        assert (report.n_learned, report.new_categories) == (1, ("wave",))
        assert library.search(report.added[0], 1).verdict.guess == "wave"
        assert library.stats().parameters["feature_set"] == "paper"


def test_takes_can_be_added_to_it(old_file, write_move, tmp_path):
    take = write_move(tmp_path / "take.bvh", "squat", n_frames=400)
    with Library.open(old_file) as library:
        library.add(take, kind="take")
        places = library.find(3, k=2).results
        assert {place.take for place in places} == {str(take)}


def test_damage_is_told_while_it_is_brought_up_to_date(old_file):
    with closing(sqlite3.connect(old_file)) as connection, connection:
        connection.execute("UPDATE forests SET parameters = '{'")
    with pytest.raises(LibraryError, match="damaged"):
        Library.open(old_file)


def test_the_features_of_the_paper_can_be_asked_for_again(old_file):
    with Library.open(old_file) as library:
        library.train(n_trees=5)
        assert library.train(n_trees=5, feature_set="paper").feature_set == "paper"
        with library.database.engine.connect() as connection:
            sizes = connection.exec_driver_sql("SELECT DISTINCT length(pose_features) FROM clip_features").all()
        assert sizes == [(np.prod((10, FEATURE_SETS["paper"].n_columns)) * 4,)]
