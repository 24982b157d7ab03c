"""The studio's own folder: uploaded files in batches, jobs with what they wrote; and no path that leads out of it."""

from __future__ import annotations

import re
import secrets
import shutil
import threading
import time
import unicodedata
from collections import OrderedDict
from contextlib import suppress
from pathlib import Path

from dousa.app.studio.problems import RefusedError
from dousa.errors import OptionError
from dousa.formats.asf_amc import TOP

__all__ = ["Workspace", "safe_parts"]

_BATCH = re.compile(r"[0-9a-f]{16}")
_DEEPEST, _LONGEST, _LONGEST_PATH = 12, 200, 1_000  # folders; bytes of a name; bytes of all
_KEPT = ".kept"  # marks a batch that a library or a job lives from
_MOST_COUNTED = 1_000  # batches whose size is remembered
_STALE = 7 * 86_400.0  # s after which other batches are cleared away when a studio starts


def safe_parts(name: str) -> tuple[str, ...]:
    """The folders and the file of a relative path that somebody sent, each fit to be made.

    Raises
    ------
    RefusedError : absolute, upwards, hidden, with control characters, too long or too deep, or empty.
    """
    text = unicodedata.normalize("NFC", name).replace("\\", "/")
    parts = tuple(part for part in text.split("/") if part not in ("", "."))
    if text.startswith("/") or re.match(r"[A-Za-z]:", text) or ".." in parts:
        raise RefusedError(422, f"{name!r}: expected a relative path without '..', such as kick/anna_1.bvh")
    if not parts:
        raise RefusedError(422, "expected the name of the file, such as ?name=walk.bvh")
    if len(parts) > _DEEPEST or len(text.encode("utf-8", "replace")) > _LONGEST_PATH:
        raise RefusedError(422, f"expected at most {_DEEPEST} folders and {_LONGEST_PATH} bytes in a path")
    for part in parts:
        if part.startswith(".") or part == "__MACOSX":
            raise RefusedError(422, f"{part!r}: hidden files are not motions")
        if any(
            unicodedata.category(character) in ("Cc", "Cs") or character in ':*?"<>|' for character in part
        ):
            raise RefusedError(
                422, f"{part!r}: a character in this name is not one for file names; rename the file"
            )
        if len(part.encode()) > _LONGEST or part.endswith((" ", ".")):
            raise RefusedError(
                422, f"{part[:40]!r}: expected a shorter name without a dot or space at its end"
            )
    return parts


class Workspace:
    """The folder of one studio.

    Parameters
    ----------
    root : made if missing.

    Raises
    ------
    OptionError : it cannot be made.
    """

    def __init__(self, root: Path) -> None:
        self.root = root.absolute()
        self._counting = threading.Lock()
        self._sizes: OrderedDict[str, tuple[int, int]] = OrderedDict()
        try:
            for name in ("files", "jobs"):
                (self.root / name).mkdir(parents=True, exist_ok=True)
            (self.root / "files" / TOP).touch()  # skeletons of uploads are not looked for further up
        except OSError as error:
            raise OptionError(
                f"{self.root}: the studio needs this folder and cannot make it: {error.strerror}; "
                "choose another with --home"
            ) from error
        self._clear_stale()

    def new_batch(self) -> str:
        """The name of a new, empty batch of files."""
        batch = secrets.token_hex(8)
        (self.root / "files" / batch).mkdir()
        return batch

    def batch_folder(self, batch: str) -> Path:
        """The folder of a batch.

        Raises
        ------
        RefusedError : there is no such batch.
        """
        folder = self.root / "files" / batch
        if not _BATCH.fullmatch(batch) or not folder.is_dir():
            raise RefusedError(404, f"no batch of files {batch[:40]!r}; upload the files again")
        return folder

    def place(self, batch: str, name: str) -> Path:
        """Where a file of a batch is or will be; its folder is made.

        Raises
        ------
        RefusedError : no such batch, or a name that cannot be used.
        """
        folder = self.batch_folder(batch)
        path = folder.joinpath(*safe_parts(name))
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError:  # a file where the folder should be
            raise RefusedError(422, f"{name!r}: a file of this batch has the name of the folder") from None
        if path.is_dir() or not path.parent.resolve().is_relative_to(folder.resolve()):
            raise RefusedError(422, f"{name!r}: expected the name of a file")
        return path

    def find(self, batch: str, name: str) -> Path:
        """A file of a batch.

        Raises
        ------
        RefusedError : it is not there.
        """
        path = self.batch_folder(batch).joinpath(*safe_parts(name))
        if not path.is_file() or path.is_symlink():
            raise RefusedError(404, f"no file {name!r} in batch {batch}; upload it again")
        return path

    def files(self, batch: str) -> list[Path]:
        """All files of a batch, by name."""
        folder = self.batch_folder(batch)
        return sorted(path for path in folder.rglob("*") if path.is_file() and not path.name.startswith("."))

    def grow(self, batch: str, n_files: int, n_bytes: int, most: tuple[int, int]) -> bool:
        """Count what is about to be put into a batch; whether it fits below so many files and bytes.

        The files are looked at only the first time: a folder that comes file by file would take ever longer.
        """
        with self._counting:
            if batch not in self._sizes:
                there = [path.stat().st_size for path in self.files(batch)]
                self._sizes[batch] = len(there), sum(there)
            files, size = self._sizes[batch]
            files, size = files + n_files, size + n_bytes
            self._sizes.move_to_end(batch)
            while len(self._sizes) > _MOST_COUNTED:
                self._sizes.popitem(last=False)
            fits = n_files <= 0 or (files <= most[0] and size <= most[1])
            if fits:
                self._sizes[batch] = files, size
        return fits

    def keep(self, batch: str) -> Path:
        """Say that a batch is in use, so that it is never cleared away; its folder."""
        folder = self.batch_folder(batch)
        (folder / _KEPT).touch()
        return folder

    def discard(self, batch: str) -> None:
        """Take away a batch that is not in use."""
        folder = self.batch_folder(batch)
        if not (folder / _KEPT).exists():
            shutil.rmtree(folder, ignore_errors=True)

    def job_folder(self, job: str) -> Path:
        """The folder of a job, whether it exists or not."""
        if not _BATCH.fullmatch(job):
            raise RefusedError(404, f"no job {job[:40]!r}")
        return self.root / "jobs" / job

    def _clear_stale(self) -> None:
        for folder in (self.root / "files").iterdir():
            with suppress(OSError):
                old = time.time() - folder.stat().st_mtime > _STALE
                if old and _BATCH.fullmatch(folder.name) and not (folder / _KEPT).exists():
                    shutil.rmtree(folder, ignore_errors=True)
