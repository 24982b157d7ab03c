"""A lane whose work runs in a process of its own: progress comes as lines of JSON, stopping is Ctrl-C."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
from contextlib import suppress
from typing import IO, TYPE_CHECKING, Any

from dousa.app.studio.jobs.board import JobStopped
from dousa.errors import DousaError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from dousa.app.studio.jobs.board import Job, JobBoard
    from dousa.app.studio.settings import Settings

__all__ = ["WorkError", "kill", "run_in_process", "start_worker"]

_PATIENCE = 10.0  # s between asking a process to stop and ending it


class WorkError(DousaError):
    """The work of a process ended with a problem that it told."""


def start_worker(
    settings: Settings, kind: str, request: Mapping[str, Any], folder: Path, errors: IO[bytes] | int
) -> tuple[subprocess.Popen[bytes], bytes]:
    """A process that does work, and the line that it waits for on its standard input.

    Parameters
    ----------
    settings : of the studio.
    kind, request : of the work, see `dousa.app.studio.work`.
    folder : where it may write.
    errors : where its standard error goes.
    """
    task = {
        "kind": kind,
        "request": dict(request),
        "folder": str(folder),
        "library": str(settings.library),
        "home": str(settings.folder),
    }
    process = subprocess.Popen(
        [sys.executable, "-m", "dousa.app.studio.jobs.worker"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=errors,
        start_new_session=True,  # Ctrl-C in the terminal reaches the studio, which stops its work itself
    )
    return process, json.dumps(task).encode() + b"\n"


def run_in_process(settings: Settings) -> Callable[[Job, JobBoard, threading.Event], dict[str, Any]]:
    """What does jobs of any kind of `dousa.app.studio.work` in a new process each."""

    def run(job: Job, board: JobBoard, stop: threading.Event) -> dict[str, Any]:
        folder = board.folder(job)
        with open(folder / "log.txt", "ab") as log:
            process, task = start_worker(settings, job.kind, job.request, folder, log)
        watcher = threading.Thread(target=_end_when, args=(stop, process), daemon=True)
        watcher.start()
        try:
            return _listen(process, task, job, board, stop)
        finally:
            _end(process)
            stop.set()  # lets the watcher go
            watcher.join()

    return run


def _listen(
    process: subprocess.Popen[bytes], task: bytes, job: Job, board: JobBoard, stop: threading.Event
) -> dict[str, Any]:
    stdin, stdout = process.stdin, process.stdout
    assert stdin is not None and stdout is not None
    with suppress(OSError):
        stdin.write(task)
        stdin.flush()  # stays open: its end tells the process that the studio is gone
    last = _take_messages(stdout, job, board)
    process.wait()
    if "result" in last:
        result: dict[str, Any] = last["result"]
        return result
    if stop.is_set():
        raise JobStopped
    if "problem" in last:
        raise WorkError(last["problem"])
    why = ", perhaps for want of memory" if process.returncode == -9 else ""
    raise WorkError(
        f"the work ended unexpectedly{why} (code {process.returncode}); see {board.folder(job) / 'log.txt'}"
    )


def _take_messages(stdout: IO[bytes], job: Job, board: JobBoard) -> dict[str, Any]:
    """Pass on progress and notes; the last word of the process."""
    last: dict[str, Any] = {}
    for line in stdout:
        with suppress(ValueError):
            message = json.loads(line)
            if "progress" in message:
                done, total, what = message["progress"]
                board.change(job, done=done, total=total, what=what)
            elif "note" in message:
                board.change(job, notes=[*job.notes, message["note"]])
            else:
                last = message
    return last


def _end_when(stop: threading.Event, process: subprocess.Popen[bytes]) -> None:
    """Ctrl-C, and the end for what does not hear it: a decoder or a product of matrices looks up late."""
    stop.wait()
    if process.poll() is None:
        with suppress(OSError):
            process.send_signal(signal.SIGINT if os.name == "posix" else signal.SIGTERM)
        with suppress(subprocess.TimeoutExpired):
            process.wait(timeout=_PATIENCE)
        if process.poll() is None:
            kill(process)


def kill(process: subprocess.Popen[bytes]) -> None:
    """End a process that was started in a session of its own, and what it started itself."""
    if process.poll() is not None:
        return
    with suppress(OSError):
        if os.name == "posix":
            os.killpg(process.pid, signal.SIGKILL)
        else:
            process.kill()


def _end(process: subprocess.Popen[bytes]) -> None:
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            with suppress(OSError):
                pipe.close()
    try:
        process.wait(timeout=_PATIENCE)
    except subprocess.TimeoutExpired:
        kill(process)
        process.wait()
