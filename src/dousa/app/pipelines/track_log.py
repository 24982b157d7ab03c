"""The state of interrupted tracking, in a hidden file beside the output, from which the same command resumes.

The file holds a fingerprint of everything the result depends on. One that is damaged, of other inputs or of another
version is passed over with a note; it is replaced as the work goes on and removed at its end.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import time
import zipfile
import zlib
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from dousa.errors import DousaError, SilhouetteError
from dousa.files.disk import atomic_write
from dousa.files.npz_arrays import open_npz
from dousa.messages import Message

_Track = TypeVar("_Track")

_KEY = "fingerprint"

# What numpy and zipfile raise on files that are no npz, or damaged ones.
_DAMAGE = (
    OSError,
    ValueError,
    KeyError,
    EOFError,
    TypeError,
    zipfile.BadZipFile,
    zlib.error,
    NotImplementedError,
)


def describe_files(paths: Iterable[str | os.PathLike[str]]) -> list[list[Any]]:
    """Place, size and time of files, and of all files in folders: what changes when their content does."""
    found: list[list[Any]] = []
    for path in paths:
        place = os.path.realpath(path)
        inside = sorted(_walk(place)) if os.path.isdir(place) else [place]
        for file in inside[:200_000]:
            try:
                state = os.stat(file)
            except OSError:
                continue
            found.append([file, state.st_size, state.st_mtime_ns])
    return found


def _walk(folder: str) -> list[str]:
    return [os.path.join(root, name) for root, _, names in os.walk(folder) for name in names]


def fingerprint(parts: Mapping[str, Any]) -> str:
    """One short text for everything that a result depends on: arrays, numbers, texts, data classes of them."""
    digest = hashlib.sha256()
    for name in sorted(parts):
        digest.update(name.encode())
        _feed(digest, parts[name])
    return digest.hexdigest()


def _feed(digest: Any, value: Any) -> None:
    if isinstance(value, np.ndarray):
        digest.update(f"{value.dtype.str}{value.shape}".encode())
        digest.update(np.ascontiguousarray(value).tobytes())
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        for field in dataclasses.fields(value):
            digest.update(field.name.encode())
            _feed(digest, getattr(value, field.name))
    elif isinstance(value, list | tuple):
        digest.update(f"[{len(value)}".encode())
        for item in value:
            _feed(digest, item)
    else:
        digest.update(json.dumps(value, default=repr, sort_keys=True).encode())


class PartialFile:
    """The hidden file of one output.

    Parameters
    ----------
    output : the file that is being made; the hidden one lies beside it. None keeps nothing.
    key : `fingerprint` of inputs, settings and version.
    every : s between two writes; `every_s`, 3, by default: with more, more is lost where the work is killed.
    """

    every_s = 3.0

    def __init__(self, output: Path | None, key: str, every: float | None = None) -> None:
        self.path = None if output is None else output.with_name(f".{output.name}.partial.npz")
        self.problem: Message | None = None
        self._key = key
        self._every = self.every_s if every is None else every
        self._last = time.monotonic()

    def load(self, kind: type[_Track]) -> tuple[_Track | None, Message | None]:
        """What an earlier run left, as the data class it was, and what a person should know about it."""
        if self.path is None or not os.path.lexists(self.path):
            return None, None
        try:
            most = os.path.getsize(self.path)  # it is not compressed
            with open_npz(self.path, SilhouetteError) as file:
                if str(file.read(_KEY, "U", 0, most)) != self._key:
                    return None, Message("track_log.other_work", path=self.path)
                names = [field.name for field in dataclasses.fields(kind)]  # type: ignore[arg-type]
                return kind(
                    **{name: _unpack(file.read(name, "biufU", None, most)) for name in names if name in file}
                ), None
        except (*_DAMAGE, DousaError) as error:
            return None, Message("track_log.unusable", path=self.path, reason=error)

    def save(self, make: Callable[[], Any]) -> None:
        """Make and keep a data class of arrays, numbers and texts, unless that was done a moment ago."""
        if self.path is None or self.problem is not None or time.monotonic() - self._last < self._every:
            return
        track = make()
        fields = {field.name: getattr(track, field.name) for field in dataclasses.fields(track)}
        try:
            with atomic_write(self.path) as file:
                arrays = {name: np.asarray(value) for name, value in fields.items() if value is not None}
                np.savez(file, **{_KEY: np.array(self._key), **arrays})  # type: ignore[arg-type]
        except DousaError as error:  # a full disk must not end hours of work
            self.problem = Message("track_log.not_kept", reason=error)
        self._last = time.monotonic()

    def remove(self) -> None:
        """The work is done."""
        if self.path is not None:
            with suppress(OSError):
                self.path.unlink(missing_ok=True)


def _unpack(array: np.ndarray) -> Any:
    if array.ndim == 0:
        return array.item()
    if array.dtype.kind == "U":
        return tuple(array.tolist())
    array.flags.writeable = False
    return array
