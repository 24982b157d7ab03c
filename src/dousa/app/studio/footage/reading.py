"""Looking at an estimation while it runs and afterwards: its frames, overlays and figure, from what the work wrote."""

from __future__ import annotations

import dataclasses
import threading
from collections import OrderedDict
from pathlib import Path
from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from dousa.app.studio.footage.recording import MASK, PICTURE, SEEN, canonical_indices, pose_record
from dousa.app.studio.problems import RefusedError

if TYPE_CHECKING:
    from dousa.app._overlay_view import ViewPainter
    from dousa.app.studio.studio import Studio

__all__ = ["Footage", "footage_of"]

_LONGEST = 480  # px of an overlay
_MOST_OVERLAYS = 240  # kept, some 25 KB each
_MOST_OPEN = 4  # estimations
_MOST_RECORDS = 20_000  # in one answer
_JPEG = 88

_open: WeakKeyDictionary[Studio, OrderedDict[str, Footage]] = WeakKeyDictionary()
_opening = threading.Lock()


def footage_of(studio: Studio, job_id: str) -> Footage:
    """What can be seen of an estimation; it may be nothing yet.

    Raises
    ------
    RefusedError : no such job, or of another kind.
    """
    job = studio.jobs.get(job_id)
    if job.kind != "estimate":
        raise RefusedError(404, f"job {job_id} is no estimation")
    with _opening:
        shelf = _open.setdefault(studio, OrderedDict())
        if job_id not in shelf:
            shelf[job_id] = Footage(studio.jobs.folder(job))
        shelf.move_to_end(job_id)
        while len(shelf) > _MOST_OPEN:
            shelf.popitem(last=False)
        found = shelf[job_id]
    found.refresh()
    return found


class Footage:
    """One estimation as far as it is.

    Parameters
    ----------
    folder : of its job.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._lock = threading.RLock()
        self._stamp: tuple[int, int] | None = None
        self._clear()

    def _clear(self) -> None:
        self.total, self.frame_rate, self.run = 0, 30.0, ""
        self.names: tuple[str, ...] = ()
        self.sizes: tuple[tuple[int, int], ...] = ()
        self._order: list[int] = []
        self._seen: dict[tuple[int, int, int], tuple[int, int]] = {}
        self._read = {"poses.bin": 0, "seen.idx": 0}
        self._painters: dict[int, ViewPainter] = {}
        self._overlays: OrderedDict[tuple[int, int, int], bytes] = OrderedDict()
        self._facing: dict[str, float] | None = None
        self._rows: Any = None
        self._is_person = False

    # --- taking in what is new

    def refresh(self) -> None:
        """Read what was written since the last look."""
        with self._lock:
            path = self._folder / "scene.npz"
            try:
                state = path.stat()
            except FileNotFoundError:
                if self._stamp is not None:
                    self._stamp = None
                    self._clear()
                return
            stamp = (state.st_mtime_ns, state.st_ino)
            if stamp != self._stamp:
                self._clear()
                self._load_scene(path)
                self._stamp = stamp
            self._load_poses()
            self._load_seen()

    def _load_scene(self, path: Path) -> None:
        from dousa.estimation.body import BodyModel
        from dousa.estimation.camera_files import read_cameras

        with np.load(path, allow_pickle=False) as file:
            fields = {field.name: file[f"body_{field.name}"] for field in dataclasses.fields(BodyModel)}
            self.names = tuple(str(name) for name in file["names"])
            self.frame_rate, self.total = float(file["rate"]), int(file["n_frames"])
            self.run = str(file["run"])
        texts = {name: tuple(map(str, fields[name])) for name in ("names", "joints", "tips")}
        self._body = BodyModel(**{**fields, **texts, "stature": float(fields["stature"])})
        self._is_person = canonical_indices(self._body) is not None
        self._cameras = read_cameras(path)
        self.sizes = tuple((camera.width, camera.height) for camera in self._cameras)
        self._record = pose_record(7 + self._body.n_angles, len(self.names), self._body.n_parts)
        self._rows = np.zeros(self.total, self._record)
        self._version = np.zeros(self.total, np.int64)

    def _load_poses(self) -> None:
        rows = self._new_records("poses.bin", self._record)
        frames = rows["frame"]
        good = (frames >= 0) & (frames < self.total)
        for row, frame in zip(rows[good], frames[good].tolist(), strict=True):
            self._rows[frame] = row
            self._order.append(frame)
            self._version[frame] = len(self._order)

    def _load_seen(self) -> None:
        for frame, view, kind, offset, size in self._new_records("seen.idx", SEEN).tolist():
            self._seen[frame, view, kind] = (offset, size)

    def _new_records(self, name: str, record: np.dtype[Any]) -> NDArray[Any]:
        try:
            with open(self._folder / name, "rb") as file:
                file.seek(self._read[name])
                content = file.read()
        except FileNotFoundError:
            content = b""
        whole = len(content) // record.itemsize * record.itemsize
        self._read[name] += whole
        return np.frombuffer(content[:whole], record)

    # --- telling

    @property
    def n_finished(self) -> int:
        """Frames from the first on that have a pose."""
        missing = np.flatnonzero(self._version == 0) if self.total else np.zeros(0, int)
        return int(missing[0]) if len(missing) else self.total

    def frames_since(self, count: int, *, joints: bool = False) -> dict[str, Any]:
        """What is new after so many records: the page asks with ``next`` the next time.

        Returns
        -------
        ``run``, ``total``, ``finished``, ``next``, ``frame_rate``, ``is_person`` (else there is no figure), ``views``
        with names and sizes; of the frames that are new or changed ``frames`` (n,), ``stage`` (n,), ``lost`` (n,),
        ``overlap`` (n, V), and if asked for ``joints``: base64 of (n, 20, 3) float32 in m.
        """
        with self._lock:
            count = min(count, len(self._order))
            until = min(len(self._order), count + _MOST_RECORDS)
            frames = sorted(set(self._order[count:until]))
            rows = self._rows[frames] if frames else np.zeros(0, pose_record(0, len(self.names), 0))
            answer = {
                "run": self.run,
                "total": self.total,
                "finished": self.n_finished,
                "next": until,
                "frame_rate": self.frame_rate,
                "is_person": self._is_person,
                "views": [
                    {"name": name, "width": width, "height": height}
                    for name, (width, height) in zip(self.names, self.sizes, strict=True)
                ],
                "frames": frames,
                "stage": rows["stage"].tolist(),
                "lost": rows["lost"].tolist(),
                "overlap": np.round(rows["overlap"].astype(float), 3).tolist(),
            }
            return answer | {"joints": _base64(rows["joints"])} if joints else answer

    def player(self, language: str) -> dict[str, Any]:
        """The figure as far as it is, for the player.

        Raises
        ------
        RefusedError : there is no figure yet, or the body is no person.
        """
        from dousa.app.player import encode_motion
        from dousa.motion import CANONICAL_JOINTS, Trajectories

        with self._lock:
            n_frames = self.n_finished
            if n_frames < 2:
                raise RefusedError(409, "there is no figure yet; wait for the second frame")
            positions = self._rows["joints"][:n_frames].astype(np.float64)
            if not self._is_person:
                raise RefusedError(409, "this body is no person: there is no figure of it to play")
            motion = Trajectories(CANONICAL_JOINTS, positions, self.frame_rate)
            data = encode_motion(motion, language=language, like=self._facing)
            if n_frames >= self.frame_rate / 2:  # where somebody faces takes a moment to tell
                self._facing = {"facing": data["facing"], "floor": data["floor"]}
            return {**data, "n_tracked": n_frames, "next": len(self._order)}

    def overlay(self, view: int, frame: int) -> bytes:
        """Silhouette, picture and model of one view in one frame, as JPEG.

        Raises
        ------
        RefusedError : there is no such view, or no pose of this frame yet.
        """
        with self._lock:
            if not 0 <= view < len(self.names):
                raise RefusedError(404, f"no view {view}; there are {len(self.names)}, counted from 0")
            if not 0 <= frame < self.total or self._version[frame] == 0:
                raise RefusedError(
                    404, f"no pose of frame {frame} yet; frames 0 to {self.n_finished - 1} have one"
                )
            key = (view, frame, int(self._version[frame]))
            if key in self._overlays:
                self._overlays.move_to_end(key)
                return self._overlays[key]
            image = self._overlays[key] = self._paint(view, frame)
            while len(self._overlays) > _MOST_OVERLAYS:
                self._overlays.popitem(last=False)
            return image

    def _paint(self, view: int, frame: int) -> bytes:
        import cv2

        row = self._rows[frame]
        mask, picture = self._look(frame, view, MASK), self._look(frame, view, PICTURE)
        drawn = self._painter(view).paint(
            row["pose"].astype(np.float64),
            None if mask is None else mask[..., 0] > 127,
            picture,
            row["hidden"],
        )
        _, content = cv2.imencode(".jpg", drawn, [cv2.IMWRITE_JPEG_QUALITY, _JPEG])
        return content.tobytes()

    def _painter(self, view: int) -> ViewPainter:
        from dousa.app._overlay_view import ViewPainter

        if view not in self._painters:
            width, height = self.sizes[view]
            factor = _LONGEST / max(width, height)
            size = max(8, round(width * factor)), max(8, round(height * factor))
            self._painters[view] = ViewPainter(self._body, self._cameras[view], *size)
        return self._painters[view]

    def _look(self, frame: int, view: int, kind: int) -> NDArray[np.uint8] | None:
        import cv2

        if (frame, view, kind) not in self._seen:
            return None
        offset, size = self._seen[frame, view, kind]
        with open(self._folder / "seen.bin", "rb") as file:
            file.seek(offset)
            content = file.read(size)
        image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR) if content else None
        return None if image is None else np.asarray(image, np.uint8)


def _base64(values: NDArray[Any]) -> str:
    import base64

    return base64.b64encode(np.ascontiguousarray(values, "<f4").tobytes()).decode("ascii")
