"""Sends a file through the doors that a user has, and judges what comes out against what is known of it."""

from __future__ import annotations

import contextlib
import dataclasses
import io
import json
import re
import signal
import sys
import traceback
from collections.abc import Iterator
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

import dousa

VERDICTS = ("right", "told", "error", "vague", "WRONG", "trace")
CLOSE = 0.001  # m: the accuracy of marker systems
NEAR = 0.1  # m: a place that was lost may be filled in, but near where it was
SLOW = 20  # s: what issue 36 allows for any file of 50 MB
PLACE = r":\d|line|row|frame|byte|joint|bone|channel|column|marker|point|node|segment|accessor|buffer|header|" \
        r"parameter|field|chunk|zip file|sampler|key|type|version|element|array|shape|'[^']+'|[A-Z]{4}"  # fmt: skip


class TooSlow(BaseException):
    """The time for a case is over."""


@contextlib.contextmanager
def time_limit(seconds: float = SLOW) -> Iterator[None]:
    """Stop what takes too long."""

    def stop(*_: object) -> None:
        raise TooSlow

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


@dataclasses.dataclass(frozen=True)
class Answer:
    """What a command gave."""

    code: int
    out: str
    err: str
    trace: str = ""

    @property
    def info(self) -> list[dict[str, Any]]:
        """The entries of `dousa info --json`."""
        return json.loads(self.out) if self.out.strip().startswith("[") else []

    @property
    def notes(self) -> list[str]:
        """All that was said beside the answer."""
        said = [note for entry in self.info for note in entry["warnings"]]
        return said + [line for line in self.err.splitlines() if line.strip()]


def run(*words: str | Path) -> Answer:
    """Run the command line in this process."""
    (command,) = entry_points(group="console_scripts", name="dousa")
    out, err, code, trace = io.StringIO(), io.StringIO(), 0, ""
    argv = ["dousa", "--lang", "en", "-j", "1", *map(str, words)]
    with mock.patch.object(sys, "argv", argv), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            with time_limit(3 * SLOW):
                code = command.load()() or 0
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else int(end.code is not None)
        except TooSlow:
            trace = "took too long"
        except BaseException:
            trace = traceback.format_exc().strip().splitlines()[-1]
    if "Traceback" in err.getvalue():
        trace = trace or err.getvalue().strip().splitlines()[-1]
    return Answer(code, out.getvalue(), err.getvalue(), trace)


@dataclasses.dataclass(frozen=True)
class Read:
    """What `read_motion` gave: names, places (T, K, 3), rate, number of roots; or its error."""

    names: tuple[str, ...] = ()
    places: np.ndarray | None = None
    rate: float = 0.0
    roots: int = 0
    error: str = ""
    trace: str = ""


def read(path: Path, frame_rate: float | None = None) -> Read:
    """Read a file as a program does."""
    try:
        with time_limit():
            motion = dousa.read_motion(path, frame_rate=frame_rate)
            points = motion if isinstance(motion, dousa.Trajectories) else dousa.compute_trajectories(motion)
    except TooSlow:
        return Read(trace="took too long")
    except Exception as error:
        if type(error).__module__.startswith("dousa"):
            return Read(error=str(error))
        return Read(trace=f"{type(error).__name__}: {error}"[:200])
    roots = sum(p < 0 for p in motion.skeleton.parents) if isinstance(motion, dousa.Motion) else 0
    return Read(tuple(points.names), np.asarray(points.positions, float), float(motion.frame_rate), int(roots))


@dataclasses.dataclass(frozen=True)
class Control:
    """How the unharmed file of a format is read: point by point which joint of the truth it is, notes, stature."""

    names: tuple[str, ...]
    joints: np.ndarray
    notes: frozenset[str]
    stature: float
    worst: float


def stem(note: str, path: Path) -> str:
    """Strip what differs from file to file from a note."""
    return re.sub(r"[-+\d.e]+", "#", note.replace(str(path), "").replace(path.name, ""))


def turned(places: np.ndarray, quarter: int) -> np.ndarray:
    """Turn places about the vertical axis by quarters: formats do not say where a person looks."""
    for _ in range(quarter):
        places = np.stack([places[..., 2], places[..., 1], -places[..., 0]], axis=-1)
    return places


def make_control(found: Read, truth: np.ndarray, answer: Answer, path: Path) -> Control | None:
    """Find which point is which joint; None where the file was not read."""
    if found.places is None or len(found.places) != len(truth):
        return None
    apart = np.abs(found.places[:, :, None] - truth[:, None]).max(axis=(0, 3))
    joints = np.where(apart.min(axis=1) < CLOSE, apart.argmin(axis=1), -1)
    expected = [j for j in range(truth.shape[1]) if j in joints]
    notes = frozenset(stem(n, path) for n in answer.notes)
    stature = float(answer.info[0]["stature_m"] or 0) if answer.info else 0.0
    return Control(found.names, joints, notes, stature, 0.0 if len(expected) >= 20 else float("inf"))


def matched(found: Read, control: Control) -> np.ndarray | None:
    """Put the places that were read into the order of the control's points: by name, else by number."""
    assert found.places is not None
    for bare in (lambda n: n, lambda n: re.sub(r"^.*:|_JNT$|_bind$", "", n)):
        at = {bare(n): i for i, n in reversed(list(enumerate(found.names)))}
        if all(bare(n) in at for n in control.names):
            return found.places[:, [at[bare(n)] for n in control.names]]
    return found.places if found.places.shape[1] == len(control.names) else None


def compare(
    found: Read, control: Control, truth: np.ndarray, rate: float, lost: np.ndarray, *, shape: bool = False
) -> str:
    """Say what is off, or nothing. Of a cell that was lost, nothing or a place near the true one is right."""
    assert found.places is not None
    if len(found.places) != len(truth):
        return f"{len(found.places)} frames for {len(truth)}"
    if abs(found.rate / rate - 1) > 2e-3:
        return f"{found.rate:.4g} Hz for {rate:g}"
    places = matched(found, control)
    if places is None:
        return f"{found.places.shape[1]} points for {len(control.names)}"
    known = control.joints >= 0
    want, gone = truth[:, control.joints[known]], lost[:, control.joints[known]]
    best = np.inf
    for quarter in range(4):
        off = turned(places[:, known], quarter) - want
        off = off - np.nanmedian(off, axis=(0, 1)) if shape else off
        away = np.abs(off).max(axis=-1)
        here = np.where(np.isnan(away), np.where(gone, 0, np.inf), np.where(gone & (away < NEAR), 0, away))
        best = min(best, float(here.max()))
    return "" if best < CLOSE else f"off by {best:.3g} m"


def named(message: str, path: Path) -> str:
    """Judge an error: does it name the file and a place in it?"""
    own = [p.name for p in path.parent.iterdir()]
    rest = message
    for name in (str(path.parent), *own):
        rest = rest.replace(name, "")
    return "error" if any(n in message for n in own) and re.search(PLACE, rest) else "vague"
