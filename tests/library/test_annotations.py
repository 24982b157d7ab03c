"""Labels of takes: segments are clips that are places in the take."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dousa.errors import LibraryError, OptionError
from dousa.library import Library
from dousa.motion.annotation import Annotation, Stretch, lay_out

LABELS = Annotation((Stretch(0.1, 0.5, "wave"), Stretch(0.6, 1.4, "kick")), unclear=((1.4, 1.6),), source="t.csv")


@pytest.fixture
def take(library, write_move, tmp_path) -> int:
    path = write_move(tmp_path / "takes" / "one.bvh", "squat", 40, n_frames=60)
    library.add(path, kind="take", performer_from="name:(one)", n_jobs=1)
    return library.clips(path)[0].id


def test_segments_are_clips_without_positions_of_their_own(library, take):
    before = library.stats()
    changes = library.annotations.write(take, LABELS, n_jobs=1)
    assert (changes.n_segments, changes.n_removed, changes.new_categories) == (2, 0, ("kick",))
    clips = {clip.category: clip for clip in library.clips() if clip.take_id == take}
    kick = clips["kick"]
    assert (kick.kind, kick.performer, kick.start_s, kick.end_s, kick.n_frames) == ("clip", "one", 0.6, 1.4, 24)
    assert kick.path.endswith("one.bvh#t=0.600,1.400")
    whole = library.trajectories(take).positions
    assert np.array_equal(library.trajectories(kick.id).positions, whole[18:42])
    after = library.stats()
    assert (after.n_clips, after.n_takes, after.categories["kick"]) == (before.n_clips + 2, 1, 1)
    with library.database.reading() as connection:
        stored = connection.exec_driver_sql("SELECT count(*) FROM clip_trajectories").scalar_one()
    assert stored == before.n_clips + 1


def test_segments_are_searched_classified_and_trained_on(library, take):
    library.annotations.write(take, LABELS, n_jobs=1)
    kick = next(clip for clip in library.clips() if clip.category == "kick")
    assert kick.predicted_category is not None  # it was learned when it was added
    assert library.search(kick.id, 1).results[0].clip_id == kick.id
    assert library.train(n_trees=10).categories["kick"] == 1
    assert library.search(kick.id, 1).category in ("kick", None)
    assert library.label(take, n_jobs=1).timeline.duration == pytest.approx(2.0, abs=0.01)


def test_the_take_from_beginning_to_end(library, take):
    library.annotations.write(take, LABELS, n_jobs=1)
    (known,) = library.annotations.read()
    assert known.is_complete and known.source == "t.csv"
    (loaded,) = library.annotations.load()
    duration = loaded.stretches[-1].stop
    assert [(one.start, one.stop, one.category, one.counted) for one in loaded.stretches] == [
        (0.0, 0.1, None, True),
        (0.1, 0.5, "wave", True),
        (0.5, 0.6, None, True),
        (0.6, 1.4, "kick", True),
        (1.4, 1.6, None, False),
        (1.6, duration, None, True),
    ]
    assert loaded.performer == "one" and loaded.positions.shape == (60, 20, 3)


def test_the_same_labels_change_nothing_and_others_what_differs(library, take):
    library.annotations.write(take, LABELS, n_jobs=1)
    numbers = {one.category: one.clip_id for one in library.annotations.read()[0].segments}
    revision = library.revision
    assert library.annotations.write(take, LABELS, n_jobs=1).unchanged
    assert library.revision == revision
    other = Annotation((LABELS.segments[0], Stretch(0.6, 1.4, "hop")))
    changes = library.annotations.write(take, other, n_jobs=1)
    assert (changes.n_segments, changes.n_removed) == (1, 1)
    now = {one.category: one.clip_id for one in library.annotations.read()[0].segments}
    assert now["wave"] == numbers["wave"] and set(now) == {"wave", "hop"}
    assert now["hop"] != numbers["kick"]


def test_what_was_removed_comes_back_and_what_was_relabelled_stays(library, take):
    library.annotations.write(take, LABELS, n_jobs=1)
    wave, kick = library.annotations.read()[0].segments
    library.remove([kick.clip_id])
    library.relabel([wave.clip_id], category="greet")
    changes = library.annotations.write(take, LABELS, n_jobs=1)
    assert (changes.n_segments, changes.n_removed, len(changes.takes)) == (1, 0, 1)
    assert [one.category for one in library.annotations.read()[0].segments] == ["greet", "kick"]
    assert library.annotations.write(take, LABELS, n_jobs=1).unchanged


def test_what_goes_beyond_the_end_is_cut_and_what_is_no_motion_left_out(library, take):
    labels = Annotation((Stretch(1.5, 9.0, "wave"), Stretch(5.0, 6.0, "far"), Stretch(0.2, 0.21, "point")))
    changes = library.annotations.write(take, labels, n_jobs=1)
    assert [note.code for _, note in changes.warnings] == ["annotations.past_end", "annotations.too_short"]
    (one,) = library.annotations.read()[0].segments
    assert (one.start, one.end, one.category) == (1.5, pytest.approx(2.0, abs=0.01), "wave")


def test_removing_a_take_removes_its_segments(library, take):
    library.annotations.write(take, LABELS, n_jobs=1)
    library.remove([take])
    assert not any(clip.take_id for clip in library.clips())
    assert "kick" not in library.categories()
    assert library.annotations.read() == []
    assert not library.stats().forest_is_current


def test_a_take_whose_file_changed_loses_its_old_segments(library, take, write_move):
    path = library.clips([take])[0].path
    library.annotations.write(take, LABELS, n_jobs=1)
    write_move(Path(path), "bow", 41, 60)
    report = library.add(path, kind="take", n_jobs=1)
    assert report.replaced
    assert not any(clip.take_id for clip in library.clips())


def test_naming_a_part_by_hand(library, take):
    number = library.annotations.name(take, 0.5, 1.0, "hop", n_jobs=1)
    (known,) = library.annotations.read([take])
    assert not known.is_complete and [one.by_hand for one in known.segments] == [True]
    assert {one.counted for one in known.stretches} == {True, False}  # nobody can say what the rest is
    again = library.annotations.name(take, 0.5, 1.1, "skip", n_jobs=1)
    (one,) = library.annotations.read([take])[0].segments
    assert (one.clip_id, one.category) == (again, "skip") and again != number
    changes = library.annotations.write(take, LABELS, n_jobs=1)
    assert "annotations.by_hand_gone" in [note.code for _, note in changes.warnings]


def test_labels_belong_to_takes(library, take):
    clip = next(one for one in library.clips() if one.kind == "clip")
    with pytest.raises(LibraryError, match="is the clip"):
        library.annotations.write(clip.id, LABELS)
    with pytest.raises(LibraryError, match="no clip or take"):
        library.annotations.name(999, 0, 1, "wave")
    with pytest.raises(OptionError):
        library.annotations.name(take, 0, 1, " ")


def test_relabelling_a_segment_and_the_performer_of_a_take(library, take):
    library.annotations.write(take, LABELS, n_jobs=1)
    kick = next(clip for clip in library.clips() if clip.category == "kick")
    library.relabel([kick.id], category=None)
    library.relabel([take], performer="two")
    assert library.clips([kick.id])[0].performer == "two"
    (known,) = library.annotations.read()
    assert [one.category for one in known.segments] == ["wave", None]
    assert [one.counted for one in known.stretches if one.start == 0.6] == [False]


def test_where_segments_overlap_the_shorter_is_seen():
    parts = lay_out([Stretch(0, 10, "walk"), Stretch(4, 5, "wave")], [(9, 12)], 11)
    assert [(one.start, one.stop, one.category, one.counted) for one in parts] == [
        (0, 4, "walk", True),
        (4, 5, "wave", True),
        (5, 10, "walk", True),
        (10, 11, None, False),
    ]


def test_an_empty_annotation_says_that_nothing_happens(tmp_path, write_move):
    with Library.open(tmp_path / "a.dousa", create=True) as library:
        library.add(write_move(tmp_path / "one.bvh"), kind="take", n_jobs=1)
        library.annotations.write(1, Annotation(()))
        (known,) = library.annotations.read()
        assert known.segments == () and [one.counted for one in known.stretches] == [True]
