"""The chain on real silhouettes (UTD-MHAD, one camera): motion, category, grade; every answer is kept in a file.

Each person is asked for with libraries of the three others and graded against the next person's takes. What is done
here is what the commands do: ``dousa render``, ``estimate``, ``add``, ``train``, ``classify`` and ``evaluate``.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from dousa.app.pipelines.estimate import Estimation, estimate_files
from dousa.app.pipelines.render import render_file
from dousa.app.requests.estimation import EstimationRequest, Outputs, RenderRequest
from dousa.estimation import TrackerSettings, fit_body, make_human
from dousa.evaluation import assess
from dousa.files.disk import atomic_write
from dousa.formats import ReadOptions, read_canonical
from dousa.library import Library
from dousa.motion import JOINT_INDEX, CanonicalMotion
from lab.figures.measured_kinect import LAG, RATE, Clip, list_clips

PEOPLE = ("1", "3", "5", "7")
STARTS = ("told", "found")
LIBRARIES = ("skeletons", "rendered", "filmed")
CAMERA_FILE = Path(__file__).parent / "kinect.toml"

_PERFORMER = r"name:_s(\d+)_"
_ENDS = ("left_wrist", "right_wrist", "left_ankle", "right_ankle", "head")


@dataclass(frozen=True, slots=True)
class Chain:
    """Where the recordings are, where to keep what is made of them, and what to ask.

    Parameters
    ----------
    data : folder with ``skeleton`` and ``silhouette``.
    kept : folder for motions, libraries and answers; empty it after a change of dousa.
    trials : of which there are silhouettes: ``"1"``, ``"2"``.
    actions : names of folders.
    n_wrong : other actions of the same person that each estimate is graded against too.
    """

    data: Path
    kept: Path
    trials: tuple[str, ...]
    actions: tuple[str, ...]
    n_wrong: int

    def clips(self, people: Sequence[str]) -> list[Clip]:
        """The recordings with silhouettes of these people."""
        return list_clips(self.data, people, self.trials, ",".join(self.actions))

    def skeletons(self, action: str, person: str) -> list[Path]:
        """All takes of an action by a person."""
        return sorted((self.data / "skeleton" / action).glob(f"*_s{person}_*.c3d"))

    def stature_of(self, person: str) -> float:
        """m, what they would say when asked; here as the Kinect's joints tell it."""
        motion = read_one(self.skeletons(self.actions[0], person)[0])
        return fit_body(make_human(motion.height), motion.positions[0]).stature


# Motions


def estimate_clip(chain: Chain, clip: Clip, start: str) -> Path:
    """The motion estimated from a clip's silhouettes, or what is kept of it."""
    path = chain.kept / f"filmed_{start}" / clip.action / f"{clip.name}.bvh"
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        done = run_estimate(chain, clip, start, Outputs((path,)))
        _write_json(path.with_suffix(".json"), done.to_json())
    return path


def run_estimate(chain: Chain, clip: Clip, start: str, outputs: Outputs) -> Estimation:
    """``dousa estimate`` of a clip's silhouettes.

    Parameters
    ----------
    start : ``"told"``: the first pose and the limbs are those of the Kinect; ``"found"``: only the stature is told.
    """
    told = start == "told"
    request = EstimationRequest(
        (clip.masks,),
        TrackerSettings(),
        outputs,
        cameras=CAMERA_FILE,
        rate=RATE,
        frames=f"{LAG}:",
        mirrored=True,
        start=f"{clip.skeleton}:0" if told else None,
        stature=None if told else chain.stature_of(clip.subject),
    )
    return estimate_files(request)


def render_clip(chain: Chain, clip: Clip) -> Path:
    """The motion estimated from what this camera would see of the clip's skeleton, or what is kept of it."""
    path = chain.kept / "rendered" / clip.action / f"{clip.name}.bvh"
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        seen = path.with_suffix(".npz")
        render_file(RenderRequest(clip.skeleton, seen, cameras=CAMERA_FILE))
        request = EstimationRequest((seen,), TrackerSettings(), Outputs((path,)), start=f"{clip.skeleton}:0")
        estimate_files(request)
        seen.unlink()
    return path


# Which figure is it?


@cache
def open_library(chain: Chain, kind: str, person: str) -> Library:
    """A trained library of the people other than this one.

    Parameters
    ----------
    kind : ``"skeletons"``: all takes as the Kinect recorded them; ``"rendered"``: skeletons seen by this camera only,
        and estimated; ``"filmed"``: estimated from the others' own silhouettes.
    """
    path = chain.kept / f"{kind}_without_{person}_{'_'.join(chain.trials)}.dousa"
    if path.exists():
        return Library.open(path, read_only=True)
    others = [one for one in PEOPLE if one != person]
    if kind == "skeletons":
        files = [path for one in others for action in chain.actions for path in chain.skeletons(action, one)]
    elif kind == "rendered":
        files = [render_clip(chain, clip) for clip in chain.clips(others)]
    else:
        files = [estimate_clip(chain, clip, "told") for clip in chain.clips(others)]
    half, table = path.with_suffix(".part"), path.with_suffix(".csv")
    half.unlink(missing_ok=True)
    lines = [f"{file.resolve()},{file.parent.name}" for file in files]
    table.write_text("\n".join(["path,category", *lines]), encoding="utf-8")
    with Library.open(half, create=True) as library:
        library.add(files, category_from=f"csv:{table}", performer_from=_PERFORMER)
        library.train()
    half.replace(path)
    return Library.open(path, read_only=True)


def ask(library: Library, motion: Path, action: str) -> dict[str, Any]:
    """What the library says of a motion, and on which place the true action is."""
    found = library.search(motion, 10)
    order = list(found.histogram)
    return {
        "guess": found.verdict.guess,
        "category": found.category,
        "known": found.verdict.known,
        "rank": order.index(action) + 1 if action in order else len(order) + 1,
        "nearest": [hit.category for hit in found.results],
        "histogram": {name: round(share, 4) for name, share in found.histogram.items() if share > 0},
    }


# How well is it danced?


@lru_cache(maxsize=512)
def read_one(path: Path) -> CanonicalMotion:
    """A motion file's 20 joints."""
    return read_canonical(str(path), ReadOptions())[0]


def read_takes(chain: Chain, action: str, person: str, reference: str = "skeletons") -> list[CanonicalMotion]:
    """The takes of an action that a performance is held against.

    Parameters
    ----------
    reference : ``"skeletons"``: all takes as the Kinect recorded them; ``"filmed"``: those of which there are
        silhouettes, estimated from them.
    """
    if reference == "skeletons":
        return [read_one(path) for path in chain.skeletons(action, person)]
    clips = [clip for clip in chain.clips([person]) if clip.action == action]
    return [read_one(estimate_clip(chain, clip, "told")) for clip in clips]


def grade(chain: Chain, motion: Path, action: str, teacher: str, reference: str) -> dict[str, float]:
    """``dousa evaluate --tempo free`` against another person's takes of an action.

    Returns
    -------
    The grade, degrees off, and the share of the performance's frames that these rest on: what is taken for motion
    before or after the reference is not compared.
    """
    judged = assess(read_takes(chain, action, teacher, reference), read_one(motion), tempo="free")
    compared = np.isfinite(judged.residual).any(axis=1)
    off = np.degrees(np.sqrt(np.nanmean(judged.residual[compared] ** 2, axis=1)).mean())
    return {"grade": round(judged.score, 1), "off": round(float(off), 2), "compared": round(float(compared.mean()), 3)}


def grade_all(chain: Chain, motion: Path, clip: Clip, teacher: str, reference: str) -> dict[str, Any]:
    """Grades against the right action and against wrong ones."""
    wrong = choose_wrong(chain, clip)
    return {
        "right": grade(chain, motion, clip.action, teacher, reference),
        "wrong": {action: grade(chain, motion, action, teacher, reference) for action in wrong},
    }


def choose_wrong(chain: Chain, clip: Clip) -> list[str]:
    """Other actions, drawn anew for each clip, the same every time."""
    others = [action for action in chain.actions if action != clip.action]
    seed = [int(number) for number in (clip.subject, clip.trial, chain.actions.index(clip.action))]
    drawn = np.random.default_rng(seed).permutation(len(others))[: chain.n_wrong]
    return [others[k] for k in sorted(drawn)]


# All of it


def measure_clip(chain: Chain, clip: Clip, start: str) -> dict[str, Any]:
    """All answers about a clip, or those kept."""
    kept = chain.kept / f"answers_{start}" / f"{clip.name}_{chain.n_wrong}.json"
    if kept.exists():
        answer: dict[str, Any] = json.loads(kept.read_text(encoding="utf-8"))
        return answer
    motion = estimate_clip(chain, clip, start)
    teacher = PEOPLE[(PEOPLE.index(clip.subject) + 1) % len(PEOPLE)]
    row: dict[str, Any] = {
        "clip": clip.name,
        "action": clip.action,
        "person": clip.subject,
        "teacher": teacher,
        "moves": describe_movement(read_one(clip.skeleton)),
        "estimation": json.loads(motion.with_suffix(".json").read_text(encoding="utf-8")),
    }
    for name, path in (("estimate", motion), ("skeleton", clip.skeleton)):
        grades = {"skeletons": grade_all(chain, path, clip, teacher, "skeletons")}
        row[name] = {"lean": describe_lean(read_one(path)), "grades": grades}
        for kind in LIBRARIES:
            row[name][kind] = ask(open_library(chain, kind, clip.subject), path, clip.action)
    row["estimate"]["grades"]["filmed"] = grade_all(chain, motion, clip, teacher, "filmed")
    _write_json(kept, row)
    return row


def describe_movement(motion: CanonicalMotion) -> dict[str, float]:
    """How far the body moves in truth, m.

    ``across`` and ``depth``: the longest way of a hand, foot or the head from the pelvis, in the image plane and along
    the camera's axis; ``travel``: the way of the pelvis itself.
    """
    ends = [JOINT_INDEX[name] for name in _ENDS]
    ways = np.ptp(motion.positions[:, ends] - motion.positions[:, :1], axis=0)
    travel = np.linalg.norm(np.ptp(motion.positions[:, 0], axis=0))
    ways_of = (("across", ways[:, :2].max()), ("depth", ways[:, 2].max()), ("travel", travel))
    return {name: round(float(way), 3) for name, way in ways_of}


def describe_lean(motion: CanonicalMotion) -> float:
    """Mean angle (degrees) by which the line from the ankles to the neck leans towards or away from the camera."""
    ankles = motion.positions[:, [JOINT_INDEX["left_ankle"], JOINT_INDEX["right_ankle"]]].mean(axis=1)
    line = motion.positions[:, JOINT_INDEX["neck"]] - ankles
    return round(float(np.degrees(np.abs(np.arctan2(line[:, 2], line[:, 1]))).mean()), 1)


def list_steps(chain: Chain, people: Sequence[str], start: str) -> Iterator[tuple[str, Callable[[], object]]]:
    """What is to be done, in words, in an order in which each step takes about as long; ready ones cost nothing."""
    for clip in chain.clips(PEOPLE):
        yield f"estimating {clip.name}", partial(estimate_clip, chain, clip, "told")
        yield f"rendering {clip.name}", partial(render_clip, chain, clip)
    for clip in chain.clips(people):
        yield f"asking about {clip.name}", partial(measure_clip, chain, clip, start)


def _write_json(path: Path, answer: Any) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(path) as file:
        file.write(json.dumps(answer, indent=1).encode())
