"""Silhouettes looked through frame by frame, and repaired by hand."""

from __future__ import annotations

from typing import Annotated, Literal

from fastapi import APIRouter
from pydantic import Field
from starlette.responses import FileResponse, Response

from dousa.app.studio.api.estimation import EstimateRequest, FramePath, JobId, ViewPath, show_picture
from dousa.app.studio.content.masks import EXPORTED, MaskDesk
from dousa.app.studio.content.studio import StudioNow
from dousa.app.studio.core.answers import BYTES, Answer, Gate, RefusedError, StrictModel, describe_bytes
from dousa.estimation.silhouettes.repairs import MaskRepair, MaskStroke, find_part, follow_part
from dousa.messages import Message

router = APIRouter(tags=["estimation"])

_Pixel = Annotated[float, Field(ge=-100_000, le=100_000, allow_inf_nan=False)]
_IMAGE = describe_bytes("image/png", "image/jpeg")
_following = Gate(2, 6, Message("studio_jobs.busy_files"))
_WAIT = 60.0  # s


class RepairRequest(StrictModel):
    """One repair of the silhouette of a view."""

    view: int = Field(ge=0, le=1000)
    frame: int = Field(ge=0, le=10_000_000)
    action: Literal["add", "remove", "exclude", "exclude_through"] = Field(
        description="a stroke of a brush that adds or removes; or the connected part at a point is not the person, "
        "in this frame or through the film"
    )
    points: list[Annotated[list[_Pixel], Field(min_length=2, max_length=2)]] = Field(
        min_length=1, max_length=5000, description="x and y, px of the silhouette; of a part the first counts"
    )
    radius: float = Field(8.0, gt=0, le=2000, description="of the brush, px")


@router.post("/jobs/masks", status_code=202, summary="Write down silhouettes to look through and repair them")
def prepare(studio: StudioNow, wanted: EstimateRequest) -> Answer:
    """A job; when it is done, its silhouettes are below ``/masks/{job}``."""
    if not studio.workspace.files(wanted.batch):
        raise RefusedError(422, "studio_estimation.empty_batch")
    studio.workspace.keep(wanted.batch)
    names = wanted.sources or [path.name for path in studio.workspace.files(wanted.batch)]
    return Answer(studio.jobs.submit("masks", wanted.model_dump(), names[0].rsplit("/", 1)[-1]).to_json(), 202)


@router.get("/masks/{job_id}", summary="What silhouettes there are, which were repaired, and which look doubtful")
def describe(studio: StudioNow, job_id: JobId) -> Answer:
    """``doubts`` are, by view, frames with a reason: ``empty``, ``parts`` (a second one of some size), ``size``."""
    return Answer(studio.masks.get(job_id).describe())


@router.get(
    "/masks/{job_id}/mask/{view}/{frame}",
    summary="A silhouette as it is repaired",
    response_class=Response,
    responses=_IMAGE,
)
def get_mask(studio: StudioNow, job_id: JobId, view: ViewPath, frame: FramePath) -> Response:
    """PNG, white on black, of full size."""
    return show_picture(studio.masks.get(job_id).mask(view, frame), "image/png")


@router.get(
    "/masks/{job_id}/picture/{view}/{frame}",
    summary="The picture behind a silhouette",
    response_class=Response,
    responses=_IMAGE,
)
def get_picture(studio: StudioNow, job_id: JobId, view: ViewPath, frame: FramePath) -> Response:
    """JPEG, at most 720 pixels wide and high, of the same proportions."""
    return show_picture(studio.masks.get(job_id).picture(view, frame), "image/jpeg")


@router.post("/masks/{job_id}/repairs", summary="Repair a silhouette")
def repair(studio: StudioNow, job_id: JobId, wanted: RepairRequest) -> Answer:
    """As GET, and ``changed``: the view, the first of its frames and how many."""
    desk = studio.masks.get(job_id)
    return Answer(desk.repair(_make_repair(desk, wanted)))


def _make_repair(desk: MaskDesk, wanted: RepairRequest) -> MaskRepair:
    points = tuple((x, y) for x, y in wanted.points)
    if wanted.action in ("add", "remove"):
        return MaskStroke(wanted.view, wanted.frame, points, wanted.radius, wanted.action == "add")
    if wanted.action == "exclude":
        return find_part(desk.repaired, wanted.view, wanted.frame, points[0])
    with _following.enter(_WAIT):
        return follow_part(desk.repaired, wanted.view, wanted.frame, points[0])


@router.post("/masks/{job_id}/undo", summary="Take the last repair back")
def undo(studio: StudioNow, job_id: JobId) -> Answer:
    """As of a repair."""
    return Answer(studio.masks.get(job_id).undo())


@router.post("/masks/{job_id}/redo", summary="Do again the repair that was taken back last")
def redo(studio: StudioNow, job_id: JobId) -> Answer:
    """As of a repair."""
    return Answer(studio.masks.get(job_id).redo())


@router.get(
    "/masks/{job_id}/masks.npz",
    summary="The repaired silhouettes as a file",
    response_class=FileResponse,
    responses=BYTES,
)
def export(studio: StudioNow, job_id: JobId) -> Response:
    """With cameras and stature where they are known, as `dousa estimate` takes it."""
    desk = studio.masks.get(job_id)
    with _following.enter(_WAIT):
        path = desk.export()
    return FileResponse(path, media_type="application/octet-stream", filename=EXPORTED)
