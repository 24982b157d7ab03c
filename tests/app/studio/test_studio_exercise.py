"""Judging the repetitions of an exercise: over HTTP as the command does it, and in a real Chromium."""

import csv
import json
import urllib.request
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.studio.evaluation_cases import upload


@pytest.fixture(scope="module")
def exercise(tmp_path_factory) -> tuple[Path, Path]:
    """A kick, and four more of which the second is broken off."""
    from dousa.formats.registry import write_motion
    from dousa.motion import canonicalise, compute_trajectories
    from dousa.motion.synthetic import draw_performer, make_motion
    from lab.trials.exercise_sets import join_repetitions

    folder, performer = tmp_path_factory.mktemp("exercise"), draw_performer(303)
    takes = [canonicalise(compute_trajectories(make_motion("kick_left", performer, take))) for take in range(14)]
    kick, *kicks = [take for take in takes if take.duration * performer.tempo < 2.7][:5]
    write_motion(kick.to_trajectories(), folder / "kick.trc")
    several = join_repetitions(kicks, np.random.default_rng(4), broken_off=[1]).motion
    write_motion(several.to_trajectories(), folder / "kicks.trc")
    return folder / "kick.trc", folder / "kicks.trc"


@pytest.fixture
def ask(studio, wait_job, exercise):
    """Asks for the evaluation of the kicks with further options."""
    kick, kicks = upload(studio, *exercise)

    def evaluate(**options: Any) -> dict[str, Any]:
        request = {"references": [kick], "performance": kicks, "repetitions": True} | options
        answer = studio.post("/api/jobs/evaluate", json=request)
        assert answer.status_code == 202, answer.text
        return wait_job(studio, answer.json()["id"])

    return evaluate


def test_it_is_what_the_command_says(ask, exercise):
    from dousa.app.pipelines.evaluate import evaluate_repetitions
    from dousa.formats import ReadOptions

    job = ask()
    assert job["state"] == "done", job["problem"]
    said = evaluate_repetitions([exercise[0]], exercise[1], options=ReadOptions()).assessment.to_json()
    assert {name: job["result"][name] for name in said} == said
    assert job["result"]["says_codes"][1] == "exercise_summary.broken_off"
    assert job["result"]["options"] == {"side": "same", "tempo": "free", "repetitions": True}
    other = ask(tempo="same", weights={"legs": 2.0})["result"]
    assert other["tempo"] == "same"
    assert [one["score"] for one in other["repetitions"]] != [one["score"] for one in said["repetitions"]]


def test_counting_needs_no_reference(studio, exercise):
    from dousa.formats.motion_files import ReadOptions, read_canonical
    from dousa.motion import count_repetitions

    (kicks,) = upload(studio, exercise[1])
    answer = studio.get("/api/motions/count", params=kicks)
    found = count_repetitions(read_canonical(exercise[1], ReadOptions())[0]).to_json()
    assert {name: answer.json()[name] for name in found} == found
    assert studio.get("/api/motions/count", params={"motion": "clip:999999"}).status_code == 404


def test_report_and_files(studio, ask):
    place = f"/api/evaluations/{ask()['id']}"
    english, japanese = (studio.get(f"{place}/exercise?language={language}").json() for language in ("en", "ja"))
    assert set(english) == {"markup", "data", "player"}
    assert "What to know" in english["markup"] and "要点" in japanese["markup"]
    assert len(english["data"]["repetitions"]) == 4 and len(english["player"]["furi"]) == 4
    page = studio.get(f"{place}/exercise.html?language=ja")
    assert page.text.startswith("<!doctype html>") and "要点" in page.text
    assert page.headers["content-disposition"].startswith("attachment; ")
    rows = list(csv.DictReader(studio.get(f"{place}/repetitions.csv").text.splitlines()))
    assert [row["complete"] for row in rows] == ["1", "0", "1", "1"]


@pytest.mark.parametrize("path", ["report", "progress", "curves.csv", "furi.txt"])
def test_what_an_exercise_has_not_is_said(studio, ask, path):
    answer = studio.get(f"/api/evaluations/{ask()['id']}/{path}")
    assert answer.status_code == 404 and "exercise" in answer.json()["problem"]


def test_a_dance_has_no_exercise_report(studio, ask):
    job = ask(repetitions=False)
    assert job["result"]["options"] == {"side": "same", "tempo": "same"}
    answer = studio.get(f"/api/evaluations/{job['id']}/exercise")
    assert answer.status_code == 404 and "repetitions" in answer.json()["problem"]


def test_no_repetition_is_said_with_the_name(studio, wait_job, exercise, tmp_path):
    from dousa.formats.registry import read_motion, write_motion

    kick = read_motion(exercise[0])
    write_motion(kick.replace(positions=np.repeat(kick.positions[:1], 90, axis=0)), tmp_path / "still.trc")
    reference, still = upload(studio, exercise[0], tmp_path / "still.trc")
    asked = {"references": [reference], "performance": still, "repetitions": True}
    job = wait_job(studio, studio.post("/api/jobs/evaluate", json=asked).json()["id"])
    assert job["state"] == "failed"
    assert "still.trc" in job["problem"] and "at least one repetition" in job["problem"]


def test_from_files_to_repetitions(show, running, exercise):
    def send(path: Path) -> str:
        headers = {"authorization": f"Bearer {running.token}", "content-type": "application/octet-stream"}
        url = f"{running.url}/api/uploads?name={path.name}"
        with urllib.request.urlopen(urllib.request.Request(url, path.read_bytes(), headers, method="POST")) as answer:
            return json.loads(answer.read())["files"][0]["motion"]

    page = show(f"/evaluate?performance={send(exercise[1])}&references={send(exercise[0])}")
    page.wait("return document.querySelector('#grade') && !document.querySelector('#grade').disabled")
    page.find("#repetitions").click()
    assert page.run("return document.querySelector('#tempo-free').checked")
    assert "repetitions=1" in page.run("return location.search")
    page.wait("return document.querySelector('#performance-count').textContent.startsWith('3 repetitions, certainty')")
    page.find("#grade").click()
    page.wait("return document.querySelectorAll('.event[data-repetition]').length === 4")
    page.run("document.querySelectorAll('.event[data-repetition]')[2].click()")
    page.wait("return document.querySelectorAll('.event[data-repetition]')[2].getAttribute('aria-current') === 'true'")
    files = page.run("return [...document.querySelectorAll('[data-part=files] a')].map((one) => one.dataset.file)")
    assert files == ["exercise.html", "repetitions.csv"]
    assert page.run("return document.documentElement.scrollWidth <= window.innerWidth")
    # The same motions again: what was chosen is still chosen.
    page.run("window.scrollTo({top: 0, behavior: 'instant'})")
    page.find("#again").click()
    page.wait("return !document.querySelector('#setup').hidden")
    assert page.run("return document.querySelector('#repetitions').checked")
