"""Motion files on disk: options, finding them, reading them on canonical joints, and votes on what they leave open.

A program writes all its files in the same axes and unit, and with joints or markers. Where a file's own evidence is
only a guess, the files with the same joints that were read together decide, if most of those with clear evidence agree.
"""

from __future__ import annotations

import dataclasses
import json
import os
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dousa.errors import DousaError, JointMappingError
from dousa.files.frame_files import is_frame_folder
from dousa.formats.parts import file_of
from dousa.formats.registry import find_reader, is_motion_file, read_motion
from dousa.messages import Message

if TYPE_CHECKING:
    from dousa.motion import CanonicalMotion, Motion, Trajectories


JointMap = Mapping[str, str | Sequence[str]]
"""Canonical joint to the name, or names, in the file."""


@dataclass(frozen=True, slots=True)
class ReadOptions:
    """Options for reading motion files.

    Parameters
    ----------
    joint_map : canonical joint to the name, or names, in the file; see ``dousa.motion.canonicalise``.
    unit : metres per unit of the file, or a name such as ``"cm"``; see ``dousa.formats.read_motion``.
    up : axis of the file that points up, such as ``"y"`` or ``"-z"``.
    skeleton : the ``.asf`` of ``.amc`` files, the model of ``.vmd`` files, the body model of SMPL poses.
    frame_rate : Hz, whatever the file says.
    person, animation : name or number of one of several in a file; see ``dousa.formats.read_motion``.
    any_skeleton : take bodies that cannot be a person's too, such as an animal's.
    markers : whether points named like joints are markers on the skin; None to decide it by the file.
    """

    joint_map: JointMap | None = None
    unit: float | str | None = None
    up: str | None = None
    skeleton: str | os.PathLike[str] | None = None
    frame_rate: float | None = None
    any_skeleton: bool = False
    person: str | None = None
    animation: str | None = None
    markers: bool | None = None

    def describe(self) -> str:
        """Return the options that affect the result, as one line of JSON; empty if there are none."""
        joints = None
        if self.joint_map is not None:
            joints = {key: value if isinstance(value, str) else list(value) for key, value in self.joint_map.items()}
        given = {
            "joint_map": joints,
            "unit": self.unit,
            "up": self.up,
            "frame_rate": self.frame_rate,
            "any_skeleton": self.any_skeleton or None,
            "person": self.person,
            "animation": self.animation,
            "markers": self.markers,
        }
        given = {key: value for key, value in given.items() if value is not None}
        return json.dumps(given, sort_keys=True) if given else ""


@dataclass(frozen=True, slots=True)
class FoundFile:
    """A motion file and the PATH it was found under, both absolute."""

    root: Path
    path: Path


@dataclass(frozen=True, slots=True)
class Skipped:
    """A file that was not used.

    Parameters
    ----------
    path : the file.
    reason : the problem and its remedy.
    """

    path: str
    reason: Message

    def to_json(self) -> dict[str, Any]:
        """Return path and reason, in the language in use."""
        return {"path": self.path, "reason": str(self.reason)}


def find_motion_files(
    paths: Iterable[str | os.PathLike[str]], others: Counter[str] | None = None
) -> tuple[list[FoundFile], list[Skipped]]:
    """Find the motion files among paths and, at any depth, in folders.

    Folders give the files of known suffixes, in the order of their names; hidden files and folders are left out, and
    links to folders are followed once. A folder with a file for each frame is one motion. A named file is always taken,
    whatever its suffix.

    Parameters
    ----------
    paths : files and folders.
    others : counts files of folders without a reader, by suffix.

    Returns
    -------
    files : each once, under the first PATH that leads to it.
    missing : paths that do not exist, and folders that cannot be read.
    """
    found: dict[Path, FoundFile] = {}
    missing: list[Skipped] = []
    for given in paths:
        root = Path(os.path.abspath(given))
        # Unlike Path.is_dir these return false, and do not raise, where a folder above cannot be read.
        if os.path.isdir(root) and find_reader(root) is None:
            for path in _walk(root, missing, Counter() if others is None else others):
                found.setdefault(path, FoundFile(root, path))
        elif os.path.exists(root):
            found.setdefault(root, FoundFile(root, root))
        else:
            missing.append(Skipped(os.fspath(given), Message("motion_files.not_found")))
    return list(found.values()), missing


def _walk(root: Path, closed: list[Skipped], others: Counter[str]) -> Iterator[Path]:
    def note(error: OSError) -> None:
        closed.append(Skipped(str(error.filename), Message("motion_files.folder_unreadable", reason=error)))

    seen: set[tuple[int, int]] = set()
    for folder, subfolders, names in os.walk(root, followlinks=True, onerror=note):
        place = os.stat(folder)
        if (place.st_dev, place.st_ino) in seen:
            subfolders.clear()
            continue
        seen.add((place.st_dev, place.st_ino))
        if is_frame_folder(folder, names):
            yield Path(folder)
            names[:] = [name for name in names if not name.lower().endswith(".json")]
        subfolders[:] = sorted(name for name in subfolders if not name.startswith("."))
        for name in sorted(names):
            if name.startswith("."):
                continue
            if is_motion_file(os.path.join(folder, name)):
                yield Path(folder, name)
            else:
                others[os.path.splitext(name)[1].lower()] += 1


def is_unicode(path: str) -> bool:
    """Return whether a path is text: on some disks names are any bytes, which no database stores."""
    try:
        path.encode()
    except UnicodeEncodeError:
        return False
    return True


def read_canonical(
    path: str | os.PathLike[str], options: ReadOptions | None = None, *, whole: bool = True
) -> tuple[CanonicalMotion, str]:
    """Read a motion file on canonical joints, with the short name of its format.

    Parameters
    ----------
    path : file ending in one of ``SUFFIXES``.
    options : what the file lacks.
    whole : refuse a part of a body; see ``dousa.motion.canonicalise``.

    Raises
    ------
    MotionFileError : the file cannot be read.
    JointMappingError : its joints cannot be mapped; the error has the ``path``.
    """
    from dousa.motion import compute_trajectories

    options = options or ReadOptions()
    # Of a long recording neither the file's own numbers nor, while its joints are mapped, its rotations are held.
    motion = read_with(path, options)
    source = motion.provenance and motion.provenance.derive()
    motion = compute_trajectories(dataclasses.replace(motion, provenance=source))
    canonical = map_joints(path, motion, options, whole=whole)
    return canonical, motion.provenance.format if motion.provenance else ""


def read_with(path: str | os.PathLike[str], options: ReadOptions) -> Motion | Trajectories:
    """Read a motion file as it is; parameters and errors as of ``read_canonical``."""
    line = find_reader(path)
    # In a folder of all kinds, each kind uses its own options.
    own = line.options if line is not None else ()
    return read_motion(
        path, unit=options.unit, up=options.up, frame_rate=options.frame_rate, person=options.person,
        skeleton=options.skeleton if "skeleton" in own else None,
        animation=options.animation if "animation" in own else None,
    )  # fmt: skip


def map_joints(
    path: str | os.PathLike[str], motion: Motion | Trajectories, options: ReadOptions, *, whole: bool = True
) -> CanonicalMotion:
    """Map what was read of a file to canonical joints; parameters and errors as of ``read_canonical``."""
    from dousa.motion import canonicalise

    try:
        return canonicalise(
            motion, options.joint_map, any_skeleton=options.any_skeleton, whole=whole, markers=options.markers
        )
    except JointMappingError as error:
        error.path = os.fspath(path)
        raise


def describe_problem(path: str, error: DousaError) -> Message:
    """Return the message of an error without the file but with the line, for a place that names the file itself."""
    place, line = getattr(error, "path", None), getattr(error, "line", None)
    if place not in (None, path, file_of(path)):
        return Message("motion_files.in_other_file", path=place, problem=error.message)
    if line is not None:
        return Message("motion_files.at_line", line=line, problem=error.message)
    return error.message


OVERRULED = frozenset({"units.guessed_up", "units.assumed", "units.normalised", "canonical.not_a_person"})
"""Codes of the notes that no longer hold where others decided."""


@dataclass(frozen=True, slots=True)
class FrameClaim:
    """Axes, unit and body of a file, declared or guessed.

    Parameters
    ----------
    skeleton : names and tree of the joints.
    up, up_source, unit, unit_source : as in a ``Provenance``.
    height : of the body in units of the file.
    markers : as in a ``JointMapping``.
    is_person : whether the proportions are a person's.
    """

    skeleton: tuple[object, ...]
    up: str
    up_source: str
    unit: float
    unit_source: str
    height: float
    markers: bool | None = None
    is_person: bool = True

    @property
    def doubtful(self) -> bool:
        """Whether other files could have better evidence."""
        is_open = self.markers is not None or not self.is_person
        return is_open or self.up_source == "guessed" or self.unit_source == "assumed"


@dataclass(frozen=True, slots=True)
class Elected:
    """What other files of a skeleton decided on one.

    Parameters
    ----------
    up, unit, markers : to read it with; None where undecided.
    is_person : whether it is a person's although its proportions are not.
    notes : for the user.
    """

    up: str | None = None
    unit: float | None = None
    markers: bool | None = None
    is_person: bool = False
    notes: tuple[Message, ...] = ()

    @property
    def decides(self) -> bool:
        """Whether anything was decided."""
        return self.is_person or (self.up, self.unit, self.markers) != (None, None, None)

    def apply(self, options: ReadOptions) -> ReadOptions:
        """Return the options, completed by what was decided."""
        return dataclasses.replace(
            options,
            up=self.up or options.up,
            unit=self.unit or options.unit,
            markers=options.markers if self.markers is None else self.markers,
            any_skeleton=self.is_person or options.any_skeleton,
        )


def describe_frame(motion: Motion | Trajectories, canonical: CanonicalMotion) -> FrameClaim | None:
    """Return the claim of a file that was read; None for a motion without a file."""
    from dousa.motion import Motion

    origin = motion.provenance
    if origin is None:
        return None
    if isinstance(motion, Motion):
        skeleton: tuple[object, ...] = (motion.skeleton.names, motion.skeleton.parents.tobytes())
    else:
        skeleton = (tuple(sorted(motion.names)),)
    return FrameClaim(
        (origin.format, *skeleton),
        origin.up,
        origin.up_source,
        origin.unit,
        origin.unit_source,
        canonical.height / origin.unit,
        canonical.mapping.markers,
    )


_FEWEST, _MAJORITY = 2, 0.75
"""By definition: how many files decide on the body of another, and which share of those that know."""


@dataclass(slots=True)
class FrameVotes:
    """The claims of files read together, by skeleton."""

    claims: dict[tuple[object, ...], list[FrameClaim]] = field(default_factory=lambda: defaultdict(list))

    def count(self, claim: FrameClaim) -> None:
        """Add the claim of one more file."""
        self.claims[claim.skeleton].append(claim)

    def elect(self, claim: FrameClaim) -> Elected:
        """Let the other files of its skeleton decide on a doubtful claim."""
        every = self.claims[claim.skeleton]
        others = [other for other in every if other.is_person]
        up, unit = self._elect_up(claim, others), self._elect_unit(claim, others)
        markers = self._elect_markers(claim, others)
        is_person = not claim.is_person and len(others) >= max(_FEWEST, _MAJORITY * len(every))
        notes = []
        if up is not None and up != claim.up:
            known = sum(other.up_source != "guessed" for other in others)
            notes.append(Message("units.voted_up", up=up, n=known, own=claim.up))
        if unit is not None:
            notes.append(Message("units.voted_unit", unit=unit, n=len(others), own=claim.unit))
        if markers is not None:
            code = "canonical.voted_markers" if markers else "canonical.voted_joints"
            notes.append(Message(code, n=sum(other.markers == markers for other in others)))
        if is_person:
            notes.append(Message("canonical.voted_person", n=len(others)))
        return Elected(up, unit, markers, is_person, tuple(notes))

    @staticmethod
    def _elect_markers(claim: FrameClaim, others: list[FrameClaim]) -> bool | None:
        """Return what most files were taken for, if it is not what the file was; None if they do not decide."""
        counts = Counter(other.markers for other in others if other.markers is not None)
        if claim.markers is None or not counts:
            return None
        found, votes = counts.most_common(1)[0]
        enough = votes >= max(_FEWEST, _MAJORITY * counts.total())
        return found if enough and found != claim.markers else None

    @staticmethod
    def _elect_up(claim: FrameClaim, others: list[FrameClaim]) -> str | None:
        """Return the axis that most files with evidence have, if they are a clear majority of these."""
        known = Counter(other.up for other in others if other.up_source != "guessed")
        if claim.up_source != "guessed" or not known:
            return None
        up, votes = known.most_common(1)[0]
        return up if votes >= _MAJORITY * known.total() else None

    @staticmethod
    def _elect_unit(
        claim: FrameClaim, others: list[FrameClaim], same_size: float = 1.6, typical_height: float = 1.55
    ) -> float | None:
        """Return the unit of the files with evidence, else the one that makes the mean body of a typical height.

        Parameters
        ----------
        same_size : by which factor the heights of two files of one unit, in that unit, differ at most.
        typical_height : m, over the joints.
        """
        similar = [other for other in others if 1 / same_size < other.height / claim.height < same_size]
        if claim.unit_source != "assumed" or len(similar) < 2:
            return None
        known = Counter(other.unit for other in similar if other.unit_source != "assumed")
        if known:
            return known.most_common(1)[0][0]
        import numpy as np

        heights = np.array([other.height for other in similar])
        unit = float(typical_height / np.exp(np.log(heights).mean()))
        return unit if abs(unit / claim.unit - 1) > 1e-6 else None
