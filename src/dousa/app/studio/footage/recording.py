"""What a running estimation leaves for those who watch it: small pictures and every pose, in files that only grow.

The work writes, the studio reads, neither waits for the other. A frame may be written several times, as its pose
settles and is smoothed; the last word counts. Records have one size, so that half of one at the end is known.

    scene.npz   body, cameras, rate, number of frames, and the name of this run
    poses.bin   records of `pose_record`
    seen.idx    records of `SEEN`: where in seen.bin the mask (PNG) or picture (JPEG) of a view lies
    seen.bin    those, one after the other
"""

from __future__ import annotations

import dataclasses
import os
import secrets
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dousa.app._estimation_watch import Scene

if TYPE_CHECKING:
    from dousa.estimation import BodyModel
    from dousa.estimation._types import Estimate, TrackedFrame
    from dousa.estimation.silhouettes import Image, Mask

__all__ = ["MASK", "PICTURE", "SEEN", "STAGES", "FootageWriter", "canonical_indices", "pose_record"]

STAGES = ("found", "settled", "smoothed")
"""How final a pose is; its number is written."""

MASK, PICTURE = 0, 1
SEEN = np.dtype([("frame", "<i4"), ("view", "<i2"), ("kind", "<i2"), ("offset", "<i8"), ("size", "<i4")])

_LONGEST = 480  # px, of what is kept
_MOST_BYTES = 1_000_000_000  # of all pictures of one estimation
_JPEG = 80


def pose_record(n_numbers: int, n_views: int, n_parts: int) -> np.dtype[Any]:
    """A pose: frame, stage, whether lost, the pose row, canonical joints in m, overlap per view, hidden parts."""
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
    """Where the 20 canonical joints are among the body's points; None for a body that is no person."""
    from dousa.estimation.kinematics import point_names
    from dousa.motion import CANONICAL_JOINTS

    names = point_names(body)
    if not set(CANONICAL_JOINTS) <= set(names):
        return None
    return [names.index(name) for name in CANONICAL_JOINTS]


class FootageWriter:
    """A `dousa.app._estimation_watch.Watcher` that writes down what it is shown.

    Parameters
    ----------
    folder : of the job.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._scene: Scene | None = None
        self._body: BodyModel | None = None
        self._files: list[Any] = []
        self._offset = 0

    def begin(self, scene: Scene) -> None:
        """Take up the files of an earlier run, or begin new ones."""
        self._scene = scene
        if scene.resumed == 0:
            for name in ("scene.npz", "poses.bin", "seen.idx", "seen.bin"):
                with suppress(FileNotFoundError):
                    (self._folder / name).unlink()
        self._index = self._append("seen.idx", SEEN.itemsize)
        self._seen = self._append("seen.bin", 1)
        self._offset = os.fstat(self._seen.fileno()).st_size

    def _append(self, name: str, record: int) -> Any:
        """A file to write on to, less the part of a record at its end that an interrupted run left."""
        file = open(self._folder / name, "ab", buffering=0)  # noqa: SIM115 - open as long as the work lasts
        file.truncate(file.tell() // record * record)
        self._files.append(file)
        return file

    def see(self, frame: int, masks: Sequence[Mask | None], pictures: Sequence[Image | None]) -> None:
        """Keep small masks, and small pictures where there are any."""
        if self._offset > _MOST_BYTES:
            return
        records = []
        for view, (mask, picture) in enumerate(zip(masks, pictures, strict=True)):
            if mask is not None:
                records.append(self._put(frame, view, MASK, _pack_mask(mask)))
            if picture is not None:
                records.append(self._put(frame, view, PICTURE, _pack_picture(picture)))
        self._index.write(np.array(records, SEEN).tobytes())

    def _put(self, frame: int, view: int, kind: int, content: bytes) -> tuple[int, ...]:
        self._seen.write(content)
        self._offset += len(content)
        return frame, view, kind, self._offset - len(content), len(content)

    def follow(self, tracked: TrackedFrame) -> None:
        """Keep a pose."""
        if tracked.body is not self._body:
            self._begin_poses(tracked.body)
        row = np.zeros(1, self._record)
        row["frame"], row["stage"] = tracked.frame, int(tracked.settled)
        self._fill(row, tracked.pose[None], tracked.overlap[None], tracked.occluded[None], [tracked.lost])

    def end(self, estimate: Estimate) -> None:
        """Keep all poses once more, smoothed."""
        if estimate.body is not self._body:
            self._begin_poses(estimate.body)
        rows = np.zeros(estimate.n_frames, self._record)
        rows["frame"], rows["stage"] = np.arange(estimate.n_frames), STAGES.index("smoothed")
        self._fill(rows, estimate.poses, estimate.iou, estimate.occluded, estimate.lost)
        self.close()

    def close(self) -> None:
        """Let go of the files."""
        for file in self._files:
            file.close()
        self._files.clear()

    def _fill(self, rows: Any, poses: Any, overlap: Any, hidden: Any, lost: Any) -> None:
        from dousa.estimation.kinematics import compute_points

        assert self._body is not None
        rows["pose"], rows["overlap"], rows["hidden"], rows["lost"] = poses, overlap, hidden, lost
        if self._joints is None:
            rows["joints"] = np.nan
        else:
            rows["joints"] = compute_points(self._body, poses)[:, self._joints]
        self._poses.write(rows.tobytes())

    def _begin_poses(self, body: BodyModel) -> None:
        """The body is known only when its girths are fitted."""
        from dousa._files import atomic_write
        from dousa.estimation.camera_files import cameras_to_arrays

        assert self._scene is not None
        self._body, self._joints = body, canonical_indices(body)
        self._record = pose_record(7 + body.n_angles, len(self._scene.names), body.n_parts)
        self._poses = self._append("poses.bin", self._record.itemsize)
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


def _pack_mask(mask: Mask) -> bytes:
    import cv2

    image = mask.view(np.uint8) * np.uint8(255)
    small = _shrink(image)
    _, content = cv2.imencode(".png", (small > 127) * np.uint8(255), [cv2.IMWRITE_PNG_BILEVEL, 1])
    return content.tobytes()


def _pack_picture(picture: NDArray[np.uint8]) -> bytes:
    import cv2

    _, content = cv2.imencode(".jpg", _shrink(picture), [cv2.IMWRITE_JPEG_QUALITY, _JPEG])
    return content.tobytes()


def _shrink(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    import cv2

    height, width = image.shape[:2]
    factor = _LONGEST / max(height, width)
    if factor >= 1.0:
        return image
    size = (max(1, round(width * factor)), max(1, round(height * factor)))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
