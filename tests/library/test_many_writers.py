"""Several programs write to one library: none fails, none waits while another learns, nothing is lost."""

import subprocess
import sys
import threading
import time

import pytest

from dousa.errors import LibraryLockedError
from dousa.library import Library
from dousa.motion.synthetic import draw_performer, make_motion
from dousa.retrieval.forest import growth
from library.database_server import address


@pytest.fixture
def nods(write_move, tmp_path):
    for seed in range(5):
        write_move(tmp_path / "new" / "squat_down" / f"n{seed}.bvh", "squat", 200 + seed)
    return tmp_path / "new"


def meddle_while_it_learns(monkeypatch, library_file, change, times):
    """Another program that waits for nobody changes the library in the middle of the first learnings."""
    grow, done = growth.grow_forest, []

    def grow_forest(*args, **options):
        if len(done) < times:
            done.append(time.monotonic())
            with Library.open(library_file, timeout=0.0) as other:
                change(other, len(done))
        return grow(*args, **options)

    monkeypatch.setattr(growth, "grow_forest", grow_forest)
    return done


def test_others_write_while_new_clips_are_learned(library, library_file, nods, monkeypatch):
    done = meddle_while_it_learns(monkeypatch, library_file, lambda other, n: other.relabel(n, performer="z"), 1)
    report = library.add(nods, n_jobs=1)
    assert (len(done), report.n_learned, len(report.added)) == (1, 5, 5)
    assert library.clips(1)[0].performer == "z"
    assert library.search(next(nods.rglob("*.bvh"))).verdict.guess == "squat_down"
    assert library.check().is_sound


def test_what_was_worked_out_for_other_clips_is_worked_out_again(library, library_file, nods, monkeypatch, moves):
    meddle_while_it_learns(monkeypatch, library_file, lambda other, n: other.remove(category="wave"), 1)
    assert library.add(nods, n_jobs=1).n_learned == 5
    assert library.categories() == {"bow": 5, "squat": 5, "squat_down": 5}
    assert len(library.search(moves / "bow" / "bow_p0.bvh", 100).results) == 15
    assert library.check().is_sound


def test_the_same_comes_out_as_one_after_the_other(library, library_file, nods, monkeypatch, tmp_path):
    alone = tmp_path / "alone.dousa"
    alone.write_bytes(library_file.read_bytes())
    with Library.open(alone) as other:
        other.relabel(3, category="wave")
        other.add(nods, n_jobs=1)
        expected = [other.search(number, 20).to_json() for number in range(1, 21)]
    meddle_while_it_learns(monkeypatch, library_file, lambda other, n: other.relabel(3, category="wave"), 1)
    library.add(nods, n_jobs=1)
    assert [library.search(number, 20).to_json() for number in range(1, 21)] == expected


def test_one_who_is_always_disturbed_learns_while_the_others_wait(library, library_file, nods, monkeypatch):
    def disturb(other, n):
        try:
            other.relabel(1, category=f"wave {n}")
        except LibraryLockedError:
            refused.append(n)

    refused: list[int] = []
    done = meddle_while_it_learns(monkeypatch, library_file, disturb, 100)
    assert library.add(nods, n_jobs=1).n_learned == 5
    assert 2 <= len(done) <= 6
    assert refused == [len(done)]


def test_edits_while_a_forest_is_trained(library, library_file, write_move, tmp_path, monkeypatch):
    write_move(tmp_path / "in" / "wave" / "late.bvh", "wave", 900)
    again = []

    def progress(done, total, what):
        if done == 3 and not again:
            again.append(done)
            with Library.open(library_file, timeout=0.0) as other:
                other.add(tmp_path / "in", n_jobs=1)

    library.train(n_trees=5, progress=progress, n_jobs=1)
    assert again == [3]
    assert library.stats().forest_is_current is False
    assert len(library.search(1, 100).results) == 16
    assert library.check().is_sound


def test_a_segment_is_named_while_others_write(library, library_file, monkeypatch, moves):
    library.add_motion(make_motion("walk", draw_performer(1), seed=1), "take", kind="take")
    (take,) = library.clips("take")
    done = meddle_while_it_learns(monkeypatch, library_file, lambda other, n: other.relabel(1, performer="z"), 1)
    number = library.annotations.name(take.id, 0.2, 1.0, "walk")
    assert len(done) == 1
    assert library.clips(number)[0].category == "walk"
    assert library.check().is_sound


_ADD = """
import sys
from dousa.library import Library

with Library.open(sys.argv[1], timeout=60.0) as library:
    library.add(sys.argv[2], n_jobs=1)
"""


def test_four_programs_add_to_a_trained_library(library_file, write_move, tmp_path):
    folders = [tmp_path / f"in{n}" for n in range(4)]
    for n, folder in enumerate(folders):
        for seed in range(4):
            write_move(folder / "wave" / f"w{n}_{seed}.bvh", "wave", 1000 + 10 * n + seed)
    programs = [subprocess.Popen([sys.executable, "-c", _ADD, address(library_file), folder]) for folder in folders]
    assert [program.wait() for program in programs] == [0, 0, 0, 0]
    with Library.open(library_file) as library:
        assert library.categories()["wave"] == 5 + 16
        assert library.stats().n_learned == 16
        assert len(library.search(1, 100).results) == 31
        assert library.check().is_sound


def test_waiting_ends_when_the_other_is_done(library, library_file):
    ready, over = threading.Event(), threading.Event()

    def hold():
        with Library.open(library_file) as other, other.database.writing():
            ready.set()
            over.wait(20)

    thread = threading.Thread(target=hold)
    thread.start()
    ready.wait(20)
    with Library.open(library_file, timeout=0.1) as hasty, pytest.raises(LibraryLockedError):
        hasty.relabel(1, performer="z")
    timer = threading.Timer(0.5, over.set)
    timer.start()
    with Library.open(library_file, timeout=30.0) as patient:
        assert patient.relabel(1, performer="z")
    thread.join()
