"""From motion files to records: finding the files, and reading one with everything that is derived from it.

``read_clip`` is a pure function of a task, so that joblib can run it in threads here or anywhere else
(``joblib.parallel_config("dask")`` around ``Library.add``).
"""

from __future__ import annotations

import hashlib
import json
import os
import warnings
from collections.abc import Generator, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dousa.errors import DousaError, JointMappingError, MotionFileError
from dousa.formats import SUFFIXES, read_motion
from dousa.library._arrays import pack, unpack
from dousa.library._describing import (
    BEYOND_MEASURE,
    Description,
    StoredMotion,
    describe_clip,
    round_positions,
)
from dousa.library._jobs import check_jobs, choose_jobs
from dousa.library.reports import Skipped
from dousa.library.schema import CLIP
from dousa.motion.joints import CANONICAL_JOINTS
from dousa.retrieval.posed_motion import check_frame_rate

if TYPE_CHECKING:
    from dousa.motion import CanonicalMotion

__all__ = [
    "ClipRecord",
    "FoundFile",
    "KnownContent",
    "ReadOptions",
    "ReadTask",
    "SourceState",
    "describe_problem",
    "find_motion_files",
    "is_unicode",
    "look_at",
    "read_canonical",
    "read_clip",
    "read_clips",
]


_BEYOND = "its joints lie beyond any measure; is the unit right?"


@dataclass(frozen=True, slots=True)
class ReadOptions:
    """What a person says about files that do not say it themselves.

    Parameters
    ----------
    joint_map : canonical joint to the name, or names, in the file.
    unit : metres per unit of the file, or a name such as ``"cm"``.
    up : axis of the file that points up.
    skeleton : the ``.asf`` of ``.amc`` files.
    """

    joint_map: Mapping[str, str | Sequence[str]] | None = None
    unit: float | str | None = None
    up: str | None = None
    skeleton: str | os.PathLike[str] | None = None

    def describe(self) -> str:
        """The options that change how a content is understood, as one line; empty if there are none."""
        joints = None
        if self.joint_map is not None:
            joints = {
                key: value if isinstance(value, str) else list(value) for key, value in self.joint_map.items()
            }
        given = {"joint_map": joints, "unit": self.unit, "up": self.up}
        given = {key: value for key, value in given.items() if value is not None}
        return json.dumps(given, sort_keys=True) if given else ""


@dataclass(frozen=True, slots=True)
class FoundFile:
    """A motion file and the PATH it was found under, both absolute."""

    root: Path
    path: Path


@dataclass(frozen=True, slots=True)
class SourceState:
    """The files behind a clip as they stand on the disk.

    Parameters
    ----------
    files : the motion file, then its skeleton file if it has one.
    size : bytes of all.
    fingerprint : sizes and times; equal ones mean that nothing changed.
    """

    files: tuple[str, ...]
    size: int
    fingerprint: str


@dataclass(frozen=True, slots=True)
class ReadTask:
    """One file to read.

    Parameters
    ----------
    path : the motion file.
    options : what is said about it.
    known : content hashes in the library of clips of this size; such a content is not parsed again.
    kind : ``CLIP`` or ``TAKE``.
    feature_set : name of the features to describe it by; it is not described if empty.
    """

    path: str
    options: ReadOptions
    known: tuple[str, ...] = ()
    kind: str = CLIP
    feature_set: str = ""


@dataclass(frozen=True, slots=True)
class KnownContent:
    """A file whose content is in the library."""

    path: str
    content_hash: str
    state: SourceState


@dataclass(frozen=True, slots=True, eq=False)
class ClipRecord:
    """All that the library keeps of one file.

    Parameters
    ----------
    path, content_hash, state : the file.
    format : short name of its format.
    n_frames, frame_rate, duration, height : of the motion; Hz, s, m.
    joint_table, warnings : how its joints were told apart.
    positions : float32 bytes of (T, 20, 3) m.
    kind : ``CLIP`` or ``TAKE``.
    description : features and poses, if they were asked for.
    """

    path: str
    content_hash: str
    state: SourceState
    format: str
    n_frames: int
    frame_rate: float
    duration: float
    height: float
    joint_table: str
    warnings: tuple[str, ...]
    positions: bytes
    kind: str
    description: Description | None

    def to_motion(self) -> StoredMotion:
        """The motion as it is stored."""
        positions = unpack(self.positions, "<f4", (self.n_frames, len(CANONICAL_JOINTS), 3), self.path)
        return StoredMotion(positions.astype(np.float64), self.frame_rate, self.height)


def find_motion_files(paths: Iterable[str | os.PathLike[str]]) -> tuple[list[FoundFile], list[Skipped]]:
    """The motion files that are named, or lie in folders that are named, at any depth.

    Folders give the files of known suffixes, in the order of their names; hidden files and folders are left
    out, and links to folders are followed once. A file that is named is always taken, whatever its suffix.

    Parameters
    ----------
    paths : files and folders.

    Returns
    -------
    files : each once, under the first PATH that leads to it.
    missing : the paths that do not exist, and the folders that cannot be looked into.
    """
    found: dict[Path, FoundFile] = {}
    missing: list[Skipped] = []
    for given in paths:
        root = Path(os.path.abspath(given))
        # Unlike Path.is_dir these say no, and do not raise, where a folder above cannot be looked into.
        if os.path.isdir(root):
            for path in _walk(root, missing):
                found.setdefault(path, FoundFile(root, path))
        elif os.path.exists(root):
            found.setdefault(root, FoundFile(root, root))
        else:
            missing.append(Skipped(os.fspath(given), "no such file or folder; check the name"))
    return list(found.values()), missing


def _walk(root: Path, closed: list[Skipped]) -> Iterator[Path]:
    def note(error: OSError) -> None:
        closed.append(Skipped(str(error.filename), f"the folder cannot be read: {error.strerror}"))

    seen: set[tuple[int, int]] = set()
    for folder, subfolders, names in os.walk(root, followlinks=True, onerror=note):
        place = os.stat(folder)
        if (place.st_dev, place.st_ino) in seen:
            subfolders.clear()
            continue
        seen.add((place.st_dev, place.st_ino))
        subfolders[:] = sorted(name for name in subfolders if not name.startswith("."))
        for name in sorted(names):
            if not name.startswith(".") and os.path.splitext(name)[1].lower() in SUFFIXES:
                yield Path(folder, name)


def look_at(path: str, options: ReadOptions) -> SourceState:
    """Size and times of a motion file and of the skeleton file that goes with it.

    Raises
    ------
    OSError : a file that is not there.
    MotionFileError : an ``.amc`` without a skeleton file.
    """
    files = [path]
    if path.lower().endswith(".amc"):
        files.append(os.fspath(options.skeleton or _find_skeleton(path)))
    stats = [os.stat(file) for file in files]
    fingerprint = " ".join(f"{stat.st_size}:{stat.st_mtime_ns}" for stat in stats)
    return SourceState(tuple(files), sum(stat.st_size for stat in stats), fingerprint)


def _find_skeleton(path: str) -> str | os.PathLike[str]:
    from dousa.formats.asf_amc import find_skeleton

    return find_skeleton(path)


def _hash_content(state: SourceState, options: ReadOptions) -> str:
    digest = hashlib.sha256()
    for file in state.files:
        with open(file, "rb") as stream:
            digest.update(stream.read())
    # The same bytes understood in another way make another clip.
    digest.update(options.describe().encode())
    return digest.hexdigest()


def read_canonical(path: str, options: ReadOptions) -> tuple[CanonicalMotion, str]:
    """A motion file as canonical joints, and the short name of its format.

    Raises
    ------
    MotionFileError : the file cannot be read.
    JointMappingError : its joints cannot be told apart.
    """
    from dousa.motion import Motion, canonicalise, compute_trajectories

    skeleton = options.skeleton if path.lower().endswith(".amc") else None
    motion = read_motion(path, unit=options.unit, up=options.up, skeleton=skeleton)
    form = motion.provenance.format if motion.provenance else ""
    trajectories = compute_trajectories(motion) if isinstance(motion, Motion) else motion
    try:
        return canonicalise(trajectories, options.joint_map), form
    except JointMappingError as error:
        raise JointMappingError(f"{path}: {error.problem}", error.joints) from error


def is_unicode(path: str) -> bool:
    """Whether a path is text: on some disks names are any bytes, which no database keeps."""
    try:
        path.encode()
    except UnicodeEncodeError:
        return False
    return True


def read_clip(task: ReadTask) -> ClipRecord | KnownContent | Skipped:
    """Read one motion file and derive everything the library keeps of it.

    Parameters
    ----------
    task : which file, and how.

    Returns
    -------
    The record; or that the content is known; or why the file cannot be used. Never raises for a bad file, so
    that the others go on.
    """
    if not is_unicode(task.path):
        printable = task.path.encode(errors="backslashreplace").decode()
        return Skipped(printable, "its name is not valid Unicode; rename it")
    try:
        state = look_at(task.path, task.options)
        content_hash = _hash_content(state, task.options)
        if content_hash in task.known:
            return KnownContent(task.path, content_hash, state)
        return _derive(task, state, content_hash)
    except DousaError as error:
        return Skipped(task.path, describe_problem(task.path, error))
    except OSError as error:
        return Skipped(task.path, f"cannot be read: {error.strerror or error}")
    except MemoryError:
        return Skipped(task.path, "the motion does not fit into the memory of this machine")


def describe_problem(path: str, error: DousaError) -> str:
    """The message without the path, which is told beside it."""
    if isinstance(error, MotionFileError) and error.path == path:
        return error.problem if error.line is None else f"line {error.line}: {error.problem}"
    return str(error).removeprefix(f"{path}: ")


def _derive(task: ReadTask, state: SourceState, content_hash: str) -> ClipRecord | Skipped:
    motion, form = read_canonical(task.path, task.options)
    rounded = round_positions(motion)
    if not ((np.abs(rounded.positions) < BEYOND_MEASURE).all() and motion.height * BEYOND_MEASURE > 1):
        return Skipped(task.path, _BEYOND)
    check_frame_rate(motion.frame_rate)
    return ClipRecord(
        path=task.path,
        content_hash=content_hash,
        state=state,
        format=form,
        n_frames=motion.n_frames,
        frame_rate=motion.frame_rate,
        duration=motion.duration,
        height=motion.height,
        joint_table=motion.mapping.table,
        warnings=tuple(motion.warnings),
        positions=pack(rounded.positions, "<f4"),
        kind=task.kind,
        description=describe_clip(rounded, task.feature_set) if task.feature_set else None,
    )


def read_clips(
    tasks: Sequence[ReadTask], n_jobs: int | None = None
) -> Generator[ClipRecord | KnownContent | Skipped, None, None]:
    """Read many files at the same time; answers come in the order of the tasks.

    Parameters
    ----------
    tasks : which files, and how.
    n_jobs : files at a time, as in joblib; by default every core, or what ``joblib.parallel_config`` says.

    Raises
    ------
    OptionError : zero jobs.
    """
    check_jobs(n_jobs)
    if len(tasks) <= 1 or n_jobs == 1:
        yield from map(read_clip, tasks)
        return
    import joblib

    # No backend is named here: threads are only a preference, so that Dask or Ray can take over.
    parallel = joblib.Parallel(n_jobs=choose_jobs(n_jobs), prefer="threads", return_as="generator")
    answers = parallel(joblib.delayed(read_clip)(task) for task in tasks)
    try:
        for answer in answers:  # noqa: UP028  (yield from would close them before the block below)
            yield answer
    finally:
        with warnings.catch_warnings():
            # Stopped in the middle: joblib regrets the files that were read in vain.
            warnings.simplefilter("ignore", UserWarning)
            answers.close()
