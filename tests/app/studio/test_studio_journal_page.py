"""The Library page in a real browser: what is done is undone, tags and stars, what is kept, panes, the way to a ZIP."""

import pytest

from app.studio.library_page import CELLS, click, wait_count

KEYS = pytest.importorskip("selenium.webdriver", reason="selenium is not installed: pip install selenium").Keys
N = 24
NOTICE = "return [...document.querySelectorAll('.notice p')].some((p) => p.textContent.includes(arguments[0]))"


@pytest.fixture
def library_page(show):
    def open_page(path="/library", **look):
        page = show(path, **look)
        page.wait(f"{CELLS}.length > 0")
        return page

    return open_page


def test_a_removal_and_a_label_are_undone_by_button_and_by_keys_also_after_a_reload(library_page, running):
    page, library = library_page(), running.app.state.studio.library
    page.find(".cell").click()
    page.press(KEYS.ARROW_RIGHT, held=KEYS.SHIFT)
    click(page, "[data-word=relabel]")
    page.find("#relabel-category").send_keys("hop", KEYS.ENTER)
    page.wait(NOTICE, "2 relabelled")
    page.wait("return document.querySelectorAll('.cell .badge')[1].textContent === 'hop'")
    page.press(KEYS.DELETE)
    click(page, "#remove-go")
    wait_count(page, N - 2)
    click(page, ".notice:last-child [data-act=undo]")
    wait_count(page, N)
    page.wait(NOTICE, "Undone: 2 clips removed")
    page.driver.refresh()
    page.wait(f"{CELLS}.length > 0")
    page.run("document.querySelector('.cell').focus()")
    page.press("z", held=KEYS.CONTROL)
    page.wait("return document.querySelector('.cell .badge').textContent === 'kick_left'")
    page.press("y", held=KEYS.CONTROL)
    page.wait("return document.querySelector('.cell .badge').textContent === 'hop'")
    assert [clip.category for clip in library.clips([1, 2])] == ["hop", "hop"]


def test_tags_stars_and_what_is_kept(library_page, running):
    page, library = library_page(), running.app.state.studio.library
    page.find(".cell").click()
    page.press("f")
    page.wait("return !document.querySelector('.cell .star').hidden")
    page.press(KEYS.ARROW_RIGHT, held=KEYS.SHIFT)  # what is chosen while the page still reads the star stays chosen
    page.wait("return document.querySelector('.chosen-count').textContent.startsWith('2')")
    click(page, "[data-word=tags]")
    assert page.run("return document.querySelector('[data-tag=favourite] .note').textContent") == "some have it"
    page.find("#tag-new").send_keys("fight", KEYS.ENTER)
    page.wait(NOTICE, "Tags of 2 changed")
    assert [clip.tags for clip in library.clips([1, 2])] == [("favourite", "fight"), ("fight",)]
    click(page, "[data-word=keep]")
    page.find("#keep-name").send_keys("<i>two</i>", KEYS.ENTER)
    page.wait("return document.querySelector('.kept-row .name')?.textContent === '<i>two</i>'")
    click(page, "[data-key='tag favourite']")
    wait_count(page, "1 of")
    click(page, "#keep-search")
    page.find("#keep-name").send_keys("stars", KEYS.ENTER)
    page.wait("return document.querySelectorAll('.kept-row').length === 2")
    click(page, ".kept-row[data-name='<i>two</i>'] .kept-name")
    wait_count(page, "2 of")
    click(page, ".kept-row[data-name=stars] .kept-name")
    wait_count(page, "1 of")
    click(page, ".kept-row[data-name=stars] .icon:last-child")
    page.wait("return document.querySelectorAll('.kept-row').length === 1")
    click(page, ".notice:last-child button.small")
    page.wait("return document.querySelectorAll('.kept-row').length === 2")
    assert {one.name for one in library.searches.all()} == {"<i>two</i>", "stars"}


def test_from_the_list_to_a_zip_onto_a_character(library_page, running, bvh, downloads):
    """The animator's way: a category, all of it, a tag, a format, a character, the file."""
    import csv
    import io
    import zipfile

    page = library_page("/library?category=kick_left")
    wait_count(page, "6 of")
    click(page, "#all-button")
    click(page, "[data-word=export]")
    page.wait("return document.querySelector('dialog .exporting select')")
    choose = "arguments[0].value = 'bvh'; arguments[0].dispatchEvent(new Event('change', {bubbles: true}))"
    page.run(choose, page.find("dialog .exporting select"))
    page.find("dialog .character input[type=file]").send_keys(str(bvh))
    page.wait("return document.querySelector('dialog .character-name')")
    page.run("[...document.querySelectorAll('dialog .foot button')].at(-1).click()")
    page.wait("return document.querySelector('dialog a[href^=\"/api/exports/\"]')")
    click(page, "dialog a[href^='/api/exports/']")
    path = downloads(".zip")
    with zipfile.ZipFile(path) as packed:
        assert packed.testzip() is None
        motions = [name for name in packed.namelist() if name.endswith(".bvh")]
        rows = list(csv.DictReader(io.StringIO(packed.read("manifest.csv").decode())))
        texts = {packed.read(name).split(b"MOTION")[0] for name in motions}
    assert len(motions) == len(rows) == 6
    assert {row["category"] for row in rows} == {"kick_left"}
    assert len(texts) == 1  # everybody has the skeleton of the character


def test_panes_figures_and_list_are_remembered(library_page):
    page = library_page(width=1600, height=900)
    page.wait("return document.querySelector('#look .dousa-player')")
    assert page.run("return document.querySelector('main').clientWidth") == 1600
    page.run("document.querySelector('#split-left').focus()")
    width = "return document.querySelector('#facets').offsetWidth"
    columns = "return Number(document.querySelector('#grid').getAttribute('aria-colcount'))"
    before, many = page.run(width), page.run(columns)
    page.press(*[KEYS.ARROW_RIGHT] * 3)
    assert page.run(width) == before + 72
    page.run("const s = document.querySelector('#cell-size'); s.value = '300'; s.dispatchEvent(new Event('input'))")
    page.settle()
    assert page.run(columns) < many
    click(page, "#view-list")
    assert page.run(columns) == 1
    page.wait(f"{CELLS}.length > 8")
    click(page, "#look-button")
    page.driver.refresh()
    page.wait(f"{CELLS}.length > 8")
    assert (page.run(columns), page.run(width)) == (1, before + 72)
    assert not page.run("return document.querySelector('#look').offsetParent")
    click(page, "#look-button")
    page.wait("return document.querySelector('#look .dousa-player')")
    for at in (390, 1100, 2560):
        page.resize(at, 900)
        page.settle()
        assert page.run("return document.documentElement.scrollWidth <= innerWidth")
    page.run("localStorage.clear()")
