"""Programs of the user: finding one, and running it in its own folder for a limited time."""

from __future__ import annotations

import glob
import importlib
import os
import shutil
import signal
import subprocess
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from dousa.errors import DousaError, OptionError

_USUAL_PLACES = {
    "blender": (
        "/Applications/Blender.app/Contents/MacOS/Blender",
        "C:/Program Files/Blender Foundation/Blender */blender.exe",
    ),
    "assimp": (),
}
_TITLES = {"blender": "Blender", "assimp": "assimp", "usd": "usd-core"}
_MOST_LOG, _MOST_RESULT = 50_000_000, 4_000_000_000  # bytes
_MOST_MEMORY = {"assimp": 4_000_000_000}  # bytes; Blender reserves more than it takes


class ProgramError(DousaError):
    """The other program failed."""


@dataclass(frozen=True, slots=True)
class Program:
    """A program of this machine: name and path."""

    name: str
    path: str

    @property
    def title(self) -> str:
        """The maker's spelling of the name."""
        return _TITLES[self.name]


def find_program(name: str) -> Program | None:
    """Find ``"blender"`` or ``"assimp"``: by DOUSA_BLENDER or DOUSA_ASSIMP, on PATH, or in its usual place.

    OptionError if the variable names no program.
    """
    variable = f"DOUSA_{name.upper()}"
    named = os.environ.get(variable)
    if named:
        found = shutil.which(named)
        if found is None:
            raise OptionError("exchange.not_found", variable=variable, path=named)
        return Program(name, os.path.abspath(found))
    found = shutil.which(name)
    usual = (path for pattern in _USUAL_PLACES[name] for path in sorted(glob.glob(pattern), reverse=True))
    path = found or next(usual, None)
    return None if path is None else Program(name, os.path.abspath(path))


def is_named(name: str) -> bool:
    """Return whether a variable names the program."""
    return bool(os.environ.get(f"DOUSA_{name.upper()}"))


def run_program(program: Program, words: Sequence[str], folder: str, result: str) -> None:
    """Run a program to its end and check that it made a file.

    Parameters
    ----------
    program : to run.
    words : after its name.
    folder : where it works and its output is kept; empty.
    result : path of the file to be made.

    Raises
    ------
    ProgramError : it cannot be started, fails, does not end in time, makes nothing.
    """
    seconds = _time_limit()
    log = os.path.join(folder, "log.txt")
    with open(log, "wb") as output:
        try:
            process = subprocess.Popen(
                [program.path, *words], stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT, cwd=folder,
                start_new_session=True,
            )  # fmt: skip
        except OSError as error:
            raise ProgramError("exchange.no_start", program=program.title, reason=error) from error
        try:
            _limit_memory(process.pid, _MOST_MEMORY.get(program.name, 0))
            end = time.monotonic() + seconds
            while process.poll() is None:
                if time.monotonic() > end:
                    raise ProgramError("exchange.hangs", program=program.title, seconds=seconds)
                if os.path.getsize(log) > _MOST_LOG:
                    raise ProgramError("exchange.failed", program=program.title, reason="-")
                with suppress(subprocess.TimeoutExpired):
                    process.wait(0.02)
        finally:
            _kill(process)
    try:
        size = os.path.getsize(result)
    except OSError:
        size = 0
    if process.returncode or not size:
        raise ProgramError("exchange.failed", program=program.title, reason=_last_words(log))
    if size > _MOST_RESULT:
        raise ProgramError("disk.too_large")


def _time_limit() -> float:
    given = os.environ.get("DOUSA_PROGRAM_SECONDS")
    if given is None:
        return 300.0
    try:
        seconds = float(given)
    except ValueError:
        seconds = float("nan")
    if not 0 < seconds < 1e6:
        raise OptionError("exchange.seconds", found=given[:20])
    return seconds


def _limit_memory(pid: int, most: int) -> None:
    """Limit the memory of a process where the system can: a damaged file may ask for any."""
    with suppress(ImportError, AttributeError, OSError):
        resource: Any = importlib.import_module("resource")
        if most:
            resource.prlimit(pid, resource.RLIMIT_AS, (most, most))


def _kill(process: subprocess.Popen[bytes]) -> None:
    if process.poll() is None or os.name == "posix":
        with suppress(OSError):
            if os.name == "posix":
                os.killpg(process.pid, signal.SIGKILL)
            else:
                process.kill()
    process.wait()


def _last_words(log: str, longest: int = 160) -> str:
    """Last line of a program's log, preferably of an error; of at most so many letters."""
    with open(log, "rb") as file:
        file.seek(max(0, os.path.getsize(log) - 20_000))
        text = file.read().decode("utf-8", "replace")
    lines = ["".join(c for c in line if c.isprintable()).strip() for line in text.splitlines()]
    lines = [line for line in lines if line]
    errors = [line for line in lines if "error" in line.lower()]
    return (errors or lines or ["-"])[-1][:longest]
