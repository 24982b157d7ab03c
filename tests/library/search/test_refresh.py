"""After a change only clips that changed are read, and what an index says is what one says that is read anew."""

import os
from pathlib import Path

import numpy as np
import pytest

from dousa.library import Library
from dousa.library.search import leaf_index as refresh
from dousa.library.search import renewal, side_file
from dousa.library.search.leaf_index import LeafIndex
from dousa.library.store.engine import read_revision
from dousa.library.store.forests import load_forest
from dousa.retrieval.forest.growth import find_changed
from library.search.test_leaf_index import check_searches


@pytest.fixture
def read(monkeypatch):
    """Numbers of the clips that are read, a list for each time."""
    numbers = []
    plain = refresh.read_part

    def read_part(connection, stored, portions):
        part = plain(connection, stored, portions)
        numbers.append(part.ids.tolist())
        return part

    monkeypatch.setattr(refresh, "read_part", read_part)
    return numbers


@pytest.fixture
def blocks_of_four(monkeypatch):
    monkeypatch.setattr(refresh, "BLOCK", 4)


def load(library: Library, known: LeafIndex | None = None) -> LeafIndex:
    with library.database.reading() as connection:
        stored = load_forest(connection, library.name)
        revision = read_revision(connection)
        if known is None:
            return refresh.read_index(connection, revision, stored)
        return refresh.refresh_index(connection, revision, stored, known)


def check_same(one: LeafIndex, other: LeafIndex) -> None:
    """Both say the same of the same clips."""
    numbers = [{i.clip_id(row) for row in np.flatnonzero(i.living).tolist()} for i in (one, other)]
    assert numbers[0] == numbers[1]
    assert (one.revision, one.learned, one.partial) == (other.revision, other.learned, other.partial)
    for number in numbers[0]:
        told = [index.answers_of(number) for index in (one, other)]
        assert np.array_equal(told[0].votes, told[1].votes) and np.array_equal(told[0].leaves, told[1].leaves)
        rows = one.find(number), other.find(number)
        assert one.path(rows[0]) == other.path(rows[1]) and one.label(rows[0]) == other.label(rows[1])


def test_only_what_changed_is_read(library, read, blocks_of_four):
    index = load(library)
    assert read == [list(range(1, 16))]
    library.relabel([3, 9], category="nod")
    later = load(library, index)
    assert read[1:] == [[3, 9]]
    check_same(later, load(library))
    del read[:]
    library.remove([1, 2, 14])
    after = load(library, later)
    assert read == []
    check_same(after, load(library))


def test_any_changes_one_after_the_other(library, read, blocks_of_four, write_move, tmp_path):
    index = load(library)
    for turn in range(10):
        if turn % 3 == 0:
            write_move(tmp_path / "more" / "squat" / f"{turn}.bvh", "squat", 70 + turn)
            library.add(tmp_path / "more", n_jobs=1)
        elif turn % 3 == 1:
            library.relabel([4, 5 + turn], category=None if turn == 4 else f"new {turn}")
        else:
            library.remove([1 + turn])
        index = load(library, index)
        check_same(index, load(library))
    assert len(index.parts) <= 8
    library.undo()
    check_same(load(library, index), load(library))


def test_other_trees_are_read_anew(library):
    index = load(library)
    library.train(n_trees=5)
    assert load(library, index) is None


@pytest.mark.sqlite
def test_a_library_that_was_put_back_from_a_copy(library, library_file, tmp_path):
    """The numbers of its writes are the same, the clips are not."""
    check_searches(library, (1,))
    library.close()
    kept = library_file.read_bytes()
    library.relabel([1], category="nod")
    index = load(library)
    library.close()
    for log in tmp_path.glob("moves.dousa-*"):
        log.unlink()
    library_file.write_bytes(kept)
    library.relabel([2], category="nod")
    again = load(library, index)
    assert again.revision == index.revision
    check_same(again, load(library))


@pytest.fixture
def large(monkeypatch, tmp_path):
    """Every library is large enough for a file of its own, that of a server beside no other."""
    monkeypatch.setattr(renewal, "FEWEST_CLIPS", 1)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))


def find_side_files(folder):
    return [*folder.rglob("*-search")]


def test_another_program_reads_the_file(library, library_file, tmp_path, read, large, monkeypatch):
    monkeypatch.setattr(refresh, "BLOCK", 4)
    check_searches(library)
    assert len(find_side_files(tmp_path)) == 1 and len(read) == 1
    with Library.open(library_file) as other:
        check_searches(other)
        assert len(read) == 1
        other.relabel([3], category="nod")
        other.remove([4])
    for _ in range(2):  # too little for another file
        with Library.open(library_file) as third:
            check_searches(third, (1, 3))
    assert read[1:] == [[3], [3]]
    library.relabel([2, 6, 10, 15], category="nod")
    for _ in range(2):
        with Library.open(library_file) as fourth:
            check_searches(fourth, (1, 3, 6, 15))
    assert read[3:] == [[2, 3, 6, 10, 15]]  # who read much wrote it


def read_kept(library: Library, folder) -> tuple[LeafIndex, bool]:
    """What is in the file of a library, brought up to date, and whether its votes were there."""
    with library.database.reading() as connection:
        stored = load_forest(connection, library.name)
        index, has_votes = side_file.read_side_file(find_side_files(folder)[0], stored)
        return refresh.refresh_index(connection, read_revision(connection), stored, index), has_votes


def change_and_teach(library, library_file, folder, write_move, turn, category):
    """Two clips are changed here, and another program adds two."""
    library.relabel([2 + turn], category="bow" if turn % 2 else None)
    library.remove([9 + turn])
    for number in range(2):
        write_move(folder / category / f"{turn}{number}.bvh", "bow", 70 + 2 * turn + number)
    with Library.open(library_file) as other:
        assert other.add(folder, n_jobs=1).n_learned == 2


@pytest.mark.parametrize(("block", "is_later"), [(refresh.BLOCK, False), (4, True)])
def test_what_a_forest_has_learned_is_in_a_file(
    library, library_file, tmp_path, read, large, request, monkeypatch, write_move, block, is_later
):
    """Whoever adds clips writes it, also where others were changed since; the next program reads no rows.

    Of the first file nothing is written again where there is a later one; categories that are new have numbers between
    the others.
    """
    if is_later:
        request.getfixturevalue("later")
    monkeypatch.setattr(refresh, "BLOCK", block)
    library.train(n_trees=8)
    (place,) = find_side_files(tmp_path)
    whole = place.read_bytes()
    for turn, category in enumerate(("nod", "a nod" if is_later else "wave", "nod", "bow")):
        change_and_teach(library, library_file, tmp_path / "more", write_move, turn, category)
        assert not is_later or (place.read_bytes() == whole and find_later(tmp_path).exists())
        del read[:]
        kept, has_votes = read_kept(library, tmp_path)
        assert read == [] and has_votes
        assert len(kept.parts) == 2 if is_later else kept.alive == (None,)
        check_same(kept, load(library))
        del read[:]
        with Library.open(library_file) as third:
            check_searches(third, (1, 16 + 2 * turn))
        assert read == []
    assert library.check().is_sound
    library.train(n_trees=8)
    assert not [*tmp_path.rglob("*-search-later")]


@pytest.fixture
def later(monkeypatch, large):
    """What a forest learns goes into a later file, however much it is."""
    monkeypatch.setattr(renewal, "_MOST_AGAIN", 1e9)
    monkeypatch.setitem(refresh.refresh_index.__kwdefaults__, "most_changed", 1e9)


def find_later(folder):
    (file,) = folder.rglob("*-search-later")
    return file


def test_of_what_stays_no_votes_are_counted_again(library, library_file, tmp_path, later, monkeypatch, write_move):
    library.train(n_trees=2)
    counted = []
    count = renewal.count_part
    monkeypatch.setattr(
        renewal, "count_part", lambda s, part, m: counted.extend(part.ids.tolist()) or count(s, part, m)
    )
    write_move(tmp_path / "more" / "nod" / "a.bvh", "bow", 70)
    with library.database.reading() as connection:
        before = load_forest(connection, library.name)
    leaves = {number: load(library).answers_of(number) for number in range(1, 16)}
    library.add(tmp_path / "more", n_jobs=1)
    with library.database.reading() as connection:
        changed = find_changed(before.forest, load_forest(connection, library.name).forest)
    assert set(counted) == {16, *(number for number, told in leaves.items() if changed[told.leaves].any())}
    assert 0 < len(set(counted)) < 16


@pytest.mark.parametrize("how", ["damaged", "cut", "gone", "of another file", "of an older state"])
def test_a_later_file_that_is_not_right_is_not_believed(library, library_file, tmp_path, read, later, write_move, how):
    library.train(n_trees=8)
    write_move(tmp_path / "more" / "nod" / "a.bvh", "bow", 70)
    library.add(tmp_path / "more", n_jobs=1)
    place = find_later(tmp_path)
    whole = place.read_bytes()
    if how == "of an older state":
        write_move(tmp_path / "more" / "nod" / "b.bvh", "bow", 71)
        library.add(tmp_path / "more", n_jobs=1)
        place.write_bytes(whole)
    elif how == "of another file":
        library.train(n_trees=8)
        place.write_bytes(whole)
    elif how == "gone":
        place.unlink()
    expected = load(library)
    texts = [whole]
    if how == "damaged":
        texts = [whole[:at] + bytes([whole[at] ^ 4]) + whole[at + 1 :] for at in range(0, len(whole), 397)]
    elif how == "cut":
        texts = [whole[:size] for size in (0, 30, len(whole) // 2, len(whole) - 1)]
    for text in texts:
        if how in ("damaged", "cut"):
            place.write_bytes(text)
        kept, _ = read_kept(library, tmp_path)
        check_same(kept, expected)
        with Library.open(library_file) as other:
            check_searches(other, (1, 16))


def test_clips_that_are_not_learned_are_read_from_their_rows(
    library, library_file, tmp_path, read, large, blocks_of_four, write_move
):
    library.search(1)
    library.add(write_move(tmp_path / "more" / "a.bvh", "bow", 70), category_from="none", n_jobs=1)
    kept, _ = read_kept(library, tmp_path)
    assert read[1:] == [[16]]
    check_same(kept, load(library))


def test_one_program_writes_the_file_at_a_time(library, tmp_path, large):
    library.search(1)
    (place,) = find_side_files(tmp_path)
    whole = place.read_bytes()
    with side_file.create_alone(place) as file:
        assert file is not None
        part = Path(file.name)
        with side_file.create_alone(place) as other:
            assert other is None
        library.train(n_trees=5)
        assert place.read_bytes() == whole and part.exists()
        file.write(b"nothing of it")
    assert place.read_bytes() == b"nothing of it" and not part.exists()
    part.write_bytes(b"what a killed program left, and it was longer than what comes now" * 1000)
    library.train(n_trees=6)
    assert not part.exists()
    assert read_kept(library, tmp_path)[1]


def test_where_writing_fails_the_file_stays(library, tmp_path, large, monkeypatch):
    library.search(1)
    (place,) = find_side_files(tmp_path)
    whole = place.read_bytes()

    def fail(*given):
        raise OSError("no space is left")

    monkeypatch.setattr(os, "replace", fail)
    library.train(n_trees=5)
    assert place.read_bytes() == whole and not list(tmp_path.rglob(".*.part"))
    check_searches(library, (1,))


def test_a_damaged_file_is_not_believed(library, library_file, tmp_path, read, large):
    library.search(1)
    (place,) = find_side_files(tmp_path)
    whole = place.read_bytes()
    for at in [*range(0, 40, 6), *np.linspace(40, len(whole) - 1, 12).astype(int).tolist()]:
        del read[:]
        place.write_bytes(whole[:at] + bytes([whole[at] ^ 4]) + whole[at + 1 :])
        with Library.open(library_file) as other:
            answer = other.search(1, 5)
        assert [hit.clip_id for hit in answer.results] == [hit.clip_id for hit in library.search(1, 5).results]
        assert len(read) in (0, 1)  # a flipped bit may lie where nothing is
    for size in (0, 5, 40, len(whole) // 2, len(whole) - 1):
        place.write_bytes(whole[:size])
        with Library.open(library_file) as other:
            assert other.search(1, 5).results == library.search(1, 5).results


def test_who_may_only_read_makes_no_file(library_file, tmp_path, large):
    with Library.open(library_file, read_only=True) as library:
        library.search(1)
    assert find_side_files(tmp_path) == []


def test_a_small_library_has_none(library, tmp_path):
    library.search(1)
    assert find_side_files(tmp_path) == []
