"""Estimation against the truth: real motion, cameras around it, and a body that is not the one that was filmed.

The tracker is told the pose of the first frame (or nothing at all), the stature, and nothing else; beside it stand
the first pose held, and what the first two true poses foretell without any image.

Conventions. One view is the first of the file. Two views are the first and the one whose optical axis is most nearly
square to it, chosen by where the cameras look; or all choices, averaged. A clip is lost where more than half of its
frames or its last one has a mean error above `LOSS_BOUND`.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from dousa.errors import DousaError, OptionError
from dousa.estimation._baselines import constant_velocity, frozen_first_pose
from dousa.estimation._bench_clips import (
    VARIANTS,
    BenchClip,
    choose_views,
    find_clips,
    first_frame_body,
    list_view_choices,
    read_clip,
    take_part,
)
from dousa.estimation._bench_result import METHODS, BenchResult, BenchRow, Score
from dousa.estimation._bench_scores import (
    Progress,
    Track,
    fit_first_poses,
    mark_points,
    score_poses,
    spread_tasks,
)
from dousa.estimation._reading_table import (
    CHANGES,
    PAPER_RATIO,
    SOURCES,
    WALKING,
    RangeRow,
    ReadingRow,
    ReadingTable,
    compute_quantisation_ratio,
    run_reading_table,
)
from dousa.estimation._types import TrackerSettings

__all__ = [
    "CHANGES",
    "METHODS",
    "PAPER_RATIO",
    "SOURCES",
    "VARIANTS",
    "WALKING",
    "BenchClip",
    "BenchResult",
    "BenchRow",
    "RangeRow",
    "ReadingRow",
    "ReadingTable",
    "Score",
    "choose_views",
    "compute_quantisation_ratio",
    "constant_velocity",
    "find_clips",
    "frozen_first_pose",
    "read_clip",
    "run_bench",
    "run_reading_table",
]

StartFrom = Literal["truth", "auto"]
BodyFrom = Literal["stature", "start"]
ViewChoice = Literal["first", "all"]


def run_bench(
    paths: Sequence[str | os.PathLike[str]],
    *,
    views: Sequence[int] = (1, 2, 4),
    choice: ViewChoice = "first",
    variants: Sequence[str] = VARIANTS,
    settings: TrackerSettings | None = None,
    start: StartFrom = "truth",
    body: BodyFrom = "stature",
    track: Track | None = None,
    n_jobs: int | None = None,
    progress: Progress | None = None,
) -> BenchResult:
    """Track sequences whose truth is known, and compare.

    Parameters
    ----------
    paths : npz files with masks, cameras, stature and true joints, and folders of them.
    views : how many views to look at, each number in turn; a clip with fewer is left out of that number.
    choice : ``"first"``: one choice of views, see the module; ``"all"``: every choice.
    variants : of `VARIANTS`, which files of a folder.
    settings : of the tracker; its defaults if None.
    start : ``"truth"``: the tracker is told the true joints of the first frame, as a pose of its own body;
        ``"auto"``: it finds its start.
    body : ``"stature"``: from tables; ``"start"``: with the bones that the true joints of the first frame show.
    track : as `dousa.estimation.tracker.estimate`, which is what None means.
    n_jobs : threads; None for one. More make the frames per second of each smaller.
    progress : called with trials done, their total, and the clip's name.

    Returns
    -------
    BenchResult. Where the tracker refuses a clip the row says why, and counts as lost.

    Raises
    ------
    OptionError : nothing found, or a value outside its range.
    SilhouetteError, CalibrationError : a file that cannot be read, or that lacks the truth.
    """
    if start not in ("truth", "auto") or choice not in ("first", "all") or body not in ("stature", "start"):
        raise OptionError(
            "expected start truth or auto, choice first or all, and body stature or start; "
            f"got '{start}', '{choice}' and '{body}'"
        )
    if not views or min(views) < 1:
        raise OptionError(f"views: expected numbers of 1 or more, got {list(views)}")
    settings = settings or TrackerSettings()
    if track is None:
        from dousa.estimation.tracker import estimate

        track = estimate
    clips = [read_clip(path) for path in find_clips(paths, variants)]
    n_threads = None if n_jobs in (None, 1) else 1  # of each trial, where the trials keep the cores busy
    tasks = [
        _Trial(clip, chosen, settings, start, body, track, n_threads)
        for clip in clips
        for count in dict.fromkeys(views)
        if count <= len(clip.cameras)
        for chosen in list_view_choices(clip.cameras, count, choice)
    ]
    if not tasks:
        raise OptionError(
            f"views: expected at most {max(len(clip.cameras) for clip in clips)}, got {min(views)}"
        )
    named = [(f"{task.clip.name} {task.clip.variant}".strip(), task) for task in tasks]
    return BenchResult(tuple(spread_tasks(_run_trial, named, n_jobs, progress)), settings, start, body)


@dataclass(frozen=True, slots=True, eq=False)
class _Trial:
    clip: BenchClip
    views: tuple[int, ...]
    settings: TrackerSettings
    start: StartFrom
    body: BodyFrom
    track: Track
    n_threads: int | None


def _run_trial(trial: _Trial) -> BenchRow:
    clip = trial.clip
    body = first_frame_body(clip, trial.body)
    first, second = fit_first_poses(body, clip)
    n_frames = len(clip.truth)
    poses = {
        "frozen": frozen_first_pose(first, n_frames),
        "constant_velocity": constant_velocity(first, second, n_frames, body.angle_limits),
    }
    scores = {name: score_poses(clip, trial.views, body, rows) for name, rows in poses.items()}
    cameras = [clip.cameras[view] for view in trial.views]
    try:
        found = trial.track(
            take_part(clip.silhouettes, trial.views),
            cameras,
            body,
            first if trial.start == "truth" else None,
            settings=trial.settings,
            n_threads=trial.n_threads,
        )
    except DousaError as error:
        nan = float("nan")
        return BenchRow(clip.name, clip.variant, trial.views, scores, nan, nan, problem=str(error))
    ours = score_poses(clip, trial.views, found.body, found.poses, mark_points(found.body, found.occluded))
    seen = found.iou[np.isfinite(found.iou)]
    return BenchRow(
        clip.name,
        clip.variant,
        trial.views,
        {"estimate": ours, **scores},
        float(seen.mean()) if seen.size else float("nan"),
        found.frames_per_second,
        tuple(found.warnings),
    )
