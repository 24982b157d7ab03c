"""The map of all clips: the job that makes it, what is told of it as clips change, and the page with its lasso."""

import numpy as np
import pytest

from app.studio.library_page import click
from dousa.library import Library

pytest.importorskip("sklearn", reason="scikit-learn is not installed: pip install 'dousa[map]'")
KEYS = pytest.importorskip("selenium.webdriver", reason="selenium is not installed: pip install selenium").Keys
N = 24
MAP = "document.querySelector('.mp-over')?.map"
CHOSEN = "return document.querySelector('.chosen-count')?.textContent ?? ''"


@pytest.fixture
def mapped(studio, wait_job):
    """A studio whose map is made."""
    job = wait_job(studio, studio.post("/api/jobs/map").json()["id"])
    assert job["state"] == "done" and job["result"] == {"n_clips": N, "n_laid_out": N, "n_left_out": 0}
    return studio


def test_without_a_map_that_is_said(studio):
    told = studio.get("/api/map").json()
    assert (told["is_made"], told["ids"], told["n_new"]) == (False, [], N)


@pytest.mark.plain_workers
def test_the_map_has_every_clip_with_its_category(mapped):
    told = mapped.get("/api/map").json()
    clips = {clip["id"]: clip for clip in mapped.get("/api/clips", params={"limit": 100}).json()["items"]}
    named = {number: told["categories"][code] for number, code in zip(told["ids"], told["category"], strict=True)}
    assert named == {number: clip["category"] for number, clip in clips.items()}
    assert told["is_made"] and (told["n_new"], told["n_left_out"]) == (0, 0)
    assert max(map(abs, told["x"] + told["y"])) == pytest.approx(1)


def test_the_map_follows_labels_and_drops_clips_that_are_gone(mapped, library_copy):
    first = mapped.get("/api/map").json()
    with Library.open(library_copy) as library:
        library.relabel([first["ids"][0]], category="new name")
        library.remove([first["ids"][1]])
    told = mapped.get("/api/map").json()
    assert "new name" in told["categories"] and len(told["ids"]) == N - 1
    assert told["x"][0] == first["x"][0] and told["n_new"] == 0
    mapped.post("/api/journal/undo", json={})
    assert mapped.get("/api/map").json()["ids"] == first["ids"]


def test_a_clip_with_another_content_is_not_on_the_map_any_more(mapped, monkeypatch):
    contents = Library.contents
    monkeypatch.setattr(Library, "contents", lambda self, ids: contents(self, ids) | {ids[0]: "other"})
    mapped.app.state.studio.map._told = None
    told = mapped.get("/api/map").json()
    assert (len(told["ids"]), told["n_new"]) == (N - 1, 1)


def test_a_damaged_map_is_no_map(mapped):
    path = mapped.app.state.studio.workspace.root / "map.json"
    path.write_bytes(path.read_bytes()[:200])
    assert not mapped.get("/api/map").json()["is_made"]


def test_one_job_makes_it_for_all_who_ask(studio, wait_job):
    jobs = {studio.post("/api/jobs/map").json()["id"] for _ in range(3)}
    assert len(jobs) == 1
    wait_job(studio, jobs.pop())


# --- the page


@pytest.fixture
def map_page(show):
    """``map_page(...)``: the page when the map stands there; it is made when it is asked for first."""

    def open_page(path="/library?view=map", **look):
        page = show(path, **look)
        page.wait(f"return {MAP}?.ids.length === {N}")
        page.settle()
        return page

    return open_page


def lasso(page, ids, held=""):
    """Draw a line around clips, a little outside of them."""
    from selenium.webdriver import ActionChains

    script = f"const m = {MAP}; return m.ids.map((id, k) => [id, m.places[2 * k], m.places[2 * k + 1]])"
    places = {number: (x, y) for number, x, y in page.run(script)}
    own = np.array([places[number] for number in ids])
    (left, top), (right, bottom) = own.min(axis=0) - 7, own.max(axis=0) + 7
    inside = {n for n, (x, y) in places.items() if left < x < right and top < y < bottom}
    width, height = page.run(f"const m = {MAP}; return [m.view.width, m.view.height]")
    actions = ActionChains(page.driver, duration=20)
    if held:
        actions.key_down(held)
    corners = [(left, top), (right, top), (right, bottom), (left, bottom), (left, top + 2)]
    for step, (x, y) in enumerate(corners):
        actions.move_to_element_with_offset(page.find(".mp-over"), round(x - width / 2), round(y - height / 2))
        if step == 0:
            actions.click_and_hold()
    actions.release()
    if held:
        actions.key_up(held)
    actions.perform()
    page.settle()
    return inside


def of_category(page, name):
    script = f"const m = {MAP}; return m.ids.filter((id, k) => m.groups[m.group[k]].name === arguments[0])"
    return page.run(script, name)


def test_a_lasso_chooses_and_shift_adds_to_it(map_page):
    page = map_page()
    first = lasso(page, of_category(page, "squat"))
    assert first >= set(of_category(page, "squat"))
    page.wait(f"{CHOSEN.replace('return ', 'return (')}).startsWith('{len(first)} ')")
    both = first | lasso(page, of_category(page, "walk"), held=KEYS.SHIFT)
    page.wait(f"{CHOSEN.replace('return ', 'return (')}).startsWith('{len(both)} ')")
    left = both - lasso(page, of_category(page, "walk"), held=KEYS.ALT)
    page.wait(f"{CHOSEN.replace('return ', 'return (')}).startsWith('{len(left)} ')")
    click(page, "#view-grid")
    page.wait("return document.querySelectorAll('.cell[aria-selected=true]').length > 0")


def test_what_is_pointed_at_is_named_and_moves(map_page):
    page = map_page()
    x, y = page.run(f"const m = {MAP}; return [m.places[0] - m.view.width / 2, m.places[1] - m.view.height / 2]")
    page.point(page.find(".mp-over"), round(x), round(y))
    page.wait("return document.querySelector('.mp-tip:not([hidden]) canvas')")
    name = page.run(f"return fetch(`/api/clips/${{{MAP}.ids[0]}}`).then((answer) => answer.json())")["name"]
    assert name in page.run("return document.querySelector('.mp-tip').textContent")
    page.wait(f"return {MAP}.miniature.share > 0")
    page.find("h1").click()
    assert page.run("return document.querySelector('.mp-tip').hidden")


def test_filter_and_legend_leave_clips_out_of_the_lasso(map_page):
    page = map_page("/library?view=map&category=squat")
    page.wait(f"return {MAP}.fits !== null")
    everything = page.run(f"return {MAP}.ids")
    lasso(page, everything)
    page.wait(f"{CHOSEN.replace('return ', 'return (')}).startsWith('6 ')")
    click(page, "#clear-filter, #chips button:last-child")
    page.wait(f"return {MAP}.fits === null")
    click(page, ".mp-row[data-name='walk']")
    lasso(page, everything)
    page.wait(f"{CHOSEN.replace('return ', 'return (')}).startsWith('6 ')")
    assert page.run("return document.querySelector('.mp-row[data-name=walk]').getAttribute('aria-pressed')") == "true"


def test_wheel_and_keys_move_the_map(map_page):
    page = map_page()
    place = f"const m = {MAP}; return [m.view.zoom, m.view.x, m.view.y]"
    page.run("document.querySelector('.mp-over').focus()")
    page.press("+", KEYS.ARROW_RIGHT)
    zoom, x, y = page.run(place)
    assert zoom > 1.3 and x > 0 and y == 0
    page.press("0")
    assert page.run(place) == [1, 0, 0]
    turned = "new WheelEvent('wheel', { deltaY: -400, clientX: 600, clientY: 500, cancelable: true })"
    page.run(f"{MAP}.over.dispatchEvent({turned})")
    assert page.run(place)[0] > 1.5
    click(page, ".mp-bar [data-mode=move]")
    assert page.run(f"return {MAP}.view.mode") == "move"


def test_new_clips_are_counted_until_the_map_is_made_anew(map_page, running, bvh, tmp_path):
    page = map_page()
    text = bvh.read_text()
    (tmp_path / "again.bvh").write_text(text[: text.rindex("Frames:")] + cut(text))
    running.app.state.studio.library.add([tmp_path / "again.bvh"], category_from=None)
    page.run("document.dispatchEvent(new Event('visibilitychange'))")
    page.wait("return document.querySelector('#map-renew')")
    assert "1 not on it yet" in page.run("return document.querySelector('.mp-state').textContent")
    click(page, "#map-renew")
    page.wait(f"return {MAP}.ids.length === {N + 1}")
    page.wait("return !document.querySelector('#map-renew')")


def cut(text):
    """The motion of a BVH file without its last frames."""
    lines = text[text.rindex("Frames:") :].splitlines()
    kept = lines[2:-9]
    return "\n".join([f"Frames: {len(kept)}", lines[1], *kept]) + "\n"
