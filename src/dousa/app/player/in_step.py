"""Two motions in step: for each moment of one the moment of the other that it resembles, fit for watching.

The correspondence of an assessment may stand still and jump, since it is there to be judged. Here it is there to be
watched: it goes from start to start and end to end, never back, and at a bounded tempo.
"""

from __future__ import annotations

import math

import numpy as np

from dousa.app.player.figures import Figure, mean_heading
from dousa.arrays import FloatArray
from dousa.evaluation.alignment.correspondence import compute_correlation_matrix, compute_similarity
from dousa.evaluation.posture.posture import compute_postures
from dousa.evaluation.posture.yaw import rotate_yaw


def find_turn(ours: FloatArray, theirs: FloatArray) -> float | None:
    """Angle about +Y, rad, that turns their segments (n, 9, 3) onto ours; eq. 7 over all frames. None if unclear."""
    here, there = (part[..., 2] + 1j * part[..., 0] for part in (ours, theirs))
    turn = np.nansum(here * there.conj())
    return float(np.angle(turn)) if abs(turn) > 0 else None


def put_in_step(
    reference: Figure, performance: Figure, rate: float, most_frames: int = 1200, smooth: float = 0.2
) -> tuple[FloatArray, float]:
    """Which moment of the reference each moment of the performance resembles, and how it must be turned.

    Parameters
    ----------
    reference, performance : any length.
    rate : Hz of the answer.
    most_frames : of each motion; a longer one is compared at a lower rate.
    smooth : s that the steps of whole frames are smoothed over.

    Returns
    -------
    times : (n,) s of the reference, ascending, from its first frame to its last; n frames at `rate` as long as
        the performance goes on.
    turn : rad about +Y that makes the reference look where the performance looks.

    The best path of steps through 1 - S, the correlation matrix of Yamane and Shakunaga, with a price on uneven
    tempo (not in the paper); found by dynamic programming. Two headings compete: the mean ones made equal, and the
    first ones.
    """
    longest = max(reference.duration, performance.duration)
    working = min(rate, most_frames / longest)
    ours, theirs = (compute_postures(figure, working).segments for figure in (performance, reference))  # type: ignore[arg-type]
    starts = (
        mean_heading(performance.positions) - mean_heading(reference.positions),
        mean_heading(performance.positions[:1]) - mean_heading(reference.positions[:1]),
    )
    turn, path = _match_turned(ours, theirs, starts)
    last = (reference.n_frames - 1) / reference.frame_rate
    times = _smooth(path * (last / max(path[-1], 1)), max(round(smooth * working), 1))
    n_frames = math.floor((performance.n_frames - 1) / performance.frame_rate * rate + 1e-6) + 1
    asked = np.arange(n_frames) / rate
    if len(times) > 1:
        asked = asked * ((len(times) - 1) / max(asked[-1], 1e-9))
    return np.clip(np.interp(asked, np.arange(len(times)), times), 0.0, last), turn


def _match_turned(
    ours: FloatArray, theirs: FloatArray, starts: tuple[float, float], same: float = 0.15
) -> tuple[float, FloatArray]:
    """Find the turn and the path of the greatest similarity; headings nearer than ``same`` rad give one match."""
    near = _apart(*starts) < same
    found = [_settle(ours, theirs, start, same) for start in starts[: 1 if near else 2]]
    _, turn, path = max(found, key=lambda each: each[0])
    return turn, path


def _settle(ours: FloatArray, theirs: FloatArray, turn: float, same: float) -> tuple[float, float, FloatArray]:
    """Turn by the match, match by the turn, twice; mean S, turn and path."""
    for _ in range(2):
        path = _find_steps(1.0 - compute_correlation_matrix(ours, rotate_yaw(theirs, turn)))
        matched = theirs[path]
        before, found = turn, find_turn(ours, matched)
        turn = turn if found is None else found
        if _apart(before, turn) < same:
            break
    return float(compute_similarity(ours, rotate_yaw(matched, turn)).mean()), turn, path.astype(np.float64)


def _apart(a: float, b: float) -> float:
    """Angle between two headings, rad."""
    return abs(math.remainder(a - b, 2 * math.pi))


def _find_steps(costs: np.ndarray, fastest: float = 3.0, uneven: float = 0.01) -> np.ndarray:
    """Column (n,) for each row: cheapest way from the first corner to the last, never back, not too fast.

    Parameters
    ----------
    costs : (n, m), 0 or above.
    fastest : times the mean tempo.
    uneven : price of a step at twice or none of the mean tempo, in units of the costs.
    """
    n_rows, n_columns = costs.shape
    if n_rows == 1:
        return np.zeros(1, np.intp)
    tempo = (n_columns - 1) / (n_rows - 1)
    most = max(3, math.ceil(fastest * tempo))
    advance = np.arange(most, -1, -1)  # in the order of the places in a window
    prices = (uneven * ((advance - tempo) / max(tempo, 1.0)) ** 2)[:, None]
    padded = np.full(n_columns + most, np.inf)
    windows = np.lib.stride_tricks.sliding_window_view(padded, n_columns)
    columns = np.arange(n_columns)
    taken = np.zeros((n_rows, n_columns), np.int16)
    padded[most] = costs[0, 0]
    for row in range(1, n_rows):
        ways = windows + prices
        choice = ways.argmin(axis=0)
        taken[row] = advance[choice]
        padded[most:] = ways[choice, columns] + costs[row]
    path = np.empty(n_rows, np.intp)
    path[-1] = n_columns - 1
    for row in range(n_rows - 1, 0, -1):
        path[row - 1] = path[row] - taken[row, path[row]]
    return path


def _smooth(values: FloatArray, width: int) -> FloatArray:
    """Moving mean of ascending values; first and last stay where they are, and they stay ascending."""
    reach = min(width // 2, len(values) - 1)
    if reach < 1:
        return values
    wide = np.pad(values, reach, mode="reflect", reflect_type="odd")
    sums = np.concatenate([[0.0], np.cumsum(wide)])
    length = 2 * reach + 1
    return np.asarray((sums[length:] - sums[:-length]) / length)
