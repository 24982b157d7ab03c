"""Run work in its own process, where progress comes as lines of JSON and Ctrl-C stops it, or in a thread of the studio,
where the kernels and the library are loaded already."""

from __future__ import annotations

import json
import os
import pickle
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, TypeVar

from dousa.app.studio.core.answers import Gate, RefusedError, pack, say_packed, to_message
from dousa.app.studio.core.workspace import Settings
from dousa.app.studio.jobs.board import LOG, Job, JobBoard, JobStopped
from dousa.errors import DousaError
from dousa.messages import Message, get_language

if TYPE_CHECKING:
    from dousa.library import Library

READING = b"read\n"
"""Sent to a process that reads on request; pickled questions follow, and pickled answers come back."""

_WORKER = "dousa.app.studio.work.worker"  # the module that a process runs
READY = '{"ready": true}\n'
"""The first line of a process: it hears Ctrl-C and waits for its task."""

Progress = Callable[[int, int, Message | str], None]
"""Called with (done, total, what is being done); raises when the job was stopped."""


@dataclass(frozen=True, slots=True)
class Context:
    """What work is given.

    Parameters
    ----------
    library : file of the library.
    home : folder of the studio, see `dousa.app.studio.core.workspace.Workspace`.
    folder : of the job.
    progress : see `Progress`.
    tell : called with messages for the user.
    """

    library: Path
    home: Path
    folder: Path
    progress: Progress
    tell: Callable[[Message | str], None]

    def open_library(self) -> Library:
        """Open the library; the studio made it, so a missing one was deleted."""
        from dousa.library import Library

        return Library.open(self.library)


class WorkError(DousaError):
    """The problem that the process of a job reported."""


def start_worker(
    settings: Settings,
    kind: str,
    request: Mapping[str, Any],
    folder: Path,
    errors: IO[bytes] | int,
) -> tuple[subprocess.Popen[bytes], bytes]:
    """Start a process that does a job in the current language; returns it with the line for its standard input.

    Parameters
    ----------
    settings : of the studio.
    kind, request : of the work, see `dousa.app.studio.work.worker`.
    folder : of the job; the process waits for one of a killed studio that is still ending there.
    errors : where its standard error goes.
    """
    task = {
        "language": get_language(),
        "kind": kind,
        "request": dict(request),
        "folder": str(folder),
        "library": str(settings.library),
        "home": str(settings.folder),
    }
    return _start(errors), json.dumps(task).encode() + b"\n"


def _start(errors: IO[bytes] | int) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, "-m", _WORKER],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=errors,
        start_new_session=True,  # Ctrl-C in the terminal reaches the studio, which stops its work itself
    )


Result = TypeVar("Result")


class Reader:
    """Processes that read files from elsewhere, with limits of memory and time: one ends, and the studio does not.

    Each is started when it is needed, and used again.

    Parameters
    ----------
    memory : bytes that a process may have; None for any number.
    at_once, waiting, busy : of the `Gate` before them.
    """

    def __init__(
        self, memory: int | None, at_once: int = 2, waiting: int = 12, busy: str = "studio_motions.busy_reading"
    ) -> None:
        self._memory = memory
        self._gate = Gate(at_once, waiting, Message(busy))
        self._lock = threading.Lock()
        self._idle: list[subprocess.Popen[bytes]] = []
        self._under_way: dict[object, subprocess.Popen[bytes]] = {}

    def run(self, function: Callable[..., Result], *args: Any, seconds: float = 60.0, about: object = None) -> Result:
        """Return the result of a function of a module, or raise its error.

        An older question ``about`` the same thing is dropped. Raises RefusedError if it takes longer than ``seconds``
        or too much memory, if too many others wait, or if a newer question came.
        """
        with self._lock:
            if (older := self._under_way.pop(about, None)) is not None:
                kill(older)
        with self._gate.enter(seconds):
            with self._lock:
                alive = [process for process in self._idle if process.poll() is None]
                process = alive.pop() if alive else None
                self._idle = alive
            if process is None:
                process = self._begin()
            if about is not None:
                self._under_way[about] = process
            ran_out = threading.Event()

            def end(process: subprocess.Popen[bytes] = process) -> None:
                ran_out.set()
                kill(process)

            timer = threading.Timer(seconds, end)
            timer.start()
            try:
                done, answer = _converse(process, (get_language(), seconds, function, args))
            except (OSError, EOFError, pickle.UnpicklingError):
                if ran_out.is_set():
                    raise RefusedError(422, "studio_jobs.took_long", seconds=seconds) from None
                if about is not None and self._under_way.get(about) is not process:
                    raise RefusedError(409, "studio_jobs.replaced") from None
                raise RefusedError(422, "studio_jobs.no_answer") from None
            finally:
                timer.cancel()
                timer.join()  # it may be killing: of a process that is used again nothing may be under way
                with self._lock:
                    replaced = about is not None and self._under_way.get(about) is not process
                    if about is not None and not replaced:
                        del self._under_way[about]
            if ran_out.is_set() or replaced:
                _end(process)
            else:
                with self._lock:
                    self._idle.append(process)
        if not done:
            raise answer
        result: Result = answer
        return result

    def _begin(self) -> subprocess.Popen[bytes]:
        process = _start(subprocess.DEVNULL)
        assert process.stdin is not None and process.stdout is not None
        process.stdout.readline()  # READY
        with suppress(OSError):
            process.stdin.write(READING)
            pickle.dump(self._memory, process.stdin)
            process.stdin.flush()
        return process

    def close(self) -> None:
        """End the processes."""
        with self._lock:
            for process in self._idle:
                kill(process)
                _end(process)
            self._idle = []


def _converse(process: subprocess.Popen[bytes], question: Any) -> tuple[bool, Any]:
    """Ask a process; a process that fails, or that is left in the middle, is ended."""
    assert process.stdin is not None and process.stdout is not None
    try:
        pickle.dump(question, process.stdin)
        process.stdin.flush()
        answer: tuple[bool, Any] = pickle.load(process.stdout)
    except BaseException:
        kill(process)
        _end(process)
        raise
    return answer


def load_work(name: str) -> Callable[[dict[str, Any], Context], dict[str, Any]]:
    """Import a function of the rooms of work by the names of its module and its own, such as ``library.add``."""
    module, _, function = name.partition(".")
    work: Callable[[dict[str, Any], Context], dict[str, Any]] = getattr(
        import_module(f"dousa.app.studio.work.{module}"), function
    )
    return work


def answer_question(name: str, request: dict[str, Any], library: Path, home: Path, folder: Path) -> dict[str, Any]:
    """Do short work that nobody watches, for a `Reader`; its messages are rendered in the current language."""
    context = Context(library, home, folder, lambda done, total, what: None, lambda note: None)
    found: dict[str, Any] = say_packed(pack(load_work(name)(request, context)))
    return found


def run_in_process(settings: Settings) -> Callable[[Job, JobBoard, threading.Event], dict[str, Any]]:
    """Make the function that runs each job in a new process."""

    def run(job: Job, board: JobBoard, stop: threading.Event) -> dict[str, Any]:
        folder = board.folder(job)
        with open(folder / LOG, "ab") as log:
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
    stdout.readline()  # READY: a signal sent before it could be lost, with the job going on to its end
    if stop.is_set():
        raise JobStopped
    with suppress(OSError):
        stdin.write(task)
        stdin.flush()  # stays open: its end tells the process that the studio is gone
    kind, said = _read_lines(stdout, job, board)
    _await_end(process)
    if kind == "result" and isinstance(said, dict):
        return said
    if stop.is_set():
        raise JobStopped
    if kind == "problem":
        raise WorkError(said)
    log = board.folder(job) / LOG
    code = "studio_jobs.killed" if process.returncode == -9 else "studio_jobs.ended"
    raise WorkError(code, status=process.returncode, log=log, last=_read_last_line(log))


def _read_lines(stdout: IO[bytes], job: Job, board: JobBoard) -> tuple[str, Any]:
    """Follow a process up to its answer, and return the kind of that and what it says; ("", None) if it has none.

    A line that is no message, of a program that writes where it should not, goes into the log.
    """
    for line in stdout:
        try:
            ((kind, said),) = json.loads(line).items()
            if kind == "progress":
                done, total, what = said
                board.change(job, done=int(done), total=int(total), what=Message.from_json(what))
            elif kind == "note":
                board.change(job, notes=[*job.notes, Message.from_json(said)])
            elif kind == "problem":
                return kind, Message.from_json(said)
            elif kind in ("result", "stopped"):
                return kind, said
        except (ValueError, TypeError, AttributeError, KeyError, RecursionError):
            with suppress(OSError), open(board.folder(job) / LOG, "ab") as log:
                log.write(line)
    return "", None


def _read_last_line(log: Path) -> str:
    """Return the last line of a log that says something; of an uncaught error it is the error."""
    with suppress(OSError):
        lines = log.read_text(encoding="utf-8", errors="replace")[-10_000:].split("\n")
        return next((line.strip()[:300] for line in reversed(lines) if line.strip()), "-")
    return "-"


def _end_when(stop: threading.Event, process: subprocess.Popen[bytes]) -> None:
    """Send Ctrl-C, and kill a process that does not react."""
    stop.wait()
    if process.poll() is None:
        with suppress(OSError):
            process.send_signal(signal.SIGINT if os.name == "posix" else signal.SIGTERM)
        _await_end(process)


def _await_end(process: subprocess.Popen[bytes], *, patience_s: float = 10.0) -> None:
    """Kill a process that has not ended by itself within ``patience_s``.

    Decoders and large products of matrices react late; killed sooner, more would lose what they have done.
    """
    with suppress(subprocess.TimeoutExpired):
        process.wait(timeout=patience_s)
    kill(process)


def kill(process: subprocess.Popen[bytes]) -> None:
    """Kill a process with its own session, and its children."""
    if process.poll() is not None:
        return
    with suppress(OSError):
        if os.name == "posix":
            os.killpg(process.pid, signal.SIGKILL)
        else:
            process.kill()


def _end(process: subprocess.Popen[bytes]) -> None:
    """Close the pipes of a process that has answered, and see it end."""
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            with suppress(OSError):
                pipe.close()
    _await_end(process)
    process.wait()


def run_in_thread(
    settings: Settings, work: Callable[[dict[str, Any], Context], dict[str, Any]]
) -> Callable[[Job, JobBoard, threading.Event], dict[str, Any]]:
    """Make the function that runs each job of a kind in the thread of its lane."""

    def run(job: Job, board: JobBoard, stop: threading.Event) -> dict[str, Any]:
        def progress(done: int, total: int, what: Message | str) -> None:
            if stop.is_set():
                raise JobStopped
            board.change(job, done=int(done), total=int(total), what=to_message(what))

        def tell(note: Message | str) -> None:
            board.change(job, notes=[*job.notes, to_message(note)])

        return work(job.request, Context(settings.library, settings.folder, board.folder(job), progress, tell))

    return run
