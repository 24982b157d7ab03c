"""The plainest judge that does the job: a path, residuals, range and best lag of each limb, and five thresholds."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dousa.arrays import FloatArray
from dousa.evaluation.alignment.correspondence import find_path
from dousa.evaluation.posture.posture import LIMBS, compute_postures
from dousa.evaluation.posture.yaw import estimate_yaw, rotate_yaw
from dousa.motion import CanonicalMotion
from dousa.motion.runs import find_runs
from lab.training.judge_metrics import Report

_RATE, _WINDOW_S = 15.0, 1.0
_WRONG, _GLOBAL_LIMBS = np.radians(30.0), 3
_LATE_S, _SMALLER, _MOVES, _SHORTEST_S = 0.1, 0.75, np.radians(20.0), 0.3


def judge_plainly(references: Sequence[CanonicalMotion], performance: CanonicalMotion) -> list[Report]:
    """Errors against the first reference; no other is looked at."""
    theirs, ours = (compute_postures(one, _RATE).segments for one in (references[0], performance))
    path = find_path(ours, theirs)
    count = np.bincount(path[:, 0], minlength=len(ours))
    place = np.bincount(path[:, 0], weights=path[:, 1], minlength=len(ours)) / np.maximum(count, 1)
    late = np.arange(len(ours)) - place
    late -= np.median(late)
    same = np.clip(np.rint(np.arange(len(ours)) - np.median(np.arange(len(ours)) - place)), 0, len(theirs) - 1)
    matched = _turn(theirs[np.rint(place).astype(int)], ours)
    straight = _turn(theirs[same.astype(int)], ours)
    reports: list[Report] = []
    wrong = {name: _smooth(_angle(matched, ours)[:, limb].max(axis=1)) > _WRONG for name, limb in LIMBS.items()}
    whole = np.sum(list(wrong.values()), axis=0) >= _GLOBAL_LIMBS
    reports += _list("global", whole, tuple(range(9)))
    shifted = (np.abs(_smooth(late)) > _LATE_S * _RATE) & ~whole
    reports += _list("shift", shifted, tuple(range(9)), lag=_smooth(late) / _RATE)
    for name, limb in LIMBS.items():
        reports += _list("partial", wrong[name] & ~whole, limb)
        reach = [_spread(one[:, limb]) for one in (straight, ours)]
        small = (reach[1] < _SMALLER * reach[0]) & (reach[0] > _MOVES / 2.0) & ~whole & ~wrong[name] & ~shifted
        reports += _list("incomplete", small, limb, missing=2.0 * (reach[0] - reach[1]))
    return reports


def _turn(theirs: FloatArray, ours: FloatArray) -> FloatArray:
    return rotate_yaw(theirs, np.asarray(estimate_yaw(ours, theirs)[0]))


def _angle(a: FloatArray, b: FloatArray) -> FloatArray:
    angles: FloatArray = np.arccos(np.clip((a * b).sum(axis=2), -1.0, 1.0))
    return angles


def _smooth(values: FloatArray) -> FloatArray:
    kernel = np.ones(5) / 5.0
    return np.convolve(np.pad(values, 2, mode="edge"), kernel, mode="valid")


def _spread(segments: FloatArray) -> FloatArray:
    """(T,) rad, how far a limb is from its mean direction around each moment."""
    half = round(_WINDOW_S * _RATE)
    kernel = np.ones(2 * half + 1) / (2 * half + 1)
    padded = np.pad(segments, ((half, half), (0, 0), (0, 0)), mode="edge")
    mean = np.apply_along_axis(np.convolve, 0, padded, kernel, "valid")
    spread: FloatArray = np.sqrt(np.maximum(1.0 - (mean**2).sum(axis=2), 0.0)).max(axis=1)
    return spread


def _list(
    kind: str,
    mask: np.ndarray,
    segments: tuple[int, ...],
    *,
    lag: FloatArray | None = None,
    missing: FloatArray | None = None,
) -> list[Report]:
    found = []
    for start, end in find_runs(np.asarray(mask, np.bool_)).tolist():
        if end - start >= _SHORTEST_S * _RATE:
            lag_ms = None if lag is None else 1000.0 * float(np.median(lag[start:end]))
            short = None if missing is None else float(np.degrees(missing[start:end].max()))
            found.append(Report(kind, start / _RATE, end / _RATE, segments, lag_ms, short))
    return found
