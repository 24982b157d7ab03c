"""Undoing and redoing changes of a library: labels, tags, removals, what was added, labels of takes."""

import pytest
import sqlalchemy as sa

from dousa.errors import LibraryError, OptionError
from dousa.library import Library
from dousa.library.history import journal as entries
from dousa.library.store import schema
from dousa.motion.annotation import Annotation, Stretch

# What follows from positions may be computed again; features are, and take windows.
_DERIVED = {"clip_features", "take_windows"}
_COUNTED = {"library_state", "journal", "removed_clips", "removed_positions", "dousa_migrations"}


def content(library: Library, without: set[str] = frozenset()) -> dict[str, set]:
    """Every row of every table but what counts changes."""
    with library.database.reading() as connection:
        return {
            table.name: {str(tuple(row)) for row in connection.execute(sa.select(table))}
            for table in schema.metadata.sorted_tables
            if table.name not in _COUNTED | without
        }


def labels(library: Library) -> dict[int, tuple]:
    return {clip.id: (clip.category, clip.performer, clip.tags) for clip in library.clips()}


def answers(library: Library, number: int) -> list[tuple[int, float]]:
    return [(hit.clip_id, hit.distance) for hit in library.search(number, 20, ranking="fused").results]


def test_labels_come_back_also_after_a_restart(library, library_file):
    before = content(library)
    bows = [clip.id for clip in library.clips(category="bow")]
    library.relabel(bows, category="greeting", performer=None)
    library.relabel(bows[:2], category="deep bow")
    after = content(library)
    library.close()
    with Library.open(library_file) as again:
        assert [entry.kind for entry in again.journal()] == ["relabel", "relabel", "add"]
        assert again.undo().what.code == "journal.category"
        assert {clip.category for clip in again.clips(bows)} == {"greeting"}
        assert again.undo().n_clips == len(bows)
        assert content(again) == before
        again.redo()
        again.redo()
        assert content(again) == after
        with pytest.raises(LibraryError, match="nothing to redo") as caught:
            again.redo()
        assert caught.value.code == "journal.nothing_to_redo"


def test_removed_clips_come_back_with_the_same_answers(library):
    before, kick = content(library, _DERIVED), answers(library, 1)
    features = content(library)["clip_features"]
    library.tag([2], add=["keep", "favourite"])
    library.undo()
    gone = [clip.id for clip in library.clips(category="squat")]
    library.remove(gone)
    assert all(number not in gone for number, _ in answers(library, 1))
    entry = library.undo()
    assert (entry.kind, entry.n_clips, entry.kept_bytes) == ("remove", len(gone), 0)
    assert content(library, _DERIVED) == before
    assert answers(library, 1) == kick
    assert library.check().is_sound
    library.train(n_trees=20)
    assert content(library)["clip_features"] == features
    library.redo()
    assert not set(gone) & {clip.id for clip in library.clips()}


def test_clips_that_come_back_are_asked_of_the_forest_that_there_is_now(library, write_move, tmp_path):
    gone = [clip.id for clip in library.clips(category="squat")][:2]
    library.remove(gone)
    library.train(n_trees=30, random_state=5)
    assert library.undo().kind == "remove"
    assert library.check().is_sound
    found = dict(answers(library, gone[0]))
    assert found[gone[0]] == 0.0 and gone[1] in found
    assert library.clips(gone)[0].predicted_category == "squat"


def test_adding_is_one_change_and_files_that_changed_come_back_as_they_were(library, write_move, tmp_path):
    for seed in range(3):
        write_move(tmp_path / "new" / f"a{seed}.bvh", "bow", seed=50 + seed)
    library.add(tmp_path / "new", category_from="none")
    first = tmp_path / "new" / "a0.bvh"
    library.tag([str(first)], add=["draft"])
    before = content(library, _DERIVED)
    write_move(first, "bow", seed=99)
    report = library.add(tmp_path / "new", category_from="none")
    assert report.replaced == (str(first),)
    assert library.clips([str(first)])[0].tags == ("draft",)
    library.undo()
    assert content(library, _DERIVED) == before
    library.undo()
    assert library.undo().kind == "add"
    assert not [clip for clip in library.clips() if str(tmp_path / "new") in clip.path]
    library.redo()
    assert len([clip for clip in library.clips() if str(tmp_path / "new") in clip.path]) == 3


def test_undoing_an_add_of_moved_files_loses_nothing(library, write_move, tmp_path):
    old, new = tmp_path / "old", tmp_path / "new"
    for seed in range(2):
        write_move(old / f"a{seed}.bvh", "bow", seed=50 + seed)
    library.add(old, category_from="none")
    library.add(write_move(old / "take.bvh", "squat", n_frames=300), kind="take")
    (take,) = [clip.id for clip in library.clips() if clip.kind == "take"]
    library.annotations.name(take, 0.5, 1.5, "nod")
    before = {clip.id: clip.path for clip in library.clips()}
    old.rename(new)
    assert len(library.add(new, category_from="none").moved) == 3
    after = {clip.id: clip.path for clip in library.clips()}
    assert [number for number in before if before[number] != after[number]] == [*before][-4:]
    assert (library.journal()[0].kind, library.journal()[0].n_clips) == ("move", 4)
    for paths, step in ((before, library.undo), (after, library.redo), (before, library.undo)):
        assert step().what.code == "journal.moved"
        assert {clip.id: clip.path for clip in library.clips()} == paths
    write_move(new / "b.bvh", "bow", seed=70)
    assert len(library.add(new, category_from="none").moved) == 3
    assert library.journal()[0].kind == "add"
    library.undo()
    assert {clip.id: clip.path for clip in library.clips()} == before
    library.redo()
    number = library.journal()[0].number
    library.add(write_move(old / "a0.bvh", "bow", seed=80), category_from="none")
    with pytest.raises(LibraryError) as caught:
        library.undo(number)
    assert caught.value.code == "journal.changed_since"


def test_labels_of_takes_come_back(library, write_move, tmp_path):
    path = write_move(tmp_path / "take.bvh", "squat", n_frames=300)
    library.add(path, kind="take")
    (take,) = [clip.id for clip in library.clips() if clip.kind == "take"]
    bare = content(library, _DERIVED)
    library.annotations.write(take, Annotation((Stretch(0, 2, "squat"), Stretch(2, 5, "rest")), (), "t", "source"))
    table = content(library, _DERIVED)
    library.annotations.name(take, 2.1, 4.9, "pause")
    assert [entry.kind for entry in library.journal()[:2]] == ["name", "label"]
    library.undo()
    assert {one.category for one in library.annotations.read([take])[0].segments} == {"squat", "rest"}
    kept = {"clips", "segments", "take_annotations", "clip_relations", "clip_tags"}
    assert {name: rows for name, rows in content(library).items() if name in kept} == {
        name: rows for name, rows in table.items() if name in kept
    }
    library.undo()
    now = content(library)
    assert library.annotations.read([take])[0].segments == ()
    assert {name: now[name] for name in kept} == {name: bare[name] for name in kept}
    library.remove([take])
    library.undo()
    assert library.find(1, k=1).results[0].take == str(path)
    assert library.check().is_sound


def test_several_steps_are_one_change(library, write_move, tmp_path):
    def said():
        return {
            name: rows for name, rows in content(library).items() if name in ("clips", "segments", "take_annotations")
        }

    library.add(write_move(tmp_path / "take.bvh", "squat", n_frames=300), kind="take")
    (take,) = [clip.id for clip in library.clips() if clip.kind == "take"]
    parts = [library.annotations.name(take, start, start + 1.0, "nod") for start in (0.5, 1.5)]
    two, n_changes = said(), len(library.journal())
    with library.one_change("name", category="long nod"):
        library.remove(parts)
        library.annotations.name(take, 0.5, 2.5, "long nod")
        library.relabel([1], category="greeting")
    one = said()
    assert len(library.journal()) == n_changes + 1
    assert library.last_change == library.journal()[0].number
    undone = library.undo()
    assert (undone.kind, undone.what.code) == ("name", "journal.named") and "long nod" in str(undone.what)
    assert said() == two
    library.redo()
    assert said() == one
    with pytest.raises(LibraryError), library.one_change():
        library.relabel([1], category="nod")
        library.remove([take + 99])
    assert library.undo(library.last_change).kind == "relabel"
    assert said() == one
    with library.one_change():
        pass
    assert library.last_change is None
    library.relabel([2], category="nod")
    assert library.journal()[0].kind == "relabel"


def test_the_number_of_a_change_is_told_whatever_it_was(library, write_move, tmp_path):
    """Names of stretches, labels of takes and motions of the memory too; None where nothing changed."""
    library.add(write_move(tmp_path / "take.bvh", "squat", n_frames=300), kind="take")
    (take,) = (clip.id for clip in library.clips() if clip.kind == "take")
    changes = [
        lambda: library.annotations.name(take, 0.5, 1.5, "nod"),
        lambda: library.annotations.write(take, Annotation((Stretch(1.0, 2.0, "greet"),))),
        lambda: library.add_motion(library.trajectories(1), "mine", "bow", performer="me"),
    ]
    for change in changes:
        library.relabel([1], category="other")
        before = library.last_change
        change()
        (last, *_) = library.journal()
        if last.number == before:  # the same content is not added a second time
            assert library.last_change is None
        else:
            assert library.last_change == last.number
        library.relabel([1], category="bow")
    library.annotations.write(take, Annotation((Stretch(1.0, 2.0, "greet"),)))
    assert library.last_change is None


def test_tags_are_given_and_taken(library):
    library.tag([1, 2, 3], add=["fight", "draft"])
    library.tag([2], remove=["draft"], add=["favourite"])
    assert library.tags() == {"draft": 2, "favourite": 1, "fight": 3}
    assert [clip.id for clip in library.clips(tag="draft")] != []
    assert {clip.id for clip in library.clips(tag="draft")} == {1, 3}
    library.undo()
    assert labels(library)[2][2] == ("draft", "fight")
    assert len(library.tag(where_tag="fight", remove=["fight"])) == 3
    assert library.tags() == {"draft": 3}
    for wrong in ("", "+a", "a\nb"):
        with pytest.raises(OptionError):
            library.tag([1], add=[wrong])
    with pytest.raises(OptionError):
        library.tag([1])
    with pytest.raises(LibraryError, match="no clip has the tag"):
        library.clips(tag="nobody")


def test_what_others_changed_since_is_left_alone(library, library_file):
    library.relabel([1, 2], category="a")
    mine = library.journal()[0].number
    with Library.open(library_file) as other:
        other.relabel([2, 3], category="b")
        theirs = other.journal()[0].number
        with pytest.raises(LibraryError) as caught:
            library.undo(mine)
        assert caught.value.code == "journal.changed_later"
        assert str(theirs) in str(caught.value)
        assert labels(library)[1][0] == "a" and labels(library)[2][0] == "b"
        other.relabel([4], category="c")
        assert library.undo(theirs).number == theirs  # another clip was changed later: that is no hindrance
        assert library.undo(mine).number == mine
        assert labels(library)[4][0] == "c"
    with pytest.raises(LibraryError) as caught:
        library.undo(mine)
    assert caught.value.code == "journal.undone_already"
    with pytest.raises(LibraryError) as caught:
        library.undo(12345)
    assert caught.value.code == "journal.no_change"


def test_each_takes_back_their_own_change(library, monkeypatch):
    library.relabel([1], category="a")
    mine = library.journal()[0]
    assert "@" in mine.made_by
    with monkeypatch.context() as patch:
        patch.setattr("getpass.getuser", lambda: "bob")
        library.tag([4], add=["fight"])
    theirs = library.journal()[0]
    assert theirs.made_by.startswith("bob@")
    assert library.undo().number == mine.number
    with monkeypatch.context() as patch:
        patch.setattr("getpass.getuser", lambda: "eve")
        with pytest.raises(LibraryError, match=r"by bob@.*tags \+fight") as caught:
            library.undo()
        assert caught.value.code == "journal.of_another"
    assert library.redo().number == mine.number
    assert library.undo(theirs.number).number == theirs.number


def test_a_name_that_is_taken_again_is_not_overwritten(library, moves):
    clip = library.clips(category="wave")[0]
    library.remove([clip.id])
    removal = library.journal()[0].number
    library.add(clip.path, category_from="none")
    with pytest.raises(LibraryError) as caught:
        library.undo(removal)
    assert caught.value.code == "journal.changed_since"
    library.undo()
    library.undo()
    assert library.clips([clip.path])[0].id == clip.id


def test_a_new_change_forgets_what_was_undone(library):
    library.remove([1, 2])
    library.undo()
    library.tag([3], add=["x"])
    with pytest.raises(LibraryError, match="nothing to redo"):
        library.redo()
    assert [entry.kind for entry in library.journal()] == ["tag", "add"]


@pytest.mark.sqlite
def test_compacting_forgets_removed_clips_and_says_so(library):
    library.relabel([1], category="x")
    library.remove([2, 3])
    library.relabel([4], category="y")
    assert library.journal()[1].kept_bytes == 2 * 24 * schema.FRAME_BYTES
    assert library.compact().forgotten == 2 * 24 * schema.FRAME_BYTES
    assert [entry.kind for entry in library.journal()] == ["relabel"]
    library.undo()
    with pytest.raises(LibraryError, match="nothing to undo"):
        library.undo()
    assert {clip.id for clip in library.clips()} & {2, 3} == set()


def test_the_oldest_changes_are_forgotten_where_they_keep_too_much(library, monkeypatch):
    monkeypatch.setitem(entries.keep_within_bounds.__kwdefaults__, "most_bytes", 3 * 24 * schema.FRAME_BYTES)
    library.remove([1, 2])
    library.relabel([7], category="x")
    library.remove([3, 4])
    assert [entry.kind for entry in library.journal()] == ["remove", "relabel"]
    library.remove([5, 6, 8, 9])  # more than that alone, and yet kept
    assert [(entry.kind, entry.n_clips) for entry in library.journal()] == [("remove", 4)]
    library.undo()
    assert {5, 6, 8, 9} <= {clip.id for clip in library.clips()}
    monkeypatch.setitem(entries.keep_within_bounds.__kwdefaults__, "most", 3)
    for tag in "abcde":
        library.tag([5], add=[tag])
    assert [entry.what.values["tags"] for entry in library.journal()] == [("+e",), ("+d",), ("+c",)]


def test_an_undo_that_fails_changes_nothing(library, monkeypatch):
    from dousa.library.history import recording as undoing

    library.remove([1, 2])
    before = content(library)

    def stop(*arguments):
        raise KeyboardInterrupt

    monkeypatch.setattr(undoing, "update_rows", stop)
    with pytest.raises(KeyboardInterrupt):
        library.undo()
    assert content(library) == before
    assert not library.journal()[0].is_undone


@pytest.mark.sqlite  # a server tells it in another way
def test_a_full_disk_leaves_the_way_without_an_undo(library):
    with library.database.alone() as connection:
        connection.execute(f"PRAGMA max_page_count = {connection.execute('PRAGMA page_count').fetchone()[0]}")
    before = content(library)
    with pytest.raises(LibraryError, match="--for-good") as caught:
        library.remove(category="bow")
    assert caught.value.code == "library_clips.no_room_for_undo"
    assert content(library) == before
    assert len(library.remove(category="bow", for_good=True)) == 5
    assert library.check().is_sound


def test_damage_of_the_journal_is_told_and_mended(library):
    library.relabel([1], category="x")
    library.tag([1], add=["fight"])
    with library.database.writing() as connection:
        connection.execute(sa.update(schema.journal).values(kind="relabel2"))
        connection.execute(sa.update(schema.clip_tags).values(tags=["fleet"]))
    report = library.check()
    assert {one.what.code for one in report.damage} == {"library_damage.journal", "library_damage.tags"}
    with pytest.raises(LibraryError, match="damaged"):
        library.undo()
    assert library.check(repair=True).is_sound
    assert library.journal() == [] and library.tags() == {}


def test_searches_are_kept(library, library_file):
    library.tag([1, 2], add=["draft"])
    library.searches.save("drafts", {"tag": ["draft"], "category": ["bow"]})
    library.searches.save("these", {"clips": [3, 1, 400]})
    library.searches.save("words", {"text": "WAVE p1"})
    with Library.open(library_file) as again:
        assert [one.name for one in again.searches.all()] == ["drafts", "these", "words"]
        assert again.searches.find("drafts") == [1, 2]
        assert again.searches.find("these") == [1, 3]
        assert [clip.category for clip in again.clips(again.searches.find("words"))] == ["wave"]
        again.searches.save("words", {"text": "squat"})
        assert again.searches.get("words").asked == {"text": "squat"}
        again.searches.remove("these")
        with pytest.raises(LibraryError):
            again.searches.remove("these")
    for name, asked in (("", {"text": "a"}), ("x", {}), ("x", {"colour": "red"})):
        with pytest.raises(OptionError):
            library.searches.save(name, asked)
