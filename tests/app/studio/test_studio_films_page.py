"""The page of estimation from films in Chromium: films dropped, seen at one moment, people chosen and left out by a
click, cameras in space, fitted again, and on to a BVH on the disk."""

import base64
import urllib.request
from pathlib import Path

import numpy as np
import pytest

from app.studio.film_scenes import LATE, N_FRAMES, write_film_scene
from app.studio.test_studio_estimate_page import CAN_START, is_within, text

KEYS = pytest.importorskip("selenium.webdriver", reason="selenium is not installed: pip install selenium").Keys
pytest.importorskip("av", reason="the reader of films is not installed: pip install 'dousa[film]'")

N_SHARED = N_FRAMES - LATE
FITTED = "return !document.querySelector('#film-figure-card').hidden && document.querySelector('#film-figure canvas')"
DRAWN = "return [...document.querySelectorAll('.film-view')].every((view) => view.dataset.frame === arguments[0])"


@pytest.fixture(scope="module")
def scene(tmp_path_factory) -> Path:
    """Two films of two people, their keypoints, and the cameras: which start together."""
    folder = tmp_path_factory.mktemp("films")
    write_film_scene(folder)
    return folder


def drop(page, *paths: Path) -> None:
    page.find("#material").send_keys("\n".join(map(str, paths)))


def ask(running, path: str) -> bytes:
    headers = {"authorization": f"Bearer {running.token}"}
    with urllib.request.urlopen(urllib.request.Request(f"{running.url}/api{path}", headers=headers)) as answer:
        return answer.read()


def click_on(page, running, job: str, view: int, track: int, frame: int) -> None:
    """Click on the middle of somebody's trunk."""
    import json

    names = json.loads(ask(running, f"/estimations/{job}/film"))["names"]
    came = json.loads(ask(running, f"/estimations/{job}/film/people/{view}?first={frame}&count=1"))
    points = np.frombuffer(base64.b64decode(came["points"]), "<i2").reshape(came["people"], 1, -1, 2) / 16384
    x, y = points[track, 0, [names.index(f"left_{name}") for name in ("shoulder", "hip")]].mean(axis=0)
    page.run(
        "const canvas = document.querySelectorAll('.film-view canvas')[arguments[0]];"
        "const box = canvas.getBoundingClientRect();"
        "canvas.dispatchEvent(new MouseEvent('click', {bubbles: true,"
        " clientX: box.left + arguments[1] * box.width, clientY: box.top + arguments[2] * box.height}))",
        view,
        float(x),
        float(y),
    )


def go_to(page, frame: int) -> None:
    page.run(
        "const f = document.querySelector('#film-frame'); f.value = arguments[0];"
        "f.dispatchEvent(new Event('input', {bubbles: true}))",
        frame,
    )
    page.wait(DRAWN, str(frame))


def job_of(page) -> str:
    return page.driver.current_url.split("job=")[1].split("&")[0]


def enlarge_and_return(page) -> None:
    """A click beside everybody enlarges a film, Escape ends it; the keyboard reaches the same by a button."""
    page.run(
        "document.querySelector('.film-view canvas').dispatchEvent(new MouseEvent('click', {clientX: -9, clientY: -9}))"
    )
    page.wait("return document.querySelector('.film-view.large') !== null")
    shown = "return [...document.querySelectorAll('.film-view')].filter((view) => view.checkVisibility()).length"
    assert page.run(shown) == 1
    page.press(KEYS.ESCAPE)
    page.wait("return document.querySelector('.film-view.large') === null")
    page.find(".film-view .enlarge").send_keys(KEYS.ENTER)
    assert page.run(shown) == 1
    page.find(".film-view .enlarge").send_keys(KEYS.ENTER)
    assert page.run(shown) == 3


COVERED = """
const canvas = document.querySelector('#film-space');
const { data } = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
let covered = 0;
for (let at = 3; at < data.length; at += 4) covered += data[at] === 255;
return covered / (canvas.width * canvas.height);
"""


def look_at_the_cameras(page) -> None:
    """The pictures of all films stand where they were taken, and go with the clock."""
    space = "const c = document.querySelector('#film-space'); "
    assert page.run(space + "return c.dataset.pictures") == "3"
    assert page.run(COVERED) > 0.05  # lines alone cover less
    before = page.run(space + "return c.toDataURL()")
    go_to(page, 10)
    page.wait(space + "return c.toDataURL() !== arguments[0]", before)
    turned = page.run(space + "return c.toDataURL()")
    page.find("#film-space").send_keys(KEYS.ARROW_LEFT)
    assert page.run(space + "return c.toDataURL()") != turned
    go_to(page, 33)


def choose_the_other(page, running, job: str) -> None:
    """The other person by a click in the first film, where they are the first track; in the third a track is left out,
    and somebody else is said to be them, until that is taken back."""
    click_on(page, running, job, 0, 0, 33)
    assert text(page, ".film-menu b") == "Person 2"
    page.run("document.querySelector('.film-menu button').click()")
    assert text(page, ".person.chosen .person-name").startswith("Person 2")
    click_on(page, running, job, 2, 1, 33)
    page.run("[...document.querySelectorAll('.film-menu button')].at(-1).click()")
    out = "return document.querySelectorAll('.tracks li.out').length"
    assert page.run(out) == 1
    click_on(page, running, job, 2, 0, 33)
    page.run("document.querySelectorAll('.film-menu button')[1].click()")
    also = "return document.querySelector('#film-people').textContent.includes('view3 → 2')"
    assert page.run(also)
    for _ in range(2):
        page.run("document.querySelector('[data-key=track-2-0]').click()")
    assert not page.run(also) and page.run(out) == 1
    assert "need not be found again" in text(page, ".changes")


def test_from_films_to_the_motion_of_another_person(show, running, scene, tmp_path):
    page = show("/estimate")
    names = [f"view{k}{suffix}" for k in (1, 2, 3) for suffix in (".mp4", ".npz")] + ["cameras.toml"]
    drop(page, *(scene / name for name in names))
    page.wait(CAN_START)
    assert page.run("return document.querySelectorAll('.pictures img').length") == 3
    assert "3 films, up to 80 frames at 30 Hz" in text(page, "#preview")
    assert not page.run("return document.querySelector('[name=overlay_video]').checked")
    page.find("#start").click()

    page.wait(FITTED)
    page.wait("return !document.querySelector('#outcome').hidden")
    first = job_of(page)
    assert "view3 0.40 s later" in text(page, "#film-starts")
    assert page.run("return document.querySelector('.watch-columns').hidden")
    assert len(page.run("return [...document.querySelectorAll('.person')].map((e) => e.dataset.person)")) == 2
    assert text(page, ".person.chosen .person-name").startswith("Person 1")
    assert page.run("return document.querySelectorAll('#film-cameras li').length") == 3
    assert page.run("return document.querySelector('#film-chart .curve') !== null")
    go_to(page, 33)
    assert text(page, "#film-now").startswith(f"frame 34 of {N_SHARED}")

    look_at_the_cameras(page)
    enlarge_and_return(page)

    choose_the_other(page, running, first)
    assert page.messages() == []
    page.find("#fit-again").click()
    page.wait("return !location.search.includes(arguments[0])", first)
    page.wait(FITTED)
    page.wait("return !document.querySelector('#outcome').hidden")
    second = job_of(page)
    assert page.run("return document.querySelectorAll('.tracks li.out').length") == 1
    assert page.messages() == []

    address = page.run("return document.querySelector('a[download=\"motion.bvh\"]').getAttribute('href')")
    (tmp_path / "mine.bvh").write_bytes(ask(running, address.removeprefix("/api")))
    from dousa import read_motion

    assert read_motion(tmp_path / "mine.bvh").n_frames == N_SHARED

    for width, height, scheme in ((390, 844, "dark"), (1280, 720, "light")):
        page = show(f"/estimate?job={second}", width, height, scheme, "ja")
        page.wait(FITTED)
        assert "0.40 秒後" in text(page, "#film-starts") and is_within(page)
        page.wait("return document.querySelector('#film-space').dataset.pictures === '3'")
        page.wait(DRAWN, "0")
        assert page.messages() == []
    page.find("#search-it").click()
    page.wait("return location.pathname === '/search' && document.readyState === 'complete'")


def test_stopped_reloaded_and_resumed(show, running, scene):
    """Also with keypoints alone: there is nothing to see but the people."""
    page = show("/estimate", 390, 844)
    drop(page, scene / "view1.npz", scene / "view2.npz", scene / "cameras.toml")
    page.wait(CAN_START)
    page.find("#start").click()
    page.wait("return document.querySelectorAll('.tracks li').length === 4")
    if page.run("return document.querySelector('#watch-stop') !== null"):  # else it was quicker
        page.find("#watch-stop").click()
    page.wait(
        "return document.querySelector('#watch-resume') || document.querySelector('#film-figure canvas')", seconds=60
    )
    page.driver.refresh()
    page.wait("return document.querySelectorAll('.film-view[data-frame]').length === 2")
    assert is_within(page)
    page.wait("return document.querySelector('#watch-new')")
    if page.run("return document.querySelector('#watch-resume') !== null"):
        page.find("#watch-resume").click()
    page.wait(FITTED)
