"""The command line as a person uses it: answers, JSON, errors with exit code 2 and no traceback."""

import importlib
import json
import os
import re
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

import dousa
from dousa.app.stops import hear_stops
from dousa.formats.registry import read_motion, write_motion
from dousa.messages import Message
from dousa.motion.synthetic.performers import draw_performer, make_motion
from made_clips import write_clips
from patience import PATIENCE

CATEGORIES = ("walk", "squat", "clap", "bow")
PERFORMERS = 4


def run_command(*words, stdout=subprocess.PIPE, **environment):
    """Runs a command in a process of its own."""
    code = "from dousa.app.cli.main import main; main()"
    return subprocess.run(
        [sys.executable, "-c", code, *map(str, words)],
        stdout=stdout,
        stderr=subprocess.PIPE,
        encoding="latin-1",
        env={**os.environ, **environment},
        check=False,
    )


@pytest.fixture(scope="session")
def motions(tmp_path_factory) -> Path:
    """A folder of BVH files: category/pN.bvh."""
    return write_clips(tmp_path_factory.mktemp("motions"), CATEGORIES, PERFORMERS)


@pytest.fixture(scope="session")
def trained(motions, tmp_path_factory) -> Path:
    """A trained library of those motions."""
    from dousa.library import Library

    path = tmp_path_factory.mktemp("library") / "moves.dousa"
    with Library.open(path, create=True) as library:
        library.add(motions, performer_from=r"name:(p\d)")
        library.train(random_state=1)
    return path


@pytest.fixture
def library(trained, tmp_path) -> Path:
    """A copy of the trained library, free to change."""
    return Path(shutil.copy(trained, tmp_path / "moves.dousa"))


def test_help_names_every_command_and_gives_examples(succeed):
    out, _ = succeed("--help")
    words = (
        "info count convert plot add train search classify find label list remove relabel tag undo check compact demo"
    )
    words += " experiment"
    for command in words.split():
        assert command in out
        text, _ = succeed(command, "--help")
        assert re.search(rf"Example:\s+dousa {command}", text)


def test_help_says_all_of_it_in_whole_lines(dousa, monkeypatch):
    """Square brackets are no style, and lines are as long as the terminal, not as those of the source."""
    monkeypatch.setenv("COLUMNS", "100")
    text = dousa("label", "--help")[1]
    assert '{"time": s, "joints": {"left_hand": [x, y, z], ...}} in m with Y' in text
    assert "more likely right than wrong if" in text


def test_info_shows_unit_axis_and_mapping(succeed, motions):
    out, _ = succeed("info", motions / "walk/p0.bvh")
    for word in ("bvh", "0.01 m (inferred)", "up", "left/right", "agree", "height"):
        assert word in out


def test_info_json_goes_on_after_a_bad_file(dousa, motions, tmp_path):
    bad = tmp_path / "bad.bvh"
    bad.write_text("HIERARCHY\nROOT hips\n{\n")
    code, out, err = dousa("info", "--json", bad, motions / "walk/p0.bvh")
    assert code == 2
    assert str(bad) in err and "Traceback" not in err
    (answer,) = json.loads(out)
    assert answer["format"] == "bvh"
    assert answer["unit_m"] == 0.01 and answer["up"] == "y"
    assert answer["mapping"]["sides"] == "agree"


def test_repetitions_are_counted_without_a_library_or_a_reference(dousa, tmp_path):
    from dousa.motion.synthetic import Performer, make_motion

    write_motion(make_motion("squat", Performer(), 0), tmp_path / "squats.bvh")
    code, out, err = dousa("count", "--json", tmp_path / "squats.bvh", tmp_path / "none.bvh")
    assert code == 2 and "none.bvh" in err
    (answer,) = json.loads(out)
    assert (answer["count"], answer["certainty"], len(answer["repetitions"])) == (2, 1.0, 2)
    for language, says in (("en", "2 repetitions in 4.5 s"), ("ja", "4.5 秒間に 2 回")):
        code, out, _ = dousa("--lang", language, "count", tmp_path / "squats.bvh")
        assert code == 0 and says in out and "0:00.5-0:02.1" in out


def test_info_of_joints_nobody_knows_names_them(succeed, tmp_path):
    from dousa.motion import Trajectories

    path = tmp_path / "dots.trc"
    write_motion(Trajectories(("foo", "bar"), np.zeros((5, 2, 3)), 30), path)
    out, _ = succeed("info", path)
    assert "not understood" in out and "foo, bar" in out


def test_convert_says_when_nothing_is_seen(dousa, motions, tmp_path):
    """A root that is nowhere in all frames: nothing of the body is anywhere, and no silence about it."""
    head, _, rows = (motions / "bow/p0.bvh").read_text().partition("Frame Time")
    first, *values = rows.splitlines()
    lost = "\n".join([f"{head}Frame Time{first}", *(f"nan {row.split(' ', 1)[1]}" for row in values if row.strip())])
    (tmp_path / "lost.bvh").write_text(lost + "\n")
    code, _, err = dousa("convert", tmp_path / "lost.bvh", tmp_path / "out.bvh")
    assert code == 0 and "no frame shows where any joint is" in err


def test_convert_keeps_a_bvh_and_resamples(dousa, succeed, motions, tmp_path):
    source, copy, slow = motions / "clap/p1.bvh", tmp_path / "copy.bvh", tmp_path / "slow.bvh"
    assert dousa("convert", source, copy)[0] == 0
    first, second = read_motion(source), read_motion(copy)
    assert np.array_equal(first.provenance.values, second.provenance.values)
    out, _ = succeed("convert", source, slow, "--frame-rate", 10, "--json")
    assert json.loads(out)["frame_rate"] == 10
    assert abs(read_motion(slow).duration - first.duration) < 0.2


@pytest.mark.parametrize("suffix", [".trc", ".c3d", ".npz"])
def test_convert_to_positions_and_back(dousa, succeed, motions, tmp_path, suffix):
    middle, back = tmp_path / f"a{suffix}", tmp_path / "a.bvh"
    assert dousa("convert", motions / "bow/p0.bvh", middle)[0] == 0
    _, err = succeed("convert", middle, back)
    assert read_motion(back).n_frames == read_motion(motions / "bow/p0.bvh").n_frames
    assert suffix == ".npz" or "mean joint error" in err


def test_convert_to_smpl_says_what_it_costs(dousa, motions, tmp_path):
    target = tmp_path / "a.amass.npz"
    code, out, err = dousa("convert", motions / "bow/p0.bvh", target, "--json")
    assert code == 0 and "mean SMPL body" in err
    assert 0 < json.loads(out)["direction_error_deg"] < 3
    assert "SMPL body" not in dousa("convert", target, tmp_path / "b.amass.npz")[2]


def test_joint_angles_are_a_table_of_their_own(dousa, motions, tmp_path):
    source = motions / "bow/p0.bvh"
    code, _, err = dousa("convert", source, tmp_path / "a.csv")
    assert code == 0 and "joint angles in degrees go into a name that ends in .angles.csv" in err
    for _ in range(2):  # what is there may be written again
        code, _, err = dousa("convert", source, tmp_path / "a.angles.csv")
        assert (code, err) == (0, "")
    assert (tmp_path / "a.angles.csv").read_text().startswith("time_s,pelvis_tilt,")


def test_convert_refuses_and_leaves_nothing(dousa, motions, tmp_path):
    source = motions / "walk/p0.bvh"
    for target, options in (("a.fbx", ()), ("a.bvh", ("--frame-rate", "0")), ("no/folder/a.bvh", ())):
        code, _, err = dousa("convert", source, tmp_path / target, *options)
        assert code == 2 and err.startswith("dousa: ") and "Traceback" not in err
    assert list(tmp_path.iterdir()) == []


def test_plot_writes_a_picture(dousa, motions, tmp_path):
    picture = tmp_path / "sheet.png"
    assert dousa("plot", motions / "squat/p0.bvh", "-o", picture)[0] == 0
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    "words",
    [
        ("{tmp}/nowhere",),
        ("{dir}", "--category-from", "mood"),
        ("{dir}", "--read", "unit=furlong"),
        ("{tmp}/damaged",),
    ],
)
def test_a_mistaken_add_leaves_no_library(dousa, motions, tmp_path, words):
    damaged = tmp_path / "damaged"
    damaged.mkdir()
    (damaged / "walk.bvh").write_text("hello")
    places = {"tmp": tmp_path, "dir": motions}
    code, out, err = dousa("add", tmp_path / "new.dousa", *(word.format(**places) for word in words))
    assert code == 2 and (err or "1 skipped" in out)
    assert list(tmp_path.iterdir()) == [damaged]


def test_training_tells_people_for_categories(dousa, succeed, motions, tmp_path):
    library, people = tmp_path / "moves.dousa", r"name:(p\d)"
    succeed("add", library, motions, "--category-from", people, "--performer-from", people)
    code, _, err = dousa("train", library, "--trees", 5)
    assert code == 0 and "no category is done by two people" in " ".join(err.split())


def test_add_train_search_classify(dousa, succeed, motions, tmp_path):
    library = tmp_path / "moves.dousa"
    out, _ = succeed("add", library, motions, "--performer-from", r"name:(p\d)", "--json")
    assert len(json.loads(out)["added"]) == len(CATEGORIES) * PERFORMERS
    code, out, _ = dousa("add", library, motions, "--json")
    again = json.loads(out)
    assert code == 0
    assert again["added"] == [] and len(again["unchanged"]) == len(CATEGORIES) * PERFORMERS
    assert dousa("train", library)[0] == 0
    query = tmp_path / "query.bvh"
    write_motion(make_motion("squat", draw_performer(99), seed=99), query)
    out, _ = succeed("search", library, query, "-k", 3, "--json")
    answer = json.loads(out)
    keys = set("query category histogram guess known confidence perhaps ranking alike_count results".split())
    assert set(answer) == keys
    assert answer["category"] == "squat"
    assert abs(sum(answer["histogram"].values()) - 1) < 1e-9
    assert [hit["rank"] for hit in answer["results"]] == [1, 2, 3]
    keys = {"path", "category", "distance", "rank"}
    assert all(keys < set(hit) for hit in answer["results"])
    distances = [hit["rank_distance"] for hit in answer["results"]]
    assert distances == sorted(distances)
    out, _ = succeed("classify", library, query, "--json")
    assert json.loads(out)[0]["category"] == "squat"


def test_search_by_number_with_picture(succeed, library, tmp_path):
    picture = tmp_path / "hits.png"
    out, _ = succeed("search", library, 1, "-k", 2, "--picture", picture)
    assert "rank" in out
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_check_names_what_is_damaged_and_repairs_it(dousa, library):
    code, out, _ = dousa("check", library)
    assert (code, "the library is sound" in out) == (0, True)
    with closing(sqlite3.connect(library)) as connection, connection:
        connection.execute("UPDATE clip_trajectories SET positions = zeroblob(length(positions)) WHERE clip_id = 1")
        (path,) = connection.execute("SELECT path FROM clips WHERE id = 1").fetchone()
    code, out, _ = dousa("check", library)
    assert (code, f"{path} (number 1): positions: its file is there and unchanged" in out) == (2, True)
    code, out, _ = dousa("check", library, "--repair", "--json")
    answer = json.loads(out)
    assert (code, answer["sound"], [one["path"] for one in answer["damage"]]) == (0, True, [path])
    assert dousa("check", library)[0] == 0


def test_nothing_that_a_terminal_obeys_reaches_the_screen(dousa, succeed, motions, tmp_path):
    path = tmp_path / "esc.bvh"
    path.write_text((motions / "walk/p0.bvh").read_text().replace("spine", "sp\x9b31mine"), encoding="utf-8")
    out, _ = succeed("info", path, "--json")
    assert "\x9b" not in out
    assert any("\x9b31mine" in name for name in json.loads(out)[0]["joints"])
    library = tmp_path / "l.dousa"
    assert dousa("add", library, motions / "walk")[0] == 0
    assert dousa("relabel", library, "1", "--category", "x\x1b[31m\ny")[0] == 0
    for words in (("list", library), ("list", library, "--clips"), ("info", path), ("add", library, path)):
        out, err = succeed(*words)
        assert not {"\x1b", "\x9b", "\x07"} & set(out + err)


def test_compact(dousa, library):
    assert dousa("remove", library, "--category", "walk")[0] == 0
    code, out, _ = dousa("compact", library)
    assert (code, "MB now" in out) == (0, True)
    code, out, _ = dousa("compact", library, "--fragments", "beside")
    assert (code, "features moved to fragments (1)" in out) == (0, True)
    assert dousa("compact", library, "--fragments", library.parent)[0] == 2


def test_list_relabel_remove(dousa, succeed, library, motions):
    out, _ = succeed("list", library)
    assert "16 clips" in out and "walk" in out
    out, _ = succeed("relabel", library, motions / "walk/p0.bvh", "--category", "stroll", "--json")
    assert len(json.loads(out)["relabelled"]) == 1
    clips = json.loads(dousa("list", library, "--category", "stroll", "--json")[1])["clips"]
    assert [clip["path"] for clip in clips] == [str(motions / "walk/p0.bvh")]
    out, _ = succeed("remove", library, clips[0]["id"], "--json")
    assert json.loads(out)["removed"] == [str(motions / "walk/p0.bvh")]
    assert "changed since" in dousa("list", library)[1]


def test_experiment_prints_the_four_systems(succeed, motions):
    out, _ = succeed("experiment", motions, "--repeats", 2, "--trees", 20, "--json")
    answer = json.loads(out)
    assert set(answer["systems"]) == {"full_tree", "random_tree", "forest", "motion_templates"}
    for scores in answer["systems"].values():
        assert {"recall", "precision", "f_measure", "accuracy"} <= set(scores)
    assert (answer["n_train"], answer["n_test"]) == (8, 8)
    assert answer["categories"] == sorted(CATEGORIES)
    out, _ = succeed(
        "experiment", motions, "--split", "leave-performer-out", "--performer-from", r"name:(p\d)", "--trees", 5
    )
    assert "single full tree" in out and "motion templates" in out


def test_experiment_says_what_came_up_when_files_were_read(dousa, succeed, motions, tmp_path):
    folder = shutil.copytree(motions, tmp_path / "cut")
    for name in ("walk/p0.bvh", "walk/p1.bvh"):
        text = (folder / name).read_text()
        (folder / name).write_text(text[: int(len(text) * (0.8 if "p0" in name else 0.85))])
    words = ("experiment", folder, "--system", "forest", "--trees", "5")
    _, err = succeed(*words)
    said = " ".join(err.split())
    assert "walk/p0.bvh: " in said and "walk/p1.bvh: " in said and said.count("truncated") == 2, err
    code, out, err = dousa("--lang", "ja", *words, "--json")
    assert code == 0 and "truncated" not in err
    notes = json.loads(out)["notes"]
    assert [Path(one["path"]).name for one in notes] == ["p0.bvh", "p1.bvh"]
    assert all("途中で切れ" in one["note"] for one in notes), notes


def test_experiment_with_given_test_folder(succeed, motions, tmp_path):
    shutil.copytree(motions, tmp_path / "copy")
    words = ("--features", "extended", "--json")
    out, _ = succeed("experiment", motions, "--test", tmp_path / "copy", *words)
    assert json.loads(out)["systems"]["full_tree"]["accuracy"] == 1.0  # it knows them all by heart


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("search", "{tmp}/none.dousa", "{bvh}"), "no library at"),
        (("train", "{bvh}"), "not a dousa library"),
        (("search", "{lib}", "{tmp}/none.bvh"), "no such file"),
        (("add", "{lib}", "{tmp}/none"), "no such file"),
        (("add", "{lib}", "{bvh}", "--category-from", "name:("), "regular expression"),
        (("add", "{lib}", "{bvh}", "--category-from", "mood"), "folder"),
        (("relabel", "{lib}", "1"), "--category"),
        (("remove", "{lib}"), "nothing"),
        (("remove", "{lib}", "999"), "999"),
        (("experiment", "{tmp}"), "no motion with a category"),
        (("experiment", "{dir}", "--split", "leave-performer-out"), "--performer-from"),
        (("experiment", "{dir}", "--test", "{dir}", "--split", "half"), "--test"),
        (("plot", "{bvh}", "-o", "{tmp}/a.xyz"), ".png"),
        (("info", "{tmp}"), "this is a folder"),
        (("search", "{lib}", "²"), "no suffix"),
        (("--jobs", "0", "train", "{lib}"), "--jobs"),
        (("train", "{lib}", "-j", "2"), "before them"),
        (("experiment", "{dir}", "--test", "{dir}"), "would also train"),
        (("info", "{bvh}", "--read", "unit=furlong"), "furlong"),
        (("info", "{bvh}", "--read", "up=w"), "w"),
        (("info", "{bvh}", "--read", "joint_map={tmp}/no.toml"), "no.toml"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(dousa, library, motions, tmp_path, words, says):
    empty = tmp_path / "empty"
    empty.mkdir()
    places = {"tmp": empty, "bvh": motions / "walk/p0.bvh", "lib": library, "dir": motions}
    code, out, err = dousa(*(word.format(**places) for word in words))
    assert code == 2
    assert says in err + out
    assert "Traceback" not in err
    assert list(empty.iterdir()) == []


def test_names_with_brackets_and_line_ends_are_shown_as_they_are(dousa, succeed, motions, tmp_path):
    folder = tmp_path / "[bold]a[" / "["
    shutil.copytree(motions, folder)
    (folder / "walk" / "p0.bvh").rename(folder / "walk" / "p\n0.bvh")
    lib = tmp_path / "a.dousa"
    assert dousa("add", lib, tmp_path / "[bold]a[")[0] == 0
    assert dousa("relabel", lib, "--where-category", "[/walk", "--category", "[/walk]")[0] == 0
    assert dousa("train", lib, "--trees", 5)[0] == 0
    query = folder / "walk" / "p\n0.bvh"
    out, _ = succeed("search", lib, query, "-k", 1)
    assert "[/walk], " in out and "p\\n0.bvh" in out and "[bold]a[" in out
    for command in ("list", "classify"):
        words = (query,) if command == "classify" else ("--clips",)
        code, out, _ = dousa(command, lib, *words)
        assert code == 0 and "[/walk]" in out and "p\\n0.bvh" in out
    query.write_text("")
    code, _, err = dousa("info", query)
    assert code == 2 and len(err.splitlines()) == 1 and "p\\n0.bvh: the file is empty" in err


def test_nothing_found_is_told(dousa, library, tmp_path, motions):
    for command in ("add", "classify"):
        code, _, err = dousa(command, library, tmp_path)
        assert code == 0 and "no motion files" in err
    assert dousa("remove", library, motions)[0] == 0
    code, _, err = dousa("search", library, motions / "walk/p0.bvh")
    assert code == 0 and "no clip found" in err


@pytest.mark.parametrize("encoding", ["ascii", pytest.param("latin-1", marks=pytest.mark.slow)])
def test_a_terminal_of_few_characters_shows_codes(motions, tmp_path, encoding):
    path = shutil.copy(motions / "walk/p0.bvh", tmp_path / "歩く é.bvh")
    for words in (("--help",), ("info", path), ("info", path, "--json"), ("info", f"{path}x")):
        done = run_command(*words, PYTHONIOENCODING=encoding)
        assert "Traceback" not in done.stderr
        assert done.returncode == (2 if words[-1] == f"{path}x" else 0)
        if "--json" in words:
            assert json.loads(done.stdout)[0]["path"] == str(path)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
@pytest.mark.parametrize("words", [("info", "--json"), pytest.param(("info",), marks=pytest.mark.slow)])
def test_an_output_that_cannot_be_written_is_one_line(motions, words):
    with open("/dev/full", "w") as full:
        done = run_command(*words, motions / "walk/p0.bvh", stdout=full)
    assert done.returncode == 2
    assert done.stderr.splitlines() == ["dousa: the answer cannot be written: the disk is full"]


@pytest.mark.parametrize("is_dropped", [False, True])
@pytest.mark.parametrize(("number", "expected"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_stop_is_a_word_not_a_traceback(dousa, trained, tmp_path, monkeypatch, number, expected, is_dropped):
    from dousa.library import export

    class Deleted:
        def __del__(self):
            signal.raise_signal(number)

    def stop(path):
        if not is_dropped:
            signal.raise_signal(number)
        Deleted()  # Python drops what is raised there
        for _ in range(100):
            time.sleep(PATIENCE / 100)

    monkeypatch.setattr(export, "read_bytes", stop)
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a run in the background ignores it
    code, _, err = dousa("export", trained, "-o", tmp_path / "out.zip")
    assert code == expected
    assert "interrupted" in err and "Traceback" not in err
    assert not list(tmp_path.rglob("*.part")) and not (tmp_path / "out.zip").exists()
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


@pytest.mark.parametrize(
    ("words", "place"),
    [
        (("train", "moves.dousa"), "dousa.retrieval.MotionForest.fit"),
        (("find", "moves.dousa", "walk/p0.bvh", "squat/p1.bvh"), "dousa.library.takes.takes.judge_places"),
        (("-j", "2", "add", "moves.dousa", "more"), "dousa.library.store.ingest.read_with"),
    ],
)
def test_a_stop_of_long_work_loses_nothing(dousa, succeed, library, motions, monkeypatch, words, place):
    write_clips(library.parent / "more", ("wave_left",), 3)
    for folder in ("walk", "squat"):
        shutil.copytree(motions / folder, library.parent / folder)
    monkeypatch.chdir(library.parent)
    before = json.loads(succeed("list", "--json", library)[0])
    with monkeypatch.context() as patch:
        patch.setattr(place, lambda *given, **options: signal.raise_signal(signal.SIGTERM))
        code, _, err = dousa(*words)
    assert (code, err.strip().splitlines()[-1]) == (143, f"dousa: {Message('cli.interrupted')}")
    assert "Traceback" not in err
    succeed("check", library)
    assert json.loads(succeed("list", "--json", library)[0]) == before
    assert "3 added" in succeed("add", library, "more")[0]


def test_a_stop_waits_while_a_module_loads(tmp_path, monkeypatch):
    (tmp_path / "half_a_module.py").write_text("import signal\nsignal.raise_signal(signal.SIGTERM)\nis_whole = True\n")
    monkeypatch.syspath_prepend(tmp_path)
    with hear_stops() as came, pytest.raises(KeyboardInterrupt):
        assert importlib.import_module("half_a_module").is_whole
        for _ in range(100):
            time.sleep(PATIENCE / 100)
    assert came == [signal.SIGTERM]
    monkeypatch.delitem(sys.modules, "half_a_module")


def test_check_of_a_file_that_cannot_be_read_sends_nobody_to_itself(dousa, trained, tmp_path):
    path = tmp_path / "cut.dousa"
    data = trained.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    assert f"see what is lost with: dousa check {path}" in dousa("list", path)[2]
    for more in ((), ("--repair",)):
        code, out, err = dousa("check", path, *more)
        assert (code, out) == (2, "") and "nothing of it can be read" in err and "dousa check" not in err


def run(*arguments):
    command = [sys.executable, "-m", "dousa", *arguments]
    return subprocess.run(command, check=False, capture_output=True, text=True, timeout=PATIENCE)


def test_the_package_is_the_command_line():
    said = run("--version")
    assert (said.returncode, said.stdout) == (0, f"dousa {dousa.__version__}\n")
    failed = run("info", "none.bvh")
    assert failed.returncode == 2
    assert "none.bvh" in failed.stderr and "Traceback" not in failed.stderr
