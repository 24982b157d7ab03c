"""Keep evaluations that users adjust while they look at them: the last ones in memory, the others are made again."""

from __future__ import annotations

import hashlib
import json
import threading
from collections import Counter, OrderedDict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Field

from dousa.app.pipelines.evaluate import find_blamed
from dousa.app.requests import evaluation
from dousa.app.requests.models import derive_model
from dousa.app.studio.content.motions import MotionRef, Motions, Named, Seconds
from dousa.app.studio.core.answers import Gate, RefusedError, StrictModel, reword
from dousa.app.studio.core.workspace import write_file
from dousa.errors import InvalidMotionError
from dousa.messages import LANGUAGES, Message, get_language

if TYPE_CHECKING:
    from dousa.app.studio.jobs.board import Job, JobBoard
    from dousa.evaluation import AdjustableAssessment, Assessment, Furi, Progress
    from dousa.motion import CanonicalMotion

Language = Literal["en", "ja"]
_Weight = Annotated[float, Field(ge=0, le=1000, allow_inf_nan=False)]
_Name = Annotated[str, Field(max_length=40)]

_MOST_READY, _MOST_BYTES = 6, 300_000_000  # evaluations in memory
_ADJUSTED, _NOTES = "adjusted.json", "notes.txt"


class Cut(StrictModel):
    """One figure of the dance."""

    start_s: Seconds = Field(description="s of the first reference")
    end_s: Seconds
    label: str = Field(min_length=1, max_length=100, description="equal figures have equal labels")


class Adjustment(StrictModel):
    """What a user may change of an evaluation."""

    weights: Annotated[dict[_Name, _Weight], Field(max_length=20)] = Field(
        default_factory=dict, description="of segments or limbs; 1 for those not named"
    )
    furi: Annotated[list[Cut], Field(min_length=1, max_length=400)] | None = Field(
        None, description="figures; those that are found if null"
    )


_ADJUSTABLE = set(Adjustment.model_fields)


class EvaluationRequest(Adjustment, derive_model(evaluation.EvaluationRequest, ("tempo", "repetitions"))):  # type: ignore[misc]
    """A performance and the references with which it is compared."""

    references: Annotated[list[MotionRef], Field(min_length=1, max_length=50)]
    performance: MotionRef
    side: Literal["auto", "same", "mirrored"] = "auto"
    language: Language = "en"

    @classmethod
    def read(cls, job: Job) -> EvaluationRequest:
        """The request of a job, without fields that an earlier version had."""
        return cls.model_validate({name: one for name, one in job.request.items() if name in cls.model_fields})

    @property
    def pace(self) -> str:
        """See `dousa.app.requests.evaluation.choose_tempo`."""
        return evaluation.choose_tempo(self.tempo, repetitions=self.repetitions)


@dataclass(slots=True, eq=False)
class Ready:
    """An evaluation in memory.

    Parameters
    ----------
    request : of the job.
    names : of the references, and of the performance.
    assessment : of these motions, to be computed with other figures and weights.
    lock : allows one computation at a time.
    last : the last result with its adjustment.
    """

    request: EvaluationRequest
    names: tuple[str, ...]
    assessment: AdjustableAssessment
    lock: threading.Lock = field(default_factory=threading.Lock)
    last: tuple[str, Assessment] | None = None

    def assess(self, adjustment: Adjustment) -> Assessment:
        """Assess with other figures and weights; RefusedError or OptionError if they are not possible."""
        key = adjustment.model_dump_json(include=_ADJUSTABLE)
        with self.lock:
            if self.last is None or self.last[0] != key:
                furi = self.to_furi(adjustment.furi)
                found = self.assessment.assess(furi, adjustment.weights)
                self.last = (key, _add_page_warnings(found))
            return self.last[1]

    def preview(self, adjustment: Adjustment) -> tuple[Assessment, bool]:
        """Assess quickly, and tell whether the result is exact; see `dousa.evaluation.AdjustableAssessment`."""
        with self.lock:
            furi = self.to_furi(adjustment.furi)
            found, is_exact = self.assessment.preview(furi, adjustment.weights)
        return _add_page_warnings(found), is_exact

    def to_furi(self, cuts: Sequence[Cut] | None) -> list[Furi] | None:
        """Convert figures to frames of the first reference.

        Raises RefusedError for figures that are empty, beyond the reference or overlapping, and for labels that a file
        cannot hold.
        """
        from dousa.evaluation import Furi
        from dousa.evaluation.figures.furi import can_hold

        if cuts is None:
            return None
        rate, n_frames = self.assessment.frame_rate, self.assessment.n_frames
        end_s = n_frames / rate
        found: list[Furi] = []
        for number, cut in enumerate(sorted(cuts, key=lambda one: one.start_s), start=1):
            where = {"number": number, "start": cut.start_s, "end": cut.end_s}
            start, end = round(cut.start_s * rate), min(round(cut.end_s * rate), n_frames)
            if cut.end_s > end_s + 0.1:  # s that the last figure may end after the dance: people round
                raise RefusedError(422, "studio_evaluation.cut_beyond", **where, length=end_s)
            if start >= end:
                raise RefusedError(422, "studio_evaluation.cut_empty", **where)
            if found and start < found[-1].end:
                raise RefusedError(422, "studio_evaluation.cuts_overlap", **where)
            if not can_hold(cut.label):
                raise RefusedError(422, "studio_evaluation.cut_label", **where, label=cut.label[:40])
            found.append(Furi(start, end, cut.label))
        return found

    def to_cuts(self) -> list[dict[str, Any]]:
        """Convert the figures found in the reference to the fields of `Cut`."""
        rate = self.assessment.frame_rate
        return [
            {"start_s": round(one.start / rate, 4), "end_s": round(one.end / rate, 4), "label": one.label}
            for one in self.assessment.found
        ]


class Evaluations:
    """The evaluations that were looked at last."""

    def __init__(self, motions: Motions, board: JobBoard) -> None:
        self._motions, self._board = motions, board
        self._lock = threading.Lock()
        self._gate = Gate(2, 8, Message("studio_evaluation.busy"), patience_s=120.0)  # an evaluation is made again
        self._making: dict[str, threading.Lock] = {}
        self._ready: OrderedDict[str, Ready] = OrderedDict()

    def put(self, job_id: str, ready: Ready) -> None:
        """Keep an evaluation in memory; those not looked at for longest are dropped."""
        with self._lock:
            self._ready[job_id] = ready
            self._ready.move_to_end(job_id)
            while len(self._ready) > 1 and (len(self._ready) > _MOST_READY or self.n_bytes > _MOST_BYTES):
                self._ready.popitem(last=False)

    @property
    def n_bytes(self) -> int:
        """Memory of the evaluations, about, in bytes."""
        return sum(one.assessment.n_bytes for one in list(self._ready.values()))

    def get(self, job_id: str) -> Ready:
        """Return an evaluation, made again if it is not in memory; RefusedError if it or a motion is missing."""
        job = self._done(job_id)
        ready = self._ready.get(job_id) or self._make_again(job)
        self.put(job_id, ready)
        return ready

    def _make_again(self, job: Job) -> Ready:
        with self._gate.enter():
            with self._lock:
                making = self._making.setdefault(job.id, threading.Lock())
            with making:
                ready = self._ready.get(job.id)
                if ready is None:
                    ready = make_ready(EvaluationRequest.read(job), self._motions.get)
                    self.put(job.id, ready)
            with self._lock:
                self._making.pop(job.id, None)
        return ready

    def read_adjustment(self, job_id: str) -> Adjustment:
        """Return the stored adjustment of an evaluation; by default that of its request."""
        job = self._done(job_id)
        with suppress(OSError, ValueError):
            kept: Adjustment = Adjustment.model_validate_json((self._board.folder(job) / _ADJUSTED).read_bytes())
            return kept
        asked = EvaluationRequest.read(job)
        return Adjustment(weights=asked.weights, furi=asked.furi)

    def write_adjustment(self, job_id: str, adjustment: Adjustment) -> None:
        """Store an adjustment for all pages and files of the evaluation."""
        write_file(
            self._board.folder(self._done(job_id)) / _ADJUSTED,
            json.dumps(adjustment.model_dump(include=_ADJUSTABLE)).encode(),
        )

    def read_notes(self, job_id: str) -> str:
        """Return the notes on the performance; empty by default."""
        folder = self._board.folder(self._done(job_id))
        with suppress(OSError):
            return (folder / _NOTES).read_bytes().decode("utf-8", "replace")
        return ""

    def write_notes(self, job_id: str, notes: str) -> None:
        """Store the notes on the performance for all pages and the report."""
        write_file(self._board.folder(self._done(job_id)) / _NOTES, notes.encode("utf-8", "replace"))

    def compare_with_earlier(self, job_id: str) -> Progress | None:
        """Compare an evaluation with earlier ones of the same reference, as they were requested; None for the first."""
        job = self._done(job_id)
        model = _describe_model(job)
        earlier = [
            one
            for one in self._board.all()
            if one.kind == job.kind and one.state == "done" and one.result and _describe_model(one) == model
        ]
        until = [one for one in earlier if one.created_s <= job.created_s][:30]  # that are drawn
        if len(until) < 2:
            return None
        return _compare(until[::-1])

    def compare(self, job_ids: Sequence[str]) -> Progress:
        """Compare evaluations of one reference in the given order, as they were requested.

        Raises RefusedError for fewer than two, for exercises, and for several references.
        """
        jobs = [self._done(job_id) for job_id in job_ids]
        if len(jobs) < 2 or len(set(job_ids)) < len(jobs):
            raise RefusedError(422, "studio_evaluation.too_few")
        if any(_describe_model(job) != _describe_model(jobs[0]) for job in jobs):
            raise RefusedError(422, "studio_evaluation.other_references")
        return _compare(jobs)

    def draw_progress(self, job_id: str) -> bytes | None:
        """Draw `compare_with_earlier` as SVG in the current language."""
        found = self.compare_with_earlier(job_id)
        return None if found is None else self._draw(found, job_id, "progress")

    def draw_comparison(self, job_ids: Sequence[str]) -> bytes:
        """Draw `compare` as SVG in the current language."""
        return self._draw(self.compare(job_ids), job_ids[-1], "comparison")

    def _draw(self, found: Progress, job_id: str, name: str) -> bytes:
        from dousa.app.pictures.charts import draw_progress

        path = self._board.folder(self._done(job_id)) / f"{name}-{get_language()}.svg"
        draw_progress(found, path)
        return path.read_bytes()

    def list_done(self) -> list[dict[str, Any]]:
        """List finished evaluations, the newest first: number, name, Unix time, and whether of an exercise."""
        return [
            {
                "id": job.id,
                "name": str(job.result["names"]["performance"]),
                "created_s": job.created_s,
                "repetitions": bool(job.request.get("repetitions")),
            }
            for job in self._board.all()
            if job.kind == "evaluate" and job.state == "done" and job.result
        ]

    def list_comparable(self) -> list[dict[str, Any]]:
        """List the same without exercises, with names of references, grade, and a key that comparable ones share."""
        found = []
        for one in self.list_done():
            job = self._board.get(one["id"])
            if one["repetitions"] or not job.result:
                continue
            model = hashlib.sha256(json.dumps(_describe_model(job)).encode()).hexdigest()[:12]
            names = [str(name) for name in job.result["names"]["references"]]
            found.append({**one, "references": names, "score": job.result.get("score"), "model": model})
        return found

    def name_performance(self, job_id: str) -> str:
        """Return the name of the performance."""
        result = self.find_job(job_id).result or {}
        return str(result["names"]["performance"])

    def read_exercise(self, job_id: str, name: str) -> bytes:
        """Read a file of the evaluation of an exercise; RefusedError for other evaluations."""
        job = self.find_job(job_id)
        if not job.request.get("repetitions"):
            raise RefusedError(404, "studio_evaluation.no_exercise")
        return (self._board.folder(job) / name).read_bytes()

    def _done(self, job_id: str) -> Job:
        job = self.find_job(job_id)
        if job.request.get("repetitions"):
            raise RefusedError(404, "studio_evaluation.exercise")
        return job

    def find_job(self, job_id: str) -> Job:
        """Return the job of a finished evaluation or exercise; RefusedError if there is none."""
        job = self._board.get(job_id)
        if job.kind != "evaluate":
            raise RefusedError(404, "studio_evaluation.not_one", job=job_id)
        if job.state != "done":
            raise RefusedError(409, "studio_evaluation.not_done")
        return job


def _compare(jobs: Sequence[Job]) -> Progress:
    from dousa.evaluation import compare_attempts, read_attempt

    results = [job.result or {} for job in jobs]
    return compare_attempts([read_attempt(one, one["names"]["performance"]) for one in results])


def _describe_model(job: Job) -> Any:
    """Return what comparable evaluations share; files that were uploaded again have other addresses."""
    result = job.result or {}
    return [result.get("names", {}).get("references"), result.get("reference_duration_s"), result.get("options")]


def make_ready(
    request: EvaluationRequest,
    find: Callable[[MotionRef], Named],
    progress: Callable[[int, int, Message], None] = lambda done, total, what: None,
) -> Ready:
    """Read and compare the motions of an evaluation.

    Raises RefusedError for a motion that cannot be used, with its name.

    Parameters
    ----------
    request : of the job.
    find : returns a motion.
    progress : called with (steps done, steps, what).
    """
    from dousa.evaluation import AdjustableAssessment

    names, takes, performance = read_motions(request, find, progress)
    with _naming(names, takes):
        ready = AdjustableAssessment(takes, performance, side=request.side, tempo=request.pace, names=names)
    return Ready(request, names, ready)


def read_motions(
    request: EvaluationRequest,
    find: Callable[[MotionRef], Named],
    progress: Callable[[int, int, Message], None],
) -> tuple[tuple[str, ...], list[CanonicalMotion], CanonicalMotion]:
    """Return the names of all motions, the takes of the reference, and the performance; errors as `make_ready`."""
    refs = [*request.references, request.performance]
    named = []
    for number, ref in enumerate(refs):
        progress(number, len(refs) + 1, Message("studio_evaluation.reading"))
        named.append(_check(find(ref)))
    _check_work([one.motion.duration for one in named])
    progress(len(refs), len(refs) + 1, Message("studio_evaluation.comparing"))
    names = _tell_apart(named)
    *takes, performance = (one.motion for one in named)
    return names, takes, performance


@contextmanager
def _naming(names: Sequence[str], takes: Sequence[CanonicalMotion]) -> Iterator[None]:
    """Add the name of the motion to errors about it."""
    try:
        yield
    except InvalidMotionError as error:
        name = names[find_blamed(error, takes)]
        raise RefusedError(422, Message("text.in_file", path=name, problem=error.message)) from error


def assess_exercise(
    request: EvaluationRequest,
    find: Callable[[MotionRef], Named],
    folder: Path,
    progress: Callable[[int, int, Message], None] = lambda done, total, what: None,
) -> dict[str, Any]:
    """Assess the repetitions of an exercise, and write its reports and table into the folder of the job.

    Returns the JSON of ``dousa evaluate --repetitions --json`` with the names of the motions. Raises RefusedError as
    `make_ready`, and if the performance has no repetition.
    """
    from dousa.app.report.exercise import build_exercise, build_exercise_page, to_repetitions_csv
    from dousa.evaluation import assess_repetitions
    from dousa.evaluation.exercises.summary import to_answer

    names, takes, performance = read_motions(request, find, progress)
    with _naming(names, takes):
        done = assess_repetitions(
            takes,
            performance,
            side=request.side,
            tempo=request.pace,
            weights=request.weights,
        )
    files = {"repetitions.csv": to_repetitions_csv(done)}
    for language in LANGUAGES:
        page = build_exercise_page(done, performance, language, names[-1])
        files[f"exercise-{language}.html"] = page.encode("utf-8", "replace")
        files[f"exercise-{language}.json"] = json.dumps(build_exercise(done, performance, language, names[-1])).encode()
    for name, content in files.items():
        write_file(folder / name, content)
    return {
        **to_answer(done, request.language),
        "names": {"references": list(names[:-1]), "performance": names[-1]},
        "options": {"side": done.side, "tempo": request.pace, "repetitions": True},
    }


def _tell_apart(named: Sequence[Named]) -> tuple[str, ...]:
    """Name the motions; add the category to names that several have."""
    count = Counter(one.name for one in named)
    return tuple(f"{one.category}/{one.name}" if count[one.name] > 1 and one.category else one.name for one in named)


def _check(named: Named, *, longest_s: float = 600.0) -> Named:
    # longest_s: of a motion
    if named.motion.duration > longest_s:
        raise RefusedError(
            422,
            "studio_evaluation.too_long",
            name=named.name,
            most=longest_s / 60,
            minutes=named.motion.duration / 60,
        )
    return named


def _check_work(durations: Sequence[float]) -> None:
    """Limit the work, as a comparison cannot be stopped."""
    total, squares = sum(durations), sum(one * one for one in durations)
    # s^2 of all pairs, since every take is compared with every other one: half a minute
    if (total * total - squares) / 2 > 1.5e6:
        raise RefusedError(422, "studio_evaluation.too_much", count=len(durations), minutes=total / 60)


def describe(ready: Ready, assessment: Assessment, adjustment: Adjustment, language: str) -> dict[str, Any]:
    """Return an assessment as JSON with names of motions, the figures and weights used, and the figures found."""
    from dousa.evaluation import advise, describe_advice

    request, take = ready.request, ready.assessment
    found = ready.to_cuts()
    furi = found if adjustment.furi is None else [cut.model_dump() for cut in adjustment.furi]
    return {
        **assessment.to_json(language),
        "advice": describe_advice(advise(assessment, "full"), language),
        "names": {"references": list(ready.names[:-1]), "performance": ready.names[-1]},
        "motions": {
            "references": [ref.model_dump(exclude_none=True) for ref in request.references],
            "performance": request.performance.model_dump(exclude_none=True),
        },
        "options": {"side": assessment.side, "tempo": request.pace},
        "reference_duration_s": round(take.n_frames / take.frame_rate, 4),
        "furi_used": furi,
        "furi_found": found,
        "weights": dict(adjustment.weights),
    }


def _add_page_warnings(assessment: Assessment) -> Assessment:
    """Reword warnings for the page, and warn if most of the performance differs from the reference."""
    warnings = [reword(warning) for warning in assessment.warnings]
    other_s = sum(event.end_s - event.start_s for event in assessment.events if event.kind == "global")
    share = other_s / max(assessment.performance.duration, 1e-9)
    if share > 0.6:  # of the performance
        warnings.insert(0, Message("studio_evaluation.other_figure", share=min(share, 1.0)))
    return replace(assessment, warnings=tuple(warnings))


def format_weights(weights: Mapping[str, float]) -> str:
    """Format weights for ``dousa evaluate --weights``."""
    lines = [f"{name} = {value:g}" for name, value in weights.items()]
    return "\n".join(["# weights of segments and limbs; what is not named weighs 1", *lines]) + "\n"
