"""What every page of the studio owes to whoever looks at it, hears it read out, or types instead of pointing."""

import pytest

KEYS = pytest.importorskip("selenium.webdriver", reason="selenium is not installed: pip install selenium").Keys

PAGES = ("/library", "/search?motion=clip:1", "/takes", "/evaluate?references=clip:1", "/estimate", "/live", "/api")


# English words on the Japanese page outside of names, code and what is marked as English.
LEFT_IN_ENGLISH = """
const walker = document.createTreeWalker(document.querySelector('main'), NodeFilter.SHOW_TEXT);
const found = [];
while (walker.nextNode()) {
  const element = walker.currentNode.parentElement;
  if (!element.checkVisibility() || element.closest('[lang=en], code, pre, script')) continue;
  const text = (element.closest('.cut') ?? walker.currentNode).textContent.trim(); // names stand in two pieces
  if (/[a-z]{3,}/.test(text) && !/[\\u3040-\\u30ff\\u4e00-\\u9fff]/.test(text) && !/[._/]/.test(text)) found.push(text);
}
return found;
"""


@pytest.fixture
def settled(show):
    """``settled(path, ...)``: the page when nothing of it is loading any more."""

    def open_page(path, **look):
        page = show(path, **look)
        page.wait("return performance.getEntriesByType('resource').every((one) => one.responseEnd > 0)")
        if path.startswith("/search"):
            page.wait("return document.querySelectorAll('.hit').length > 3")
        if path == "/library":
            page.wait("return document.querySelectorAll('.cell').length > 3")
        page.settle()
        return page

    return open_page


@pytest.mark.parametrize("path", (*PAGES, "/takes?motion=clip:1"))
def test_a_page_fits_its_window_and_has_one_heading(settled, path):
    page = settled(path)
    assert page.run("return [...document.querySelectorAll('h1')].filter((e) => e.checkVisibility()).length") == 1
    for width, height in ((1280, 720), (640, 360), (390, 844)):
        page.resize(width, height)
        page.settle()
        assert page.run("return document.documentElement.scrollWidth") <= width


@pytest.mark.parametrize("path", (*PAGES, "/takes?motion=clip:1"))
def test_the_japanese_page_is_japanese(settled, path):
    page = settled(path, language="ja")
    assert page.run("return document.documentElement.lang") == "ja"
    names = {"walk", "squat"}  # categories of the library
    assert [text for text in page.run(LEFT_IN_ENGLISH) if text not in names and "performer" not in text] == []
    assert page.run("return document.body.innerText").count("{") == 0 or path == "/api"


def test_the_jobs_are_reached_and_left_by_keyboard(settled, running):
    page = settled("/library")
    studio = running.app.state.studio
    studio.jobs.submit("train", {"feature_set": "extended", "n_trees": 1}, "moves.dousa")
    page.find("#jobs-button").send_keys(KEYS.ENTER)
    page.wait("return document.querySelector('#jobs-tray .job[data-state=done]')")
    assert "took" in page.run("return document.querySelector('.job-times').textContent")
    page.press(KEYS.TAB)
    assert page.run("return document.activeElement.closest('#jobs-tray') !== null")
    page.press(KEYS.ESCAPE)
    assert page.run("return document.activeElement.id") == "jobs-button"
    assert page.run("return document.querySelector('#jobs-tray').hidden")


def test_finished_jobs_are_cleared_and_results_stay(settled, running):
    """What was trained and what failed are lines of the past; an evaluation is something to come back to."""
    from dousa.app.studio.jobs.board import Job

    page = settled("/library")
    board = running.app.state.studio.jobs
    for number, (kind, state) in enumerate([("train", "done"), ("add", "failed"), ("evaluate", "done")]):
        job = Job(f"{number:016x}", kind, kind, {}, state=state, started_s=1.0, finished_s=63.0, result={})
        board._jobs[job.id] = job
    page.find("#jobs-button").click()
    page.wait("return document.querySelectorAll('#jobs-tray .job').length === 3")
    assert page.run("return document.querySelector('.job-times').textContent") == "took 1:02"
    page.find("#jobs-clear").click()
    page.wait("return document.querySelectorAll('#jobs-tray .job').length === 1")
    assert [job.kind for job in board.all()] == ["evaluate"]


def test_who_looks_at_a_page_of_a_studio_that_is_gone_is_told(settled):
    page = settled("/library")
    page.driver.execute_cdp_cmd("Network.enable", {})
    offline = {"offline": True, "latency": 0, "downloadThroughput": -1, "uploadThroughput": -1}
    problem = "return [...document.querySelectorAll('.notice.problem p')].map((p) => p.textContent).join()"
    try:
        page.driver.execute_cdp_cmd("Network.emulateNetworkConditions", offline)
        page.wait(f"{problem}.startsWith('The studio does not answer')")
    finally:
        page.driver.execute_cdp_cmd("Network.emulateNetworkConditions", {**offline, "offline": False})
    page.wait("return document.querySelectorAll('.notice.problem').length === 0")
    page.messages()  # the browser notes what it could not reach
