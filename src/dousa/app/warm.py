"""Compile ahead what commands compile at their first use, by using them: small jobs on made motions.

What each kernel is compiled for is written down nowhere: every part of the jobs runs in a process of its own, and what
it compiles stays in numba's cache for all later ones.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import asdict, dataclass, replace
from io import StringIO
from pathlib import Path
from typing import Any

from dousa.app.output import ProgressCallback
from dousa.errors import OptionError
from dousa.messages import Message

# The longest first. ``take`` and ``series`` are joined motions.
PARTS = {
    "library": (
        *("add moves.dousa motions", "train moves.dousa", "search moves.dousa new/walk.bvh --explain"),
        *("classify moves.dousa new", "find moves.dousa new/walk.bvh take.bvh", "label moves.dousa take.bvh"),
        "export moves.dousa --to glb -o exported",
    ),
    "estimation": ("render new/walk.bvh --ring 4 -o masks.npz", "estimate masks.npz --frames 0:12 -o estimated.bvh"),
    "evaluation": (
        "evaluate motions/walk/0.bvh --performance new/walk.bvh -o report",
        "evaluate motions/squat/0.bvh --performance series.bvh --repetitions",
        "count series.bvh",
    ),
}

_JOBS = (
    "import sys; from dousa.app.cli.main import make_application as make; from dousa.app.warm import run_jobs; "
    "run_jobs(make(), sys.argv[1])"
)


@dataclass(frozen=True, slots=True)
class WarmPart:
    """What is ready now.

    Parameters
    ----------
    part : of `PARTS`.
    compiled : functions that were compiled now; 0 if all were ready.
    seconds : on the clock.
    problem : why it is not ready; None if it is.
    """

    part: str
    compiled: int
    seconds: float
    problem: str | None

    def to_json(self) -> dict[str, Any]:
        """As a dictionary."""
        return asdict(self)


def warm(
    parts: Sequence[str] | None = None, n_jobs: int | None = None, progress: ProgressCallback | None = None
) -> list[WarmPart]:
    """Run the jobs of some parts, each part in a process; what was compiled is kept when this is interrupted.

    Parameters
    ----------
    parts : of `PARTS`; all by default.
    n_jobs : processes at once; every core by default.
    progress : called with (jobs done, jobs, what is being done).

    Raises
    ------
    OptionError : an unknown part.
    """
    for part in parts or ():
        if part not in PARTS:
            raise OptionError("warm.unknown_part", found=part, known=list(PARTS))
    n_jobs = n_jobs if n_jobs is not None and n_jobs > 0 else os.cpu_count() or 1
    chosen = [part for part in PARTS if not parts or part in parts]
    total, done = sum(len(PARTS[part]) for part in chosen), 0
    running: list[subprocess.Popen[str]] = []

    def run(part: str) -> WarmPart:
        nonlocal done
        started = time.perf_counter()
        command = [sys.executable, "-c", _JOBS, part]
        pipe = subprocess.PIPE
        with subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=pipe, stderr=pipe, text=True) as process:
            running.append(process)
            assert process.stdout is not None
            assert process.stderr is not None
            counts = [0]
            for line in process.stdout:
                counts.append(int(line))
                done += 1
                if progress is not None:
                    progress(done, total, Message("warm.compiling"))
            problem = process.stderr.read().strip().rpartition("\n")[2]
        seconds = time.perf_counter() - started
        return WarmPart(part, counts[-1], seconds, problem if process.returncode else None)

    threads = ThreadPoolExecutor(min(n_jobs, len(chosen) or 1))
    try:
        return list(threads.map(run, chosen))
    finally:
        threads.shutdown(wait=False, cancel_futures=True)  # so that none begins now
        for process in running:
            process.kill()
        threads.shutdown()


def _make_motions() -> None:
    import numpy as np

    from dousa.formats.registry import write_motion
    from dousa.motion import Motion
    from dousa.motion.synthetic import draw_performer, make_motion

    def join(motions: list[Motion]) -> Motion:
        turned, placed = zip(*((one.rotations, one.translations) for one in motions), strict=True)
        return replace(motions[0], rotations=np.concatenate(turned), translations=np.concatenate(placed))

    kinds, people = ("walk", "throw", "squat"), [draw_performer(number) for number in range(4)]
    made = {kind: [make_motion(kind, one) for one in people] for kind in kinds}
    for kind, motions in made.items():
        paths = [*(Path("motions", kind, f"{number}.bvh") for number in range(3)), Path("new", f"{kind}.bvh")]
        for path, motion in zip(paths, motions, strict=True):
            path.parent.mkdir(parents=True, exist_ok=True)
            write_motion(motion, path)
    write_motion(join([motions[-1] for motions in made.values()] * 3), "take.bvh")
    write_motion(join([made["squat"][1]] * 6), "series.bvh")


def run_jobs(app: Callable[..., object], part: str) -> None:
    """Run the jobs of a part here by ``app``, with a line of output after each: how many functions it compiled."""
    from dousa.kernels import compile_always

    compile_always()  # also what small work alone would not
    from numba.core import event

    with tempfile.TemporaryDirectory() as folder, event.install_recorder("numba:compile") as seen:
        os.chdir(folder)
        try:
            _make_motions()
            for job in PARTS[part]:
                with redirect_stdout(StringIO()), redirect_stderr(StringIO()):
                    app(job.split(), standalone_mode=False)
                print(sum(one.is_start for _, one in seen.buffer), flush=True)
        finally:
            os.chdir(os.sep)  # the folder goes
