"""The paper's experiment, on walking whose truth is known: what each reading of eq. 2 is worth, and what inertia is."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray
from dousa.errors import OptionError
from dousa.estimation.tracking.settings import EVIDENCES, READINGS, Evidence, Reading, TrackerSettings
from dousa.experiments.runner import check_some
from dousa.experiments.table import Cell, Result, ResultTable, show
from dousa.messages import Message, Progress
from dousa.motion import rotations as rot
from lab.estimation.clips import (
    BenchClip,
    Score,
    choose_views,
    read_clip,
    score_baselines,
    score_poses,
    take_part,
)
from lab.estimation.experiment import Track
from lab.tasks import run_tasks

if TYPE_CHECKING:
    from dousa.estimation.body.body import BodyModel
    from dousa.estimation.cameras.camera import Camera
    from dousa.estimation.silhouettes.silhouettes import Silhouettes

Bits = NDArray[np.uint64]
Reach = Literal["range", "near", "inertia"]

REACHES: tuple[Reach, ...] = ("range", "near", "inertia")

_TIE = 1e-12  # W of one candidate and mismatch of another can make up for each other exactly
_SLACK = 1e-9  # rad: an angle at its limit is within it


@dataclass(frozen=True, slots=True, eq=False)
class _PlainScene:
    """What does not change from candidate to candidate."""

    body: BodyModel
    cameras: tuple[Camera, ...]
    reading: Reading
    reach: Reach
    max_change: float
    root_change: float
    half: int

    def draw(self, poses: FloatArray, first: int, stop: int) -> list[Bits]:
        """Bits (C, H, words) for every view of the parts from first to before stop in poses (C, 7 + A)."""
        from dousa.estimation.body.kinematics import place_parts
        from dousa.estimation.raster.rasteriser import draw_layers, outline_scratch

        rotations, positions = (np.ascontiguousarray(a[:, first:stop]) for a in place_parts(self.body, poses))
        starts = self.body.sphere_starts[first : stop + 1]
        solids = (self.body.spheres[starts[0] : starts[-1]], starts - starts[0])
        layers = np.zeros(stop - first, np.intp)
        views = []
        for camera in self.cameras:
            bits = np.zeros((len(poses), 1, camera.height, -(-camera.width // 64)), np.uint64)
            work = outline_scratch(self.body, camera.height)
            draw_layers(rotations, positions, solids, camera.to_row(), camera.width, layers, work, bits)
            views.append(bits[:, 0])
        return views


def search_plainly(
    silhouettes: Silhouettes,
    cameras: Sequence[Camera],
    body: BodyModel,
    start: FloatArray,
    *,
    known: FloatArray | None = None,
    reading: Reading,
    reach: Reach,
    max_change: float,
    root_change: float,
    n_candidates: int = 13,
) -> FloatArray:
    """Follow silhouettes from the root to the leaves, one axis at a time.

    Parameters
    ----------
    silhouettes : (V, T); every view has an image in every frame.
    cameras : (V,).
    body : with A joint angles.
    start : (7 + A,) pose of the first frame.
    known : (T, 7 + A) poses that every frame is predicted from, so that no error lives on; by default those found.
    reading : of eq. 2.
    reach : ``"range"``: candidates over the whole range of each joint, W = 1; ``"near"``: within max_change of the
        prediction (eq. 1), W = 1; ``"inertia"``: the same, weighed by W (eq. 3) as eq. 2 has it. The root, which has no
        range, is searched within max_change and root_change in any case.
    max_change : rad, the dR of eq. 1, at the rate of the silhouettes.
    root_change : m, the same for the root's place.
    n_candidates : of each axis, odd.

    Returns
    -------
    (T, 7 + A) poses. Among candidates of one score the one nearest to the prediction wins; with the range, the one
    nearest to the angle of the frame before, which is more than the method had.
    """
    from dousa.estimation.raster.rasteriser import pack_bits

    scene = _PlainScene(body, tuple(cameras), reading, reach, max_change, root_change, n_candidates // 2)
    poses = [np.array(start, np.float64)]
    for frame in range(1, silhouettes.n_frames):
        bits = [pack_bits(mask) for mask in silhouettes.read(frame) if mask is not None]
        assert len(bits) == len(cameras), "the plain search takes views without gaps"
        past = poses if known is None else known[:frame]
        predicted = _predict(past[max(frame - 2, 0)], past[frame - 1], body.angle_limits)
        if reach == "range":
            predicted[7:] = past[frame - 1][7:]
        poses.append(_search_frame(scene, bits, predicted))
    return np.stack(poses)


def _predict(before: FloatArray, last: FloatArray, limits: FloatArray) -> FloatArray:
    """Constant velocity."""
    pose = 2.0 * last - before
    turn = rot.multiply(rot.conjugate(before[3:7]), last[3:7])
    pose[3:7] = rot.multiply(last[3:7], turn)
    pose[3:7] /= np.linalg.norm(pose[3:7])
    pose[7:] = np.clip(pose[7:], limits[:, 0], limits[:, 1])
    return pose


def _search_frame(scene: _PlainScene, silhouettes: list[Bits], predicted: FloatArray) -> FloatArray:
    pose = predicted.copy()
    fixed = [np.zeros_like(bits) for bits in silhouettes]
    starts = scene.body.angle_starts
    for part in range(scene.body.n_parts):
        axes = range(6) if part == 0 else range(6 + starts[part], 6 + starts[part + 1])
        for axis in axes:
            trials, weights = _make_candidates(scene, pose, axis)
            # The whole body helps to place the root: the root's own solid is inside the trunk's silhouette.
            drawn = scene.draw(trials, part, scene.body.n_parts if part == 0 else part + 1)
            mismatch = sum(
                count_mismatch(scene.reading, s, f, p) for s, f, p in zip(silhouettes, fixed, drawn, strict=True)
            )
            scores = weights / (1.0 + mismatch)  # eq. 2
            pose = trials[int(np.argmax(scores >= (1.0 - _TIE) * scores.max()))]
        placed = scene.draw(pose[None], part, part + 1)
        fixed = [f | p[0] for f, p in zip(fixed, placed, strict=True)]
    return pose


def _make_candidates(scene: _PlainScene, pose: FloatArray, axis: int) -> tuple[FloatArray, FloatArray]:
    """Poses (C, 7 + A), the one that wins a tie first, and their W of eq. 3."""
    steps = np.arange(-scene.half, scene.half + 1) / scene.half
    trials = np.tile(pose, (len(steps), 1))
    if axis >= 6 and scene.reach == "range":
        low, high = scene.body.angle_limits[axis - 6]
        angles = 0.5 * (low + high) + 0.5 * (high - low) * steps
        trials[:, axis + 1] = angles[np.argsort(np.abs(angles - pose[axis + 1]), kind="stable")]
        return trials, np.ones(len(steps))
    steps = steps[np.argsort(np.abs(steps), kind="stable")]
    amounts = steps * (scene.root_change if axis < 3 else scene.max_change)
    # The prediction of an axis is where the search of it begins.
    weights = 1.0 - 0.25 * steps * steps if scene.reach == "inertia" else np.ones(len(steps))
    if axis < 3:
        trials[:, axis] += amounts
    elif axis < 6:
        turns = np.zeros((len(steps), 3))
        turns[:, axis - 3] = amounts
        trials[:, 3:7] = rot.multiply(pose[3:7], rot.from_axis_angle(turns))
    else:
        trials[:, axis + 1] += amounts
        low, high = scene.body.angle_limits[axis - 6]
        kept = (trials[:, axis + 1] >= low - _SLACK) & (trials[:, axis + 1] <= high + _SLACK)
        trials, weights = trials[kept], weights[kept]
    return trials, weights


def count_mismatch(reading: Reading, silhouette: Bits, fixed: Bits, candidates: Bits) -> NDArray[np.intp]:
    """(C,) pixels that disagree, as eq. 2 is read; see `READINGS` of `dousa.estimation.tracking.settings`."""
    seen = {
        "residual": silhouette & ~fixed,
        "union": silhouette | fixed,
        "literal": silhouette & fixed,
    }.get(reading, silhouette)
    wrong = (seen ^ candidates) & ~fixed if reading == "masked" else seen ^ candidates
    counts: NDArray[np.intp] = np.bitwise_count(wrong).sum(axis=(1, 2), dtype=np.intp)
    return counts


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
"""What the plain search of the ranges knows: the first true pose, so that errors live on from frame to frame; or
before every frame the true poses of the frames before it, which is what the paper's reckoning takes for granted. Then
W = 1 tells what the smaller range is worth; with W the prediction is nearly right whatever the image says."""


@dataclass(frozen=True, slots=True, eq=False)
class ReadingRow(Result):
    """One reading and evidence.

    Parameters
    ----------
    source : of `SOURCES`.
    views : indices of those looked at.
    reading, evidence : see `READINGS` and `EVIDENCES` of `dousa.estimation.tracking.settings`.
    change : of `CHANGES`.
    score : how near it came.
    """

    source: str
    views: tuple[int, ...]
    reading: Reading
    evidence: Evidence
    change: str
    score: Score

    def to_json(self) -> dict[str, Any]:
        """What was tried, and the numbers of its score."""
        answer = Result.to_json(self)
        return {**answer.pop("score"), **answer}


@dataclass(frozen=True, slots=True, eq=False)
class RangeRow(Result):
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
        """The fields and both ratios."""
        return {**Result.to_json(self), "ratio": self.ratio, "weighed_ratio": self.weighed_ratio}


@dataclass(frozen=True, slots=True, eq=False)
class ReadingTable(Result):
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
        """The fields, the ranges as ``end_to_end``, and the ratio of the paper."""
        answer = Result.to_json(self)
        ranges = answer.pop("range_rows")
        return {**answer, "end_to_end": ranges, "quantisation_ratio_of_the_paper": PAPER_RATIO}

    def to_tables(self) -> tuple[ResultTable, ...]:
        """Readings by evidence and change for each source, then what inertia is worth."""
        views = tuple(dict.fromkeys(row.views for row in self.rows))
        what = Message(
            "trial_paper.what",
            clip=self.clip,
            first=self.frames[0],
            last=self.frames[1] - 1,
            counts=" / ".join(str(len(some)) for some in views),
            views=" / ".join(", ".join(map(str, some)) for some in views),
        )
        sources = dict.fromkeys(row.source for row in self.rows)
        return (
            ResultTable(preface=(what,)),
            *(self._tabulate_readings(source) for source in sources),
            self._tabulate_ranges(),
        )

    def _tabulate_readings(self, source: str) -> ResultTable:
        held = self.baselines[source]
        rows = [row for row in self.rows if row.source == source]
        cells: dict[tuple[str, str], dict[str, list[str]]] = {}
        for row in rows:
            changes = cells.setdefault((row.reading, row.evidence), {})
            changes.setdefault(row.change, []).append(_show_error(row.score))
        return ResultTable(
            (
                Message("trial_paper.reading"),
                Message("trial_paper.evidence"),
                *dict.fromkeys(_CHANGE_WORDS[row.change] for row in rows),
            ),
            tuple((*key, *(" / ".join(some) for some in changes.values())) for key, changes in cells.items()),
            title=Message(
                "trial_paper.baselines",
                source=_SOURCE_TITLES[source],
                held=_show_error(held["frozen"]),
                velocity=_show_error(held["constant_velocity"]),
            ),
            n_words=2,
        )

    def _tabulate_ranges(self) -> ResultTable:
        ratio = Message("trial_paper.ratio", ours=self.quantisation_ratio, paper=PAPER_RATIO)
        return ResultTable(
            _RANGE_HEADS,
            tuple(
                (
                    _SOURCE_WORDS[row.source],
                    row.reading,
                    _TOLD_WORDS[row.told],
                    str(len(row.views)),
                    *map(_show_error, (row.full_range, row.within, row.weighed)),
                    show(row.ratio, 2),
                    show(row.weighed_ratio, 2),
                )
                for row in self.range_rows
            ),
            title=Message("trial_paper.ranges", candidates=self.settings.n_candidates),
            preface=(ratio,),
            notes=(Message("trial_paper.how"),),
            n_words=3,
        )


_SOURCE_TITLES = {
    "recorded": Message("trial_paper.recorded_title"),
    "own body": Message("trial_paper.own_body_title"),
}

_SOURCE_WORDS = {"recorded": Message("trial_paper.recorded"), "own body": Message("trial_paper.own_body")}

_TOLD_WORDS = {
    "first frame": Message("trial_paper.first_frame"),
    "every frame": Message("trial_paper.every_frame"),
}

_CHANGE_WORDS: dict[str, Cell] = {
    "paper": Message("trial_paper.unchanged"),
    "W = 1": "W = 1",
    "damped": Message("trial_paper.damped"),
    "damped, one sweep more": Message("trial_paper.one_sweep_more"),
    "damped, parts with all below": Message("trial_paper.all_below"),
}

_RANGE_HEADS = (
    Message("trial_paper.silhouettes"),
    Message("trial_paper.reading"),
    Message("trial_paper.known"),
    Message("trial_pose.views"),
    Message("trial_paper.whole_range"),
    Message("trial_paper.within"),
    Message("trial_paper.weighed"),
    Message("trial_paper.times_nearer"),
    Message("trial_paper.weighed"),
)


def _show_error(score: Score) -> str:
    return show(score.accuracy.mean_mm, 0)


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
        raise OptionError("trials.quantisation", joints=len(limits), change=max_change)
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
    settings : the paper's if None: `PAPER` of `dousa.estimation.tracking.tracker`.
    track : as `dousa.estimation.tracking.tracker.estimate`, which is what None means.
    n_jobs : threads; None for one.
    progress : called with trials done, their total, and what was done.

    Returns
    -------
    ReadingTable. The tracker gets the true joints of the first of the frames, and the stature; the body is that
    of the tables, its girths as they are.

    Raises
    ------
    OptionError : frames or views that are not there, an unknown change or source.
    SilhouetteError, CalibrationError : a file that cannot be read, or that lacks the truth.
    """
    from dousa.estimation.body.human import make_human
    from dousa.estimation.body.posing import fit_poses

    check_some("changes", changes, CHANGES)
    check_some("sources", sources, SOURCES)
    if track is None or settings is None:
        from dousa.estimation.tracking.settings import PAPER
        from dousa.estimation.tracking.tracker import estimate

        track, settings = track or estimate, settings or PAPER
    recorded = _cut(read_clip(path), frames)
    body = make_human(recorded.stature)
    clips = {"recorded": lambda: recorded, "own body": lambda: _redraw(recorded, body)}
    seen = {source: clips[source]() for source in sources}
    poses = {source: fit_poses(body, clip.truth, clip.joints)[0] for source, clip in seen.items()}
    tasks: list[_Task] = []
    for source, clip in seen.items():
        for count in views:
            scene = _Scene(source, clip, choose_views(clip.cameras, count), body, poses[source], settings, track)
            tasks += scene.plan(readings, evidences, changes)
    answers = list(run_tasks(lambda task: task[1](), tasks, _name_task, n_jobs=n_jobs, progress=progress))
    return ReadingTable(
        recorded.name,
        frames,
        settings,
        tuple(answer for answer in answers if isinstance(answer, ReadingRow)),
        tuple(answer for answer in answers if isinstance(answer, RangeRow)),
        {
            source: score_baselines(clip, range(len(clip.cameras)), body, *poses[source][:2])
            for source, clip in seen.items()
        },
        compute_quantisation_ratio(body, settings.max_change),
    )


_Task = tuple[str, Callable[[], ReadingRow | RangeRow]]


def _name_task(task: _Task) -> Message:
    return Message("text.verbatim", text=task[0])


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
    ) -> Iterator[_Task]:
        """Names of trials and the trials."""
        for reading in readings:
            for evidence in evidences:
                for change in changes:
                    yield f"{reading}, {evidence}, {change}", partial(self._track, reading, evidence, change)
            for told in TOLD:
                yield f"{reading}, full range", partial(self._compare_ranges, reading, told)

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
    from dousa.estimation.body.kinematics import compute_points, point_names
    from dousa.estimation.body.posing import fit_poses
    from dousa.estimation.raster.rendering import render
    from dousa.estimation.silhouettes.silhouettes import PackedSilhouettes

    poses, _ = fit_poses(body, clip.truth, clip.joints)
    masks = render(body, poses, clip.cameras)
    drawn = PackedSilhouettes(masks, clip.silhouettes.frame_rate, clip.silhouettes.names)
    return replace(clip, silhouettes=drawn, joints=point_names(body), truth=compute_points(body, poses))
