"""The report in a real Chromium: nothing fails, and everything follows one moment."""

import base64
from pathlib import Path
from typing import Any

import pytest

from app.fake_assessment import HOSTILE_WORDS, make_assessment
from app.report_cases import UNUSUAL, page_data
from dousa.app.report.page import write_report


@pytest.fixture
def opened(browser: Any, tmp_path: Path) -> Any:
    """The report in a browser, standing still at 0."""
    path = write_report(make_assessment(), tmp_path)
    browser.open(path, 1280, 900)
    browser.wait("return document.querySelector('#readout b')?.textContent === '0:00.0'")
    return browser


_NOW = "return Number(document.getElementById('lanes').getAttribute('aria-valuenow'))"
_CURSOR = """const line = document.getElementById('cursor').getBoundingClientRect();
const box = document.getElementById('lanes').getBoundingClientRect();
return (line.left - box.left) / box.width * Number(document.getElementById('lanes').dataset.duration)"""


@pytest.mark.parametrize("language", ["en", "ja"])
@pytest.mark.parametrize("case", ["usual", "hostile", *UNUSUAL])
def test_the_console_stays_silent(case: str, language: str, browser: Any, tmp_path: Path) -> None:
    assessment = make_assessment(words=HOSTILE_WORDS if case == "hostile" else None)
    if case in UNUSUAL:
        assessment = UNUSUAL[case](assessment)
    browser.open(write_report(assessment, tmp_path, language=language), 390, 844, "dark")
    browser.wait("return document.querySelector('#readout b')?.textContent")
    browser.settle()
    assert browser.messages() == []
    assert browser.run("return window.hacked === undefined")
    width = browser.run("return document.documentElement.scrollWidth")
    assert width <= 390, "the page is wider than a phone"
    low = "return [...document.querySelectorAll('.tip svg text')].map((e) => e.getBoundingClientRect().height)"
    assert min(browser.run(low), default=10) >= 10, "nobody reads that"


def test_the_cursor_follows_the_player(opened: Any) -> None:
    opened.find("#player .dousa-player").click()
    opened.press(" ")
    opened.wait("return Number(document.getElementById('lanes').getAttribute('aria-valuenow')) > 0.2")
    opened.press(" ")
    opened.settle()
    now = opened.run(_NOW)
    assert opened.run(_CURSOR) == pytest.approx(now, abs=0.1)
    assert opened.messages() == []


@pytest.mark.parametrize("place", ["#advice", "#events", ".lanes"])
def test_a_press_on_an_error_goes_there_and_loops(place: str, opened: Any) -> None:
    button = opened.find(f"{place} [data-event]:not([data-event='0'])")
    number = button.get_attribute("data-event")
    event = page_data(opened.driver.page_source)["events"][int(number)]
    opened.run("arguments[0].scrollIntoView({block: 'center', behavior: 'instant'})", button)
    button.click()
    start, end = max(event[0] - 0.5, 0.0), event[1] + 0.5
    opened.wait(f"return document.querySelector('[data-event=\"{number}\"]').getAttribute('aria-current') === 'true'")
    assert start - 0.05 <= opened.run(_NOW) <= end + 0.05
    assert opened.messages() == []


def test_errors_are_reached_by_keyboard(opened: Any) -> None:
    opened.run("document.querySelector('#events button').focus()")
    opened.press("\ue007")
    opened.wait("return Number(document.getElementById('lanes').getAttribute('aria-valuenow')) > 0.5")


def test_a_press_on_the_timeline_goes_there(opened: Any) -> None:
    from selenium.webdriver import ActionChains

    curve = opened.find(".lanes .row.plot")
    opened.run("arguments[0].scrollIntoView({block: 'center', behavior: 'instant'})", curve)
    ActionChains(opened.driver).move_to_element(curve).click().perform()
    opened.settle()
    assert opened.run(_NOW) == pytest.approx(10.0, abs=0.1)
    assert opened.run(_CURSOR) == pytest.approx(10.0, abs=0.1)
    opened.run("document.getElementById('lanes').focus()")
    opened.press("\ue014", "\ue010")
    assert opened.run(_NOW) == pytest.approx(20.0, abs=0.1)
    assert opened.messages() == []


@pytest.mark.parametrize("language", ["en", "ja"])
def test_the_embedded_font_draws_the_japanese(language: str, browser: Any, tmp_path: Path) -> None:
    assessment = make_assessment()
    browser.open(write_report(assessment, tmp_path, language=language, title="扇の舞"), 1280, 900)
    browser.wait("return document.fonts.status === 'loaded' && document.fonts.size === 1")
    assert browser.run("return [...document.fonts][0].status") == "loaded"


@pytest.mark.parametrize(("opening", "most"), [("", 2), ("document.querySelector('#analysis').open = true", 8)])
def test_two_sheets_of_paper_and_the_rest_if_it_lies_open(opening: str, most: int, opened: Any) -> None:
    opened.run(opening)
    sheets = opened.driver.execute_cdp_cmd("Page.printToPDF", {"printBackground": True, "preferCSSPageSize": True})
    count = base64.b64decode(sheets["data"]).count(b"/Type /Page\n")
    assert (2 < count <= most) if opening else count <= most


def test_what_is_chosen_on_the_screen_is_not_marked_on_paper(opened: Any) -> None:
    opened.run("document.querySelector('.event').click()")
    look = """const one = document.querySelector('.event[aria-current="true"]'), style = getComputedStyle(one);
        return [style.boxShadow, style.backgroundColor]"""
    screen = opened.wait(f"if (document.querySelector('.event[aria-current=\"true\"]')) {{ {look} }}")
    opened.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
    assert opened.run(look) == ["none", "rgba(0, 0, 0, 0)"] != screen
    opened.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": ""})
