"""One address for the studios of all tests, one after the other: a browser keeps its process and the scripts that it
has compiled only for the address that it shows already, and half of what a page costs is those."""

import asyncio
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import AbstractAsyncContextManager, contextmanager
from typing import Any

import uvicorn
from starlette.responses import HTMLResponse

from app.browser import Page
from app.studio.firefox import Firefox
from dousa.app.studio.core.guard import with_headers
from patience import PATIENCE

_EMPTY = HTMLResponse("<!doctype html><html lang=en><title>nothing</title><link rel=icon href=data:,>")
_NOTHING = "/nothing-of-the-tests"


@contextmanager
def run_app(app: Any, listener: socket.socket, log_level: str = "warning", **options: Any) -> Iterator[None]:
    """Answer what comes to a socket, in a thread."""
    server = uvicorn.Server(uvicorn.Config(app, log_level=log_level, access_log=False, **options))
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]}, daemon=True)
    thread.start()
    while not server.started:
        time.sleep(0.01)
    try:
        yield
    finally:
        server.should_exit = True
        thread.join(timeout=PATIENCE)


class Address:
    """A server in a thread, on a free port: what it is asked goes to the studio of the test that is under way."""

    def __init__(self) -> None:
        self.port = 0
        self._app: Any = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._n_asked = 0  # that are being answered

    @property
    def url(self) -> str:
        """Where, without a slash at its end."""
        return f"http://127.0.0.1:{self.port}"

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        """What the server calls."""
        if scope["type"] == "lifespan":
            self._loop = asyncio.get_running_loop()
            for step in ("startup", "shutdown"):
                await receive()
                await send({"type": f"lifespan.{step}.complete"})
            return
        if self._app is None or scope["path"] == _NOTHING:
            await _EMPTY(scope, receive, with_headers(send))
            return
        self._n_asked += 1
        try:
            await self._app({**scope, "app": self._app}, receive, send)
        finally:
            self._n_asked -= 1

    @contextmanager
    def open(self) -> Iterator[None]:
        """Listen."""
        with socket.socket(proto=socket.IPPROTO_TCP) as listener:
            listener.bind(("127.0.0.1", 0))
            self.port = listener.getsockname()[1]
            with run_app(self, listener):
                yield

    @contextmanager
    def serve(self, app: Any) -> Iterator[None]:
        """Let a studio answer, until it has answered all that it was asked."""
        assert self._app is None and self._loop is not None
        living: AbstractAsyncContextManager[Any] = app.router.lifespan_context(app)
        self._wait(living.__aenter__())
        self._app = app
        try:
            yield
        finally:
            self._app = None
            end = time.monotonic() + PATIENCE
            while self._n_asked and time.monotonic() < end:
                time.sleep(0.005)
            self._wait(living.__aexit__(None, None, None))

    def _wait(self, work: Any) -> None:
        assert self._loop is not None
        asyncio.run_coroutine_threadsafe(work, self._loop).result(PATIENCE)

    def leave(self, page: Page) -> None:
        """Show nothing, and forget what pages of this address have kept: the next test finds a fresh browser."""
        page.driver.get(f"{self.url}{_NOTHING}")
        page.run("sessionStorage.clear()")
        page.driver.execute_cdp_cmd("Storage.clearDataForOrigin", {"origin": self.url, "storageTypes": "all"})

    def leave_firefox(self, page: Firefox) -> None:
        """The same with a Firefox."""
        page.open(f"{self.url}{_NOTHING}")
        page.run("(sessionStorage.clear(), localStorage.clear())")
