"""The commands about uncut recordings, unknown motions, orders, reasons and mirror images."""

import io
import json
import shutil
import sys
from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from dousa.app.requests.library import FeatureSet, Ranking
from dousa.formats.registry import read_motion, write_motion
from dousa.library import Library
from dousa.motion import CANONICAL_JOINTS, Trajectories, canonicalise, compute_trajectories
from dousa.motion.synthetic.performers import draw_performer, make_motion
from dousa.retrieval import DEFAULT_FEATURE_SET, FEATURE_SETS
from dousa.retrieval.ranking.ranking import DEFAULT_RANKING, RANKINGS
from made_clips import write_clip, write_clips

KNOWN = ("walk", "squat", "clap", "jump", "kick_left")


@pytest.fixture(scope="session")
def recordings(tmp_path_factory) -> Path:
    """``clips`` of five categories by four performers, and ``take.trc``: a squat and a jump by a fifth."""
    root = tmp_path_factory.mktemp("recordings")
    write_clips(root / "clips", KNOWN, 4)
    parts = [
        canonicalise(compute_trajectories(make_motion(category, draw_performer(7), seed=7))).positions
        for category in ("squat", "jump")
    ]
    write_motion(Trajectories(CANONICAL_JOINTS, np.concatenate(parts), 30.0), root / "take.trc")
    return root


@pytest.fixture(scope="session")
def trained(recordings, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("trained") / "moves.dousa"
    with Library.open(path, create=True) as library:
        library.add(recordings / "clips", performer_from=r"name:(p\d)")
        library.train(n_trees=40)
        library.add(recordings / "take.trc", kind="take")
    return path


@pytest.fixture
def library(trained, tmp_path) -> Path:
    return Path(shutil.copy(trained, tmp_path / "moves.dousa"))


def test_the_choices_of_the_commands_are_those_of_the_package():
    assert list(get_args(FeatureSet)) == list(FEATURE_SETS)
    assert sorted(get_args(Ranking)) == sorted(RANKINGS)
    assert get_args(Ranking)[0] == DEFAULT_RANKING
    assert DEFAULT_FEATURE_SET == "extended"  # so says dousa train --help


def test_takes_are_added_and_listed(dousa, recordings, tmp_path):
    library = tmp_path / "new.dousa"
    assert dousa("add", library, recordings / "take.trc", "--takes")[0] == 0
    code, _, err = dousa("add", library, recordings / "take.trc")
    assert code == 0 and "1 file remains clip or take as before" in err and "dousa remove" in err
    code, out, _ = dousa("list", library)
    assert code == 0 and "0 clips, 0.0 minutes, 1 take, 0.1 minutes" in out
    code, out, _ = dousa("list", library, "--clips")
    assert code == 0 and "take" in out
    assert [clip["kind"] for clip in json.loads(dousa("list", library, "--json")[1])["clips"]] == ["take"]


def test_train_says_what_will_be_unknown(dousa, library):
    code, out, _ = dousa("train", library, "--trees", 20)
    assert code == 0 and "are called unknown, of others" in out
    code, out, _ = dousa("train", library, "--trees", 20, "--features", "paper", "--json")
    answer = json.loads(out)
    assert (answer["feature_set"], answer["n_clips"]) == ("paper", 20)
    assert 0.5 <= answer["calibration"]["auroc"] <= 1
    assert "features 'paper'" in dousa("list", library)[1]


def test_add_says_what_the_forest_learned(dousa, succeed, library, tmp_path):
    for number in range(3):
        write_clip(tmp_path / "new", "bow", number)
    out, _ = succeed("add", library, tmp_path / "new")
    assert "the forest learned 3 clips and 1 new category; dousa train makes a new one" in out
    assert "learned 3 clips since" in dousa("list", library)[1]
    answer = json.loads(dousa("add", library, write_clip(tmp_path / "more", "bow", 5).parents[1], "--json")[1])
    assert (answer["n_learned"], answer["new_categories"]) == (1, [])


def test_unknown_motions(dousa, succeed, library, tmp_path):
    stranger, friend = write_clip(tmp_path, "bow", 9), write_clip(tmp_path, "squat", 9)
    out, _ = succeed("classify", library, stranger, friend)
    first, second = out.splitlines()
    assert f"{stranger}: unknown (most like " in first and "likely right" in first
    assert second.startswith(f"{friend}: squat, ") and "% sure (votes: squat " in second
    answer = json.loads(dousa("search", library, stranger, "--json")[1])
    assert answer["category"] is None and answer["guess"] in KNOWN and answer["known"] < 0.5
    answer = json.loads(dousa("classify", library, stranger, "--json", "--threshold", 0)[1])[0]
    assert answer["category"] == answer["guess"]
    code, out, _ = dousa("search", library, stranger, "-k", 2, "--picture", tmp_path / "a.png")
    assert code == 0 and "unknown (most like" in out
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("rank", RANKINGS)
def test_ranks(dousa, library, tmp_path, rank):
    answer = json.loads(dousa("search", library, write_clip(tmp_path, "squat", 9), "--rank", rank, "--json")[1])
    assert answer["ranking"] == rank
    assert [hit["category"] for hit in answer["results"][:3]] == ["squat"] * 3


def test_reasons(dousa, library, tmp_path):
    query = write_clip(tmp_path, "squat", 9)
    for words in (("search", library, query, "-k", 2), ("classify", library, query)):
        code, out, _ = dousa(*words, "--explain")
        assert code == 0 and " from " in out and " s: " in out
        answer = json.loads(dousa(*words, "--explain", "--json")[1])
        told = answer if words[0] == "search" else answer[0]
        assert all(reason["vote_without"] < reason["vote_before"] for reason in told["explanation"]["reasons"])


def test_the_other_side(dousa, succeed, library, tmp_path):
    kick = write_clip(tmp_path, "kick_right", 9)
    out, _ = succeed("search", library, kick, "-k", 3, "--mirror")
    assert "mirrored: kick_left" in out and "which fits better" in out
    assert out.count("mirrored") == 4
    (answer,) = json.loads(dousa("classify", library, kick, "--mirror", "--json")[1])
    assert answer["mirrored"]["category"] == "kick_left" and answer["mirrored"]["fits_better"]
    out, _ = succeed("find", library, kick, recordings_of(library), "--mirror")


def recordings_of(library: Path) -> str:
    with Library.open(library) as opened:
        return next(clip.path for clip in opened.clips() if clip.kind == "take")


def test_find(dousa, succeed, library, recordings, tmp_path):
    query = write_clip(tmp_path, "squat", 9)
    out, _ = succeed("find", library, query, "-k", 2)
    assert "in 1 take, 0.1 minutes:" in out and str(recordings / "take.trc") in out
    answer = json.loads(dousa("find", library, query, "-k", 2, "--json")[1])
    assert {"query", "results", "skipped", "n_takes"} <= set(answer)
    best = answer["results"][0]
    assert {"take", "start_s", "end_s", "score", "rank", "mirrored", "tempo"} <= set(best)
    squat = make_motion("squat", draw_performer(7), seed=7).duration
    assert best["start_s"] < squat / 2 and best["end_s"] < squat + 1
    given = json.loads(dousa("find", library, query, recordings / "take.trc", "-k", 2, "--json")[1])
    assert given["results"] == answer["results"]


def test_find_goes_on_after_a_bad_file(dousa, library, recordings, tmp_path):
    bad = tmp_path / "bad.bvh"
    bad.write_text("")
    code, out, err = dousa("find", library, 1, recordings / "take.trc", bad)
    assert code == 0 and "take.trc" in out
    assert f"left out {bad}" in err
    code, _, err = dousa("find", library, 1, bad, "--json")
    assert code == 2 and f"left out {bad}" in err


def test_label_with_table_and_picture(dousa, library, recordings, tmp_path):
    table, picture = tmp_path / "t.csv", tmp_path / "t.png"
    take = recordings / "take.trc"
    code, out, _ = dousa("label", library, take, "--csv", table, "--picture", picture)
    assert code == 0 and "start" in out and "sure" in out
    assert [line.partition(": ")[2] for line in out.splitlines()[-2:]] == [str(table), str(picture)]
    lines = table.read_text().splitlines()
    assert lines[0] == "start_s,end_s,category,confidence,repetitions,perhaps"
    assert picture.read_bytes().startswith(b"\x89PNG")
    answer = json.loads(dousa("label", library, take, "--json")[1])
    assert len(answer["segments"]) == len(lines) - 1
    assert {"start_s", "end_s", "category", "confidence", "unknown"} <= set(answer["segments"][0])
    assert answer["take"] == str(take)
    copy = shutil.copy(take, tmp_path / "copy.trc")
    again = json.loads(dousa("label", library, copy, "--json", "--picture", tmp_path / "c.svg")[1])
    assert [one["category"] for one in again["segments"]] == [one["category"] for one in answer["segments"]]
    assert all(
        one["unknown"] for one in json.loads(dousa("label", library, take, "--threshold", 1, "--json")[1])["segments"]
    )


def frames(recordings: Path) -> str:
    motion = read_motion(recordings / "take.trc")
    lines = [json.dumps({"height": 1.7, "frame_rate": motion.frame_rate})]
    return "\n".join([*lines, *(json.dumps({"positions": pose.tolist()}) for pose in motion.positions), ""])


def pipe(monkeypatch, text: str | bytes) -> None:
    data = text if isinstance(text, bytes) else text.encode()
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(data)))


def test_live_frames_are_answered_line_by_line(succeed, library, recordings, monkeypatch):
    pipe(monkeypatch, frames(recordings))
    out, _ = succeed("label", library, "-")
    answers = [json.loads(line) for line in out.splitlines()]
    times = [answer["time_s"] for answer in answers]
    assert times == sorted(times)
    assert max(np.diff(times[:-1])) < 0.21
    settled = [segment for answer in answers for segment in answer["settled"]]
    assert settled[0]["start_s"] == 0
    assert settled[-1]["end_s"] == pytest.approx(times[-1])
    assert {segment["category"] for segment in settled} & set(KNOWN)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("nonsense\n", "line 1: expected one JSON object"),
        (b"\xff\xfe\n", "line 1: expected one JSON object"),
        ('{"positions": [[0, 0, 0]], "time": 0}\n', "line 1: expected 'positions' of 20 joints, got 1"),
        ('{"joints": {"tail": [0, 0, 0]}, "time": 0}\n', "line 1: no joint 'tail'"),
    ],
)
def test_bad_frames_are_told_with_their_line(dousa, library, monkeypatch, text, says):
    pipe(monkeypatch, text)
    code, _, err = dousa("label", library, "-")
    assert code == 2
    assert says in err and len(err.splitlines()) == 1


def test_what_was_seen_is_told_when_a_live_session_breaks_off(dousa, library, recordings, monkeypatch):
    lines = frames(recordings).splitlines(keepends=True)
    cut = len(lines) // 2
    late = json.dumps({**json.loads(lines[cut]), "time": -1})
    pipe(monkeypatch, "".join([*lines[:cut], late, "\n"]))
    code, out, err = dousa("label", library, "-")
    assert code == 2
    assert f"line {cut + 1}: expected frames in the order of time" in err
    settled = [segment for line in out.splitlines() for segment in json.loads(line)["settled"]]
    assert settled[0]["start_s"] == 0
    assert settled[-1]["end_s"] == json.loads(out.splitlines()[-1])["time_s"]


def test_ctrl_c_ends_a_live_session_with_all_that_was_seen(dousa, library, recordings, monkeypatch):
    lines = frames(recordings).splitlines(keepends=True)

    def stop():
        yield from lines[: len(lines) // 2]
        raise KeyboardInterrupt

    monkeypatch.setattr("dousa.app.cli.takes._read_lines", stop)
    code, out, _ = dousa("label", library, "-")
    assert code == 130
    last = json.loads(out.splitlines()[-1])
    assert last["settled"][-1]["end_s"] == last["time_s"]


def test_a_motion_too_large_for_the_memory_is_one_line(dousa, library, monkeypatch):
    def fill(*words, **named):
        raise MemoryError

    monkeypatch.setattr(Library, "find", fill)
    code, _, err = dousa("find", library, "1")
    assert code == 2 and "memory" in err and len(err.splitlines()) == 1


def test_a_folder_without_recordings_is_said_so(dousa, library, tmp_path):
    _, _, err = dousa("find", library, "1", tmp_path)
    assert "no takes to search" in err


def test_no_frames_are_no_error(dousa, library, monkeypatch):
    for nothing in (io.TextIOWrapper(io.BytesIO(b"")), None):
        monkeypatch.setattr(sys, "stdin", nothing)
        code, out, err = dousa("label", library, "-")
        assert (code, out) == (0, "") and "no frames" in err


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("find", "{lib}", "{tmp}/none.bvh"), "no such file"),
        (("find", "{lib}", "999"), "no clip or take 999"),
        (("find", "{lib}", "1", "999"), "no clip or take 999"),
        (("find", "{lib}", "9" * 25), "no clip or take 999"),
        (("label", "{lib}", "9" * 5000), "no such file"),
        (("find", "{tmp}/none.dousa", "1"), "no library at"),
        (("find", "{lib}", "1", "-k", "0"), "-k"),
        (("label", "{lib}", "{tmp}/none.bvh"), "no such file"),
        (("label", "{lib}", "999"), "no clip or take 999"),
        (("label", "{lib}", "{clips}"), "expected one take, found 20 files"),
        (("label", "{lib}", "{take}", "--threshold", "2"), "--threshold"),
        (("label", "{lib}", "{take}", "--picture", "{tmp}/a.xyz"), ".png"),
        (("label", "{lib}", "{take}", "--csv", "{tmp}/no/a.csv"), "the folder does not exist"),
        (("label", "{lib}", "-", "--csv", "{tmp}/a.csv"), "answered as JSON lines"),
        (("search", "{lib}", "1", "--rank", "best"), "--rank"),
        (("search", "{lib}", "{take_number}"), "dousa find"),
        (("train", "{lib}", "--features", "all"), "--features"),
        (("add", "{lib}", "{take}", "--takes", "--category-from", "name:(.)"), "a take has no category"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(dousa, library, recordings, tmp_path, words, says):
    empty = tmp_path / "empty"
    empty.mkdir()
    with Library.open(library) as opened:
        (number,) = (clip.id for clip in opened.clips() if clip.kind == "take")
    places = {"tmp": empty, "lib": library, "take": recordings / "take.trc", "clips": recordings / "clips"}
    code, out, err = dousa(*(word.format(**places, take_number=number) for word in words))
    assert code == 2
    assert says in err + out
    assert "Traceback" not in err
    assert list(empty.iterdir()) == []


def test_label_refuses_a_picture_of_no_format_before_it_answers(dousa, library, recordings, tmp_path):
    code, out, err = dousa("label", library, recordings / "take.trc", "--picture", tmp_path / "a.xyz")
    assert (code, out) == (2, "")
    assert ".png" in err


def test_a_library_without_a_forest_says_how_to_train(dousa, recordings, tmp_path):
    library = tmp_path / "new.dousa"
    dousa("add", library, recordings / "take.trc", "--takes")
    for words in (("find", library, 1), ("label", library, 1), ("label", library, "-")):
        code, _, err = dousa(*words)
        assert code == 2 and "dousa train" in err


def test_a_doubtful_guess_is_said_to_be_one():
    from dousa.app.tables.search import describe_verdict
    from dousa.library import Verdict

    verdict = Verdict(None, "kick", 0.4, 0.31, {"kick": 0.6, "march": 0.4}, perhaps=True)
    assert describe_verdict(verdict) == "perhaps kick, 31% sure (votes: kick 60%, march 40%)"
    named = replace(verdict, category="kick", confidence=0.97, perhaps=False)
    assert describe_verdict(named) == "kick, 97% sure (votes: kick 60%, march 40%)"
    assert describe_verdict(replace(named, confidence=None)) == "kick (votes: kick 60%, march 40%)"
    assert describe_verdict(replace(verdict, perhaps=False)).startswith("unknown (most like kick, 31% likely right")
    assert verdict.to_json()["perhaps"] is True and verdict.to_json()["category"] is None
    mirrored = replace(verdict, odds=verdict.odds + 2.5)
    assert mirrored.fits_better_than(verdict) and not verdict.fits_better_than(mirrored)
    assert not replace(verdict, odds=verdict.odds + 1.5).fits_better_than(verdict), "likelier, not clearly"


@pytest.fixture(scope="session")
def cut_off(recordings, tmp_path_factory) -> Path:
    """The take, cut off within a row."""
    path = tmp_path_factory.mktemp("cut off") / "cut.trc"
    data = (recordings / "take.trc").read_bytes()
    path.write_bytes(data[: 2 * len(data) // 3])
    return path


NOTE = "the file declares 230 frames and holds 152: those were read"


@pytest.mark.parametrize("words", [("label",), ("classify",), ("search",), ("find",)], ids=" ".join)
def test_what_came_up_when_a_file_was_read_is_said(dousa, library, cut_off, words):
    code, out, err = dousa(*words, library, cut_off)
    assert code == 0 and NOTE not in out
    assert err.count(NOTE) == 1 and f"note: {cut_off}: {NOTE}" in err
    code, out, err = dousa(*words, library, cut_off, "--json")
    (answer,) = [json.loads(out)] if words != ("classify",) else json.loads(out)
    assert code == 0 and sum(NOTE in note for note in answer["notes"]) == 1


def test_what_came_up_when_a_file_was_added_is_said_again(dousa, library, cut_off):
    with Library.open(library) as opened:
        opened.add(cut_off, kind="take")
        (number,) = (clip.id for clip in opened.clips() if clip.path == str(cut_off))
        assert [note.code for note in opened.label(number).notes] == ["guard.frame_count"]
    for take in (cut_off, number):
        assert NOTE in dousa("label", library, take)[2]


def test_a_take_is_no_clip(dousa, library, recordings, tmp_path):
    motion = read_motion(recordings / "take.trc")
    many = motion.replace(positions=np.concatenate([motion.positions] * 4))
    write_motion(many, tmp_path / "long.trc")
    told = "long.trc: lasts 31 s, nearly all clips of the library less than"
    for command in ("classify", "search"):
        code, _, err = dousa(command, library, tmp_path / "long.trc")
        assert code == 0 and told in err and "dousa find, dousa label" in err
        assert "lasts" not in dousa(command, library, recordings / "clips/walk/p0.bvh")[2]
    for command in ("label", "find"):
        assert "lasts" not in dousa(command, library, tmp_path / "long.trc")[2]


@pytest.mark.parametrize("command", ["find", "search", "label"])
def test_a_joint_beyond_measure_is_said_with_the_file(dousa, library, recordings, tmp_path, command):
    motion = read_motion(recordings / "clips/walk/p0.bvh")
    far = compute_trajectories(motion)
    positions = far.positions.copy()
    positions[3, 5, 0] = 1e300
    path = tmp_path / "far.trc"
    write_motion(far.replace(positions=positions), path)
    code, out, err = dousa(command, library, path)
    assert (code, out) == (2, "")
    assert f"far.trc: '{far.names[5]}' is at 1e+300 in frame 4" in err and err.count("\n") == 1


def test_places_are_in_the_order_of_what_the_table_shows(dousa, library, recordings):
    words = ("find", library, recordings / "clips/jump/p0.bvh", "-k", 10)
    places = json.loads(dousa(*words, "--json")[1])["results"]
    assert sorted(places, key=lambda place: -place["probability"]) == places
    rows = dousa(*words)[1].splitlines()[1:]
    assert rows[0].split() == ["rank", "sure", "score", "start", "end", "tempo", "take"]
    shown = [row.split()[1] for row in rows[1:] if "no longer alike" not in row]
    assert shown == [f"{place['probability']:.0%}" for place in places]
    ends = [number for number, row in enumerate(rows[1:]) if "no longer alike" in row] or [len(places)]
    assert [place["probability"] >= 0.5 for place in places] == [number < ends[0] for number in range(len(places))]
    assert "確信度" in dousa("--lang", "ja", *words)[1].splitlines()[1]


def test_places_of_bodies_that_lack_joints_have_no_probability(capsys):
    from rich.console import Console

    from dousa.app.tables.search import print_places
    from dousa.library import FindResult, Place

    place = Place("take.bvh", None, 0.0, 1.0, 0.4, 0.1, 0.5, 1.0, False, 1)
    print_places(Console(width=90), FindResult("a", 1.0, 1, 9.0, (place,), ()), mirrored=False)
    assert capsys.readouterr().out.splitlines()[1].split() == ["rank", "score", "start", "end", "tempo", "take"]


def test_the_table_of_a_take_says_what_is_done_how_often_and_what_is_doubtful(capsys):
    from rich.console import Console

    from dousa.app.tables.search import print_timeline
    from dousa.library import LabelledTake
    from dousa.retrieval import Segment, Timeline

    known = Segment(0.0, 9.0, "squat", 0.9, 5), Segment(9.0, 11.0, "kick", 0.8)
    unsure = Segment(11.0, 12.0, None, 0.6), Segment(12.0, 14.0, None, 0.31, 2, guess="[kick]")
    print_timeline(Console(width=90), LabelledTake("take.bvh", None, Timeline(known + unsure, 14.0, 0.5)))
    squat, kick, nothing, doubtful = capsys.readouterr().out.splitlines()[-4:]
    assert "squat × 5" in squat and "kick" in kick and "×" not in kick + nothing
    assert "perhaps [kick] × 2" in doubtful and "31%" in doubtful
