"""Motions as figures and files."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query
from pydantic import Field
from starlette.responses import Response

from dousa.app.studio.content.motions import MotionName, MotionPart, MotionRef, Seconds, name_file
from dousa.app.studio.content.studio import Studio, StudioNow
from dousa.app.studio.core.answers import BYTES, Answer, attachment, say
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
    """Describe a clip of the library; other motions have null in all fields."""
    if clip is None:
        return {"clip_id": None, "kind": None, "performer": None, "path": None}
    info = studio.library.clips([clip])[0]
    return {"clip_id": clip, "kind": info.kind, "performer": info.performer, "path": info.path}


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


class _Download(MotionPart):
    onto: MotionName | None = Field(default=None, description="a motion over the skeleton that it is brought onto")


@router.get("/motions/miniature", summary="A small moving figure", response_class=Response, responses=BYTES)
def get_miniature(studio: StudioNow, asked: Annotated[MotionPart, Query()]) -> Response:
    """Bytes for ``dousa.createMiniature`` of the pages."""
    from dousa.app.player.figures import encode_miniature

    content = encode_miniature(studio.motions.get(asked.ref()).motion)
    return Response(content, media_type="application/octet-stream")


@router.get("/motions/bvh", summary="Download as BVH", response_class=Response, responses=BYTES)
def get_bvh(studio: StudioNow, asked: Annotated[_Download, Query()]) -> Response:
    """With every joint of the file it came from, if that is still there; else the joints that dousa compares.

    Or on the skeleton of a character, as `dousa convert --onto` does.
    """
    from dousa.app.studio.content.motions import make_file
    from dousa.formats.characters import read_character

    ref = asked.ref()
    named = studio.motions.get(ref)
    character = None if asked.onto is None else read_character(studio.motions.path(MotionRef(motion=asked.onto)))
    content = make_file(named, studio.motions.path(ref), ref, ".bvh", character)
    headers = {"content-disposition": attachment(name_file(named, ref, ".bvh"))}
    return Response(content, media_type="application/octet-stream", headers=headers)
