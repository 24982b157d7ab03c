"""Takes with tables of labels beside them: ``Library.add(..., kind="take", labels_from=...)``."""

from __future__ import annotations

from pathlib import Path

import pytest

from dousa.errors import MotionFileError, OptionError
from dousa.formats.annotations.writing import format_labels_csv
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
