"""Find motions by name: a clip of the library, an uploaded file, an estimate; whole or a part.

``clip:12``, ``file:BATCH/NAME`` and ``job:ID`` name a motion everywhere: in requests and in the addresses of pages.
"""

from __future__ import annotations

import dataclasses
import tempfile
import threading
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import Field

from dousa.app.studio.core.answers import RefusedError, StrictModel, say
from dousa.arrays import BoolArray
from dousa.errors import DousaError

if TYPE_CHECKING:
    from dousa.app.studio.core.workspace import Workspace
    from dousa.app.studio.jobs.board import JobBoard
    from dousa.app.studio.jobs.lanes import Reader
    from dousa.library import Library
    from dousa.motion import CanonicalMotion, Motion

MOTION_FORM = r"^(clip:[0-9]{1,15}|file:[0-9a-f]{16}/.{1,1000}|job:[0-9a-f]{16})$"
"""The form of the name of a motion."""

MotionName = Annotated[
    str,
    Field(
        pattern=MOTION_FORM,
        description="clip:NUMBER of the library, file:BATCH/NAME of an upload, or job:ID of an estimation",
        examples=["clip:12"],
    ),
]
Seconds = Annotated[float, Field(ge=0, le=1e6, allow_inf_nan=False)]
_KEPT, _KEPT_BYTES = 24, 60_000_000  # motions that were read from files last
_LONGEST_S, _MOST_FRAMES = 3 * 3600.0, 1_500_000  # of a motion that is looked at as one


@dataclass(frozen=True, slots=True)
class Address:
    """The place of a motion: a clip, a file of a batch, or a job.

    Parameters
    ----------
    clip : number in the library.
    batch, name : of an upload, and of the file in it.
    job : of an estimation.
    """

    clip: int | None = None
    batch: str = ""
    name: str = ""
    job: str = ""

    @classmethod
    def parse(cls, motion: str) -> Address:
        """Parse a `MotionName`."""
        kind, _, rest = motion.partition(":")
        if kind == "clip":
            return cls(clip=int(rest))
        batch, _, name = rest.partition("/")
        return cls(batch=batch, name=name) if kind == "file" else cls(job=rest)

    def __str__(self) -> str:
        if self.clip is not None:
            return f"clip:{self.clip}"
        return f"file:{self.batch}/{self.name}" if self.batch else f"job:{self.job}"


class MotionPart(StrictModel):
    """A motion, or a part of one, as it stands in an address."""

    motion: MotionName
    start_s: Seconds | None = Field(default=None, description="s; the beginning if left out")
    end_s: Seconds | None = Field(default=None, description="s; the end if left out")
    unit: str | None = Field(default=None, max_length=20, description="length unit of an uploaded file, such as cm")
    up: str | None = Field(default=None, max_length=2, description="up axis of an uploaded file: x, y or z")

    def ref(self) -> MotionRef:
        """Convert the query of an address to the form that requests have."""
        return MotionRef(motion=self.motion, start_s=self.start_s, end_s=self.end_s, unit=self.unit, up=self.up)

    @property
    def address(self) -> Address:
        """The place of the motion."""
        return Address.parse(self.motion)


class MotionRef(MotionPart):
    """A motion, or a part of one."""

    joint_map: dict[str, str | list[str]] | None = Field(
        default=None, description="canonical joint -> joint of the file"
    )

    @property
    def is_whole(self) -> bool:
        """Whether the whole motion is meant."""
        return self.start_s is None and self.end_s is None


@dataclass(frozen=True, slots=True, eq=False)
class Named:
    """A motion and its name.

    Parameters
    ----------
    name : of its file.
    motion : canonical joints, with the warnings of its reader.
    category : label of a clip.
    """

    name: str
    motion: CanonicalMotion
    category: str | None = None

    @property
    def n_bytes(self) -> int:
        """Size in memory."""
        return int(self.motion.positions.nbytes)


class Motions:
    """Finds motions, and keeps those in memory that were last read from files.

    Parameters
    ----------
    library : returns the open library.
    workspace, board : with uploads and estimates.
    reader : reads files.
    """

    def __init__(self, library: Callable[[], Library], workspace: Workspace, board: JobBoard, reader: Reader) -> None:
        self._library, self._workspace, self._board, self._reader = library, workspace, board, reader
        self._lock = threading.Lock()
        self._kept: OrderedDict[tuple[Any, ...], Named] = OrderedDict()

    def get(self, ref: MotionRef) -> Named:
        """Return a motion or a part; RefusedError if there is none, DousaError if its file cannot be used."""
        return _cut(self._whole(ref), ref)

    def query(self, ref: MotionRef) -> int | CanonicalMotion:
        """Return what `Library.search` takes: the number of a whole clip, else a motion."""
        clip = ref.address.clip
        if clip is not None and ref.is_whole:
            return clip
        return self.get(ref).motion

    def path(self, ref: MotionRef) -> Path:
        """Return the file of a motion; of a clip its source, which may be gone. RefusedError if there is no such
        motion."""
        address = ref.address
        if address.clip is not None:
            return Path(self._library().clips([address.clip])[0].path)
        if address.batch:
            return self._workspace.find(address.batch, address.name)
        job = self._board.get(address.job)
        name = (job.result or {}).get("motion")
        if not name:
            raise RefusedError(409, "studio_motions.no_motion_yet")
        return self._board.folder(job) / PurePath(str(name)).name

    def _whole(self, ref: MotionRef) -> Named:
        address = ref.address
        if address.clip is not None:
            return _stored(self._library(), address.clip)
        found = self._from_file(self.path(ref), ref)
        if address.job:  # all estimates lie in a motion.bvh: they are called as what they were made of
            return replace(found, name=f"{PurePath(str(self._board.get(address.job).title)).stem}.bvh")
        return found

    def _from_file(self, path: Path, ref: MotionRef) -> Named:
        joints = tuple((name, str(value)) for name, value in (ref.joint_map or {}).items())
        try:
            changed = path.stat().st_mtime_ns
        except OSError:
            raise RefusedError(404, "studio_motions.gone", name=path.name) from None
        key = (str(path), changed, ref.unit, ref.up, joints)
        kept = self._look(key)
        if kept is not None:
            return kept
        kept = self._reader.run(_read, path, ref)
        self._keep(key, kept)
        return kept

    def make_file(
        self, named: Named, ref: MotionRef, suffix: str, character: Path | None = None, keep_reach: bool = False
    ) -> bytes:
        """Write a motion that was found as a file, as `make_file`."""
        return self._reader.run(make_file, named, self.path(ref), ref, suffix, character, keep_reach, seconds=180.0)

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


def _read(path: Path, ref: MotionRef) -> Named:
    from dousa.formats.motion_files import ReadOptions, read_canonical

    motion, _ = read_canonical(str(path), ReadOptions(ref.joint_map, ref.unit, ref.up, None), whole=False)
    _check_size(path.name, motion.n_frames, motion.frame_rate)
    return Named(path.name, motion)


def _check_size(name: str, n_frames: int, frame_rate: float) -> None:
    """Refuse files that claim a length which would fill the memory."""
    from dousa.retrieval.features.posed_motion import check_frame_rate

    check_frame_rate(frame_rate)
    if n_frames > _MOST_FRAMES or n_frames / frame_rate > _LONGEST_S:
        raise RefusedError(
            422,
            "studio_motions.too_long",
            name=name,
            most_hours=_LONGEST_S / 3600,
            most_frames=_MOST_FRAMES,
            hours=n_frames / frame_rate / 3600,
            frames=n_frames,
        )


def _stored(library: Library, clip: int) -> Named:
    from dousa.motion import CanonicalMotion
    from dousa.motion.canonical.canonicalise import JointMapping

    info = library.clips([clip])[0]
    _check_size(PurePath(info.path).name, info.n_frames, info.frame_rate)
    positions = library.trajectories(clip).positions
    mapping = JointMapping(info.joint_table, {}, (), "agree", info.absent)
    missing: BoolArray | None = np.any(np.isnan(positions), axis=2) if info.absent else None
    motion = CanonicalMotion(positions, info.frame_rate, info.height, "library", mapping, info.warnings, missing)
    return Named(PurePath(info.path).name, motion, info.category)


def _cut(whole: Named, ref: MotionRef) -> Named:
    if ref.is_whole:
        return whole
    motion = whole.motion
    rate, n_frames = motion.frame_rate, motion.n_frames
    first = round((ref.start_s or 0.0) * rate)
    last = n_frames if ref.end_s is None else min(round(ref.end_s * rate) + 1, n_frames)
    if last - first < 2:
        raise RefusedError(
            422,
            "studio_motions.empty_part",
            seconds=(n_frames - 1) / rate,
            start=ref.start_s or 0.0,
            end=(n_frames - 1) / rate if ref.end_s is None else ref.end_s,
        )
    missing = None if motion.missing is None else motion.missing[first:last]
    part = dataclasses.replace(motion, positions=motion.positions[first:last], missing=missing)
    return Named(whole.name, part, whole.category)


EXPORTED = "export.zip"
"""What an export of clips writes into the folder of its job."""


def name_file(named: Named, ref: MotionRef, suffix: str) -> str:
    """Name the download of a motion or a part."""
    stem = named.name.rpartition(".")[0] or named.name
    part = "" if ref.is_whole else f"_{ref.start_s or 0:.2f}s"
    return f"{stem}{part}{suffix}"


def make_file(
    named: Named,
    source: Path,
    ref: MotionRef,
    suffix: str,
    character: Path | None = None,
    keep_reach: bool = False,
) -> bytes:
    """Write a motion as a file and return its bytes.

    If the source still holds this motion as rotations, all its joints are written; else a body of the canonical joints
    is fitted. Raises JointMappingError if the joints of the character are not recognised.

    Parameters
    ----------
    named : the motion or the part.
    source : the file from which it came; it may be gone or changed.
    ref : the part, and how to read the file.
    suffix : of the format.
    character : file with a skeleton to retarget onto.
    keep_reach : keep the places that hands reach, instead of arm directions.
    """
    from dousa.formats.registry import read_character, write_motion
    from dousa.motion import fit_motion
    from dousa.motion.retargeting import retarget

    with tempfile.TemporaryDirectory(prefix="dousa-") as folder:
        path = Path(folder) / f"motion{suffix}"
        original = _read_original(named, source, ref)
        motion = fit_motion(named.motion) if original is None else original
        if character is not None:
            motion = retarget(motion, read_character(character), keep_reach=keep_reach).motion
        write_motion(motion, path)
        return path.read_bytes()


def _read_original(named: Named, source: Path, ref: MotionRef) -> Motion | None:
    """Read the part from the source; None if it does not hold this motion."""
    from dousa.formats.registry import read_motion
    from dousa.motion import Motion

    try:
        motion = read_motion(source, unit=ref.unit, up=ref.up)
        if not isinstance(motion, Motion):
            return None
        first = 0 if ref.start_s is None else round(ref.start_s * motion.frame_rate)
        last = first + named.motion.n_frames
        if not ref.is_whole:
            motion = motion.replace(
                rotations=motion.rotations[first:last], translations=motion.translations[first:last]
            )
        return motion if _is_same(motion, named, ref) else None
    except (DousaError, OSError):
        return None  # what the library keeps serves as well


def describe_character(path: Path) -> dict[str, Any]:
    """Describe the body of a character; errors as `read_character`, and if it is no person."""
    from dousa.formats.registry import read_character
    from dousa.motion import canonicalise

    character = read_character(path)
    body = canonicalise(character, any_skeleton=True, whole=True)
    joints = len(character.skeleton.names)
    return {"n_joints": joints, "height_m": body.height, "notes": [say(note) for note in body.warnings]}


def _is_same(motion: Motion, named: Named, ref: MotionRef) -> bool:
    """Whether a file still has the length, rate, joints and unit that the library stored."""
    from dousa.motion import canonicalise

    if motion.n_frames != named.motion.n_frames or motion.frame_rate != named.motion.frame_rate:
        return False
    positions = canonicalise(motion, ref.joint_map, whole=True).positions
    return bool(np.abs(positions - named.motion.positions).max() <= 1e-3)  # m: joints of the library are rounded
