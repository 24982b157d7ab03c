"""Record an estimation while it runs: small pictures and every pose, in files that only grow.

The work writes, the studio reads, and neither waits for the other. A frame may be written several times, as its pose
settles and is smoothed; the last record counts. Records have a fixed size, so that an incomplete one at the end is
recognised.

    scene.npz   body, cameras, rate, number of frames, and the name of this run
    poses.bin   records of `pose_record`
    seen.idx    records of `SEEN`: the place of the mask (PNG) or picture (JPEG) of a view in seen.bin
    seen.bin    PNG and JPEG files, one after another
"""

from __future__ import annotations

import dataclasses
import os
import secrets
import threading
from collections import OrderedDict
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dousa.app.pipelines.estimation_views import Scene
from dousa.app.player.figures import encode_array
from dousa.app.studio.content.film_record import (
    FILM_SIDE,
    MASK_SIDE,
    FilmRecord,
    encode_jpeg,
    encode_mask,
    read_records,
    shrink,
)
from dousa.app.studio.core.answers import RefusedError
from dousa.app.studio.jobs.board import JobBoard, OpenedJobs
from dousa.arrays import Image, Mask
from dousa.files.disk import atomic_write

if TYPE_CHECKING:
    from dousa.app.pictures.overlay_view import ViewPainter
    from dousa.estimation import BodyModel
    from dousa.estimation.tracking.settings import Estimate, TrackedFrame

STAGES = ("found", "settled", "smoothed")
"""How final a pose is; its number is written."""

MASK, PICTURE = 0, 1
SEEN = np.dtype([("frame", "<i4"), ("view", "<i2"), ("kind", "<i2"), ("offset", "<i8"), ("size", "<i4")])


def pose_record(n_numbers: int, n_views: int, n_parts: int) -> np.dtype[Any]:
    """The record of a pose: frame, stage, whether lost, pose, canonical joints in m, overlap per view, hidden parts."""
    return np.dtype(
        [
            ("frame", "<i4"),
            ("stage", "u1"),
            ("lost", "?"),
            ("pose", "<f4", (n_numbers,)),
            ("joints", "<f4", (20, 3)),
            ("overlap", "<f4", (n_views,)),
            ("hidden", "?", (n_parts,)),
        ]
    )


def canonical_indices(body: BodyModel) -> list[int] | None:
    """Return the indices of the 20 canonical joints among the body's points; None for a body that is not a person."""
    from dousa.estimation.body.kinematics import point_names
    from dousa.motion import CANONICAL_JOINTS

    names = point_names(body)
    if not set(CANONICAL_JOINTS) <= set(names):
        return None
    return [names.index(name) for name in CANONICAL_JOINTS]


class SeenWriter:
    """Appends masks and pictures of views to the files of a folder, and their places to the index."""

    def __init__(self, folder: Path) -> None:
        self._index = open_to_append(folder / "seen.idx", SEEN.itemsize)
        self._content = open_to_append(folder / "seen.bin", 1)
        self.n_bytes = os.fstat(self._content.fileno()).st_size

    def write(self, frame: int, view: int, kind: int, content: bytes) -> None:
        """Append a mask or a picture; the index comes last, as it names what is there."""
        self._content.write(content)
        self._index.write(np.array([(frame, view, kind, self.n_bytes, len(content))], SEEN).tobytes())
        self.n_bytes += len(content)

    def close(self) -> None:
        """Close the files."""
        self._index.close()
        self._content.close()


def open_to_append(path: Path, record: int) -> Any:
    """Open a file to append, without the incomplete record of an interrupted run."""
    file = open(path, "ab", buffering=0)  # noqa: SIM115 - open as long as the work lasts
    file.truncate(file.tell() // record * record)
    return file


class SeenReader:
    """Reads the masks and pictures of views in a folder, as far as they are written."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._n_read = folder, 0
        self._places: dict[tuple[int, int, int], tuple[int, int]] = {}

    def refresh(self) -> None:
        """Read what was written since the last call."""
        records = read_records(self._folder / "seen.idx", SEEN, self._n_read)
        self._n_read += records.nbytes
        for frame, view, kind, offset, size in records.tolist():
            self._places[frame, view, kind] = (offset, size)

    def read(self, frame: int, view: int, kind: int) -> bytes | None:
        """Return a mask (PNG) or a picture (JPEG); None if there is none."""
        if (frame, view, kind) not in self._places:
            return None
        offset, size = self._places[frame, view, kind]
        with open(self._folder / "seen.bin", "rb") as file:
            file.seek(offset)
            return file.read(size)


class FootageWriter:
    """Writes what a `dousa.app.pipelines.estimation_views.Watcher` is given into the folder of the job."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._scene: Scene | None = None
        self._body: BodyModel | None = None
        self._poses: Any = None
        self._seen: SeenWriter | None = None

    def begin(self, scene: Scene) -> None:
        """Continue the files of an earlier run, or begin new ones."""
        self._scene = scene
        if scene.resumed == 0:
            for name in ("scene.npz", "poses.bin", "seen.idx", "seen.bin"):
                with suppress(FileNotFoundError):
                    (self._folder / name).unlink()
        self._seen = SeenWriter(self._folder)

    def see(
        self,
        frame: int,
        masks: Sequence[Mask | None],
        pictures: Sequence[Image | None],
        *,
        most_bytes: int = 1_000_000_000,
    ) -> None:
        """Write small masks and pictures."""
        # most_bytes: of all pictures of one estimation
        assert self._seen is not None
        longest = MASK_SIDE
        if self._seen.n_bytes > most_bytes:
            return
        for view, (mask, picture) in enumerate(zip(masks, pictures, strict=True)):
            if mask is not None:
                self._seen.write(
                    frame, view, MASK, encode_mask(shrink(mask.view(np.uint8) * np.uint8(255), longest) > 127)
                )
            if picture is not None:
                self._seen.write(frame, view, PICTURE, encode_jpeg(shrink(picture, longest), 80))

    def follow(self, tracked: TrackedFrame) -> None:
        """Write a pose."""
        if tracked.body is not self._body:
            self._begin_poses(tracked.body)
        row = np.zeros(1, self._record)
        row["frame"], row["stage"] = tracked.frame, int(tracked.settled)
        self._fill(row, tracked.pose[None], tracked.overlap[None], tracked.occluded[None], [tracked.lost])

    def end(self, estimate: Estimate) -> None:
        """Write all smoothed poses."""
        if estimate.body is not self._body:
            self._begin_poses(estimate.body)
        rows = np.zeros(estimate.n_frames, self._record)
        rows["frame"], rows["stage"] = np.arange(estimate.n_frames), STAGES.index("smoothed")
        self._fill(rows, estimate.poses, estimate.iou, estimate.occluded, estimate.lost)
        self.close()

    def close(self) -> None:
        """Close the files."""
        for file in (self._seen, self._poses):
            if file is not None:
                file.close()

    def _fill(self, rows: Any, poses: Any, overlap: Any, hidden: Any, lost: Any) -> None:
        from dousa.estimation.body.kinematics import compute_points

        assert self._body is not None
        rows["pose"], rows["overlap"], rows["hidden"], rows["lost"] = poses, overlap, hidden, lost
        if self._joints is None:
            rows["joints"] = np.nan
        else:
            rows["joints"] = compute_points(self._body, poses)[:, self._joints]
        self._poses.write(rows.tobytes())

    def _begin_poses(self, body: BodyModel) -> None:
        """Begin the poses once the girths of the body are fitted."""
        from dousa.estimation.cameras.camera_formats import cameras_to_arrays

        assert self._scene is not None
        self._body, self._joints = body, canonical_indices(body)
        self._record = pose_record(7 + body.n_angles, len(self._scene.names), body.n_parts)
        self._poses = open_to_append(self._folder / "poses.bin", self._record.itemsize)
        fields = {f"body_{field.name}": getattr(body, field.name) for field in dataclasses.fields(body)}
        arrays = {
            **cameras_to_arrays(self._scene.cameras),
            **{name: np.asarray(value) for name, value in fields.items()},
            "names": np.array(self._scene.names),
            "rate": np.float64(self._scene.frame_rate),
            "n_frames": np.int64(self._scene.n_frames),
            "run": np.array(secrets.token_hex(4)),
        }
        with atomic_write(self._folder / "scene.npz") as file:
            np.savez(file, **arrays)  # type: ignore[arg-type]


class Footages:
    """The footage of the estimations that were looked at last."""

    def __init__(self, board: JobBoard) -> None:
        self._board = board
        self._opened = OpenedJobs(board, _open_footage, 4)  # estimations

    def get(self, job_id: str) -> Footage:
        """Return the footage of an estimation, which may still be empty; RefusedError for other jobs."""
        job = self._board.get(job_id)
        if job.kind != "estimate":
            raise RefusedError(404, "studio_estimation.not_one", job=job_id)
        found = self._opened.get(job)
        found.refresh()
        return found


def _open_footage(folder: Path) -> Footage:
    return Footage(folder, FilmRecord(folder, folder.parent.parent / "files"))


class Footage:
    """Reads one estimation as far as it is.

    Parameters
    ----------
    folder : of its job.
    film : what was found of its films, for an estimation from films.
    """

    def __init__(self, folder: Path, film: FilmRecord | None = None) -> None:
        self._folder = folder
        self.film = film or FilmRecord(folder, folder)
        self._lock = threading.RLock()
        self._stamp: tuple[int, int] | None = None
        self._clear()

    def _clear(self) -> None:
        self.total, self.frame_rate, self.run = 0, 30.0, ""
        self.names: tuple[str, ...] = ()
        self.sizes: tuple[tuple[int, int], ...] = ()
        self._order: list[int] = []
        self._seen = SeenReader(self._folder)
        self._n_read = 0  # bytes of the poses
        self._painters: dict[int, ViewPainter] = {}
        self._overlays: OrderedDict[tuple[int, int, int], bytes] = OrderedDict()
        self._facing: dict[str, float] | None = None
        self._rows: Any = None
        self._is_person = False

    # --- taking in what is new

    def refresh(self) -> None:
        """Read what was written since the last call."""
        with self._lock:
            self.film.refresh()
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
            self._seen.refresh()

    def _load_scene(self, path: Path) -> None:
        from dousa.estimation.body.body import BodyModel
        from dousa.estimation.cameras.camera_files import read_cameras

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
        rows = read_records(self._folder / "poses.bin", self._record, self._n_read)
        self._n_read += rows.nbytes
        frames = rows["frame"]
        good = (frames >= 0) & (frames < self.total)
        for row, frame in zip(rows[good], frames[good].tolist(), strict=True):
            self._rows[frame] = row
            self._order.append(frame)
            self._version[frame] = len(self._order)

    @property
    def n_finished(self) -> int:
        """Number of frames from the first on that have a pose."""
        missing = np.flatnonzero(self._version == 0) if self.total else np.zeros(0, int)
        return int(missing[0]) if len(missing) else self.total

    def frames_since(self, count: int, *, joints: bool = False) -> dict[str, Any]:
        """Return what is new after so many records; ``next`` is the number for the next call.

        Returns
        -------
        ``run``, ``total``, ``finished``, ``next``, ``frame_rate``, ``is_person`` (else there is no figure), ``film``
            (version of its films; 0 without films), ``views`` with names and sizes; of new and changed frames
            ``frames`` (n,), ``stage`` (n,), ``lost`` (n,), ``overlap`` (n, V), and on request ``joints``: base64 of (n,
            20, 3) float32 in m.
        """
        with self._lock:
            count = min(count, len(self._order))
            until = min(len(self._order), count + 20_000)  # in one answer
            frames = sorted(set(self._order[count:until]))
            rows = self._rows[frames] if frames else np.zeros(0, pose_record(0, len(self.names), 0))
            answer = {
                "run": self.run,
                "total": self.total,
                "finished": self.n_finished,
                "next": until,
                "frame_rate": self.frame_rate,
                "is_person": self._is_person,
                "film": self.film.version,
                "views": [
                    {"name": name, "width": width, "height": height}
                    for name, (width, height) in zip(self.names, self.sizes, strict=True)
                ],
                "frames": frames,
                "stage": rows["stage"].tolist(),
                "lost": rows["lost"].tolist(),
                "overlap": np.round(rows["overlap"].astype(float), 3).tolist(),
            }
            return answer | {"joints": encode_array(rows["joints"], "<f4")} if joints else answer

    def player(self, language: str) -> dict[str, Any]:
        """Return the figure as far as it is, for the player; RefusedError if there is none."""
        from dousa.app.player.data import encode_motion
        from dousa.motion import CANONICAL_JOINTS, Trajectories

        with self._lock:
            n_frames = self.n_finished
            if n_frames < 2:
                raise RefusedError(409, "studio_estimation.no_figure_yet")
            positions = self._rows["joints"][:n_frames].astype(np.float64)
            if not self._is_person:
                raise RefusedError(409, "studio_estimation.no_person")
            motion = Trajectories(CANONICAL_JOINTS, positions, self.frame_rate)
            data = encode_motion(motion, language=language, like=self._facing)
            if n_frames >= self.frame_rate / 2:  # the facing is known only after a moment
                self._facing = {"facing": data["facing"], "floor": data["floor"]}
            return {**data, "n_tracked": n_frames, "next": len(self._order)}

    def overlay(self, view: int, frame: int) -> bytes:
        """Draw silhouette, picture and model of a view in a frame as JPEG; RefusedError without a pose of it."""
        with self._lock:
            if not 0 <= view < len(self.names):
                raise RefusedError(404, "studio_estimation.no_view", view=view, count=len(self.names))
            if not 0 <= frame < self.total or self._version[frame] == 0:
                raise RefusedError(404, "studio_estimation.no_pose", frame=frame, count=self.n_finished)
            key = (view, frame, int(self._version[frame]))
            if key in self._overlays:
                self._overlays.move_to_end(key)
                return self._overlays[key]
            image = self._overlays[key] = self._paint(view, frame)
            while len(self._overlays) > 240:  # kept, some 25 KB each
                self._overlays.popitem(last=False)
            return image

    def _paint(self, view: int, frame: int, *, quality: int = 88) -> bytes:
        row = self._rows[frame]
        mask, picture = (decode_image(self._seen.read(frame, view, kind)) for kind in (MASK, PICTURE))
        if self.film.version and picture is None:
            picture = decode_image(self.film.find_picture(view, frame))
            # grey behind keypoints without a film
            picture = np.full((4, 4, 3), 246, np.uint8) if picture is None else picture
        drawn = self._painter(view).paint(
            row["pose"].astype(np.float64),
            None if mask is None else mask[..., 0] > 127,
            picture,
            row["hidden"],
        )
        return encode_jpeg(drawn, quality)

    def _painter(self, view: int) -> ViewPainter:
        from dousa.app.pictures.overlay_view import ViewPainter

        if view not in self._painters:
            width, height = self.sizes[view]
            factor = (FILM_SIDE if self.film.version else MASK_SIDE) / max(width, height)
            size = max(8, round(width * factor)), max(8, round(height * factor))
            self._painters[view] = ViewPainter(self._body, self._cameras[view], *size)
        return self._painters[view]


def decode_image(content: bytes | None) -> NDArray[np.uint8] | None:
    """Decode a PNG or JPEG to (H, W, 3) blue, green, red; None if there is none, or it is damaged."""
    from dousa.extras import cv2

    image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR) if content else None
    return None if image is None else np.asarray(image, np.uint8)
