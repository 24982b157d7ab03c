"""Results of the library's methods: plain values without a database connection, each with ``to_json()``."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, ClassVar

from dousa.files.json_values import to_json_value
from dousa.formats.motion_files import Skipped as Skipped  # noqa: PLC0414 - a result of the library too
from dousa.messages import Message
from dousa.motion.annotation import Stretch, lay_out
from dousa.notebooks import Tabular, short_repr

if TYPE_CHECKING:
    from dousa.retrieval.explain.explanation import Explanation, Likeness
    from dousa.retrieval.forest.calibration import Calibration
    from dousa.retrieval.takes.label import Timeline

# Many motions equal their mirror image, which must thus be clearly better: log odds, distance ratio, score.
MIRROR_ODDS, MIRROR_DISTANCE, MIRROR_SCORE = 2.0, 0.95, 0.02


class Answer:
    """A plain value that can be written as JSON; ``_names`` renames keys, ``_if_any`` leaves empty ones out."""

    __slots__ = ()
    _names: ClassVar[dict[str, str]] = {}
    _if_any: ClassVar[tuple[str, ...]] = ()

    def to_json(self) -> dict[str, Any]:
        """Return plain lists and dictionaries, with messages in the current language."""
        values = {one.name: getattr(self, one.name) for one in fields(self)}  # type: ignore[arg-type]
        plain = {
            self._names.get(name, name): value for name, value in values.items() if value or name not in self._if_any
        }
        return {name: to_json_value(value, float) for name, value in plain.items()}


@dataclass(frozen=True, slots=True)
class Verdict(Answer):
    """What the forest predicts for a motion.

    Parameters
    ----------
    category : the category; None ("unknown") if the guess is more likely wrong than right, or the motion unfamiliar.
    guess : the likeliest category by votes and poses, even for an unknown motion.
    known : probability that the motion is of a category that the forest knows; None if the forest had too few
        categories to learn that.
    confidence : probability that the guess is right, if one motion in eleven is of no known category; None as above.
    histogram : share of the trees that vote for each category, the largest first.
    explanation : the reasons, if requested.
    perhaps : whether a motion without a category may still be what was guessed: it is less strange to the library than
        nearly all unnamed gestures.
    odds : log odds of the guess, but for a constant; to compare motions of one library.
    """

    category: str | None
    guess: str
    known: float | None
    confidence: float | None
    histogram: dict[str, float]
    explanation: Explanation | None = None
    perhaps: bool = False
    odds: float = 0.0

    _if_any: ClassVar[tuple[str, ...]] = ("explanation",)

    def fits_better_than(self, other: Verdict) -> bool:
        """Return whether the guess of this motion is clearly likelier than that of another, as of its mirror image."""
        return self.odds > other.odds + MIRROR_ODDS

    def to_json(self) -> dict[str, Any]:
        """Return plain lists and dictionaries; ``explanation`` only if there is one, and no ``odds``."""
        plain = {"category": None, "histogram": None, **Answer.to_json(self)}
        del plain["odds"]
        return plain


@dataclass(frozen=True, slots=True)
class Hit(Answer):
    """One clip found by a search.

    Parameters
    ----------
    path : file of the clip.
    category : its category; the predicted one if it has no label.
    distance : between the histograms of query and clip, eq. 8; 0 to sqrt(2).
    rank : 1 for the nearest.
    clip_id : number of the clip in the library.
    leaf_share : share of the trees in which query and clip end in the same leaf, 0 to 1.
    pose_distance : between the time-aligned poses, body heights; None if they were not compared.
    rank_distance : the value that results are ordered by; None if that is the poses and they were not compared.
    mirrored : whether the clip matches the mirror image of the query.
    likeness : the reasons for the similarity, if requested.
    hidden : canonical joints that were not compared because one of the bodies lacks them.
    alike : whether the clip counts as similar, as learned from the library; None if that was not learned.
    probability : that both mean the same, if clips of any meaning are equally likely; None as above.
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
    _if_any: ClassVar[tuple[str, ...]] = ("likeness", "hidden")
    alike: bool | None = None
    probability: float | None = None


@short_repr
@dataclass(frozen=True, slots=True)
class SearchResult(Tabular):
    """The result of a search.

    Parameters
    ----------
    query : name of the query.
    verdict : what the forest predicts for it.
    results : the most similar clips, the most similar first.
    ranking : what they are ordered by, one of ``dousa.retrieval.RANKINGS``.
    mirrored : prediction for the mirror image, if requested.
    notes : warnings from reading the query, and joints that were not compared.
    alike_count : number of similar clips in the library; they come first in ``results``, which may hold fewer or
        more. None if likeness was not learned: no training since, or too small a library.
    """

    _rows: ClassVar[str] = "results"
    _columns: ClassVar[str] = (
        "path category distance rank clip_id leaf_share pose_distance rank_distance mirrored alike probability"
    )

    query: str
    verdict: Verdict
    results: tuple[Hit, ...]
    ranking: str
    mirrored: Verdict | None = None
    notes: tuple[Message, ...] = ()
    alike_count: int | None = None

    @property
    def likenesses(self) -> tuple[float | None, ...]:
        """Likeness of the results, 1 to 0: exp(-``rank_distance``), and never more than of the one before."""
        found: list[float | None] = []
        most = 1.0
        for hit in self.results:
            most = most if hit.rank_distance is None else min(most, math.exp(-hit.rank_distance))
            found.append(None if hit.rank_distance is None else most)
        return tuple(found)

    @property
    def category(self) -> str | None:
        """The predicted category of the query, None if unknown."""
        return self.verdict.category

    @property
    def histogram(self) -> dict[str, float]:
        """Share of the trees that vote for each category, the largest first."""
        return self.verdict.histogram

    def to_json(self) -> dict[str, Any]:
        """Return plain lists and dictionaries."""
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
    verdict, mirrored : the prediction, None if the file cannot be used; that for the mirror image, if requested.
    problem : why the file cannot be used, None if it can.
    notes : warnings from reading the file, and joints that were ignored because the body lacks them.
    """

    path: str
    verdict: Verdict | None
    mirrored: Verdict | None = None
    problem: Message | None = None
    notes: tuple[Message, ...] = ()

    @property
    def category(self) -> str | None:
        """The category; None if it is unknown or the file cannot be used."""
        return None if self.verdict is None else self.verdict.category

    @property
    def histogram(self) -> dict[str, float]:
        """Share of the trees that vote for each category, the largest first; empty if the file cannot be used."""
        return {} if self.verdict is None else self.verdict.histogram

    def to_json(self) -> dict[str, Any]:
        """Return a plain dictionary; ``problem`` only if there is one."""
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
class Duplicate(Answer):
    """A file whose content is in the library under another path, ``same_as``."""

    path: str
    same_as: str


@short_repr
@dataclass(frozen=True, slots=True)
class AddReport(Answer):
    """The result of ``Library.add``.

    Parameters
    ----------
    added, unchanged : paths of the new clips, and of those in the library already.
    replaced : paths of stored clips whose file had changed.
    moved : new paths of stored files whose old path no longer exists.
    duplicates : files whose content is in the library under another path.
    skipped : files that could not be used.
    passed_over : (suffix, number) of files in the folders that no reader accepts.
    warnings : (path, message) of clips that were added with a warning.
    other_labels : stored paths whose category or performer differs from what the rules give now; their labels stay,
        ``Library.relabel`` changes them.
    other_kind : paths stored as clips but added as takes, or the reverse; they keep their kind.
    n_learned, new_categories : labelled clips that the leaves of the forest learned at once; their new categories.
    labelled, n_segments : takes whose labels are new or changed, and their number of segments, now clips.
    seconds, bytes : time it took, and size of the files that were read.
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
        """Return plain lists and dictionaries."""
        return {
            **Answer.to_json(self),
            "moved": [{"path": item.path, "from": item.same_as} for item in self.moved],
            "warnings": [{"path": path, "warning": str(text)} for path, text in self.warnings],
            "passed_over": dict(self.passed_over),
        }


@short_repr
@dataclass(frozen=True, slots=True)
class TrainReport(Answer):
    """The result of ``Library.train``.

    Parameters
    ----------
    feature_set, n_trees : name of the features used, and number of trees.
    n_clips, n_unlabelled : clips it was trained on, and clips without a category, which only get a histogram.
    categories : number of clips of each category.
    calibration : how well unknown categories are separated from known ones, learned by holding some out; None if there
        were too few clips or categories.
    single : categories with one clip, too few to separate them.
    seconds : time it took.
    n_partial : clips that lack joints it uses; separate forests handle them.
    hidden : joints it does not use because most clips lack them.
    doubt : a sign that the categories do not say what is done, as where folders are recording sessions.
    """

    feature_set: str
    n_trees: int
    n_clips: int
    n_unlabelled: int
    categories: dict[str, int]
    calibration: Calibration | None = field(repr=False)
    single: tuple[str, ...]
    seconds: float
    n_partial: int = 0
    hidden: tuple[str, ...] = ()
    doubt: Message | None = None


@dataclass(frozen=True, slots=True)
class ClipInfo(Answer):
    """A clip or take of the library, without its arrays.

    Parameters
    ----------
    id, path : number, never reused, and file.
    category, performer : labels, or None.
    predicted_category : of the forest, None before the training.
    format : short name of the file's format.
    n_frames, frame_rate, duration : poses, Hz, s.
    height : m, of the performer's skeleton.
    joint_table : source of the canonical joints, such as ``"CMU/HDM05"``.
    warnings : warnings from reading the file.
    kind : ``"clip"`` or ``"take"``.
    take_id, start_s, end_s : of a segment, the number of its take and its times in it; else None.
    absent : canonical joints that the body lacks.
    tags : sorted tags.
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
class TakeSegment(Answer):
    """A labelled part of a take: a clip of the library without a file of its own.

    Parameters
    ----------
    clip_id : its number.
    start, end : s, from the beginning of the take.
    category : its category; None if the label was removed.
    by_hand : whether it was named by hand rather than by a table of labels.
    """

    clip_id: int
    start: float
    end: float
    category: str | None
    by_hand: bool

    _names: ClassVar[dict[str, str]] = {"start": "start_s", "end": "end_s"}


@dataclass(frozen=True, slots=True)
class TakeAnnotation(Answer):
    """The labels of a take.

    Parameters
    ----------
    take_id, path, duration : its number, its file, and s.
    is_complete : whether it was labelled from beginning to end, so that the rest shows nothing that has a name.
    segments : in the order of time.
    unclear : (start, end) s of parts whose content is undecided.
    source, tier : its table of labels, and the tier of it; empty if there is none.
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
        """Return the take from beginning to end: its segments and the rest."""
        named = [Stretch(one.start, one.end, one.category) for one in self.segments if one.category is not None]
        unnamed = [(one.start, one.end) for one in self.segments if one.category is None]
        return lay_out(named, [*self.unclear, *unnamed], self.duration, complete=self.is_complete)

    @property
    def rows(self) -> list[Stretch]:
        """Return the rows of a label table: the segments, which may overlap, and the rest."""
        named = [Stretch(one.start, one.end, one.category) for one in self.segments if one.category is not None]
        rest = [one for one in self.stretches if _is_rest(one)]
        return sorted([*named, *rest], key=lambda one: (one.start, one.stop))


def _is_rest(stretch: Stretch, *, least: float = 0.002) -> bool:
    """Return whether a stretch has no category and lasts ``least`` s; shorter ones come from rounded times."""
    return stretch.category is None and stretch.stop - stretch.start >= least


@dataclass(frozen=True, slots=True)
class LibraryStats(Answer):
    """The library in numbers.

    Parameters
    ----------
    n_clips, n_frames, seconds : clips without takes, their poses, and their duration.
    n_takes, take_seconds : uncut recordings, and their duration.
    n_unlabelled : clips without a category.
    categories, performers : number of clips of each category, and of clips and takes of each performer.
    trained_at : when the forest was trained (ISO 8601, UTC), None if there is none.
    n_trained, n_learned : clips the forest was trained on, and those its leaves learned later.
    parameters : of the forest, with the name of its feature set.
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
class Place(Answer):
    """A part of a take that is similar to the query.

    Parameters
    ----------
    take : file of the take.
    clip_id : its number in the library, None for a file outside it.
    start, end : s, from the beginning of the take.
    score : 0 to 1, larger for more similar.
    distance : between the poses along the best alignment, root mean square in body heights.
    shared_leaves : share of the trees in which both end in the same leaf.
    tempo : speed relative to the query; 2 is double speed.
    mirrored : whether it matches the mirror image of the query.
    rank : 1 for the best.
    alike : whether it probably shows the query's motion; None if that was not learned.
    probability : that it does, for a place that was found; None as above.
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


@short_repr
@dataclass(frozen=True, slots=True)
class FindResult(Answer, Tabular):
    """The result of a search inside takes.

    Parameters
    ----------
    query : name of the query.
    duration : s, of the query.
    n_takes, seconds : takes searched, and their duration.
    results : the places most similar to the query, best first, without repeats.
    skipped : takes that could not be used, and why.
    notes : warnings from reading the query and takes outside the library, with their names; and omissions: joints that
        a body lacks, windows of many takes.
    alike_count : number of similar places, which come first; None if that was not learned.
    """

    _rows: ClassVar[str] = "results"
    _columns: ClassVar[str] = (
        "take clip_id start_s end_s score distance shared_leaves tempo mirrored rank alike probability"
    )

    query: str
    duration: float
    n_takes: int
    seconds: float
    results: tuple[Place, ...]
    skipped: tuple[Skipped, ...]
    notes: tuple[Message, ...] = ()
    alike_count: int | None = None

    _names: ClassVar[dict[str, str]] = {"duration": "duration_s", "seconds": "takes_s"}

    _if_any: ClassVar[tuple[str, ...]] = ("notes",)


@short_repr
@dataclass(frozen=True, slots=True)
class LabelledTake(Tabular):
    """The timeline of a take.

    Parameters
    ----------
    take : its file.
    clip_id : its number in the library, None for a file outside it.
    timeline : its stretches in order and without gaps, with categories and confidence.
    notes : warnings from reading the file, and joints that were ignored because the body lacks them.
    """

    _rows: ClassVar[str] = "segments"

    take: str
    clip_id: int | None
    timeline: Timeline
    notes: tuple[Message, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Return plain lists and dictionaries; times in s."""
        return {"take": self.take, "clip_id": self.clip_id, **self.timeline.to_json(), **_notes_json(self.notes)}
