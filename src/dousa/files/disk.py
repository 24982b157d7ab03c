"""Reading and writing of whole files, with clear errors and never half a file on the disk."""

from __future__ import annotations

import errno
import os
import re
import secrets
import stat
import sys
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

from dousa.errors import MotionFileError, MotionWriteError

NO_ROOM = frozenset({"disk.full", "disk.quota"})
"""Codes of errors after which nothing else can be written either."""

_WRITE_REMEDIES = {
    errno.ENOSPC: "disk.full",
    errno.EDQUOT: "disk.quota",
    errno.EACCES: "disk.write_permission",
    errno.EPERM: "disk.write_permission",
    errno.EROFS: "disk.read_only",
    errno.ENOENT: "disk.no_folder",
    errno.ENOTDIR: "disk.file_in_path",
    errno.ENAMETOOLONG: "disk.long_name",
    errno.EFBIG: "disk.large_file",
}


def read_bytes(path: str | os.PathLike[str]) -> bytes:
    """Read a whole file, which is an ordinary file that is not empty.

    Raises
    ------
    MotionFileError : missing, a folder or device, unreadable, too large for the memory, or empty.
    """
    try:
        if not stat.S_ISREG(os.stat(path).st_mode):
            raise MotionFileError(path, "disk.folder" if os.path.isdir(path) else "disk.device")
        with open(path, "rb") as file:
            data = file.read()
    except FileNotFoundError:
        raise MotionFileError(path, "disk.missing") from None
    except NotADirectoryError:
        raise MotionFileError(path, "disk.not_a_folder") from None
    except PermissionError:
        raise MotionFileError(path, "disk.no_permission") from None
    except OSError as error:
        raise MotionFileError(path, "disk.unreadable", reason=error) from error
    except ValueError as error:  # a zero byte in the name
        raise MotionFileError(path, "disk.no_name", reason=error) from error
    except MemoryError:
        raise MotionFileError(path, "disk.too_large") from None
    if not data:
        raise MotionFileError(path, "disk.empty")
    return data


def read_small_text(path: str | os.PathLike[str], most: int = 1_000_000) -> str:
    """Read the text of a file of a few lines written by hand, also of a pipe.

    Raises
    ------
    MotionFileError : it cannot be read, is larger than ``most`` bytes, or is no text in UTF-8.
    """
    try:
        # The size by the system is no limit: a device or a pipe has none, and may never end.
        with open(path, "rb") as file:
            data = file.read(most + 1)
    except OSError as error:
        raise MotionFileError(path, "small_text.unreadable", reason=error) from error
    except ValueError as error:  # a zero byte in the name
        raise MotionFileError(path, "small_text.not_a_name", reason=error) from error
    if len(data) > most:
        raise MotionFileError(path, "small_text.too_large")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise MotionFileError(path, "small_text.not_utf8", reason=error) from error
    if "\0" in text:
        raise MotionFileError(path, "small_text.zero_bytes")
    return text


def write_error(path: str | os.PathLike[str], error: OSError) -> MotionWriteError:
    """Return the error for a file that cannot be written."""
    code = _WRITE_REMEDIES.get(error.errno or 0)
    return MotionWriteError(path, code) if code else MotionWriteError(path, "disk.unwritable", reason=error)


_PART = re.compile(r"\.([0-9a-f]{8}|[0-9a-f]{12})\.part$")
"""The end of the names of `_open_part`, by definition."""

TAKEN = (errno.EAGAIN, errno.EACCES, errno.EDEADLK)
"""What the system answers where another program has the lock."""


def lock_file(file: IO[bytes]) -> None:
    """Lock a file until it is closed or the program ends; OSError at once if another has locked it."""
    if sys.platform == "win32":
        import msvcrt

        msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
    else:
        import fcntl

        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)


def sync_folder(folder: str | os.PathLike[str]) -> None:
    """Wait until the names in a folder are on the disk."""
    with suppress(OSError):  # some systems cannot open folders
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def remove_left_overs(folder: Path) -> int:
    """Delete the hidden files below a folder that killed programs left half-written; return their bytes."""
    size = 0
    for path in folder.rglob(".*.part"):
        if not _PART.search(path.name):  # of another program
            continue
        with suppress(OSError), open(path, "r+b") as file:
            lock_file(file)  # fails for what is being written
            n_bytes = os.fstat(file.fileno()).st_size
            if sys.platform == "win32":  # Windows cannot delete an open file
                file.close()
            path.unlink()
            size += n_bytes
    return size


def _open_part(target: str, *, alone: bool) -> IO[bytes] | None:
    """Open a hidden file beside a target, empty and locked; None if it must be ``alone``, with a name that follows from
    the target, and another program has it, something else has its name, or the disk has no locks.
    """
    folder, name = os.path.split(target)
    mark = f"{zlib.crc32(os.fsencode(name)):08x}" if alone else secrets.token_hex(6)
    part = os.path.join(folder, f".{name[:32]}.{mark}.part")
    # No link: in a folder for all, another user could let it lead to any file of ours.
    flags = os.O_RDWR | os.O_CREAT | getattr(os, "O_BINARY", 0) | getattr(os, "O_NOFOLLOW", 0)
    try:
        file = open(part, "r+b", opener=lambda path, _: os.open(path, flags, 0o666))  # noqa: SIM115 - by its caller
    except OSError:
        if alone and os.path.lexists(part):  # of another user
            return None
        raise
    with suppress(OSError):
        lock_file(file)
        if os.path.samestat(os.fstat(file.fileno()), os.stat(part)):  # not renamed in between
            file.truncate(0)
            return file
    if not alone:
        return file
    file.close()
    return None


@contextmanager
def _finishing(file: IO[bytes], target: str, *, sync: bool) -> Iterator[IO[bytes]]:
    """Rename a hidden file to its target when the block ends well, and delete it when it does not."""
    try:
        with suppress(OSError):  # a new target, or a disk without permissions
            os.chmod(file.name, stat.S_IMODE(os.stat(target).st_mode))
        yield file
        file.flush()
        if sync:
            os.fsync(file.fileno())
        if sys.platform == "win32":  # Windows cannot rename an open file; elsewhere it stays locked until it has
            file.close()
        os.replace(file.name, target)
    except BaseException:
        with suppress(OSError):  # closing flushes, which fails again on a full disk
            file.close()
        with suppress(OSError):
            os.unlink(file.name)
        raise
    file.close()


@contextmanager
def create_alone(path: str | os.PathLike[str]) -> Iterator[IO[bytes] | None]:
    """Write a file as ``atomic_write``, but not where another program is writing it: then None comes.

    For what can be made again: it may be lost when the power fails.
    """
    target = os.fspath(path)
    file = _open_part(target, alone=True)
    if file is None:
        yield None
    else:
        with _finishing(file, target, sync=False):
            yield file


@contextmanager
def atomic_write(path: str | os.PathLike[str]) -> Iterator[IO[bytes]]:
    """Write a file so that it appears whole or not at all.

    The bytes go to a hidden file beside the target. It replaces the target when the block ends well and is removed when
    it does not (Ctrl-C included); what a killed program left of it is written over by the next. Links are kept.

    Parameters
    ----------
    path : the file to write or replace.

    Returns
    -------
    A binary file to write to; its ``name`` is the path of the hidden file.

    Raises
    ------
    MotionWriteError : the folder is missing or read-only, the target is a folder, the disk is full.
    """
    try:
        target = os.path.realpath(path)
        if os.path.isdir(target):
            raise MotionWriteError(path, "disk.target_folder")
        # Where another program writes it as well, the last one stays.
        file = _open_part(target, alone=True) or _open_part(target, alone=False)
    except OSError as error:
        raise write_error(path, error) from error
    except ValueError as error:  # a zero byte in the name
        raise MotionWriteError(path, "disk.no_name", reason=error) from error
    assert file is not None
    try:
        with _finishing(file, target, sync=True):
            yield file
    except OSError as error:
        raise write_error(path, error) from error
