"""Exporting from the Library and Search pages in a real browser: format, character, the ZIP file."""

import csv
import io
import zipfile

import pytest

from dousa.formats.registry import read_motion, write_motion
from dousa.motion import canonicalise, retarget
from dousa.motion.synthetic import draw_performer, make_motion

KEYS = pytest.importorskip("selenium.webdriver", reason="selenium is not installed: pip install selenium").Keys

DIALOG = "return document.querySelector('dialog[open]')"
FORMATS = "return [...document.querySelectorAll('#export-format option')].map((option) => option.value)"
DRAWN = "return document.querySelectorAll('.hit').length > 3 && document.querySelector('.verdict-words') !== null"


@pytest.fixture
def hero(tmp_path):
    """A character of other proportions, as GLB."""
    path = tmp_path / "hero.glb"
    write_motion(make_motion("bow", draw_performer(31)), path)
    return path


def choose_character(page, path):
    page.find("#character-file").send_keys(str(path))
    page.wait("return document.querySelector('.character-name')?.textContent === arguments[0]", path.name)


def rows_of(path):
    with zipfile.ZipFile(path) as archive:
        assert archive.testzip() is None
        return list(csv.DictReader(io.StringIO(archive.read("manifest.csv").decode())))


def test_hits_go_onto_the_character(show, running, hero, downloads, tmp_path):
    """Search a kick, take the hits without the last, on the own character."""
    kick = running.app.state.studio.library.clips(category="kick_left")[0].id
    page = show(f"/search?motion=clip:{kick}")
    page.wait(DRAWN)
    page.run("document.querySelector('#export-hits').click()")
    page.wait(DIALOG)
    choose_character(page, hero)
    assert page.run("return document.querySelector('#export-format').value") == "glb"  # as the character
    n_hits = page.run("return document.querySelectorAll('.ticks input:checked').length")
    page.run("[...document.querySelectorAll('.ticks input')].at(-1).click()")
    assert page.run("return document.querySelector('.ticks [role=status]').textContent").startswith(str(n_hits - 1))
    page.find("#export-go").click()
    page.wait("return document.querySelector('#export-file')")
    path = downloads(".zip")
    rows = rows_of(path)
    assert len(rows) == n_hits - 1
    assert rows[0]["file"].endswith(".glb")
    with zipfile.ZipFile(path) as archive:
        made = read_motion(archive.extract(rows[0]["file"], tmp_path))
    assert canonicalise(made).height == pytest.approx(canonicalise(read_motion(hero)).height, abs=5e-3)


def test_one_hit_onto_the_character_which_is_remembered(show, running, hero, downloads):
    kick = running.app.state.studio.library.clips(category="kick_left")[0].id
    page = show(f"/search?motion=clip:{kick}")
    page.wait(DRAWN)
    page.run("document.querySelector('.hit-open').click()")
    page.wait("return document.querySelector('#onto')")
    page.run("document.querySelector('#onto').click()")
    choose_character(page, hero)
    page.press(KEYS.ESCAPE)
    page.wait("return !document.querySelector('dialog')")
    page.run("document.querySelector('#onto').click()")
    page.wait("return document.querySelector('.character-name')?.textContent === 'hero.glb'")
    assert "original" not in page.run(FORMATS)
    page.run("document.querySelector('#export-reach').click()")
    page.find("#export-go").click()
    page.wait("return !document.querySelector('dialog')")
    made = read_motion(downloads(".glb"))
    hit = page.run("return new URLSearchParams(location.search).get('hit')").removeprefix("clip:")
    source = read_motion(running.app.state.studio.library.clips([int(hit)])[0].path)
    expected = retarget(source, read_motion(hero), keep_reach=True).motion
    assert made.n_frames == expected.n_frames


def test_what_is_no_character_is_told(show, tmp_path):
    points = tmp_path / "points.c3d"
    write_motion(make_motion("bow", draw_performer(3)), points)
    page = show("/library")
    page.find(".cell").click()
    page.run("document.querySelector('[data-word=export]').click()")
    page.find("#character-file").send_keys(str(points))
    page.wait("return document.querySelector('.notice.problem')")
    assert page.run("return document.querySelector('.character-name')") is None
    assert "points.c3d" in page.run("return document.querySelector('.notice.problem p').textContent")
    page.messages()  # the browser tells of the refused request itself
