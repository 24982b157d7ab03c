"""Which files of the given paths are motion files."""

from __future__ import annotations

import errno
import os
from pathlib import Path

from dousa.formats import find_motion_files


def touch(root: Path, *names: str) -> None:
    for name in names:
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("x")


def names(root: Path, *given: Path) -> list[str]:
    files, _ = find_motion_files(given or [root])
    return [file.path.relative_to(root).as_posix() for file in files]


def test_folders_give_known_suffixes_in_order(tmp_path):
    touch(tmp_path, "b/2.BVH", "b/1.bvh", "a/x.amc", "a/x.asf", "notes.txt", "z.c3d", "a/deep/er/y.trc")
    assert names(tmp_path) == ["z.c3d", "a/x.amc", "a/deep/er/y.trc", "b/1.bvh", "b/2.BVH"]


def test_hidden_files_and_folders_are_left_out(tmp_path):
    touch(tmp_path, ".a.bvh", ".git/b.bvh", "c.bvh")
    assert names(tmp_path) == ["c.bvh"]


def test_a_file_that_is_named_is_taken_whatever_it_is(tmp_path):
    touch(tmp_path, "notes.txt")
    assert names(tmp_path, tmp_path / "notes.txt") == ["notes.txt"]


def test_a_folder_that_cannot_be_looked_into_is_named(tmp_path, monkeypatch):
    touch(tmp_path, "open/a.bvh", "closed/b.bvh")
    look = os.scandir

    def refuse(folder):
        if os.path.basename(folder) == "closed":
            raise PermissionError(errno.EACCES, "Permission denied", os.fspath(folder))
        return look(folder)

    monkeypatch.setattr(os, "scandir", refuse)
    files, missing = find_motion_files([tmp_path])
    assert [file.path.name for file in files] == ["a.bvh"]
    assert [(item.path, str(item.reason)) for item in missing] == [
        (str(tmp_path / "closed"), "the folder cannot be read: permission denied")
    ]


def test_links_in_a_circle_end(tmp_path):
    touch(tmp_path, "a/1.bvh")
    os.symlink(tmp_path, tmp_path / "a" / "up")
    assert names(tmp_path) == ["a/1.bvh"]


def test_a_broken_link_does_not_stop_the_rest(tmp_path):
    touch(tmp_path, "a/1.bvh")
    os.symlink(tmp_path / "gone", tmp_path / "a" / "folder")
    os.symlink(tmp_path / "gone.bvh", tmp_path / "a" / "2.bvh")
    assert names(tmp_path) == ["a/1.bvh", "a/2.bvh"]


def test_a_file_is_found_once_under_the_first_path(tmp_path):
    touch(tmp_path, "a/b/1.bvh")
    files, _ = find_motion_files([tmp_path / "a", tmp_path / "a" / "b", tmp_path / "a" / "b" / "1.bvh"])
    assert [(file.root, file.path) for file in files] == [(tmp_path / "a", tmp_path / "a" / "b" / "1.bvh")]


def test_missing_paths_are_reported(tmp_path):
    files, missing = find_motion_files([tmp_path / "none", tmp_path / "none.bvh"])
    assert files == []
    assert [item.path for item in missing] == [str(tmp_path / "none"), str(tmp_path / "none.bvh")]
    assert "no such file" in str(missing[0].reason)
