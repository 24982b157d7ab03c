"""Somebody before the camera: pictures in, keypoints, label and grade out."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Path, Query, Request
from pydantic import Field
from starlette.concurrency import run_in_threadpool

from dousa.app.studio.content import live
from dousa.app.studio.content.motions import MotionRef
from dousa.app.studio.content.studio import StudioNow
from dousa.app.studio.core.answers import Answer, RefusedError, StrictModel, describe_body, name_error, say
from dousa.errors import DousaError

router = APIRouter(tags=["live"])

_MOST_BYTES, _MOST_SIDE, _LEAST_SIDE = 1_000_000, 1280, 16  # of a picture
_SessionId = Annotated[str, Path(pattern="^[0-9a-f]{16}$")]


class LiveRequest(StrictModel):
    """What a performance is held against."""

    references: list[MotionRef] = Field([], max_length=10)


@router.get("/live", summary="Whether people can be found in pictures here")
def describe_live(studio: StudioNow) -> Answer:
    """``problem`` names what to install; null if nothing is missing. ``trained``: whether there are labels.
    ``vmc``: where the motion is sent."""
    problem = live.find_problem(studio.workspace.root)
    trained = studio.library.stats().trained_at is not None
    said = None if problem is None else say(problem)
    return Answer({"problem": said, "trained": trained, "bones": list_bones(), "vmc": studio.settings.vmc})


@router.post("/live", status_code=201, summary="Begin to watch a camera")
def begin(studio: StudioNow, wanted: LiveRequest) -> Answer:
    """The number of a session; one that was watched before ends."""
    references = [studio.motions.get(ref).motion for ref in wanted.references]
    try:
        finder = live.open_finder()
    except DousaError as error:
        raise RefusedError(409, name_error(error, studio.workspace.root)) from None
    sent = () if studio.vmc is None else (studio.vmc.push,)
    session = live.LiveSession(finder, studio.library, references, *sent)
    studio.live.begin(session)
    return Answer({"id": session.id}, 201)


@router.post(
    "/live/{session_id}/picture", summary="The next picture of the camera", openapi_extra=describe_body("image/jpeg")
)
async def see(
    request: Request,
    studio: StudioNow,
    session_id: _SessionId,
    seconds: Annotated[float, Query(ge=0, le=1e7, allow_inf_nan=False, description="s, by the camera's clock")],
) -> Answer:
    """``person`` (or null) with ``points`` in shares of the picture, ``label``, ``grade`` and ``ms``. The picture
    is not kept."""
    session = studio.live.get(session_id)
    content = b""
    async for part in request.stream():
        content += part
        if len(content) > _MOST_BYTES:
            raise RefusedError(413, "studio.large_request", most=_MOST_BYTES / 1e6)

    def answer() -> dict[str, Any]:
        found = session.see(_decode(content), seconds)
        label = found["label"]
        return {**found, "label": {**label, "problem": say(label["problem"])} if "problem" in label else label}

    return Answer(await run_in_threadpool(answer))


@router.delete("/live/{session_id}", summary="Stop watching")
def end(studio: StudioNow, session_id: _SessionId) -> Answer:
    """Nothing of it is kept."""
    studio.live.end(session_id)
    return Answer({"id": session_id})


def _decode(content: bytes) -> Any:
    import numpy as np

    from dousa.extras import cv2

    size = _read_size(content)
    if size is None or max(size) > _MOST_SIDE or min(size) < _LEAST_SIDE:
        raise RefusedError(422, "studio_live.picture", most=_MOST_SIDE)
    image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)
    if image is None:
        raise RefusedError(422, "studio_live.picture", most=_MOST_SIDE)
    return np.ascontiguousarray(image[..., ::-1])


def _read_size(content: bytes) -> tuple[int, int] | None:
    """Read height and width of a JPEG before memory is allocated for it; None for other content."""
    at = 2
    while content[:2] == b"\xff\xd8" and at + 9 <= len(content) and content[at] == 0xFF:
        kind, length = content[at + 1], int.from_bytes(content[at + 2 : at + 4], "big")
        if 0xC0 <= kind <= 0xCF and kind not in (0xC4, 0xC8, 0xCC):
            return int.from_bytes(content[at + 5 : at + 7], "big"), int.from_bytes(content[at + 7 : at + 9], "big")
        at += 2 + max(length, 2)
    return None


def list_bones() -> list[list[int]]:
    """Pairs of the points that are drawn with a line between them."""
    from dousa.app.pictures.keypoint_overlay import BONES
    from dousa.estimation import MEDIAPIPE_NAMES

    places = {name: number for number, name in enumerate(MEDIAPIPE_NAMES)}
    return [[places[one], places[other]] for one, other in BONES if {one, other} <= set(places)]
