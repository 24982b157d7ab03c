"""Curves over the performance's frames: distances, angles, facing, and what each furi makes of them.

Everything compares the performance with the reference on the same clock, after one turn about the vertical. Both
are turned onto the mean of a figure together: by an angle of the reference that changes slowly, and by the yaw between
the two. Pose by pose, a near-vertical one would be turned any way, and each of the two another way.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray, IndexArray
from dousa.evaluation.alignment.pairing import Pairing, pair_motions, turn_takes
from dousa.evaluation.figures.eigenspace import (
    Eigenspace,
    compute_distance_from_space,
    compute_distance_to_path,
    compute_distance_within,
)
from dousa.evaluation.figures.furi import Furi
from dousa.evaluation.posture.posture import SEGMENTS, PostureSequence, interpolate_segments
from dousa.evaluation.posture.yaw import rotate_yaw

_TURN_RATE = 30.0  # Hz, of the poses whose angle is measured


@dataclass(frozen=True, slots=True, eq=False)
class Turned:
    """Reference poses of a figure and a second around it, turned onto the figure's mean."""

    segments: FloatArray  # (n, 9, 3)
    turn: FloatArray  # (n,) rad by which they were turned, unwrapped
    seen: NDArray[np.bool_]  # (n,) where all segments are
    first: int  # frame of the reference

    def find(self, figure: Furi) -> slice:
        """Where the figure lies in the arrays."""
        return slice(figure.start - self.first, figure.end - self.first)

    def find_turn(self, frames: FloatArray) -> FloatArray:
        """(N,) rad at fractional frames of the reference, ends held."""
        return np.interp(frames, self.first + np.arange(len(self.turn)), self.turn)


def turn_reference(
    reference: PostureSequence, figure: Furi, space: Eigenspace, *, margin_s: float = 1.0, turn_window_s: float = 0.3
) -> Turned:
    """Turn the poses of a figure, and margin_s around it, onto the mean of its label's space.

    The margin is for a late performer, who shows the end of the figure before: not a wrong pose. The turn is the median
    over turn_window_s: longer than a near-vertical pose that faces anywhere, shorter than a spin. Not in the paper,
    which turns each pose by itself: a pose that is nearly vertical in all segments may then be turned any way, and
    another way than its neighbours.
    """
    margin = round(margin_s * reference.frame_rate)
    part = slice(max(figure.start - margin, 0), min(figure.end + margin, reference.n_frames))
    segments, seen = reference.segments[part], np.all(reference.seen[part], axis=1)
    step = max(1, int(reference.frame_rate // _TURN_RATE))
    sample = np.arange(0, len(segments), step)
    half = round(0.5 * turn_window_s * reference.frame_rate / step)
    angle = _smooth_turn(np.unwrap(space.find_turn(segments[sample])), half)
    turn = np.interp(np.arange(len(segments)), sample, angle)
    return Turned(rotate_yaw(segments, turn), turn, seen, part.start)


def _smooth_turn(angle: FloatArray, half: int) -> FloatArray:
    """Median of the values around each, the ends repeated."""
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(angle, half, mode="edge"), 2 * half + 1)
    return np.median(windows, axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class Curves:
    """What differs, frame by frame; nan where there is nothing to compare."""

    d_space: FloatArray  # (T,) d#, distance from the furi's eigenspace (eq. 10, 11)
    d_within: FloatArray  # (T,) d*, distance inside it at the same time (eq. 12-14)
    # (T,) distance to the nearest pose of the furi, any time of it and a second around it; turned like the moment
    # that is resembled, so that who is late is on the path
    d_path: FloatArray
    facing: FloatArray  # (T,) rad, heading against the reference's less its median, -pi to pi, to the own left
    residual: FloatArray  # (T, 9) rad, angle between each segment and the reference's at the same time
    gain: FloatArray  # (n_furi, 9) range of each segment as a share of the reference's
    lag_by_furi: FloatArray  # (n_furi,) s, median, positive is late
    furi_index: NDArray[np.intp]  # (T,) number of the furi; -1 outside all
    d_space_reference: FloatArray  # (U,) largest d# that any take of the reference has at a frame of the first
    d_within_reference: FloatArray  # (U,) largest d* of the other takes against the first; nan with one take
    # (T,) rad that turns each pose of the performance onto the mean of its furi; nan without a distance
    turn: FloatArray


def compute_curves(
    reference: PostureSequence,
    more_references: Sequence[PostureSequence],
    performance: PostureSequence,
    same_time: FloatArray,
    matched_time: FloatArray,
    furi: Sequence[Furi],
    spaces: Mapping[str, Eigenspace],
    pairing: Pairing | None = None,
) -> Curves:
    """Compute all curves of a performance.

    Parameters
    ----------
    reference : first take.
    more_references : further takes on the clock of the first, as long as it; may be empty.
    performance : at the same frame rate.
    same_time : (T,) s, reference time of each frame if the tempo is kept; outside the reference, or nan, nothing
        is compared.
    matched_time : (T,) s, reference time that each frame resembles.
    furi : in frames of the reference.
    spaces : by label.
    pairing : of `pair_motions` with the same motions and times, where that is known already.

    Source: Yamane and Shakunaga, eq. 7 to 14. They turn every pose by itself; here the reference is turned onto the
    mean by an angle that changes slowly, the performance by that less the yaw from the reference to it, which one
    wrong limb cannot bend. A pose with a segment that is not seen has no distance; its other segments keep their
    residuals.
    """
    if pairing is None:
        takes = turn_takes(reference, more_references)
        pairing = pair_motions(reference, takes, performance, same_time, matched_time)
    frames, yaw = pairing.frames, pairing.yaw
    index = _find_furi_index(frames, pairing.inside, furi, reference.n_frames)
    distances = np.full((3, len(frames)), np.nan)
    turn = np.full(len(frames), np.nan)
    references = np.full((2, reference.n_frames), np.nan)
    for number, figure in enumerate(furi):
        space = spaces[figure.label]
        turned = turn_reference(reference, figure, space)
        here = np.flatnonzero((index == number) & pairing.whole)
        angle = turned.find_turn(frames[here])
        turn[here] = angle - yaw[here]
        distances[:, here] = _measure_distances(
            space,
            turned,
            rotate_yaw(interpolate_segments(reference.segments, frames[here]), angle),
            rotate_yaw(performance.segments[here], turn[here]),
            turned.find_turn(pairing.late_frames[here]) - pairing.late_yaw[here] - turn[here],
            reference.frame_rate,
        )
        references[:, figure.start : figure.end] = _measure_takes(space, turned, figure, pairing.takes)
    lag_by_furi = _take_medians(np.asarray(same_time) - matched_time, index, len(furi))
    return Curves(
        d_space=distances[0],
        d_within=distances[1],
        d_path=distances[2],
        facing=take_off_median(yaw),
        residual=pairing.residual,
        gain=_measure_gains(reference, performance, same_time, lag_by_furi, furi, spaces),
        lag_by_furi=lag_by_furi,
        furi_index=index,
        d_space_reference=references[0],
        d_within_reference=references[1],
        turn=turn,
    )


def take_off_median(yaw: FloatArray) -> FloatArray:
    """Compute angles against their median, from above -pi to pi."""
    known = np.isfinite(yaw)
    if not known.any():
        return yaw
    # The median of angles is taken about their mean direction, or the cut at pi would move it.
    middle = np.angle(np.exp(1j * yaw[known]).sum())
    around = np.angle(np.exp(1j * (yaw - middle)))
    return np.asarray(np.angle(np.exp(1j * (around - np.median(around[known])))))


def _find_furi_index(
    frames: FloatArray, inside: NDArray[np.bool_], furi: Sequence[Furi], n_frames: int
) -> NDArray[np.intp]:
    """Number of the furi that each frame lies in, -1 outside."""
    of_frame = np.full(n_frames, -1, np.intp)
    for number, figure in enumerate(furi):
        of_frame[figure.start : figure.end] = number
    return np.where(inside, of_frame[np.rint(frames).astype(np.intp)], -1)


def _measure_distances(
    space: Eigenspace,
    turned: Turned,
    theirs: FloatArray,
    ours: FloatArray,
    further: FloatArray,
    frame_rate: float,
    *,
    path_rate: float = 60.0,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """d#, d* and the distance to the path of (n, 9, 3) poses that are turned onto the mean, (n,) each.

    Poses are turned ``further`` (n,) rad for the path.
    """
    # path_rate: Hz, of the poses of the reference that the nearest one is chosen from
    # Between the frames of the path the reference itself would be a little off it.
    nearest: FloatArray = np.linalg.norm((ours - theirs).reshape(len(ours), 27), axis=1)
    step = max(1, int(frame_rate // path_rate))
    path = turned.segments[::step][turned.seen[::step]]
    if len(path):
        nearest = np.minimum(nearest, compute_distance_to_path(space, path, rotate_yaw(ours, further)))
    return (
        compute_distance_from_space(space, ours),
        compute_distance_within(space, theirs, ours),
        nearest,
    )


def _take_medians(values: FloatArray, index: NDArray[np.intp], count: int) -> FloatArray:
    """Median of each furi's values, nan for none."""
    medians = np.full(count, np.nan)
    known = np.isfinite(values)
    for number in range(count):
        here = values[(index == number) & known]
        if len(here):
            medians[number] = np.median(here)
    return medians


def _measure_gains(
    reference: PostureSequence,
    performance: PostureSequence,
    same_time: FloatArray,
    lag_by_furi: FloatArray,
    furi: Sequence[Furi],
    spaces: Mapping[str, Eigenspace],
    *,
    range_window_s: float = 0.1,
    range_rate: float = 30.0,
    smallest_range: float = np.radians(15.0),
) -> FloatArray:
    """(n_furi, 9) ranges of the performance over the reference's; nan where the reference hardly moves."""
    # range_rate: Hz, after that smoothing
    rate = reference.frame_rate
    half, step = round(range_window_s * rate) // 2, max(1, int(rate // range_rate))
    spans: dict[int, tuple[IndexArray, IndexArray]] = {}
    for number, figure in enumerate(furi):
        if not np.isfinite(lag_by_furi[number]):
            continue
        # Who dances the figure late has the whole of it later.
        shown = (same_time - lag_by_furi[number]) * rate
        ours = np.flatnonzero((shown >= figure.start - 0.5) & (shown < figure.end - 0.5))[::step]
        if len(ours) < 2:
            continue
        # Of a figure danced in part that part is compared.
        first = max(figure.start, int(np.rint(shown[ours].min())))
        theirs = np.arange(first, min(figure.end, int(np.rint(shown[ours].max())) + step), step)
        spans[number] = theirs, ours
    ranges = np.full((2, len(furi), len(SEGMENTS)), np.nan)
    for which, motion in enumerate((reference, performance)):
        total = _sum_up(motion.segments)
        for number, span in spans.items():
            aligned = spaces[furi[number].label].align(_smooth(motion.segments, total, span[which], half))
            ranges[which, number] = _measure_range(aligned, motion.seen[span[which]])
    whole, part = ranges
    return np.asarray(np.divide(part, whole, out=np.full_like(whole, np.nan), where=whole >= smallest_range))


def _measure_range(aligned: FloatArray, seen: NDArray[np.bool_]) -> FloatArray:
    """(9,) rad, largest angle between two directions of each segment."""
    # The two lie at the ends along some direction: so only the ends along many directions are compared.
    reach = np.tensordot(aligned, _DIRECTIONS, axes=1)  # (n, 9, directions)
    unseen = ~seen[..., None]
    lowest = np.where(unseen, np.inf, reach).argmin(axis=0)
    highest = np.where(unseen, -np.inf, reach).argmax(axis=0)
    chosen = np.concatenate([lowest, highest], axis=1)  # (9, candidates)
    candidates = np.take_along_axis(aligned.transpose(1, 0, 2), chosen[..., None], axis=1)
    smallest = (candidates @ candidates.transpose(0, 2, 1)).min(axis=(1, 2))
    angle: FloatArray = np.arccos(np.clip(smallest, -1.0, 1.0))
    return np.where(seen.any(axis=0), angle, np.nan)


def _sum_up(segments: FloatArray) -> FloatArray:
    """(T + 1, 9, 3) sums of the frames before each."""
    total = np.zeros((len(segments) + 1, *segments.shape[1:]))
    np.cumsum(segments, axis=0, out=total[1:])
    return total


def _smooth(segments: FloatArray, total: FloatArray, frames: IndexArray, half: int) -> FloatArray:
    """(N, 9, 3) mean direction of the frames around some, fewer at the ends, from the sums up to each."""
    if half < 1:
        return segments[frames]
    low, high = np.maximum(frames - half, 0), np.minimum(frames + half + 1, len(segments))
    mean = total[high] - total[low]
    smooth: FloatArray = mean / np.maximum(np.linalg.norm(mean, axis=2, keepdims=True), 1e-9)
    return smooth


def _spread_directions(count: int = 32) -> FloatArray:
    """(3, count) unit vectors spread evenly over half a sphere."""
    number = np.arange(count) + 0.5
    height, turn = number / count, number * np.pi * (1.0 + np.sqrt(5.0))
    across = np.sqrt(1.0 - height**2)
    return np.stack([across * np.cos(turn), across * np.sin(turn), height])


_DIRECTIONS = _spread_directions()  # along which extreme poses are looked for, both ways: 64 candidates


def _measure_takes(
    space: Eigenspace,
    turned: Turned,
    figure: Furi,
    takes: Sequence[tuple[FloatArray, NDArray[np.bool_]]],
) -> tuple[FloatArray, FloatArray]:
    """Largest d# of all takes and d* of the others against the first, a value a frame of the figure."""
    here, part = turned.find(figure), slice(figure.start, figure.end)
    first, seen = turned.segments[here], turned.seen[here]
    d_space = np.where(seen, compute_distance_from_space(space, first), np.nan)
    d_within = np.full(len(first), np.nan)
    for segments, both in takes:
        other = rotate_yaw(segments[part], turned.turn[here])
        d_space = np.fmax(d_space, np.where(both[part], compute_distance_from_space(space, other), np.nan))
        d_within = np.fmax(d_within, np.where(both[part], compute_distance_within(space, first, other), np.nan))
    return d_space, d_within
