"""Whole files: clear errors on reading, all or nothing on writing."""

import errno
import os
import stat

import pytest

from dousa.errors import MotionFileError, MotionWriteError
from dousa.files.disk import atomic_write, read_bytes


def test_reads_what_is_there(tmp_path):
    (tmp_path / "a.bvh").write_bytes(b"\x00\xff\r\n")
    assert read_bytes(tmp_path / "a.bvh") == b"\x00\xff\r\n"
    assert read_bytes(str(tmp_path / "a.bvh")) == b"\x00\xff\r\n"


def test_what_cannot_be_read(tmp_path):
    (tmp_path / "empty.bvh").touch()
    os.mkfifo(tmp_path / "pipe.bvh")
    for name, message in {
        "missing.bvh": "no such file",
        "empty.bvh": "empty",
        ".": "a folder",
        "pipe.bvh": "a pipe",
        "empty.bvh/inside.bvh": "part of the path is a file",
        "a\0b.bvh": "not a valid file name",
        "x" * 300: "cannot be read",
    }.items():
        with pytest.raises(MotionFileError, match=message):
            read_bytes(f"{tmp_path}/{name}")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_no_permission_to_read(tmp_path):
    path = tmp_path / "secret.bvh"
    path.write_bytes(b"x")
    path.chmod(0)
    with pytest.raises(MotionFileError, match="permission"):
        read_bytes(path)


def test_a_read_that_is_refused(tmp_path, monkeypatch):
    path = tmp_path / "a.bvh"
    path.write_bytes(b"x")

    def refuse(*_):
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr("builtins.open", refuse)
    with pytest.raises(MotionFileError, match="permission"):
        read_bytes(path)


def test_writes_and_replaces(tmp_path):
    path = tmp_path / "a.trc"
    for content in (b"first", b"second"):
        with atomic_write(path) as file:
            file.write(content)
            assert os.path.dirname(file.name) == str(tmp_path)
        assert path.read_bytes() == content
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.trc"]


def test_permissions_of_a_new_and_an_old_file(tmp_path):
    path = tmp_path / "a.trc"
    with atomic_write(path) as file:
        file.write(b"x")
    (tmp_path / "plain").touch()
    assert stat.S_IMODE(path.stat().st_mode) == stat.S_IMODE((tmp_path / "plain").stat().st_mode)
    path.chmod(0o640)
    with atomic_write(path) as file:
        file.write(b"y")
    assert stat.S_IMODE(path.stat().st_mode) == 0o640


def test_a_link_keeps_pointing(tmp_path):
    (tmp_path / "real.trc").write_bytes(b"old")
    (tmp_path / "link.trc").symlink_to("real.trc")
    with atomic_write(tmp_path / "link.trc") as file:
        file.write(b"new")
    assert (tmp_path / "link.trc").is_symlink()
    assert (tmp_path / "real.trc").read_bytes() == b"new"


@pytest.mark.parametrize("problem", [KeyboardInterrupt, ValueError, SystemExit])
def test_a_failure_leaves_the_old_file(tmp_path, problem):
    path = tmp_path / "a.trc"
    path.write_bytes(b"old")
    with pytest.raises(problem), atomic_write(path) as file:
        file.write(b"half of")
        raise problem
    assert path.read_bytes() == b"old"
    assert len(list(tmp_path.iterdir())) == 1


@pytest.mark.parametrize(
    ("number", "message"), [(errno.ENOSPC, "disk is full"), (errno.EDQUOT, "quota"), (errno.EIO, "cannot be")]
)
def test_a_disk_that_fails_while_writing(tmp_path, monkeypatch, number, message):
    def fail(_):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(MotionWriteError, match=message), atomic_write(tmp_path / "a.trc") as file:
        file.write(b"x")
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no /dev/full here")
def test_a_full_disk_on_closing(tmp_path, monkeypatch):
    """Bytes still in the buffer fail once more when the file is closed; that must not hide the reason."""
    monkeypatch.setattr("dousa.files.disk._open_part", lambda _, alone: open("/dev/full", "wb"))  # noqa: SIM115
    removed = []
    monkeypatch.setattr(os, "unlink", removed.append)
    with pytest.raises(MotionWriteError, match="disk is full"), atomic_write(tmp_path / "a.trc") as file:
        file.write(b"x" * 100)
    assert removed == ["/dev/full"]
    assert not list(tmp_path.iterdir())


def test_where_nothing_can_be_written(tmp_path):
    (tmp_path / "file").touch()
    for name, message in {
        "no/such/a.trc": "folder does not exist",
        ".": "a folder",
        "file/a.trc": "folder does not exist",
        "x" * 300 + ".trc": "too long",
        "a\0b": "not a valid file name",
    }.items():
        with pytest.raises(MotionWriteError, match=message), atomic_write(f"{tmp_path}/{name}") as file:
            file.write(b"x")
    assert [entry.name for entry in tmp_path.iterdir()] == ["file"]


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_no_permission_to_write(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(MotionWriteError, match="permission"), atomic_write(tmp_path / "a.trc") as file:
        file.write(b"x")
