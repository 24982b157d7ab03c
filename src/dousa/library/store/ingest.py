"""From motions to records: reads a file or takes a motion in memory, and derives everything to store.

``read_clip`` is a pure function of a task, for threads of joblib and the workers of a cluster (``dousa.workers``).
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Generator, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from dousa.errors import DousaError, InvalidMotionError, JointMappingError, MotionFileError
from dousa.formats.motion_files import (
    OVERRULED,
    Elected,
    FrameClaim,
    ReadOptions,
    Skipped,
    describe_frame,
    describe_problem,
    is_unicode,
    map_joints,
    read_canonical,
    read_with,
)
from dousa.formats.parts import file_of, find_address, join_address, list_untaken, split_address
from dousa.library.store.engine import check_jobs, choose_jobs
from dousa.library.store.features import Description, StoredMotion, describe_clip, is_measurable, lacks, round_positions
from dousa.library.store.schema import CLIP, pack
from dousa.library.store.selection import choose_doubts
from dousa.messages import Message
from dousa.motion import CANONICAL_JOINTS, CanonicalMotion, canonicalise
from dousa.retrieval.features.posed_motion import check_frame_rate
from dousa.workers.current import current_cluster
from dousa.workers.threads import yield_answers

if TYPE_CHECKING:
    from dousa.motion import Motion, Trajectories
    from dousa.workers.cluster import Cluster


@dataclass(frozen=True, slots=True)
class SourceState:
    """The present state of the files of a clip.

    ``files`` : the motion file, or those of its frames, then its skeleton file if it has one.
    ``size``, ``fingerprint`` : bytes of all; sizes and times, equal if nothing changed.
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
    options : how to read it.
    known : content hashes of clips of this size in the library; such a content is not parsed again.
    kind : ``CLIP`` or ``TAKE``.
    feature_set : name of the features to compute; none if empty.
    voted : what other files of its skeleton elected.
    may_be_voted : keep a body of impossible proportions until others decide on it, see ``ClipRecord.refusal``.
    parts : of a file of several people or animations, whether to list them instead of reading the first.
    """

    path: str
    options: ReadOptions
    known: tuple[str, ...] = ()
    kind: str = CLIP
    feature_set: str = ""
    voted: Elected = field(default_factory=Elected)
    may_be_voted: bool = False
    parts: bool = False


@dataclass(frozen=True, slots=True)
class Several:
    """A file (or part) of several people or animations, each of which is a motion of its own.

    ``path`` : as it was asked for. ``addresses`` : of the parts, see ``dousa.formats.parts``.
    """

    path: str
    addresses: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class FileRecord:
    """A file whose content is in the library; ``row`` has its values of ``clips``, of a ``ClipRecord`` all values."""

    row: dict[str, Any]

    @property
    def path(self) -> str:
        """Path of the file, or the name of a motion in memory."""
        return str(self.row["path"])


@dataclass(frozen=True, slots=True, eq=False)
class ClipRecord(FileRecord):
    """All that the library keeps of one motion, except number, labels and date.

    Parameters
    ----------
    row : values of the columns of ``clips``.
    motion : as it is stored.
    description : features and poses, if they were wanted.
    claim : axes and unit according to the file; None of a motion in memory.
    place : of a segment of a take, the values of the columns of ``segments``.
    refusal : why the file cannot be used, unless others of its skeleton decide otherwise.
    """

    motion: StoredMotion
    description: Description | None
    claim: FrameClaim | None = None
    place: dict[str, Any] | None = None
    refusal: Message | None = None


def look_at(path: str, options: ReadOptions) -> SourceState:
    """Return size and times of a motion file (or the files of its frames) and of its skeleton file.

    OSError for a file that is not there. MotionFileError for an ``.amc`` without a skeleton file.
    """
    path = file_of(path)
    files = [path]
    if os.path.isdir(path):  # a file for each frame
        from dousa.files.frame_files import list_frame_files

        files = [os.path.join(path, name) for name in list_frame_files(path)]
    elif path.lower().endswith(".amc"):
        from dousa.formats.asf_amc.reading import find_skeleton

        files.append(os.fspath(options.skeleton or find_skeleton(path)))
    elif path.lower().endswith(".vmd"):
        from dousa.formats.mmd import find_model

        model = options.skeleton or find_model(path)
        files += [] if model is None else [os.fspath(model)]
    stats = [os.stat(file) for file in files]
    fingerprint = " ".join(f"{stat.st_size}:{stat.st_mtime_ns}" for stat in stats)
    return SourceState(tuple(files), sum(stat.st_size for stat in stats), fingerprint)


def is_as_stored(row: Any, options: ReadOptions) -> bool:
    """Return whether a file (of a row of ``clips``) is unchanged and would be read in the same way."""
    if row.read_options != options.describe():
        return False
    try:
        return bool(look_at(row.path, options).fingerprint == row.fingerprint)
    except (DousaError, OSError):
        return False  # reading the file reports the error


def read_clip(task: ReadTask) -> ClipRecord | FileRecord | Several | Skipped:
    """Read one motion file, or a part of it, and derive everything the library keeps of it.

    Returns
    -------
    The record; that of the file alone if its content is known; the parts of the file, if they were asked for; or why
    the file cannot be used. A bad file raises no error, so that the others go on.
    """
    if not is_unicode(task.path):
        printable = task.path.encode(errors="backslashreplace").decode()
        return Skipped(printable, Message("motion_files.not_unicode"))
    try:
        return _read_clip(task)
    except DousaError as error:
        return Skipped(task.path, describe_problem(task.path, error))
    except OSError as error:
        return Skipped(task.path, Message("motion_files.unreadable", reason=error))
    except MemoryError:
        return Skipped(task.path, Message("motion_files.too_large"))


def _read_clip(task: ReadTask) -> ClipRecord | FileRecord | Several:
    state = look_at(task.path, task.options)
    row = {
        "path": task.path,
        "content_hash": _hash_content(state, task.path, task.options),
        "fingerprint": state.fingerprint,
        "size": state.size,
        "read_options": task.options.describe(),
        "kind": task.kind,
    }
    if row["content_hash"] in task.known:
        return FileRecord(row)
    options, refusal = task.voted.apply(task.options), None
    motion = read_with(task.path, options)
    said = motion.provenance.notes if motion.provenance else ()
    if task.parts and (addresses := list_untaken(task.path, said)):
        return Several(task.path, addresses)
    if task.parts and (path := find_address(task.path, said)) != task.path:
        row |= {"path": path, "content_hash": _hash_content(state, path, task.options)}
    try:
        canonical = map_joints(task.path, motion, options, whole=False)
    except JointMappingError as error:
        if not task.may_be_voted or error.problem.code != "canonical.not_human":
            raise
        refusal = describe_problem(task.path, error)
        canonical = map_joints(task.path, motion, replace(options, any_skeleton=True), whole=False)
    if task.voted.decides:
        kept = tuple(note for note in canonical.warnings if note.code not in OVERRULED)
        canonical = replace(canonical, warnings=(*task.voted.notes, *kept))
    form = motion.provenance.format if motion.provenance else ""
    record = _derive(canonical, {**row, "format": form}, task.feature_set)
    claim = describe_frame(motion, canonical)
    if claim is not None and refusal is not None:
        claim = replace(claim, is_person=False)
    return replace(record, claim=claim, refusal=refusal)


def _hash_content(state: SourceState, path: str, options: ReadOptions) -> str:
    digest = _hash_files(state.files, state.fingerprint).copy()
    # The same bytes read with other options make another clip, and so does another part of them.
    digest.update(options.describe().encode())
    if parts := split_address(path)[1]:
        digest.update(join_address("", parts).encode())
    return digest.hexdigest()


@lru_cache(maxsize=1)  # the parts of a file follow each other
def _hash_files(files: tuple[str, ...], _fingerprint: str) -> hashlib._Hash:
    digest = hashlib.sha256()
    for file in files:
        with open(file, "rb") as stream:
            digest.update(stream.read())
    return digest


def make_record(motion: CanonicalMotion, name: str, kind: str) -> ClipRecord:
    """Derive everything the library keeps of a motion in memory; InvalidMotionError if it is beyond measure.

    Its fingerprint is empty, and its content hash is of the stored data.
    """
    positions = pack(motion.positions, "<f4")
    digest = hashlib.sha256(positions)
    digest.update(np.array([motion.frame_rate, motion.height], "<f8").tobytes())
    row = {
        "path": name,
        "content_hash": digest.hexdigest(),
        "fingerprint": "",
        "size": len(positions),
        "read_options": "",
        "kind": kind,
        "format": "memory",
    }
    return _derive(motion, row, "")


def _derive(motion: CanonicalMotion, row: dict[str, Any], feature_set: str) -> ClipRecord:
    rounded = _round(motion)
    absent = rounded.absent
    row |= {
        "n_frames": motion.n_frames,
        "frame_rate": motion.frame_rate,
        "duration": motion.duration,
        "height": motion.height,
        "joint_table": motion.mapping.table,
        "warnings": [item.to_json() for item in motion.warnings],
        "absent": " ".join(absent),
    }
    described = feature_set and not lacks(feature_set, row["absent"])
    description = describe_clip(rounded, feature_set) if described else None
    return ClipRecord(row, rounded, description)


def _round(motion: CanonicalMotion) -> StoredMotion:
    """Return the motion as it would be stored; InvalidMotionError if positions or the frame rate are beyond measure."""
    rounded = round_positions(motion)
    there = [row for row, joint in enumerate(CANONICAL_JOINTS) if joint not in rounded.absent]
    if not is_measurable(rounded.positions[:, there], motion.height):
        raise InvalidMotionError("motion_files.beyond_measure")
    check_frame_rate(motion.frame_rate)
    return rounded


def read_clips(
    tasks: Sequence[ReadTask], n_jobs: int | None = None
) -> Generator[ClipRecord | FileRecord | Several | Skipped, None, None]:
    """Read many files at the same time (``n_jobs`` as in ``Library.add``), in the order of the tasks."""
    check_jobs(n_jobs)
    cluster = current_cluster()
    if cluster is not None and tasks:
        yield from _read_elsewhere(cluster, tasks)
        return
    if len(tasks) <= 1 or n_jobs == 1:
        yield from map(read_clip, tasks)
        return
    yield from yield_answers(read_clip, tasks, choose_jobs(n_jobs))


def _read_elsewhere(
    cluster: Cluster, tasks: Sequence[ReadTask]
) -> Generator[ClipRecord | FileRecord | Several | Skipped, None, None]:
    files = [file_of(task.path) for task in tasks]
    cluster.check_paths(files)
    sizes = [os.path.getsize(file) if os.path.isfile(file) else 0 for file in files]
    for task, answer in zip(tasks, cluster.map(read_clip, tasks, sizes=sizes), strict=True):
        # Retry here a file that a worker cannot use: the worker may not see it.
        yield read_clip(task) if isinstance(answer, Skipped) else answer


Given: TypeAlias = "str | os.PathLike[str] | CanonicalMotion | Motion | Trajectories"
"""A file or a motion."""

Query: TypeAlias = "int | Given"
"""A query: the number of a clip, a file, or a motion."""


def read_query(query: Given, options: ReadOptions) -> CanonicalMotion:
    """Read a file or a motion onto canonical joints."""
    if isinstance(query, str | os.PathLike):
        return read_canonical(query, options, whole=False)[0]
    return query if isinstance(query, CanonicalMotion) else canonicalise(query, options.joint_map)


def read_rounded(query: Given, options: ReadOptions) -> tuple[StoredMotion, tuple[Message, ...]]:
    """Return a file or a motion as it would be stored, and the warnings from reading it."""
    motion = read_query(query, options)
    try:
        return _round(motion), choose_doubts(motion.warnings)
    except InvalidMotionError as error:
        if isinstance(query, str | os.PathLike):
            raise MotionFileError(query, error.message) from error
        raise


def list_doubts(record: ClipRecord) -> tuple[Message, ...]:
    """Return the warnings from reading a file."""
    return choose_doubts(map(Message.from_json, record.row["warnings"]))


def name_query(query: Query) -> str:
    """Return the name of a query for results: its path, if it has one."""
    if isinstance(query, str | os.PathLike):
        return os.fspath(query)
    return getattr(getattr(query, "provenance", None), "path", "motion")
