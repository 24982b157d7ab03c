"""Which found events belong to which injected errors."""

from __future__ import annotations

from collections.abc import Sequence

from dousa.evaluation._injection_truth import Error
from dousa.evaluation._types import ErrorEvent

__all__ = ["compute_overlap", "find_counterpart", "match_events"]


def compute_overlap(error: Error, event: ErrorEvent) -> float:
    """Intersection over union of two stretches of time, 0 to 1."""
    common = min(error.end_s, event.end_s) - max(error.start_s, event.start_s)
    union = max(error.end_s, event.end_s) - min(error.start_s, event.start_s)
    return max(common, 0.0) / union if union > 0.0 else 0.0


def match_events(
    errors: Sequence[Error], events: Sequence[ErrorEvent], least: float = 0.5
) -> tuple[tuple[int, int], ...]:
    """Pair errors with events of the same class, best overlap first, each at most once.

    Parameters
    ----------
    errors, events : of one performance.
    least : smallest intersection over union.

    Returns
    -------
    (index of error, index of event) pairs, in order of the errors.
    """
    pairs = [
        (compute_overlap(error, event), i, j)
        for i, error in enumerate(errors)
        for j, event in enumerate(events)
        if error.kind == event.kind
    ]
    matched: dict[int, int] = {}
    used: set[int] = set()
    for overlap, i, j in sorted(pairs, key=lambda pair: (-pair[0], pair[1], pair[2])):
        if overlap >= least and i not in matched and j not in used:
            matched[i] = j
            used.add(j)
    return tuple(sorted(matched.items()))


def find_counterpart(error: Error, events: Sequence[ErrorEvent], least: float = 0.1) -> ErrorEvent | None:
    """The event of any class that overlaps an error best; None if none overlaps it by ``least``."""
    best = max(events, key=lambda event: compute_overlap(error, event), default=None)
    return best if best is not None and compute_overlap(error, best) >= least else None
