"""What every page of the studio owes to whoever looks at it, hears it read out, or types instead of pointing."""

import pytest

KEYS = pytest.importorskip("selenium.webdriver", reason="selenium is not installed: pip install selenium").Keys

PAGES = ("/library", "/search?motion=clip:1", "/takes", "/evaluate?references=clip:1", "/estimate", "/live", "/api")

# What a screen reader would call each thing that can be used; those without a name are returned.
UNNAMED = """
const named = (e) => e.getAttribute('aria-label') || e.textContent.trim() || e.title || e.placeholder
  || [...(e.labels ?? [])].some((label) => label.textContent.trim())
  || (e.getAttribute('aria-labelledby') ?? '').split(' ').some((id) => document.getElementById(id)?.textContent.trim());
return [...document.querySelectorAll('button, input, select, textarea, a[href], summary, [role=slider], dialog')]
  .filter((e) => e.checkVisibility() && e.getAttribute('aria-hidden') !== 'true' && !named(e))
  .map((e) => e.outerHTML.slice(0, 120));
"""

# Text that does not stand out from what is behind it as WCAG AA asks (4.5, large letters 3).
PALE = """
const canvas = document.createElement('canvas').getContext('2d', { willReadFrequently: true });
const read = (colour) => {
  canvas.clearRect(0, 0, 1, 1);
  canvas.fillStyle = colour;
  canvas.fillRect(0, 0, 1, 1);
  const [r, g, b, a] = canvas.getImageData(0, 0, 1, 1).data;
  return [r, g, b, a / 255];
};
const over = (top, below) => [0, 1, 2].map((i) => top[i] * top[3] + below[i] * (1 - top[3])).concat(1);
const bend = (v) => (v <= 10 ? v / 3294.6 : ((v / 255 + 0.055) / 1.055) ** 2.4);
const light = (c) => 0.2126 * bend(c[0]) + 0.7152 * bend(c[1]) + 0.0722 * bend(c[2]);
const behind = (element) => {
  const layers = [];
  for (let e = element; e; e = e.parentElement) {
    const style = getComputedStyle(e);
    if (style.backgroundImage !== 'none') return null; // drawn, not a colour
    layers.push(read(style.backgroundColor));
    if (layers.at(-1)[3] === 1) break;
  }
  return layers.reduceRight((below, top) => over(top, below), [255, 255, 255, 1]);
};
const pale = [];
for (const e of document.querySelectorAll('body *')) {
  const texts = [...e.childNodes].some((node) => node.nodeType === 3 && node.textContent.trim());
  const box = e.getBoundingClientRect();
  if (!texts || !e.checkVisibility() || box.width < 2 || e.closest(':disabled, svg, script, style')) continue;
  const ground = behind(e);
  if (!ground) continue;
  const style = getComputedStyle(e);
  const [high, low] = [light(over(read(style.color), ground)), light(ground)].sort((a, b) => b - a);
  const least = parseFloat(style.fontSize) >= 24 ? 3 : 4.5;
  if ((high + 0.05) / (low + 0.05) < least - 0.01) pale.push(`${e.className}: ${e.textContent.trim().slice(0, 40)}`);
}
return pale;
"""

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

# Words in empty fields that have no room.
CUT_HINTS = """
const canvas = document.createElement('canvas').getContext('2d');
return [...document.querySelectorAll('input[placeholder], textarea[placeholder]')].filter((one) => {
  if (!one.checkVisibility() || one.tagName === 'TEXTAREA') return false;
  const style = getComputedStyle(one);
  canvas.font = style.font;
  const room = one.clientWidth - parseFloat(style.paddingLeft) - parseFloat(style.paddingRight);
  return canvas.measureText(one.placeholder).width > room + 1;
}).map((one) => one.placeholder);
"""

# Where Japanese stands, the font for it comes first: behind others Chromium may draw boxes instead of letters.
WITHOUT_THE_FONT = """
const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
const found = [];
while (walker.nextNode()) {
  const element = walker.currentNode.parentElement;
  if (!element.checkVisibility() || !/[\\u3040-\\u30ff\\u4e00-\\u9fff]/.test(walker.currentNode.textContent)) continue;
  if (!/^"?dousa-ja/.test(getComputedStyle(element).fontFamily)) found.push(walker.currentNode.textContent.trim());
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


def check_frame(page, width):
    """The page is no wider than its window, has one heading, and all that can be used has a name."""
    assert page.run("return document.documentElement.scrollWidth") <= width
    assert page.run(UNNAMED) == []
    assert page.run("return [...document.querySelectorAll('h1')].filter((e) => e.checkVisibility()).length") == 1
    assert page.messages() == []


def check_hints(page):
    """What stands in empty fields has room, on a phone and on screens."""
    for width in (390, 1280, 1440):
        page.resize(width, 844)
        page.settle()
        assert page.run(CUT_HINTS) == [], width


@pytest.mark.parametrize("path", PAGES)
def test_on_a_phone_and_at_twice_the_size_nothing_runs_out_of_the_window(settled, path):
    page = settled(path, width=390, height=844)
    check_frame(page, 390)
    page.resize(640, 360)
    page.settle()
    assert page.run("return document.documentElement.scrollWidth") <= 640


@pytest.mark.parametrize("path", (*PAGES, "/takes?motion=clip:1"))
def test_a_page_fits_its_window_and_text_stands_out_in_both_schemes(settled, path):
    page = settled(path)
    check_frame(page, 1280)
    for scheme in ("light", "dark"):
        page.paint(scheme)
        page.settle()
        assert page.run(f"return matchMedia('(prefers-color-scheme: {scheme})').matches")
        assert page.run(PALE) == [], scheme
    check_hints(page)


@pytest.mark.parametrize("path", (*PAGES, "/takes?motion=clip:1"))
def test_the_japanese_page_is_japanese_and_fits_its_fields(settled, path):
    page = settled(path, language="ja")
    assert page.run("return document.documentElement.lang") == "ja"
    assert page.run(WITHOUT_THE_FONT) == []
    names = {"walk", "squat"}  # categories of the library
    assert [text for text in page.run(LEFT_IN_ENGLISH) if text not in names and "performer" not in text] == []
    assert page.run("return document.body.innerText").count("{") == 0 or path == "/api"
    assert page.messages() == []
    check_hints(page)


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
    assert page.messages() == []


def test_two_requests_that_fail_for_one_reason_say_it_once_and_in_japanese(settled):
    page = settled("/library", language="ja")
    said = page.driver.execute_async_script(
        """
        const done = arguments[0];
        const base = document.querySelector('script[src*="core/frame"]').src.replace('frame.js', '');
        Promise.all([import(`${base}api.js`), import(`${base}notices.js`)]).then(async ([api, notices]) => {
          for (const again of [1, 2]) await notices.attempt(() => api.get('/motions/info', { motion: 'clip:999' }));
          done([...document.querySelectorAll('.notice p')].map((p) => p.textContent));
        });
        """
    )
    assert said == ["クリップ 999 はもうライブラリーにありません"]
    assert all("/api/motions/info" in text for text in page.messages())


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
