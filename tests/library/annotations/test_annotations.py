"""Labels of takes: segments are clips that are places in the take."""

from pathlib import Path

import numpy as np
import pytest

from dousa.errors import LibraryError, MotionFileError, OptionError
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
    assert [(note.code, note.values["n"]) for _, note in changes.warnings] == [("annotations.removed", 1)]
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


def test_where_a_removed_segment_was_nobody_can_say_what_happens(library, take):
    """It is not called nothing by the next training; what the table says of the rest stays true."""
    library.annotations.write(take, LABELS, n_jobs=1)
    (before,) = library.annotations.read()
    kick = before.segments[1]
    library.remove([kick.clip_id])
    (known,) = library.annotations.read()
    assert known.is_complete and known.unclear == ((0.6, 1.4), (1.4, 1.6))
    said = [(one.start, one.category, one.counted) for one in known.stretches]
    assert said == [(0.0, None, True), (0.1, "wave", True), (0.5, None, True), (0.6, None, False), (1.6, None, True)]
    library.undo()
    assert library.annotations.read() == [before]
    library.redo()
    assert library.annotations.read() == [known]
    library.annotations.write(take, LABELS, n_jobs=1)
    (again,) = library.annotations.read()
    assert again.unclear == LABELS.unclear and [one.category for one in again.segments] == ["wave", "kick"]
    library.undo()
    assert library.annotations.read() == [known]
    assert library.check().is_sound


@pytest.mark.parametrize("for_good", [False, True])
def test_a_take_whose_segments_are_all_removed_has_no_labels(library, take, for_good):
    library.annotations.write(take, LABELS, n_jobs=1)
    before = library.annotations.read()
    numbers = [one.clip_id for one in before[0].segments]
    library.remove(numbers[:1])
    library.remove(numbers[1:], for_good=for_good)
    assert library.annotations.read() == [] and list(library.annotations.load()) == []
    if not for_good:
        library.undo()
        library.undo()
        assert library.annotations.read() == before
        library.redo()
        library.redo()
    assert library.annotations.write(take, LABELS, n_jobs=1).n_segments == 2
    assert library.annotations.read()[0].is_complete


def test_what_was_named_by_hand_leaves_the_table_as_it_is(library, take):
    """Names that are taken back one after the other can be had again in any order."""
    library.annotations.write(take, LABELS, n_jobs=1)
    before = library.annotations.read()
    numbers = [library.annotations.name(take, start, start + 0.2, "nod", n_jobs=1) for start in (1.45, 1.7)]
    library.remove([numbers[0]])
    first = library.last_change
    library.remove([numbers[1]])
    assert library.annotations.read() == before
    library.undo(first)
    assert [one.clip_id for one in library.annotations.read()[0].segments][2:] == numbers[:1]


def test_of_two_things_at_one_time_the_one_that_is_meant_is_named_otherwise(library, take):
    both = Annotation((Stretch(0.1, 0.9, "walk"), Stretch(0.1, 0.9, "wave")))
    library.annotations.write(take, both, n_jobs=1)

    def list_categories():
        return sorted(one.category for one in library.annotations.read()[0].segments)

    library.annotations.name(take, 0.15, 0.9, "clap", instead_of="wave", n_jobs=1)
    assert list_categories() == ["clap", "walk"]
    library.annotations.name(take, 0.15, 0.9, "nod", instead_of="clap", n_jobs=1)
    assert list_categories() == ["nod", "walk"]
    library.undo()
    library.annotations.name(take, 0.1, 0.9, "kick", instead_of="bow", n_jobs=1)  # which is not there
    assert list_categories() == ["clap", "kick", "walk"]
    library.annotations.name(take, 0.1, 0.9, "bow", n_jobs=1)
    assert list_categories() == ["bow"]


def test_removed_categories_and_takes(library, take):
    """Segments of several takes go at once; a take that goes takes its table along, and brings it back."""
    library.annotations.write(take, LABELS, n_jobs=1)
    before = library.annotations.read()
    library.remove(category="kick")
    assert library.journal()[0].n_clips == 1
    assert library.annotations.read()[0].unclear == ((0.6, 1.4), (1.4, 1.6))
    library.undo()
    for removed in ([take, *(one.clip_id for one in before[0].segments)], [take]):
        library.remove(removed)
        assert library.annotations.read() == [] and not any(clip.take_id for clip in library.clips())
        assert "kick" not in library.categories() and not library.stats().forest_is_current
        library.undo()
        assert library.annotations.read() == before


def test_what_goes_beyond_the_end_is_cut_and_what_is_no_motion_left_out(library, take):
    labels = Annotation((Stretch(1.5, 9.0, "wave"), Stretch(5.0, 6.0, "far"), Stretch(0.2, 0.21, "point")))
    changes = library.annotations.write(take, labels, n_jobs=1)
    assert [note.code for _, note in changes.warnings] == [
        "annotations.past_end",
        "annotations.beyond",
        "annotations.too_short",
    ]
    (one,) = library.annotations.read()[0].segments
    assert (one.start, one.end, one.category) == (1.5, pytest.approx(2.0, abs=0.01), "wave")


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


def test_what_is_left_by_rounding_is_no_stretch():
    parts = lay_out([Stretch(0.0004, 1.0, "walk"), Stretch(1.0003, 2.5333, "wave")], [], 2.53333)
    assert [(one.start, one.stop, one.category) for one in parts] == [(0.0, 1.0003, "walk"), (1.0003, 2.53333, "wave")]


def test_an_empty_annotation_says_that_nothing_happens(tmp_path, write_move):
    with Library.open(tmp_path / "a.dousa", create=True) as library:
        library.add(write_move(tmp_path / "one.bvh"), kind="take", n_jobs=1)
        library.annotations.write(1, Annotation(()))
        (known,) = library.annotations.read()
        assert known.segments == () and [one.counted for one in known.stretches] == [True]


def test_labels_on_the_same_stretch_are_clips_of_their_own(library, take):
    both = (
        Stretch(0.5, 1.5, "walk"), Stretch(0.5, 1.5, "turn"), Stretch(0.5002, 1.5, "nod"), Stretch(0.5, 1.5, "walk"),
    )  # fmt: skip
    changes = library.annotations.write(take, Annotation(both), n_jobs=1)
    assert changes.n_segments == 3
    assert [note.code for _, note in changes.warnings] == ["label_files.twice"]
    found = {clip.category: clip for clip in library.clips() if clip.take_id == take}
    times = {name: clip.path.partition("#t=")[2] for name, clip in found.items()}
    assert times == {"walk": "0.500,1.500", "turn": "0.500,1.500&id=2", "nod": "0.500,1.500&id=3"}
    assert library.annotations.write(take, Annotation(both), n_jobs=1).unchanged
    # One that goes leaves the others as they are; one that comes takes the name that is free.
    library.remove([found["turn"].id])
    assert library.annotations.write(take, Annotation(both), n_jobs=1).n_segments == 1
    fewer = library.annotations.write(take, Annotation((*both[1:3], Stretch(0.5, 1.5, "hop"))), n_jobs=1)
    assert (fewer.n_segments, fewer.n_removed) == (1, 1)
    now = {clip.category: clip.path.partition("#t=")[2] for clip in library.clips() if clip.take_id == take}
    assert now == {"turn": "0.500,1.500&id=2", "nod": "0.500,1.500&id=3", "hop": "0.500,1.500"}


def test_labels_at_the_same_time_that_were_relabelled(library, take):
    both = Annotation((Stretch(0.5, 1.5, "walk"), Stretch(0.5, 1.5, "turn")))
    library.annotations.write(take, both, n_jobs=1)
    walk = next(clip.id for clip in library.clips() if clip.category == "walk")
    library.relabel([walk], category="hop")
    assert library.annotations.write(take, both, n_jobs=1).unchanged
    more = Annotation((*both.segments, Stretch(0.5, 1.5, "hop")))
    assert library.annotations.write(take, more, n_jobs=1).n_segments == 1
    assert sorted(one.category for one in library.annotations.read()[0].segments) == ["hop", "turn", "walk"]
    library.relabel([one.clip_id for one in library.annotations.read()[0].segments], category="hop")
    assert library.annotations.write(take, Annotation((Stretch(0.5, 1.5, "hop"),)), n_jobs=1).n_removed == 2
    library.undo()
    assert len(library.annotations.read()[0].segments) == 3


@pytest.mark.parametrize(
    ("segments", "said"),
    [
        (
            [(2067, 6667)],
            "'x' from 2067 to 6667 s does not fit one.bvh, which ends at 2.00 s; of its 1 label none lies",
        ),
        ([(0, 700), (800, 1900)], "'x' from 0 to 700 s does not fit .* milliseconds"),
        ([(0, 20), (25, 55)], "'x' from 0 to 20 s does not fit .* the frame rate, 30 Hz"),
        ([(30.5, 40.0), (60.0, 70.5)], "of its 2 labels none lies within the take"),
        ([(0.1, 0.11), (0.2, 0.21)], "shorter than two frames"),
    ],
)
def test_labels_that_do_not_fit_their_take_change_nothing(library, take, segments, said):
    library.annotations.write(take, LABELS, n_jobs=1)
    revision = library.revision
    parts = tuple(Stretch(start, stop, "x", line=7) for start, stop in segments)
    with pytest.raises(OptionError, match=said):
        library.annotations.write(take, Annotation(parts))
    with pytest.raises(MotionFileError, match=f"t.csv:7: .*{said}"):
        library.annotations.write(take, Annotation(parts, source="t.csv"))
    assert library.revision == revision and len(library.annotations.read()[0].segments) == 2


def test_what_no_label_can_be_is_refused_and_changes_nothing(library, take):
    library.annotations.write(take, LABELS, n_jobs=1)
    revision = library.revision
    nan = float("nan")
    for start, stop, said in (
        (nan, 1.0, "expected times within a recording, got nan, 1"),
        (0.0, float("inf"), "expected times"),
        (1.5, 0.5, "'x' ends at 0.5, not after it begins at 1.5"),
        (1.0, 1.0, "ends at 1"),
        (100.0, 101.0, "does not fit one.bvh"),
    ):
        with pytest.raises(OptionError, match=said):
            library.annotations.name(take, start, stop, "x")
        with pytest.raises(OptionError, match=said):
            library.annotations.write(take, Annotation((Stretch(start, stop, "x"),)))
    for labels in (
        Annotation((Stretch(0.1, 0.5, " "),)),
        Annotation((Stretch(0.1, 0.5, "x" * 2000),)),
        Annotation((), unclear=((1.0, nan),)),
    ):
        with pytest.raises(OptionError):
            library.annotations.write(take, labels)
    assert library.revision == revision
    assert library.annotations.name(take, 0.5, 0.51, "x") is None


def test_blank_labels_take_all_away(library, take):
    assert library.annotations.write(take, Annotation((), is_blank=True)).unchanged
    library.annotations.write(take, LABELS, n_jobs=1)
    library.annotations.name(take, 1.5, 1.9, "hop", n_jobs=1)
    changes = library.annotations.write(take, Annotation((), is_blank=True), n_jobs=1)
    assert changes.n_removed == 3
    assert [note.code for _, note in changes.warnings] == ["annotations.removed", "annotations.by_hand_gone"]
    assert library.annotations.read() == []
    library.undo()
    assert library.annotations.read()[0].is_complete
