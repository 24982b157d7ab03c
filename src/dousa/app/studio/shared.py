"""The application for others on the local network: reports and clips of the library, read-only; and inboxes.

It is not the studio with restrictions: what it cannot do does not exist in it. It listens at one address of this
machine, over TLS, with a limited number of connections, so that the studio itself never waits. The owner's token is not
accepted, only links, GET and HEAD, and no bodies; but for the links with an inbox, which shows what came by that link
and nothing else, and takes films and motion files of limited size and number. Only how they begin is looked at here.
"""

from __future__ import annotations

import asyncio
import socket
import ssl
import threading
import weakref
from collections.abc import Callable, Coroutine
from dataclasses import replace
from functools import partial
from ipaddress import IPv4Address
from pathlib import Path
from typing import Annotated, Any, TypeVar
from urllib.parse import parse_qsl

from fastapi import APIRouter, Depends, FastAPI, Query, Request
from starlette.datastructures import Headers
from starlette.responses import Response
from starlette.types import ASGIApp, Receive, Scope

from dousa.app.studio import pages
from dousa.app.studio.api import evaluation, motions
from dousa.app.studio.api.share import describe_inbox, name_sent
from dousa.app.studio.content.clips import ClipQuery
from dousa.app.studio.content.evaluations import Language
from dousa.app.studio.content.sharing import (
    KEY,
    SharedServer,
    ShareLink,
    ShareLinks,
    Sharing,
    check_address,
    provide_certificate,
)
from dousa.app.studio.content.studio import Studio, StudioNow
from dousa.app.studio.core.answers import FILE, Answer, RefusedError
from dousa.app.studio.core.guard import CountingReceive, RequestGuard, check_length, check_names, read_cookies
from dousa.app.studio.core.uploads import VIDEOS, receive
from dousa.app.studio.core.workspace import safe_parts
from dousa.errors import OptionError
from dousa.extras import require

LINK = "share_link"
"""Name of the link in the state of a request."""


class SharedGuard(RequestGuard):
    """The guard of what is shared.

    Parameters
    ----------
    app : answers requests that are passed on.
    host : address and port on the network.
    links : the valid links.
    most_bytes : of a file that is sent into an inbox.
    """

    def __init__(self, app: ASGIApp, host: str, links: ShareLinks, most_bytes: int) -> None:
        super().__init__(app)
        self._host, self._links, self._most_bytes = host, links, most_bytes
        self._cookie = f"__Host-dousa_share_{host.rpartition(':')[2]}"  # over https only

    async def judge(self, scope: Scope, headers: Headers, receive: Receive) -> Answer | Receive:
        """Check host, method and link."""
        check_names(scope["method"], headers, "https", {self._host})
        if (scope["method"], scope["path"]) == ("POST", INBOX_PATH):
            return self._let_send(scope, headers, receive)
        if scope["method"] not in ("GET", "HEAD"):
            raise RefusedError(405, "studio_share.only_reads")
        if headers.get("content-length", "0") != "0" or "transfer-encoding" in headers:
            raise RefusedError(413, "studio.large_request", most=0)
        asked = dict(parse_qsl(scope["query_string"].decode("latin-1")))
        if KEY in asked and not scope["path"].startswith("/api/"):
            return self._welcome(asked[KEY])
        scope.setdefault("state", {})[LINK] = self._find_link(headers)
        return receive

    def _let_send(self, scope: Scope, headers: Headers, receive: Receive) -> Receive:
        """Let a link with an inbox send a body of a length that is said, and kept to."""
        link = self._find_link(headers)
        if link.inbox is None:
            raise RefusedError(405, "studio_share.only_reads")
        if "content-length" not in headers or "transfer-encoding" in headers:
            raise RefusedError(411, "studio_share.no_length")
        check_length(headers, self._most_bytes)
        scope.setdefault("state", {})[LINK] = link
        return CountingReceive(receive, self._most_bytes)

    def _find_link(self, headers: Headers) -> ShareLink:
        for token in read_cookies(headers.getlist("cookie"), self._cookie):
            link = self._links.find(token)
            if link is not None:
                return link
        raise RefusedError(401, "studio_share.no_key")

    def _welcome(self, token: str) -> Answer:
        """Move the secret from the address into a cookie, and lead to the page of the link."""
        link = self._links.find(token)
        if link is None:
            raise RefusedError(401, "studio_share.no_key")
        answer = Answer(None, 303)
        answer.headers["location"] = link.page
        answer.set_cookie(self._cookie, link.token, httponly=True, secure=True, samesite="lax", path="/")
        return answer


INBOX_PATH = "/api/inbox"
"""The one address that takes anything."""

_TAKEN = VIDEOS | {".bvh", ".c3d", ".trc", ".fbx", ".glb"}  # no archives, and nothing that programs run or follow
_MOST_FILES, _MOST_BYTES, _PATIENCE_S = 50, 2_000_000_000, 1800.0  # of an inbox; s for a film to come over slow air
_sending = threading.BoundedSemaphore(4)  # at once: what is not yet counted of them fits on the disk
_MOST_CONNECTIONS, _MOST_OF_ONE = 100, 24  # of all, and of one address; a browser opens about six

# --- what there is to see


def _link_of(request: Request) -> ShareLink:
    link: ShareLink = getattr(request.state, LINK)
    return link


_LinkNow = Annotated[ShareLink, Depends(_link_of)]


def _check_report(link: _LinkNow, job_id: str) -> str:
    if not link.shows(job_id):
        raise RefusedError(403, "studio_share.other_report")
    return job_id


def _check_all(link: _LinkNow) -> None:
    if not link.shows_everything:
        raise RefusedError(403, "studio_share.other_report")


def _check_inbox(link: _LinkNow) -> str:
    if link.inbox is None:
        raise RefusedError(403, "studio_share.no_inbox")
    return link.inbox


def _check_clip(asked: Annotated[motions.ShownMotion, Query()]) -> motions.ShownMotion:
    if asked.address.clip is None:  # uploads and estimates are private
        raise RefusedError(403, "studio_share.only_clips")
    return asked


_Report = Annotated[str, Depends(_check_report)]
_Inbox = Annotated[str, Depends(_check_inbox)]
_Clip = Annotated[motions.ShownMotion, Depends(_check_clip)]
_Language = Annotated[Language, Query()]
_EVERYTHING = [Depends(_check_all)]

router = APIRouter(prefix="/api")


@router.get("/reports")
def list_reports(studio: StudioNow, link: _LinkNow) -> Answer:
    """The evaluations that the link shows, the last first."""
    rows = [one for one in studio.evaluations.list_done() if link.shows(one["id"])]
    return Answer({"reports": rows, "everything": link.shows_everything, "page": link.page})


@router.get("/reports/{job_id}")
def get_report(studio: StudioNow, job_id: _Report, language: _Language = "en") -> Answer:
    """The parts of a report and what its scripts need."""
    return Answer(evaluation.collect_report(studio, job_id, language))


@router.get("/reports/{job_id}/exercise")
def get_exercise(studio: StudioNow, job_id: _Report, language: _Language = "en") -> Response:
    """The report of an exercise."""
    return evaluation.get_exercise(studio, job_id, language)


@router.get("/reports/{job_id}/{name}.html")
def download_report(studio: StudioNow, job_id: _Report, name: evaluation.Page, language: _Language = "en") -> Response:
    """The report as one file."""
    return evaluation.download_file(studio, job_id, f"{name}.html", language)


@router.get("/clips", dependencies=_EVERYTHING)
def list_clips(
    studio: StudioNow,
    text: Annotated[str, Query(max_length=300)] = "",
    offset: Annotated[int, Query(ge=0, le=10**9)] = 0,
    limit: Annotated[int, Query(ge=0, le=100)] = 30,
) -> Answer:
    """Clips of the library: number, name, category and length; no names of performers, no folders."""
    snapshot = studio.listing.now()
    rows = snapshot.find(ClipQuery(text)).rows
    described = [snapshot.describe(row) for row in rows[offset : offset + limit]]
    names = ("id", "name", "category", "duration")
    return Answer({"total": len(rows), "items": [{name: one[name] for name in names} for one in described]})


@router.get("/motions/miniature", dependencies=_EVERYTHING, **FILE)
def get_miniature(studio: StudioNow, asked: _Clip) -> Response:
    """A small moving figure."""
    return motions.get_miniature(studio, asked)


@router.get("/motions/player", dependencies=_EVERYTHING)
def get_player(studio: StudioNow, asked: _Clip) -> Answer:
    """A figure for the player."""
    return motions.get_player(studio, asked)


@router.get("/inbox")
def get_inbox(studio: StudioNow, inbox: _Inbox) -> Answer:
    """What came by this link, and what may come."""
    return Answer(_list_sent(studio, inbox))


def _list_sent(studio: Studio, inbox: str) -> dict[str, Any]:
    files = [{"name": one["name"], "bytes": one["bytes"]} for one in describe_inbox(studio, inbox)["files"]]
    return {"files": files, "kinds": sorted(_TAKEN), "most_files": _MOST_FILES, "most_bytes": _MOST_BYTES}


@router.post("/inbox", status_code=201)
async def send(
    request: Request, studio: StudioNow, inbox: _Inbox, name: Annotated[str, Query(max_length=200)]
) -> Answer:
    """Keep one film or motion file."""
    called = name_sent(safe_parts(name)[-1])
    if Path(called).suffix.lower() not in _TAKEN:
        raise RefusedError(415, "studio_share.other_kind", kinds=tuple(sorted(_TAKEN)))
    if not _sending.acquire(blocking=False):
        raise RefusedError(429, "studio_jobs.busy_files")
    limits = replace(studio.settings, most_files=_MOST_FILES, most_unpacked_bytes=_MOST_BYTES)
    try:
        async with asyncio.timeout(_PATIENCE_S):
            await receive(request.stream(), called, inbox, studio.workspace, limits, studio.reader.run)
    except TimeoutError:
        raise RefusedError(408, "studio_jobs.took_long", seconds=_PATIENCE_S) from None
    finally:
        _sending.release()
    return Answer(_list_sent(studio, inbox), 201)


def create_shared_app(studio: Studio, host: str, links: ShareLinks, answer_problems: Callable[[FastAPI], None]) -> Any:
    """Make the application that others see.

    Parameters
    ----------
    studio : with the reports and clips.
    host : address and port.
    links : the valid links.
    answer_problems : registers the answers to errors.
    """
    app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None, default_response_class=Answer)
    app.state.studio = studio
    app.include_router(router)
    pages.register_shared(app)
    answer_problems(app)
    pages.make_addresses(app)
    return SharedGuard(app, host, links, studio.settings.most_bytes)


# --- the server


def make_sharing(
    studio: Studio,
    address: IPv4Address,
    answer_problems: Callable[[FastAPI], None],
    http: Any,
    *,
    takes_films: bool = False,
) -> Sharing:
    """Prepare sharing at an address of this machine.

    Parameters
    ----------
    studio : what is shown.
    address : of this machine.
    answer_problems : registers the answers to errors.
    http : the protocol of uvicorn.
    takes_films : links can let others film and upload into an inbox.
    """

    def start(links: ShareLinks) -> SharedServer:
        require("segno", "share")
        certificate = provide_certificate(studio.workspace.root, address)
        listener = listen(str(address))
        host = f"{address}:{listener.getsockname()[1]}"
        app = create_shared_app(studio, host, links, answer_problems)
        stop = _serve(app, listener, str(certificate.path), http)
        return SharedServer(f"https://{host}", certificate.fingerprint, stop)

    return Sharing(start, takes_films=takes_films)


def find_share_address(asked: str | None = None) -> IPv4Address:
    """Return the given address, or that of this machine in its usual network.

    Raises OptionError without a network, or for an address that is reachable from the internet.
    """
    return check_address(asked if asked is not None else _find_address())


def _find_address() -> str:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("10.255.255.255", 9))  # sends nothing, but selects a route
            found: str = probe.getsockname()[0]
        except OSError:
            raise OptionError("studio_share.no_network") from None
    if found.startswith("127."):
        raise OptionError("studio_share.no_network")
    return found


class LimitedListener(socket.socket):
    """A listening socket with a limited number of connections: open files are few, and the studio needs some."""

    def hold_back(self) -> None:
        """Start to count."""
        self._open: weakref.WeakSet[socket.socket] = weakref.WeakSet()

    def accept(self) -> tuple[socket.socket, Any]:
        """Accept a connection; ConnectionAbortedError, after closing it, if there are too many."""
        connection, peer = super().accept()
        there = [one for one in self._open if one.fileno() >= 0]
        same = sum(1 for one in there if _peer_of(one) == peer[0])
        if len(there) >= _MOST_CONNECTIONS or same >= _MOST_OF_ONE:
            connection.close()
            raise ConnectionAbortedError("too many connections")
        self._open.add(connection)
        return connection, peer

    def close_all(self) -> None:
        """Close the socket and all its connections."""
        self.close()
        for one in list(self._open):
            one.close()


def _peer_of(connection: socket.socket) -> str | None:
    try:
        return str(connection.getpeername()[0])
    except OSError:  # it is gone
        return None


Listener = TypeVar("Listener", bound=socket.socket)


def bind_free_port(make: Callable[..., Listener], host: str, first: int, tries: int = 20) -> Listener:
    """Bind a socket to the first free port of several; OSError, of the last one, if none is free."""
    problem = OSError()
    for port in range(first, min(first + tries, 65536)):
        # The protocol is named, else asyncio does not switch Nagle off, and small answers wait 40 ms.
        listener = make(socket.AF_INET, socket.SOCK_STREAM, socket.IPPROTO_TCP)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind((host, port))
            return listener
        except OSError as error:
            listener.close()
            problem = error
    raise problem


def listen(address: str) -> LimitedListener:
    """Listen at an address on the first free port; OptionError if this is not possible."""
    try:
        listener = bind_free_port(LimitedListener, address, 8865)
    except OSError as error:
        raise OptionError("studio_share.cannot_listen", address=address, reason=error) from error
    listener.hold_back()
    listener.listen(64)
    return listener


def _serve(
    app: Any, listener: LimitedListener, certificate: str, http: Any, *, handshake_s: float = 10.0
) -> Callable[[], None]:
    """Serve in a thread; strangers have ``handshake_s`` to say who they are: with more, silent ones stay longer."""
    uvicorn = require("uvicorn", "studio")
    config = uvicorn.Config(
        app, http=http, ws="none", lifespan="off", loop="asyncio", proxy_headers=False, server_header=False,
        access_log=False, log_level="error", timeout_keep_alive=30, timeout_graceful_shutdown=3, limit_concurrency=60,
        ssl_certfile=certificate, ssl_version=ssl.PROTOCOL_TLS_SERVER,
    )  # fmt: skip
    config.load()
    config.ssl.minimum_version = ssl.TLSVersion.TLSv1_2
    server = uvicorn.Server(config)

    def make_loop() -> asyncio.AbstractEventLoop:
        loop = asyncio.new_event_loop()
        # uvicorn has no option for this, and waits a minute for silent connections.
        hasty = partial(loop.create_server, ssl_handshake_timeout=handshake_s, ssl_shutdown_timeout=1.0)
        loop.create_server = hasty  # type: ignore[method-assign]
        loop.set_exception_handler(lambda *_: None)  # strangers who are no browsers are nothing for the terminal
        return loop

    def run() -> None:
        with asyncio.Runner(loop_factory=make_loop) as runner:
            serving: Coroutine[Any, Any, None] = server.serve(sockets=[listener])
            runner.run(serving)

    thread = threading.Thread(target=run, name="share", daemon=True)
    thread.start()

    def stop() -> None:
        server.should_exit = True
        thread.join(timeout=10)
        listener.close_all()

    return stop
