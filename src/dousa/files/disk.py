"""Reading and writing of whole files, with clear errors and never half a file on the disk."""

from __future__ import annotations

import errno
import os
import secrets
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
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


def create_beside(target: str) -> IO[bytes]:
    """Create a file in the target's folder, with the target's permissions or those of a new file."""
    folder, name = os.path.split(target)
    temporary = os.path.join(folder, f".{name[:32]}.{secrets.token_hex(6)}.part")
    file = open(temporary, "xb")  # noqa: SIM115 - its name is the path, which os.fdopen would not keep
    with suppress(OSError):  # a new target, or a disk without permissions
        os.chmod(temporary, stat.S_IMODE(os.stat(target).st_mode))
    return file


@contextmanager
def atomic_write(path: str | os.PathLike[str]) -> Iterator[IO[bytes]]:
    """Write a file so that it appears whole or not at all.

    The bytes go to a hidden file beside the target. It replaces the target when the block ends well and is removed when
    it does not (Ctrl-C included). Links are kept.

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
        file = create_beside(target)
    except OSError as error:
        raise write_error(path, error) from error
    except ValueError as error:  # a zero byte in the name
        raise MotionWriteError(path, "disk.no_name", reason=error) from error
    try:
        yield file
        file.flush()
        os.fsync(file.fileno())
        file.close()
        os.replace(file.name, target)
    except BaseException as error:
        with suppress(OSError):  # closing flushes, which fails again on a full disk
            file.close()
        with suppress(OSError):
            os.unlink(file.name)
        if isinstance(error, OSError):
            raise write_error(path, error) from error
        raise
