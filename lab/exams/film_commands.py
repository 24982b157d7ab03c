"""The exam of films: the commands as a user types them, what they answer, and the truth that rows are held to."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import time
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from lab.exams import film_baseline as plain
from lab.exams.film_baseline import JOINTS

# What is typed. Of each row the first line counts whose options `dousa COMMAND --help` knows; adapt them here.
COMMANDS = {
    "calibrated": ["estimate {films} --cameras {cameras} -o {out} --json"],
    "one view": [
        "estimate {films} --cameras {cameras} -o {out} --json",
        "estimate {films} --cameras {cameras} --stature {stature} -o {out} --json",
    ],
    "bench": ["estimate {films} -o {out} --json"],
    "films, focal known": [
        "estimate {films} --stature {stature} --intrinsics {cameras} -o {out} --json",
        "estimate {films} --stature {stature} --focal {focal} -o {out} --json",
        "estimate {films} --stature {stature} --focal-length {focal} -o {out} --json",
    ],
    "films": ["estimate {films} --stature {stature} -o {out} --json"],
    "everybody": ["estimate {films} --cameras {cameras} --everybody -o {out} --json"],
    "sync": ["sync {films} -o {out} --json"],
    "calibrate": ["calibrate {films} --stature {stature} -o {out} --json"],
}
STATURE, FOCAL, RATE, FAR, MOST_SECONDS = 1.72, 1678, 60.0, 0.150, 1800  # m (Pose2Sim's demo), pixels, Hz, m, s
BENCH = os.environ.get("EXAM_BENCH", "*.npz")
VIEWS = [f"cam0{k}" for k in (1, 2, 3, 4)]
SURE = [k for k, name in enumerate(JOINTS) if name not in ("neck", "head")]  # 15 joints that all define alike
POSTURE = [k for k, name in enumerate(JOINTS) if name != "pelvis"]


@dataclass
class Answer:
    """What a command did: `failed` is empty or the sentence for the table."""

    code: int
    failed: str
    out: Path
    said: dict = field(default_factory=dict)
    error_lines: list[str] = field(default_factory=list)
    seconds: float = 0.0

    @cached_property
    def motions(self) -> list[Motion]:
        """Every TRC that was written: `out`, or its neighbours whose names begin alike."""
        files = sorted(self.out.parent.glob(f"{self.out.stem}*.trc"))
        return [motion for motion in map(read_motion, files) if motion is not None]

    @property
    def lost(self) -> set[int]:
        value = self.said.get("lost_frames", [])
        return set(value) if isinstance(value, list) else set()


@dataclass
class Motion:
    joints: np.ndarray  # (T, 17, 3), metres; NaN where a joint is not in the file
    rate: float


def read_motion(path: Path) -> Motion | None:
    trc, rate = plain.read_trc(path)
    if "left_hip" not in trc:
        return None
    trc["pelvis"] = (trc["left_hip"] + trc["right_hip"]) / 2
    absent = np.full_like(trc["pelvis"], np.nan)
    return Motion(np.stack([trc.get(name, absent) for name in JOINTS], axis=1), rate)


class Exam:
    def __init__(self, data: Path, dousa: str, work: Path) -> None:
        self.data, self.dousa, self.work = data, shlex.split(dousa), work
        self.calibration = data / "pose2sim/calibration/Calib.qca.txt"
        self.cameras = plain.read_qualisys(self.calibration)
        self.reference = plain.read_reference(data / "pose2sim/Balancing_for_IK.trc")
        self.kept: dict[str, Answer] = {}
        for folder, source in (("pose2sim", "pose2sim/videos"), ("two", "films/two_people")):
            (work / folder).mkdir(parents=True, exist_ok=True)
            for view in VIEWS:  # Copies: what is kept beside a film must be writable.
                shutil.copyfile(data / source / f"{view}.mp4", work / folder / f"{view}.mp4")
            shutil.copyfile(self.calibration, work / folder / "Calib.qca.txt")

    def films(self, folder: str, views: tuple[int, ...] = (0, 1, 2, 3)) -> list[Path]:
        return [self.work / folder / f"{VIEWS[v]}.mp4" for v in views]

    def knows(self, command: str) -> str:
        asked = subprocess.run(
            [*self.dousa, command, "--help"], capture_output=True, text=True, env=quiet(), check=False
        )
        return asked.stdout if asked.returncode == 0 else ""

    def ask(self, what: str, films: list[Path], name: str, suffix: str = ".trc", **words: object) -> Answer:
        """Run a command of the table, once for each name; later lines of the table only where earlier ones fail."""
        if name in self.kept:
            return self.kept[name]
        out = self.work / "out" / name.replace(" ", "_") / f"motion{suffix}"
        shutil.rmtree(out.parent, ignore_errors=True)
        out.parent.mkdir(parents=True)
        answer = Answer(-1, "no such option or command", out)
        for line in COMMANDS[what]:
            command, options = line.split()[0], re.findall(r"--[a-z-]+", line)
            text = self.knows(command)
            absent = [option for option in options if not re.search(rf"{option}(?![a-z-])", text)]
            if not text or absent:
                if answer.code == -1:
                    answer.failed = f"dousa {command}: " + (f"no {' '.join(absent)}" if text else "no such command")
                continue
            filled = {"cameras": self.calibration, "stature": STATURE, "focal": FOCAL, "out": out} | words
            argv = []
            for part in line.split():
                argv += map(str, films) if part == "{films}" else [part.format(**filled)]
            answer = self.run(argv, out)
            if not answer.failed:
                break
        self.kept[name] = answer
        return answer

    def run(self, argv: list[str], out: Path) -> Answer:
        begun = time.monotonic()
        try:
            done = subprocess.run(
                ["nice", "-n", "10", *self.dousa, *argv],
                capture_output=True,
                text=True,
                env=quiet(),
                cwd=out.parent,
                timeout=MOST_SECONDS,
                check=False,
            )
        except subprocess.TimeoutExpired:
            return Answer(124, f"not ended after {MOST_SECONDS} s", out, seconds=MOST_SECONDS)
        lines = [line for line in re.split(r"[\r\n]+", done.stderr) if line.strip()]
        try:
            said = json.loads(done.stdout)
        except ValueError:
            said = {}
        last = (lines or done.stdout.strip().splitlines() or ["nothing said"])[-1].strip()[:150]
        failed = "" if done.returncode == 0 else f"exit {done.returncode}: {last}"
        return Answer(
            done.returncode,
            failed,
            out,
            said if isinstance(said, dict) else {"answer": said},
            lines,
            time.monotonic() - begun,
        )

    # The truth and the baseline.

    @cached_property
    def lag(self) -> int:
        """Film frame t shows reference frame t + lag: where the baseline agrees best. dousa has no say in it."""
        misses = {
            lag: mean_error(self.triangulated((0, 1, 2, 3)), self.truth(np.arange(100.0), lag)) for lag in range(-5, 6)
        }
        return min(misses, key=misses.__getitem__)

    def truth(self, frames: np.ndarray, lag: int | None = None) -> np.ndarray:
        """The reference (n, 17, 3) at frames of the films (60 Hz, may be fractions); NaN outside."""
        places = frames + (self.lag if lag is None else lag)
        below = np.clip(np.floor(places).astype(int), 0, len(self.reference) - 2)
        part = (places - below)[:, None, None]
        found = (1 - part) * self.reference[below] + part * self.reference[below + 1]
        found[(places < 0) | (places > len(self.reference) - 1)] = np.nan
        return found

    @cached_property
    def seen(self) -> tuple[np.ndarray, np.ndarray]:
        """Heavy's landmarks and world points of pose2sim, (V, T, 33, 3) each."""
        both = [plain.follow(film, f"pose2sim_{film.stem}", plain.biggest) for film in self.films("pose2sim")]
        return np.stack([one[0] for one in both]), np.stack([one[1] for one in both])

    def triangulated(self, views: tuple[int, ...]) -> np.ndarray:
        seen = self.seen[0][list(views)]
        points = plain.triangulate([self.cameras[v] for v in views], seen[..., :2], seen[..., 2])
        return plain.landmarks_to_joints(points)

    @cached_property
    def own_seventeen(self) -> float:
        """The baseline over the 17 points that BlazePose and the reference share (nose, heels; no neck, crown)."""
        seen, trc = self.seen[0], plain.read_trc(self.data / "pose2sim/Balancing_for_IK.trc")[0]
        points = plain.triangulate(self.cameras, seen[..., :2], seen[..., 2])
        words = plain.HALPE | {"toe": "BigToe", "heel": "Heel"}
        index = {
            letter + words[limb]: k + right
            for limb, k in (plain.LANDMARKS | {"heel": 29}).items()
            for right, letter in enumerate("LR")
        } | {"Nose": 0}
        truth = np.stack([trc[name] for name in index], axis=1)
        frames = np.arange(max(0, -self.lag), min(100, 100 - self.lag))
        return mean_error(points[frames][:, list(index.values())], truth[frames + self.lag])


def quiet() -> dict[str, str]:
    one = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")}
    return os.environ | one | {"DOUSA_LANG": "en", "COLUMNS": "200", "NO_COLOR": "1"}


def mean_error(found: np.ndarray, truth: np.ndarray, joints: list[int] | None = None) -> float:
    """Millimetres; frames and joints that either lacks do not count."""
    miss = 1e3 * np.linalg.norm(found - truth, axis=-1)
    return float(np.nanmean(miss if joints is None else miss[:, joints])) if np.isfinite(miss).any() else np.nan


def tell(row: str, what: str, target: str, dousa: str, baseline: str) -> None:
    print(f"{row:3s} {what:46s} | {target:26s} | {dousa:60s} | {baseline}", flush=True)


def not_there(answer: Answer) -> str:
    return f"not there ({answer.failed or 'no motion written'})"


def both(found: np.ndarray, truth: np.ndarray) -> str:
    return f"{mean_error(found, truth):.0f} mm, 15 joints {mean_error(found, truth, SURE):.0f}"
