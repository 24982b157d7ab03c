"""Running the studio until somebody stops it."""

from __future__ import annotations

import os
import socket
import sys
import threading
import webbrowser
from contextlib import suppress
from dataclasses import replace

from dousa.app.studio.settings import Settings
from dousa.errors import MissingExtraError, OptionError

__all__ = ["serve"]

_ARENA_MAX, _MMAP_THRESHOLD = -8, -3  # names of malloc.h
_TRIES = 20  # ports after the one asked for


def serve(settings: Settings, *, opens_browser: bool = True) -> None:
    """Listen on this machine and show the address, until Ctrl-C.

    Parameters
    ----------
    settings : where, and for which library; a port that is taken is replaced by the next free one.
    opens_browser : show the page in the browser of this machine.

    Raises
    ------
    MissingExtraError : FastAPI or uvicorn is not installed.
    OptionError : no port is free.
    """
    _tame_memory()
    # Many small products for each request: threads of the linear algebra cost twice what they save.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        import uvicorn

        from dousa.app.studio.connections import PatientProtocol
        from dousa.app.studio.server import create_app
        from dousa.app.studio.warming import warm
    except ImportError as error:
        raise MissingExtraError(str(error.name), "studio") from error
    listener, port = _listen(settings)
    with listener:
        settings = replace(settings, port=port)
        app = create_app(settings)
        config = uvicorn.Config(
            app, http=PatientProtocol, ws="none", proxy_headers=False, server_header=False, access_log=False,
            log_level="error",  # what others send that is no HTTP is nothing for the terminal
            timeout_keep_alive=30, timeout_graceful_shutdown=3, limit_concurrency=200,
        )  # fmt: skip
        server = uvicorn.Server(config)
        sys.stderr.write(f"dousa studio of {settings.library}: {settings.address}\n(Ctrl-C stops it)\n")
        sys.stderr.flush()
        threading.Thread(target=warm, args=(app.state.studio,), daemon=True).start()
        if opens_browser:
            threading.Timer(0.5, webbrowser.open, [settings.address]).start()
        with suppress(KeyboardInterrupt):  # the usual end
            server.run(sockets=[listener])
        sys.stderr.write(
            "the studio has stopped; jobs that were under way can be taken up again in the next one\n"
        )


def _tame_memory() -> None:
    """Let memory go back to the system: glibc keeps a heap for every thread, and what is freed in it stays there."""
    if not sys.platform.startswith("linux"):
        return
    import ctypes

    with suppress(OSError, AttributeError):  # another C library
        libc = ctypes.CDLL("libc.so.6")
        libc.mallopt(_ARENA_MAX, 2)
        libc.mallopt(_MMAP_THRESHOLD, 256 * 1024)


def _listen(settings: Settings) -> tuple[socket.socket, int]:
    """A socket that waits for calls, and its port."""
    for port in range(settings.port, min(settings.port + _TRIES, 65536)):
        # The protocol is named, else asyncio does not switch Nagle off, and small answers wait 40 ms.
        listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM, socket.IPPROTO_TCP)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind((settings.host, port))
        except OSError:
            listener.close()
            continue
        listener.listen(128)
        return listener, listener.getsockname()[1]
    raise OptionError(
        f"no free port from {settings.port} to {settings.port + _TRIES - 1}; choose another with --port"
    )
