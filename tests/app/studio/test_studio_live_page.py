"""The live page in a real Chromium with a made-up camera, and recorded keypoints in the network's place."""

import numpy as np
import pytest

from app.studio.live_people import record_landmarks, replay
from dousa.app.studio.content import live

DRAWN = """
const canvas = document.querySelector('#live-drawing');
const values = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data;
return values.some((value, at) => at % 4 === 3 && value > 0);
"""


@pytest.fixture
def camera(monkeypatch):
    monkeypatch.setattr(live, "choose_model", lambda: "full")
    monkeypatch.setattr(live, "open_finder", replay(record_landmarks("kick_left", 3, 15.0)))
    monkeypatch.setitem(live.LiveSession.__init__.__kwdefaults__, "grade_every", 0.5)


@pytest.mark.parametrize("language", ["en", pytest.param("ja", marks=pytest.mark.slow)])
def test_the_camera_shows_the_skeleton_the_label_the_grade_and_how_quick_it_is(camera, show, language):
    page = show("/live?reference=clip:1", language=language)
    page.wait("return !document.querySelector('#live-start').disabled")
    page.find("#live-start").click()
    page.wait(f"return (() => {{ {DRAWN} }})()")
    page.wait("return /[0-9]/.test(document.querySelector('#live-latency').textContent)")
    page.wait("return Number(document.querySelector('#live-grade').textContent) > 0")
    page.wait("return document.querySelector('#live-label').textContent === 'kick_left'")
    assert page.run("return document.querySelector('#live-hint').textContent") == ""
    page.find("#live-stop").click()
    page.wait("return document.querySelector('#live-stop').hidden")
    assert not page.run(DRAWN)
    assert page.run("return document.querySelector('#live-video').srcObject") is None
    assert [text for text in page.messages() if "willReadFrequently" not in text] == []  # we read, the page does not


def test_a_reference_is_chosen_and_stays_in_the_address(camera, show):
    page = show("/live")
    page.find("#live-reference").click()
    page.find(".pick").click()
    page.wait("return new URLSearchParams(location.search).get('reference')")
    assert not page.run("return document.querySelector('#live-no-reference').hidden")
    page.find("#live-no-reference").click()
    assert page.run("return new URLSearchParams(location.search).get('reference')") is None


def test_nobody_in_the_picture_is_told(camera, show, monkeypatch):
    monkeypatch.setattr(live, "open_finder", lambda: lambda picture: None)
    page = show("/live", width=390, height=844)
    page.wait("return !document.querySelector('#live-start').disabled")
    page.find("#live-start").click()
    page.wait("return document.querySelector('#live-hint').textContent.startsWith('Nobody is seen')")
    assert page.run("return document.documentElement.scrollWidth") <= 390
    page.find("#live-stop").click()


def test_without_models_the_page_says_what_to_run_and_does_not_start(show, monkeypatch, tmp_path):
    monkeypatch.setenv("DOUSA_MODELS", str(tmp_path))
    page = show("/live")
    page.wait("return document.querySelector('#live-problem .problem-box')")
    said = page.run("return document.querySelector('#live-problem').textContent")
    assert "dousa keypoints --install" in said or "pip install" in said
    assert page.find("#live-start").get_property("disabled")


def test_pictures_reach_the_studio_as_the_camera_gives_them(camera, show, monkeypatch):
    seen = []

    def keep(picture):
        seen.append(picture)

    monkeypatch.setattr(live, "open_finder", lambda: keep)
    page = show("/live")
    page.wait("return !document.querySelector('#live-start').disabled")
    page.find("#live-start").click()
    page.wait("return document.querySelector('#live-rate').textContent !== '-'")
    page.find("#live-stop").click()
    assert max(seen[0].shape[:2]) == 640
    assert np.ptp(seen[0]) > 100  # Chromium's made-up camera is a clock on green
