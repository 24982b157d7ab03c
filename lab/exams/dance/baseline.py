"""A plain baseline: a path, residuals, range and best lag of each limb, with fixed thresholds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_closing, median_filter, uniform_filter1d

from lab.exams.dance.bodies import ALL, LIMBS, NAMES, angle, sample, unit
from lab.exams.dance.comparing import dtw, follow, residuals, to_30
from lab.exams.dance.placing import spread


def half_range(x, width=61):
    """(T, 9) degrees from the mean direction of the frames around."""
    return np.array([angle(x, unit(uniform_filter1d(x, width, axis=0)))]).max(0)


def baseline_one(x, y):
    """Against one reference: lag of the body, residual and lag of each limb, missing range."""
    at = follow(x, y)
    frames = np.arange(len(y))
    lag = uniform_filter1d((frames - at) / 30, 7)
    lag = lag - median_filter(lag, 121, mode="nearest")
    off = residuals(x, y, at)
    limb_lag = np.zeros((len(y), 4))
    shifts = [s for s in range(-12, 13) if abs(s) >= 3]
    tries = np.stack([uniform_filter1d(residuals(x, y, at - s), 31, axis=0) for s in shifts])
    now = uniform_filter1d(off, 31, axis=0)
    for k, (_, parts) in enumerate(LIMBS.values()):
        best, before = tries[:, :, parts].mean(2), now[:, parts].mean(1)
        better = (best.min(0) < 0.6 * before) & (before > 8)
        limb_lag[:, k] = np.where(better, np.array(shifts)[best.argmin(0)] / 30, 0)
    size = [half_range(v) for v in (unit(sample(x, at)), y)]
    size = [2 * np.stack([np.lib.stride_tricks.sliding_window_view(np.pad(v[:, s], 30, mode="edge"), 61).max(1)
                          for s in ALL], 1) for v in size]  # fmt: skip
    missing = np.where(size[1] < 0.75 * size[0], size[0] - size[1], 0)
    return lag, off, limb_lag, missing


@dataclass
class Found:
    """An event of the baseline."""

    kind: str
    start_s: float
    end_s: float
    segments: tuple[str, ...]
    lag_ms: float | None = None
    shortfall_deg: float | None = None


def baseline(references, performance):
    """(events, grade): fixed thresholds, the kindest of the references at every moment."""
    y = to_30(performance)
    lag, off, limb_lag, missing = (
        np.stack(v) for v in zip(*(baseline_one(to_30(r), y) for r in references), strict=True)
    )
    grade = float(np.clip(100 - 3 * off.mean((1, 2)).min(), 0, 100))

    def pick(v):
        return np.take_along_axis(v, np.abs(v).argmin(0)[None], 0)[0]

    lag, off, limb_lag, missing = pick(lag), off.min(0), pick(limb_lag), missing.min(0)
    late = np.abs(lag) > 0.08
    small = missing > 15
    limb_of = np.array([next((k for k, v in enumerate(LIMBS.values()) if s in v[1]), -1) for s in ALL])
    limb_late = np.where(limb_of >= 0, limb_lag[:, limb_of] != 0, False)
    wrong = off > 25
    everywhere = wrong.sum(1) >= 5
    rest = ~everywhere[:, None]
    masks = {
        "global": np.where(everywhere[:, None], wrong, False),
        "shift": (late[:, None] | limb_late) & rest,
        "incomplete": small & ~limb_late & rest,
        "partial": wrong & ~small & ~limb_late & rest,
    }
    events = []
    for kind, mask in masks.items():
        any_of = binary_closing(np.pad(mask.any(1), 8), np.ones(7))[8:-8]
        edges = np.flatnonzero(np.diff(np.concatenate([[0], any_of, [0]])))
        for a, b in zip(edges[::2], edges[1::2], strict=True):
            if b - a < 9:
                continue
            parts = tuple(NAMES[s] for s in ALL if mask[a:b, s].mean() > 0.3)
            delay = lag[a:b] if late[a:b].mean() > 0.3 else limb_lag[a:b][np.abs(limb_lag[a:b]) > 0]
            events.append(Found(kind, a / 30, b / 30, parts, 1e3 * float(np.median(delay)) if kind == "shift" else None,
                                float(missing[a:b].max()) if kind == "incomplete" else None))  # fmt: skip
    return events, grade


def irds_plain(references, performance):
    """One dimension: the angle from the start of the segment that moves most, its range and its DTW distance."""
    refs, y = [to_30(r) for r in references], to_30(performance)
    main = int(np.mean([spread(x) for x in refs], 0).argmax())

    def curve(x):
        return angle(x[:, main], x[0, main])

    mine, marks = curve(y), []
    for x in refs:
        theirs = curve(x)
        at = dtw(np.abs(theirs[:, None] - mine[None, :]))
        marks.append(np.abs(sample(theirs, at) - mine).mean() + abs(np.ptp(theirs) - np.ptp(mine)))
    return None, -float(min(marks))
