"""Look through the silhouettes of a job and repair them.

    masks.json      names, sizes, rate, frames, stature, whether there are cameras; the last file to be written
    cameras.toml    the cameras, if they are known
    seen.idx        records of `dousa.app.studio.content.footage.SEEN`
    seen.bin        masks (PNG, full size) and small pictures (JPEG), one after another
    measures.npy    (2, V, T) areas and second parts, see `dousa.estimation.silhouettes.cleaning`
    repairs.json    the repairs, and those that were undone

The stored masks are never changed: repairs are applied when they are read.
"""

from __future__ import annotations

import json
import threading
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from dousa.app.studio.content.film_record import encode_mask
from dousa.app.studio.content.footage import MASK, PICTURE, SeenReader, decode_image
from dousa.app.studio.core.answers import RefusedError
from dousa.app.studio.core.workspace import write_file
from dousa.app.studio.jobs.board import JobBoard, OpenedJobs
from dousa.arrays import Image, Mask
from dousa.estimation.silhouettes.cleaning import doubt_masks, measure_mask
from dousa.estimation.silhouettes.mask_npz import write_silhouettes
from dousa.estimation.silhouettes.repairs import MaskRepair, RepairedSilhouettes, repair_from_json
from dousa.estimation.silhouettes.silhouettes import Silhouettes, checked_frame

SCENE, CAMERAS, MEASURES, EXPORTED = "masks.json", "cameras.toml", "measures.npy", "masks.npz"
_REPAIRS = "repairs.json"


class StoredMasks(Silhouettes):
    """The silhouettes in the folder of a job as they were found; RefusedError if there are none."""

    def __init__(self, folder: Path) -> None:
        try:
            scene = json.loads((folder / SCENE).read_bytes())
        except (OSError, ValueError):
            raise RefusedError(404, "studio_masks.not_one", job=folder.name) from None
        self.names = tuple(scene["names"])
        self.sizes = tuple((int(width), int(height)) for width, height in scene["sizes"])
        self.n_frames, self.frame_rate = int(scene["n_frames"]), float(scene["frame_rate"])
        self.stature: float | None = scene["stature"]
        self.has_cameras: bool = scene["cameras"]
        self._seen = SeenReader(folder)
        self._seen.refresh()

    def read(self, frame: int) -> tuple[Mask | None, ...]:
        """Read the masks (height, width) of all views in a frame; None for a view without an image."""
        return tuple(self.read_view(view, frame) for view in range(self.n_views))

    def read_view(self, view: int, frame: int) -> Mask | None:
        """Read the mask of one view."""
        image = decode_image(self._seen.read(checked_frame(frame, self.n_frames), view, MASK))
        return None if image is None else np.ascontiguousarray(image[..., 0] > 127)

    def look(self, frame: int) -> tuple[Image | None, ...]:
        """Read the small pictures behind the masks; None where there is none."""
        return tuple(decode_image(self.picture(view, frame)) for view in range(self.n_views))

    def picture(self, view: int, frame: int) -> bytes | None:
        """Read the small picture of a view as JPEG."""
        return self._seen.read(frame, view, PICTURE)


def load_repaired(folder: Path) -> tuple[StoredMasks, RepairedSilhouettes]:
    """Load the silhouettes of a job as found and as repaired; RefusedError if there are none."""
    found = StoredMasks(folder)
    return found, RepairedSilhouettes(found, _load_repairs(folder)[0])


def export_masks(folder: Path, path: Path, progress: Any = None) -> None:
    """Write the repaired silhouettes of a job with cameras and stature as npz for `dousa estimate`.

    Parameters
    ----------
    folder : of the job.
    path : the file to write.
    progress : called with (done, total, what).
    """
    from dousa.estimation.cameras.camera_files import read_cameras

    found, repaired = load_repaired(folder)
    cameras = read_cameras(folder / CAMERAS) if found.has_cameras else None
    write_silhouettes(path, repaired, cameras, stature=found.stature, progress=progress)


def _load_repairs(folder: Path) -> tuple[list[MaskRepair], list[MaskRepair]]:
    try:
        stored = json.loads((folder / _REPAIRS).read_bytes())
    except FileNotFoundError:
        return [], []
    done, undone = ([repair_from_json(one) for one in stored[name]] for name in ("done", "undone"))
    return done, undone


class MaskDesks:
    """The silhouettes that were looked at last."""

    def __init__(self, board: JobBoard) -> None:
        self._board = board
        self._opened = OpenedJobs(board, MaskDesk, 3)  # jobs

    def get(self, job_id: str) -> MaskDesk:
        """Return the silhouettes of a finished job; RefusedError for other jobs."""
        job = self._board.get(job_id)
        if job.kind != "masks":
            raise RefusedError(404, "studio_masks.not_one", job=job_id)
        if job.state != "done":
            raise RefusedError(409, "studio_masks.not_done")
        return self._opened.get(job)


class MaskDesk:
    """The silhouettes in the folder of a job, and their repairs."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.found = StoredMasks(folder)
        self._lock = threading.RLock()
        self._done, self._undone = _load_repairs(folder)
        self.repaired = RepairedSilhouettes(self.found, self._done)
        self._measures = np.load(folder / MEASURES)
        self._measure({(repair.view, frame) for repair in self._done for frame in repair.frames})

    def describe(self) -> dict[str, Any]:
        """Describe ``views`` (name, width, height, whether there are pictures), ``n_frames``, ``frame_rate``,
        ``cameras``, ``done`` and ``undone`` (numbers of repairs), ``repaired`` frames by view, ``doubts``: (frame,
        reason) by view."""
        with self._lock:
            views = [
                {"name": name, "width": width, "height": height, "pictures": self._has_pictures(view)}
                for view, (name, (width, height)) in enumerate(zip(self.found.names, self.found.sizes, strict=True))
            ]
            touched: list[set[int]] = [set() for _ in views]
            for repair in self._done:
                touched[repair.view].update(repair.frames)
            return {
                "views": views,
                "n_frames": self.found.n_frames,
                "frame_rate": self.found.frame_rate,
                "cameras": self.found.has_cameras,
                "done": len(self._done),
                "undone": len(self._undone),
                "repaired": [sorted(frames) for frames in touched],
                "doubts": [doubt_masks(*self._measures[:, view]) for view in range(len(views))],
            }

    def _has_pictures(self, view: int) -> bool:
        return any(self.found.picture(view, frame) is not None for frame in (0, self.found.n_frames // 2))

    def repair(self, repair: MaskRepair, *, most_repairs: int = 20_000) -> dict[str, Any]:
        """Add a repair and forget those undone; RefusedError if there are too many, SilhouetteError for an unknown
        frame."""
        with self._lock:
            if len(self._done) >= most_repairs:
                raise RefusedError(409, "studio_masks.many", most=most_repairs)
            RepairedSilhouettes(self.found, [repair])  # refuses a view or frame that there is not
            return self._set([*self._done, repair], [], repair)

    def undo(self) -> dict[str, Any]:
        """Undo the last repair; RefusedError if there is none."""
        with self._lock:
            if not self._done:
                raise RefusedError(409, "studio_masks.nothing_to_undo")
            return self._set(self._done[:-1], [self._done[-1], *self._undone], self._done[-1])

    def redo(self) -> dict[str, Any]:
        """Redo the repair that was undone last; RefusedError if there is none."""
        with self._lock:
            if not self._undone:
                raise RefusedError(409, "studio_masks.nothing_to_redo")
            return self._set([*self._done, self._undone[0]], self._undone[1:], self._undone[0])

    def _set(self, done: list[MaskRepair], undone: list[MaskRepair], changed: MaskRepair) -> dict[str, Any]:
        stored = {"done": [one.to_json() for one in done], "undone": [one.to_json() for one in undone]}
        write_file(self.folder / _REPAIRS, json.dumps(stored).encode())
        with suppress(FileNotFoundError):
            (self.folder / EXPORTED).unlink()
        self._done, self._undone = done, undone
        self.repaired = RepairedSilhouettes(self.found, done)
        self._measure({(changed.view, frame) for frame in changed.frames})
        where = {"view": changed.view, "frame": changed.frames[0], "count": len(changed.frames)}
        return {**self.describe(), "changed": where}

    def _measure(self, places: set[tuple[int, int]]) -> None:
        for view, frame in places:
            self._measures[:, view, frame] = measure_mask(self.repaired.read_view(view, frame))

    def mask(self, view: int, frame: int) -> bytes:
        """Return the repaired mask of a view as PNG of full size; SilhouetteError or RefusedError if there is none."""
        mask = self.repaired.read_view(view, frame)
        if mask is None:
            raise RefusedError(404, "studio_masks.no_image", frame=frame)
        return encode_mask(mask)

    def picture(self, view: int, frame: int) -> bytes:
        """Return the small picture of a view as JPEG; RefusedError if there is none."""
        content = self.found.picture(view, frame)
        if content is None:
            raise RefusedError(404, "studio_masks.no_image", frame=frame)
        return content

    def export(self) -> Path:
        """Write the repaired silhouettes as npz into the folder of the job."""
        with self._lock:
            path = self.folder / EXPORTED
            if not path.is_file():
                export_masks(self.folder, path)
            return path
