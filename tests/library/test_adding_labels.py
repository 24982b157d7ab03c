"""Takes with tables of labels beside them: ``Library.add(..., kind="take", labels_from=...)``."""

from pathlib import Path

import pytest

from dousa.errors import MotionFileError, OptionError
from dousa.formats.annotations.tables import format_labels_csv
from dousa.library import Library

HEAD = "start_s,end_s,category\n"


@pytest.fixture
def takes(tmp_path, write_move) -> Path:
    folder = tmp_path / "takes"
    for number, move in enumerate(("wave", "squat")):
        write_move(folder / f"p{number}_take.bvh", move, 60 + number, n_frames=90)
        (folder / f"p{number}_take.labels.csv").write_text(HEAD + f"0.2,1.0,{move}\n1.5,2.5,rest\n")
    return folder


def add(library: Library, folder: Path, rule: str | None = "beside", **options):
    return library.add(folder, kind="take", labels_from=rule, performer_from=r"name:(p\d)", n_jobs=1, **options)


def labels(library: Library) -> dict[str, list[tuple[float, float, str | None]]]:
    return {
        Path(one.path).stem: [(part.start, part.end, part.category) for part in one.segments]
        for one in library.annotations.read()
    }


def test_tables_beside_takes(library, takes):
    report = add(library, takes)
    assert (len(report.added), len(report.labelled), report.n_segments, report.n_learned) == (2, 2, 4, 4)
    assert report.new_categories == ("rest",) and report.passed_over == ()
    assert labels(library)["p0_take"] == [(0.2, 1.0, "wave"), (1.5, 2.5, "rest")]
    assert {clip.performer for clip in library.clips() if clip.take_id} == {"p0", "p1"}


def test_adding_again_takes_over_what_changed(library, takes):
    add(library, takes)
    numbers = {clip.path: clip.id for clip in library.clips() if clip.take_id}
    again = add(library, takes)
    assert (len(again.unchanged), again.labelled, again.n_segments) == (2, (), 0)
    (takes / "p1_take.labels.csv").write_text(HEAD + "0.2,1.0,squat\n1.6,2.5,rest\n")
    changed = add(library, takes)
    assert [Path(path).stem for path in changed.labelled] == ["p1_take"] and changed.n_segments == 1
    now = {clip.path: clip.id for clip in library.clips() if clip.take_id}
    assert len(now.keys() & numbers.keys()) == 3
    assert all(now[path] == numbers[path] for path in now.keys() & numbers.keys())


def test_labels_can_come_after_the_takes(library, takes):
    add(library, takes, None)
    assert labels(library) == {}
    assert len(add(library, takes).labelled) == 2


def test_a_take_without_a_table_is_kept_and_said(library, takes):
    (takes / "p1_take.labels.csv").unlink()
    report = add(library, takes)
    assert len(report.added) == 2 and len(report.labelled) == 1
    assert [(Path(path).stem, note.code) for path, note in report.warnings] == [("p1_take", "annotations.no_table")]


def test_one_table_for_all_and_tables_of_another_folder(library, takes, tmp_path):
    table = tmp_path / "all.csv"
    table.write_text("file,start_s,end_s,category\np0_take.bvh,0,1,wave\np1_take.bvh,1,2,squat\n")
    add(library, takes, f"csv:{table}")
    assert labels(library) == {"p0_take": [(0, 1, "wave")], "p1_take": [(1, 2, "squat")]}
    other = tmp_path / "other"
    other.mkdir()
    (other / "P0_take.Labels.csv").write_text(HEAD + "2,2.5,bow\n")
    add(library, takes, f"folder:{other}")
    assert labels(library) == {"p0_take": [(2, 2.5, "bow")], "p1_take": [(1, 2, "squat")]}


def test_mistakes_are_found_before_anything_is_written(library, takes, tmp_path):
    before = library.revision
    (takes / "p1_take.labels.csv").write_text(HEAD + "1,2,wave\n3,2,wave\n")
    with pytest.raises(MotionFileError, match=r"p1_take.labels.csv:3: 'wave' ends at 2"):
        add(library, takes)
    (takes / "p1_take.labels.csv").write_text(HEAD)
    (takes / "p1_take.TextGrid").write_text("")
    with pytest.raises(OptionError, match=r"several tables of labels \(p1_take.labels.csv, p1_take.TextGrid\)"):
        add(library, takes)
    (takes / "p1_take.TextGrid").unlink()
    empty = tmp_path / "empty"
    empty.mkdir()
    for rule, said in (
        ("besides", "expected beside"),
        (f"folder:{empty}", "no labels of any take"),
        (f"folder:{tmp_path / 'none'}", "cannot be read"),
        (f"csv:{tmp_path / 'none.csv'}", "no such file|not there|does not exist"),
    ):
        with pytest.raises((OptionError, MotionFileError), match=f"(?i){said}"):
            add(library, takes, rule)
    with pytest.raises(OptionError, match=r"no tier 'x'"):
        add(library, takes, tier="x")
    with pytest.raises(OptionError, match="for takes"):
        library.add(takes, labels_from="beside")
    with pytest.raises(OptionError, match="--labels"):
        library.add(takes, kind="take", tier="x")
    assert library.revision == before


def test_a_take_that_moved_keeps_its_segments(library, takes):
    add(library, takes)
    (takes / "p0_take.bvh").rename(takes / "q0_take.bvh")
    report = library.add(takes, kind="take", n_jobs=1)
    assert len(report.moved) == 1
    assert sum("q0_take.bvh#t=" in clip.path for clip in library.clips()) == 2


def test_what_label_writes_is_what_is_read(library, takes, tmp_path):
    from dousa.retrieval.takes.label import write_timeline_csv

    add(library, takes)
    take = next(clip for clip in library.clips() if clip.kind == "take")
    timeline = library.label(take.id, threshold=0.0, n_jobs=1).timeline
    said = [(round(one.start, 3), round(one.stop, 3), one.category) for one in timeline.segments if one.category]
    assert said
    write_timeline_csv(timeline, tmp_path / "p0_take.labels.csv")
    add(library, Path(take.path), f"folder:{tmp_path}")
    assert labels(library)["p0_take"] == said
    # ... and what is kept, written again, is the same once more.
    (known,) = library.annotations.read([take.id])
    (tmp_path / "p0_take.labels.csv").write_text(format_labels_csv(known.stretches))
    assert add(library, Path(take.path), f"folder:{tmp_path}").labelled == ()


def codes(report) -> list[tuple[str, str]]:
    return [(Path(path).name, note.code.partition(".")[2]) for path, note in report.warnings]


def test_labels_at_the_same_time_are_read(library, takes):
    (takes / "p0_take.labels.csv").write_text(HEAD + "0.2,1.0,wave\n0.2,1.0,stand\n0.2,1.0,wave\n")
    report = add(library, takes)
    assert report.n_segments == 4
    assert sorted(labels(library)["p0_take"]) == [(0.2, 1.0, "stand"), (0.2, 1.0, "wave")]
    assert add(library, takes).labelled == ()
    (takes / "p0_take.bvh").rename(takes / "q0_take.bvh")
    (takes / "p0_take.labels.csv").rename(takes / "q0_take.labels.csv")
    assert len(add(library, takes).moved) == 1
    names = [clip.path.partition("takes/q0_take.bvh#t=")[2] for clip in library.clips() if "q0_take" in clip.path]
    assert sorted(names) == ["", "0.200,1.000", "0.200,1.000&id=2"]


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ("2067,2667,walk\n2700,2900,sit\n", r"p1_take.labels.csv:2: 'walk' from 2067 .* milliseconds"),
        (
            "0,0.01,x\n75.5,80,walk\n",
            r"p1_take.labels.csv:3: 'walk' from 75.5 to 80 s does not fit p1_take.bvh, .*take",
        ),
        ("0,45,walk\n45,88,sit\n", r"p1_take.labels.csv:2: .* the frame rate, 30 Hz"),
    ],
)
@pytest.mark.parametrize("when", ["new", "known", "many"])
def test_a_table_that_does_not_fit_changes_nothing(library, takes, monkeypatch, rows, said, when):
    if when == "known":
        add(library, takes)
    elif when == "many":  # so that some are written while others are read
        monkeypatch.setattr("dousa.library.add._is_full", bool)
    before = labels(library), len(library.clips())
    (takes / "p1_take.labels.csv").write_text(HEAD + rows)
    with pytest.raises(MotionFileError, match=said):
        add(library, takes)
    assert (labels(library), len(library.clips())) == before
    (takes / "p1_take.labels.csv").write_text(HEAD + "1,2,walk\n2.5,8,sit\n8.5,9,run\n")
    assert codes(add(library, takes))[:2] == [("p1_take.bvh", "past_end"), ("p1_take.bvh", "beyond")]


def test_a_table_that_does_not_fit_undoes_nothing_of_the_block_around_it(library, takes, write_move):
    add(library, takes)
    write_move(takes / "p2_take.bvh", "wave", 70, n_frames=90)
    (takes / "p2_take.labels.csv").write_text(HEAD + "45,88,sit\n")
    with library.one_change():
        library.relabel(1, performer="Ben")
        with pytest.raises(MotionFileError):
            add(library, takes)
    assert library.clips([1])[0].performer == "Ben"
    library.undo()
    assert library.clips([1])[0].performer == "p0"


@pytest.mark.parametrize(("name", "content"), [("p1_take.labels.csv", HEAD), ("p1_take.TextGrid", "")])
def test_an_empty_table_is_no_annotation(library, takes, name, content):
    (takes / "p1_take.labels.csv").unlink()
    if name.endswith(".TextGrid"):
        head = 'File type = "ooTextFile"\nObject class = "TextGrid"\n0\n3\n<exists>\n1\n"IntervalTier"\n'
        content = head + '"x"\n0\n3\n1\n0\n3\n""\n'
    (takes / name).write_text(content)
    report = add(library, takes)
    assert codes(report) == [("p1_take.bvh", "blank")] and len(report.labelled) == 1
    assert set(labels(library)) == {"p0_take"}


def test_an_emptied_table_leaves_labels_where_they_are(library, takes):
    add(library, takes)
    before = labels(library)
    (takes / "p1_take.labels.csv").write_text(HEAD)
    assert codes(add(library, takes)) == [("p1_take.bvh", "blank_kept")]
    assert labels(library) == before


def make_copy(takes: Path, rows: str) -> Path:
    copy = takes.parent / "corrected"
    copy.mkdir()
    (copy / "p0_take.bvh").write_bytes((takes / "p0_take.bvh").read_bytes())
    (copy / "p0_take.labels.csv").write_text(HEAD + rows)
    return copy


def test_the_table_of_a_copy_is_told_where_the_take_has_one(library, takes):
    add(library, takes)
    before = labels(library)
    copy = make_copy(takes, "0.3,1.1,bow\n")
    report = add(library, copy)
    assert labels(library) == before and len(report.duplicates) == 1
    ((path, note),) = report.warnings
    assert (note.code, Path(path).parent.name) == ("annotations.copy_unread", "takes")
    assert f"--labels folder:{copy}" in str(note)
    # It says what helps.
    add(library, takes / "p0_take.bvh", f"folder:{copy}")
    assert labels(library)["p0_take"] == [(0.3, 1.1, "bow")]
    assert add(library, copy).warnings == ()


def test_the_table_of_a_copy_counts_where_the_take_has_none(library, takes):
    copy = make_copy(takes, "0.3,1.1,bow\n")
    (takes / "p0_take.labels.csv").unlink()
    add(library, takes)
    report = add(library, copy)
    assert [Path(path).parent.name for path in report.labelled] == ["takes"] and report.warnings == ()
    assert labels(library)["p0_take"] == [(0.3, 1.1, "bow")]
    (copy / "p0_take.labels.csv").write_text(HEAD + "0.3,1.1,wave\n")  # it stays its table
    assert codes(add(library, copy)) == [("p0_take.bvh", "removed")]
    assert labels(library)["p0_take"] == [(0.3, 1.1, "wave")]


def test_a_table_that_went_to_a_copy_counts_there(library, takes):
    add(library, takes)
    copy = make_copy(takes, "0.3,1.1,bow\n")
    (takes / "p0_take.labels.csv").unlink()
    assert codes(add(library, copy)) == [("p0_take.bvh", "removed")]
    assert labels(library)["p0_take"] == [(0.3, 1.1, "bow")]


def test_copies_in_one_go(library, takes):
    copy = make_copy(takes, "0.3,1.1,bow\n")
    report = add(library, takes.parent)
    assert len(report.duplicates) == 1 and [code for _, code in codes(report)] == ["copy_unread"]
    assert labels(library)["p0_take"] == [(0.3, 1.1, "bow")]  # the first by name
    (takes / "p0_take.labels.csv").write_text((copy / "p0_take.labels.csv").read_text())
    assert add(library, takes.parent).warnings == ()


@pytest.mark.parametrize("rule", ["csv", "folder"])
def test_one_name_for_takes_of_several_folders_is_said(library, takes, tmp_path, write_move, rule):
    tables = tmp_path / "tables"
    tables.mkdir()
    write_move(tmp_path / "more" / "p0_take.bvh", "bow", 70, n_frames=90)
    if rule == "csv":
        table = tables / "all.csv"
        table.write_text("file,start_s,end_s,category\np0_take.bvh,0,1,wave\n")
    else:
        table = tables / "p0_take.csv"
        table.write_text(HEAD + "0,1,wave\n")
    paths = [tmp_path / "more", takes / "p0_take.bvh"]
    asked = {"kind": "take", "labels_from": f"{rule}:{table if rule == 'csv' else tables}", "n_jobs": 1}
    report = library.add(paths, **asked)
    ((_, note),) = report.warnings
    assert (note.code, note.values["n"], len(report.labelled)) == ("annotations.one_name", 2, 2)
    if rule == "csv":
        table.write_text("file,start_s,end_s,category\n../takes/p0_take.bvh,0,1,wave\n../more/p0_take.bvh,1,2,bow\n")
        assert [note.code for _, note in library.add(paths, **asked).warnings] == ["annotations.removed"]


def test_the_table_of_a_file_that_is_a_clip_is_told(library, takes):
    library.add(takes / "p0_take.bvh", n_jobs=1)
    report = add(library, takes)
    assert codes(report) == [("p0_take.bvh", "of_clip")] and set(labels(library)) == {"p1_take"}
    copy = make_copy(takes, "0.3,1.1,bow\n")
    assert codes(add(library, copy)) == [("p0_take.bvh", "of_clip")]
