"""The settings of a studio, and its folder: uploaded files in batches, and the files of jobs. No path leads out of it.

Only one studio may use a folder, as two would take each other's jobs for interrupted ones, resume and delete them. The
lock is the operating system's, so that it ends with the process.
"""

from __future__ import annotations

import json
import os
import re
import secrets
import shutil
import threading
import time
import unicodedata
from collections import OrderedDict
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any
from urllib import request

from dousa.app.studio.core.answers import RefusedError
from dousa.errors import OptionError
from dousa.files.disk import TAKEN, atomic_write, lock_file, remove_left_overs
from dousa.formats.asf_amc.reading import TOP

LOCK, RUNNING = "studio.lock", "studio.json"


class HomeTakenError(OptionError):
    """Another running studio uses the folder."""


class HomeLock:
    """The lock of a studio's folder until it is released or the process ends.

    Raises HomeTakenError if another studio has it, OSError if the folder cannot be written.
    """

    def __init__(self, home: Path) -> None:
        self._home = home
        self._file: IO[bytes] | None = open_private(home / LOCK)
        try:
            lock_file(self._file)
        except OSError as error:
            if error.errno not in TAKEN:
                return  # a disk without locks
            self._file.close()
            self._file = None
            raise HomeTakenError("studio.taken", folder=home, process=_read_note(home).get("process", "?")) from None
        self.announce(None, None, None)

    def announce(self, address: str | None, token: str | None, library: Path | None) -> None:
        """Write the address of the studio and its library into the folder, readable by this user alone."""
        known = None if library is None else str(library.absolute())
        note = {"process": os.getpid(), "address": address, "token": token, "library": known}
        temporary = self._home / f".{RUNNING}"
        with open_private(temporary) as file:
            file.truncate(0)
            file.write(json.dumps(note).encode())
        os.replace(temporary, self._home / RUNNING)

    def release(self) -> None:
        """Release the lock."""
        if self._file is not None:
            with suppress(OSError):
                (self._home / RUNNING).unlink(missing_ok=True)
            self._file.close()
            self._file = None


def open_private(path: Path) -> IO[bytes]:
    """Open a file that only this user can read, made if missing; its content is kept."""
    return os.fdopen(os.open(path, os.O_RDWR | os.O_CREAT, 0o600), "r+b")


def _read_note(home: Path) -> dict[str, Any]:
    with suppress(OSError, ValueError):
        note = json.loads((home / RUNNING).read_bytes())
        if isinstance(note, dict):
            return note
    return {}


def ask_running(home: Path, library: Path) -> str | None:
    """Ask the running studio of a folder for an address that opens it once; None if it does not answer.

    Raises OptionError if it has another library.
    """
    note = _read_note(home)
    known = note.get("library")
    if known is not None and known != str(library.absolute()):
        raise OptionError("studio.home_of_another", folder=home, library=known) from None
    address, token = note.get("address"), note.get("token")
    if not address or not token:
        return None
    asked = request.Request(f"{address}/code", b"", {"authorization": f"Bearer {token}"})
    with suppress(OSError, ValueError, KeyError):
        opener = request.build_opener(request.ProxyHandler({}))
        with opener.open(asked, timeout=5.0) as answer:  # s for the running studio to answer
            return f"{address}/?code={json.load(answer)['code']}"
    return None


@dataclass(frozen=True, slots=True)
class Settings:
    """A studio and its limits.

    Raises OptionError for a port outside 0 to 65535 or an empty token.

    Parameters
    ----------
    library : file of the motion library; made when the first motions are added.
    host, port : where it listens.
    token : the secret in its address, required from every request.
    home : folder for uploads, jobs and their results; ``NAME.studio`` beside the library by default.
    alias : a name of this machine to which browsers are sent, so that no other server of it gets their cookie; none if
        empty.
    most_bytes : of one uploaded file.
    most_unpacked_bytes : of all files of one zip archive, and of one batch of uploads.
    most_files : of one batch of uploads.
    most_memory : bytes of a process that reads an upload.
    vmc : ``HOST:PORT`` of a program that shows an avatar, to which the page Live sends the motion; none if empty.
    """

    library: Path
    host: str = "127.0.0.1"
    port: int = 8765
    token: str = field(default_factory=lambda: secrets.token_urlsafe(24))
    home: Path | None = None
    alias: str = ""
    most_bytes: int = 500_000_000
    most_unpacked_bytes: int = 4_000_000_000
    most_files: int = 20_000
    most_memory: int = 2_000_000_000
    vmc: str = ""

    def __post_init__(self) -> None:
        if not 0 <= self.port <= 65535:
            raise OptionError("studio.port", found=self.port)
        if not self.token:
            raise OptionError("studio.empty_token")

    @property
    def folder(self) -> Path:
        """The folder for everything but the library."""
        home = self.home or self.library.with_name(f"{self.library.stem}.studio")
        return home.absolute()  # what is read and added is named by whole paths

    @property
    def hosts(self) -> frozenset[str]:
        """The names of the studio in a browser on this machine; all others are foreign."""
        names = {self.host, self.alias, "127.0.0.1", "localhost", "[::1]"} - {""}
        return frozenset(f"{name}:{self.port}" for name in names)

    @property
    def address(self) -> str:
        """The address, without a slash at its end."""
        return f"http://{self.host}:{self.port}"


SPELLED = "spelled"
"""Folder of files that commands to copy name: parts of motions, figures, weights."""

_BATCH = re.compile(r"[0-9a-f]{16}")
_ALIAS = re.compile(r"dousa-[0-9a-f]{16}\.localhost")
_DEEPEST, _LONGEST, _LONGEST_PATH = 12, 200, 1_000  # folders; bytes of a name; bytes of all
# Characters that some system cannot store, or that turn the direction of writing, so that a name reads as another.
_NOWHERE = frozenset(':*?"<>|\u061c\u200e\u200f\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069')
# Reserved by Windows: "Naming Files, Paths, and Namespaces", https://learn.microsoft.com/windows/win32/fileio/
_DEVICES = frozenset({"con", "prn", "aux", "nul", *(f"{name}{n}" for name in ("com", "lpt") for n in range(1, 10))})
_KEPT = ".kept"  # marks a batch that a library or a job lives from
_INBOX = ".inbox"  # marks a batch that others on the network fill
_OF_LIBRARY = "library"  # in that file: kept as long as clips come from it


def write_file(path: Path, content: bytes) -> None:
    """Write a file, which is replaced as a whole."""
    with atomic_write(path) as file:
        file.write(content)


def measure(folder: Path) -> int:
    """Measure a file, or all files below a folder, in bytes; files that vanish meanwhile do not count."""
    total = 0
    for path in (folder, *folder.rglob("*")):
        with suppress(OSError):
            if path.is_file():
                total += path.stat().st_size
    return total


def safe_parts(name: str) -> tuple[str, ...]:
    """Split a relative path from outside into folders and file.

    Raises RefusedError for a path that is absolute, upwards, hidden, too long, too deep or empty, or has control
    characters or the name of a device.
    """
    text = unicodedata.normalize("NFC", name).replace("\\", "/")
    parts = tuple(part for part in text.split("/") if part not in ("", "."))
    if text.startswith("/") or re.match(r"[A-Za-z]:", text) or ".." in parts:
        raise RefusedError(422, "studio_files.not_relative", name=name)
    if not parts:
        raise RefusedError(422, "studio_files.no_name")
    if len(parts) > _DEEPEST or len(text.encode("utf-8", "replace")) > _LONGEST_PATH:
        raise RefusedError(422, "studio_files.deep_path", folders=_DEEPEST, bytes=_LONGEST_PATH)
    for part in parts:
        if part.startswith(".") or part == "__MACOSX":
            raise RefusedError(422, "studio_files.hidden", name=part)
        if any(unicodedata.category(character) in ("Cc", "Cs") or character in _NOWHERE for character in part):
            raise RefusedError(422, "studio_files.bad_character", name=part)
        if part.split(".")[0].strip().lower() in _DEVICES:
            raise RefusedError(422, "studio_files.device", name=part)
        if len(part.encode()) > _LONGEST or part.endswith((" ", ".")):
            raise RefusedError(422, "studio_files.bad_name", name=part[:40])
    return parts


def place_below(folder: Path, name: str) -> Path:
    """Return the path of a new file below a folder, with its own folder made; RefusedError for an unusable name."""
    path = folder.joinpath(*safe_parts(name))
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError):
        raise RefusedError(422, "studio_files.folder_is_file", name=name) from None
    if path.is_dir() or not path.parent.resolve().is_relative_to(folder.resolve()):
        raise RefusedError(422, "studio_files.not_a_file", name=name)
    return path


class Workspace:
    """The folder of one studio, made if missing; OptionError if it cannot be made."""

    def __init__(self, root: Path) -> None:
        self.root = root.absolute()
        self._held: HomeLock | None = None
        self._counting = threading.Lock()
        self._sizes: OrderedDict[str, tuple[int, int]] = OrderedDict()
        try:
            self.root.mkdir(mode=0o700, parents=True, exist_ok=True)
            for name in ("files", "jobs"):
                (self.root / name).mkdir(mode=0o700, exist_ok=True)
            (self.root / "files" / TOP).touch()  # skeletons of uploads are not looked for further up
        except OSError as error:
            raise OptionError("studio.no_home", folder=self.root, reason=error) from error

    def hold(self) -> HomeLock:
        """Lock the folder and delete what is no longer needed.

        Raises HomeTakenError if another studio has it, OptionError if it cannot be written.
        """
        try:
            self._held = HomeLock(self.root)
        except OSError as error:
            raise OptionError("studio.no_home", folder=self.root, reason=error) from error
        self._clear_stale()
        return self._held

    def release(self) -> None:
        """Release the folder."""
        if self._held is not None:
            self._held.release()
            self._held = None

    def read_alias(self) -> str:
        """Return the host name of this folder, which leads to this machine and is the same at every start.

        Browsers resolve every name below ``localhost`` to this machine themselves.
        """
        with open_private(self.root / "host") as file:
            name = file.read(100).decode("ascii", "replace")
            if not _ALIAS.fullmatch(name):
                name = f"dousa-{secrets.token_hex(8)}.localhost"
                file.seek(0)
                file.truncate()
                file.write(name.encode())
        return name

    def new_batch(self) -> str:
        """Make a new, empty batch of files and return its name."""
        batch = secrets.token_hex(8)
        (self.root / "files" / batch).mkdir()
        return batch

    def new_inbox(self) -> str:
        """Make a new batch that others on the network fill."""
        batch = self.new_batch()
        (self.root / "files" / batch / _INBOX).touch()
        return batch

    def list_inboxes(self) -> list[str]:
        """List the batches that others on the network fill, or filled, by age."""
        marks = sorted((self.root / "files").glob(f"*/{_INBOX}"), key=lambda mark: mark.stat().st_mtime)
        return [mark.parent.name for mark in marks]

    @contextmanager
    def fill_batch(self) -> Iterator[str]:
        """Make a new batch, which is deleted again where it cannot be filled."""
        batch = self.new_batch()
        try:
            yield batch
        except BaseException:
            self.discard(batch)
            raise

    def batch_folder(self, batch: str) -> Path:
        """Return the folder of a batch; RefusedError if there is none."""
        folder = self.root / "files" / batch
        if not _BATCH.fullmatch(batch) or not folder.is_dir():
            raise RefusedError(404, "studio_files.no_batch", batch=batch[:40])
        return folder

    def place(self, batch: str, name: str) -> Path:
        """Return `place_below` the folder of a batch."""
        return place_below(self.batch_folder(batch), name)

    def find(self, batch: str, name: str) -> Path:
        """Return the path of a file of a batch; RefusedError if it is missing."""
        path = self.batch_folder(batch).joinpath(*safe_parts(name))
        if not path.is_file() or path.is_symlink():
            raise RefusedError(404, "studio_files.no_file", name=name, batch=batch)
        return path

    def files(self, batch: str) -> list[Path]:
        """List all files of a batch by name."""
        folder = self.batch_folder(batch)
        return sorted(path for path in folder.rglob("*") if path.is_file() and not path.name.startswith("."))

    def grow(self, batch: str, n_files: int, n_bytes: int, most: tuple[int, int]) -> bool:
        """Count new files and bytes of a batch; returns whether they fit below ``most`` files and bytes.

        The files are listed only the first time, as a folder that is uploaded file by file would take ever longer.
        """
        with self._counting:
            if batch not in self._sizes:
                there = [path.stat().st_size for path in self.files(batch)]
                self._sizes[batch] = len(there), sum(there)
            files, size = self._sizes[batch]
            files, size = files + n_files, size + n_bytes
            self._sizes.move_to_end(batch)
            while len(self._sizes) > 1_000:  # batches whose size is remembered
                self._sizes.popitem(last=False)
            fits = n_files <= 0 or (files <= most[0] and size <= most[1])
            if fits:
                self._sizes[batch] = files, size
        return fits

    def keep(self, batch: str, *, by_library: bool = False) -> Path:
        """Mark a batch as used, so that it is never deleted, and return its folder.

        Parameters
        ----------
        by_library : only while clips of the library come from it.
        """
        folder = self.batch_folder(batch)
        if by_library and not (folder / _KEPT).exists():
            (folder / _KEPT).write_text(_OF_LIBRARY)
        elif not by_library:
            (folder / _KEPT).write_text("")
        return folder

    def discard(self, batch: str) -> None:
        """Delete a batch that is not used; an inbox is emptied, as its link goes on taking films."""
        folder = self.batch_folder(batch)
        if (folder / _KEPT).exists():
            return
        if not (folder / _INBOX).exists():
            shutil.rmtree(folder, ignore_errors=True)
            return
        for path in self.files(batch):
            path.unlink(missing_ok=True)
        with self._counting:
            self._sizes.pop(batch, None)

    def job_folder(self, job: str) -> Path:
        """Return the folder of a job, whether it exists or not."""
        if not _BATCH.fullmatch(job):
            raise RefusedError(404, "studio_jobs.no_job", job=job[:40])
        return self.root / "jobs" / job

    def list_unused(self, mentioned: str) -> list[Path]:
        """List batches that nothing uses and that are older than an hour, but for inboxes, which links lead to.

        Parameters
        ----------
        mentioned : text with the names of all batches in use.
        """
        return [
            folder
            for folder, age, used in self._list_batches(mentioned)
            # s after which a batch may be cleared away by hand
            if age > 3600.0 and (used is None or used == _OF_LIBRARY) and not (folder / _INBOX).exists()
        ]

    def list_outlived(self, mentioned: str) -> dict[Path, float]:
        """List batches that a deleted job used and that nothing mentions, with the s since their last use."""
        return {folder: age for folder, age, used in self._list_batches(mentioned) if used == ""}

    def _list_batches(self, mentioned: str) -> list[tuple[Path, float, str | None]]:
        """List batches that are not mentioned, the s since their last use, and the content of their mark."""
        found = []
        for folder in (self.root / "files").iterdir():
            with suppress(OSError):
                if not _BATCH.fullmatch(folder.name) or folder.name in mentioned:
                    continue
                kept = folder / _KEPT
                there = kept.exists()
                last = max(folder.stat().st_mtime, kept.stat().st_mtime if there else 0.0)
                found.append((folder, time.time() - last, kept.read_text() if there else None))
        return found

    def _clear_stale(self, *, stale_s: float = 7 * 86_400.0) -> None:
        # stale_s: after which other batches, and files of commands to copy, are cleared away when a studio starts
        remove_left_overs(self.root)
        for path in (self.root / SPELLED).glob("*"):
            with suppress(OSError):
                if time.time() - path.stat().st_mtime > stale_s:
                    path.unlink()
        for folder, age, used in self._list_batches(""):
            if used is None and age > stale_s:
                shutil.rmtree(folder, ignore_errors=True)
