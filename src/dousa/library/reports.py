"""What the library says of itself and of its work: plain values without a connection, each with ``to_json()``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dousa.retrieval.calibration import Calibration

__all__ = [
    "AddReport",
    "ClipInfo",
    "Duplicate",
    "LibraryStats",
    "Skipped",
    "TrainReport",
]


@dataclass(frozen=True, slots=True)
class Skipped:
    """A file that was not added, and why.

    Parameters
    ----------
    path : the file.
    reason : what is wrong with it and what helps.
    """

    path: str
    reason: str


@dataclass(frozen=True, slots=True)
class Duplicate:
    """A file with the content of a clip that is in the library under another path.

    Parameters
    ----------
    path : the file.
    same_as : path of the stored clip.
    """

    path: str
    same_as: str


@dataclass(frozen=True, slots=True)
class AddReport:
    """What ``Library.add`` did.

    Parameters
    ----------
    added : paths of the new clips.
    replaced : paths of stored clips whose file had changed.
    unchanged : paths that were in the library already.
    moved : files that are in the library under a path where there is no file any more; the new path is kept.
    duplicates : files whose content is in the library under another path.
    skipped : files that could not be used.
    warnings : (path, text) of clips that were added with a doubt.
    other_labels : paths that were in the library with another category or performer than the rules give now;
        their labels stay, ``Library.relabel`` changes them.
    other_kind : paths that were in the library as clips and were added as takes, or the other way round; they stay
        what they are.
    n_learned : clips with a category that the leaves of the forest learned at once.
    new_categories : categories among them that the forest did not know.
    seconds : time it took.
    bytes : size of the files that were read.
    """

    added: tuple[str, ...]
    replaced: tuple[str, ...]
    unchanged: tuple[str, ...]
    moved: tuple[Duplicate, ...]
    duplicates: tuple[Duplicate, ...]
    skipped: tuple[Skipped, ...]
    warnings: tuple[tuple[str, str], ...]
    other_labels: tuple[str, ...]
    other_kind: tuple[str, ...]
    n_learned: int
    new_categories: tuple[str, ...]
    seconds: float
    bytes: int

    def to_json(self) -> dict[str, Any]:
        """The report as plain lists and dictionaries."""
        return {
            "added": list(self.added),
            "replaced": list(self.replaced),
            "unchanged": list(self.unchanged),
            "moved": [{"path": item.path, "from": item.same_as} for item in self.moved],
            "duplicates": [{"path": item.path, "same_as": item.same_as} for item in self.duplicates],
            "skipped": [{"path": item.path, "reason": item.reason} for item in self.skipped],
            "warnings": [{"path": path, "warning": text} for path, text in self.warnings],
            "other_labels": list(self.other_labels),
            "other_kind": list(self.other_kind),
            "n_learned": self.n_learned,
            "new_categories": list(self.new_categories),
            "seconds": self.seconds,
            "bytes": self.bytes,
        }


@dataclass(frozen=True, slots=True)
class TrainReport:
    """What ``Library.train`` did.

    Parameters
    ----------
    feature_set : name of the features that it asks for.
    n_trees : trees of the forest.
    n_clips : clips it was trained on.
    n_unlabelled : clips without a category, which got a histogram only.
    categories : number of clips of each category.
    calibration : how well motions of unknown categories are told from known ones, learned by holding some back; None
        where there were too few clips or categories.
    single : categories with one clip: the forest has seen too little to tell them apart.
    seconds : time it took.
    """

    feature_set: str
    n_trees: int
    n_clips: int
    n_unlabelled: int
    categories: dict[str, int]
    calibration: Calibration | None
    single: tuple[str, ...]
    seconds: float

    def to_json(self) -> dict[str, Any]:
        """The report as plain lists and dictionaries."""
        return {
            "feature_set": self.feature_set,
            "n_trees": self.n_trees,
            "n_clips": self.n_clips,
            "n_unlabelled": self.n_unlabelled,
            "categories": dict(self.categories),
            "calibration": None if self.calibration is None else self.calibration.to_json(),
            "single": list(self.single),
            "seconds": self.seconds,
        }


@dataclass(frozen=True, slots=True)
class ClipInfo:
    """A clip or take of the library, without its arrays.

    Parameters
    ----------
    id : number of the clip; never given out twice.
    path : file it came from.
    category, performer : labels, None where there are none.
    predicted_category : what the forest takes it for, None before the training.
    format : short name of the file's format.
    n_frames : number of poses.
    frame_rate : Hz.
    duration : s.
    height : m, of the performer's skeleton.
    joint_table : where the canonical joints came from, such as ``"CMU/HDM05"``.
    warnings : doubts that came up when the file was read.
    kind : ``"clip"`` or ``"take"``.
    """

    id: int
    path: str
    category: str | None
    performer: str | None
    predicted_category: str | None
    format: str
    n_frames: int
    frame_rate: float
    duration: float
    height: float
    joint_table: str
    warnings: tuple[str, ...]
    kind: str = "clip"

    def to_json(self) -> dict[str, Any]:
        """The clip as a plain dictionary."""
        return {
            "id": self.id,
            "path": self.path,
            "category": self.category,
            "performer": self.performer,
            "predicted_category": self.predicted_category,
            "format": self.format,
            "n_frames": self.n_frames,
            "frame_rate": self.frame_rate,
            "duration": self.duration,
            "height": self.height,
            "joint_table": self.joint_table,
            "warnings": list(self.warnings),
            "kind": self.kind,
        }


@dataclass(frozen=True, slots=True)
class LibraryStats:
    """A library in numbers.

    Parameters
    ----------
    n_clips : clips, takes left out.
    n_frames : poses of all clips.
    seconds : duration of all clips.
    n_takes, take_seconds : uncut recordings, and their duration.
    n_unlabelled : clips without a category.
    categories : number of clips of each category.
    performers : number of clips and takes of each performer.
    trained_at : when the forest was trained (ISO 8601, UTC), None if there is none.
    n_trained : clips the forest was trained on.
    n_learned : clips that its leaves learned later.
    parameters : of the forest, with the name of the features it was trained on.
    forest_is_current : false if clips or labels changed after the training, or there is no forest.
    revision : counts the writes.
    """

    n_clips: int
    n_frames: int
    seconds: float
    n_takes: int
    take_seconds: float
    n_unlabelled: int
    categories: dict[str, int]
    performers: dict[str, int]
    trained_at: str | None
    n_trained: int
    n_learned: int
    parameters: dict[str, Any]
    forest_is_current: bool
    revision: int

    def to_json(self) -> dict[str, Any]:
        """The numbers as plain lists and dictionaries."""
        return {
            "n_clips": self.n_clips,
            "n_frames": self.n_frames,
            "seconds": self.seconds,
            "n_takes": self.n_takes,
            "take_seconds": self.take_seconds,
            "n_unlabelled": self.n_unlabelled,
            "categories": dict(self.categories),
            "performers": dict(self.performers),
            "trained_at": self.trained_at,
            "n_trained": self.n_trained,
            "n_learned": self.n_learned,
            "parameters": dict(self.parameters),
            "forest_is_current": self.forest_is_current,
            "revision": self.revision,
        }
