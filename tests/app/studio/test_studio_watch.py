"""A folder that the studio watches."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

from dousa.app.studio.jobs.board import FolderWatch
from dousa.formats.registry import write_motion
from dousa.motion.synthetic.performers import draw_performer, make_motion


@pytest.fixture(scope="module")
def squat(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("watched") / "one.bvh"
    write_motion(make_motion("squat", draw_performer(77), 3), path)
    return path


def test_what_is_new_is_taken_once_when_it_rests(tmp_path, squat):
    taken, busy = [], [False]
    watch = FolderWatch(tmp_path, taken.append, lambda: busy[0])
    assert not watch.look() and not watch.look(), "nothing is there"
    place = tmp_path / "squat" / "one.bvh"
    place.parent.mkdir()
    place.write_bytes(squat.read_bytes()[:1000])
    assert not watch.look(), "somebody may still be writing it"
    shutil.copy(squat, place)
    os.utime(place, (1, 1))
    assert not watch.look(), "it has changed since"
    busy[0] = True
    assert not watch.look(), "one after the other"
    busy[0] = False
    assert watch.look()
    assert taken == [[str(place)]]
    assert not watch.look()
    shutil.copy(squat, tmp_path / "two.bvh")
    (tmp_path / "notes.txt").write_text("no motion")
    assert not watch.look()
    assert watch.look()
    assert taken[1:] == [[str(tmp_path / "two.bvh")]], "what was taken before is left alone"
    place.unlink()
    assert not watch.look() and not watch.look(), "what has gone stays in the library"


@pytest.mark.plain_workers
def test_what_appears_goes_into_the_library_with_its_folder_as_category(studio, tmp_path, squat, wait_job):
    from dousa.app.studio.server import _watch

    before = studio.get("/api/info").json()["library"]["categories"]
    watch = _watch(tmp_path, studio.app.state.studio)
    (tmp_path / "jumping").mkdir()
    shutil.copy(squat, tmp_path / "jumping" / "one.bvh")
    assert not watch.look()
    assert watch.look()
    job = next(one for one in studio.get("/api/jobs").json()["jobs"] if one["kind"] == "watch")
    done = wait_job(studio, job["id"])
    assert done["state"] == "done", done

    after = studio.get("/api/info").json()["library"]["categories"]
    assert after == {**before, "jumping": 1}


def test_the_watch_begins_and_ends(tmp_path):
    watch = FolderWatch(tmp_path, lambda files: None, lambda: False)
    watch.start()
    watch.end()


def test_a_folder_that_is_not_there_is_said_before_anything_is_made(dousa, tmp_path):
    code, out, err = dousa("studio", tmp_path / "new.dousa", "--no-browser", "--watch", tmp_path / "none")
    assert (code, out) == (2, "")
    assert "none" in err and "no such folder" in err
    assert not (tmp_path / "new.dousa").exists()
