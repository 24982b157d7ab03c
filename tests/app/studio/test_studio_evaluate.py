"""Judging a performance over HTTP: the job, the report by parts, changes that are answered at once, files."""

import dataclasses
import json

import pytest

from app.studio.evaluation_cases import upload

KINDS = {"global", "partial", "incomplete", "shift"}


@pytest.fixture
def motions(studio, dances):
    takes, pupil = dances
    *references, performance = upload(studio, *takes, pupil)
    return {"references": references, "performance": performance}


@pytest.fixture
def evaluate(studio, wait_job):
    def ask(request):
        answer = studio.post("/api/jobs/evaluate", json=request)
        assert answer.status_code == 202, answer.text
        return wait_job(studio, answer.json()["id"])

    return ask


@pytest.fixture
def job(evaluate, motions):
    done = evaluate(motions)
    assert done["state"] == "done", done["problem"]
    return done


def test_the_errors_are_found_and_the_figures_told(job):
    result = job["result"]
    assert {event["kind"] for event in result["events"]} >= {"shift", "partial", "global"}
    # The short arm, whether it is called short or elsewhere.
    assert any(
        event["kind"] in {"incomplete", "partial"} and event["start_s"] < 34.5 and event["end_s"] > 35.0
        for event in result["events"]
    )
    assert {event["kind"] for event in result["events"]} <= KINDS
    assert sorted(one["event"] for one in result["advice"] if one["event"] is not None) == list(
        range(len(result["events"]))
    )
    assert result["calibrated"] and 0 < result["score"] < 100
    assert result["names"]["performance"] == "dance_pupil.bvh" and len(result["names"]["references"]) == 3
    assert result["furi_used"] == result["furi_found"] and len(result["furi_found"]) > 5
    assert result["furi_found"][-1]["end_s"] == pytest.approx(result["reference_duration_s"], abs=0.05)


def test_it_is_what_the_command_says(job, dances):
    from dousa.app.pipelines.evaluate import evaluate_files
    from dousa.formats import ReadOptions

    takes, pupil = dances
    said = evaluate_files(takes, pupil, options=ReadOptions()).assessment.to_json()
    assert {name: job["result"][name] for name in said} == said


def test_the_report_comes_by_parts_in_both_languages(studio, job):
    english, japanese = (
        studio.get(f"/api/evaluations/{job['id']}/report?language={language}").json() for language in ("en", "ja")
    )
    assert set(english["parts"]) == {
        *(
            "header",
            "advice",
            "events",
            "facts",
            "segments",
            "timeline",
            "matrix",
            "furi",
            "moments",
            "reading",
            "tables",
        )
    }
    for name in english["parts"]:
        assert f'data-part="{name}"' in english["frame"]
    assert "Timeline" in english["frame"] and "Timeline" not in japanese["frame"]
    assert "評価" in japanese["parts"]["header"]
    assert english["player"]["performance"]["name"] == "dance_pupil.bvh"
    assert len(english["data"]["events"]) == len(job["result"]["events"])


def _adjust(studio, job, **values):
    return studio.post(f"/api/evaluations/{job['id']}/adjust", json=values)


def test_a_moved_cut_changes_the_figures_at_once(studio, job):
    furi = json.loads(json.dumps(job["result"]["furi_found"]))
    furi[1]["end_s"] = furi[2]["start_s"] = furi[1]["end_s"] + 0.5
    quick = _adjust(studio, job, furi=furi, precision="quick").json()
    assert quick["exact"] and "player" not in quick and "moments" not in quick["parts"]
    assert quick["assessment"]["furi"][1]["reference_end_s"] == pytest.approx(furi[1]["end_s"], abs=0.02)
    exact = _adjust(studio, job, furi=furi).json()
    assert exact["assessment"] == quick["assessment"]
    assert "moments" in exact["parts"]
    # A quick answer is a try, an exact one is kept.
    assert _adjust(studio, job, precision="quick").json()["assessment"]["furi_used"] == job["result"]["furi_found"]
    kept = studio.get(f"/api/evaluations/{job['id']}/report").json()["assessment"]
    assert kept["furi_used"] == furi and kept["furi_found"] == job["result"]["furi_found"]


def _cut(start, end, label="A"):
    return {"start_s": start, "end_s": end, "label": label}


@pytest.mark.parametrize(
    "values",
    [
        '{"weights": {"trunk": NaN}}',
        '{"weights": {"trunk": Infinity}}',
        {"weights": {"trunk": -1}},
        {"weights": {"trunk": 1e9}},
        {"weights": {"tail": 1}},
        {"weights": {"trunk": "much"}},
        {"weights": {str(number): 1 for number in range(1000)}},
        {"weights": dict.fromkeys(("trunk", "left_arm", "right_arm", "left_leg", "right_leg"), 0)},
        {"furi": []},
        {"furi": [_cut(0, 1000)]},
        {"furi": [_cut(5, 5)]},
        {"furi": [_cut(5, 3)]},
        {"furi": [_cut(-1, 3)]},
        {"furi": [_cut(0, 5), _cut(4, 8)]},
        {"furi": [_cut(0, 5), _cut(0, 5)]},
        {"furi": [_cut(k / 500, (k + 1) / 500) for k in range(5000)]},
        {"furi": [_cut(0, 5, "")]},
        {"furi": [_cut(0, 5, "a # b")]},
        {"furi": [_cut(0, 5, "a\nb")]},
        {"furi": [_cut(0, 5, "x" * 101)]},
        '{"furi": [{"start_s": NaN, "end_s": 3, "label": "A"}]}',
        {"furi": "all"},
        {"language": "fr"},
        {"precision": "sloppy"},
        {"surprise": 1},
        "[",
    ],
)
@pytest.mark.parametrize("precision", ["quick", "exact"])
def test_hostile_changes_are_refused_in_one_sentence(studio, ready, values, precision):
    text = values if isinstance(values, str) else json.dumps({"precision": precision, **values})
    answer = studio.post(
        "/api/evaluations/00000000000000aa/adjust", content=text, headers={"content-type": "application/json"}
    )
    assert answer.status_code == 422, answer.text[:300]
    problem = answer.json()["problem"]
    assert problem and "\n" not in problem and len(problem) <= 2000


@pytest.fixture
def ready(studio):
    """An evaluation of two clips of the library that is done, without the waiting."""
    from dousa.app.studio.jobs.board import Job

    board = studio.app.state.studio.jobs
    clips = [item["motion"] for item in studio.get("/api/clips?category=walk").json()["items"][:2]]
    request = {"references": [{"motion": clips[0]}], "performance": {"motion": clips[1]}}
    job = Job("00000000000000aa", "evaluate", "x", request, state="done")
    board._jobs[job.id] = job
    board.folder(job).mkdir(parents=True)
    return job


def test_evaluations_are_made_again_when_they_are_gone(studio, ready):
    evaluations = studio.app.state.studio.evaluations
    first = studio.get(f"/api/evaluations/{ready.id}/report").json()["assessment"]
    evaluations._ready.clear()
    again = studio.get(f"/api/evaluations/{ready.id}/report").json()["assessment"]
    assert first == again


def test_few_evaluations_stay_in_memory(studio, ready):
    evaluations = studio.app.state.studio.evaluations
    one = evaluations.get(ready.id)
    for number in range(20):
        evaluations.put(f"{number:016x}", dataclasses.replace(one))
    assert len(evaluations._ready) <= 6
    assert f"{19:016x}" in evaluations._ready


def test_what_was_changed_outlives_the_studio(studio, job, library_copy):
    from starlette.testclient import TestClient

    from dousa.app.studio import Settings, create_app

    weights = {"left_arm": 0.5}
    before = _adjust(studio, job, weights=weights).json()["assessment"]
    studio.app.state.studio.close()
    with TestClient(create_app(Settings(library_copy, token="x")), "http://127.0.0.1:8765") as later:
        later.headers["authorization"] = "Bearer x"
        after = later.get(f"/api/evaluations/{job['id']}/report").json()["assessment"]
    assert after == before


def test_files_are_those_of_what_was_changed(studio, job, tmp_path):
    from dousa.evaluation import read_furi, read_weights

    furi = [_cut(0, 3, "hand 1"), _cut(3, 8, "turn"), _cut(8, 12.5, "hand 1")]
    _adjust(studio, job, furi=furi, weights={"trunk": 2, "left_shank": 0})
    files = {}
    for name in ("report.html", "curves.csv", "events.csv", "furi.txt", "weights.toml"):
        answer = studio.get(f"/api/evaluations/{job['id']}/{name}")
        assert answer.status_code == 200
        assert answer.headers["content-disposition"].startswith("attachment; ")
        files[name] = tmp_path / name
        files[name].write_bytes(answer.content)
    read = read_furi(files["furi.txt"], 30.0, 1120)
    assert [(one.start, one.end, one.label) for one in read] == [
        *((0, 90, "hand 1"), (90, 240, "turn"), (240, 375, "hand 1"))
    ]
    weights = read_weights(files["weights.toml"])
    assert weights["trunk"] == 2 and weights["left_shank"] == 0 and weights["right_shank"] == 1
    page = files["report.html"].read_text(encoding="utf-8")
    assert page.startswith("<!doctype html>") and "hand 1" in page and "<script src" not in page


@pytest.mark.parametrize("part", ["performance", "reference"])
def test_who_is_too_short_is_named(evaluate, motions, part):
    if part == "performance":
        motions["performance"] |= {"start_s": 1, "end_s": 1.2}
    else:
        motions["references"][1] |= {"start_s": 1, "end_s": 1.2}
    done = evaluate(motions)
    assert done["state"] == "failed"
    name = "dance_pupil.bvh" if part == "performance" else "dance_reference_1.bvh"
    assert done["problem"].startswith(f"{name}: {part}: expected a motion of at least 0.5 s")


def test_another_figure_altogether_is_said(studio, evaluate, motions):
    clip = studio.get("/api/clips?category=squat").json()["items"][0]["motion"]
    done = evaluate({**motions, "performance": {"motion": clip}})
    assert done["state"] == "done"
    assert done["result"]["score"] is None
    assert any("is it the same dance?" in warning for warning in done["result"]["warnings"])


def test_warnings_name_what_the_page_has(studio, evaluate, dances, tmp_path):
    from dousa.formats.registry import read_motion, write_motion
    from dousa.motion import canonicalise, fit_motion

    takes, _ = dances
    motion = canonicalise(read_motion(takes[0]))
    mirrored = dataclasses.replace(motion, positions=_mirror(motion.positions))
    write_motion(fit_motion(mirrored), tmp_path / "facing.bvh")
    reference, performance = upload(studio, takes[0], tmp_path / "facing.bvh")
    asked = {"references": [reference], "performance": performance}
    done = evaluate({**asked, "side": "same"})
    said = " ".join(done["result"]["warnings"])
    assert "compare it with 'Mirrored'" in said and "--mirror" not in said
    better = evaluate(asked)  # the side is found
    assert better["result"]["score"] > done["result"]["score"] + 20 and better["result"]["side"] == "mirrored"


def _mirror(positions):
    from dousa.motion.canonical.joints import MIRRORED_JOINTS

    return positions[:, list(MIRRORED_JOINTS)] * [-1.0, 1.0, 1.0]


@pytest.mark.parametrize(
    ("request_", "status"),
    [
        ({"references": [], "performance": {"motion": "clip:1"}}, 422),
        ({"references": [{"motion": "clip:1"}] * 51, "performance": {"motion": "clip:1"}}, 422),
        ({"references": [{"motion": "clip:1"}], "performance": {"motion": "clip:999999"}}, 404),
        ({"references": [{"motion": "file:00000000000000aa/x.bvh"}], "performance": {"motion": "clip:1"}}, 404),
        ({"references": [{"motion": "../x"}], "performance": {"motion": "clip:1"}}, 422),
        ({"references": [{"motion": "clip:1"}], "performance": {"motion": "clip:1"}, "side": "left"}, 422),
    ],
)
def test_requests_that_cannot_be(studio, request_, status):
    answer = studio.post("/api/jobs/evaluate", json=request_)
    assert answer.status_code == status and answer.json()["problem"]


@pytest.mark.parametrize("path", ["report", "report.html", "curves.csv", "furi.txt", "weights.toml"])
def test_other_jobs_are_no_evaluations(studio, path):
    assert studio.get(f"/api/evaluations/00000000000000bb/{path}").status_code == 404
    other = studio.post("/api/jobs/train", json={}).json()["id"]
    studio.post(f"/api/jobs/{other}/stop")
    assert studio.get(f"/api/evaluations/{other}/{path}").status_code == 404


def test_a_pupil_over_time(studio, evaluate, motions, job):
    assert studio.get(f"/api/evaluations/{job['id']}/progress").json() == {"progress": None}
    refused = studio.get(f"/api/evaluations/{job['id']}/progress.svg?language=ja")
    assert refused.status_code == 404 and refused.json()["code"] == "studio_evaluation.first"
    later = evaluate(motions)
    other = evaluate({**motions, "tempo": "free"})
    found = studio.get(f"/api/evaluations/{later['id']}/progress").json()["progress"]
    assert [one["name"] for one in found["attempts"]] == ["dance_pupil.bvh"] * 2
    assert [one["score"] for one in found["attempts"]] == [job["result"]["score"]] * 2
    assert found["says"].startswith("the grade stayed at") and found["still"]
    assert studio.get(f"/api/evaluations/{other['id']}/progress").json() == {"progress": None}
    picture = studio.get(f"/api/evaluations/{later['id']}/progress.svg?language=ja")
    assert picture.headers["content-type"] == "image/svg+xml" and b"<svg" in picture.content
