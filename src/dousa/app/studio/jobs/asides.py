"""Short work in a process of its own while the request waits: what reads strange files keeps no memory here."""

from __future__ import annotations

import json
import subprocess
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

from dousa.app.studio.gates import Gate
from dousa.app.studio.jobs.processes import kill, start_worker
from dousa.app.studio.problems import RefusedError
from dousa.app.studio.settings import Settings

__all__ = ["ask_process"]

_gate = Gate(2, 6, "other files are being looked at; try again in a moment")
_lock = threading.Lock()
_under_way: dict[str, subprocess.Popen[bytes]] = {}


def ask_process(
    settings: Settings, kind: str, request: dict[str, Any], folder: Path, seconds: float
) -> dict[str, Any]:
    """The result of work of `dousa.app.studio.work`.

    Parameters
    ----------
    settings : of the studio.
    kind, request : of the work; an older question about the same batch is given up.
    folder : where it may write.
    seconds : it may take.

    Raises
    ------
    RefusedError : it told a problem, took too long or ended without an answer.
    """
    key = f"{settings.folder} {kind} {request.get('batch')}"
    with _lock:
        older = _under_way.get(key)
        if older is not None:
            kill(older)
    with _gate.enter(seconds):
        start = partial(start_worker, settings, kind, request, folder, subprocess.DEVNULL)
        lines = _run(key, start, seconds)
    for line in reversed(lines):
        message = json.loads(line)
        if "result" in message:
            result: dict[str, Any] = message["result"]
            return result
        if "problem" in message:
            raise RefusedError(422, message["problem"])
    raise RefusedError(422, "these files could not be read to the end; are they what their names say?")


def _run(key: str, start: Callable[[], tuple[subprocess.Popen[bytes], bytes]], seconds: float) -> list[bytes]:
    process, task = start()
    with _lock:
        _under_way[key] = process
    ran_out = threading.Event()

    def end() -> None:
        ran_out.set()
        kill(process)

    timer = threading.Timer(seconds, end)
    timer.start()
    try:
        lines = _ask(process, task)
    finally:
        timer.cancel()
        with _lock:
            replaced = _under_way.get(key) is not process
            if not replaced:
                del _under_way[key]
    if ran_out.is_set():
        raise RefusedError(422, f"this took longer than {seconds:g} s; give less")
    if process.returncode < 0 and replaced:
        raise RefusedError(409, "the same files were asked about again; that answer counts")
    return lines


def _ask(process: subprocess.Popen[bytes], task: bytes) -> list[bytes]:
    """What the process says; it ends when its standard input does, so that is closed only afterwards."""
    assert process.stdin is not None and process.stdout is not None
    lines: list[bytes] = []
    with process.stdout, suppress(BrokenPipeError):
        process.stdin.write(task)
        process.stdin.flush()
        lines = process.stdout.read().splitlines()
    process.wait()
    with suppress(BrokenPipeError):
        process.stdin.close()
    return lines
