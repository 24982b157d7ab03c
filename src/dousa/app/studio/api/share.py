"""What others on the local network may look at: the owner's side of it."""

from __future__ import annotations

import re
import secrets
import time
from contextlib import suppress
from typing import Annotated, Any

from fastapi import APIRouter
from pydantic import Field

from dousa.app.studio.content.motions import Address
from dousa.app.studio.content.sharing import ShareLink, Sharing, draw_code
from dousa.app.studio.content.studio import Studio, StudioNow
from dousa.app.studio.core.answers import Answer, RefusedError, StrictModel
from dousa.app.studio.core.uploads import is_film

router = APIRouter(prefix="/share", tags=["share"])


class LinkRequest(StrictModel):
    """What a link is for."""

    report: Annotated[str, Field(pattern="^[0-9a-f]{16}$")] | None = Field(
        None, description="the job of one evaluation; null for all evaluations and the library"
    )
    films: bool = Field(
        False, description="instead, to film or upload into a new inbox; needs a studio whose links take films"
    )


class RevokeRequest(StrictModel):
    """Which link."""

    number: Annotated[str, Field(max_length=40)]


@router.get("", summary="What is shown on the local network")
def get_share(studio: StudioNow) -> Answer:
    """``possible``: the studio was started with `--share`, ``films``: with `--share-films`. ``address`` is null while
    nothing is shown. ``inboxes`` have what came: the batch, and its files with their names as motions, or null."""
    return _describe(studio)


@router.post("/begin", summary="Show reports and library on the local network")
def begin(studio: StudioNow) -> Answer:
    """Only where the studio was started with `--share`; others can look and change nothing. New links every time."""
    _sharing(studio).begin()
    return _describe(studio)


@router.post("/end", summary="Show nothing on the local network any more")
def end(studio: StudioNow) -> Answer:
    """All links are taken back."""
    _sharing(studio).end()
    return _describe(studio)


@router.post("/links", summary="Make a link for others")
def make_link(studio: StudioNow, wanted: LinkRequest) -> Answer:
    """To one evaluation, or to everything that is shown: the same link as long as it holds; or a new inbox."""
    sharing = _sharing(studio)
    if wanted.films and not sharing.takes_films:
        raise RefusedError(409, "studio_share.no_inboxes")
    if wanted.report is not None:
        studio.evaluations.name_performance(wanted.report)  # is it there?
    if sharing.server is None:
        raise RefusedError(409, "studio_share.ended")
    if wanted.films:
        return Answer(_describe_link(studio, sharing, sharing.links.add(None, studio.workspace.new_inbox())))
    return Answer(_describe_link(studio, sharing, sharing.links.add(wanted.report)))


@router.post("/revoke", summary="Take a link back")
def revoke(studio: StudioNow, wanted: RevokeRequest) -> Answer:
    """Who came by it gets nothing any more."""
    _sharing(studio).links.revoke(wanted.number)
    return _describe(studio)


def _sharing(studio: Studio) -> Sharing:
    if studio.sharing is None:
        raise RefusedError(409, "studio_share.not_asked_for")
    return studio.sharing


def _describe(studio: Studio) -> Answer:
    sharing = studio.sharing
    server = None if sharing is None else sharing.server
    links = [] if sharing is None or server is None else sharing.links.all()
    return Answer(
        {
            "possible": sharing is not None,
            "films": sharing is not None and sharing.takes_films,
            "inboxes": [describe_inbox(studio, batch) for batch in studio.workspace.list_inboxes()],
            "address": None if server is None else server.address,
            "fingerprint": None if server is None else server.fingerprint,
            "links": [_describe_link(studio, sharing, link) for link in links if sharing is not None],
        }
    )


_SENT = re.compile(r"\d{8}-\d{6}-[0-9a-f]{4}-")


def name_sent(name: str) -> str:
    """Name a file that is sent: phones call all films alike, and the owner may put files of other names beside it."""
    end = name.encode()[-150:].decode(errors="ignore")  # bytes, of names of 200
    return f"{time.strftime('%Y%m%d-%H%M%S')}-{secrets.token_hex(2)}-{end}"


def describe_inbox(studio: Studio, batch: str) -> dict[str, Any]:
    """Describe what came into an inbox; nothing of it is opened."""
    files = [
        {
            "name": path.name,
            "bytes": path.stat().st_size,
            "motion": None if is_film(path.name) else str(Address(batch=batch, name=path.name)),
        }
        for path in studio.workspace.files(batch)
        if _SENT.match(path.name)
    ]
    return {"batch": batch, "files": files}


def _describe_link(studio: Studio, sharing: Sharing | None, link: ShareLink) -> dict[str, Any]:
    url = "" if sharing is None else sharing.address_of(link)
    title = None
    if link.report is not None:
        with suppress(RefusedError):  # the evaluation was forgotten: so its link shows nothing
            title = studio.evaluations.name_performance(link.report)
    return {
        "number": link.number,
        "report": link.report,
        "inbox": link.inbox,
        "title": title,
        "url": url,
        "code": draw_code(url),
        "created_s": link.created_s,
    }
