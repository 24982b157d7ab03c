"""Motions as figures and files."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query
from pydantic import Field
from starlette.responses import FileResponse, Response

from dousa.app.player.figures import encode_miniature
from dousa.app.requests import library
from dousa.app.requests.models import derive_model
from dousa.app.studio.content.motions import (
    EXPORTED,
    Address,
    MotionName,
    MotionPart,
    MotionRef,
    Seconds,
    describe_character,
    name_file,
)
from dousa.app.studio.content.studio import Studio, StudioNow
from dousa.app.studio.core.answers import FILE, Answer, RefusedError, attachment, say
from dousa.formats.exchange.programs import find_program
from dousa.formats.parts import file_of
from dousa.library.export import ORIGINAL, ExportFormat, list_formats
from dousa.messages import Message

router = APIRouter(tags=["motions"])

_MATCH, _QUERY = Message("studio_motions.match"), Message("studio_motions.query")

_Language = Literal["en", "ja"]


class ShownMotion(MotionPart):
    """A motion for the player."""

    language: _Language = Field(default="en", description="of the words in the data")


class _Pair(ShownMotion):
    other: MotionName = Field(description="what is shown beside it")
    other_start_s: Seconds | None = None
    other_end_s: Seconds | None = None
    mirror: bool = Field(default=False, description="show the mirror image of the other")


@router.get("/motions/info", summary="A motion in numbers")
def get_info(studio: StudioNow, asked: Annotated[MotionPart, Query()]) -> Answer:
    """Name, length, category, and doubts that came up when it was read."""
    named = studio.motions.get(asked.ref())
    motion = named.motion
    clip = asked.address.clip
    return Answer(
        {
            "motion": asked.motion,
            "name": named.name,
            "duration_s": motion.duration,
            "frame_rate": motion.frame_rate,
            "n_frames": motion.n_frames,
            "height_m": motion.height,
            "joint_table": motion.mapping.table,
            "category": named.category,
            "notes": [say(note) for note in motion.warnings],
            **_describe_clip(studio, clip),
        }
    )


def _describe_clip(studio: Studio, clip: int | None) -> dict[str, Any]:
    if clip is None:
        return {"clip_id": None, "kind": None, "performer": None, "path": None}
    info = studio.library.clips([clip])[0]
    return {"clip_id": clip, "kind": info.kind, "performer": info.performer, "path": info.path}


@router.get("/motions/count", summary="How often a movement is repeated")
def get_count(studio: StudioNow, asked: Annotated[MotionPart, Query()]) -> Answer:
    """The repetitions in a motion, as ``dousa count --json``: no reference is needed."""
    from dousa.motion import count_repetitions

    named = studio.motions.get(asked.ref())
    return Answer({"motion": asked.motion, "name": named.name, **count_repetitions(named.motion).to_json()})


@router.get("/motions/player", summary="A figure for the 3D player")
def get_player(studio: StudioNow, asked: Annotated[ShownMotion, Query()]) -> Answer:
    """What ``dousa.createPlayer`` of the pages is given."""
    from dousa.app.player.data import encode_motion

    named = studio.motions.get(asked.ref())
    return Answer(encode_motion(named.motion, named.name, language=asked.language))


@router.get("/motions/pair", summary="Two figures in step for the 3D player")
def get_pair(studio: StudioNow, asked: Annotated[_Pair, Query()]) -> Answer:
    """The motion and the other, which is brought into step with it; times are those of the motion."""
    from dousa.app.player.data import encode_pair
    from dousa.motion.canonical.canonicalise import mirror_canonical

    named = studio.motions.get(asked.ref())
    other_ref = MotionRef(motion=asked.other, start_s=asked.other_start_s, end_s=asked.other_end_s)
    other = studio.motions.get(other_ref)
    beside = mirror_canonical(other.motion) if asked.mirror else other.motion
    return Answer(
        encode_pair(
            beside,
            named.motion,
            names=(other.name, named.name),
            labels=(_MATCH.render(asked.language), _QUERY.render(asked.language)),
            language=asked.language,
        )
    )


@router.get("/motions/miniature", summary="A small moving figure", **FILE)
def get_miniature(studio: StudioNow, asked: Annotated[MotionPart, Query()]) -> Response:
    """Bytes for ``dousa.createMiniature`` of the pages."""
    content = encode_miniature(studio.motions.get(asked.ref()).motion)
    return Response(content, media_type="application/octet-stream")


export_router = APIRouter(tags=["export"])

CHARACTER_FORM = r"^(clip:[0-9]{1,15}|file:[0-9a-f]{16}/.{1,1000})$"
"""The form of the name of a character."""

_Number = Annotated[int, Field(ge=1, le=2**31 - 1)]
_Character = Annotated[
    str,
    Field(
        pattern=CHARACTER_FORM,
        description="file:BATCH/NAME of an upload, or clip:NUMBER: a file over the skeleton that motions are put onto",
    ),
]
_Format = Annotated[str, Field(max_length=20, description="of GET /api/export/formats")]


class _Reach(derive_model(library.Character, ("keep_reach",))):  # type: ignore[misc]
    pass


class ExportRequest(_Reach):
    """Which clips, and what they are written as."""

    clips: Annotated[list[_Number], Field(min_length=1, max_length=20_000)]
    to: _Format = "bvh"
    onto: _Character | None = None
    frame_rate: Annotated[float | None, Field(gt=0, le=1000, description="Hz to resample to")] = None


@export_router.get("/export/formats", summary="What motions can be written as")
def get_formats() -> Answer:
    """Names of formats with their suffixes; ``original`` are the files as they were added, ``missing`` says what this
    machine lacks for a format."""
    missing = {} if find_program("blender") else {"fbx": say(Message("studio_export.needs_blender"))}
    return Answer({"formats": list_formats(), "original": ORIGINAL, "missing": missing})


@export_router.get("/export/character", summary="Whether motions can be put onto a character")
def get_character(studio: StudioNow, motion: Annotated[_Character, Query()]) -> Answer:
    """Its name and body; refused if it has no skeleton of a person. An upload is kept from now on."""
    path = _find_character(studio, motion)
    described = studio.reader.run(describe_character, path)
    _keep_upload(studio, motion)
    suffix = Path(file_of(path)).suffix.lower()
    return Answer({"motion": motion, "name": path.name, "suffix": suffix, **described})


@export_router.post("/jobs/export", status_code=202, summary="Export clips as a ZIP file")
def export(studio: StudioNow, wanted: ExportRequest) -> Answer:
    """A job; when it is done GET /api/exports/ID gives the file: a folder per category, and manifest.csv."""
    request: dict[str, Any] = wanted.model_dump()
    character = None
    if wanted.onto is not None:
        character = _find_character(studio, wanted.onto)
        _keep_upload(studio, wanted.onto)
    ExportFormat(wanted.to, character, wanted.keep_reach, wanted.frame_rate)  # refuses mistakes at once
    count, to = len(wanted.clips), wanted.to.upper()
    title = Message("studio_export.clips", count=count, to=to)
    if character is not None:
        title = Message("studio_export.clips_onto", count=count, to=to, name=character.name)
    return Answer(studio.jobs.submit("export", request, title).to_json(), 202)


@export_router.get("/exports/{job_id}", summary="The ZIP file of an export", **FILE)
def get_export(studio: StudioNow, job_id: str) -> Response:
    """``export.zip``."""
    job = studio.jobs.get(job_id)
    path = studio.jobs.folder(job) / EXPORTED
    if job.kind != "export" or job.state != "done" or not path.is_file():
        raise RefusedError(404, "studio_export.nothing")
    stem = Path(studio.settings.library.name).stem
    return FileResponse(path, media_type="application/zip", filename=f"{stem}_{job.id[:6]}.zip")


class _FormatDownload(MotionPart, _Reach):
    to: _Format = "bvh"
    onto: _Character | None = None


@export_router.get("/motions/file", summary="Download in any format", **FILE)
def get_motion_file(studio: StudioNow, asked: Annotated[_FormatDownload, Query()]) -> Response:
    """With every joint of the file it came from, if that is still there; else the joints that dousa compares.

    On the skeleton of a character, as `dousa convert --onto` does, with the mesh of a GLB character in a GLB.
    """
    ref = asked.ref()
    named = studio.motions.get(ref)
    path = None if asked.onto is None else _find_character(studio, asked.onto)
    form = ExportFormat(asked.to, path, asked.keep_reach)
    if form.to == ORIGINAL:
        raise RefusedError(422, "export.format", found=form.to, known=tuple(list_formats()))
    suffix = list_formats()[form.to]
    content = studio.motions.make_file(named, ref, suffix, path, form.keep_reach)
    headers = {"content-disposition": attachment(name_file(named, ref, suffix))}
    return Response(content, media_type="application/octet-stream", headers=headers)


def _find_character(studio: Studio, motion: str) -> Path:
    return studio.motions.path(MotionRef(motion=motion))


def _keep_upload(studio: Studio, motion: str) -> None:
    if batch := Address.parse(motion).batch:
        studio.workspace.keep(batch)
