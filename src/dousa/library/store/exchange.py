"""The exchange of a library file for a new one, which is there whole or not at all, and deletes nothing.

All is prepared in the folder ``NAME.part`` beside the library: the new one in ``new``, the one that it replaces in
``old``. When both are there, ``new`` becomes ``ready``, and what is in it gets its name. Where a program was killed,
who opens the library next, or copies another there, gives the name to what is ready, and otherwise to what is old.
"""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import count
from pathlib import Path

from dousa.errors import LibraryLockedError
from dousa.files.disk import lock_file, sync_folder, write_error

_NEEDED = (".fragments", "-journal", "-wal", "")
_PARTS = ("-windows", "-search", "-search-later", "-shm", *_NEEDED)
"""What belongs to a library file, by the ends of names; the file comes last and goes first: it is the library."""


@contextmanager
def prepare(path: Path) -> Iterator[Path]:
    """Make the folder to prepare a library in, alone; the new one is written below ``new`` under its own name.

    Raises LibraryLockedError where another program does, MotionWriteError if the disk cannot be written.
    """
    folder = path.with_name(f"{path.name}.part")
    made = [one for one in path.parents if not one.exists()]
    try:
        settle(path.parent)
        folder.mkdir(parents=True, exist_ok=True)
        with open(folder / "lock", "wb") as lock:
            try:
                lock_file(lock)
            except OSError:
                raise LibraryLockedError("library_backup.at_work", library=os.fspath(path)) from None
            try:
                for name in ("old", "new"):
                    (folder / name).mkdir()
                yield folder
            finally:
                with suppress(OSError):
                    _finish(folder, path)
                if sys.platform == "win32":  # Windows cannot delete an open file
                    lock.close()
                shutil.rmtree(folder, ignore_errors=True)
    except OSError as error:
        raise write_error(path, error) from error
    finally:
        for empty in made:
            with suppress(OSError):
                empty.rmdir()


def exchange(folder: Path, path: Path, kept: str = "replaced", *, stays: Sequence[str] = ()) -> str | None:
    """Give the new library its name; the old one goes to a folder, whose name is returned.

    Parameters
    ----------
    folder : of `prepare`.
    path : of the library.
    kept : the end of the name of the folder for the old one.
    stays : ends of names of what the new one takes over.
    """
    for end in reversed(_PARTS):
        if end not in stays and path.with_name(path.name + end).exists():
            path.with_name(path.name + end).rename(folder / "old" / (path.name + end))
    (folder / "new").rename(folder / "ready")
    sync_folder(folder)
    return _finish(folder, path, kept)


def _finish(folder: Path, path: Path, kept: str = "replaced") -> str | None:
    """Give the name, unless another library has it by now, to what is ready, or else to what is old.

    A file that is no part of a library made again is never deleted: it may be all that is left of one.
    """
    old, ready = folder / "old", folder / "ready"
    source = ready if ready.exists() else old
    if not path.exists():
        for end in _PARTS:
            if (source / (path.name + end)).exists():
                (source / (path.name + end)).rename(path.with_name(path.name + end))
        sync_folder(path.parent)
    for done in (folder / "new", ready):
        shutil.rmtree(done, ignore_errors=True)
    if not any((old / (path.name + end)).exists() for end in _NEEDED):
        shutil.rmtree(old, ignore_errors=True)
        return None
    names = (path.with_name(f"{path.name}.{kept}{number or ''}") for number in count())
    return os.fspath(old.rename(next(name for name in names if not name.exists())))


def settle(folder: Path) -> None:
    """Finish the exchanges of libraries in a folder that killed programs have left."""
    for part in folder.glob("*.part"):
        with suppress(OSError):
            found = {one.name for one in part.iterdir()}
            if not found or not found <= {"lock", "old", "new", "ready"}:
                continue  # of another program
            with open(part / "lock", "ab") as lock:
                lock_file(lock)
                _finish(part, part.with_suffix(""))
                if sys.platform == "win32":
                    lock.close()
                shutil.rmtree(part)


__all__ = ["exchange", "prepare", "settle"]
