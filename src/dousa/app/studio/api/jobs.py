"""Work under way: watch, stop, resume, forget; adding and training."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Literal

from fastapi import APIRouter, Query
from pydantic import Field

from dousa.app.requests import library
from dousa.app.requests.models import derive_model
from dousa.app.studio.content.disk_space import describe_space, free_space
from dousa.app.studio.content.studio import StudioNow
from dousa.app.studio.core.answers import Answer, RefusedError, StrictModel
from dousa.app.studio.jobs.board import ACTIVE
from dousa.messages import Message

router = APIRouter(tags=["jobs"])


class AddRequest(derive_model(library.LabelRules)):  # type: ignore[misc]
    """Which uploaded files, where their labels come from and how they are read."""

    batch: str = Field(pattern="^[0-9a-f]{16}$")
    kind: Literal["clip", "take"] = "clip"
    category_from: str | None = Field("folder", max_length=300, description="as dousa add --category-from")
    labels: bool = Field(False, description="of takes: tables of labels lie beside them in the batch")
    tier: str | None = Field(None, max_length=200, description="as dousa add --tier")
    unit: str | None = Field(None, max_length=20)
    up: str | None = Field(None, max_length=2)
    joint_map: dict[str, str | list[str]] | None = None


class CheckRequest(StrictModel):
    """How the library is checked."""

    repair: bool = Field(False, description="put right what can be, as dousa check --repair")


class CompactRequest(StrictModel):
    """How room is given back."""

    fragments: bool = Field(
        False, description="move positions and features out of the file, as dousa compact --fragments"
    )


class TrainRequest(derive_model(library.TrainRequest)):  # type: ignore[misc]
    """How the forest is trained."""

    n_trees: Annotated[int, Field(ge=1, le=2000)] = 100


@router.post("/jobs/add", status_code=202, summary="Add uploaded files to the library")
def add(studio: StudioNow, wanted: AddRequest) -> Answer:
    """A job; its result lists what was added, and what was refused and why."""
    files = studio.workspace.files(wanted.batch)
    studio.workspace.keep(wanted.batch, by_library=True)
    job = studio.jobs.submit("add", wanted.model_dump(), Message("studio_jobs.files", count=len(files)))
    return Answer(job.to_json(), 202)


@router.post("/jobs/train", status_code=202, summary="Train the forest of the library")
def train(studio: StudioNow, wanted: TrainRequest) -> Answer:
    """A job; the library keeps its old forest until the new one is there."""
    return Answer(studio.jobs.submit("train", wanted.model_dump(), studio.settings.library.name).to_json(), 202)


@router.post("/jobs/review", status_code=202, summary="Look for labels that are likely wrong")
def review(studio: StudioNow) -> Answer:
    """A job; its result lists clips that resemble those of another category, and groups of clips nearly the same."""
    return Answer(studio.jobs.submit("review", {}, studio.settings.library.name).to_json(), 202)


@router.post("/jobs/check", status_code=202, summary="Compare everything in the library with its checksums")
def check(studio: StudioNow, wanted: CheckRequest) -> Answer:
    """A job; its notes and its result list what is damaged, and what was or can be done."""
    return Answer(studio.jobs.submit("check", wanted.model_dump(), studio.settings.library.name).to_json(), 202)


@router.post("/jobs/backup", status_code=202, summary="Copy the library to a file in a folder beside it")
def backup(studio: StudioNow) -> Answer:
    """A job, as dousa backup; its notes and its result say where the file is."""
    library = studio.settings.library.absolute()
    name = f"{library.stem}_{datetime.now():%Y-%m-%d_%H%M%S}{library.suffix}"
    asked = {"to": str(library.with_name(f"{library.stem}.backups") / name)}
    return Answer(studio.jobs.submit("backup", asked, studio.settings.library.name).to_json(), 202)


@router.post("/jobs/compact", status_code=202, summary="Forget removed clips, and make the library file smaller")
def compact(studio: StudioNow, wanted: CompactRequest) -> Answer:
    """A job. What it forgets POST /journal/undo cannot bring back. Needs as much free space as what is left."""
    return Answer(studio.jobs.submit("compact", wanted.model_dump(), studio.settings.library.name).to_json(), 202)


@router.post("/jobs/map", status_code=202, summary="Lay out all clips on a map")
def map_clips(studio: StudioNow) -> Answer:
    """A job; what it made is given by GET /map. One that is under way is the answer, not begun twice."""
    for job in studio.jobs.all():
        if job.kind == "map" and job.state in ACTIVE:
            return Answer(job.to_json(), 202)
    return Answer(studio.jobs.submit("map", {}, studio.settings.library.name).to_json(), 202)


@router.post("/jobs/demo", status_code=202, summary="Fill an empty library with made-up motions")
def demo(studio: StudioNow) -> Answer:
    """A job that adds motions of a few made-up people and trains; refused where the library has clips already."""
    stats = studio.library.stats()
    if stats.n_clips or stats.n_takes:
        raise RefusedError(409, "studio_jobs.not_empty")
    batch = studio.workspace.new_batch()
    studio.workspace.keep(batch, by_library=True)
    return Answer(studio.jobs.submit("demo", {"batch": batch}, studio.settings.library.name).to_json(), 202)


@router.get("/space", summary="What the studio keeps on the disk")
def get_space(studio: StudioNow) -> Answer:
    """Bytes of the library, of uploads and of jobs; ``can_be_freed_bytes`` is what POST /space/free gives back."""
    return Answer(describe_space(studio))


@router.post("/space/free", summary="Give back disk space that nothing needs")
def free(
    studio: StudioNow,
    older_days: Annotated[
        int | None, Query(ge=1, le=36_500, description="also uploads of forgotten jobs, unused for so many days")
    ] = None,
) -> Answer:
    """Deletes uploads that nothing uses and that are older than an hour, and finished exports with their files."""
    return Answer(free_space(studio, older_days))


@router.get("/jobs", summary="All jobs, the newest first")
def list_jobs(
    studio: StudioNow,
    kind: Annotated[str | None, Query(max_length=20)] = None,
    active: Annotated[bool | None, Query(description="only those under way, or only the others")] = None,
    limit: Annotated[int, Query(ge=1, le=500)] = 50,
) -> Answer:
    """Without requests and results."""
    chosen = [
        job.to_json(brief=True)
        for job in studio.jobs.all()
        if (kind is None or job.kind == kind) and (active is None or (job.state in ACTIVE) == active)
    ]
    return Answer({"jobs": chosen[:limit]})


@router.get("/jobs/{job_id}", summary="One job, with its result when it is done")
def get_job(studio: StudioNow, job_id: str) -> Answer:
    """State, progress, notes, result or problem."""
    return Answer(studio.jobs.get(job_id).to_json())


@router.post("/jobs/{job_id}/stop", summary="Stop a job")
def stop_job(studio: StudioNow, job_id: str) -> Answer:
    """What it has done stays."""
    return Answer(studio.jobs.stop(job_id).to_json(brief=True))


@router.post("/jobs/{job_id}/resume", summary="Resume a stopped job where it was")
def resume_job(studio: StudioNow, job_id: str) -> Answer:
    """Adding, training and estimation can be resumed."""
    return Answer(studio.jobs.resume(job_id).to_json(brief=True))


@router.delete("/jobs/{job_id}", summary="Forget a finished job and its files")
def forget_job(studio: StudioNow, job_id: str) -> Answer:
    """A job under way is stopped first, by its own request."""
    studio.jobs.remove(job_id)
    return Answer({"id": job_id})
