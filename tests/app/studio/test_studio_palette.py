"""The palette of all that can be done (Ctrl+K) and the list of keys (?), in a real browser."""

import pytest

from app.studio.library_page import CELLS, wait_count

KEYS = pytest.importorskip("selenium.webdriver", reason="selenium is not installed: pip install selenium").Keys
ROWS = "return [...document.querySelectorAll('.palette-row')].map((row) => row.firstChild.textContent)"


def open_palette(page):
    page.press("k", held=KEYS.CONTROL)
    page.wait("return document.activeElement.id === 'palette-field'")


def test_pages_and_actions_are_found_by_parts_of_their_names(show):
    page = show("/library")
    page.wait(f"{CELLS}.length > 3")
    open_palette(page)
    rows = page.run(ROWS)
    assert {"Library", "Search", "Takes", "Train", "Add motions", "Check labels"} <= set(rows)
    page.find("#palette-field").send_keys("trn")
    assert page.run(ROWS)[0] == "Train"
    page.press(KEYS.ENTER)
    page.wait("return document.querySelector('#train-trees')")
    page.press(KEYS.ESCAPE)
    open_palette(page)
    page.find("#palette-field").send_keys("squat")
    page.press(KEYS.ARROW_UP, KEYS.ENTER)  # the last: find it in the library
    page.wait("return new URLSearchParams(location.search).get('text') === 'squat'")
    wait_count(page, 6)
    open_palette(page)
    page.find("#palette-field").send_keys("takes")
    page.press(KEYS.ENTER)
    page.wait("return location.pathname === '/takes'")


@pytest.mark.parametrize(("language", "word"), [("en", "Keys"), ("ja", "キー操作")])
def test_a_question_mark_lists_the_keys_but_not_in_a_field(show, language, word):
    page = show("/library", language=language)
    page.wait(f"{CELLS}.length > 3")
    page.find("#text").send_keys("?")
    assert page.run("return document.querySelector('dialog')") is None
    page.find("#text").clear()
    page.run("document.activeElement.blur()")
    page.press("?")
    page.wait("return document.querySelector('dialog[open] .key-list')")
    assert page.run("return document.querySelector('dialog h2').textContent") == word
    assert page.run("return document.querySelectorAll('.key-list kbd').length") > 8
