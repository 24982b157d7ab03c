"""Estimation against the truth: real motion, cameras around it, and a body that is not the one that was filmed.

The tracker knows the pose of the first frame (or nothing at all), the stature, and nothing else; beside it stand
the first pose held, and what the first two true poses predict without any image.

Conventions. One view is the first of the file. Two views are the first and the one whose optical axis is most nearly
square to it, chosen by where the cameras look; or all choices, averaged. A clip is lost where more than half of its
frames or its last one has a mean error above `LOSS_BOUND`.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import groupby
from typing import Any, Literal

import numpy as np

from dousa.errors import DousaError, OptionError
from dousa.estimation.tracking.settings import Estimate, TrackerSettings
from dousa.experiments.runner import check_choice
from dousa.experiments.table import Cell, Result, ResultTable, show
from dousa.files.json_values import to_json_value
from dousa.messages import Message, Progress
from lab.estimation.clips import (
    VARIANTS,
    BenchClip,
    Score,
    find_clips,
    first_frame_body,
    fit_first_poses,
    list_view_choices,
    mark_points,
    read_clip,
    score_baselines,
    score_poses,
    take_part,
)
from lab.estimation.metrics import LOSS_BOUND, mean_of
from lab.tasks import run_tasks

METHODS: tuple[str, ...] = ("estimate", "frozen", "constant_velocity")
"""What is compared: the tracker; the first pose held; what the first two true poses predict."""

StartFrom = Literal["truth", "auto"]
BodyFrom = Literal["stature", "start"]
ViewChoice = Literal["first", "all"]

Track = Callable[..., Estimate]
"""As `dousa.estimation.tracking.tracker.estimate`."""

_MEANS = ("mean_mm", "root_mm", "rigid_mm", "segment_deg", "angle_deg", "pck_50", "pck_100", "loss_rate",
          "visible_mm", "occluded_mm", "jitter_m_s2", "mean_px", "percent_of_stature")  # fmt: skip

_METHOD_WORDS = {
    "estimate": Message("trial_pose.estimated"),
    "frozen": Message("trial_pose.held"),
    "constant_velocity": Message("trial_pose.constant_velocity"),
}

_STARTS = {"truth": Message("trial_pose.start_truth"), "auto": Message("trial_pose.start_auto")}
_BODIES = {"stature": Message("trial_pose.body_stature"), "start": Message("trial_pose.body_start")}

# Heading, number, digits, factor.
_COLUMNS: tuple[tuple[Cell, str, int, float], ...] = (
    (Message("trial_pose.mean_mm"), "mean_mm", 0, 1.0),
    (Message("trial_pose.root_mm"), "root_mm", 0, 1.0),
    (Message("trial_pose.rigid_mm"), "rigid_mm", 0, 1.0),
    (Message("trial_pose.segment_deg"), "segment_deg", 1, 1.0),
    (Message("trial_pose.angle_deg"), "angle_deg", 1, 1.0),
    ("PCK50 %", "pck_50", 0, 100.0),
    ("PCK100 %", "pck_100", 0, 100.0),
    (Message("trial_pose.loss_rate"), "loss_rate", 0, 100.0),
    (Message("trial_pose.jitter"), "jitter_m_s2", 1, 1.0),
    (Message("trial_pose.mean_px"), "mean_px", 1, 1.0),
    (Message("trial_pose.percent_of_stature"), "percent_of_stature", 1, 1.0),
)

_CLIP_HEADS: tuple[Cell, ...] = (
    Message("trial_pose.clip"),
    Message("trial_pose.views"),
    *(column[0] for column in _COLUMNS[:3]),
    _COLUMNS[-1][0],
    Message("trial_pose.held_mm"),
    Message("trial_pose.root_mm"),
    Message("trial_pose.velocity_mm"),
    Message("trial_pose.root_mm"),
    Message("trial_pose.overlap"),
    "",
)


@dataclass(frozen=True, slots=True, eq=False)
class BenchRow(Result):
    """One clip, seen by some of its cameras.

    Parameters
    ----------
    clip, variant : see `BenchClip`.
    views : indices of the views that were looked at.
    scores : `METHODS` -> how near it came; without the estimate where there was a problem.
    iou : mean overlap of the tracked body and the silhouettes.
    frames_per_second : tracked, by the clock on the wall.
    warnings : of the tracker.
    problem : the error that ended the tracking; None if there was none.
    """

    clip: str
    variant: str
    views: tuple[int, ...]
    scores: dict[str, Score]
    iou: float
    frames_per_second: float
    warnings: tuple[Message | str, ...] = ()
    problem: Message | None = None

    @property
    def is_lost(self) -> bool:
        """Whether the tracker lost the clip, see `Accuracy.is_lost`; a problem counts as lost."""
        return self.problem is not None or self.scores["estimate"].accuracy.is_lost

    def to_json(self) -> dict[str, Any]:
        """The fields, each score by its method, and whether the clip was lost."""
        answer = Result.to_json(self)
        return {**answer.pop("scores"), **answer, "is_lost": self.is_lost}


@dataclass(frozen=True, slots=True, eq=False)
class BenchResult(Result):
    """All rows of an experiment and what they were made with.

    Parameters
    ----------
    rows : in the order of clips and numbers of views.
    settings : of the tracker.
    start : ``"truth"`` or ``"auto"``.
    body : ``"stature"`` or ``"start"``.
    """

    rows: tuple[BenchRow, ...]
    settings: TrackerSettings
    start: str
    body: str

    @property
    def problems(self) -> tuple[Message, ...]:
        """Of each row that the tracker refused, which it is and why."""
        return tuple(
            Message("trial_pose.problem", clip=row.clip, variant=row.variant, views=row.views, problem=row.problem)
            for row in self.rows
            if row.problem is not None
        )

    def summarise(self) -> list[dict[str, Any]]:
        """One entry for each variant and number of views: every clip counts the same, over its choices of views.

        Returns
        -------
        Dicts with ``variant``, ``n_views``, ``n_clips``; of these ``n_lost``, ``n_below_frozen`` (mean error smaller
        than that of the first pose held) and ``n_below_frozen_rooted`` (the same with the hips in the right place, so
        that walking away does not count); ``iou``, ``frames_per_second``, ``joints_mm``, and for each of `METHODS` the
        means of its numbers.
        """
        groups: dict[tuple[str, int], list[BenchRow]] = {}
        for row in self.rows:
            groups.setdefault((row.variant, len(row.views)), []).append(row)
        return [
            {"variant": variant, "n_views": n_views, **_summarise(rows)}
            for (variant, n_views), rows in sorted(groups.items(), key=lambda item: (item[0][0], item[0][1]))
        ]

    def to_json(self) -> dict[str, Any]:
        """Settings, means and rows."""
        answer = Result.to_json(self)
        return {"clips": answer.pop("rows"), "summary": to_json_value(self.summarise()), **answer}

    def to_tables(self) -> tuple[ResultTable, ...]:
        """Means by variant and number of views, then every clip."""
        what = Message(
            "trial_pose.told",
            start=_STARTS[self.start],
            body=_BODIES[self.body],
            reading=self.settings.reading,
            evidence=self.settings.evidence,
        )
        tables = [ResultTable(preface=(what,))]
        for variant, entries in groupby(self.summarise(), lambda entry: str(entry["variant"])):
            tables.append(_tabulate_means(variant, list(entries)))
            tables.append(_tabulate_clips([row for row in self.rows if row.variant == variant]))
        return tuple(tables)


def _tabulate_means(variant: str, entries: Sequence[dict[str, Any]]) -> ResultTable:
    rows: list[tuple[Cell, ...]] = [
        (
            str(entry["n_views"]) if method == "estimate" else "",
            words,
            *(show(entry[method][key], digits, by) for _, key, digits, by in _COLUMNS),
        )
        for entry in entries
        for method, words in _METHOD_WORDS.items()
    ]
    notes = (
        Message(
            "trial_pose.summary",
            views=entry["n_views"],
            lost=entry["n_lost"],
            clips=entry["n_clips"],
            nearer=entry["n_below_frozen"],
            posture=entry["n_below_frozen_rooted"],
            visible=show(entry["estimate"]["visible_mm"], 0),
            hidden=show(entry["estimate"]["occluded_mm"], 0),
            overlap=show(entry["iou"], 2),
            rate=show(entry["frames_per_second"], 0),
        )
        for entry in entries
    )
    n_clips = max(entry["n_clips"] for entry in entries)
    firsts = range(0, len(rows), len(METHODS))
    return ResultTable(
        (Message("trial_pose.views"), Message("trial_pose.what"), *(column[0] for column in _COLUMNS)),
        tuple(rows),
        title=Message("trial_pose.means", what=variant or Message("trial_pose.sequences"), clips=n_clips),
        notes=tuple(notes),
        n_words=2,
        bold=frozenset(firsts),
        sections=frozenset(row - 1 for row in firsts if row),
    )


def _tabulate_clips(rows: Sequence[BenchRow]) -> ResultTable:
    """A row a clip and number of views, over the choices of views."""
    cells: list[tuple[Cell, ...]] = []
    before = ""
    groups: dict[tuple[str, int], list[BenchRow]] = {}
    for row in rows:
        groups.setdefault((row.clip, len(row.views)), []).append(row)
    for (clip, count), same in groups.items():
        ours = _mean_numbers([row.scores["estimate"] for row in same if "estimate" in row.scores])
        held = [same[0].scores[method].accuracy for method in METHODS[1:]]
        n_lost = sum(row.is_lost for row in same)
        lost: Cell = "!" if n_lost else ""
        if n_lost and len(same) > 1:
            lost = Message("trial_pose.some_lost", lost=n_lost, choices=len(same))
        cells.append(
            (
                clip if clip != before else "",
                str(count),
                *(show(ours[key], digits) for _, key, digits, _ in (*_COLUMNS[:3], _COLUMNS[-1])),
                *(show(number, 0) for one in held for number in (one.mean_mm, one.root_mm)),
                show(_mean(row.iou for row in same), 2),
                lost,
            )
        )
        before = clip
    note = Message("trial_pose.lost", bound=LOSS_BOUND * 1e3)
    return ResultTable(
        _CLIP_HEADS,
        tuple(cells),
        title=Message("trial_pose.each_clip"),
        notes=(note,) if any(row.is_lost for row in rows) else (),
        framed=False,
    )


def _summarise(rows: Sequence[BenchRow]) -> dict[str, Any]:
    clips: dict[str, list[BenchRow]] = {}
    for row in rows:
        clips.setdefault(row.clip, []).append(row)
    answer: dict[str, Any] = {
        "n_clips": len(clips),
        "n_lost": sum(any(r.is_lost for r in c) for c in clips.values()),
    }
    numbers = {
        method: [_mean_numbers([r.scores[method] for r in c if method in r.scores]) for c in clips.values()]
        for method in METHODS
    }
    for name, number in (("n_below_frozen", "mean_mm"), ("n_below_frozen_rooted", "root_mm")):
        answer[name] = sum(
            ours[number] < frozen[number] for ours, frozen in zip(numbers["estimate"], numbers["frozen"], strict=True)
        )
    answer["iou"] = _mean(row.iou for row in rows)
    answer["frames_per_second"] = _mean(row.frames_per_second for row in rows)
    for method, per_clip in numbers.items():
        answer[method] = {name: _mean(entry[name] for entry in per_clip) for name in _MEANS}
    answer["joints_mm"] = _mean_joints([r.scores["estimate"] for r in rows if "estimate" in r.scores])
    return answer


def _mean_numbers(scores: Sequence[Score]) -> dict[str, float]:
    entries = [score.to_json() for score in scores]
    return {name: _mean(entry[name] for entry in entries) for name in _MEANS}


def _mean_joints(scores: Sequence[Score]) -> dict[str, float]:
    tables = [score.accuracy.joint_mm for score in scores]
    names = dict.fromkeys(name for table in tables for name in table)
    return {name: _mean(table[name] for table in tables if name in table) for name in names}


def _mean(values: Iterable[float]) -> float:
    return mean_of(np.array(list(values), np.float64))


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
    start : ``"truth"``: the tracker gets the true joints of the first frame, as a pose of its own body;
        ``"auto"``: it finds its start.
    body : ``"stature"``: from tables; ``"start"``: with the bones that the true joints of the first frame show.
    track : as `dousa.estimation.tracking.tracker.estimate`, which is what None means.
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
    check_choice("start", start, ("truth", "auto"))
    check_choice("choice", choice, ("first", "all"))
    check_choice("body", body, ("stature", "start"))
    if not views or min(views) < 1:
        raise OptionError("trials.view_numbers", found=list(views))
    settings = settings or TrackerSettings()
    if track is None:
        from dousa.estimation.tracking.tracker import estimate

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
        raise OptionError("trials.most_views", most=max(len(clip.cameras) for clip in clips), found=min(views))
    rows = run_tasks(_run_trial, tasks, _name_trial, n_jobs=n_jobs, progress=progress)
    return BenchResult(tuple(rows), settings, start, body)


@dataclass(frozen=True, slots=True, eq=False)
class _Trial:
    clip: BenchClip
    views: tuple[int, ...]
    settings: TrackerSettings
    start: StartFrom
    body: BodyFrom
    track: Track
    n_threads: int | None


def _name_trial(trial: _Trial) -> Message:
    return Message("text.verbatim", text=f"{trial.clip.name} {trial.clip.variant}".strip())


def _run_trial(trial: _Trial) -> BenchRow:
    clip = trial.clip
    body = first_frame_body(clip, trial.body)
    first, second = fit_first_poses(body, clip)
    scores = score_baselines(clip, trial.views, body, first, second)
    row = partial(BenchRow, clip.name, clip.variant, trial.views)
    try:
        found = trial.track(
            take_part(clip.silhouettes, trial.views),
            [clip.cameras[view] for view in trial.views],
            body,
            first if trial.start == "truth" else None,
            settings=trial.settings,
            n_threads=trial.n_threads,
        )
    except DousaError as error:
        return row(scores, float("nan"), float("nan"), problem=error.message)
    ours = score_poses(clip, trial.views, found.body, found.poses, mark_points(found.body, found.occluded))
    return row({"estimate": ours, **scores}, mean_of(found.iou), found.frames_per_second, found.warnings)
