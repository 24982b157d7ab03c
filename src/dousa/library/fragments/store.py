"""Fragments: files of blocks of bytes, one after the other, that only grow; in a folder, or in object storage.

Plain blocks were the fastest layout measured (``lab/benchmarks/fragments.py``), and need no package. A block has no
header: the database has its place and its checksum. New blocks go to the end of the newest fragment, or begin another
one; in object storage, where nothing can be appended, those that are written together are a fragment of their own.
Nothing is overwritten: what a killed program wrote and no row names is left out when the library is compacted.
"""

from __future__ import annotations

import errno
import os
import re
import secrets
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from dousa.errors import LibraryError
from dousa.extras import require

MOST_BYTES = 2**28
"""Of a fragment: then another one is begun."""

_NAME = re.compile(r"\d{6,}-[0-9a-f]{8}\.blocks")
_EXTRAS = {"s3": ("s3fs", "s3"), "s3a": ("s3fs", "s3")}  # package and extra of dousa, by the beginning of a URL


class Place(NamedTuple):
    """Where a block lies.

    Parameters
    ----------
    fragment : its name.
    first_byte, n_bytes : its place in it.
    """

    fragment: str
    first_byte: int
    n_bytes: int


class FragmentStore(Protocol):
    """What keeps fragments."""

    where: str
    """Names it in messages."""

    def append(self, blocks: Sequence[bytes], into: str | None = None) -> list[Place]:
        """Write blocks, which are on the disk when this returns; into a fragment of this name where that can be."""

    def read(self, places: Sequence[Place]) -> list[bytes]:
        """Blocks, in the order of their places; those that are not there, or not whole, are shorter."""

    def sizes(self) -> dict[str, int]:
        """Bytes of all fragments, by name."""

    def delete(self, name: str) -> None:
        """Delete a fragment."""


def is_name(name: Any) -> bool:
    """Whether a fragment can have this name."""
    return isinstance(name, str) and _NAME.fullmatch(name) is not None


def make_name(known: Sequence[str]) -> str:
    """A name for a new fragment, which sorts after the others and is nobody else's."""
    last = max((int(name.partition("-")[0]) for name in known), default=0)
    return f"{last + 1:06}-{secrets.token_hex(4)}.blocks"


class FolderFragments:
    """Fragments as files of a folder.

    Parameters
    ----------
    folder : made when the first block is written.
    library : its name, for messages.
    """

    def __init__(self, folder: Path, library: str) -> None:
        self.folder, self.library, self.where = folder, library, os.fspath(folder)

    def append(self, blocks: Sequence[bytes], into: str | None = None) -> list[Place]:
        """As ``FragmentStore.append``."""
        with _plain_errors(self.library, self.where):
            self.folder.mkdir(parents=True, exist_ok=True)
            name = into or self._choose()
            path = self.folder / name
            is_new = not path.exists()
            with open(path, "ab") as file:
                end = file.seek(0, os.SEEK_END)
                file.writelines(blocks)
                file.flush()
                os.fsync(file.fileno())
            if is_new:
                _sync_folder(self.folder)
        return list(_lay_out(name, end, blocks))

    def _choose(self) -> str:
        """The newest fragment while it has room, else a new one."""
        sizes = self.sizes()
        newest = max(sizes, default=None)
        return newest if newest is not None and sizes[newest] < MOST_BYTES else make_name(list(sizes))

    def read(self, places: Sequence[Place]) -> list[bytes]:
        """As ``FragmentStore.read``."""
        found = [b""] * len(places)
        by_name: dict[str, list[int]] = {}
        for number, place in enumerate(places):
            if is_name(place.fragment) and place.first_byte >= 0 and place.n_bytes >= 0:
                by_name.setdefault(place.fragment, []).append(number)
        with _plain_errors(self.library, self.where):
            for name, numbers in by_name.items():
                with suppress(FileNotFoundError, NotADirectoryError), open(self.folder / name, "rb") as file:
                    size = os.fstat(file.fileno()).st_size
                    for number in numbers:
                        _, first, length = places[number]
                        file.seek(min(first, size))
                        found[number] = file.read(min(length, size))
        return found

    def sizes(self) -> dict[str, int]:
        """As ``FragmentStore.sizes``."""
        with _plain_errors(self.library, self.where):
            if not self.folder.is_dir():
                return {}
            with os.scandir(self.folder) as entries:
                return {entry.name: entry.stat().st_size for entry in entries if is_name(entry.name)}

    def delete(self, name: str) -> None:
        """As ``FragmentStore.delete``; an empty folder goes with its last fragment."""
        with _plain_errors(self.library, self.where), suppress(FileNotFoundError):
            os.unlink(self.folder / name)
        with suppress(OSError):
            self.folder.rmdir()


class ObjectFragments:
    """Fragments as objects of what fsspec knows, such as ``s3://bucket/moves``.

    Parameters
    ----------
    url : of the folder.
    library : its name, for messages.
    """

    def __init__(self, url: str, library: str) -> None:
        self.library, self.where = library, url
        kind = url.partition("://")[0]
        if kind in _EXTRAS:
            require(*_EXTRAS[kind])
        core = require("fsspec.core", "s3")
        with _plain_errors(library, url):
            self._files, self._root = core.url_to_fs(url)

    def append(self, blocks: Sequence[bytes], into: str | None = None) -> list[Place]:
        """As ``FragmentStore.append``; always a new fragment."""
        name = f"{int(time.time()):010}-{secrets.token_hex(4)}.blocks"  # without a list of all that are there
        with _plain_errors(self.library, self.where):
            self._files.pipe_file(f"{self._root}/{name}", b"".join(blocks))
        return list(_lay_out(name, 0, blocks))

    def read(self, places: Sequence[Place]) -> list[bytes]:
        """As ``FragmentStore.read``; neighbours are read together."""
        spans = _join([place for place in places if is_name(place.fragment)])
        paths = [f"{self._root}/{name}" for name, _, _ in spans]
        starts, ends = [first for _, first, _ in spans], [first + n for _, first, n in spans]
        with _plain_errors(self.library, self.where):
            got = self._files.cat_ranges(paths, starts, ends, on_error="return") if spans else []
            for one in got:
                if isinstance(one, Exception) and not isinstance(one, FileNotFoundError):
                    raise one
        data = {span: b"" if isinstance(one, Exception) else one for span, one in zip(spans, got, strict=True)}
        found = []
        for place in places:
            own = [span for span in data if span[0] == place.fragment and _is_within(place, span)]
            start = place.first_byte - own[0].first_byte if own else 0
            found.append(data[own[0]][start : start + place.n_bytes] if own else b"")
        return found

    def sizes(self) -> dict[str, int]:
        """As ``FragmentStore.sizes``."""
        with _plain_errors(self.library, self.where), suppress(FileNotFoundError):
            self._files.invalidate_cache(self._root)
            listed = self._files.ls(self._root, detail=True)
            found = {one["name"].rpartition("/")[2]: int(one["size"] or 0) for one in listed}
            return {name: size for name, size in found.items() if is_name(name)}
        return {}

    def delete(self, name: str) -> None:
        """As ``FragmentStore.delete``."""
        with _plain_errors(self.library, self.where), suppress(FileNotFoundError):
            self._files.rm_file(f"{self._root}/{name}")


_GAP = 2**16  # bytes between two blocks that are read together all the same


def _join(places: Sequence[Place]) -> list[Place]:
    """Stretches that have all of some blocks, neighbours in one."""
    spans: list[Place] = []
    for place in sorted(set(places)):
        last = spans[-1] if spans else None
        end = place.first_byte + place.n_bytes
        if last is not None and last.fragment == place.fragment:
            reached = last.first_byte + last.n_bytes
            if place.first_byte <= reached + _GAP and end - last.first_byte <= MOST_BYTES:
                spans[-1] = last._replace(n_bytes=max(end, reached) - last.first_byte)
                continue
        spans.append(place)
    return spans


def _is_within(place: Place, span: Place) -> bool:
    end = span.first_byte + span.n_bytes
    return span.first_byte <= place.first_byte and place.first_byte + place.n_bytes <= end


def _lay_out(name: str, start: int, blocks: Sequence[bytes]) -> Iterator[Place]:
    for block in blocks:
        yield Place(name, start, len(block))
        start += len(block)


def _sync_folder(folder: Path) -> None:
    """The name of a new file is on the disk too."""
    with suppress(OSError):  # some systems cannot open folders
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def _list_client_errors() -> tuple[type[Exception], ...]:
    """What a client of object storage raises besides errors of the system."""
    module = sys.modules.get("botocore.exceptions")
    return () if module is None else (module.BotoCoreError, module.ClientError)


@contextmanager
def _plain_errors(library: str, where: str) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            raise LibraryError("library_fragments.disk_full", library=library, where=where) from error
        raise LibraryError("library_fragments.unusable", library=library, where=where, reason=error) from error
    except Exception as error:
        # ValueError: a URL of no kind that fsspec knows; ImportError: of one whose package is not there.
        if not isinstance(error, (ValueError, ImportError, *_list_client_errors())):
            raise
        raise LibraryError("library_fragments.unusable", library=library, where=where, reason=error) from error


def open_fragments(place: str, beside: Path | None, library: str) -> FragmentStore:
    """The store of a library.

    Parameters
    ----------
    place : folder or URL; empty for ``beside``.
    beside : the folder beside a library file; None of a server.
    library : its name, for messages.
    """
    # What a file says of other places is not believed: it may come from anybody.
    if beside is not None:
        return FolderFragments(beside, library)
    if "://" in place and not place.startswith("file://"):
        return ObjectFragments(place, library)
    return FolderFragments(Path(place.removeprefix("file://")), library)
