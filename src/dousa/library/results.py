"""What the library answers about motions: plain values without a connection behind them, each with ``to_json()``."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, ClassVar

from dousa.formats.motion_files import Skipped
from dousa.messages import Message
from dousa.motion.annotation import Stretch, lay_out

if TYPE_CHECKING:
    from dousa.retrieval.explain.explanation import Explanation, Likeness
    from dousa.retrieval.forest.calibration import Calibration
    from dousa.retrieval.takes.label import Timeline

__all__ = [
    "AddReport",
    "Classification",
    "ClipInfo",
    "Duplicate",
    "FindResult",
    "Hit",
    "LabelledTake",
    "LibraryStats",
    "Place",
    "SearchResult",
    "Skipped",
    "TakeAnnotation",
    "TakeSegment",
    "TrainReport",
    "Verdict",
]

# Many motions are their own mirror image, so a mirror image must be clearly better: by this share of the votes, this
# factor of a distance, this much of a score.
MIRROR_VOTES, MIRROR_DISTANCE, MIRROR_SCORE = 0.1, 0.95, 0.02
_LEAST_REST = 0.002  # s; less is lost where times are rounded


class _Answer:
    """A plain value that can be written as JSON, under other names where ``_names`` has some."""

    __slots__ = ()
    _names: ClassVar[dict[str, str]] = {}

    def to_json(self) -> dict[str, Any]:
        """The value as plain lists and dictionaries, messages in the language in use."""
        names = [field.name for field in fields(self)]  # type: ignore[arg-type]
        return {self._names.get(name, name): _to_plain(getattr(self, name)) for name in names}


def _to_plain(value: Any) -> Any:
    if isinstance(value, Message):
        return str(value)
    if hasattr(value, "to_json"):
        return value.to_json()
    if isinstance(value, tuple):
        return [_to_plain(item) for item in value]
    return dict(value) if isinstance(value, dict) else value


def _without(answer: dict[str, Any], name: str) -> dict[str, Any]:
    """The same, without a key that has no value."""
    if answer[name] is None:
        del answer[name]
    return answer


@dataclass(frozen=True, slots=True)
class Verdict(_Answer):
    """What the forest predicts for a motion.

    Parameters
    ----------
    category : the category; None where the guess is more likely wrong than right, or the motion hardly known, and so
        called unknown.
    guess : the category that most trees vote for, whether the motion is known or not.
    known : probability that the motion is of a category that the forest knows; None where the forest had too few
        categories to learn that, or was trained by an older dousa.
    confidence : probability that the guess is right, for somebody who does not know whether the library knows the
        action, one in eleven being of none that it knows; None likewise.
    histogram : share of the trees that vote for each category, the largest first.
    explanation : the reasons, if requested.
    perhaps : whether the motion, though it has no category, may be what was guessed: it is less strange to the library
        than nearly all gestures that nobody named.
    """

    category: str | None
    guess: str
    known: float | None
    confidence: float | None
    histogram: dict[str, float]
    explanation: Explanation | None = None
    perhaps: bool = False

    def fits_better_than(self, other: Verdict) -> bool:
        """Whether the forest is clearly surer of this than of another motion."""
        own, others = ((one.category is not None, one.perhaps) for one in (self, other))
        if own != others:
            return own > others
        return self.histogram[self.guess] > other.histogram[other.guess] + MIRROR_VOTES

    def to_json(self) -> dict[str, Any]:
        """The verdict as plain lists and dictionaries; ``explanation`` only where there is one."""
        return _without({"category": None, "histogram": None, **_Answer.to_json(self)}, "explanation")


@dataclass(frozen=True, slots=True)
class Hit(_Answer):
    """One clip that a search found.

    Parameters
    ----------
    path : file the clip came from.
    category : its category; the forest's, where nobody gave it one.
    distance : between the histograms of query and clip, eq. 8; 0 to sqrt(2).
    rank : 1 for the nearest.
    clip_id : number of the clip in the library.
    leaf_share : share of the trees in which query and clip end in the same leaf, 0 to 1.
    pose_distance : of the poses of both, aligned in time, body heights; None where they were not compared.
    rank_distance : what the order goes by; None where the poses decide and were not compared.
    mirrored : whether it is the mirror image of the query that the clip is like.
    likeness : why they are alike, if requested.
    hidden : canonical joints that were not compared, as one of both bodies lacks them.
    alike : whether it is alike at all, as learned from the library; None where that was not learned.
    probability : that both mean the same, where clips of any meaning are equally likely; None likewise.
    """

    path: str
    category: str
    distance: float
    rank: int
    clip_id: int
    leaf_share: float
    pose_distance: float | None = None
    rank_distance: float | None = None
    mirrored: bool = False
    likeness: Likeness | None = None
    hidden: tuple[str, ...] = ()

    _names: ClassVar[dict[str, str]] = {"hidden": "compared_without"}
    alike: bool | None = None
    probability: float | None = None

    def to_json(self) -> dict[str, Any]:
        """The hit as a plain dictionary; ``likeness`` and ``compared_without`` only where there are any."""
        answer = _without(_Answer.to_json(self), "likeness")
        if not self.hidden:
            del answer["compared_without"]
        return answer


@dataclass(frozen=True, slots=True)
class SearchResult:
    """The answer to a search.

    Parameters
    ----------
    query : name of the query.
    verdict : what the forest predicts for it.
    results : the most similar clips, the most similar first.
    ranking : what they were ordered by, one of ``dousa.retrieval.RANKINGS``.
    mirrored : what it predicts for the mirror image, if requested.
    notes : what came up when the query was read, and what was not compared, where a body lacks joints.
    alike_count : clips of the library that are alike, of which ``results`` may be the first; the others follow them,
        alike or not. None where likeness was not learned: the library was not trained since, or is too small.
    """

    query: str
    verdict: Verdict
    results: tuple[Hit, ...]
    ranking: str
    mirrored: Verdict | None = None
    notes: tuple[Message, ...] = ()
    alike_count: int | None = None

    @property
    def category(self) -> str | None:
        """The predicted category of the query, None if it is of none that the forest knows."""
        return self.verdict.category

    @property
    def histogram(self) -> dict[str, float]:
        """Share of the trees that vote for each category, the largest first."""
        return self.verdict.histogram

    def to_json(self) -> dict[str, Any]:
        """The answer as plain lists and dictionaries."""
        return {
            "query": self.query,
            **self.verdict.to_json(),
            **_mirrored_json(self.verdict, self.mirrored),
            "ranking": self.ranking,
            "alike_count": self.alike_count,
            "results": [hit.to_json() for hit in self.results],
            **_notes_json(self.notes),
        }


@dataclass(frozen=True, slots=True)
class Classification:
    """What the forest predicts for a motion file.

    Parameters
    ----------
    path : the file.
    verdict : what the forest predicts, None if the file cannot be used.
    mirrored : what it predicts for the mirror image, if requested.
    problem : why the file cannot be used, None if it can.
    notes : what came up when the file was read, and what was not looked at, where the body lacks joints.
    """

    path: str
    verdict: Verdict | None
    mirrored: Verdict | None = None
    problem: Message | None = None
    notes: tuple[Message, ...] = ()

    @property
    def category(self) -> str | None:
        """The category; None if the motion is of none that the forest knows, or the file cannot be used."""
        return None if self.verdict is None else self.verdict.category

    @property
    def histogram(self) -> dict[str, float]:
        """Share of the trees that vote for each category, the largest first; empty if the file cannot be used."""
        return {} if self.verdict is None else self.verdict.histogram

    def to_json(self) -> dict[str, Any]:
        """The answer as a plain dictionary; ``problem`` only where there is one."""
        if self.verdict is None:
            nothing = dict.fromkeys(("category", "histogram", "guess", "known", "confidence"))
            return {"path": self.path, **nothing, "histogram": {}, "perhaps": False, "problem": str(self.problem)}
        mirrored = _mirrored_json(self.verdict, self.mirrored)
        return {"path": self.path, **self.verdict.to_json(), **mirrored, **_notes_json(self.notes)}


def _notes_json(notes: tuple[Message, ...]) -> dict[str, Any]:
    return {"notes": [str(note) for note in notes]} if notes else {}


def _mirrored_json(verdict: Verdict, mirrored: Verdict | None) -> dict[str, Any]:
    if mirrored is None:
        return {}
    return {"mirrored": {**mirrored.to_json(), "fits_better": mirrored.fits_better_than(verdict)}}


@dataclass(frozen=True, slots=True)
class Duplicate(_Answer):
    """A file with the content of a clip that is in the library under another path.

    Parameters
    ----------
    path : the file.
    same_as : path of the stored clip.
    """

    path: str
    same_as: str


@dataclass(frozen=True, slots=True)
class AddReport(_Answer):
    """What ``Library.add`` did.

    Parameters
    ----------
    added : paths of the new clips.
    replaced : paths of stored clips whose file had changed.
    unchanged : paths that were in the library already.
    moved : files that are in the library under a path where there is no file any more; the new path is kept.
    duplicates : files whose content is in the library under another path.
    skipped : files that could not be used.
    passed_over : (suffix, number) of the files in the folders that no reader takes.
    warnings : (path, message) of clips that were added with a doubt.
    other_labels : paths that were in the library with another category or performer than the rules give now;
        their labels stay, ``Library.relabel`` changes them.
    other_kind : paths that were in the library as clips and were added as takes, or the other way round; they stay
        what they are.
    n_learned : clips with a category that the leaves of the forest learned at once.
    new_categories : categories among them that the forest did not know.
    labelled : takes whose labels are new, or others than before.
    n_segments : of these takes, which are clips now.
    seconds : time it took.
    bytes : size of the files that were read.
    """

    added: tuple[str, ...]
    replaced: tuple[str, ...]
    unchanged: tuple[str, ...]
    moved: tuple[Duplicate, ...]
    duplicates: tuple[Duplicate, ...]
    skipped: tuple[Skipped, ...]
    passed_over: tuple[tuple[str, int], ...]
    warnings: tuple[tuple[str, Message], ...]
    other_labels: tuple[str, ...]
    other_kind: tuple[str, ...]
    n_learned: int
    new_categories: tuple[str, ...]
    labelled: tuple[str, ...]
    n_segments: int
    seconds: float
    bytes: int

    def to_json(self) -> dict[str, Any]:
        """The report as plain lists and dictionaries."""
        return {
            **_Answer.to_json(self),
            "moved": [{"path": item.path, "from": item.same_as} for item in self.moved],
            "warnings": [{"path": path, "warning": str(text)} for path, text in self.warnings],
            "passed_over": dict(self.passed_over),
        }


@dataclass(frozen=True, slots=True)
class TrainReport(_Answer):
    """What ``Library.train`` did.

    Parameters
    ----------
    feature_set : name of the features that it asks for.
    n_trees : trees of the forest.
    n_clips : clips it was trained on.
    n_unlabelled : clips without a category, which got a histogram only.
    categories : number of clips of each category.
    calibration : how well motions of unknown categories are told from known ones, learned by holding some out; None
        where there were too few clips or categories.
    single : categories with one clip: the forest has seen too little to tell them apart.
    seconds : time it took.
    n_partial : clips that lack joints which it asks about; forests of their own tell them apart.
    hidden : joints that it does not ask about, as most clips lack them.
    """

    feature_set: str
    n_trees: int
    n_clips: int
    n_unlabelled: int
    categories: dict[str, int]
    calibration: Calibration | None
    single: tuple[str, ...]
    seconds: float
    n_partial: int = 0
    hidden: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class ClipInfo(_Answer):
    """A clip or take of the library, without its arrays.

    Parameters
    ----------
    id : number of the clip; never given out twice.
    path : file it came from.
    category, performer : labels, None where there are none.
    predicted_category : of the forest, None before the training.
    format : short name of the file's format.
    n_frames : number of poses.
    frame_rate : Hz.
    duration : s.
    height : m, of the performer's skeleton.
    joint_table : where the canonical joints came from, such as ``"CMU/HDM05"``.
    warnings : doubts that came up when the file was read.
    kind : ``"clip"`` or ``"take"``.
    take_id : of a segment, the number of the take that it is a part of; else None.
    start_s, end_s : where it lies in that take.
    absent : canonical joints that the body lacks.
    tags : sorted names that people gave it.
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
    warnings: tuple[Message, ...]
    kind: str = "clip"
    take_id: int | None = None
    start_s: float | None = None
    end_s: float | None = None
    absent: tuple[str, ...] = ()
    tags: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class TakeSegment(_Answer):
    """A part of a take that was given a category: a clip of the library that has no file of its own.

    Parameters
    ----------
    clip_id : its number.
    start, end : s, from the beginning of the take.
    category : what happens there; None where its label was taken away.
    by_hand : whether somebody named it in the take, rather than a table of labels.
    """

    clip_id: int
    start: float
    end: float
    category: str | None
    by_hand: bool

    _names: ClassVar[dict[str, str]] = {"start": "start_s", "end": "end_s"}


@dataclass(frozen=True, slots=True)
class TakeAnnotation(_Answer):
    """What is written down of a take.

    Parameters
    ----------
    take_id, path, duration : its number, its file, and s.
    is_complete : whether it was labelled from beginning to end: then nothing that has a name happens in the rest.
    segments : in the order of time.
    unclear : (start, end) s of parts of which nobody can say what they are.
    source, tier : the table of labels that it came from, and the tier of it; empty if there is none.
    """

    take_id: int
    path: str
    duration: float
    is_complete: bool
    segments: tuple[TakeSegment, ...]
    unclear: tuple[tuple[float, float], ...]
    source: str
    tier: str

    _names: ClassVar[dict[str, str]] = {"duration": "duration_s"}

    @property
    def stretches(self) -> tuple[Stretch, ...]:
        """The take from beginning to end: its segments, and the rest."""
        named = [Stretch(one.start, one.end, one.category) for one in self.segments if one.category is not None]
        unnamed = [(one.start, one.end) for one in self.segments if one.category is None]
        return lay_out(named, [*self.unclear, *unnamed], self.duration, complete=self.is_complete)

    @property
    def rows(self) -> list[Stretch]:
        """What a table says of it: its segments, which may overlap, and the rest."""
        named = [Stretch(one.start, one.end, one.category) for one in self.segments if one.category is not None]
        rest = [one for one in self.stretches if one.category is None and one.stop - one.start >= _LEAST_REST]
        return sorted([*named, *rest], key=lambda one: (one.start, one.stop))


@dataclass(frozen=True, slots=True)
class LibraryStats(_Answer):
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


@dataclass(frozen=True, slots=True)
class Place(_Answer):
    """A part of a take that is like the query.

    Parameters
    ----------
    take : file of the take.
    clip_id : its number in the library, None for a file that is not there.
    start, end : s, from the beginning of the take.
    score : 0 to 1, the larger the more alike.
    distance : of the poses of both along the best alignment, root mean square in body heights.
    shared_leaves : share of the trees in which both end in the same leaf.
    tempo : how much faster than the query it goes on; 2 is double speed.
    mirrored : whether it is the mirror image of the query that it is like.
    rank : 1 for the best.
    alike : whether it is likelier than not that it shows what the query does; None where that was not learned.
    probability : of that, for a place that was found; None likewise.
    """

    take: str
    clip_id: int | None
    start: float
    end: float
    score: float
    distance: float
    shared_leaves: float
    tempo: float
    mirrored: bool
    rank: int
    alike: bool | None = None
    probability: float | None = None

    _names: ClassVar[dict[str, str]] = {"start": "start_s", "end": "end_s"}


@dataclass(frozen=True, slots=True)
class FindResult(_Answer):
    """The answer to a search inside takes.

    Parameters
    ----------
    query : name of the query.
    duration : s, of the query.
    n_takes, seconds : takes that were looked into, and their duration.
    results : the places most like the query, best first, no two of them the same.
    skipped : takes that could not be used, and why.
    notes : what came up when the query and takes that are not in the library were read, with their names; and what was
        not compared: joints that a body lacks, windows of many takes.
    alike_count : places among them that are alike, which come first; None where that was not learned.
    """

    query: str
    duration: float
    n_takes: int
    seconds: float
    results: tuple[Place, ...]
    skipped: tuple[Skipped, ...]
    notes: tuple[Message, ...] = ()
    alike_count: int | None = None

    _names: ClassVar[dict[str, str]] = {"duration": "duration_s", "seconds": "takes_s"}

    def to_json(self) -> dict[str, Any]:
        """The answer as plain lists and dictionaries; ``notes`` only where there are any."""
        answer = _Answer.to_json(self)
        if not self.notes:
            del answer["notes"]
        return answer


@dataclass(frozen=True, slots=True)
class LabelledTake:
    """What happens in a take, from beginning to end.

    Parameters
    ----------
    take : its file.
    clip_id : its number in the library, None for a file that is not there.
    timeline : its stretches, one after another without gaps, with their categories and how sure they are.
    notes : what came up when its file was read, and what was not looked at, where the body lacks joints.
    """

    take: str
    clip_id: int | None
    timeline: Timeline
    notes: tuple[Message, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """The timeline as plain lists and dictionaries; times in s."""
        return {"take": self.take, "clip_id": self.clip_id, **self.timeline.to_json(), **_notes_json(self.notes)}
