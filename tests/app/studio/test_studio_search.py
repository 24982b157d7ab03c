"""Searching: what the interface answers, and what the page shows of it."""

from __future__ import annotations

import json
import urllib.parse
from pathlib import Path

import pytest

SHARED = Path(__file__).resolve().parents[4] / "shared" / "data"


def clip_of(studio, category, n=0):
    """Name of a clip of a category."""
    return f"clip:{studio.app.state.studio.library.clips(category=category)[n].id}"


def add_take(library):
    """A take of two clips of the library, one after the other; its number."""
    import numpy as np

    from dousa.app.demo_takes import write_take
    from dousa.retrieval import LabelledClip

    parts = []
    for name in ("walk", "kick_left", "squat"):
        info = library.clips(category=name)[-1]
        parts.append(
            LabelledClip(
                name,
                name,
                "x",
                np.array(library.trajectories(info.id).positions),
                info.frame_rate,
                info.height,
            )
        )
    take = write_take(parts, (), Path(info.path).parent.parent / "take.bvh")
    report = library.add(take.path, kind="take")
    return library.clips([take.path])[0].id if not report.added else library.clips(list(report.added))[0].id


# --- the interface


def test_a_clip_finds_its_like(studio):
    kick = clip_of(studio, "kick_left")
    answer = studio.post("/api/search", json={"query": {"motion": kick}, "k": 5}).json()
    assert answer["category"] == "kick_left"
    assert [hit["category"] for hit in answer["results"][:4]] == ["kick_left"] * 4
    assert answer["results"][0]["motion"] == kick
    assert "places" not in answer


def test_an_uploaded_file_and_a_part_of_it_are_searched_for(studio, bvh):
    came = studio.post("/api/uploads?name=new.bvh", content=bvh.read_bytes()).json()
    motion = came["files"][0]["motion"]
    whole = studio.post("/api/search", json={"query": {"motion": motion}}).json()
    assert whole["results"][0]["path"] == str(bvh)
    part = studio.post("/api/search", json={"query": {"motion": motion, "start_s": 0.4, "end_s": 1.2}}).json()
    assert part["results"]
    assert part["results"][0]["distance"] > whole["results"][0]["distance"]


def test_reasons_come_when_asked_for(studio):
    asked = {"query": {"motion": clip_of(studio, "squat")}, "explain": True, "mirror": True, "k": 3}
    answer = studio.post("/api/search", json=asked).json()
    assert answer["explanation"]["reasons"]
    assert all("likeness" in hit for hit in answer["results"])
    assert "fits_better" in answer["mirrored"]


def test_places_inside_takes_are_found(studio):
    take = add_take(studio.app.state.studio.library)
    asked = {"query": {"motion": clip_of(studio, "kick_left", 1)}, "inside_takes": True}
    place = studio.post("/api/search", json=asked).json()["places"][0]
    assert place["motion"] == f"clip:{take}"
    assert 0 < place["start_s"] < place["end_s"]


def test_without_takes_there_are_no_places(studio):
    asked = {"query": {"motion": clip_of(studio, "kick_left")}, "inside_takes": True}
    assert studio.post("/api/search", json=asked).json()["places"] == []


def test_a_take_as_a_whole_is_no_query(studio):
    take = add_take(studio.app.state.studio.library)
    answer = studio.post("/api/search", json={"query": {"motion": f"clip:{take}"}})
    assert answer.status_code == 404
    assert "is the take" in answer.json()["problem"]


@pytest.mark.parametrize(
    "body",
    [
        {},
        {"query": {"motion": "walk.bvh"}},
        {"query": {"motion": "clip:1"}, "k": 0},
        {"query": {"motion": "clip:1"}, "k": 10**9},
        {"query": {"motion": "clip:1"}, "ranking": "best"},
        {"query": {"motion": "clip:1"}, "threshold": 2},
        {"query": {"motion": "clip:1"}, "surprise": 1},
        {"query": {"motion": "clip:1", "start_s": 100, "end_s": 101}},
    ],
)
def test_questions_that_make_no_sense_are_refused(studio, body):
    answer = studio.post("/api/search", json=body)
    assert answer.status_code == 422
    assert answer.json()["problem"]


def test_motions_are_classified_one_by_one(studio):
    asked = {"motions": [{"motion": clip_of(studio, "walk")}, {"motion": "clip:99999"}]}
    walk, missing = studio.post("/api/classify", json=asked).json()["answers"]
    assert walk["category"] == "walk"
    assert walk["histogram"]["walk"] > 0.5
    assert missing["category"] is None
    assert "99999" in missing["problem"]


def test_an_untrained_library_says_so(tmp_path):
    from starlette.testclient import TestClient

    from dousa.app.studio import Settings, create_app

    with TestClient(
        create_app(Settings(tmp_path / "new.dousa", token="t")), "http://127.0.0.1:8765"
    ) as client:
        client.headers["authorization"] = "Bearer t"
        for path, body in (
            ("search", {"query": {"motion": "clip:1"}}),
            ("classify", {"motions": [{"motion": "clip:1"}]}),
        ):
            answer = client.post(f"/api/{path}", json=body)
            assert answer.status_code == 409
            assert "train" in answer.json()["problem"]


# --- the page

DRAWN = (
    "return document.querySelectorAll('.hit').length > 3 && document.querySelector('.verdict-words') !== null"
)
FIGURES = "return dousa.miniatures.count"


def first_clip(running, category="kick_left"):
    return f"clip:{running.app.state.studio.library.clips(category=category)[0].id}"


def find_query_file(bvh):
    """A real recording if there is one here, else a made one."""
    if SHARED.is_dir():
        real = sorted((SHARED / "bandai").rglob("*.bvh")) or sorted(SHARED.rglob("*.bvh"))
        if real:
            return real[0]
    return bvh


def test_a_dropped_file_is_searched_for_and_plays_in_step(show, running, bvh):
    page = show("/search")
    page.wait("return document.querySelector('#query-file') !== null")
    page.find("#query-file").send_keys(str(find_query_file(bvh)))
    page.wait(DRAWN)
    page.wait(f"{FIGURES} > 3")
    assert "motion=file" in page.run("return location.search")
    drawn = page.run("return dousa.miniatures.drawn")
    page.wait("return dousa.miniatures.drawn > arguments[0] + 10", drawn)
    before = page.run("return document.querySelector('.tl-cursor').getAttribute('aria-valuenow')")
    page.wait(
        "return document.querySelector('.tl-cursor').getAttribute('aria-valuenow') !== arguments[0]", before
    )
    assert page.messages() == []


def test_a_hit_is_shown_beside_the_query_and_can_be_downloaded(show, running, tmp_path):
    page = show(f"/search?motion={first_clip(running)}")
    page.wait(DRAWN)
    page.run("document.querySelector('.hit-open').click()")
    page.wait("return document.querySelector('.dousa-player[data-mode=side]') !== null")
    page.wait("return document.querySelector('#download') !== null")
    assert "hit=clip" in page.run("return location.search")
    address = page.run("return document.querySelector('#download').getAttribute('href')")
    text = page.driver.execute_async_script(
        "const done = arguments[1]; fetch(arguments[0]).then((answer) => answer.text()).then(done);", address
    )
    assert text.startswith("HIERARCHY")
    page.driver.refresh()
    page.wait("return document.querySelector('.dousa-player[data-mode=side]') !== null")
    page.driver.back()
    page.wait("return document.querySelector('#match').hidden")
    assert page.messages() == []


def test_reasons_are_told_when_asked_for(show, running):
    page = show(f"/search?motion={first_clip(running, 'squat')}")
    page.wait(DRAWN)
    page.run("document.querySelector('.hit .why summary').click()")
    page.wait(
        "return document.querySelector('.hit .why .reasons li, .hit .why .note:not(:only-child)') !== null"
    )
    page.run("document.querySelector('#verdict .why summary').click()")
    page.wait("return document.querySelectorAll('#verdict .reasons li').length > 0")
    assert page.messages() == []


def test_a_part_is_chosen_by_keyboard_and_by_mouse(show, running):
    page = show(f"/search?motion={first_clip(running)}")
    page.wait(DRAWN)
    page.run("document.querySelector('.tl-cursor').focus()")
    page.press("\ue011", *["\ue014"] * 4)  # home, right
    page.press("[")
    page.press(*["\ue014"] * 6)
    page.press("]")
    page.wait("return location.search.includes('start_s=0') && location.search.includes('end_s=')")
    page.press("\ue00c")  # Escape
    page.wait("return !location.search.includes('start_s')")
    page.run("""
        const inner = document.querySelector('.tl-inner'), box = inner.getBoundingClientRect();
        const at = (share) => ({clientX: box.left + share * box.width, clientY: box.top + 50, bubbles: true,
          pointerId: 1, pointerType: 'mouse', button: 0, cancelable: true});
        document.querySelector('.tl-track').dispatchEvent(new PointerEvent('pointerdown', at(0.25)));
        for (const share of [0.3, 0.5, 0.75]) window.dispatchEvent(new PointerEvent('pointermove', at(share)));
        window.dispatchEvent(new PointerEvent('pointerup', at(0.75)));
    """)
    page.wait("return location.search.includes('start_s')")
    page.wait(DRAWN)
    page.driver.back()
    page.wait("return !location.search.includes('start_s')")
    assert page.messages() == []


def test_places_inside_takes_open_at_their_moment(show, running):
    take = add_take(running.app.state.studio.library)
    page = show(f"/search?motion={first_clip(running)}")
    page.wait("return document.querySelector('.place-open') !== null")
    link = page.run("return document.querySelector('.place a').getAttribute('href')")
    assert link.startswith(f"/takes?motion=clip:{take}&at_s=")
    page.run("document.querySelector('.place-open').click()")
    page.wait("return document.querySelector('.dousa-player[data-mode=side]') !== null")
    assert f"hit=clip%3A{take}" in page.run("return location.search")
    assert "other_start_s=" in page.run("return location.search")
    assert page.messages() == []


def test_unknown_is_said_in_words(show, running):
    """With the highest bar nothing is known; the nearest guess is told all the same."""
    page = show(f"/search?motion={first_clip(running)}&threshold=1")
    page.wait("return document.querySelector('.verdict-words') !== null")
    known = page.run("return document.querySelector('#verdict').textContent")
    answer = running.app.state.studio.library.search(int(first_clip(running)[5:]), threshold=1)
    if answer.verdict.known is not None:
        assert "Unknown" in known
        assert "kick_left" in known
    assert page.messages() == []


def test_options_are_kept_in_the_address(show, running):
    page = show(f"/search?motion={first_clip(running)}")
    page.wait(DRAWN)
    page.run("""
        const select = document.querySelector('select[name=ranking]');
        select.value = 'pose';
        select.dispatchEvent(new Event('change'));
    """)
    page.wait("return location.search.includes('ranking=pose')")
    page.run("document.querySelector('input[name=mirror]').click()")
    page.wait("return location.search.includes('mirror=1')")
    page.wait(DRAWN)
    assert page.messages() == []


def test_an_untrained_library_points_to_training(browser, tmp_path):
    from app.studio.conftest import listening
    from dousa.app.studio import Settings

    with listening(Settings(tmp_path / "new.dousa", token="t")) as found:
        browser.driver.get_log("browser")
        browser.driver.get(f"{found.url}/search?token=t&lang=en")
        browser.wait("return document.querySelector('#start .empty a') !== null")
        assert (
            browser.run("return document.querySelector('#start .empty a').getAttribute('href')") == "/library"
        )
        assert browser.messages() == []


@pytest.mark.parametrize(
    ("width", "height", "scheme", "language"),
    [(1280, 720, "light", "en"), (1280, 720, "dark", "ja"), (390, 844, "light", "ja")],
)
def test_it_fits_and_every_word_is_there(show, running, tmp_path, width, height, scheme, language):
    page = show(f"/search?motion={first_clip(running)}", width, height, scheme, language)
    page.wait(DRAWN)
    page.wait(f"{FIGURES} > 3")
    page.run("document.querySelector('.hit-open').click()")
    page.wait("return document.querySelector('#download') !== null")
    page.screenshot(tmp_path / "search.png")
    assert page.run("return document.documentElement.scrollWidth") <= width
    text = page.run("return document.querySelector('main').innerText")
    words = json.loads(page.run("return document.getElementById('words').textContent"))
    left = [name for name in words if "_" in name and name in text.split()]
    assert left == []
    nameless = page.run("""
        return [...document.querySelectorAll('main button, main a, main [role=slider], main input, main select')]
          .filter((one) => !one.hidden && one.getAttribute('aria-hidden') !== 'true')
          .filter((one) => !(one.textContent.trim() || one.ariaLabel || one.title || one.labels?.length))
          .map((one) => one.outerHTML.slice(0, 120))
    """)
    assert nameless == []
    assert page.messages() == []


def test_the_address_names_its_motion_safely(show, running):
    page = show("/search?" + urllib.parse.urlencode({"motion": "file:0123456789abcdef/<img src=x>.bvh"}))
    page.wait("return document.querySelector('.notice.problem') !== null")
    assert page.run("return document.querySelector('main img')") is None
