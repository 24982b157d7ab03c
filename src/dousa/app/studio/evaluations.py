"""Evaluations that can be changed while somebody looks: the last ones stay ready in memory, all can be made again."""

from __future__ import annotations

import json
import threading
from collections import Counter, OrderedDict
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from dousa.app.studio.gates import Gate
from dousa.app.studio.motions import MotionRef, Seconds
from dousa.app.studio.problems import RefusedError

if TYPE_CHECKING:
    from dousa.app.studio.jobs.board import Job, JobBoard
    from dousa.app.studio.motions import Motions, Named
    from dousa.evaluation import AdjustableAssessment, Assessment, Furi

__all__ = [
    "Adjustment",
    "Cut",
    "EvaluationRequest",
    "Evaluations",
    "Language",
    "Ready",
    "describe",
    "format_weights",
    "make_ready",
]

Language = Literal["en", "ja"]
_Weight = Annotated[float, Field(ge=0, le=1000, allow_inf_nan=False)]
_Name = Annotated[str, Field(max_length=40)]

_MOST_READY, _MOST_BYTES = 6, 300_000_000  # evaluations in memory
_LONGEST_S = 600.0  # s of a motion
_MOST_WORK = 1.5e6  # s^2 of all pairs, since every take is compared with every other one: half a minute
_WAIT = 120.0  # s for others whose evaluation is made again
_SLACK_S = 0.1  # s that the last figure may end after the dance: people round
_ADJUSTED = "adjusted.json"

# The warnings speak of the options of the command line; here they have names on the page.
_OPTIONS = {
    "en": {"--mirror": "'Mirrored'", "--tempo free": "'Any tempo'"},
    "ja": {
        "--mirror を付けると": "「左右反転」を選ぶと",
        "--mirror を外すと": "「左右反転」を外すと",
        "--tempo free を付けると": "「テンポは自由」を選ぶと",
    },
}
_OTHER = 0.6  # of the performance
_OTHER_FIGURE = {
    "en": "{0:.0f} % of the performance is another figure than the reference: is it the same dance? Choose other "
    "motions, or a part",
    "ja": "演技の {0:.0f} % は手本とは別の振りです。同じ踊りでしょうか。別の動作か、その部分を選んでください。",
}


class Cut(BaseModel):
    """One figure of the dance."""

    model_config = ConfigDict(extra="forbid")

    start_s: Seconds = Field(description="s of the first reference")
    end_s: Seconds
    label: str = Field(min_length=1, max_length=100, description="equal figures have equal labels")


class Adjustment(BaseModel):
    """What a person may change of an evaluation."""

    model_config = ConfigDict(extra="forbid")

    weights: Annotated[dict[_Name, _Weight], Field(max_length=20)] = Field(
        default_factory=dict, description="of segments or limbs; 1 for those not named"
    )
    furi: Annotated[list[Cut], Field(min_length=1, max_length=400)] | None = Field(
        None, description="figures; those that are found if null"
    )


class EvaluationRequest(Adjustment):
    """A performance and the reference that it is held against."""

    references: Annotated[list[MotionRef], Field(min_length=1, max_length=50)]
    performance: MotionRef
    side: Literal["same", "mirrored"] = "same"
    tempo: Literal["same", "free"] = "same"
    language: Language = "en"


@dataclass(slots=True, eq=False)
class Ready:
    """An evaluation that answers quickly.

    Parameters
    ----------
    request : what was asked for.
    names : of the references, and of the performance.
    assessment : of these motions, to be asked with other figures and weights.
    lock : it answers one question at a time.
    last : the last answer, and to what.
    """

    request: EvaluationRequest
    names: tuple[str, ...]
    assessment: AdjustableAssessment
    lock: threading.Lock = field(default_factory=threading.Lock)
    last: tuple[str, Assessment] | None = None

    def assess(self, adjustment: Adjustment, language: Language) -> Assessment:
        """The assessment with these figures and weights.

        Raises
        ------
        RefusedError, OptionError : figures or weights that cannot be.
        """
        key = f"{language} {adjustment.model_dump_json(include={'weights', 'furi'})}"
        with self.lock:
            if self.last is None or self.last[0] != key:
                furi = self.to_furi(adjustment.furi)
                found = self.assessment.assess(furi, adjustment.weights, language)
                self.last = (key, _speak(found, language))
            return self.last[1]

    def preview(self, adjustment: Adjustment, language: Language) -> tuple[Assessment, bool]:
        """The same quickly, and whether it is exactly the same; see `dousa.evaluation.AdjustableAssessment`."""
        with self.lock:
            furi = self.to_furi(adjustment.furi)
            found, is_exact = self.assessment.preview(furi, adjustment.weights, language)
        return _speak(found, language), is_exact

    def to_furi(self, cuts: Sequence[Cut] | None) -> list[Furi] | None:
        """Figures in frames of the first reference.

        Raises
        ------
        RefusedError : a figure without length, beyond the reference, over another one, or with a label that a file
            cannot hold.
        """
        from dousa.evaluation import Furi
        from dousa.evaluation.furi_file import can_hold

        if cuts is None:
            return None
        rate, n_frames = self.assessment.frame_rate, self.assessment.n_frames
        end_s = n_frames / rate
        found: list[Furi] = []
        for number, cut in enumerate(sorted(cuts, key=lambda one: one.start_s), start=1):
            where = f"furi {number} ({cut.start_s:g} to {cut.end_s:g} s)"
            start, end = round(cut.start_s * rate), min(round(cut.end_s * rate), n_frames)
            if cut.end_s > end_s + _SLACK_S:
                raise RefusedError(422, f"{where}: the reference ends at {end_s:.2f} s; cut within it")
            if start >= end:
                raise RefusedError(422, f"{where}: expected an end after the start, by a frame at least")
            if found and start < found[-1].end:
                raise RefusedError(
                    422, f"{where}: begins before the one before it ends; figures must not overlap"
                )
            if not can_hold(cut.label):
                raise RefusedError(422, f"{where}: the label {cut.label[:40]!r} is none; choose plain words")
            found.append(Furi(start, end, cut.label))
        return found

    def to_cuts(self) -> list[dict[str, Any]]:
        """The figures that are found in the reference, as `Cut`."""
        rate = self.assessment.frame_rate
        return [
            {"start_s": round(one.start / rate, 4), "end_s": round(one.end / rate, 4), "label": one.label}
            for one in self.assessment.found
        ]


class Evaluations:
    """The evaluations that were looked at last.

    Parameters
    ----------
    motions : finds what is compared.
    board : the jobs that asked for evaluations.
    """

    def __init__(self, motions: Motions, board: JobBoard) -> None:
        self._motions, self._board = motions, board
        self._lock = threading.Lock()
        self._gate = Gate(2, 8, "other evaluations are being made again; try again in a moment")
        self._making: dict[str, threading.Lock] = {}
        self._ready: OrderedDict[str, Ready] = OrderedDict()

    def put(self, job_id: str, ready: Ready) -> None:
        """Keep an evaluation; others that were not looked at for long go."""
        with self._lock:
            self._ready[job_id] = ready
            self._ready.move_to_end(job_id)
            while len(self._ready) > 1 and (len(self._ready) > _MOST_READY or self.n_bytes > _MOST_BYTES):
                self._ready.popitem(last=False)

    @property
    def n_bytes(self) -> int:
        """About how much memory is kept."""
        return sum(one.assessment.n_bytes for one in list(self._ready.values()))

    def get(self, job_id: str) -> Ready:
        """An evaluation; made again if it is not in memory any more.

        Raises
        ------
        RefusedError : no such evaluation, or it is not done; a motion of it is gone.
        """
        job = self._done(job_id)
        ready = self._ready.get(job_id) or self._make_again(job)
        self.put(job_id, ready)
        return ready

    def _make_again(self, job: Job) -> Ready:
        with self._gate.enter(_WAIT):
            with self._lock:
                making = self._making.setdefault(job.id, threading.Lock())
            with making:
                ready = self._ready.get(job.id)
                if ready is None:
                    ready = make_ready(EvaluationRequest.model_validate(job.request), self._motions.get)
                    self.put(job.id, ready)
            with self._lock:
                self._making.pop(job.id, None)
        return ready

    def read_adjustment(self, job_id: str) -> Adjustment:
        """What somebody changed of an evaluation; else what was asked for."""
        job = self._done(job_id)
        with suppress(OSError, ValueError):
            return Adjustment.model_validate_json((self._board.folder(job) / _ADJUSTED).read_bytes())
        asked = EvaluationRequest.model_validate(job.request)
        return Adjustment(weights=asked.weights, furi=asked.furi)

    def write_adjustment(self, job_id: str, adjustment: Adjustment) -> None:
        """Keep what somebody changed, for every page that shows the evaluation, and for the files of it."""
        from dousa._files import atomic_write

        with atomic_write(self._board.folder(self._done(job_id)) / _ADJUSTED) as file:
            file.write(json.dumps(adjustment.model_dump(include={"weights", "furi"})).encode())

    def _done(self, job_id: str) -> Job:
        job = self._board.get(job_id)
        if job.kind != "evaluate":
            raise RefusedError(404, f"job {job_id} is no evaluation; see GET /api/jobs?kind=evaluate")
        if job.state != "done":
            raise RefusedError(409, f"the evaluation is {job.state}; wait for it, or ask for it again")
        return job


def make_ready(
    request: EvaluationRequest,
    find: Callable[[MotionRef], Named],
    progress: Callable[[int, int, str], None] = lambda done, total, what: None,
) -> Ready:
    """Read the motions of an evaluation.

    Parameters
    ----------
    request : which.
    find : gives a motion.
    progress : called with (steps done, steps, what).

    Raises
    ------
    RefusedError : a motion that cannot be used; the sentence names it.
    """
    from dousa.errors import InvalidMotionError
    from dousa.evaluation import AdjustableAssessment

    refs = [*request.references, request.performance]
    named = []
    for number, ref in enumerate(refs):
        progress(number, len(refs) + 1, "reading")
        named.append(_check(find(ref)))
    _check_work([one.motion.duration for one in named])
    progress(len(refs), len(refs) + 1, "comparing")
    names = _tell_apart(named)
    *takes, performance = (one.motion for one in named)
    try:
        ready = AdjustableAssessment(takes, performance, side=request.side, tempo=request.tempo, names=names)
    except InvalidMotionError as error:
        # It says "reference: ..." or "performance: ..."; the person wants the name.
        shortest = min(range(len(takes)), key=lambda number: takes[number].duration)
        name = names[shortest] if str(error).startswith("reference") else names[-1]
        raise RefusedError(422, f"{name}: {error}") from error
    return Ready(request, names, ready)


def _tell_apart(named: Sequence[Named]) -> tuple[str, ...]:
    """Names of the motions; those that several have, with their categories."""
    count = Counter(one.name for one in named)
    return tuple(
        f"{one.category}/{one.name}" if count[one.name] > 1 and one.category else one.name for one in named
    )


def _check(named: Named) -> Named:
    if named.motion.duration > _LONGEST_S:
        raise RefusedError(
            422,
            f"{named.name}: expected at most {_LONGEST_S / 60:g} minutes, got {named.motion.duration / 60:.1f}; "
            "choose a part of it",
        )
    return named


def _check_work(durations: Sequence[float]) -> None:
    """A comparison cannot be stopped in the middle, so it must not take for ever."""
    total, squares = sum(durations), sum(one * one for one in durations)
    if (total * total - squares) / 2 > _MOST_WORK:
        raise RefusedError(
            422,
            f"{len(durations)} motions of {total / 60:.0f} minutes together are too much to compare each with each; "
            "choose fewer takes, or parts of them",
        )


def describe(ready: Ready, assessment: Assessment, adjustment: Adjustment) -> dict[str, Any]:
    """An assessment as JSON, with the names of the motions, the figures and weights, and what was found by itself."""
    request, take = ready.request, ready.assessment
    found = ready.to_cuts()
    furi = found if adjustment.furi is None else [cut.model_dump() for cut in adjustment.furi]
    return {
        **assessment.to_json(),
        "names": {"references": list(ready.names[:-1]), "performance": ready.names[-1]},
        "motions": {
            "references": [ref.model_dump(exclude_none=True) for ref in request.references],
            "performance": request.performance.model_dump(exclude_none=True),
        },
        "options": {"side": request.side, "tempo": request.tempo},
        "reference_duration_s": round(take.n_frames / take.frame_rate, 4),
        "furi_used": furi,
        "furi_found": found,
        "weights": dict(adjustment.weights),
    }


def _speak(assessment: Assessment, language: str) -> Assessment:
    """With warnings that name what the page has, and one more where motions were mixed up."""

    def say(text: str) -> str:
        for option, name in _OPTIONS[language].items():
            text = text.replace(option, name)
        return text

    warnings = [say(text) for text in assessment.warnings]
    other_s = sum(event.end_s - event.start_s for event in assessment.events if event.kind == "global")
    share = other_s / max(assessment.performance.duration, 1e-9)
    if share > _OTHER:
        warnings.insert(0, _OTHER_FIGURE[language].format(min(100 * share, 100)))
    return replace(assessment, warnings=tuple(warnings))


def format_weights(weights: Mapping[str, float]) -> str:
    """The text of a file for ``dousa evaluate --weights``."""
    lines = [f"{name} = {value:g}" for name, value in weights.items()]
    return "\n".join(["# weights of segments and limbs; what is not named weighs 1", *lines]) + "\n"
