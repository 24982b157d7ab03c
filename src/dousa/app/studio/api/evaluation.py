"""Judging a performance."""

from __future__ import annotations

import mimetypes
from contextlib import suppress
from typing import Annotated, Any, Literal
from urllib.parse import quote

from fastapi import APIRouter, Query
from pydantic import Field
from starlette.responses import FileResponse, Response

from dousa.app.studio.content.companions import Companion, Kind
from dousa.app.studio.content.evaluations import Adjustment, EvaluationRequest, Language, describe, format_weights
from dousa.app.studio.content.studio import Studio, StudioNow
from dousa.app.studio.core.answers import FILE, Answer, RefusedError, StrictModel, give_files, say
from dousa.app.studio.jobs.board import Job
from dousa.errors import DousaError, InvalidMotionError, OptionError
from dousa.messages import use_language

router = APIRouter(tags=["evaluation"])

_SVG = give_files("image/svg+xml", form=None)


class AdjustRequest(Adjustment):
    """Other figures and weights."""

    language: Language = "en"
    precision: Literal["quick", "exact"] = Field(
        "exact",
        description="quick: while something is being dragged; with new weights the bodies stay laid beside each other "
        "as they were, and nothing is kept. exact: as `dousa evaluate`, and kept for the files and other pages",
    )


_Language = Annotated[Language, Query(description="of the words")]


@router.post("/jobs/evaluate", status_code=202, summary="Judge a performance against takes of a reference")
def evaluate(studio: StudioNow, wanted: EvaluationRequest) -> Answer:
    """A job; its result is that of `dousa evaluate --json` with names, figures and weights."""
    for ref in (*wanted.references, wanted.performance):
        if ref.address.batch:
            studio.workspace.keep(ref.address.batch)
        studio.motions.path(ref)  # is it there?
    title = studio.motions.path(wanted.performance).name
    return Answer(studio.jobs.submit("evaluate", wanted.model_dump(), title).to_json(), 202)


@router.get("/evaluations/{job_id}/report", summary="The parts of the report")
def get_report(studio: StudioNow, job_id: str, language: _Language = "en") -> Answer:
    """Assessment, the parts of the report as markup, the frame around them, and what its scripts need."""
    ready = studio.evaluations.get(job_id)
    adjustment = studio.evaluations.read_adjustment(job_id)
    said = describe(ready, ready.assess(adjustment), adjustment, language)
    return Answer({"exact": True, "assessment": said, **collect_report(studio, job_id, language)})


def collect_report(studio: Studio, job_id: str, language: Language) -> dict[str, Any]:
    """What shows the report of an evaluation: its frame, its parts, notes, and what scripts and player need.

    Raises
    ------
    RefusedError : no such evaluation, or one of an exercise.
    """
    from dousa.app.report.page import build_frame

    assessment = studio.evaluations.get(job_id).assess(studio.evaluations.read_adjustment(job_id))
    notes = studio.evaluations.read_notes(job_id)
    return {"frame": build_frame(language), "notes": notes, **_show(assessment, language)}


class NotesRequest(StrictModel):
    """Notes on a performance."""

    notes: str = Field(max_length=20_000)


@router.put("/evaluations/{job_id}/notes", summary="Write notes on the performance")
def put_notes(studio: StudioNow, job_id: str, wanted: NotesRequest) -> Answer:
    """Kept with the evaluation; stands in its report."""
    studio.evaluations.write_notes(job_id, wanted.notes)
    return Answer({"notes": wanted.notes})


@router.get("/evaluations/{job_id}/exercise", summary="The report of an exercise")
def get_exercise(studio: StudioNow, job_id: str, language: _Language = "en") -> Response:
    """Of a job with ``repetitions``: the report as markup, what its script needs, and what the player needs."""
    content = studio.evaluations.read_exercise(job_id, f"exercise-{language}.json")
    return Response(content, media_type="application/json")


@router.post("/evaluations/{job_id}/adjust", summary="Change the figures and weights of an evaluation")
def adjust(studio: StudioNow, job_id: str, wanted: AdjustRequest) -> Answer:
    """The new assessment and the parts of the report that follow; a quick answer leaves out those with figures."""
    from dousa.app.report.page import QUICK_PARTS, build_parts, collect_data

    ready, language = studio.evaluations.get(job_id), wanted.language
    if wanted.precision == "exact":
        assessment = ready.assess(wanted)
        studio.evaluations.write_adjustment(job_id, wanted)
        said = describe(ready, assessment, wanted, language)
        return Answer({"exact": True, "assessment": said, **_show(assessment, language)})
    assessment, is_exact = ready.preview(wanted)
    return Answer(
        {
            "exact": is_exact,
            "assessment": describe(ready, assessment, wanted, language),
            "parts": build_parts(assessment, language, QUICK_PARTS),
            "data": collect_data(assessment, language),
        }
    )


@router.get("/evaluations/{job_id}/progress", summary="A pupil over time: this evaluation and those before it")
def get_progress(studio: StudioNow, job_id: str, language: _Language = "en") -> Answer:
    """As `dousa progress --json`: the evaluations against the same reference, the oldest first; null for the first."""
    found = studio.evaluations.compare_with_earlier(job_id)
    return Answer({"progress": None if found is None else found.to_json(language)})


@router.get("/evaluations/{job_id}/progress.svg", summary="The same as a picture", **_SVG)
def draw_progress(studio: StudioNow, job_id: str, language: _Language = "en") -> Response:
    """An SVG."""
    use_language(language)
    drawn = studio.evaluations.draw_progress(job_id)
    if drawn is None:
        raise RefusedError(404, "studio_evaluation.first")
    return Response(drawn, media_type="image/svg+xml")


@router.get("/comparisons/choices", summary="Evaluations that can be compared")
def list_choices(studio: StudioNow) -> Answer:
    """``evaluations``, the last first; those with the same ``model`` are against the same reference."""
    return Answer({"evaluations": studio.evaluations.list_comparable()})


_Jobs = Annotated[
    list[Annotated[str, Query(pattern="^[0-9a-f]{16}$")]],
    Query(min_length=1, max_length=50, description="evaluations against one reference, the oldest first"),
]


@router.get("/comparisons", summary="Evaluations beside each other: dates of one pupil, or pupils")
def compare(studio: StudioNow, job: _Jobs, language: _Language = "en") -> Answer:
    """As `dousa progress --json`, with ``still_says`` of what failed in all of them, and the names of kinds of errors
    and segments."""
    from dousa.evaluation.advice.progress import describe_faults
    from dousa.evaluation.words import KINDS, SEGMENT_NAMES, name_all

    found = studio.evaluations.compare(job)
    return Answer(
        {
            **found.to_json(language),
            "still_says": [message.render(language) for message in describe_faults(found.still)],
            "kinds": name_all(KINDS, language),
            "segments": name_all(SEGMENT_NAMES, language),
        }
    )


@router.get("/comparisons/progress.svg", summary="The same as a picture", **_SVG)
def draw_comparison(studio: StudioNow, job: _Jobs, language: _Language = "en") -> Response:
    """An SVG."""
    use_language(language)
    return Response(studio.evaluations.draw_comparison(job), media_type="image/svg+xml")


@router.get("/comparisons/player", summary="Two performances in step for the 3D player")
def show_two(studio: StudioNow, job: _Jobs, language: _Language = "en") -> Answer:
    """The first and the last of the evaluations; times are those of the last."""
    from dousa.app.player.data import encode_pair

    studio.evaluations.compare(job)
    ends = [EvaluationRequest.model_validate(studio.jobs.get(one).request) for one in (job[0], job[-1])]
    first, last = (studio.motions.get(one.performance) for one in ends)
    names = first.name, last.name
    return Answer(encode_pair(first.motion, last.motion, names=names, labels=("1", "2"), language=language))


def _show(assessment: Any, language: str) -> dict[str, Any]:
    from dousa.app.player.data import encode_player_data
    from dousa.app.report.page import build_parts, collect_data

    return {
        "parts": build_parts(assessment, language),
        "data": collect_data(assessment, language),
        "player": encode_player_data(assessment, language),
    }


Page = Literal["report", "exercise"]
"""Reports that are one file."""

_FILES: dict[str, tuple[str, str]] = {
    "report.html": ("text/html", "the whole report as one page that opens anywhere"),
    "curves.csv": ("text/csv", "all curves, a row a frame"),
    "events.csv": ("text/csv", "errors and lapses"),
    "furi.txt": ("text/plain", "the figures, for `dousa evaluate --furi`"),
    "weights.toml": ("text/plain", "the weights, for `dousa evaluate --weights`"),
    "exercise.html": ("text/html", "the whole report of an exercise as one page that opens anywhere"),
    "repetitions.csv": ("text/csv", "the repetitions of an exercise, a row for each"),
}


def _make_download(name: str) -> Any:
    def download(studio: StudioNow, job_id: str, language: _Language = "en") -> Response:
        return download_file(studio, job_id, name, language)

    return download


def download_file(studio: Studio, job_id: str, name: str, language: Language) -> Response:
    """A file of an evaluation, to be kept.

    Parameters
    ----------
    studio, job_id : of the evaluation.
    name : one of `_FILES`.
    language : of the words in it.

    Raises
    ------
    RefusedError : no such evaluation, or none of this kind.
    """
    content = _write(name, studio, job_id, language)
    stem = studio.evaluations.name_performance(job_id).rpartition(".")[0] or "performance"
    plain, full = f"{job_id}-{name}", quote(f"{stem} {name}", safe="", errors="replace")
    return Response(
        content,
        media_type=f"{_FILES[name][0]}; charset=utf-8",
        headers={"content-disposition": f"attachment; filename=\"{plain}\"; filename*=UTF-8''{full}"},
    )


def _write(name: str, studio: Studio, job_id: str, language: Language) -> str | bytes:
    from dousa.app.report.curves import to_curves_csv, to_events_csv
    from dousa.app.report.page import build_page
    from dousa.evaluation import format_furi

    if name in ("exercise.html", "repetitions.csv"):
        stored = name if name == "repetitions.csv" else f"exercise-{language}.html"
        return studio.evaluations.read_exercise(job_id, stored)
    ready = studio.evaluations.get(job_id)
    adjustment = studio.evaluations.read_adjustment(job_id)
    if name == "furi.txt":
        figures = ready.to_furi(adjustment.furi) or ready.assessment.found
        return format_furi(figures, ready.assessment.frame_rate)
    if name == "weights.toml":
        return format_weights(adjustment.weights)
    assessment = ready.assess(adjustment)
    if name == "report.html":
        notes, timing = studio.evaluations.read_notes(job_id), None
        with suppress(DousaError):  # no beats, or nothing that finds them: the report is whole without
            timing = studio.companions.time_accents(studio.evaluations.find_job(job_id), ready.request.performance)
        return build_page(assessment, language, timing=timing, notes=notes).encode("utf-8", "replace")
    return to_curves_csv(assessment) if name == "curves.csv" else to_events_csv(assessment, language)


for _name, (_kind, _what) in _FILES.items():
    router.add_api_route(
        f"/evaluations/{{job_id}}/{_name}",
        _make_download(_name),
        methods=["GET"],
        **give_files(_kind, form=None),
        summary=f"Download {_what}",
        operation_id=f"download_{_name.replace('.', '_')}",
    )


companions_router = APIRouter(prefix="/evaluations/{job_id}", tags=["evaluation"])


class CompanionRequest(StrictModel):
    """A film or a piece of music that was uploaded."""

    batch: str = Field(pattern="^[0-9a-f]{16}$")
    name: str = Field(min_length=1, max_length=1000)
    start_s: float = Field(
        0.0, ge=-36_000, le=36_000, allow_inf_nan=False, description="when it begins, s of the performance"
    )


@companions_router.get("/companions", summary="Film and music that are shown in step with the figures")
def get_companions(studio: StudioNow, job_id: str) -> Answer:
    """``film`` and ``music``, null where there is none; the film of an estimated performance is found by itself."""
    return _describe_companions(studio, studio.evaluations.find_job(job_id))


@companions_router.put("/companions/{kind}", summary="Show a film or a piece of music in step with the figures")
def put_companion(studio: StudioNow, job_id: str, kind: Kind, wanted: CompanionRequest) -> Answer:
    """Upload the file first."""
    job = studio.evaluations.find_job(job_id)
    studio.companions.put(job, kind, Companion(wanted.batch, wanted.name, wanted.start_s))
    return _describe_companions(studio, job)


@companions_router.delete("/companions/{kind}", summary="Show it no more")
def remove_companion(studio: StudioNow, job_id: str, kind: Kind) -> Answer:
    """The evaluation stays as it is."""
    job = studio.evaluations.find_job(job_id)
    studio.companions.put(job, kind, None)
    return _describe_companions(studio, job)


@companions_router.get("/companions/{kind}/file", summary="The film or the music", **FILE)
def get_companion_file(studio: StudioNow, job_id: str, kind: Kind) -> FileResponse:
    """As it was uploaded; parts of it by the header Range."""
    path = studio.companions.path(studio.evaluations.find_job(job_id), kind)
    media_type = mimetypes.guess_type(path.name)[0] or "application/octet-stream"
    return FileResponse(path, media_type=media_type, headers={"cache-control": "private, max-age=3600"})


@companions_router.get("/beats", summary="The beats of the music, and the accents of the dance against them")
def get_beats(studio: StudioNow, job_id: str, language: _Language = "en") -> Answer:
    """``times_s`` of the music; ``timing`` as of `dousa evaluate --music`; all null without music."""
    from dousa.app.report.timeline import build_beats

    job = studio.evaluations.find_job(job_id)
    performance = EvaluationRequest.read(job).performance
    beats = studio.companions.find_beats(job)
    if beats is None:
        return Answer({"times_s": None, "tempo_bpm": None, "timing": None, "section": "", "problem": None})
    timing, problem = None, None
    try:
        timing = studio.companions.time_accents(job, performance)
    except (InvalidMotionError, OptionError) as error:  # too few accents: the beats are shown all the same
        problem = say(error.message)
    duration = studio.motions.get(performance).motion.duration
    return Answer(
        {
            "times_s": [round(float(one), 3) for one in beats.times],
            "tempo_bpm": round(beats.tempo, 1),
            "timing": None if timing is None else timing.to_json(language),
            "section": build_beats(timing, duration, language),
            "problem": problem,
        }
    )


def _describe_companions(studio: Studio, job: Job) -> Answer:
    found: dict[str, Any] = {"film": None, "music": None}
    for kind, one in studio.companions.get(job).items():
        found[kind] = {"batch": one.batch, "name": one.name, "start_s": one.start_s}
    return Answer(found)
