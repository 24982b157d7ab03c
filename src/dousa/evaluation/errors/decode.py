"""From what is likely at each moment to errors with a beginning, an end and limbs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numba import njit

from dousa.arrays import FloatArray
from dousa.evaluation.posture.posture import LIMBS

LIMB_CLASSES = ("ok", "shift", "incomplete", "partial")
BODY_CLASSES = ("ok", "shift", "incomplete", "global")
_LIMB_SEGMENTS = tuple(LIMBS.values())


@dataclass(frozen=True, slots=True)
class Decoding:
    """How moments become errors; chosen on trials.

    Parameters
    ----------
    change : price of beginning or ending an error, nats.
    shift, incomplete, partial, whole : what speaks for an error of the class at every moment, nats; ``whole`` for
        global motion errors.
    shortest_s : a shorter error is none.
    surest : mean log odds against "ok" that an error must have, nats.
    """

    change: float = 3.0
    shift: float = 0.0
    incomplete: float = 0.0
    partial: float = 0.0
    whole: float = 0.0
    shortest_s: float = 0.25
    surest: float = 0.5


@dataclass(frozen=True, slots=True)
class Suspect:
    """An error in moments.

    Parameters
    ----------
    kind : class.
    start, end : moments, half-open.
    limbs : numbers; all for an error of the body.
    surety : mean log odds against none, nats.
    """

    kind: str
    start: int
    end: int
    limbs: tuple[int, ...]
    surety: float

    @property
    def segments(self) -> tuple[int, ...]:
        """Numbers of the segments."""
        return tuple(s for limb in self.limbs for s in _LIMB_SEGMENTS[limb])


@njit(cache=True, nogil=True)
def follow_classes(scores: FloatArray, change: float) -> np.ndarray:  # pragma: no cover - compiled
    """(N,) the classes with the largest sum of (N, C) scores; every change of class costs."""
    n, n_classes = scores.shape
    if n == 0:
        return np.empty(0, np.int8)
    came = np.empty((n, n_classes), np.int8)
    best = scores[0].copy()
    for t in range(1, n):
        top = 0
        for c in range(n_classes):
            if best[c] > best[top]:
                top = c
        leap = best[top] - change
        for c in range(n_classes):
            if best[c] >= leap:
                came[t, c] = c
            else:
                came[t, c], best[c] = top, leap
        for c in range(n_classes):
            best[c] += scores[t, c]
    classes = np.empty(n, np.int8)
    last = 0
    for c in range(n_classes):
        if best[c] > best[last]:
            last = c
    for t in range(n - 1, -1, -1):
        classes[t] = last
        if t:
            last = came[t, last]
    return classes


def decode(limbs: FloatArray, body: FloatArray, rate: float, how: Decoding) -> list[Suspect]:
    """Errors of a performance, in order of time.

    Parameters
    ----------
    limbs : (N, 5, 4) log probabilities of `LIMB_CLASSES`.
    body : (N, 4) of `BODY_CLASSES`.
    rate : moments a second.
    how : prices.
    """
    found = _find_runs(body, BODY_CLASSES, tuple(range(limbs.shape[1])), rate, how)
    by_limb = [
        suspect
        for limb in range(limbs.shape[1])
        for suspect in _find_runs(limbs[:, limb], LIMB_CLASSES, (limb,), rate, how)
        if not _is_of(suspect, found)
    ]
    return sorted([*found, *_join_limbs(by_limb)], key=lambda one: (one.start, one.end))


def _find_runs(
    logs: FloatArray, names: Sequence[str], limbs: tuple[int, ...], rate: float, how: Decoding
) -> list[Suspect]:
    scores = logs.copy()
    scores[:, 1:] += [how.shift, how.incomplete, how.partial if "partial" in names else how.whole]
    classes = follow_classes(np.ascontiguousarray(scores * (15.0 / rate)), how.change)
    edges = [0, *(np.flatnonzero(np.diff(classes)) + 1), len(classes)]
    found = []
    for start, end in pairwise(edges):
        name = names[classes[start]] if end > start else "ok"
        if name == "ok" or end - start < how.shortest_s * rate:
            continue
        odds = scores[start:end, classes[start]] - scores[start:end, 0]
        if odds.mean() >= how.surest:
            found.append(Suspect(name, int(start), int(end), limbs, float(odds.mean())))
    return found


def _is_of(suspect: Suspect, body: Sequence[Suspect]) -> bool:
    """Whether what a limb does is told by what the body does."""
    for other in body:
        shared = min(suspect.end, other.end) - max(suspect.start, other.start)
        if shared <= 0.5 * (suspect.end - suspect.start):
            continue
        if other.kind in ("global", suspect.kind):
            return True
        if other.kind == "incomplete" and suspect.kind != "shift":
            return True
    return False


def _join_limbs(suspects: Sequence[Suspect]) -> list[Suspect]:
    """Limbs that do the same at the same time are one error."""
    joined: list[Suspect] = []
    for one in sorted(suspects, key=lambda suspect: (suspect.kind, suspect.start)):
        for place, other in enumerate(joined):
            shared = min(one.end, other.end) - max(one.start, other.start)
            either = max(one.end, other.end) - min(one.start, other.start)
            if other.kind == one.kind and shared > 0.5 * either and not set(one.limbs) & set(other.limbs):
                limbs = tuple(sorted({*other.limbs, *one.limbs}))
                surety = max(one.surety, other.surety)
                joined[place] = Suspect(one.kind, min(one.start, other.start), max(one.end, other.end), limbs, surety)
                break
        else:
            joined.append(one)
    return joined
