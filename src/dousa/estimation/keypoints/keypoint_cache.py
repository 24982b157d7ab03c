"""The cache of keypoints: finished films to read again, unfinished ones to continue.

Films are identified by content, so they may be moved or renamed. During a search sightings are written frame by frame
into a folder of this process; an interrupted search leaves it to the next one with the same film and settings. The
least recently used films are removed.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import tempfile
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray
from dousa.errors import DousaError, KeypointError
from dousa.estimation.keypoints.keypoint_files import read_keypoint_npz, write_keypoints
from dousa.estimation.keypoints.keypoints import PersonMasks, PersonTrack, ViewKeypoints
from dousa.estimation.keypoints.people import SIGHTING

_SIGHTINGS, _TIMES = "sightings.bin", "times.bin"
_POINTS, _MASKS, _CROPS, _DAMAGED = "keypoints.npz", "masks.npy", "crops.npy", "damaged.npy"


def fingerprint_film(
    path: str | os.PathLike[str], settings: Mapping[str, Any], *, n_samples: int = 48, sample: int = 262_144
) -> str:
    """Compute a hash of a film and the settings: of its size and ``n_samples`` of ``sample`` bytes each."""
    digest = hashlib.sha256(json.dumps(dict(settings), sort_keys=True, default=str).encode())
    try:
        with open(path, "rb") as file:
            size = file.seek(0, os.SEEK_END)
            digest.update(str(size).encode())
            for place in np.linspace(0, max(0, size - sample), n_samples).astype(int).tolist():
                file.seek(place)
                digest.update(file.read(sample))
    except OSError as error:
        raise KeypointError("disk.unreadable", reason=error).at(path) from error
    return digest.hexdigest()[:40]


class KeypointCache:
    """The cached keypoints of one film.

    ``n_damaged`` is the number of packets that could not be decoded, after loading or finishing.

    Parameters
    ----------
    folder : of all films; None keeps nothing.
    key : of the film and the settings, see `fingerprint_film`.
    most_bytes : of the disk, that kept films may take.
    flush_every : s, between two writes to the disk: what an interrupted search loses at most.
    """

    def __init__(
        self, folder: Path | None, key: str, *, most_bytes: int = 4_000_000_000, flush_every: float = 2.0
    ) -> None:
        self._most_bytes, self._flush_every = most_bytes, flush_every
        self._final = None if folder is None else folder / key
        self._files: list[IO[bytes]] = []
        self._work: Path | None = None
        self._last_flush = time.monotonic()
        self.n_damaged = 0

    def load(self, source: str) -> ViewKeypoints | None:
        """Load the finished keypoints, with masks mapped from the file; None if missing or damaged."""
        if self._final is None or not self._final.is_dir():
            return None
        try:
            if (self._final / _DAMAGED).exists():
                self.n_damaged = int(np.load(self._final / _DAMAGED, allow_pickle=False))
            os.utime(self._final)  # used now
            return _load(self._final, source, in_memory=False)
        except (DousaError, OSError, ValueError):
            shutil.rmtree(self._final, ignore_errors=True)
            return None

    def open(self) -> tuple[NDArray[np.void], FloatArray]:
        """Begin or continue: return sightings and times (T,) of the frames of an earlier run."""
        self._work = self._take_folder()
        times, sightings = self._work / _TIMES, self._work / _SIGHTINGS
        for path in (times, sightings):
            path.touch()
        n_frames = times.stat().st_size // 8
        os.truncate(times, 8 * n_frames)
        known = _map(sightings)
        n_sightings = int(np.searchsorted(known["frame"], n_frames))
        del known  # some systems do not cut a file that is mapped
        os.truncate(sightings, SIGHTING.itemsize * n_sightings)
        self._files = [open(path, "ab") for path in (sightings, times)]  # noqa: SIM115 - closed in `_close`
        return _map(sightings), np.fromfile(times, np.float64)

    def _take_folder(self) -> Path:
        """Return a folder of this thread: one left by another, else a new one, else a temporary one."""
        if self._final is not None:
            with suppress(OSError):
                self._final.parent.mkdir(parents=True, exist_ok=True)
                mine = self._final.with_name(f"{self._final.name}.{os.getpid()}-{threading.get_ident()}")
                shutil.rmtree(mine, ignore_errors=True)
                for left in sorted(self._final.parent.glob(f"{self._final.name}.*")):
                    if (left.suffix == ".left" or _is_abandoned(left)) and not mine.exists():
                        with suppress(OSError):
                            os.rename(left, mine)
                mine.mkdir(exist_ok=True)
                return mine
        self._final = None
        return Path(tempfile.mkdtemp(prefix="dousa-keypoints-"))

    def add(self, seconds: float, sightings: NDArray[np.void]) -> None:
        """Store one more frame."""
        try:
            self._files[0].write(sightings.tobytes())
            self._files[1].write(np.float64(seconds).tobytes())
            if time.monotonic() - self._last_flush > self._flush_every:
                self._flush()
        except OSError as error:
            raise KeypointError("keypoints.cache_disk", folder=self._work, reason=error) from error

    def _flush(self) -> None:
        for file in self._files:  # the sightings first: a frame counts once its time is there
            file.flush()
        self._last_flush = time.monotonic()

    def read(self) -> tuple[NDArray[np.void], FloatArray]:
        """Return all sightings, mapped from the file, and the times (T,)."""
        assert self._work is not None
        self._flush()
        return _map(self._work / _SIGHTINGS), np.fromfile(self._work / _TIMES, np.float64)

    def finish(
        self, keypoints: ViewKeypoints, sightings: NDArray[np.void], people: list[NDArray[np.int64]], n_damaged: int
    ) -> ViewKeypoints:
        """Write keypoints and masks, and read them back.

        Parameters
        ----------
        keypoints : without masks.
        sightings : all.
        people : for each person of the keypoints the places among the sightings.
        n_damaged : packets of the film that could not be decoded.
        """
        self.n_damaged = n_damaged
        assert self._work is not None
        try:
            write_keypoints(self._work / _POINTS, keypoints, masks=False)
            np.save(self._work / _DAMAGED, n_damaged)
            _write_masks(self._work, keypoints.n_frames, sightings, people)
            self._close()
            del sightings
            place = self._move(self._work)
            if place == self._final:
                clear_kept(place.parent, self._most_bytes, but=place)
            return _load(place, keypoints.source, in_memory=place != self._final)
        except OSError as error:
            raise KeypointError("keypoints.cache_disk", folder=self._work, reason=error) from error
        finally:
            if self._work is not None and self._work.exists():
                shutil.rmtree(self._work, ignore_errors=True)
            self._work = None

    def _move(self, work: Path) -> Path:
        """Move the finished folder to its final place, if possible, and return where it is."""
        if self._final is None:
            return work
        for name in (_SIGHTINGS, _TIMES):
            with suppress(OSError):  # on some systems a mapped file cannot be removed
                (work / name).unlink()
        with suppress(OSError):
            if not self._final.exists():  # else another process was quicker
                os.rename(work, self._final)
            return self._final
        return work

    def _close(self) -> None:
        for file in self._files:
            with suppress(OSError):
                file.close()
        self._files = []

    def leave(self) -> None:
        """Leave an unfinished folder to the next process; remove it if nothing is cached."""
        self._close()
        if self._work is None:
            return
        if self._final is None:
            shutil.rmtree(self._work, ignore_errors=True)
        else:
            with suppress(OSError):
                os.rename(self._work, self._final.with_name(f"{self._final.name}.left"))
        self._work = None


@dataclass(frozen=True, slots=True)
class KeptFilm:
    """A cached film: its folder, its size in bytes, and its last use (s since 1970)."""

    path: Path
    n_bytes: int
    used: float


def list_kept(folder: Path) -> list[KeptFilm]:
    """List the cached films and unfinished searches, latest use first."""
    kept = []
    for path in folder.iterdir() if folder.is_dir() else ():
        with suppress(OSError):
            if path.is_dir():
                n_bytes = sum(file.stat().st_size for file in path.iterdir())
                kept.append(KeptFilm(path, n_bytes, path.stat().st_mtime))
    return sorted(kept, key=lambda film: -film.used)


def clear_kept(folder: Path, most_bytes: int = 0, but: Path | None = None) -> list[KeptFilm]:
    """Remove the least recently used films until the rest takes at most so many bytes; return the removed ones.

    Parameters
    ----------
    folder : of all films.
    most_bytes : that may stay.
    but : a film to keep; films being written by another process stay as well.
    """
    removed, total = [], 0
    for film in list_kept(folder):
        busy = film.path.suffix != "" and not _is_abandoned(film.path)
        total += film.n_bytes
        if film.path != but and not busy and (total > most_bytes or not most_bytes):
            shutil.rmtree(film.path, ignore_errors=True)
            total -= film.n_bytes
            removed.append(film)
    return removed


def _map(path: Path) -> NDArray[np.void]:
    """Map the whole sightings of a file."""
    n_sightings = path.stat().st_size // SIGHTING.itemsize
    if not n_sightings:
        return np.zeros(0, SIGHTING)
    return np.memmap(path, SIGHTING, "r", shape=(n_sightings,))


def _is_abandoned(folder: Path, after: float = 60.0) -> bool:
    """Return whether the last write to an unfinished folder is more than ``after`` s ago."""
    try:
        return time.time() - max(os.stat(path).st_mtime for path in (folder, *folder.iterdir())) > after
    except OSError:
        return False


def _write_masks(folder: Path, n_frames: int, sightings: NDArray[np.void], people: list[NDArray[np.int64]]) -> None:
    from dousa.estimation.keypoints.pose_networks import PersonCrop

    shape = (len(people), n_frames, *SIGHTING["mask"].shape)
    crops = np.full((*shape[:2], 2, 3), np.nan)
    masks = np.lib.format.open_memmap(folder / _MASKS, "w+", np.uint8, shape) if people else None
    for person, rows in enumerate(people):
        for row in rows:
            seen = sightings[row]
            if masks is not None:
                masks[person, seen["frame"]] = seen["mask"]
            crop = PersonCrop(*seen["crop"].tolist())
            crops[person, seen["frame"]] = crop.matrix(shape[2])
    if masks is not None:
        masks.flush()
    np.save(folder / _CROPS, crops)


def _load(folder: Path, source: str, *, in_memory: bool) -> ViewKeypoints:
    found = read_keypoint_npz(folder / _POINTS)
    people: list[PersonTrack] = []
    if found.people:
        crops = np.load(folder / _CROPS, allow_pickle=False)
        masks = np.load(folder / _MASKS, mmap_mode=None if in_memory else "r", allow_pickle=False)
        for place, one in enumerate(found.people):
            own = PersonMasks(masks[place], crops[place])
            people.append(PersonTrack(one.points, one.visibility, one.world, own))
    return ViewKeypoints(found.names, tuple(people), found.times, found.size, source)
