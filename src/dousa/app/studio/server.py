"""Run the studio until it is stopped."""

from __future__ import annotations

import asyncio
import gc
import os
import socket
import sys
import threading
import webbrowser
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager, suppress
from dataclasses import replace
from functools import cache
from ipaddress import IPv4Address
from pathlib import Path
from typing import Any, ClassVar

import h11
from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect
from starlette.responses import Response
from starlette.routing import BaseRoute
from uvicorn.protocols.http.h11_impl import H11Protocol

import dousa
from dousa.app.player.data import encode_pair
from dousa.app.studio import pages
from dousa.app.studio.api import ROUTERS
from dousa.app.studio.api.clips import ONE_LINE
from dousa.app.studio.api.estimation import FRAMES_FORM
from dousa.app.studio.api.motions import CHARACTER_FORM
from dousa.app.studio.content.motions import MOTION_FORM
from dousa.app.studio.content.sharing import print_code
from dousa.app.studio.content.studio import Studio
from dousa.app.studio.core.answers import Answer, describe_disk, name_error, status_of, to_answer
from dousa.app.studio.core.guard import Codes, Guard
from dousa.app.studio.core.workspace import HomeTakenError, Settings, ask_running
from dousa.app.studio.jobs.board import ACTIVE, FolderWatch
from dousa.app.studio.shared import bind_free_port, make_sharing
from dousa.app.studio.work.worker import make_lanes
from dousa.errors import DousaError, OptionError
from dousa.extras import require
from dousa.messages import Message


def serve(
    settings: Settings,
    *,
    opens_browser: bool = True,
    watched: Path | None = None,
    shared: IPv4Address | None = None,
    takes_films: bool = False,
) -> None:
    """Serve the studio on this machine and print its address, until Ctrl-C.

    Raises OptionError if no port is free, the folder belongs to a studio that does not answer, ``watched`` is no
    folder, or the running studio would have to watch or share; MissingExtraError without the extra ``studio`` or
    ``share``.

    Parameters
    ----------
    settings : a port that is taken is replaced by the next free one; if a studio of this library runs already, that one
        is shown.
    opens_browser : show the page in the browser of this machine.
    watched : folder whose new files are added to the library while the studio runs.
    shared : address of this machine at which others on its network see reports and library, read-only.
    takes_films : links can let them film and upload into an inbox too.
    """
    if watched is not None and not watched.is_dir():
        raise OptionError("studio.no_watched_folder", folder=watched)
    _tame_memory()
    # Many small products for each request: threads of the linear algebra cost twice what they save.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    uvicorn = require("uvicorn", "studio")

    listener, port = _listen(settings)
    with listener:
        settings = replace(settings, port=port)
        try:
            # Safari asks the system for names below localhost, which older ones do not know.
            app = create_app(settings, uses_alias=sys.platform != "darwin")
        except HomeTakenError:
            running = ask_running(settings.folder, settings.library)
            if running is None:
                raise
            asked = {"--watch": watched, "--share": shared, "--vmc": settings.vmc}
            for option in (name for name, value in asked.items() if value):
                raise OptionError("studio.cannot_watch", library=settings.library, option=option) from None
            _show_running(settings, running, opens_browser)
            return
        config = uvicorn.Config(
            app, http=PatientProtocol, ws="none", proxy_headers=False, server_header=False, access_log=False,
            log_level="error",  # what others send that is no HTTP is nothing for the terminal
            timeout_keep_alive=30, timeout_graceful_shutdown=3, limit_concurrency=200,
        )  # fmt: skip
        server = uvicorn.Server(config)
        if shared is not None:
            _begin_sharing(app.state.studio, shared, takes_films)
        app.state.studio.held.announce(settings.address, settings.token, settings.library)
        _say_serving(settings, app.state.codes.issue())
        threading.Thread(target=warm_up, args=(app.state.studio,), daemon=True).start()
        if watched is not None:
            _watch(watched, app.state.studio).start()
        if opens_browser:
            address = f"{settings.address}/?code={app.state.codes.issue()}"
            threading.Timer(0.5, webbrowser.open, [address]).start()
        with suppress(KeyboardInterrupt):  # the usual end
            server.run(sockets=[listener])
        sys.stderr.write(f"{Message('studio.stopped')}\n")


def _begin_sharing(studio: Studio, address: IPv4Address, takes_films: bool) -> None:
    studio.sharing = make_sharing(studio, address, answer_problems, PatientProtocol, takes_films=takes_films)
    try:
        server = studio.sharing.begin()
    except BaseException:
        studio.close()
        raise
    link = studio.sharing.address_of(studio.sharing.links.add(None))
    if sys.stderr.isatty():
        sys.stderr.write(f"\n{print_code(link)}\n")
    sys.stderr.write(f"{Message('studio_share.serving', address=link, fingerprint=server.fingerprint)}\n")
    if takes_films:
        sys.stderr.write(f"{Message('studio_share.takes_films')}\n")


def _watch(folder: Path, studio: Studio) -> FolderWatch:
    def take_in(files: list[str]) -> None:
        studio.jobs.submit("watch", {"folder": str(folder.absolute()), "files": files}, folder.name)

    def is_busy() -> bool:
        return any(job.kind == "watch" and job.state in ACTIVE for job in studio.jobs.all())

    return FolderWatch(folder, take_in, is_busy)


def _say_serving(settings: Settings, code: str) -> None:
    said = Message(
        "studio.serving", library=settings.library, address=f"{settings.address}/?code={code}", token=settings.token
    )
    sys.stderr.write(f"{said}\n")
    sys.stderr.flush()


def _show_running(settings: Settings, address: str, opens_browser: bool) -> None:
    sys.stderr.write(f"{Message('studio.runs_already', library=settings.library, address=address)}\n")
    if opens_browser:
        webbrowser.open(address)


def _tame_memory() -> None:
    """Return memory to the system: glibc keeps a heap for every thread, in which freed memory stays."""
    if not sys.platform.startswith("linux"):
        return
    import ctypes

    with suppress(OSError, AttributeError):  # another C library
        libc = ctypes.CDLL("libc.so.6")
        libc.mallopt(-8, 2)  # M_ARENA_MAX of malloc.h
        libc.mallopt(-3, 256 * 1024)  # M_MMAP_THRESHOLD


def _listen(settings: Settings, *, tries: int = 20) -> tuple[socket.socket, int]:
    # tries: ports after the one asked for
    try:
        listener = bind_free_port(socket.socket, settings.host, settings.port, tries)
    except OSError:
        raise OptionError("studio.no_port", first=settings.port, last=settings.port + tries - 1) from None
    listener.listen(128)
    return listener, listener.getsockname()[1]


_DESCRIPTION = """Motion retrieval, evaluation and estimation over HTTP, on this machine only. Every request carries
`Authorization: Bearer TOKEN`, the token of the address that `dousa studio` prints. Problems are answered with a status
of 400 or above and `{"problem": "one sentence", "code": ..., "values": ...}`; sentences are in the language of the
header `Accept-Language`, English or Japanese."""


def create_app(settings: Settings, *, uses_alias: bool = False) -> FastAPI:
    """Make the application of a studio; LibraryError or OptionError if library or folder cannot be used.

    Parameters
    ----------
    settings : of the studio.
    uses_alias : send browsers to a host name that only this studio has.
    """
    studio = Studio(settings, make_lanes)
    if uses_alias:
        settings = replace(settings, alias=studio.workspace.read_alias())

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        yield
        studio.close()

    app = FastAPI(
        title="dousa studio",
        version=dousa.__version__,
        description=_DESCRIPTION,
        docs_url=None,  # they would load scripts from elsewhere; the page /api-guide shows the same
        redoc_url=None,
        openapi_url="/api/openapi.json",
        lifespan=lifespan,
        routes=list(_make_routes()),
    )
    app.state.studio = studio
    app.state.codes = codes = Codes()
    answer_problems(app, pages.show_missing)
    app.add_middleware(Guard, settings=settings, codes=codes)
    return app


@cache
def _make_routes() -> tuple[BaseRoute, ...]:
    """Make the routes, which are the same for every studio: to build their models takes 0.1 s."""
    app = FastAPI(
        openapi_url=None,
        default_response_class=Answer,
        responses={422: {"description": "cannot be used as it is", "content": _PROBLEM_CONTENT}},
    )
    for router in ROUTERS:
        app.include_router(router, prefix="/api")
    pages.register(app)
    pages.make_addresses(app)
    return tuple(app.routes)


_PROBLEM_CONTENT: dict[str, Any] = {
    "application/json": {
        "schema": {"type": "object", "properties": {"problem": {"type": "string"}}, "required": ["problem"]}
    }
}


def answer_problems(app: FastAPI, show_missing: Callable[[Request], Response | None] = lambda request: None) -> None:
    """Register the answers to errors.

    Parameters
    ----------
    app : the application.
    show_missing : returns the page for an unknown address; None to answer with a sentence.
    """

    @app.exception_handler(DousaError)
    async def answer_error(request: Request, error: DousaError) -> Answer:
        home = request.app.state.studio.workspace.root
        return Answer(to_answer(name_error(error, home)), status_of(error))

    @app.exception_handler(OSError)
    async def answer_disk(request: Request, error: OSError) -> Answer:
        problem = describe_disk(error)
        if problem is None:
            raise error
        return Answer(to_answer(problem), 507)

    @app.exception_handler(Exception)
    async def answer_fault(request: Request, error: Exception) -> Answer:
        return Answer(to_answer(Message("studio.fault", kind=type(error).__name__)), 500)

    @app.exception_handler(ClientDisconnect)
    async def answer_nobody(request: Request, error: ClientDisconnect) -> Answer:
        return Answer(to_answer(Message("studio.broken_off")), 400)

    @app.exception_handler(RequestValidationError)
    async def answer_invalid(request: Request, error: RequestValidationError) -> Answer:
        fields = tuple(_describe_field(item) for item in error.errors()[:20])
        return Answer(to_answer(Message("studio.invalid", fields=fields)), 422)

    @app.exception_handler(HTTPException)
    async def answer_other(request: Request, error: HTTPException) -> Response:
        page = show_missing(request) if error.status_code == 404 else None
        if page is not None:
            return page
        known = {404: "studio.no_address", 405: "studio.other_method"}
        code = known.get(error.status_code)
        problem = Message("text.verbatim", text=error.detail) if code is None else Message(code)
        return Answer(to_answer(problem), error.status_code, error.headers)


def _describe_field(item: Mapping[str, Any]) -> Message:
    where = ".".join(str(step) for step in item["loc"][1:]) or str(item["loc"][0])
    context = item.get("ctx", {})
    cause = context.get("error")
    if isinstance(cause, ValueError) and cause.args and isinstance(cause.args[0], DousaError):
        problem = cause.args[0].message
    elif item["type"] == "string_pattern_mismatch":
        problem = Message(_FORM_CODES.get(context.get("pattern", ""), "studio.field_form"))
    elif item["type"] in _FIELD_CODES:
        limits = {name: value for name, value in context.items() if isinstance(value, str | int | float)}
        problem = Message(_FIELD_CODES[item["type"]], **limits)
    else:
        problem = Message("studio.field_other")
    return Message("studio.field", field=where, problem=problem)


# Kinds of problems of pydantic -> codes; their values are pydantic's.
_FIELD_CODES = {
    "missing": "studio.field_missing",
    "extra_forbidden": "studio.field_unknown",
    "greater_than": "studio.field_greater_than",
    "greater_than_equal": "studio.field_at_least",
    "less_than": "studio.field_less_than",
    "less_than_equal": "studio.field_at_most",
    "finite_number": "studio.field_finite",
    "float_parsing": "studio.field_number",
    "float_type": "studio.field_number",
    "int_parsing": "studio.field_integer",
    "int_type": "studio.field_integer",
    "int_from_float": "studio.field_integer",
    "bool_parsing": "studio.field_boolean",
    "bool_type": "studio.field_boolean",
    "string_type": "studio.field_text",
    "string_too_short": "studio.field_short",
    "string_too_long": "studio.field_long",
    "list_type": "studio.field_list",
    "model_attributes_type": "studio.field_object",
    "model_type": "studio.field_object",
    "dict_type": "studio.field_object",
    "literal_error": "studio.field_choice",
    "too_short": "studio.field_few",
    "too_long": "studio.field_many",
    "json_invalid": "studio.field_json",
}


# Forms that texts must have -> what they are, for people.
_FORM_CODES = {
    "^[0-9a-f]{16}$": "studio.form_number",
    ONE_LINE: "studio.form_line",
    MOTION_FORM: "studio.form_motion",
    CHARACTER_FORM: "studio.form_character",
    FRAMES_FORM: "studio.form_frames",
}


class PatientProtocol(H11Protocol):
    """HTTP of uvicorn that closes a connection whose next request is late, or whose body comes too slowly.

    Attributes
    ----------
    patience_s : for the first line and the headers of a request, and in every such time a body must go on; uvicorn
        itself waits for ever.
    most_waiting : connections of one address without a request under way: of more the oldest is closed, so that those
        that say nothing do not keep others out. Browsers have six at a time.
    """

    patience_s = 5.0
    most_waiting = 40
    _waiting: ClassVar[dict[str, dict[PatientProtocol, None]]] = {}  # by address, the oldest first
    _peer = ""
    _deadline: asyncio.TimerHandle | None = None
    _n_bytes = 0  # of a body since it was looked at

    def connection_made(self, transport: Any) -> None:
        """Start the time limit."""
        super().connection_made(transport)
        self._peer = str((transport.get_extra_info("peername") or ("",))[0])
        self._queue()
        self._watch()

    def data_received(self, data: bytes) -> None:
        """Count the bytes; a few bytes do not extend the time limit."""
        self._n_bytes += len(data)
        super().data_received(data)
        if self.conn.their_state is not h11.IDLE:
            self._leave_queue()
        self._watch()

    def on_response_complete(self) -> None:
        """Wait for the next request."""
        super().on_response_complete()
        if self.conn.their_state is h11.IDLE:
            self._queue()

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop the time limit."""
        self._rest()
        self._leave_queue()
        super().connection_lost(exc)

    def _queue(self) -> None:
        waiting = self._waiting.setdefault(self._peer, {})
        waiting[self] = None
        if len(waiting) > self.most_waiting:
            oldest = next(iter(waiting))
            oldest._leave_queue()
            oldest.transport.abort()

    def _leave_queue(self) -> None:
        waiting = self._waiting.get(self._peer, {})
        waiting.pop(self, None)
        if not waiting:
            self._waiting.pop(self._peer, None)

    def _watch(self) -> None:
        if self.conn.their_state not in (h11.IDLE, h11.SEND_BODY):
            self._rest()
        elif self._deadline is None:
            self._n_bytes = 0
            self._deadline = self.loop.call_later(self.patience_s, self._give_up, self.conn.their_state)

    def _rest(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None

    def _give_up(self, state: Any) -> None:
        self._deadline = None
        # of a body, in every such time
        went_on = self.conn.their_state is not state or self._n_bytes >= 1000 or self.flow.read_paused
        if state is h11.SEND_BODY and went_on:  # read_paused: it is we who do not read
            self._watch()
        elif self.conn.their_state is state:
            self.transport.close()
        else:
            self._watch()


def warm_up(studio: Studio) -> None:
    """Load kernels, the forest and the index by one search and one pair; without a forest there is nothing to load.

    What is loaded then is left out of the search for cycles, which becomes as frequent as Python has it: by the command
    line's own measure it lets 0.3 million dead objects lie, 40 MB.
    """
    with suppress(DousaError):
        clips = [clip for clip in studio.library.clips() if clip.kind == "clip" and not clip.absent]
        if clips:
            motion = studio.library.trajectories(clips[0].id)
            encode_pair(motion, motion)
            studio.library.search(motion, 1)
    gc.collect()
    gc.freeze()
    gc.set_threshold(700, 10, 10)  # documentation of gc
