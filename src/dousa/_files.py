"""Reading and writing whole files: clear errors, and never half a file on the disk."""

from __future__ import annotations

import errno
import os
import secrets
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import IO

from dousa.errors import MotionFileError, MotionWriteError

__all__ = ["atomic_write", "read_bytes"]

_WRITE_REMEDIES = {
    errno.ENOSPC: "the disk is full; free some space or write elsewhere",
    errno.EDQUOT: "your disk quota is used up; free some space or write elsewhere",
    errno.EACCES: "no permission to write here; choose another folder or change the permissions",
    errno.EPERM: "no permission to write here; choose another folder or change the permissions",
    errno.EROFS: "the disk is read-only; choose another folder",
    errno.ENOENT: "the folder does not exist; make it first",
    errno.ENOTDIR: "the folder does not exist; part of the path is a file",
    errno.ENAMETOOLONG: "the name is too long for this disk; choose a shorter one",
    errno.EFBIG: "the file is too large for this disk",
}


def read_bytes(path: str | os.PathLike[str]) -> bytes:
    """Read a whole file.

    Parameters
    ----------
    path : an ordinary file that is not empty.

    Returns
    -------
    Its bytes.

    Raises
    ------
    MotionFileError : missing, a folder or device, unreadable, too large for the memory, or empty.
    """
    try:
        if not stat.S_ISREG(os.stat(path).st_mode):
            what = "a folder" if os.path.isdir(path) else "a pipe or device"
            raise MotionFileError(path, f"expected a file, this is {what}; name a motion file")
        with open(path, "rb") as file:
            data = file.read()
    except FileNotFoundError:
        raise MotionFileError(path, "no such file; check the name and the folder") from None
    except NotADirectoryError:
        raise MotionFileError(path, "no such file; part of the path is a file, not a folder") from None
    except PermissionError:
        raise MotionFileError(path, "no permission to read; change the permissions of the file") from None
    except OSError as error:
        raise MotionFileError(path, f"cannot be read: {error.strerror or error}") from error
    except ValueError as error:  # a zero byte in the name
        raise MotionFileError(path, f"not the name of a file: {error}") from error
    except MemoryError:
        raise MotionFileError(path, "the file does not fit into the memory of this machine") from None
    if not data:
        raise MotionFileError(path, "the file is empty; was the copy or download interrupted?")
    return data


def _write_error(path: str | os.PathLike[str], error: OSError) -> MotionWriteError:
    reason = _WRITE_REMEDIES.get(error.errno or 0) or f"cannot be written: {error.strerror or error}"
    return MotionWriteError(path, reason)


def _create_beside(target: str) -> IO[bytes]:
    """A new file in the target's folder, with the target's permissions or those a new file would get."""
    folder, name = os.path.split(target)
    temporary = os.path.join(folder, f".{name[:32]}.{secrets.token_hex(6)}.part")
    file = open(temporary, "xb")  # noqa: SIM115 - its name is the path, which os.fdopen would not keep
    with suppress(OSError):  # a new target, or a disk without permissions
        os.chmod(temporary, stat.S_IMODE(os.stat(target).st_mode))
    return file


@contextmanager
def atomic_write(path: str | os.PathLike[str]) -> Iterator[IO[bytes]]:
    """Write a file so that it appears whole or not at all.

    The bytes go to a hidden file beside the target, which takes the target's place when the block ends
    well and is removed when it does not (Ctrl-C included). A link keeps pointing where it points.

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
            raise MotionWriteError(path, "expected the name of a file, this is a folder")
        file = _create_beside(target)
    except OSError as error:
        raise _write_error(path, error) from error
    except ValueError as error:  # a zero byte in the name
        raise MotionWriteError(path, f"not the name of a file: {error}") from error
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
            raise _write_error(path, error) from error
        raise
