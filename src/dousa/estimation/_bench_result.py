"""What an experiment with silhouettes found, clip by clip and in the mean."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from dousa.estimation._accuracy import Accuracy, ImageAccuracy

if TYPE_CHECKING:
    from dousa.estimation._types import TrackerSettings

__all__ = ["METHODS", "BenchResult", "BenchRow", "Score"]

METHODS: tuple[str, ...] = ("estimate", "frozen", "constant_velocity")
"""What is compared: the tracker; the first pose held; what the first two true poses foretell."""

_MEANS = ("mean_mm", "root_mm", "rigid_mm", "segment_deg", "angle_deg", "pck_50", "pck_100", "loss_rate",
          "visible_mm", "occluded_mm", "jitter_m_s2", "mean_px", "percent_of_stature")  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Score:
    """How near one method came.

    Parameters
    ----------
    accuracy : in space.
    image : in the views that were looked at.
    """

    accuracy: Accuracy
    image: ImageAccuracy

    def to_json(self) -> dict[str, Any]:
        """The numbers that sum it up."""
        return {**self.accuracy.to_json(), **self.image.to_json()}


@dataclass(frozen=True, slots=True, eq=False)
class BenchRow:
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
    warnings: tuple[str, ...] = ()
    problem: str | None = None

    @property
    def is_lost(self) -> bool:
        """Whether the tracker lost the clip, see `Accuracy.is_lost`; a problem counts as lost."""
        return self.problem is not None or self.scores["estimate"].accuracy.is_lost

    def to_json(self) -> dict[str, Any]:
        """All of it, the arrays summed up."""
        return {
            "clip": self.clip,
            "variant": self.variant,
            "views": list(self.views),
            **{name: score.to_json() for name, score in self.scores.items()},
            "is_lost": self.is_lost,
            "iou": self.iou,
            "frames_per_second": self.frames_per_second,
            "warnings": list(self.warnings),
            "problem": self.problem,
        }


@dataclass(frozen=True, slots=True, eq=False)
class BenchResult:
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
        return {
            "settings": asdict(self.settings),
            "start": self.start,
            "body": self.body,
            "summary": self.summarise(),
            "clips": [row.to_json() for row in self.rows],
        }


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
            ours[number] < frozen[number]
            for ours, frozen in zip(numbers["estimate"], numbers["frozen"], strict=True)
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
    numbers = [value for value in values if np.isfinite(value)]
    return float(np.mean(numbers)) if numbers else float("nan")
