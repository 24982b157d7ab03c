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
    page.wait("return document.querySelector('#take-file')")
    page.find("#take-file").send_keys(str(recording[0]))
    try:
        page.wait("return document.querySelector('#progress progress')?.value === 2")
        assert page.run("return document.querySelector('#progress progress').max") == 5
        assert "step 3 of 5" in page.run("return document.querySelector('#progress').textContent")
    finally:
        go_on.set()
    page.wait("return document.querySelectorAll('#segments tbody tr').length > 2")
    assert any(done > 0 and total > 1 for done, total, _ in told), "the library knows its steps"
    assert page.messages() == []


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
    assert page.messages() == []


def test_an_fbx_file_is_a_motion_and_what_reads_it_is_named(show, tmp_path, monkeypatch):
    from dousa.formats.exchange import conversion

    monkeypatch.setattr(conversion, "find_program", lambda name: None)
    (tmp_path / "hero.fbx").write_bytes(FBX)
    page = show("/library")
    click(page, "#add-button")
    page.wait("return document.querySelector('#add-files')")
    page.find("#add-files").send_keys(str(tmp_path / "hero.fbx"))
    page.wait("return document.querySelector('#came')")
    assert not page.run("return document.querySelector('dialog .refused')")
    page = show("/takes")
    page.wait("return document.querySelector('#take-file')")
    page.find("#take-file").send_keys(str(tmp_path / "hero.fbx"))
    page.wait("return document.querySelector('#problem').checkVisibility()")
    said = page.run("return document.querySelector('#problem').textContent")
    assert "hero.fbx" in said and "neither Blender nor assimp" in said
