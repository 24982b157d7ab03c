"""The one box of the Library page and the tree of categories, asked as a program would and in a real browser."""

import numpy as np
import pytest

from app.studio.library_page import CELLS, click, wait_count
from dousa.app.studio.content.clip_words import find_words, plain, read_text
from dousa.library import TextMatches

KEYS = pytest.importorskip("selenium.webdriver", reason="selenium is not installed: pip install selenium").Keys
TEXTS = [plain(text) for text in ("HDM05/kick/right/hdm_01.bvh", "hdm05/kick/left/hdm_02.bvh", "walk\nAnna\nfavourite")]
IDS = np.array([7, 3, 9])


def match_last_two(text):
    return TextMatches(np.array([9, 3]), np.array([0.9, 0.6]), {"gehen": "walk"})


@pytest.mark.parametrize(
    ("text", "fits"), [("kick", [1, 1, 0]), ("KICK ｌｅｆｔ", [0, 1, 0]), ("zebra", [0, 0, 0]), ("hdm_03", [0, 0, 0])]
)
def test_every_word_is_looked_for_by_its_letters(text, fits):
    assert find_words(TEXTS, text).tolist() == [bool(fit) for fit in fits]


def test_what_is_called_so_comes_before_what_does_so():
    narrow = read_text(TEXTS, IDS, "right", match_last_two, wide=False)
    assert (narrow.fits.tolist(), narrow.more) == ([True, False, False], 2)
    wide = read_text(TEXTS, IDS, "right", match_last_two, wide=True)
    assert wide.fits.all() and np.argsort(-wide.scores).tolist() == [0, 2, 1]
    meant = read_text(TEXTS, IDS, "gehen", match_last_two, wide=False)
    assert meant.fits.tolist() == [False, True, True] and meant.taken_for == {"gehen": "walk"}
    assert read_text(TEXTS, IDS, " ", match_last_two, wide=False).fits is None


def test_as_long_as_words_are_read_names_are_found():
    reading = read_text(TEXTS, IDS, "walk", lambda text: None, wide=False)
    assert reading.pending and reading.fits.tolist() == [False, False, True]


@pytest.fixture
def nested(running):
    """The studio's library with categories on several levels."""
    library = running.app.state.studio.library
    ids = {name: [clip.id for clip in library.clips(category=name)] for name in ("kick_left", "squat", "wave_right")}
    library.relabel(ids["kick_left"], category="HDM05/kick/left")
    library.relabel(ids["squat"][:2], category="HDM05/kick/right")
    library.relabel(ids["squat"][2:], category="HDM05")
    return library


def test_a_level_stands_for_all_below_it(studio):
    library = studio.app.state.studio.library
    library.relabel(category="a/b/c", where_category="squat")
    library.relabel(category="a/b", where_category="walk")
    library.relabel(category="ab", where_category="wave_right")
    for asked, count in (
        ("a/", 12),
        ("a/b/", 12),
        ("a/b", 12),
        ("b", 12),
        ("a/b/c", 6),
        ("a/b/c/", 6),
        ("b/", 0),
        ("ab/", 6),
    ):
        assert studio.get("/api/clips", params={"category": asked}).json()["total"] == count
    studio.post("/api/searches", json={"name": "below", "asked": {"category": ["a/"]}})
    assert len(library.searches.find("below")) == 12


def test_the_box_finds_what_is_misspelt_and_what_is_done(studio):
    find = lambda text: studio.get("/api/clips", params={"text": text, "limit": 500}).json()  # noqa: E731
    while find("sqaut")["reading"]["pending"]:
        pass
    assert find("sqaut")["total"] == 6 and find("sqaut")["reading"]["taken_for"] == {"sqaut": "squat"}
    while find("蹴る")["reading"]["pending"]:
        pass
    assert {item["category"] for item in find("蹴る")["items"]} == {"kick_left"}
    assert find("zzzxq")["total"] == 0


def test_a_search_that_is_kept_reads_its_words_as_the_box_does(studio):
    def find(**asked):
        return sorted(studio.get("/api/clips/ids", params=asked).json()["ids"])

    for name, text in (("misspelt", "sqaut"), ("done", "kicking")):
        assert studio.post("/api/searches", json={"name": name, "asked": {"text": text}}).status_code == 200
        while studio.get("/api/clips", params={"text": text}).json()["reading"]["pending"]:
            pass
        found = find(text=text)
        assert found and find(saved=name) == found
    studio.post("/api/searches", json={"name": "both", "asked": {"text": "sqaut", "performer": ["performer03"]}})
    assert len(find(saved="both")) == 1


def test_the_tree_opens_counts_and_narrows(show, nested):
    page = show("/library")
    page.wait(f"{CELLS}.length > 3")
    rows = "return [...document.querySelectorAll('.tree-rows .name-row')].map((row) => row.textContent)"
    assert page.run(rows) == ["HDM0512", "walk6", "wave_right6"]
    page.run("document.querySelector(\"[data-key='level HDM05/']\").focus()")
    page.press(KEYS.ENTER)
    assert page.run(rows) == ["HDM0512", "HDM05 itself4", "kick8", "left6", "right2", "walk6", "wave_right6"]
    assert page.run("return document.activeElement.dataset.key") == "level HDM05/"
    click(page, "[data-key='category HDM05/kick/']")
    wait_count(page, 8)
    assert page.run("return [...new URLSearchParams(location.search).getAll('category')]") == ["HDM05/kick/"]
    assert page.run("return document.querySelector('[data-key=\"category HDM05/\"]').indeterminate")
    page.driver.refresh()
    wait_count(page, 8)
    click(page, "[data-key='category HDM05/kick/right']")  # in the place of the level above it
    wait_count(page, 2)
    click(page, "[data-key='category HDM05/']")
    wait_count(page, 12)
    click(page, "[data-key='category HDM05/']")
    wait_count(page, 24)


def test_categories_are_searched_for(show, running):
    library = running.app.state.studio.library
    for number, clip in enumerate(library.clips()):
        library.relabel([clip.id], category=f"day{number % 3}/sort {number}")
    page = show("/library")
    page.wait(f"{CELLS}.length > 3")
    page.find(".tree-field").send_keys("sort 23")
    rows = "return [...document.querySelectorAll('.tree-rows .name-row')].map((row) => row.textContent)"
    page.wait(f"{rows.replace('return ', 'return (')}).length === 1")
    assert page.run("return document.activeElement.className") == "tree-field"
    click(page, "[data-key='category day2/sort 23']")
    wait_count(page, 1)


def test_the_box_says_how_it_read_the_words(show):
    page = show("/library")
    page.wait(f"{CELLS}.length > 3")
    page.find("#text").send_keys("sqaut")
    wait_count(page, 6)
    assert "squat" in page.run("return document.querySelector('#reading').textContent")
    page.run("document.querySelector('#text').select()")
    page.find("#text").send_keys("蹴る")
    page.wait("return document.querySelector('.cell .badge').textContent === 'kick_left'")
    wait_count(page, 6)
