"""A performance judged while it goes on: frame by frame, with the answers that the whole will have.

Of every frame what is known at once; of errors, once they are over and the look-ahead has passed, the same events
that `assess` finds in the whole; and at the end `assess` itself.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dousa.arrays import FloatArray
from dousa.errors import InvalidMotionError, OptionError
from dousa.evaluation.advice.advice import Advice, advise_on_event
from dousa.evaluation.advice.directions import PairedDancers
from dousa.evaluation.alignment.lines import Lapse
from dousa.evaluation.alignment.pairing import compare_poses
from dousa.evaluation.errors.explain import Finding
from dousa.evaluation.figures.curves import take_off_median
from dousa.evaluation.figures.furi import Furi, find_furi, fit_furi_eigenspaces, pool_takes, scale_furi
from dousa.evaluation.grade.assessment import FEWEST_FRAMES, SHORTEST_S, check_importance, check_takes, judge
from dousa.evaluation.grade.references import prepare_references
from dousa.evaluation.grade.result import Assessment, ErrorEvent, describe_findings
from dousa.evaluation.live.stream_frame import FigureMeter, LagWatcher, PoseReader, compare_with_reference, find_front
from dousa.evaluation.live.stream_window import LineFollower, Window
from dousa.evaluation.posture.posture import (
    MIRRORED_SEGMENTS,
    SEGMENTS,
    WORKING_RATE,
    PostureSequence,
    Working,
    compute_postures,
    interpolate_segments,
    mirror_postures,
    spread_weights,
    thin_postures,
)
from dousa.evaluation.posture.yaw import (
    estimate_offset,
    estimate_robust_yaw,
    find_turns,
    make_no_offset,
    take_out,
    take_out_of_pose,
    take_out_of_postures,
)
from dousa.motion import CanonicalMotion
from dousa.motion.canonical.joints import CANONICAL_JOINTS

_FLIP = np.array([-1.0, 1.0, 1.0])  # mirror image by definition: x negated
_N_JOINTS = len(CANONICAL_JOINTS)


@dataclass(frozen=True, slots=True, eq=False)
class FrameState:
    """What is known of a frame at the moment it is seen; nan where there is nothing to compare.

    Parameters
    ----------
    time_s : of the performance.
    reference_time_s : s, of the reference, if the tempo is kept (straight line).
    matched_time_s : s, reference time that the pose resembles.
    lag_ms : positive is late.
    residual : (9,) rad, angle of each segment to the reference's at the same time.
    d_space, d_within : d# and d* (eq. 10 to 14).
    wrong : names of the segments that are out of tolerance now, small lags forgiven.
    provisional : True while it is not clear yet which part of the reference is danced.
    """

    time_s: float
    reference_time_s: float
    matched_time_s: float
    lag_ms: float
    residual: FloatArray
    d_space: float
    d_within: float
    wrong: tuple[str, ...]
    provisional: bool


class IncrementalAssessor:
    """Says what differs between a performance and its reference while it goes on.

    Parameters
    ----------
    reference, furi, side, tempo, weights, importance : as for `assess`.
    frame_rate : Hz, of the frames that will come.
    look_ahead_s : s, 1 or more, after which an error that is over is reported. With ``tempo="free"`` the line bends for
        3 s after a moment, so that a shorter look-ahead is less accurate.
    offset_s : reference time at the first frame in s, if it is known (both start with the music); then no line is
        searched, and who stops or skips is late or wrong from there on. None: the line is found, and followed.

    Raises
    ------
    InvalidMotionError, OptionError : as `assess`; a frame rate or look-ahead that is none.

    Not in the paper. Where the answers may differ from those of the whole: with one reference the tolerance comes
    from the performer's own steadiness, here so far (the last three minutes of it), in the whole from all of it;
    a stop, skip or repeat is known some 3 s after it, as soon as the other line is worth it; an error of more than
    about half a minute is reported in pieces; with a free tempo the curve is that of the past. The work on a frame is
    bounded by the length of the reference. All frames are kept for `finish`; what else is kept is a fraction of it.
    """

    def __init__(
        self,
        reference: CanonicalMotion | Sequence[CanonicalMotion],
        frame_rate: float,
        *,
        furi: Sequence[Furi] | None = None,
        side: str = "same",
        tempo: str = "same",
        weights: Mapping[str, float] | None = None,
        importance: str = "learned",
        look_ahead_s: float = 2.0,
        offset_s: float | None = None,
    ) -> None:
        takes = [reference] if isinstance(reference, CanonicalMotion) else list(reference)
        _check_numbers(frame_rate, look_ahead_s, offset_s)
        if not takes:
            raise InvalidMotionError("evaluation.no_reference")
        check_takes(takes, takes[0], side, tempo)
        check_importance(importance)
        self._weights = spread_weights(weights)
        self._rate, self._mirrored = float(frame_rate), side == "mirrored"
        self._tempo, self._look_ahead_s = tempo, look_ahead_s
        self._model = takes[0]
        postures = [compute_postures(take, self._rate) for take in takes]
        self._references = prepare_references(postures, tempo, self._weights, importance=importance)
        first = self._references.postures
        self._furi = scale_furi(furi, takes[0], first) if furi else find_furi(first)
        more = pool_takes(self._references.warped, self._furi)
        spaces = fit_furi_eigenspaces(first, self._furi, more=more)
        self._figures = FigureMeter(first, tuple(self._furi), spaces)
        self._stride = self._references.working[0].stride
        self._working_rate = self._rate / self._stride
        offset = None if offset_s is None else offset_s * self._working_rate
        working = self._references.working
        self._line = LineFollower(working[0], tempo, self._weights, offset)
        self._window = Window(self._references, self._line, self._weights)
        self._watcher = LagWatcher(working, self._weights)
        self._reader = PoseReader()
        self._joints, self._group = _Rows((_N_JOINTS, 3)), _Rows((9, 3))
        self._seen, self._yaw = _Rows((9,), np.bool_), _Rows(())
        self._heading, self._matched, self._faces = _Rows(()), _Rows(()), 0.0
        self._offset = make_no_offset()
        self._turns = find_turns(self._offset)
        self._poses = np.zeros((self._stride, 9, 3))
        self._poses_seen = np.zeros((self._stride, 9), np.bool_)
        self._settled: list[ErrorEvent] = []
        self._advice: list[Advice] = []

    @property
    def n_frames(self) -> int:
        """Frames so far."""
        return self._joints.count

    @property
    def settled(self) -> tuple[ErrorEvent, ...]:
        """Errors that are over for the look-ahead and more, in order of time; they do not change any more."""
        return tuple(self._settled)

    @property
    def advice(self) -> tuple[Advice, ...]:
        """What to tell the dancer of each of `settled`, in the same order; see `dousa.evaluation.advise`."""
        return tuple(self._advice)

    @property
    def lapses(self) -> tuple[Lapse, ...]:
        """Stops, skips and repeats so far; they do not change any more."""
        return tuple(self._window.lapses)

    @property
    def tolerance(self) -> FloatArray:
        """(9,) rad, what is tolerated of each segment now."""
        return self._window.tolerance.angle.copy()

    def push(self, joints: ArrayLike) -> FrameState:
        """Take the next frame: joints (20, 3) m, order of `CANONICAL_JOINTS`, Y up; nan where a joint is not seen.

        Returns what is known of it. About once a second the call takes longer, when the last seconds are looked at.
        Raises InvalidMotionError for another shape or infinite values; the frame is not taken then.
        """
        points = _check_frame(joints)
        number = self.n_frames
        self._joints.add(points)
        pose, seen = self._reader.read(points)
        faces = find_front(points)
        if self._mirrored:
            pose, seen, faces = pose[MIRRORED_SEGMENTS, :] * _FLIP, seen[list(MIRRORED_SEGMENTS)], -faces
        self._faces = faces if np.isfinite(faces) else self._faces
        slot = number % self._stride
        self._poses[slot], self._poses_seen[slot] = pose, seen
        if slot == self._stride - 1:
            self._take_working_frame()
        bare = take_out_of_pose(pose, self._faces, self._turns)
        return self._describe(number, bare, seen & ~self._offset.missing)

    def finish(self) -> Assessment:
        """Assess all frames so far, as `assess` does.

        Returns
        -------
        The same as ``assess(reference, performance, ...)``; more frames may follow.

        Raises
        ------
        InvalidMotionError : fewer than 3 frames or half a second.
        """
        if self.n_frames < max(FEWEST_FRAMES, SHORTEST_S * self._rate):
            raise InvalidMotionError(
                "live_evaluation.too_few_frames",
                least_s=SHORTEST_S,
                least_frames=FEWEST_FRAMES,
                n_frames=self.n_frames,
                rate=self._rate,
                duration=self.n_frames / self._rate,
            )
        return judge(
            self._references,
            self._furi,
            self._read_postures(0),
            side="mirrored" if self._mirrored else "same",
            tempo=self._tempo,
            weights=self._weights,
        )

    def _take_working_frame(self, *, hop_s: float = 1.0) -> None:
        mean = self._poses.mean(axis=0)
        mean /= np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-9)
        self._group.add(mean)
        self._seen.add(np.all(self._poses_seen, axis=0, keepdims=True)[0])
        self._heading.add(np.asarray(self._faces))
        count = self._group.count
        if count % max(1, round(hop_s * self._working_rate)) == 0:
            self._look_back()
        self._watch(count - 1)

    def _watch(self, frame: int) -> None:
        there = float(self._line.locate(frame, frame + 1)[0])
        pose = take_out_of_pose(self._group.values[frame], float(self._heading.values[frame]), self._turns)
        seen = self._seen.values[frame] & ~self._offset.missing
        self._watcher.look(pose, seen, there, self._window.tolerance)
        if frame == self._yaw.count:
            self._yaw.add(np.asarray(self._watcher.yaw))
            self._matched.add(np.asarray(there - self._watcher.lag_s * self._working_rate))

    def _look_back(self, *, replayed_s: float = 0.5, moved: float = 0.25) -> None:
        """Once a second: the line, the deviations along it, and the errors that are over."""
        # moved: frames by which the line must move for the lag to be followed from the beginning again
        count = self._group.count
        performance = Working(
            self._group.values, self._seen.values, self._heading.values, self._working_rate, self._stride
        )
        self._line.update(performance.segments)
        self._estimate_body(performance)
        performance = take_out(performance, self._offset)
        if self._window.update(performance) > moved:
            self._watcher.forget()
            for frame in range(max(count - 1 - round(replayed_s * self._working_rate), 0), count - 1):
                self._watch(frame)
        if not self._line.known:
            return
        until = count - round(self._look_ahead_s * self._working_rate)
        found = self._window.settle(performance, until)
        if found:
            self._settled += self._tell(found, performance)

    def _estimate_body(self, performance: Working, *, most_moments: int = 600) -> None:
        """How the performer's body differs from the reference's, as far as it has been seen."""
        # most_moments: number that the performer's body is estimated from
        if not self._line.known:
            return
        matched = self._matched.values
        known = np.flatnonzero((matched >= 0.0) & (matched <= self._references.working[0].n_frames - 1.0))
        if len(known):
            known = known[:: max(1, len(known) // most_moments)]
            pairs = np.column_stack([np.rint(matched[known]).astype(np.intp), known])
            reference, between = self._references.working[0], self._references.between
            self._offset = estimate_offset(reference, performance, pairs, between)
            self._turns = find_turns(self._offset)

    def _tell(self, found: Sequence[Finding], performance: Working, *, margin_s: float = 1.0) -> tuple[ErrorEvent, ...]:
        """Events in words, from the curves of the last seconds."""
        first = min(finding.start for finding in found) - round(margin_s * self._working_rate)
        first = max(first, self._window.first) * self._stride
        there = self._place_frames(first)
        part = self._read_postures(first)
        part = take_out_of_postures(part, thin_postures(part), self._offset)
        residual, yaw = self._compare(part, there)
        count = self.n_frames
        index, same = np.full(count, -1, np.intp), np.full(count, np.nan)
        inside = np.isfinite(there)
        index[first:][inside] = self._figures.index[np.rint(there[inside]).astype(np.intp)]
        same[first:] = there / self._rate
        residuals, facing = np.full((count, len(SEGMENTS)), np.nan), np.full(count, np.nan)
        residuals[first:] = residual
        # Of the heading the usual difference so far is taken off.
        facing[first:] = take_off_median(np.concatenate([self._yaw.values, yaw]))[-len(yaw) :]
        events = describe_findings(
            found,
            self._window.lapses,
            working=performance,
            same_time=same,
            residual=residuals,
            facing=facing,
            furi_index=index,
        )
        dancers = PairedDancers(self._references.postures, part, same[first:], first / self._rate)
        for event in events:
            self._advice.append(advise_on_event(event, len(self._advice), dancers, self._furi))
        return events

    def _place_frames(self, first: int) -> FloatArray:
        """Reference frames of the frames from the first on, nan outside the reference."""
        n_reference, middle = self._references.postures.n_frames, 0.5 * (self._stride - 1)
        centres = (self._window.first + np.arange(len(self._window.frames))) * self._stride + middle
        there = np.interp(np.arange(first, self.n_frames), centres, self._window.frames * self._stride + middle)
        inside = (there >= -0.5) & (there <= n_reference - 0.5)
        return np.where(inside, np.clip(there, 0.0, n_reference - 1.0), np.nan)

    def _compare(self, part: PostureSequence, there: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Angles to the reference and headings, as for the whole."""
        reference = self._references.postures
        inside = np.isfinite(there)
        frames = np.where(inside, there, 0.0)
        seen = reference.seen[np.floor(frames).astype(np.intp)] & reference.seen[np.ceil(frames).astype(np.intp)]
        judged = part.seen & seen & inside[:, None]
        return compare_poses(interpolate_segments(reference.segments, frames), part.segments, judged, self._rate)

    def _read_postures(self, first: int) -> PostureSequence:
        """Postures of the frames from the first on, gaps filled as for the whole."""
        positions = self._joints.values[first:].copy()
        performance = replace(self._model, positions=positions, frame_rate=self._rate, missing=None, warnings=())
        postures = compute_postures(performance)
        return mirror_postures(postures) if self._mirrored else postures

    def _describe(self, number: int, pose: FloatArray, seen: NDArray[np.bool_]) -> FrameState:
        reference, middle = self._references.postures, 0.5 * (self._stride - 1)
        place = (number - middle) / self._stride
        whole = int(np.floor(place))
        low, high = self._line.locate(whole, whole + 2) if self._tempo == "free" else (0.0, 0.0)
        line = low + (place - whole) * (high - low)
        if self._tempo != "free":
            line = place + self._line.runs[-1].offset
        there = line * self._stride + middle
        time_s, nothing = number / self._rate, np.full(len(SEGMENTS), np.nan)
        provisional = not self._line.known
        if not -0.5 <= there <= reference.n_frames - 0.5:
            return FrameState(time_s, np.nan, np.nan, np.nan, nothing, np.nan, np.nan, (), provisional)
        there = min(max(there, 0.0), reference.n_frames - 1.0)
        yaw = self._watcher.yaw
        if not np.isfinite(yaw):
            yaw = float(estimate_robust_yaw(pose, reference.segments[round(there)])[0])
        residual, whole_pose = compare_with_reference(reference, pose, seen, there, yaw)
        d_space, d_within = self._figures.measure(pose, there, yaw) if whole_pose else (np.nan, np.nan)
        lag_s, same_s = self._watcher.lag_s, there / self._rate
        end_s = (reference.n_frames - 1) / self._rate
        return FrameState(
            time_s=time_s,
            reference_time_s=same_s,
            matched_time_s=min(max(same_s - lag_s, 0.0), end_s) if np.isfinite(lag_s) else np.nan,
            lag_ms=1000.0 * lag_s,
            residual=residual,
            d_space=d_space,
            d_within=d_within,
            wrong=self._find_wrong(residual),
            provisional=provisional,
        )

    def _find_wrong(self, residual: FloatArray) -> tuple[str, ...]:
        limit = self._window.tolerance.angle
        with np.errstate(invalid="ignore"):
            over = (residual > limit) & ~(self._watcher.forgiven <= limit**2)
        return tuple(SEGMENTS[index] for index in np.flatnonzero(over))


class _Rows:
    """An array that grows."""

    def __init__(self, shape: tuple[int, ...], dtype: type = np.float64) -> None:
        self._array: np.ndarray = np.empty((1024, *shape), dtype)
        self.count = 0

    @property
    def values(self) -> np.ndarray:
        """All rows so far."""
        return self._array[: self.count]

    def add(self, row: np.ndarray) -> None:
        """One more."""
        if self.count == len(self._array):
            self._array = np.concatenate([self._array, np.empty_like(self._array)])
        self._array[self.count] = row
        self.count += 1


def _check_numbers(frame_rate: float, look_ahead_s: float, offset_s: float | None) -> None:
    if not (np.isfinite(frame_rate) and frame_rate > 0.0):
        raise OptionError("live_evaluation.frame_rate", rate=frame_rate)
    if frame_rate > 1000.0 * WORKING_RATE:
        raise OptionError("live_evaluation.high_frame_rate", most=1000.0 * WORKING_RATE, rate=frame_rate)
    if not (np.isfinite(look_ahead_s) and look_ahead_s >= 1.0):
        raise OptionError("live_evaluation.look_ahead", seconds=look_ahead_s)
    if offset_s is not None and not np.isfinite(offset_s):
        raise OptionError("live_evaluation.offset", seconds=offset_s)


def _check_frame(joints: ArrayLike) -> FloatArray:
    try:
        points = np.asarray(joints, np.float64)
    except (TypeError, ValueError) as error:
        raise InvalidMotionError("live_evaluation.not_numbers", reason=error) from error
    if points.shape != (_N_JOINTS, 3):
        raise InvalidMotionError("live_evaluation.shape", shape=points.shape)
    if np.isinf(points).any():
        raise InvalidMotionError("live_evaluation.infinite")
    return points
