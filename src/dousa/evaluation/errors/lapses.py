"""Stops, skips, repeats, and what is missing or added at the ends: found from the lines that a performance follows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray
from dousa.evaluation.alignment.lines import Alignment
from dousa.evaluation.posture.posture import Working
from dousa.evaluation.words import date, describe_lapse
from dousa.messages import Message

_SHORTEST_END_S = 0.7  # recordings are cut half a second earlier or later as it comes
_SHORTEST_S = 0.3  # a smaller step between two lines is a matter of lag
NO_LIKENESS = 0.74  # mismatch of a performance whose lines mean nothing
_SPEED_WINDOW_S = 0.3
_STILL = 0.35  # of the reference's speed, below which a performer stands still
_SLOWEST = 0.25  # rad/s, as fast as a standing person and a tracker waver
_STILL_SHARE = 0.7  # of the lost time


@dataclass(frozen=True, slots=True)
class Lapse:
    """A stretch where the performance is not at the reference's place: no error of form, but of order.

    Parameters
    ----------
    kind : ``"stop"`` (stands still, goes on later), ``"skip"`` (leaves reference time out), ``"repeat"`` (does
        reference time again), ``"late start"`` or ``"early end"`` (of the performance's part of the reference),
        ``"lead-in"`` or ``"lead-out"`` (motion before or after, that is not in the reference).
    start_s, end_s : performance seconds.
    reference_start_s, reference_end_s : reference seconds that are left out, done again or not reached.
    """

    kind: str
    start_s: float
    end_s: float
    reference_start_s: float
    reference_end_s: float

    @property
    def message(self) -> Message:
        """What happens: ``"stands still for 1.2 s, then goes on"``."""
        spans = (self.start_s, self.end_s, self.reference_start_s, self.reference_end_s)
        return describe_lapse(self.kind, *spans)

    @property
    def says(self) -> Message:
        """When, and what happens: ``"0:31.0, stands still for 1.2 s, then goes on"``."""
        return date(self.message, self.start_s)


def find_lapses(alignment: Alignment, reference: Working, performance: Working) -> tuple[Lapse, ...]:
    """Where the performance changes its place in the reference.

    Parameters
    ----------
    alignment : lines, frames at the working rate.
    reference, performance : at the working rate.

    Returns
    -------
    In order of time. None where performance and reference have nothing in common, since no place is known then.

    Not in the paper.
    """
    if alignment.mismatch > NO_LIKENESS or performance.n_frames == 0:
        return ()
    speed = _measure_speed(performance)
    usual = _measure_speed(reference)
    found = [*_look_before(alignment, performance)]
    for run in alignment.runs[1:]:
        found += _look_between(alignment, run.start, speed, usual, performance)
    found += _look_after(alignment, reference, performance)
    return tuple(found)


def _look_before(alignment: Alignment, performance: Working) -> list[Lapse]:
    first = float(alignment.frames[0])
    if first > _SHORTEST_END_S * performance.frame_rate:
        return [Lapse("late start", 0.0, 0.0, 0.0, first / performance.frame_rate)]
    # The reference begins where the line comes to its frame 0.
    begins = int(np.searchsorted(alignment.frames, 0.0))
    if begins > _SHORTEST_END_S * performance.frame_rate:
        return [Lapse("lead-in", 0.0, begins / performance.frame_rate, 0.0, 0.0)]
    return []


def _look_after(alignment: Alignment, reference: Working, performance: Working) -> list[Lapse]:
    rate = performance.frame_rate
    end, last = performance.n_frames / rate, reference.n_frames / rate
    left = reference.n_frames - 1.0 - float(alignment.frames[-1])
    if left > _SHORTEST_END_S * rate:
        return [Lapse("early end", end, end, last - left / rate, last)]
    beyond = int((alignment.frames[::-1] > reference.n_frames - 1.0).cumprod().sum())
    if beyond > _SHORTEST_END_S * rate:
        return [Lapse("lead-out", end - beyond / rate, end, last, last)]
    return []


def _look_between(
    alignment: Alignment, start: int, speed: FloatArray, usual: FloatArray, performance: Working
) -> list[Lapse]:
    """What happens between two lines; the second begins at frame ``start``."""
    if start < 1:
        return []
    rate = performance.frame_rate
    reached, again = float(alignment.frames[start - 1]) + 1.0, float(alignment.frames[start])
    if again - reached >= _SHORTEST_S * rate:
        return [Lapse("skip", start / rate, start / rate, reached / rate, again / rate)]
    lost = reached - again
    if lost < _SHORTEST_S * rate:
        return []
    still = _find_still(start, lost, speed, usual, (again, reached), rate)
    if still is not None:
        first, last = still
        # On the line before, the reference goes on; the performer does not.
        moment = float(alignment.frames[start - 1]) - (start - 1 - first)
        if first >= start:
            moment = again + (first - start)
        moment = float(np.clip(moment, 0.0, len(usual) - 1.0)) / rate
        return [Lapse("stop", first / rate, last / rate, moment, moment)]
    end = min(start + lost, performance.n_frames)
    return [Lapse("repeat", start / rate, end / rate, again / rate, reached / rate)]


def _find_still(
    start: int, lost: float, speed: FloatArray, usual: FloatArray, span: tuple[float, float], rate: float
) -> tuple[int, int] | None:
    """The stretch around a break, as long as the time lost, in which the performer stands still, if there is one."""
    length = max(1, round(lost))
    # The break between the lines lies somewhere in the stop.
    low, high = max(0, start - length), min(len(speed), start + length)
    if high - low < length:
        return None
    around = usual[max(0, int(span[0])) : max(int(span[1]), int(span[0]) + 1)]
    limit = max(_STILL * float(np.median(around if len(around) else usual)), _SLOWEST)
    still = (speed[low:high] < limit).astype(np.float64)
    shares = np.convolve(still, np.ones(length) / length, mode="valid")
    best = shares.max()
    if best < _STILL_SHARE:
        return None
    # Equal shares lie side by side: the middle one.
    places: NDArray[np.intp] = np.flatnonzero(shares >= best - 1e-9)
    first = low + int(places[len(places) // 2])
    return first, first + length


def _measure_speed(motion: Working) -> FloatArray:
    """(T,) rad/s, mean over the segments, averaged over a moment."""
    if motion.n_frames < 2:
        return np.zeros(motion.n_frames)
    half = max(1, round(0.5 * _SPEED_WINDOW_S * motion.frame_rate))
    padded = np.pad(motion.segments, ((half, half), (0, 0), (0, 0)), mode="edge")
    chord = np.linalg.norm(padded[2 * half :] - padded[: -2 * half], axis=2).mean(axis=1)
    # At the ends the window is shorter than it looks.
    count = np.arange(motion.n_frames)
    width = np.minimum(count + half, motion.n_frames - 1) - np.maximum(count - half, 0)
    return np.asarray(chord * motion.frame_rate / width)
