"""Listing, removing and relabelling clips."""

from dataclasses import replace

import pytest
import sqlalchemy as sa

from dousa.errors import LibraryDamagedError, LibraryError, OptionError
from dousa.formats import read_canonical
from dousa.library import Library
from dousa.library.store import schema
from dousa.messages import Message


def test_clips_are_chosen_by_label_number_file_and_folder(library, moves):
    everything = library.clips()
    assert len(everything) == 15
    assert len(library.clips(category="bow")) == 5
    assert len(library.clips(performer="p3")) == 3
    assert [clip.category for clip in library.clips(category="bow", performer="p3")] == ["bow"]
    assert library.clips(everything[4].id) == [everything[4]]
    assert library.clips(moves / "squat") == library.clips(category="squat")
    both = [everything[0].id, moves / "wave"]
    assert library.clips(both) == [everything[0], *library.clips(category="wave")]


@pytest.mark.parametrize("selection", [999, "/no/such/file.bvh", [1, 999]])
def test_what_is_not_there_is_an_error_and_nothing_changes(library, selection):
    with pytest.raises(LibraryError, match="see: dousa list"):
        library.remove(selection)
    with pytest.raises(LibraryError, match="see: dousa list"):
        library.relabel(selection, category="x")
    assert len(library.clips()) == 15


def test_remove_takes_clips_and_everything_of_them(library, moves):
    removed = library.remove(category="wave")
    assert sorted(removed) == sorted(str(path) for path in (moves / "wave").iterdir())
    assert library.categories() == {"bow": 5, "squat": 5}
    assert len(library.search(moves / "bow" / "bow_p0.bvh", 100).results) == 10
    assert library.stats().forest_is_current is False
    assert all(path.exists() for path in (moves / "wave").iterdir())


def test_removed_clips_can_be_added_again_under_new_numbers(library, moves):
    numbers = {clip.id for clip in library.clips()}
    library.remove(category="wave")
    assert len(library.add(moves).added) == 5
    assert {clip.id for clip in library.clips(category="wave")}.isdisjoint(numbers)


def test_relabel(library, moves):
    library.relabel(where_category="wave", category="greet")
    assert library.categories() == {"bow": 5, "greet": 5, "squat": 5}
    library.relabel(moves / "bow", performer=None)
    assert {clip.performer for clip in library.clips(category="bow")} == {None}
    assert library.stats().forest_is_current is False
    library.train(n_trees=5)
    assert library.search(moves / "wave" / "wave_p0.bvh").category == "greet"


def test_stats(library, empty_library):
    stats = library.stats()
    assert (stats.n_clips, stats.n_frames, stats.n_unlabelled) == (15, 15 * 24, 0)
    assert stats.seconds == pytest.approx(15 * 24 * 0.033333, rel=1e-4)
    assert stats.performers == {f"p{number}": 3 for number in range(5)}
    assert stats.forest_is_current and stats.trained_at
    none = empty_library.stats()
    assert (none.n_clips, none.n_frames, none.seconds, none.trained_at) == (0, 0, 0.0, None)


def test_odd_names_are_kept(library_file, write_move, tmp_path):
    odd = "wa've %_ \N{SNOWMAN} -- 動作"
    path = write_move(tmp_path / odd / "a b%.bvh", "wave", 321)
    with Library.open(library_file) as library:
        library.add(tmp_path / odd, category_from="path:(.*)")
        (clip,) = library.clips(tmp_path / odd)
        assert (clip.path, clip.category) == (str(path), "a b%.bvh")
        library.relabel(tmp_path / odd, category=odd)
        library.train(n_trees=5)
        assert odd in library.search(path).histogram


def test_the_revision_counts_the_writes_of_everybody(library):
    before = library.revision
    assert library.revision == before
    with Library.open(library.name) as other:
        other.relabel(1, performer="x")
    assert library.revision == before + 1 == library.stats().revision


def test_many_motions_are_read_at_once_and_missing_ones_left_out(library):
    found = dict(library.iterate_trajectories([3, 1, 999, -5, 2**40]))
    assert sorted(found) == [1, 3]
    alone = library.trajectories(3)
    assert (found[3].positions == alone.positions).all()
    assert found[3].frame_rate == alone.frame_rate
    assert list(library.iterate_trajectories([])) == []


def test_the_content_of_a_clip_has_a_name_that_its_labels_do_not_change(library):
    before = library.contents([1, 2, 999])
    assert sorted(before) == [1, 2]
    assert before[1] != before[2]
    library.relabel(1, category="other")
    assert library.contents([1, 2]) == before


def test_doubts_are_kept_as_codes(library, moves):
    doubtful = replace(
        read_canonical(moves / "bow/bow_p1.bvh")[0], warnings=(Message("canonical.made_toes"),), frame_rate=25.0
    )
    report = library.add_motion(doubtful, "a", "bow")
    assert report.warnings == (("a", Message("canonical.made_toes")),)
    (clip,) = library.clips("a")
    assert clip.warnings == (Message("canonical.made_toes"),)
    assert clip.warnings[0].render("ja") != clip.warnings[0].render("en") == clip.to_json()["warnings"][0]


def test_every_error_of_a_selection_is_said_in_japanese(library, moves):
    in_english = {
        "no clip of category 'dance' and performer 'p0'": {"category": "dance", "performer": "p0"},
        "99": {"selection": [99]},
        "nowhere": {"selection": ["nowhere"]},
        "squa": {"selection": str(moves / "squa")},  # a folder whose name begins another is not meant
    }
    for said, wanted in in_english.items():
        with pytest.raises(LibraryError, match=said) as caught:
            library.clips(**wanted)
        assert caught.value.code.startswith("library_clips.")
        assert "ありません" in caught.value.render("ja")


@pytest.mark.parametrize(
    ("call", "words", "options"),
    [("remove", (), {}), ("remove", ([],), {}), ("relabel", (), {"category": "x"}), ("relabel", (1,), {}),
     ("relabel", (1,), {"category": " "}), ("relabel", (1,), {"performer": ""})],
)  # fmt: skip
def test_clips_and_labels_are_needed(library, call, words, options):
    with pytest.raises(OptionError, match="expected"):
        getattr(library, call)(*words, **options)


def assert_is_listed(library, known):
    """What is known is what a new list says."""
    assert sorted(known.clips.values(), key=lambda clip: clip.path) == library.clips()


def test_what_has_changed_is_read_again_and_nothing_else(library, moves):
    known = library.renew_clips()
    assert_is_listed(library, known)
    first, second, *_ = sorted(known.clips)
    changes = (
        (lambda: library.tag([first], add=["good"]), {first}),
        (lambda: library.relabel(second, performer="somebody"), {second}),
        (lambda: library.remove(first), set()),
        (library.undo, {first}),
        (lambda: library.remove(category="wave"), set()),
        (lambda: library.add(moves), None),
        (library.train, None),
    )
    for change, expected in changes:
        change()
        news = library.renew_clips(known)
        assert_is_listed(library, news)
        read = {number for number, clip in news.clips.items() if clip is not known.clips.get(number)}
        assert expected is None or read == expected
        known = news
    assert library.renew_clips(known).clips == known.clips


def test_a_damaged_row_is_not_taken_for_another_one(library):
    known = library.renew_clips()
    first = min(known.clips)
    with library.database.writing() as connection:
        connection.execute(sa.update(schema.clips).where(schema.clips.c.id == first).values(height=9.0))
    with pytest.raises(LibraryDamagedError):
        library.renew_clips()
    with pytest.raises(LibraryDamagedError):
        library.clips()
