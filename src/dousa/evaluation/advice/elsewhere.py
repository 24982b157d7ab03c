"""Which other figure of the reference somebody danced instead."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dousa.arrays import FloatArray
from dousa.evaluation.alignment.correlation import compute_correlation_matrix
from dousa.evaluation.grade.result import FuriAssessment
from dousa.evaluation.posture.posture import PostureSequence

_RATE = 10.0  # Hz, at which is searched
_AROUND_S = 1.0  # the place where it belongs, which is not looked at
_SHORTEST_S = 0.6
_FADE_S = 0.4  # at both ends of the stretch, where one figure becomes the other
_MUCH = 0.4  # of the stretch
_ALIKE = 1.0 - float(np.cos(np.radians(25.0)))  # mean over segments and moments
_BETTER = 0.4  # of the difference from what is expected


def find_other_figure(
    reference: PostureSequence,
    performance: FloatArray,
    frame_rate: float,
    expected_s: float,
    furi: Sequence[FuriAssessment],
) -> int | None:
    """Number of the figure, from 0, that a stretch resembles instead of the one that belongs there.

    Parameters
    ----------
    reference : the whole of it.
    performance : (N, 9, 3) unit vectors of the stretch.
    frame_rate : Hz of the stretch.
    expected_s : reference time that belongs to its first frame.
    furi : figures in order of the reference.

    Returns
    -------
    None if nothing elsewhere is alike, or only the same figure again.
    """
    if len(performance) < _SHORTEST_S * frame_rate or not np.isfinite(expected_s):
        return None
    fade = int(min(_FADE_S, 0.2 * len(performance) / frame_rate) * frame_rate)
    performance, expected_s = performance[fade : len(performance) - fade], expected_s + fade / frame_rate
    count = max(round(len(performance) / frame_rate * _RATE), 2)
    places = np.linspace(0, len(performance) - 1, count).round().astype(np.intp)
    step = places[-1] / frame_rate / (count - 1)  # s
    total = int(reference.n_frames / reference.frame_rate / step)
    if total <= count:
        return None
    frames = np.rint(np.arange(total) * step * reference.frame_rate).astype(np.intp)
    theirs = reference.segments[np.minimum(frames, reference.n_frames - 1)]
    unlike = 1.0 - np.asarray(compute_correlation_matrix(performance[places], theirs), np.float64)
    starts = np.arange(total - count + 1)
    rows = np.arange(count)
    mean = np.array([unlike[rows, start + rows].mean() for start in starts])
    here = int(np.clip(round(expected_s / step), 0, len(mean) - 1))
    away = np.abs(starts * step - expected_s) > _AROUND_S
    if not away.any():
        return None
    best = int(starts[away][mean[away].argmin()])
    if mean[best] > _ALIKE or mean[best] > _BETTER * mean[here]:
        return None
    spans = [
        (min(one.reference_end_s, start + count * step) - max(one.reference_start_s, start)) / (count * step)
        for start in (expected_s, best * step)
        for one in furi
    ]
    return _choose_figure(furi, spans[: len(furi)], spans[len(furi) :])


def _choose_figure(furi: Sequence[FuriAssessment], expected: Sequence[float], found: Sequence[float]) -> int | None:
    """The figure that takes the largest share of what was found, unless it is one that was expected."""
    known = {one.label for one, share in zip(furi, expected, strict=True) if share > _MUCH}
    others = [k for k, one in enumerate(furi) if one.label not in known and found[k] > _MUCH]
    return max(others, key=lambda k: found[k], default=None)
