"""Film and music beside an evaluation."""

from __future__ import annotations

import mimetypes
from typing import Annotated, Any

from fastapi import APIRouter, Query
from pydantic import BaseModel, ConfigDict, Field
from starlette.responses import FileResponse

from dousa.app.studio.content.companions import Companion, Kind
from dousa.app.studio.content.evaluations import EvaluationRequest, Language
from dousa.app.studio.content.studio import Studio, StudioNow
from dousa.app.studio.core.answers import BYTES, Answer
from dousa.app.studio.core.words import say
from dousa.app.studio.jobs.board import Job
from dousa.errors import InvalidMotionError, OptionError

router = APIRouter(prefix="/evaluations/{job_id}", tags=["evaluation"])

_Language = Annotated[Language, Query(description="of the words")]


class CompanionRequest(BaseModel):
    """A film or a piece of music that was uploaded."""

    model_config = ConfigDict(extra="forbid")

    batch: str = Field(pattern="^[0-9a-f]{16}$")
    name: str = Field(min_length=1, max_length=1000)
    start_s: float = Field(
        0.0, ge=-36_000, le=36_000, allow_inf_nan=False, description="when it begins, s of the performance"
    )


@router.get("/companions", summary="Film and music that are shown in step with the figures")
def get_companions(studio: StudioNow, job_id: str) -> Answer:
    """``film`` and ``music``, null where there is none; the film of an estimated performance is found by itself."""
    return _describe(studio, studio.evaluations.find_job(job_id))


@router.put("/companions/{kind}", summary="Show a film or a piece of music in step with the figures")
def put_companion(studio: StudioNow, job_id: str, kind: Kind, wanted: CompanionRequest) -> Answer:
    """Upload the file first."""
    job = studio.evaluations.find_job(job_id)
    studio.companions.put(job, kind, Companion(wanted.batch, wanted.name, wanted.start_s))
    return _describe(studio, job)


@router.delete("/companions/{kind}", summary="Show it no more")
def remove_companion(studio: StudioNow, job_id: str, kind: Kind) -> Answer:
    """The evaluation stays as it is."""
    job = studio.evaluations.find_job(job_id)
    studio.companions.put(job, kind, None)
    return _describe(studio, job)


@router.get("/companions/{kind}/file", summary="The film or the music", response_class=FileResponse, responses=BYTES)
def get_file(studio: StudioNow, job_id: str, kind: Kind) -> FileResponse:
    """As it was uploaded; parts of it by the header Range."""
    path = studio.companions.path(studio.evaluations.find_job(job_id), kind)
    media_type = mimetypes.guess_type(path.name)[0] or "application/octet-stream"
    return FileResponse(path, media_type=media_type, headers={"cache-control": "private, max-age=3600"})


@router.get("/beats", summary="The beats of the music, and the accents of the dance against them")
def get_beats(studio: StudioNow, job_id: str, language: _Language = "en") -> Answer:
    """``times_s`` of the music; ``timing`` as `dousa evaluate --music` says; all null without music."""
    from dousa.app.report import build_beats

    job = studio.evaluations.find_job(job_id)
    performance = EvaluationRequest.model_validate(job.request).performance
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


def _describe(studio: Studio, job: Job) -> Answer:
    found: dict[str, Any] = {"film": None, "music": None}
    for kind, one in studio.companions.get(job).items():
        found[kind] = {"batch": one.batch, "name": one.name, "start_s": one.start_s}
    return Answer(found)
