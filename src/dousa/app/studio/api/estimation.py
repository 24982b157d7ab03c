"""Motion from films or silhouettes."""

from __future__ import annotations

import shutil
from typing import Annotated, Literal

from fastapi import APIRouter, Path, Query
from pydantic import AfterValidator, Field, field_validator
from starlette.responses import FileResponse, Response

from dousa.app.requests.estimation import EstimationRequest, Preset, Sex
from dousa.app.requests.models import derive_model
from dousa.app.studio.content.masks import EXPORTED, MaskDesk
from dousa.app.studio.content.motions import Address, MotionName, MotionRef
from dousa.app.studio.content.studio import Studio, StudioNow
from dousa.app.studio.core.answers import FILE, Answer, Gate, RefusedError, StrictModel, give_files
from dousa.app.studio.core.workspace import safe_parts
from dousa.estimation.silhouettes.repairs import MaskRepair, MaskStroke, find_part, follow_part
from dousa.messages import Message

router = APIRouter(tags=["estimation"])

FILES = {
    "motion.bvh": "application/octet-stream",
    "joints.trc": "text/plain",
    "angles.csv": "text/csv",
    "overlay.mp4": "video/mp4",
    "cameras.toml": "text/plain",
    "masks.npz": "application/octet-stream",
}
"""What can be fetched of an estimation."""

FRAMES_FORM = r"^-?\d{0,9}:-?\d{0,9}$"
"""The form of a range of frames."""


def _check_name(name: str) -> str:
    try:
        safe_parts(name)
    except RefusedError as error:
        raise ValueError(error) from error
    return name


_Name = Annotated[str, Field(min_length=1, max_length=1000, description="name in the batch")]
JobId = Annotated[str, Path(pattern="^[0-9a-f]{16}$")]
_Track = Annotated[
    list[Annotated[int, Field(ge=0, le=1000)]],
    Field(min_length=2, max_length=2, description="a view and the number of somebody found in it, from 0"),
]


class BodyRequest(StrictModel):
    """Whose body is tracked."""

    stature_m: Annotated[float, Field(ge=0.2, le=3.0)] | None = Field(
        None, description="found from what is seen if left out; films without calibration need it"
    )
    sex: Sex = "average"
    file: _Name | None = Field(None, description="body file (TOML), or a motion with the person's bones")


class StartRequest(StrictModel):
    """The pose of the first frame with somebody in it, in the world of the cameras."""

    motion: MotionName
    frame: int = Field(0, ge=0, le=10_000_000)
    unit: str | None = Field(None, max_length=20)
    up: str | None = Field(None, max_length=2)
    joint_map: dict[str, str | list[str]] | None = None


_SHARED = ("background_method", "kind", "mirrored", "bones", "cues", "model", "size")


class EstimateRequest(derive_model(EstimationRequest, _SHARED)):  # type: ignore[misc]
    """The options of `dousa estimate`. Where no sources are named, every file of the batch finds its own part."""

    batch: str = Field(pattern="^[0-9a-f]{16}$")
    sources: list[_Name] | None = Field(
        None, max_length=100, description="one npz; or per view a folder of masks or a video"
    )
    cameras: Annotated[_Name, AfterValidator(_check_name)] | None = Field(
        None, description="calibration; an npz of silhouettes may have its own"
    )
    backgrounds: list[_Name] | None = Field(None, max_length=100, description="pictures of the empty scene")
    rate: Annotated[float, Field(gt=0, le=10_000, allow_inf_nan=False)] | None = None
    frames: Annotated[str, Field(pattern=FRAMES_FORM)] | None = None
    body: BodyRequest | _Name | None = None
    start: StartRequest | None = Field(None, description="found if left out")
    method: Preset = "default"
    reading: Literal["masked", "residual", "union", "plain", "literal"] | None = None
    evidence: Literal["log", "local", "global"] | None = None
    smoothing: Annotated[float, Field(ge=0, le=1000, allow_inf_nan=False)] | None = None
    beam: Annotated[int, Field(ge=1, le=64)] | None = None
    overlay_video: bool = Field(True, description="write overlay.mp4 at the end")
    offsets: Literal["auto", "none"] = Field("auto", description="films are synchronised, or start together")
    person: list[_Track] | None = Field(
        None, max_length=200, description="who is estimated from films: [view, track] of theirs; who is seen most"
    )
    masks: Annotated[str, Field(pattern="^[0-9a-f]{16}$")] | None = Field(
        None, description="job of `POST /jobs/masks`, whose repaired silhouettes are fitted instead of the sources"
    )
    left_out: list[_Track] | None = Field(None, max_length=500, description="[view, track] of nobody, not to be used")

    @field_validator("sources", "backgrounds")
    @classmethod
    def _inside(cls, names: list[str] | None) -> list[str] | None:
        for name in names or ():
            if name != ".":
                _check_name(name)
        return names

    @field_validator("body")
    @classmethod
    def _whose(cls, body: BodyRequest | str | None) -> BodyRequest | None:
        if isinstance(body, str):
            body = BodyRequest.model_validate({"file": body})
        if body is not None and body.file is not None:
            _check_name(body.file)
        return body


class AddEstimate(StrictModel):
    """How an estimated motion is put into the library."""

    name: str = Field("estimated", min_length=1, max_length=80)
    category: Annotated[str, Field(min_length=1, max_length=80)] | None = None


@router.post("/jobs/estimate", status_code=202, summary="Estimate a motion from films or silhouettes")
def estimate(studio: StudioNow, wanted: EstimateRequest) -> Answer:
    """A job. Watch it by ``/estimations/{job}``; its motion is ``job:ID`` when it is done."""
    names = _name_sources(studio, wanted)
    if wanted.masks is not None:
        studio.masks.get(wanted.masks)
    studio.workspace.keep(wanted.batch)
    title = names[0] + (f" + {len(names) - 1}" if len(names) > 1 else "")
    return Answer(studio.jobs.submit("estimate", wanted.model_dump(), title).to_json(), 202)


def _name_sources(studio: Studio, wanted: EstimateRequest) -> list[str]:
    """Names without folders of the sources, else of all files of the batch; RefusedError where there is none."""
    files = studio.workspace.files(wanted.batch)
    if not files:
        raise RefusedError(422, "studio_estimation.empty_batch")
    return [name.rsplit("/", 1)[-1] for name in wanted.sources or [path.name for path in files]]


@router.post("/estimations/preview", summary="Look at what would be estimated")
def preview(studio: StudioNow, wanted: EstimateRequest) -> Answer:
    """What each file is for, the views with their cameras and first silhouettes, and what is missing."""
    folder = studio.workspace.batch_folder(wanted.batch)
    return Answer(studio.ask("preview.preview", wanted.model_dump(), folder.parent))


@router.post("/estimations/example", status_code=201, summary="Make a short example to estimate")
def make_example(studio: StudioNow) -> Answer:
    """A batch with the silhouettes of a synthetic person who kicks, as four cameras see it."""
    with studio.workspace.fill_batch() as batch:
        return Answer(studio.ask("estimation.write_example", {"batch": batch}, studio.workspace.root / "files"), 201)


@router.get("/estimations/{job_id}/frames", summary="Frames that are new since the last time")
def get_frames(
    studio: StudioNow,
    job_id: JobId,
    since: Annotated[int, Query(alias="from", ge=0, description="``next`` of the last answer")] = 0,
    joints: Annotated[bool, Query(description="with the 20 canonical joints of each frame, base64")] = False,
) -> Answer:
    """A frame comes when it has a pose, and again when it is settled (stage 1) and smoothed (stage 2)."""
    return Answer(studio.footage.get(job_id).frames_since(since, joints=joints))


@router.get("/estimations/{job_id}/player", summary="The figure as far as it is")
def get_player(studio: StudioNow, job_id: JobId, language: Literal["en", "ja"] = "en") -> Answer:
    """Data of the player."""
    return Answer(studio.footage.get(job_id).player(language))


_JPEG = give_files("image/jpeg")
ViewPath = Annotated[int, Path(ge=0, le=1000)]
FramePath = Annotated[int, Path(ge=0, le=10_000_000)]


def show_picture(content: bytes, kind: str = "image/jpeg") -> Response:
    """Answer with a picture that browsers ask for again."""
    return Response(content, media_type=kind, headers={"cache-control": "private, no-cache"})


@router.get(
    "/estimations/{job_id}/overlay/{view}/{frame}", summary="One view of one frame: silhouette and model", **_JPEG
)
def get_overlay(studio: StudioNow, job_id: JobId, view: ViewPath, frame: FramePath) -> Response:
    """JPEG, at most 480 pixels wide and high, from films 720."""
    return show_picture(studio.footage.get(job_id).overlay(view, frame))


@router.get("/estimations/{job_id}/film", summary="What was found of its films so far")
def get_film(studio: StudioNow, job_id: JobId) -> Answer:
    """Views with the people found, when each film begins (s after the first), cameras (m), who is who, and of every
    frame of the motion whether it is lost or unsure; ``stage`` is films, found, placed, matched or fitted."""
    return Answer(studio.footage.get(job_id).film.describe())


@router.get("/estimations/{job_id}/film/people/{view}", summary="The keypoints of everybody in a film")
def get_people(
    studio: StudioNow,
    job_id: JobId,
    view: ViewPath,
    first: Annotated[int, Query(ge=0, le=10_000_000)] = 0,
    count: Annotated[int, Query(ge=1, le=2000)] = 600,
) -> Answer:
    """At moments that all films share: ``points`` base64 of (people, frames, names, 2) int16 in 1/16384 of the
    picture's width and height, -32768 where not seen; ``sure`` base64 of (people, frames, names) uint8."""
    return Answer(studio.footage.get(job_id).film.tracks(view, first, count))


@router.get(
    "/estimations/{job_id}/film/picture/{view}/{frame}",
    summary="The picture of a film at a moment that all films share",
    **_JPEG,
)
def get_picture(studio: StudioNow, job_id: JobId, view: ViewPath, frame: FramePath) -> Response:
    """JPEG, at most 720 pixels wide and high."""
    return show_picture(studio.footage.get(job_id).film.picture(view, frame))


@router.get("/estimations/{job_id}/files/{name}", summary="A file that was estimated", **FILE)
def get_file(studio: StudioNow, job_id: JobId, name: str) -> Response:
    """``motion.bvh``, ``joints.trc``, ``angles.csv``, ``overlay.mp4``, ``cameras.toml``, ``masks.npz``."""
    job = studio.jobs.get(job_id)
    if name not in FILES or job.kind != "estimate":
        raise RefusedError(404, "studio_estimation.other_file", names=tuple(FILES))
    path = studio.jobs.folder(job) / name
    if job.state != "done" or not path.is_file():
        raise RefusedError(404, "studio_estimation.no_result", name=name)
    return FileResponse(path, media_type=FILES[name], filename=name)


@router.post("/estimations/{job_id}/add", status_code=202, summary="Add the estimated motion to the library")
def add_to_library(studio: StudioNow, job_id: JobId, wanted: AddEstimate) -> Answer:
    """A job, as ``POST /jobs/add``."""
    motion = studio.motions.path(MotionRef(motion=str(Address(job=job_id))))
    with studio.workspace.fill_batch() as batch:
        place = studio.workspace.place(batch, f"{wanted.category or 'estimated'}/{wanted.name}.bvh")
        shutil.copyfile(motion, place)
        studio.workspace.keep(batch)
    category = "folder" if wanted.category else None
    request = {"batch": batch, "kind": "clip", "category_from": category, "performer_from": None}
    return Answer(studio.jobs.submit("add", request, f"{wanted.name}.bvh").to_json(), 202)


masks_router = APIRouter(tags=["estimation"])

_Pixel = Annotated[float, Field(ge=-100_000, le=100_000, allow_inf_nan=False)]
_IMAGE = give_files("image/png", "image/jpeg")
_following = Gate(2, 6, Message("studio_jobs.busy_files"))


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


@masks_router.post("/jobs/masks", status_code=202, summary="Write down silhouettes to look through and repair them")
def prepare_masks(studio: StudioNow, wanted: EstimateRequest) -> Answer:
    """A job; when it is done, its silhouettes are below ``/masks/{job}``."""
    name = _name_sources(studio, wanted)[0]
    studio.workspace.keep(wanted.batch)
    return Answer(studio.jobs.submit("masks", wanted.model_dump(), name).to_json(), 202)


@masks_router.get("/masks/{job_id}", summary="What silhouettes there are, which were repaired, and which look doubtful")
def describe_masks(studio: StudioNow, job_id: JobId) -> Answer:
    """``doubts`` are, by view, frames with a reason: ``empty``, ``parts`` (a second one of some size), ``size``."""
    return Answer(studio.masks.get(job_id).describe())


@masks_router.get("/masks/{job_id}/mask/{view}/{frame}", summary="A silhouette as it is repaired", **_IMAGE)
def get_mask(studio: StudioNow, job_id: JobId, view: ViewPath, frame: FramePath) -> Response:
    """PNG, white on black, of full size."""
    return show_picture(studio.masks.get(job_id).mask(view, frame), "image/png")


@masks_router.get("/masks/{job_id}/picture/{view}/{frame}", summary="The picture behind a silhouette", **_IMAGE)
def get_mask_picture(studio: StudioNow, job_id: JobId, view: ViewPath, frame: FramePath) -> Response:
    """JPEG, at most 720 pixels wide and high, of the same proportions."""
    return show_picture(studio.masks.get(job_id).picture(view, frame), "image/jpeg")


@masks_router.post("/masks/{job_id}/repairs", summary="Repair a silhouette")
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
    with _following.enter():
        return follow_part(desk.repaired, wanted.view, wanted.frame, points[0])


@masks_router.post("/masks/{job_id}/undo", summary="Take the last repair back")
def undo(studio: StudioNow, job_id: JobId) -> Answer:
    """As of a repair."""
    return Answer(studio.masks.get(job_id).undo())


@masks_router.post("/masks/{job_id}/redo", summary="Do again the repair that was taken back last")
def redo(studio: StudioNow, job_id: JobId) -> Answer:
    """As of a repair."""
    return Answer(studio.masks.get(job_id).redo())


@masks_router.get("/masks/{job_id}/masks.npz", summary="The repaired silhouettes as a file", **FILE)
def export_masks(studio: StudioNow, job_id: JobId) -> Response:
    """With cameras and stature where they are known, as `dousa estimate` takes it."""
    desk = studio.masks.get(job_id)
    with _following.enter():
        path = desk.export()
    return FileResponse(path, media_type="application/octet-stream", filename=EXPORTED)
