"""Labels that are likely wrong, the demo of an empty library: asked as a program would and in a real browser."""

import pytest

from app.studio.conftest import TOKEN, listening, wait_for
from app.studio.library_page import CELLS, click, wait_count
from dousa.app.studio import Settings

KEYS = pytest.importorskip("selenium.webdriver", reason="selenium is not installed: pip install selenium").Keys
STAGE = "return document.querySelector('.rv-stage')?.textContent ?? ''"


@pytest.fixture
def planted(running):
    """The library with two wrong labels; their numbers."""
    library = running.app.state.studio.library
    kick, squat = (library.clips(category=name)[0].id for name in ("kick_left", "squat"))
    library.relabel([kick], category="walk")
    library.relabel([squat], category="wave_right")
    return library, kick, squat


@pytest.mark.plain_workers
def test_a_review_is_a_job_with_doubts_and_duplicates(studio):
    library = studio.app.state.studio.library
    first = library.clips(category="squat")[0].id
    library.relabel([first], category="walk")
    job = wait_for(studio, studio.post("/api/jobs/review").json()["id"])
    assert job["state"] == "done"
    doubt, *others = job["result"]["doubts"]
    assert (doubt["clip_id"], doubt["suggested"]) == (first, "squat")
    assert len(others) <= 1  # of six squats, one that resembles most the one with the wrong label
    assert job["result"]["duplicates"] == []
    refused = studio.post("/api/jobs/demo")
    assert refused.status_code == 409 and "empty" in refused.json()["problem"]


def test_labels_that_are_being_checked_are_not_checked_a_second_time(show, running):
    from dousa.app.studio.jobs.board import Job

    board = running.app.state.studio.jobs
    job = Job("00000000000000ab", "review", "review", {}, state="running", started_s=1.0)
    board._jobs[job.id] = job
    page = show("/library")
    page.wait(f"{CELLS}.length > 3")
    click(page, "#review-button")
    page.wait("return new URLSearchParams(location.search).get('job') === arguments[0]", job.id)
    assert page.wait("return document.querySelector('dialog progress')")
    assert [one.id for one in board.all() if one.kind == "review"] == [job.id]
    page.press(KEYS.ESCAPE)
    assert page.messages() == []
    del board._jobs[job.id]


def test_wrong_labels_are_decided_by_keys_and_taken_back(show, planted):
    library, kick, squat = planted
    category = lambda number: library.clips([number])[0].category  # noqa: E731
    page = show("/library")
    page.wait(f"{CELLS}.length > 3")
    click(page, "#review-button")
    at = "return document.querySelector('#review-count')?.textContent.startsWith(arguments[0])"
    page.wait(at, "1 of ")
    first = page.run("return Number(document.querySelector('.rv-large').dataset.clip)")
    second = kick + squat - first
    assert page.wait("return document.querySelectorAll('.rv-small[data-drawn]').length") >= 4
    wrong, right = category(first), {kick: "kick_left", squat: "squat"}
    page.press("y")
    page.wait(at, "2 of ")
    assert category(first) == right[first]
    page.press("u")
    page.wait(at, "1 of ")
    assert category(first) == wrong
    page.press("n")
    page.wait(at, "2 of ")
    assert library.clips([first])[0].tags == ("checked",)
    assert page.run("return Number(document.querySelector('.rv-large').dataset.clip)") == second
    page.press("y")
    page.wait("return document.querySelector('#review-end, #review-count')?.textContent.startsWith('2 of ') === false")
    assert category(second) == right[second]
    page.driver.refresh()  # what was decided is not asked again
    page.wait("return document.querySelector('#review-end, #review-count')")
    assert page.run("return document.querySelector('.rv-large')?.dataset.clip") not in (str(first), str(second))
    page.press(KEYS.ESCAPE)
    wait_count(page, 24)


@pytest.mark.plain_workers
def test_an_empty_library_is_filled_with_the_demo_by_a_button(browser, tmp_path):
    with listening(Settings(tmp_path / "new.dousa", token=TOKEN)) as running:
        browser.resize(1280, 720)
        browser.driver.get(f"{running.url}/library?token={TOKEN}&lang=en")
        click(browser, "#demo-button")
        browser.wait(f"{CELLS}.length > 3")
        browser.wait("return document.querySelector('#forest-state').textContent.includes('up to date')")
        assert running.app.state.studio.library.stats().n_clips > 30
        assert browser.messages() == []
        browser.driver.get("about:blank")
