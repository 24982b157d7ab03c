"""``dousa evaluate`` as a person uses it: table, JSON, report, and every mistake in one line with exit code 2."""

import dataclasses
import json
import math
import re
import shutil
from pathlib import Path
from types import SimpleNamespace

import pytest

from app.fake_assessment import make_assessment
from dousa import evaluation
from dousa.formats.registry import write_motion
from dousa.motion import compute_trajectories
from dousa.motion.synthetic.performers import draw_performer, make_motion


@pytest.fixture(scope="session")
def takes(tmp_path_factory) -> Path:
    """BVH files of one synthetic person: takes/t0.bvh ... t2.bvh, and pupil.bvh beside the folder."""
    folder = tmp_path_factory.mktemp("evaluate")
    (folder / "takes").mkdir()
    for number in range(3):
        write_motion(make_motion("squat", draw_performer(1), number), folder / "takes" / f"t{number}.bvh")
    write_motion(make_motion("squat", draw_performer(2)), folder / "pupil.bvh")
    return folder


@pytest.fixture
def asked(monkeypatch):
    """A made-up `assess` and report; holds what they were asked for."""
    calls = SimpleNamespace(assess=[], report=[])

    def assess(references, performance, **options):
        calls.assess.append((references, performance, options))
        made = make_assessment()
        return dataclasses.replace(made, n_references=len(references), calibrated=len(references) >= 5)

    def write_report(assessment, folder, language="en", timing=None, notes=""):
        calls.report.append((Path(folder), language))
        Path(folder).mkdir(parents=True, exist_ok=True)
        for name in ("report.html", "curves.csv"):
            (Path(folder) / name).write_text(language)
        return Path(folder) / "report.html"

    monkeypatch.setitem(evaluation.__dict__, "assess", assess)
    monkeypatch.setattr("dousa.app.report.page.write_report", write_report)
    return calls


def test_the_table_tells_grade_errors_and_order(succeed, takes, asked):
    out, err = succeed("evaluate", takes / "takes/t0.bvh", "--performance", takes / "pupil.bvh")
    said = ("95 % of the reference", "(64 to 77)", "grade 71", "100 - 10 x 2.9 = 71", "not calibrated", "24 deg short",
            "global motion error", "order: skip", "partial motion error", "200 ms late", " 1.4 ")  # fmt: skip
    for word in said:
        assert word in out
    assert len(re.findall(r"^ ?0:\d\d\.\d-0:\d\d\.\d", out, re.MULTILINE)) == 5
    assert "the limits are guessed" in err and "Traceback" not in err
    ((references, performance, options),) = asked.assess
    assert len(references) == 1 and performance.n_frames > 10
    assert options.pop("names") == ["t0.bvh", "pupil.bvh"]
    assert options == {"furi": None, "side": "auto", "tempo": "same", "weights": None}
    assert asked.report == []


def test_json_alone_is_on_standard_output(succeed, takes, asked, tmp_path):
    words = ("--performance", takes / "pupil.bvh", "--json", "-o", tmp_path / "a" / "b")
    out, err = succeed("evaluate", takes / "takes", takes / "takes/t0.bvh", *words)
    answer = json.loads(out, parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))
    keys = ["score", "calibrated", "furi", "events", "lag_ms", "frame_rate"]
    assert list(answer)[:6] == keys
    assert answer["n_references"] == 3  # the one named twice counts once
    assert [Path(path).name for path in answer["references"]] == ["t0.bvh", "t1.bvh", "t2.bvh"]
    assert answer["performance"] == str(takes / "pupil.bvh")
    assert answer["report"] == str(tmp_path / "a" / "b" / "report.html")
    assert sorted(path.name for path in (tmp_path / "a" / "b").iterdir()) == ["curves.csv", "report.html"]
    assert "guessed" in err


def test_options_reach_the_assessment(succeed, takes, asked, tmp_path):
    weights = tmp_path / "weights"
    weights.write_text("arms = 2\n")
    words = ("--mirror", "yes", "--tempo", "free", "--weights", weights, "-o", tmp_path / "out")
    out, _ = succeed("--lang", "ja", "evaluate", takes / "takes", "-p", takes / "pupil.bvh", *words)
    options = asked.assess[0][2]
    assert (options["side"], options["tempo"]) == ("mirrored", "free")
    assert options["weights"]["left_forearm"] == 2.0 and options["weights"]["trunk"] == 1.0
    for word in ("評価点 71", "全体振りミス", "左腕：24度足りません", "時刻", "未校正", "64～77", "順序: 抜け"):
        assert word in out
    assert asked.report[0][1] == "ja" and (tmp_path / "out/report.html").read_text() == "ja"


def test_a_furi_file_counts_frames_of_the_first_reference(dousa, takes, asked, tmp_path):
    path = tmp_path / "furi.txt"
    path.write_text("1-20 down\n21-40 up\n")
    words = ("evaluate", takes / "takes", "-p", takes / "pupil.bvh", "--furi", path)
    assert dousa(*words)[0] == 0
    furi = asked.assess[0][2]["furi"]
    assert [(figure.start, figure.end, figure.label) for figure in furi] == [(0, 20, "down"), (20, 40, "up")]
    for text, says in (("1-20\n15-30\n", "overlap"), ("1-20000\n", "expected frames 1 to"), ("one\n", "expected")):
        path.write_text(text)
        code, out, err = dousa(*words)
        assert code == 2 and out == "" and says in err and str(path) in err and len(err.splitlines()) == 1
    path.unlink()
    code, _, err = dousa(*words)
    assert code == 2 and "cannot be read" in err and len(asked.assess) == 1


def test_a_performance_among_several_references_is_noted(dousa, takes, asked):
    _, _, err = dousa("evaluate", takes / "takes", "-p", takes / "takes/t1.bvh")
    assert "also one of the references" in err
    _, _, err = dousa("evaluate", takes / "takes/t1.bvh", "-p", takes / "takes/t1.bvh")
    assert "also one of the references" not in err


def test_nothing_found_and_no_grade(succeed, takes, asked, monkeypatch):
    made = dataclasses.replace(make_assessment(), events=(), lapses=(), score=math.nan, gaps=((1, 2, "trunk"),))
    monkeypatch.setitem(evaluation.__dict__, "assess", lambda *_, **__: made)
    out, _ = succeed("evaluate", takes / "takes", "-p", takes / "pupil.bvh")
    # Why there is none stands for the grade.
    assert out.splitlines()[1].startswith("100 - 10") and "of 100" not in out
    assert "no error was found" in out and "1.0 s of gaps" in out


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("{takes}",), "performance required: --performance FILE"),
        (("{dir}/none.bvh", "-p", "{pupil}"), "none.bvh: no such file"),
        (("{takes}", "-p", "{dir}/none.bvh"), "none.bvh: no such file"),
        (("{takes}", "-p", "{takes}"), "this is a folder"),
        (("{dir}", "-p", "{pupil}"), "no motion files"),
        (("{takes}", "-p", "{pupil}", "--weights", "{dir}/none"), "weights cannot be read"),
        (("{takes}", "-p", "{pupil}", "--weights", "{pupil}"), "expected 'segment = number'"),
        (("{takes}", "-p", "{pupil}", "-o", "{pupil}"), "is a file"),
        (("{takes}", "-p", "{pupil}", "-o", "{pupil}/deeper"), "is a file"),
        (("{takes}", "-p", "{pupil}", "--notes", "well done"), "--output"),
        (("{takes}", "-p", "{pupil}", "--notes", "well done", "--repetitions"), "--notes"),
        (("{takes}", "-p", "{pupil}", "--read", "joint_map={dir}/none"), "joint map"),
        (("{takes}", "-p", "{pupil}", "--read", "unit=furlong"), "furlong"),
    ],
)
def test_mistakes_are_one_line_and_exit_code_2(dousa, takes, asked, tmp_path, words, says):
    places = {"takes": takes / "takes", "dir": tmp_path, "pupil": takes / "pupil.bvh"}
    code, out, err = dousa("evaluate", *(word.format(**places) for word in words))
    assert code == 2 and out == ""
    assert says in err and len(err.splitlines()) == 1 and "Traceback" not in err
    assert asked.assess == [] and list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("option", "named"), [(("--tempo", "fast"), "'fast'"), (("--read", "mood=glad"), "'mood'")])
def test_unknown_choices_are_refused(dousa, takes, option, named):
    code, _, err = dousa("evaluate", takes / "takes", "-p", takes / "pupil.bvh", *option)
    assert code == 2 and named in err and "Traceback" not in err


def test_a_file_that_is_damaged_is_named(dousa, takes, asked, tmp_path):
    bad = tmp_path / "bad.bvh"
    bad.write_text("HIERARCHY\n")
    for words in ((bad, "-p", takes / "pupil.bvh"), (takes / "takes", bad, "-p", takes / "pupil.bvh"),
                  (takes / "takes", "-p", bad)):  # fmt: skip
        code, _, err = dousa("evaluate", *words)
        assert code == 2 and str(bad) in err and len(err.splitlines()) == 1


def test_a_motion_that_is_too_short_is_named(dousa, takes, tmp_path):
    one = tmp_path / "one.bvh"
    motion = make_motion("bow", draw_performer(3))
    write_motion(dataclasses.replace(motion, rotations=motion.rotations[:1], translations=motion.translations[:1]), one)
    for words in ((takes / "takes", one, "-p", takes / "pupil.bvh"), (takes / "takes", "-p", one)):
        code, out, err = dousa("evaluate", *words, "--json", "-o", tmp_path / "out")
        assert code == 2 and out == "" and not (tmp_path / "out").exists()
        assert str(one) in err and "got 1 frame at" in err and len(err.splitlines()) == 1


def test_ctrl_c_leaves_nothing(dousa, takes, asked, monkeypatch, tmp_path):
    def interrupt(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setitem(evaluation.__dict__, "assess", interrupt)
    code, out, err = dousa("evaluate", takes / "takes", "-p", takes / "pupil.bvh", "-o", tmp_path / "a/b")
    assert code == 130 and out == "" and "interrupted" in err and "Traceback" not in err
    assert list(tmp_path.iterdir()) == []


def test_other_formats_and_names_with_brackets(dousa, takes, asked, tmp_path):
    place = tmp_path / "[bold]\n"
    place.mkdir()
    for suffix in (".trc", ".c3d", ".npz"):
        write_motion(compute_trajectories(make_motion("bow", draw_performer(3))), place / f"a{suffix}")
    shutil.copy(takes / "pupil.bvh", place / "[x] é.BVH")
    code, out, err = dousa("evaluate", place, "-p", place / "[x] é.BVH", "-o", place)
    assert code == 0 and "report: " in out
    assert len(asked.assess[0][0]) == 4 and "Traceback" not in err


def test_the_real_assessment_and_report(dousa, takes, tmp_path):
    words = (
        "--lang",
        "ja",
        "evaluate",
        takes / "takes",
        "-p",
        takes / "pupil.bvh",
        "-o",
        tmp_path / "report",
        "--notes",
        "ひざを <柔らかく>",
    )
    code, out, err = dousa(*words)
    assert code == 0 and "評価" in out and "Traceback" not in err
    page = (tmp_path / "report" / "report.html").read_text(encoding="utf-8")
    assert "pupil.bvh" in page and "t0.bvh" in page
    assert "ひざを &lt;柔らかく&gt;" in page
    code, out, _ = dousa(*words, "--json")
    assert code == 0 and json.loads(out)["report"] == str(tmp_path / "report" / "report.html")


def test_a_motion_equals_itself(dousa, takes):
    code, out, _ = dousa("evaluate", takes / "pupil.bvh", "-p", takes / "pupil.bvh", "--json")
    answer = json.loads(out)
    assert code == 0 and answer["score"] == 100.0 and answer["events"] == []


def test_each_amc_finds_its_own_skeleton(succeed, asked, shared_data):
    folder = shared_data("hdm05/squat1Reps")
    files = sorted(folder.glob("*.amc"))
    out, _ = succeed("evaluate", files[0], files[-1], "-p", files[1], "--json")
    assert len(json.loads(out)["references"]) == 2
    first, last = asked.assess[0][0]
    assert first.height != last.height  # another person's skeleton


# advice and progress


def test_brief_is_the_grade_and_what_to_work_on(dousa, succeed, takes, asked):
    words = ("evaluate", takes / "takes/t0.bvh", "--performance", takes / "pupil.bvh")
    out, _ = succeed(*words, "--detail", "brief")
    lines = out.splitlines()
    assert lines[0].startswith("95 %") and lines[1].startswith("grade 71")
    assert [line[:3] for line in lines[2:5]] == ["1. ", "2. ", "3. "]
    assert "went well" in lines[5]
    assert lines[6:] == ["2 more things to work on: --detail full"]
    full = dousa(*words)[1]
    assert full.startswith("\n".join(lines[:5])) and "partial motion error" in full
    brief, whole = (json.loads(dousa(*words, "--json", "--detail", one)[1])["advice"] for one in ("brief", "full"))
    assert len(brief) == 3 and sorted(one["event"] for one in whole if one["event"] is not None) == [0, 1, 2, 3]
    assert lines[2] == f"1. {brief[0]['says']}"


def test_progress_over_answers(dousa, takes, asked, tmp_path):
    answer = dousa("evaluate", takes / "takes/t0.bvh", "--performance", takes / "pupil.bvh", "--json")[1]
    (tmp_path / "a.json").write_text(answer, encoding="utf-8")
    later = json.loads(answer)
    later["score"], later["events"] = 80.0, later["events"][:1]
    (tmp_path / "b.json").write_text(json.dumps(later), encoding="utf-8")
    files = (tmp_path / "a.json", tmp_path / "b.json")
    code, out, err = dousa("progress", *files, "--picture", tmp_path / "p.png")
    assert code == 0 and err == ""
    assert "the grade rose from 71 to 80" in out and "every time" in out and "1 (24 deg)" in out
    assert (tmp_path / "p.png").read_bytes().startswith(b"\x89PNG")
    assert json.loads(dousa("progress", *files, "--json")[1])["worse"] == []
    assert "評価点が71点から80点に" in dousa("--lang", "ja", "progress", *files)[1]
    later["references"] = ["another.bvh"]
    files[1].write_text(json.dumps(later), encoding="utf-8")
    assert "different references" in dousa("progress", *files)[2]


@pytest.mark.parametrize(
    ("content", "says"),
    [("[1]", "with score, events and lapses"), ("no", "cannot be read as"), (None, "cannot be read")],
)
def test_progress_over_something_else(dousa, tmp_path, content, says):
    file = tmp_path / "a.json"
    if content is not None:
        file.write_text(content)
    code, out, err = dousa("progress", file, file)
    assert code == 2 and out == "" and says in err and len(err.splitlines()) == 1
