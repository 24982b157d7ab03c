"""dousa experiment: takes and annotated takes, as tables and as JSON, and what it refuses."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from dousa.formats import write_motion
from dousa.formats.annotations.reading import read_label_file
from dousa.formats.annotations.tables import write_labels_csv
from dousa.library import Library
from dousa.motion import CANONICAL_JOINTS, Trajectories, canonicalise, compute_trajectories
from dousa.motion.annotation import Stretch
from dousa.motion.synthetic.performers import draw_performer, make_motion
from made_clips import write_clip, write_clips


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """category/pN.bvh of three performers; one category only one of them shows."""
    made = write_clips(tmp_path_factory.mktemp("ranked"), ("walk", "squat", "clap"), 3)
    write_clip(made, "bow", 0)
    return made


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        (("--takes", "--split", "half"), "--split cannot be combined with --takes"),
        (("--system", "dtw"), "dtw"),
        (("--takes",), "performer"),
        (("--split", "thirds"), "expected half, leave-performer-out or a share"),
        (("--split", 1.5), "between 0 and 1"),
    ],
)
def test_options_that_would_be_ignored_are_refused(dousa, folder, options, problem):
    code, out, err = dousa("--jobs", 1, "experiment", folder, *options)
    assert code == 2
    assert problem in err
    assert not out


PARTS = ("squat", "jump", "squat", "clap")


@pytest.fixture(scope="session")
def session(tmp_path_factory) -> Path:
    """Takes of three people, with tables of labels beside them."""
    folder = tmp_path_factory.mktemp("session")
    for number in range(3):
        lines, parts, at = ["start_s,end_s,category"], [], 0.0
        for seed, category in enumerate(PARTS):
            motion = canonicalise(compute_trajectories(make_motion(category, draw_performer(number), seed=seed)))
            parts.append(motion.positions)
            lines.append(f"{at:.3f},{at + motion.duration:.3f},{category if seed else ''}")
            at += motion.duration
        write_motion(Trajectories(CANONICAL_JOINTS, np.concatenate(parts), 30.0), folder / f"p{number}.trc")
        (folder / f"p{number}.labels.csv").write_text("\n".join(lines))
    return folder


@pytest.mark.parametrize("features", ["paper", "extended"])
def test_the_table_says_what_was_tried_and_nothing_of_what_was_not(succeed, folder, features):
    out, _ = succeed("--jobs", 1, "experiment", folder, "--system", "forest", "--trees", 5, "--features", features)
    assert f"(half, 1 x, {features} features)" in " ".join(out.split())
    assert "relational" not in out, "no motion templates were asked for"


def test_takes_are_added_with_labels_and_listed(dousa, succeed, session, tmp_path):
    library = tmp_path / "a.dousa"
    code, out, _ = dousa("add", library, session, "--takes", "--labels", "beside")
    assert code == 0 and "3 takes labelled, 9 new segments" in out
    code, out, _ = dousa("add", library, session, "--takes", "--labels", "beside", "--json")
    assert json.loads(out)["labelled"] == []
    code, out, _ = dousa("list", library, "--category", "jump")
    assert code == 0 and out.count(".trc#t=") == 3
    code, out, _ = dousa("list", library, "--json")
    parts = [clip for clip in json.loads(out)["clips"] if clip["take_id"] is not None]
    assert len(parts) == 9 and all(clip["end_s"] > clip["start_s"] for clip in parts)
    assert dousa("train", library)[0] == 0
    number = parts[0]["id"]
    code, out, _ = dousa("search", library, number, "--json", "-k", "2")
    assert code == 0 and json.loads(out)["results"][0]["clip_id"] == number
    out, _ = succeed("remove", library, session / "p0.trc", "--json")
    code, out, _ = dousa("list", library, "--json")
    assert json.loads(out)["n_clips"] == 6


def test_a_mistake_is_one_sentence_with_file_and_line(dousa, session, tmp_path):
    folder = tmp_path / "takes"
    folder.mkdir()
    (folder / "p0.trc").write_bytes((session / "p0.trc").read_bytes())
    table = folder / "p0.labels.csv"
    library = tmp_path / "a.dousa"
    for content, said in (
        (b"start_s,end_s,category\n1,2,walk\n5,4,run\n", ":3: 'run' ends at 4, not after it begins at 5"),
        (b"start_s,end_s,category\n1,2,wa\0lk\n", ":2: zero bytes"),
        (b"start_s,end_s,category\n1,2,w\xe4lk\n", ":2: not text in UTF-8"),
        (b"a,b\n1,2\n", ":1: expected the columns start_s, end_s and category"),
        (b'start_s,end_s,category\n0,1,"walk\n1,2,sit\n', ":2: a quotation mark opens and is not closed"),
        (b"start_s,end_s,category\n0,1," + b"x" * 1001, ":2: expected a category of at most 1000 bytes"),
        (b"start_s,end_s,category\n2067,6667,walk\n", ":2: 'walk' from 2067 to 6667 s does not fit p0.trc, which ends"),
    ):
        table.write_bytes(content)
        code, _, err = dousa("add", library, folder, "--takes", "--labels", "beside")
        assert code == 2 and f"{table.name}{said}" in " ".join(err.split()) and "Traceback" not in err
        assert not library.exists()
    table.unlink()
    code, _, err = dousa("add", library, folder, "--takes", "--labels", "beside")
    assert code == 2 and "no labels of any take" in " ".join(err.split())
    code, _, err = dousa("add", library, folder, "--labels", "beside")
    assert code == 2 and "--takes" in err


def test_labels_at_the_same_time_and_what_is_unknown(dousa, session, tmp_path):
    folder = tmp_path / "takes"
    folder.mkdir()
    (folder / "p0.trc").write_bytes((session / "p0.trc").read_bytes())
    (folder / "p0.labels.csv").write_text("start_s,end_s,category\n0,2,walk\n0,2,run\n0,2,run\n2,3,unknown\n")
    library = tmp_path / "a.dousa"
    code, out, err = dousa("add", library, folder, "--takes", "--labels", "beside")
    said = " ".join(err.split())
    assert code == 0 and "1 take labelled, 2 new segments" in out
    assert "labels.csv:4: 1 label is there twice and counts once" in said
    assert "labels.csv:5: 1 label such as 'unknown' read as no category" in said
    _, out, _ = dousa("list", library, "--json")
    parts = {clip["category"]: clip["path"].partition("#t=")[2] for clip in json.loads(out)["clips"] if clip["take_id"]}
    assert parts == {"walk": "0.000,2.000", "run": "0.000,2.000&id=2"}
    (folder / "p0.labels.csv").write_text("start_s,end_s,category\n")
    code, _, err = dousa("add", library, folder, "--takes", "--labels", "beside")
    assert code == 0 and "the take keeps its 2 segments" in " ".join(err.split())
    (folder / "p0.labels.csv").write_text("start_s,end_s,category\n0,2,walk\n")
    code, _, err = dousa("add", library, folder, "--takes", "--labels", "beside")
    assert code == 0 and "1 earlier segment removed" in " ".join(err.split())


def test_the_trial_of_annotated_takes(dousa, succeed, session):
    rule = r"name:(p\d)"
    words = ("--takes", "--labels", "beside", "--performer-from", rule, "--split", "leave-performer-out")
    out, _ = succeed("experiment", session, *words, "--trees", "10", "--json")
    answer = json.loads(out)
    assert set(answer["by_performer"]["dousa"]) == {"p0", "p1", "p2"}
    assert 0 <= answer["scores"]["dousa"]["annotated_right"] <= 1
    for wrong in (("--split", "half"), ("--system", "dtw"), ("--category-from", "none")):
        code, _, err = dousa("experiment", session, *words[:5], *wrong)
        assert code == 2 and wrong[0] in err
    code, _, err = dousa("experiment", session, "--takes", "--labels", "beside")
    assert code == 2 and "--performer-from" in err
    code, _, err = dousa("experiment", session, "--labels", "beside")
    assert code == 2 and "--takes" in err


def test_the_trial_says_what_is_doubtful_in_tables(dousa, session, tmp_path):
    folder = shutil.copytree(session, tmp_path / "own")
    table = folder / "p1.labels.csv"
    table.write_text(table.read_text() + "\n0.5,900,walk")
    code, _, err = dousa(
        "experiment", folder, "--takes", "--labels", "beside", "--performer-from", r"name:(p\d)", "--trees", 5
    )
    said = " ".join(err.split())
    assert code == 0, err
    assert "p1.labels.csv:" in said and "p1.trc: " in said and "beyond" in said, err


def test_given_labels_are_given_back(dousa, session, tmp_path):
    library, take = tmp_path / "a.dousa", session / "p1.trc"
    assert dousa("add", library, session, "--takes", "--labels", "beside")[0] == 0
    with Library.open(library, read_only=True) as opened:
        (before,) = (one for one in opened.annotations.read() if one.path == str(take))
    named = [(round(one.start, 3), round(one.end, 3), one.category) for one in before.segments]
    code, out, _ = dousa("label", library, take, "--given", "--csv", tmp_path / "p1.csv")
    assert code == 0 and [row.split()[-1] for row in out.splitlines()[2:6]] == ["-", "jump", "squat", "clap"]
    code, out, _ = dousa("label", library, before.take_id, "--given", "--json", "--csv", tmp_path / "p1.eaf")
    assert code == 0 and [part["category"] for part in json.loads(out)["segments"]] == ["jump", "squat", "clap"]
    for name in ("p1.csv", "p1.eaf"):
        (tier,) = read_label_file(tmp_path / name).takes[""]
        assert [(one.start, one.stop, one.category) for one in tier.spans] == named and not tier.unclear
    code, _, err = dousa("label", library, take, "--given", "--csv", tmp_path / "p1.csv")
    assert code == 2 and "remove it first" in err


def test_what_nobody_can_say_is_written_as_that(tmp_path):
    write_labels_csv([Stretch(0, 1, "walk"), Stretch(1, 2, None, counted=False)], tmp_path / "a.csv")
    (tier,) = read_label_file(tmp_path / "a.csv").takes[""]
    assert [one.category for one in tier.spans] == ["walk"] and tier.unclear == ((1.0, 2.0),)


def test_labels_that_nobody_gave(dousa, session, tmp_path):
    library = tmp_path / "a.dousa"
    assert dousa("add", library, session, "--takes")[0] == 0
    for words, said in (
        ((session / "p0.trc", "--given"), "nobody has given this take labels"),
        ((session / "p0.trc", "--given", "--threshold", 0), "--given shows labels as they are"),
        (("-", "--given"), "frames on standard input"),
    ):
        code, out, err = dousa("label", library, *words)
        assert (code, out) == (2, "") and said in err and err.count("\n") == 1, err
