"""Films of one scene are looked at side by side."""

from __future__ import annotations

import threading
from pathlib import Path

import numpy as np
import pytest

from dousa.app.pipelines import film_scene
from dousa.app.pipelines.film_scene import shows_masks
from dousa.errors import KeypointError
from dousa.estimation.keypoints.keypoints import MEDIAPIPE_NAMES, ViewKeypoints
from patience import PATIENCE


def make_view(film):
    return ViewKeypoints(MEDIAPIPE_NAMES, (), np.arange(3) / 30, (64, 48), str(film))


@pytest.fixture
def finders(monkeypatch):
    """What is called for a film, by its name; every other film is found at once."""
    known = {}

    def find(film, model, *, threads=None, progress):
        known.get(Path(film).stem, lambda note: note(3, 3, "done"))(progress)
        return make_view(film)

    monkeypatch.setattr("dousa.estimation.find_keypoints", find)
    monkeypatch.setattr(film_scene.os, "cpu_count", lambda: 2)
    return known


def open_all(names, progress=lambda done, total, what: None):
    return film_scene.open_keypoints([Path(f"{name}.mp4") for name in names], "full", progress)


@pytest.mark.parametrize("content", [b"", b"sound" * 99])
def test_what_is_no_film_is_no_film_of_masks(tmp_path, content):
    (tmp_path / "a.mp4").write_bytes(content)
    assert not shows_masks(tmp_path / "a.mp4")


def test_two_films_are_looked_at_at_the_same_time_and_come_in_their_order(finders):
    both = threading.Barrier(2, timeout=PATIENCE)
    finders["a"] = finders["b"] = lambda note: both.wait()
    assert [view.source for view in open_all("abc")] == ["a", "b", "c"]


def test_progress_is_of_all_films_and_told_by_the_thread_that_asked(finders):
    told, go_on = [], threading.Event()

    def work(note):
        note(2, 5, "looking")
        assert go_on.wait(60)

    def progress(done, total, what):
        told.append((done, total, what, threading.current_thread()))
        if done == 4:
            go_on.set()

    finders["a"] = finders["b"] = work
    open_all("ab", progress)
    assert told[-1] == (4, 10, "looking", threading.main_thread())


@pytest.mark.parametrize("bad", ["a", "b"])
def test_a_film_that_fails_stops_the_others(finders, bad):
    def fail(note):
        raise KeypointError("film.no_frame")

    def work(note):
        for _ in range(10**9):
            note(1, 5, "looking")

    finders.update({"a": work, "b": work}, **{bad: fail})
    with pytest.raises(KeypointError) as caught:
        open_all("ab")
    assert caught.value.code == "film.no_frame"


def test_an_interruption_stops_all(finders):
    ended = []

    def work(note):
        try:
            for _ in range(10**9):
                note(1, 5, "looking")
        finally:
            ended.append(True)

    def interrupt(done, total, what):
        raise KeyboardInterrupt

    finders["a"] = finders["b"] = work
    with pytest.raises(KeyboardInterrupt):
        open_all("ab", interrupt)
    assert len(ended) == 2
