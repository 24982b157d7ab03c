"""Motions by name: a clip of the library, an uploaded file, what a job estimated; whole or a part.

``clip:12``, ``file:BATCH/NAME`` and ``job:ID`` stand for a motion everywhere: in the interface, in the addresses of
pages, and between them.
"""

from __future__ import annotations

import dataclasses
import threading
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from dousa.app.studio.gates import Gate
from dousa.app.studio.problems import RefusedError

if TYPE_CHECKING:
    from dousa.app.studio.jobs.board import JobBoard
    from dousa.app.studio.workspace import Workspace
    from dousa.library import Library
    from dousa.motion import CanonicalMotion

__all__ = ["MotionName", "MotionPart", "MotionRef", "Motions", "Named", "Seconds"]

MotionName = Annotated[
    str,
    Field(
        pattern=r"^(clip:[0-9]{1,15}|file:[0-9a-f]{16}/.{1,1000}|job:[0-9a-f]{16})$",
        description="clip:NUMBER of the library, file:BATCH/NAME of an upload, or job:ID of an estimation",
        examples=["clip:12"],
    ),
]
Seconds = Annotated[float, Field(ge=0, le=1e6, allow_inf_nan=False)]
_KEPT, _KEPT_BYTES = 24, 60_000_000  # motions that were read from files last
_WAIT = 60.0  # s for others that read
_LONGEST_S, _MOST_FRAMES = 3 * 3600.0, 1_500_000  # of a motion that is looked at as one


class MotionPart(BaseModel):
    """A motion, or a part of one, as it stands in an address."""

    model_config = ConfigDict(extra="forbid")

    motion: MotionName
    start_s: Seconds | None = Field(default=None, description="s; the beginning if left out")
    end_s: Seconds | None = Field(default=None, description="s; the end if left out")
    unit: str | None = Field(
        default=None, max_length=20, description="length unit of an uploaded file, such as cm"
    )
    up: str | None = Field(default=None, max_length=2, description="up axis of an uploaded file: x, y or z")

    def ref(self) -> MotionRef:
        """The same in the form that everything else uses."""
        return MotionRef(
            motion=self.motion, start_s=self.start_s, end_s=self.end_s, unit=self.unit, up=self.up
        )


class MotionRef(MotionPart):
    """A motion, or a part of one."""

    joint_map: dict[str, str | list[str]] | None = Field(
        default=None, description="canonical joint -> joint of the file"
    )

    @property
    def is_whole(self) -> bool:
        """Whether it is all of the motion."""
        return self.start_s is None and self.end_s is None


@dataclass(frozen=True, slots=True, eq=False)
class Named:
    """A motion and what it is called.

    Parameters
    ----------
    name : of its file, for people.
    motion : its canonical joints, with the doubts that came up when it was read.
    category : its label, of clips.
    """

    name: str
    motion: CanonicalMotion
    category: str | None = None

    @property
    def n_bytes(self) -> int:
        """Size in memory."""
        return int(self.motion.positions.nbytes)


class Motions:
    """Finds motions, and keeps those of files that were read last.

    Parameters
    ----------
    library : gives the library that is open.
    workspace, board : where uploads and estimates are.
    """

    def __init__(self, library: Callable[[], Library], workspace: Workspace, board: JobBoard) -> None:
        self._library, self._workspace, self._board = library, workspace, board
        self._lock = threading.Lock()
        self._reading = Gate(2, 12, "many files are being read; try again in a moment")
        self._kept: OrderedDict[tuple[Any, ...], Named] = OrderedDict()

    def get(self, ref: MotionRef) -> Named:
        """The motion, or the part, that is meant.

        Raises
        ------
        RefusedError : there is no such motion, or the part is empty.
        DousaError : its file cannot be used.
        """
        return _cut(self._whole(ref), ref)

    def query(self, ref: MotionRef) -> int | CanonicalMotion:
        """What `Library.search` is asked: the number of a whole clip, else a motion."""
        clip = self.clip_id(ref)
        if clip is not None and ref.is_whole:
            return clip
        return self.get(ref).motion

    def clip_id(self, ref: MotionRef) -> int | None:
        """Number of the clip that is meant, None if it is not one of the library."""
        kind, _, rest = ref.motion.partition(":")
        return int(rest) if kind == "clip" else None

    def path(self, ref: MotionRef) -> Path:
        """The file of a motion; of a clip, where it came from, whether it is there or not.

        Raises
        ------
        RefusedError : there is no such motion.
        """
        kind, _, rest = ref.motion.partition(":")
        if kind == "clip":
            return Path(self._library().clips([int(rest)])[0].path)
        if kind == "file":
            return self._workspace.find(*_split(rest))
        job = self._board.get(rest)
        name = (job.result or {}).get("motion")
        if not name:
            raise RefusedError(409, f"the job is {job.state}: there is no motion yet")
        return self._board.folder(job) / PurePath(str(name)).name

    def _whole(self, ref: MotionRef) -> Named:
        clip = self.clip_id(ref)
        if clip is not None:
            return _stored(self._library(), clip)
        found = self._from_file(self.path(ref), ref)
        kind, _, rest = ref.motion.partition(":")
        if kind == "job":  # all estimates lie in a motion.bvh: they are called as what they were made of
            return replace(found, name=f"{PurePath(self._board.get(rest).title).stem}.bvh")
        return found

    def _from_file(self, path: Path, ref: MotionRef) -> Named:
        joints = tuple((name, str(value)) for name, value in (ref.joint_map or {}).items())
        try:
            changed = path.stat().st_mtime_ns
        except OSError:
            raise RefusedError(404, f"{path.name} is not there any more; make or upload it again") from None
        key = (str(path), changed, ref.unit, ref.up, joints)
        kept = self._look(key)
        if kept is not None:
            return kept
        with self._reading.enter(_WAIT):
            kept = self._look(key)  # somebody else asked for the same file
            if kept is None:
                kept = _read(path, ref.unit, ref.up, ref.joint_map, self._short(path))
                self._keep(key, kept)
        return kept

    def _look(self, key: tuple[Any, ...]) -> Named | None:
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
            return self._kept.get(key)

    def _keep(self, key: tuple[Any, ...], read: Named) -> None:
        with self._lock:
            self._kept[key] = read
            while len(self._kept) > 1 and (len(self._kept) > _KEPT or self._n_bytes() > _KEPT_BYTES):
                self._kept.popitem(last=False)

    def _n_bytes(self) -> int:
        return sum(item.n_bytes for item in self._kept.values())

    def _short(self, path: Path) -> str:
        """What takes the place of the studio's folder in messages."""
        return f"{path.parent}/"


def _split(rest: str) -> tuple[str, str]:
    batch, _, name = rest.partition("/")
    return batch, name


def _read(
    path: Path,
    unit: str | None,
    up: str | None,
    joint_map: Mapping[str, str | Sequence[str]] | None,
    folder: str,
) -> Named:
    from dousa.errors import DousaError
    from dousa.library import ReadOptions
    from dousa.library.ingest import read_canonical

    try:
        motion, _ = read_canonical(str(path), ReadOptions(joint_map, unit, up, None))
    except DousaError as error:
        raise RefusedError(422, str(error).replace(folder, "")) from error
    _check_size(path.name, motion.n_frames, motion.frame_rate)
    return Named(path.name, motion)


def _check_size(name: str, n_frames: int, frame_rate: float) -> None:
    """A file of a few frames that says it lasts a year would fill the memory when it is shown."""
    from dousa.retrieval.posed_motion import check_frame_rate

    check_frame_rate(frame_rate)
    if n_frames > _MOST_FRAMES or n_frames / frame_rate > _LONGEST_S:
        raise RefusedError(
            422,
            f"{name}: expected at most {_LONGEST_S / 3600:g} hours and {_MOST_FRAMES:,} frames, got "
            f"{n_frames / frame_rate / 3600:.1f} hours and {n_frames:,} frames; cut it into parts",
        )


def _stored(library: Library, clip: int) -> Named:
    from dousa.motion import CanonicalMotion
    from dousa.motion.canonical import JointMapping

    info = library.clips([clip])[0]
    _check_size(PurePath(info.path).name, info.n_frames, info.frame_rate)
    positions = library.trajectories(clip).positions
    mapping = JointMapping(info.joint_table, {}, (), "agree")
    motion = CanonicalMotion(positions, info.frame_rate, info.height, "library", mapping, info.warnings)
    return Named(PurePath(info.path).name, motion, info.category)


def _cut(whole: Named, ref: MotionRef) -> Named:
    if ref.is_whole:
        return whole
    motion = whole.motion
    rate, n_frames = motion.frame_rate, motion.n_frames
    first = round((ref.start_s or 0.0) * rate)
    last = n_frames if ref.end_s is None else min(round(ref.end_s * rate) + 1, n_frames)
    if last - first < 2:
        seconds = (n_frames - 1) / rate
        raise RefusedError(
            422, f"expected a part between 0 and {seconds:.2f} s, got {ref.start_s} to {ref.end_s}"
        )
    missing = None if motion.missing is None else motion.missing[first:last]
    part = dataclasses.replace(motion, positions=motion.positions[first:last], missing=missing)
    return Named(whole.name, part, whole.category)
