"""Workers of studios as forks of one program that has loaded what they load: a second of processor time less for each.

A worker is still a process of its own, with pipes, signals and an end of its own; that it starts from nothing, too, is
what the tests of jobs try, which have it so (the mark ``plain_workers``).
"""

import array
import contextlib
import importlib
import json
import os
import pkgutil
import select
import signal
import socket
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

_N_FILES = 4  # standard input, output, errors, and where is told what becomes of it
_ROOMS = ("app.studio.work", "app.pipelines", "library", "retrieval", "estimation", "formats", "motion")


class _Worker:
    """What `subprocess.Popen` is to the studio, of a process that the program with the libraries has forked."""

    def __init__(self, control: socket.socket, stdin: Any, stdout: Any, errors: Any) -> None:
        assert stdin == stdout == subprocess.PIPE
        self.returncode: int | None = None
        self._lock = threading.Lock()
        self._news, theirs = socket.socketpair()
        reads, self_writes = os.pipe()
        self_reads, writes = os.pipe()
        null = os.open(os.devnull, os.O_WRONLY)
        told = null if errors == subprocess.DEVNULL else errors if isinstance(errors, int) else errors.fileno()
        try:
            files = array.array("i", [reads, writes, told, theirs.fileno()])
            control.sendmsg([b"+"], [(socket.SOL_SOCKET, socket.SCM_RIGHTS, files)])
        finally:
            for file in (reads, writes, null):
                os.close(file)
            theirs.close()
        self._lines = self._news.makefile("rb")
        self._news.sendall(json.dumps({"environment": dict(os.environ), "folder": os.getcwd()}).encode() + b"\n")
        self.pid = int(self._lines.readline())
        self.stdin = os.fdopen(self_writes, "wb")
        self.stdout = os.fdopen(self_reads, "rb")
        self.stderr = None

    def poll(self) -> int | None:
        """The exit status, None while it runs."""
        with self._lock:
            if self.returncode is None and select.select([self._news], [], [], 0)[0]:
                self.returncode = int(self._lines.readline())
                self._lines.close()
                self._news.close()
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """The exit status when it has ended."""
        end = None if timeout is None else time.monotonic() + timeout
        while self.poll() is None:
            left = None if end is None else end - time.monotonic()
            if left is not None and left < 0:
                raise subprocess.TimeoutExpired("worker", timeout or 0.0)
            with contextlib.suppress(ValueError, OSError):  # another thread has just heard it
                select.select([self._news], [], [], left)
        assert self.returncode is not None
        return self.returncode

    def send_signal(self, number: int) -> None:
        """A signal, if it still runs."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        """Its end."""
        self.send_signal(signal.SIGKILL)


@contextmanager
def use_forks() -> Iterator[SimpleNamespace]:
    """What `subprocess` is to ``dousa.app.studio.jobs.lanes``, with workers that are forked."""
    from dousa.app.studio.jobs import lanes

    lock, started = threading.Lock(), list[tuple[socket.socket, subprocess.Popen[bytes]]]()

    def start(command: Sequence[str], **options: Any) -> Any:
        if list(command) != [sys.executable, "-m", lanes._WORKER]:
            return subprocess.Popen(command, **options)
        with lock:
            if not started:
                started.append(_start_program())
            return _Worker(started[0][0], options["stdin"], options["stdout"], options["stderr"])

    names = {name: getattr(subprocess, name) for name in ("PIPE", "DEVNULL", "TimeoutExpired")}
    try:
        yield SimpleNamespace(Popen=start, **names)
    finally:
        for control, program in started:
            control.close()
            program.wait()


def _start_program() -> tuple[socket.socket, subprocess.Popen[bytes]]:
    ours, theirs = socket.socketpair()
    with theirs:
        words = [sys.executable, __file__, str(theirs.fileno())]
        return ours, subprocess.Popen(words, pass_fds=[theirs.fileno()], stdin=subprocess.DEVNULL)


def _load() -> None:
    """All that work may need, with the kernels' compiler; what is not installed here is passed over."""
    os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", "200000000")  # as the worker, which must come before OpenCV
    import numba

    from dousa.errors import DousaError

    for room in _ROOMS:
        package = importlib.import_module(f"dousa.{room}")
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            with contextlib.suppress(ImportError, DousaError):
                importlib.import_module(module.name)
    numba.njit(lambda x: x + 1)(1)


def _become_worker(files: Sequence[int], asked: dict[str, Any]) -> None:
    """The forked process; it does not come back."""
    code = 1
    try:
        os.setsid()
        for number, file in enumerate(files[:3]):
            os.dup2(file, number)
        os.closerange(3, 100)
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        os.environ.clear()
        os.environ.update(asked["environment"])
        os.chdir(asked["folder"])
        from dousa.app.studio.work import worker

        worker.main()
        code = 0
    except SystemExit as stop:
        code = stop.code if isinstance(stop.code, int) else int(stop.code is not None)
    except BaseException:
        traceback.print_exc()
    finally:
        with contextlib.suppress(Exception):
            sys.stdout.flush()
            sys.stderr.flush()
        os._exit(code)


def _serve(control: socket.socket) -> None:
    """Fork for whoever asks, and say how it ended."""
    woken, wake = os.pipe()
    os.set_blocking(wake, False)
    os.set_blocking(woken, False)
    signal.set_wakeup_fd(wake, warn_on_full_buffer=False)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    told: dict[int, socket.socket] = {}
    while True:
        ready = select.select([control, woken], [], [])[0]
        if woken in ready:
            os.read(woken, 1000)
            _tell_ends(told)
        if control in ready:
            files = array.array("i")
            message, more, *_ = control.recvmsg(1, socket.CMSG_SPACE(_N_FILES * files.itemsize))
            if not message:
                return
            for _, _, data in more:
                files.frombytes(data)
            news = socket.socket(fileno=files[3])
            asked = json.loads(news.makefile("rb").readline())
            pid = os.fork()
            if not pid:
                _become_worker(files, asked)
            for file in files[:3]:
                os.close(file)
            told[pid] = news
            news.sendall(b"%d\n" % pid)


def _tell_ends(told: dict[int, socket.socket]) -> None:
    for pid, news in list(told.items()):
        ended, status = os.waitpid(pid, os.WNOHANG)
        if ended:
            with contextlib.suppress(OSError), news:
                news.sendall(b"%d\n" % os.waitstatus_to_exitcode(status))
            del told[pid]


if __name__ == "__main__":
    _load()
    with socket.socket(fileno=int(sys.argv[1])) as channel:
        _serve(channel)
