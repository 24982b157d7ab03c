"""Signs of what is going on, in Chromium: steps of a bar, a folder that is read, what cannot be read, categories."""

import sqlite3
import threading

import pytest

from app.studio.library_page import click
from app.studio.test_studio_takes import recording  # noqa: F401 - a fixture
from dousa.library import Library
from dousa.messages import Message
from patience import PATIENCE

pytest.importorskip("selenium.webdriver", reason="selenium is not installed: pip install selenium")
FBX = b"Kaydara FBX Binary  \0\x1a\0" + b"\0" * 64


def test_the_bar_of_the_first_labelling_shows_its_steps(show, library_copy, recording, monkeypatch):  # noqa: F811
    with sqlite3.connect(library_copy) as connection:  # as after a change that the kept one does not know
        connection.execute("UPDATE forests SET labeller = NULL")
    connection.close()
    real, go_on, told = Library.label, threading.Event(), []

    def label(library, take, *, progress, **options):
        progress(2, 5, "the third of five")
        assert go_on.wait(PATIENCE)
        return real(library, take, progress=lambda *step: (told.append(step), progress(*step)), **options)

    monkeypatch.setattr(Library, "label", label)
    page = show("/takes")
    page.find("#take-file").send_keys(str(recording[0]))
    try:
        page.wait("return document.querySelector('#progress progress')?.value === 2")
        assert page.run("return document.querySelector('#progress progress').max") == 5
        assert "step 3 of 5" in page.run("return document.querySelector('#progress').textContent")
    finally:
        go_on.set()
    page.wait("return document.querySelectorAll('#segments tbody tr').length > 2")
    assert any(done > 0 and total > 1 for done, total, _ in told), "the library knows its steps"


def test_a_search_that_learns_first_shows_its_steps(show, client, monkeypatch):
    real, go_on = Library.search, threading.Event()

    def search(library, query, *words, progress=None, **options):
        if progress is not None:
            progress(1, 3, Message("text.verbatim", text="learning bodies without hands"))
            assert go_on.wait(PATIENCE)
        return real(library, query, *words, **options)

    monkeypatch.setattr(Library, "search", search)
    try:
        page = show("/search?motion=clip:1")
        page.wait("return document.querySelector('#results-note progress')?.value === 1")
        assert "learning bodies without hands" in page.run("return document.querySelector('#results-note').textContent")
        said = client.ask("GET", "/api/search/learning")["learning"]
        assert said == {"done": 1, "total": 3, "what": "learning bodies without hands"}
    finally:
        go_on.set()
    page.wait("return document.querySelectorAll('.hit').length > 3")
    assert not page.run("return document.querySelector('#results-note progress')")
    assert client.ask("GET", "/api/search/learning") == {"learning": None}


def test_an_fbx_file_is_a_motion_and_what_reads_it_is_named(show, tmp_path, monkeypatch):
    from dousa.formats.exchange import conversion

    monkeypatch.setattr(conversion, "find_program", lambda name: None)
    (tmp_path / "hero.fbx").write_bytes(FBX)
    page = show("/library")
    click(page, "#add-button")
    page.find("#add-files").send_keys(str(tmp_path / "hero.fbx"))
    page.wait("return document.querySelector('#came')")
    assert not page.run("return document.querySelector('dialog .refused')")
    page = show("/takes")
    page.find("#take-file").send_keys(str(tmp_path / "hero.fbx"))
    page.wait("return document.querySelector('#problem').checkVisibility()")
    said = page.run("return document.querySelector('#problem').textContent")
    assert "hero.fbx" in said and "neither Blender nor assimp" in said
    page.messages()  # the browser tells of the refused request itself


DROP_FOLDER = """
const [text, number] = arguments;
const named = (k) => [`one${k}.bvh`, new File([text + '\\n'.repeat(k)], `one${k}.bvh`)];
const file = (k) => ({isFile: true, name: named(k)[0], file: (done) => done(named(k)[1])});
const parts = [Array.from({length: number}, (_, k) => file(k)), [file(number)], []];
const gate = new Promise((done) => { window.letGo = done; });
const reader = {async readEntries(done) {
  const part = parts.shift(); if (parts.length === 1) await gate; done(part);
}};
const folder = {isFile: false, name: 'archive', createReader: () => reader};
const event = new Event('drop', {bubbles: true, cancelable: true});
event.dataTransfer = {types: ['Files'], items: [{webkitGetAsEntry: () => folder}], files: []};
document.querySelector('#grid').dispatchEvent(event);
"""


def test_a_folder_that_takes_long_to_read_says_how_far_it_is(show, bvh):
    page = show("/library")
    page.wait("return document.querySelector('.cell')")
    page.run(DROP_FOLDER, bvh.read_text(), 3)
    said = "document.querySelector('.reading-folder')?.textContent"
    page.wait(f"return {said} === 'Reading the folder: 3 files'")
    assert not page.run("return document.querySelector('dialog[open]')")
    page.run("window.letGo()")
    page.wait("return document.querySelector('#came')?.textContent.includes('4')")
    assert page.run(f"return {said}") is None


@pytest.mark.parametrize(
    ("path", "field"), [("/search", "#query-file"), ("/takes", "#take-file"), ("/evaluate", "#performance-file")]
)
def test_where_a_motion_is_wanted_another_file_is_said_to_be_none(show, tmp_path, path, field):
    (tmp_path / "joints.toml").write_text("hips = 'pelvis'\n")
    page = show(path)
    page.wait("return document.querySelector(arguments[0])", field)
    page.find(field).send_keys(str(tmp_path / "joints.toml"))
    told = "[...document.querySelectorAll('.notice.problem')].map((one) => one.textContent).join()"
    page.wait(f"return {told}.includes('There is no motion file among them')")


@pytest.mark.parametrize("asked", ["job", "masks"])
def test_an_estimation_that_is_not_there_leads_back_to_the_start(show, asked):
    part = {"job": "watch"}.get(asked, asked)
    page = show(f"/estimate?{asked}=0123456789abcdef")
    page.wait(f"return document.querySelector('#{part}-problem .problem-box')")
    page.find(f"#{part}-actions button").click()
    page.wait("return !document.querySelector('#setup').hidden")
    page.messages()  # the browser tells of the 404 itself
