"""List the clips of a library for the pages: filtered, counted by facets, in parts, with small moving figures.

The clips are kept in memory with columns of numbers beside them, and read again when the revision of the library
changes, as another program may have written to it. Figures and the map are keyed by clip number and `Library.contents`,
so that a figure is never shown for another clip.
"""

from __future__ import annotations

import json
import os
import re
import threading
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from dousa.app.player.figures import MINIATURE_BYTES, encode_miniature
from dousa.app.studio.content.clip_words import Reading, plain, read_text
from dousa.app.studio.content.motions import Address
from dousa.app.studio.core.answers import say
from dousa.app.studio.core.workspace import write_file
from dousa.arrays import Mask
from dousa.errors import InvalidMotionError, LibraryDamagedError
from dousa.library.label_rules import fits_category
from dousa.library.store.selection import KnownClips

if TYPE_CHECKING:
    from dousa.library import ClipInfo, ClipMap, Library, TextMatches

Match = Callable[[str], "TextMatches | None"]
"""Finds the clips that do what a text describes; None if that is not known yet."""

NO_LABEL = ""
"""Stands for clips without a label; no label is empty."""

LENGTHS: dict[str, tuple[float, float]] = {
    "0-2": (0.0, 2.0),
    "2-5": (2.0, 5.0),
    "5-15": (5.0, 15.0),
    "15-60": (15.0, 60.0),
    "60-": (60.0, np.inf),
}
"""The facet of lengths by definition, as facets.js has it: name, from so many seconds on, and below so many."""

Sort = Literal["path", "-path", "duration", "-duration", "category", "-id"]
"""What a list may be ordered by; a minus turns it round."""

_LABELS = ("category", "performer", "kind")
_MOST_NAMES, _MOST_CATEGORIES = 500, 5_000  # of one facet in one answer; categories are shown as a tree
_BATCH = re.compile(r"([0-9a-f]{16})/(.+)", re.DOTALL)


@dataclass(frozen=True, slots=True)
class ClipQuery:
    """Which clips are wanted.

    Parameters
    ----------
    text : as `read_text` understands it.
    labels : ``category``, ``performer``, ``kind`` or ``tag`` to the names that fit, `NO_LABEL` for none; all if empty.
        A category is read by `fits_category`.
    min_s, max_s : shortest length, and the length that is too long, s; None for any.
    batch : only clips of this batch of uploads.
    sort : order of the list.
    among : only clips of these numbers; None for all.
    wide : include clips that do what the text says even if others are called so.
    """

    text: str = ""
    labels: dict[str, Sequence[str]] = field(default_factory=dict)
    min_s: float | None = None
    max_s: float | None = None
    batch: str | None = None
    sort: Sort = "path"
    among: frozenset[int] | None = None
    wide: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """The clips that fit.

    Parameters
    ----------
    rows : (n,) rows of the snapshot in the order wanted.
    facets : facet to name to number of clips that would fit if this facet were left open.
    reading : how the text was understood.
    """

    rows: NDArray[np.intp]
    facets: dict[str, dict[str, int]]
    reading: Reading


class Snapshot:
    """All clips of one revision of a library; never changed, so that requests can share it.

    Parameters
    ----------
    clips : in the order of their paths.
    revision : of the library.
    uploads : folder of the batches; clips in it are named by their path in the batch.
    before : an earlier snapshot, whose texts are reused for unchanged clips.
    """

    def __init__(self, clips: Sequence[ClipInfo], revision: int, uploads: Path, before: Snapshot | None = None) -> None:
        self.clips, self.revision = tuple(clips), revision
        self.ids = np.array([clip.id for clip in clips], np.int64)
        self.durations = np.array([clip.duration for clip in clips], np.float64)
        self._rows = {clip.id: row for row, clip in enumerate(clips)}
        self._batches, self._shorts = _shorten([clip.path for clip in clips], f"{uploads}{os.sep}")
        self._texts = self._read_texts(before)
        self._names: dict[str, list[str]] = {}
        self._codes: dict[str, NDArray[np.intp]] = {}
        for label in _LABELS:
            values = [getattr(clip, label) or NO_LABEL for clip in clips]
            self._names[label] = sorted(set(values))
            code = {name: number for number, name in enumerate(self._names[label])}
            self._codes[label] = np.array([code[value] for value in values], np.intp)
        self._are_clips = np.array([clip.kind != "take" for clip in clips], bool)
        self._tags = [clip.tags or (NO_LABEL,) for clip in clips]
        self._lengths = np.digitize(self.durations, [end for _, end in LENGTHS.values()])
        self._orders: dict[str, NDArray[np.intp]] = {}

    def __contains__(self, clip_id: int) -> bool:
        return clip_id in self._rows

    def _read_texts(self, before: Snapshot | None) -> list[str]:
        """Make the text in which each clip is searched."""
        known = {} if before is None else before._read
        self._read: dict[int, tuple[ClipInfo, str, str]] = {}
        for clip, short in zip(self.clips, self._shorts, strict=True):
            own = known.get(clip.id)
            if own is None or own[0] is not clip or own[1] != short:
                own = clip, short, _searchable(clip, short)
            self._read[clip.id] = own
        return [text for _, _, text in self._read.values()]

    def row_of(self, clip_id: int) -> int:
        """Return the row of a clip of the snapshot."""
        return self._rows[clip_id]

    def find(self, asked: ClipQuery, match: Match = lambda text: None) -> Found:
        """Find the rows that fit and count the facets; ``match`` finds clips by what they do, like `Meanings.match`."""
        masks = {label: self._labelled(label, asked.labels.get(label, ())) for label in _LABELS}
        masks["tag"] = self._tagged(asked.labels.get("tag", ()))
        masks["length"] = self._long(asked.min_s, asked.max_s)
        reading = read_text(self._texts, self.ids, asked.text, match, wide=asked.wide)
        rest = reading.fits
        if asked.among is not None:
            rest = _both(rest, np.isin(self.ids, np.array(sorted(asked.among), np.int64)))
        if asked.batch is not None:
            rest = _both(rest, np.array([batch == asked.batch for batch in self._batches], bool))
        fits = rest
        for mask in masks.values():
            fits = _both(fits, mask)
        order = self._order(asked.sort)
        rows = order if fits is None else order[fits[order]]
        if reading.scores is not None and asked.sort == "path":
            rows = rows[np.argsort(-reading.scores[rows], kind="stable")]
        return Found(rows, {name: self._count(name, rest, masks) for name in masks}, reading)

    def describe(self, row: int) -> dict[str, Any]:
        """Describe one clip for the pages."""
        clip = self.clips[row]
        folder, _, name = self._shorts[row].rpartition("/")
        warnings = [say(warning) for warning in clip.warnings]
        return {
            **clip.to_json(),
            "warnings": warnings,
            "motion": str(Address(clip=clip.id)),
            "name": name,
            "folder": folder,
        }

    def summarise(self) -> dict[str, Any]:
        """Count clips, takes, seconds and categories of the whole library."""
        names, codes = self._names["category"], self._codes["category"]
        takes = ~self._are_clips
        sizes = dict(zip(names, np.bincount(codes[~takes], minlength=len(names)).tolist(), strict=True))
        n_unlabelled = sizes.pop(NO_LABEL, 0)
        return {
            "n_clips": int((~takes).sum()),
            "n_takes": int(takes.sum()),
            "seconds": float(self.durations.sum()),
            "n_categories": sum(size > 0 for size in sizes.values()),
            "n_unlabelled": n_unlabelled,
        }

    def _labelled(self, label: str, wanted: Sequence[str]) -> Mask | None:
        if not wanted:
            return None
        if label == "category":
            fits = [any(fits_category(name, one) for one in wanted) for name in self._names[label]]
        else:
            fits = [name in wanted for name in self._names[label]]
        known = np.array(fits, bool)
        found = known[self._codes[label]] if len(known) else np.zeros(0, bool)
        return found & self._are_clips if label == "category" else found  # a take does not lack one

    def _tagged(self, wanted: Sequence[str]) -> Mask | None:
        names = frozenset(wanted)
        return np.array([not names.isdisjoint(tags) for tags in self._tags], bool) if names else None

    def _long(self, min_s: float | None, max_s: float | None) -> Mask | None:
        if min_s is None and max_s is None:
            return None
        low, high = min_s or 0.0, np.inf if max_s is None else max_s
        return np.asarray((self.durations >= low) & (self.durations < high))

    def _count(self, name: str, rest: Mask | None, masks: dict[str, Mask | None]) -> dict[str, int]:
        mask = rest
        for other, own in masks.items():
            if other != name:
                mask = _both(mask, own)
        if name == "category":
            mask = _both(mask, self._are_clips)
        if name == "tag":
            rows = range(len(self._tags)) if mask is None else np.flatnonzero(mask)
            return dict(Counter(tag for row in rows for tag in self._tags[row]).most_common(_MOST_NAMES))
        names = list(LENGTHS) if name == "length" else self._names[name]
        codes = self._lengths if name == "length" else self._codes[name]
        counts = np.bincount(codes if mask is None else codes[mask], minlength=len(names))
        chosen = np.flatnonzero(counts)
        most = _MOST_CATEGORIES if name == "category" else _MOST_NAMES
        if len(chosen) > most:
            chosen = np.sort(chosen[np.argsort(-counts[chosen], kind="stable")[:most]])
        return {names[code]: int(counts[code]) for code in chosen}

    def _order(self, sort: str) -> NDArray[np.intp]:
        if sort not in self._orders:
            key = sort.removeprefix("-")
            values = {
                "path": np.arange(len(self.clips)),
                "duration": self.durations,
                "category": self._codes["category"],
                "id": self.ids,
            }[key]
            self._orders[sort] = np.argsort(-values if sort.startswith("-") else values, kind="stable")
        return self._orders[sort]


class Listing:
    """Provides the current snapshot of the library.

    Parameters
    ----------
    library : returns the open library.
    uploads : folder of the batches.
    """

    def __init__(self, library: Callable[[], Library], uploads: Path) -> None:
        self._library, self._uploads = library, uploads
        self._lock = threading.Lock()
        self._snapshot: Snapshot | None = None
        self._known: KnownClips | None = None
        self._of: Library | None = None  # another file may have taken the library's place

    def now(self) -> Snapshot:
        """Return all clips as they are now; they are read only if something has changed."""
        library = self._library()
        with self._lock:  # when many ask at once, one reads
            revision = library.revision
            before = self._snapshot if self._of is library else None
            if before is None or before.revision != revision:
                # The number was read before the clips: at worst they are newer, and are read once more.
                known = library.renew_clips(None if before is None else self._known)
                clips = sorted(known.clips.values(), key=lambda clip: clip.path)
                self._snapshot = Snapshot(clips, revision, self._uploads, before)
                self._known, self._of = known, library
                return self._snapshot
            return before


def _both(first: Mask | None, second: Mask | None) -> Mask | None:
    if first is None or second is None:
        return second if first is None else first
    return first & second


def _searchable(clip: ClipInfo, short: str) -> str:
    words = (short, clip.category or clip.predicted_category, clip.performer, *clip.tags)
    return plain("\n".join(word for word in words if word))


def _shorten(paths: Sequence[str], uploads: str) -> tuple[list[str | None], list[str]]:
    """Find the batch of each file, and its path without the folder of its batch or the folder that all other files
    share."""
    matches = [_BATCH.fullmatch(path.removeprefix(uploads)) if path.startswith(uploads) else None for path in paths]
    others = list({os.path.dirname(path) for path, match in zip(paths, matches, strict=True) if match is None})
    # The last shared folder stays: it may be the only one with a meaning.
    shared = os.path.dirname(_shared_folder(others)).rstrip(os.sep)
    shorts = [
        (match[2] if match else path.removeprefix(shared).lstrip(os.sep)).replace(os.sep, "/")
        for path, match in zip(paths, matches, strict=True)
    ]
    return [match[1] if match else None for match in matches], shorts


def _shared_folder(folders: Sequence[str]) -> str:
    try:
        return os.path.commonpath(folders)
    except ValueError:  # none, or on several drives
        return ""


class Figures:
    """The figures of clips, made when they are shown; those shown last are remembered.

    Parameters
    ----------
    most : figures that are remembered, 1.5 kB each; with fewer those of long takes are made again more often.
    """

    def __init__(self, *, most: int = 5_000) -> None:
        self._most = most
        self._made: dict[tuple[int, str], bytes] = {}

    def get(self, library: Library, clip_ids: Sequence[int]) -> bytes:
        """Return records of `encode_miniature` in the order of the numbers; zeros for clips that are missing or
        damaged."""
        contents = library.contents(clip_ids)
        found = {number: self._made.get((number, content)) for number, content in contents.items()}
        made = _make(library, [number for number, record in found.items() if record is None])
        if len(self._made) > self._most:
            self._made = {}
        self._made |= {(number, contents[number]): record for number, record in made.items()}
        return b"".join(made.get(number) or found.get(number) or bytes(MINIATURE_BYTES) for number in clip_ids)


def _make(library: Library, clip_ids: Sequence[int]) -> dict[int, bytes]:
    made: dict[int, bytes] = {}
    try:
        for clip_id, motion in library.iterate_trajectories(clip_ids):
            with suppress(InvalidMotionError):
                made[clip_id] = encode_miniature(motion)
    except LibraryDamagedError:
        if len(clip_ids) == 1:
            return {}
        # One of them is damaged; the others are shown.
        return {clip_id: record for one in clip_ids for clip_id, record in _make(library, [one]).items()}
    return made


_MAP_NAME = "map.json"


def keep_map(home: Path, found: ClipMap, contents: Mapping[int, str], *, digits: int = 4) -> None:
    """Write a map into the folder of a studio; ``contents`` are those of `Library.contents` for its clips."""
    places = zip(found.clip_ids.tolist(), found.points.tolist(), strict=True)
    clips = [[n, contents[n], round(x, digits), round(y, digits)] for n, (x, y) in places if n in contents]
    kept = {"clips": clips, "left_out": list(found.left_out)}
    write_file(home / _MAP_NAME, json.dumps(kept).encode())


class KeptMap:
    """The map of one studio.

    Parameters
    ----------
    home : folder of the studio.
    library : returns the open library.
    listing : of its clips.
    """

    def __init__(self, home: Path, library: Callable[[], Library], listing: Listing) -> None:
        self._path = home / _MAP_NAME
        self._library, self._listing = library, listing
        self._lock = threading.Lock()
        self._told: tuple[Any, dict[str, Any]] | None = None

    def describe(self) -> dict[str, Any]:
        """Describe the clips that are unchanged since the map was made: numbers, points and categories.

        ``n_new`` clips came later or have changed, ``n_left_out`` lack joints; ``is_made`` is false without a map.
        """
        snapshot = self._listing.now()
        with self._lock:
            key = snapshot.revision, id(snapshot), self._stamp()
            if self._told is None or self._told[0] != key:
                self._told = key, self._compare(snapshot)
            return self._told[1]

    def _stamp(self) -> int:
        try:
            return self._path.stat().st_mtime_ns
        except OSError:
            return 0

    def _compare(self, snapshot: Snapshot) -> dict[str, Any]:
        clips = {clip.id: clip for clip in snapshot.clips if clip.kind == "clip"}
        try:
            kept = json.loads(self._path.read_bytes())
            places = {int(number): (str(content), float(x), float(y)) for number, content, x, y in kept["clips"]}
            lacking = [number for number in kept["left_out"] if number in clips]
        except (OSError, ValueError, KeyError, TypeError):
            lists: dict[str, Any] = {name: [] for name in ("ids", "x", "y", "categories", "category")}
            return {"is_made": False, **lists, "n_new": len(clips), "n_left_out": 0}
        contents = self._library().contents([number for number in places if number in clips])
        ids = [number for number in places if contents.get(number) == places[number][0]]
        names = sorted({clips[number].category or "" for number in ids})
        code = {name: place for place, name in enumerate(names)}
        return {
            "is_made": True,
            "ids": ids,
            "x": [places[number][1] for number in ids],
            "y": [places[number][2] for number in ids],
            "categories": names,
            "category": [code[clips[number].category or ""] for number in ids],
            "n_new": len(clips) - len(ids) - len(lacking),
            "n_left_out": len(lacking),
        }
