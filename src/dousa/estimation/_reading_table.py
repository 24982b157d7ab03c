"""The paper's experiment, on walking whose truth is known: what each reading of eq. 2 is worth, and what inertia is."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dousa.errors import OptionError
from dousa.estimation._baselines import constant_velocity, frozen_first_pose
from dousa.estimation._bench_clips import BenchClip, choose_views, read_clip, take_part
from dousa.estimation._bench_result import Score
from dousa.estimation._bench_scores import Progress, Track, score_poses, spread_tasks
from dousa.estimation._plain_search import REACHES, Reach, search_plainly
from dousa.estimation._types import EVIDENCES, READINGS, Evidence, Reading, TrackerSettings

if TYPE_CHECKING:
    from dousa.estimation.body import BodyModel

__all__ = [
    "CHANGES",
    "PAPER_RATIO",
    "SOURCES",
    "TOLD",
    "WALKING",
    "RangeRow",
    "ReadingRow",
    "ReadingTable",
    "compute_quantisation_ratio",
    "run_reading_table",
]

FloatArray = NDArray[np.float64]

WALKING: tuple[int, int] = (40, 76)
"""The 36 frames of ``cmu86_walk_clean.npz``: mid walk, the legs pass each other in frames 48 and 74 and the arms the
trunk."""

PAPER_RATIO = 4.61
"""By how much the paper says that inertia sharpens the angles at equal cost: mean range of a joint / (2 dR)."""

CHANGES: dict[str, dict[str, float | str | tuple[float, ...]]] = {
    "paper": {},
    "W = 1": {"inertia": 0.0},
    "damped": {"damping": (0.5,)},
    "damped, one sweep more": {"damping": (0.5,), "passes": (1.0, 0.5)},
    "damped, parts with all below": {"damping": (0.5,), "candidates": "subtree"},
}
"""What is changed of the paper's settings. The sweep more has half the dR, about where the first one ended; with all
below, a part is judged together with those that hang on it, and before all others rather than those placed already."""

SOURCES: tuple[str, ...] = ("recorded", "own body")
"""Silhouettes as the file has them, of another body than the model; and of the model itself in the same poses, so that
no error is due to its shape."""

TOLD: tuple[str, ...] = ("first frame", "every frame")
"""What the plain search of the ranges is told: the first true pose, so that errors live on from frame to frame; or
before every frame the true poses of the frames before it, which is what the paper's reckoning takes for granted. Then
W = 1 tells what the smaller range is worth; with W the prediction is nearly right whatever the image says."""


@dataclass(frozen=True, slots=True, eq=False)
class ReadingRow:
    """One reading and evidence.

    Parameters
    ----------
    source : of `SOURCES`.
    views : indices of those looked at.
    reading, evidence : see `READINGS` and `EVIDENCES` of `dousa.estimation._types`.
    change : of `CHANGES`.
    score : how near it came.
    """

    source: str
    views: tuple[int, ...]
    reading: Reading
    evidence: Evidence
    change: str
    score: Score


@dataclass(frozen=True, slots=True, eq=False)
class RangeRow:
    """As many candidates over the whole range of each joint as within what inertia allows.

    Parameters
    ----------
    source, views, reading : as for `ReadingRow`.
    told : of `TOLD`.
    full_range : how near the one came.
    within : how near the other came, W = 1: what the smaller range alone is worth.
    weighed : and with W as eq. 2 has it.
    """

    source: str
    views: tuple[int, ...]
    reading: Reading
    told: str
    full_range: Score
    within: Score
    weighed: Score

    @property
    def ratio(self) -> float:
        """How many times smaller the mean joint error is within what inertia allows, W = 1."""
        return self.full_range.accuracy.mean_mm / self.within.accuracy.mean_mm

    @property
    def weighed_ratio(self) -> float:
        """The same with W."""
        return self.full_range.accuracy.mean_mm / self.weighed.accuracy.mean_mm

    def to_json(self) -> dict[str, Any]:
        """All of it, the arrays summed up."""
        return {
            "source": self.source,
            "reading": self.reading,
            "views": list(self.views),
            "told": self.told,
            "ratio": self.ratio,
            "weighed_ratio": self.weighed_ratio,
            **{name: getattr(self, name).to_json() for name in ("full_range", "within", "weighed")},
        }


@dataclass(frozen=True, slots=True, eq=False)
class ReadingTable:
    """The whole of the paper's experiment.

    Parameters
    ----------
    clip : name of the sequence.
    frames : first, and the one after the last.
    settings : the paper's.
    rows, range_rows : in the order of sources, views, readings, evidences and changes.
    baselines : source -> ``"frozen"`` and ``"constant_velocity"`` -> score, over all views.
    quantisation_ratio : mean range of the joints of our body / (2 dR); the paper says 4.61 of its own.
    """

    clip: str
    frames: tuple[int, int]
    settings: TrackerSettings
    rows: tuple[ReadingRow, ...]
    range_rows: tuple[RangeRow, ...]
    baselines: dict[str, dict[str, Score]]
    quantisation_ratio: float

    def find(self, **wanted: Any) -> ReadingRow:
        """The first row with these values, such as ``reading="masked"``."""
        return next(row for row in self.rows if all(getattr(row, k) == v for k, v in wanted.items()))

    def to_json(self) -> dict[str, Any]:
        """All of it, the arrays summed up."""
        return {
            "clip": self.clip,
            "frames": list(self.frames),
            "settings": asdict(self.settings),
            "quantisation_ratio": self.quantisation_ratio,
            "quantisation_ratio_of_the_paper": PAPER_RATIO,
            "baselines": {
                source: {name: score.to_json() for name, score in scores.items()}
                for source, scores in self.baselines.items()
            },
            "rows": [
                {
                    **{name: getattr(row, name) for name in ("source", "reading", "evidence", "change")},
                    "views": list(row.views),
                    **row.score.to_json(),
                }
                for row in self.rows
            ],
            "end_to_end": [row.to_json() for row in self.range_rows],
        }


def compute_quantisation_ratio(body: BodyModel, max_change: float) -> float:
    """By how much finer equally many candidates lie within +-dR than over the whole range of a joint, in the mean.

    Parameters
    ----------
    body : with joint limits.
    max_change : rad, the dR of eq. 1.

    Returns
    -------
    Mean range of the joint axes / (2 dR), the reckoning behind the paper's 4.61; its body's limits are not printed.
    """
    limits = body.angle_limits
    if not len(limits) or not max_change > 0:
        raise OptionError(
            f"expected a body with joints and a dR above 0, got {len(limits)} and {max_change:g}"
        )
    return float(np.mean(limits[:, 1] - limits[:, 0]) / (2.0 * max_change))


def run_reading_table(
    path: str | os.PathLike[str],
    *,
    frames: tuple[int, int] = WALKING,
    views: Sequence[int] = (1, 2, 4),
    readings: Sequence[Reading] = READINGS,
    evidences: Sequence[Evidence] = EVIDENCES,
    changes: Sequence[str] = tuple(CHANGES),
    sources: Sequence[str] = SOURCES,
    settings: TrackerSettings | None = None,
    track: Track | None = None,
    n_jobs: int | None = None,
    progress: Progress | None = None,
) -> ReadingTable:
    """Repeat the paper's experiment: 36 frames of walking, dR = 6 degrees, s = 1 degree, 13 candidates.

    Parameters
    ----------
    path : an npz file with masks, cameras, stature and true joints; the paper's frames are not to be had.
    frames : first, and the one after the last.
    views : how many views, each number in turn, chosen as `choose_views` does.
    readings, evidences, changes, sources : which of them.
    settings : the paper's if None: `PAPER` of `dousa.estimation.tracker`.
    track : as `dousa.estimation.tracker.estimate`, which is what None means.
    n_jobs : threads; None for one.
    progress : called with trials done, their total, and what was done.

    Returns
    -------
    ReadingTable. The tracker is told the true joints of the first of the frames, and the stature; the body is that
    of the tables, its girths as they are.

    Raises
    ------
    OptionError : frames or views that are not there, an unknown change or source.
    SilhouetteError, CalibrationError : a file that cannot be read, or that lacks the truth.
    """
    from dousa.estimation.human import make_human
    from dousa.estimation.posing import fit_poses

    if unknown := [name for name in (*changes, *sources) if name not in (*CHANGES, *SOURCES)]:
        raise OptionError(
            f"expected changes {', '.join(CHANGES)} and sources {', '.join(SOURCES)}, got {unknown[0]}"
        )
    if track is None or settings is None:
        from dousa.estimation.tracker import PAPER, estimate

        track, settings = track or estimate, settings or PAPER
    recorded = _cut(read_clip(path), frames)
    body = make_human(recorded.stature)
    clips = {"recorded": lambda: recorded, "own body": lambda: _redraw(recorded, body)}
    seen = {source: clips[source]() for source in sources}
    poses = {source: fit_poses(body, clip.truth, clip.joints)[0] for source, clip in seen.items()}
    tasks: list[tuple[str, Callable[[], ReadingRow | RangeRow]]] = []
    for source, clip in seen.items():
        for count in views:
            scene = _Scene(
                source, clip, choose_views(clip.cameras, count), body, poses[source], settings, track
            )
            tasks += scene.plan(readings, evidences, changes)
    answers = list(spread_tasks(lambda task: task(), tasks, n_jobs, progress))
    return ReadingTable(
        recorded.name,
        frames,
        settings,
        tuple(answer for answer in answers if isinstance(answer, ReadingRow)),
        tuple(answer for answer in answers if isinstance(answer, RangeRow)),
        {source: _score_baselines(clip, body, *poses[source][:2]) for source, clip in seen.items()},
        compute_quantisation_ratio(body, settings.max_change),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Scene:
    """Some views of a clip, the body's poses nearest to the truth, and what is done with them."""

    source: str
    clip: BenchClip
    views: tuple[int, ...]
    body: BodyModel
    poses: FloatArray
    settings: TrackerSettings
    track: Track

    def plan(
        self, readings: Sequence[Reading], evidences: Sequence[Evidence], changes: Sequence[str]
    ) -> list[tuple[str, Callable[[], ReadingRow | RangeRow]]]:
        """Names of trials and the trials."""
        plan: list[tuple[str, Callable[[], ReadingRow | RangeRow]]] = []
        for reading in readings:
            for evidence in evidences:
                for change in changes:
                    trial = partial(self._track, reading, evidence, change)
                    plan.append((f"{reading}, {evidence}, {change}", trial))
            for told in TOLD:
                plan.append((f"{reading}, full range", partial(self._compare_ranges, reading, told)))
        return plan

    def _track(self, reading: Reading, evidence: Evidence, change: str) -> ReadingRow:
        settings = replace(self.settings, reading=reading, evidence=evidence, **CHANGES[change])  # type: ignore[arg-type]
        part, cameras = self._look()
        found = self.track(part, cameras, self.body, self.poses[0], settings=settings, girths="keep")
        score = score_poses(self.clip, self.views, found.body, found.poses)
        return ReadingRow(self.source, self.views, reading, evidence, change, score)

    def _compare_ranges(self, reading: Reading, told: str) -> RangeRow:
        full_range, within, weighed = (self._search(reading, reach, told) for reach in REACHES)
        return RangeRow(self.source, self.views, reading, told, full_range, within, weighed)

    def _search(self, reading: Reading, reach: Reach, told: str) -> Score:
        part, cameras = self._look()
        slowness = 30.0 / part.frame_rate
        poses = search_plainly(
            part,
            cameras,
            self.body,
            self.poses[0],
            known=self.poses if told == "every frame" else None,
            reading=reading,
            reach=reach,
            max_change=self.settings.max_change * slowness,
            root_change=self.settings.root_change * self.body.stature * slowness,
            n_candidates=self.settings.n_candidates,
        )
        return score_poses(self.clip, self.views, self.body, poses)

    def _look(self) -> tuple[Any, list[Any]]:
        return take_part(self.clip.silhouettes, self.views), [self.clip.cameras[view] for view in self.views]


def _cut(clip: BenchClip, frames: tuple[int, int]) -> BenchClip:
    part = take_part(clip.silhouettes, range(clip.silhouettes.n_views), frames)
    return replace(clip, silhouettes=part, truth=clip.truth[frames[0] : frames[1]])


def _redraw(clip: BenchClip, body: BodyModel) -> BenchClip:
    """The same poses, worn by the model itself; the truth is then that of the model."""
    from dousa.estimation.kinematics import compute_points, point_names
    from dousa.estimation.posing import fit_poses
    from dousa.estimation.rendering import render
    from dousa.estimation.silhouettes import PackedSilhouettes

    poses, _ = fit_poses(body, clip.truth, clip.joints)
    masks = render(body, poses, clip.cameras)
    drawn = PackedSilhouettes(masks, clip.silhouettes.frame_rate, clip.silhouettes.names)
    return replace(clip, silhouettes=drawn, joints=point_names(body), truth=compute_points(body, poses))


def _score_baselines(
    clip: BenchClip, body: BodyModel, first: FloatArray, second: FloatArray
) -> dict[str, Score]:
    n_frames, views = len(clip.truth), range(len(clip.cameras))
    poses = {
        "frozen": frozen_first_pose(first, n_frames),
        "constant_velocity": constant_velocity(first, second, n_frames, body.angle_limits),
    }
    return {name: score_poses(clip, views, body, rows) for name, rows in poses.items()}
