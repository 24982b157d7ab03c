"""A performance judged while it goes on: `assess` on a window that slides with it.

The line to the reference is carried on by the alignment's own search. Of every pose what is known at once; each moment
is judged once, by the judge of the whole, when the look-ahead has passed; and at the end `assess` itself.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from dousa.arrays import FloatArray
from dousa.errors import InvalidMotionError, OptionError
from dousa.evaluation.advice.advice import Advice, advise_on_event
from dousa.evaluation.advice.directions import PairedDancers
from dousa.evaluation.alignment.lines import Alignment, Lapse, LineFollower, Run, find_lapses
from dousa.evaluation.alignment.pairing import compare_poses
from dousa.evaluation.errors.causes import tell_errors
from dousa.evaluation.errors.descriptors import choose_stride, join_descriptors
from dousa.evaluation.errors.deviations import MAX_LAG_S, YAW_WINDOW_S, Deviations, compute_deviations, merge_takes
from dousa.evaluation.errors.evidence import Evidence, Tolerance, gather_evidence
from dousa.evaluation.errors.findings import Finding
from dousa.evaluation.errors.judge import decode, load_judge
from dousa.evaluation.figures.curves import take_off_median
from dousa.evaluation.figures.furi import Furi, find_furi, fit_furi_eigenspaces, pool_takes, scale_furi
from dousa.evaluation.grade.assessment import FEWEST_FRAMES, SHORTEST_S, check_takes, judge, name_faults
from dousa.evaluation.grade.movement import compare_movements, describe_movement
from dousa.evaluation.grade.references import choose_tolerance, describe, prepare_references, spread_in_time
from dousa.evaluation.grade.result import Assessment, ErrorEvent, describe_findings
from dousa.evaluation.grade.score import grade_performance
from dousa.evaluation.live.pose import FigureMeter, LagWatcher
from dousa.evaluation.posture.posture import (
    MIRRORED_SEGMENTS,
    REST,
    SEGMENTS,
    WORKING_RATE,
    PostureSequence,
    Working,
    compute_postures,
    compute_segments,
    interpolate_segments,
    mirror_postures,
    spread_weights,
    thin_postures,
)
from dousa.evaluation.posture.yaw import (
    estimate_offset,
    find_turns,
    make_no_offset,
    take_out,
    take_out_of_pose,
    take_out_of_postures,
)
from dousa.motion import CanonicalMotion
from dousa.motion.canonical.joints import CANONICAL_JOINTS
from dousa.motion.canonical.joints import JOINT_INDEX as J

_FLIP = np.array([-1.0, 1.0, 1.0])  # mirror image by definition: x negated
_N_JOINTS = len(CANONICAL_JOINTS)
_SIDES = np.array([[J[f"{side}_{joint}"] for joint in ("hip", "shoulder")] for side in ("left", "right")])
# s from one look at the last seconds to the next, and how many these are: `lab.benchmarks.assess --agreement`
_HOP_S, WINDOW_S = 2.0, 12.0
_MOVED = 0.25  # frames by which a line must have moved for its deviations to be measured again, see docs/evaluation.md


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
    reference, furi, side, tempo, weights : as for `assess`; the side is not found by itself.
    frame_rate : Hz, of the frames that will come.

    Raises
    ------
    InvalidMotionError, OptionError : as `assess`; a frame rate that is none.

    Not in the paper. Where the answers may differ from those of the whole: with one reference the tolerance comes
    from the performer's own steadiness, here of the last minute, in the whole from all of it; a stop, skip or repeat
    is known some 3 s after it, as soon as the other line is worth it; an error is measured by the part of it that lies
    in the last 12 s; with a free tempo the curve is that of the past. The work on a frame is bounded by the length of
    the reference. All frames are kept for `finish`.
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
    ) -> None:
        takes = [reference] if isinstance(reference, CanonicalMotion) else list(reference)
        if not (np.isfinite(frame_rate) and frame_rate > 0.0):
            raise OptionError("live_evaluation.frame_rate", rate=frame_rate)
        if frame_rate > 1000.0 * WORKING_RATE:
            raise OptionError("live_evaluation.high_frame_rate", most=1000.0 * WORKING_RATE, rate=frame_rate)
        if not takes:
            raise InvalidMotionError("evaluation.no_reference")
        check_takes(takes, takes[0], side, tempo)
        self._weights = spread_weights(weights)
        self._rate, self._tempo, self._model = float(frame_rate), tempo, takes[0]
        self._mirrored = side == "mirrored"
        postures = [compute_postures(take, self._rate) for take in takes]
        self._references = prepare_references(postures, tempo, self._weights)
        first, working = self._references.postures, self._references.working
        self._furi = scale_furi(furi, takes[0], first) if furi else find_furi(first)
        spaces = fit_furi_eigenspaces(first, self._furi, more=pool_takes(self._references.warped, self._furi))
        self._figures = FigureMeter(first, self._furi, spaces)
        self._watcher = LagWatcher(working, self._weights)
        self._stride, self._working_rate = working[0].stride, working[0].frame_rate
        self._line = LineFollower(working[0], tempo, self._weights)
        self._window = _Window(self)
        # The largest lag; or as long as the line of a free tempo bends after a moment, see `smooth_course`.
        self._look_ahead = round((1.0 if tempo == "same" else 2.5) * MAX_LAG_S * self._working_rate)
        self._hop = max(2, round(_HOP_S * self._working_rate))
        self._joints, self._segments, self._seen = _Rows((_N_JOINTS, 3)), _Rows((9, 3)), _Rows((9,), np.bool_)
        self._heading, self._yaw, self._matched = _Rows(()), _Rows(()), _Rows(())
        self._ahead, self._ahead_from = self._line.locate(0, 2 * self._hop), 0
        self._offset, self._turns, self._known_by = make_no_offset(), find_turns(make_no_offset()), 0
        self._settled: list[ErrorEvent] = []
        self._advice: list[Advice] = []
        self._state = self._describe(0, REST)

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
    def grade(self) -> float:
        """Grade of the last 12 s, 0 to 100, as that of a furi of `assess`; nan before anything is compared."""
        return self._window.grade()

    def push(self, joints: ArrayLike) -> FrameState:
        """Take the next frame: joints (20, 3) m, order of `CANONICAL_JOINTS`, Y up; nan where a joint is not seen.

        Returns what is known of it; above 30 Hz, of the group of frames that was last complete. Once a second the call
        takes longer, when the last seconds are looked at. Raises InvalidMotionError for another shape or infinite
        values; the frame is not taken then.
        """
        self._joints.add(_check_frame(joints))
        if self.n_frames % self._stride == 0:
            self._take_pose()
        return self._state

    def finish(self) -> Assessment:
        """Assess all frames so far: the same as ``assess(reference, performance, ...)``; more frames may follow.

        Raises InvalidMotionError for fewer than 3 frames or half a second.
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
        side = "mirrored" if self._mirrored else "same"
        played = self._read_postures(0)
        found = judge(self._references, self._furi, played, side=side, tempo=self._tempo, weights=self._weights)
        return name_faults(self._references, found)

    def _take_pose(self) -> None:
        group = self._joints.values[-self._stride :]
        pose = compute_segments(group).mean(axis=0)
        seen = ~np.isnan(pose[:, 0])
        pose /= np.maximum(np.sqrt((pose * pose).sum(axis=1, keepdims=True)), 1e-9)
        left, right = group[0][_SIDES].sum(axis=1)
        faces = np.arctan2(left[0] - right[0], left[2] - right[2])
        if self._mirrored:
            pose, seen, faces = pose[MIRRORED_SEGMENTS, :] * _FLIP, seen[list(MIRRORED_SEGMENTS)], -faces
        count = self._segments.count
        if not seen.all():
            pose[~seen] = self._segments.values[-1][~seen] if count else REST[~seen]
        if np.isnan(faces):
            faces = self._heading.values[-1] if count else 0.0
        for rows, value in ((self._segments, pose), (self._seen, seen), (self._heading, faces)):
            rows.add(value)
        # Half a hop apart, so that no frame waits for both.
        half = (count + 1) % self._hop == self._hop // 2
        if (count + 1) % self._hop == 0 or (half and not self._line.known):
            self._find_line()
        if half and self._line.known:
            self._window.update()
            self._tell(self._window.settle(count + 1 - self._look_ahead))
        self._state = self._describe(count, self._watch(count))

    def _watch(self, frame: int) -> FloatArray:
        """The pose of a working frame as by the reference's body, compared."""
        pose = take_out_of_pose(self._segments.values[frame], float(self._heading.values[frame]), self._turns)
        there, seen = self._place(frame), self._seen.values[frame] & ~self._offset.missing
        self._watcher.look(pose, seen, there, self._window.tolerance)
        if frame == self._yaw.count:
            self._yaw.add(np.asarray(self._watcher.yaw))
            self._matched.add(np.asarray(there - self._watcher.lag_s * self._working_rate))
        return pose

    def _place(self, frame: int) -> float:
        return float(self._ahead[min(max(frame - self._ahead_from, 0), len(self._ahead) - 1)])

    def _find_line(self, *, replayed_s: float = 0.5) -> None:
        count, before = self._segments.count, self._place(self._segments.count)
        self._line.update(self._performance())
        self._ahead_from = count - self._hop
        self._ahead = self._line.locate(self._ahead_from, count + 2 * self._hop)
        if self._line.known:
            self._estimate_body()
        if abs(self._place(count) - before) > _MOVED:
            self._watcher.forget()
            for frame in range(max(count - 1 - round(replayed_s * self._working_rate), 0), count - 1):
                self._watch(frame)

    def _performance(self, first: int = 0, last: int | None = None) -> Working:
        """The poses of some working frames."""
        segments, seen, heading = (rows.values[first:last] for rows in (self._segments, self._seen, self._heading))
        return Working(segments, seen, heading, self._working_rate, self._stride)

    def _estimate_body(self, *, growth: float = 1.3, most_moments: int = 600) -> None:
        """How the performer's body differs from the reference's, whenever more of it has been seen."""
        # most_moments: that it is estimated from
        reference, matched = self._references.working[0], self._matched.values
        known = np.flatnonzero((matched >= 0.0) & (matched <= reference.n_frames - 1.0))
        if len(known) > growth * self._known_by:
            self._known_by = len(known)
            known = known[:: max(1, len(known) // most_moments)]
            pairs = np.column_stack([np.rint(matched[known]).astype(np.intp), known])
            self._offset = estimate_offset(reference, self._performance(), pairs, self._references.between)
            self._turns = find_turns(self._offset)

    def _tell(self, found: Sequence[Finding], *, margin_s: float = 1.0) -> None:
        """Put errors into words, from the curves of the last seconds."""
        if not found:
            return
        window, count, reference = self._window, self.n_frames, self._references.postures
        first = min(finding.start for finding in found) - round(margin_s * self._working_rate)
        first = max(first, window.first) * self._stride
        middle = 0.5 * (self._stride - 1)
        centres = (window.first + np.arange(len(window.frames))) * self._stride + middle
        there = np.interp(np.arange(first, count), centres, window.frames * self._stride + middle)
        inside = (there >= -0.5) & (there <= reference.n_frames - 0.5)
        there = np.clip(there, 0.0, reference.n_frames - 1.0)
        part = self._read_postures(first)
        part = take_out_of_postures(part, thin_postures(part), self._offset)
        seen = reference.seen[np.floor(there).astype(np.intp)] & reference.seen[np.ceil(there).astype(np.intp)]
        judged = part.seen & seen & inside[:, None]
        theirs = interpolate_segments(reference.segments, there)
        residual, yaw = compare_poses(theirs, part.segments, judged, self._rate)
        index, same = np.full(count, -1, np.intp), np.full(count, np.nan)
        index[first:][inside] = self._figures.index[np.rint(there[inside]).astype(np.intp)]
        same[first:] = np.where(inside, there / self._rate, np.nan)
        residuals, facing = np.full((count, len(SEGMENTS)), np.nan), np.full(count, np.nan)
        residuals[first:] = residual
        # Of the heading the usual difference so far is taken off.
        facing[first:] = take_off_median(np.concatenate([self._yaw.values, yaw]))[-len(yaw) :]
        events = describe_findings(
            found,
            window.lapses,
            working=self._performance(),
            same_time=same,
            residual=residuals,
            facing=facing,
            furi_index=index,
        )
        dancers = PairedDancers(reference, part, same[first:], first / self._rate)
        for event in events:
            self._advice.append(advise_on_event(event, len(self._advice), dancers, self._furi))
        self._settled += events

    def _read_postures(self, first: int) -> PostureSequence:
        """Postures of the frames from the first on, gaps filled as for the whole."""
        positions = self._joints.values[first:].copy()
        performance = replace(self._model, positions=positions, frame_rate=self._rate, missing=None, warnings=())
        postures = compute_postures(performance)
        return mirror_postures(postures) if self._mirrored else postures

    def _describe(self, frame: int, pose: FloatArray) -> FrameState:
        reference, middle = self._references.postures, 0.5 * (self._stride - 1)
        time_s, there = (frame * self._stride + middle) / self._rate, self._place(frame) * self._stride + middle
        provisional, watcher = not self._line.known, self._watcher
        if not (np.isfinite(watcher.yaw) and -0.5 <= there <= reference.n_frames - 0.5):
            nothing = np.full(len(SEGMENTS), np.nan)
            return FrameState(time_s, np.nan, np.nan, np.nan, nothing, np.nan, np.nan, (), provisional)
        there = min(max(there, 0.0), reference.n_frames - 1.0)
        whole = not np.isnan(watcher.residual).any()
        distances = self._figures.measure(pose, there, watcher.yaw) if whole else (np.nan, np.nan)
        same_s, lag_s, end_s = there / self._rate, watcher.lag_s, (reference.n_frames - 1) / self._rate
        matched_s = min(max(same_s - lag_s, 0.0), end_s)
        limit = self._window.tolerance.angle
        over = (watcher.residual > limit) & (watcher.forgiven > limit**2)
        wrong = tuple(SEGMENTS[index] for index in np.flatnonzero(over))
        return FrameState(time_s, same_s, matched_s, 1000.0 * lag_s, watcher.residual, *distances, wrong, provisional)


class _Window:
    """The last seconds of a performance beside the reference, and what the judge says of them."""

    def __init__(self, of: IncrementalAssessor) -> None:
        self._of, self._rate = of, of._working_rate
        self._context = 2 * max(1, round(0.5 * YAW_WINDOW_S * self._rate))
        self._moments = choose_stride(self._rate)  # working frames from one to the next
        self.first, self.frames = 0, np.empty(0)  # first working frame that is kept; reference frames of those kept
        self._parts: Deviations | None = None
        self._history, self._counted, self._measured = list[Deviations](), 0, 0
        self.tolerance = Tolerance(np.full(9, np.radians(21.6)))  # until a second was seen: the least steady one's
        self.lapses: list[Lapse] = []
        # Log probabilities of the moments from one on, and what was usual in them.
        self._from = 0
        self._limbs, self._body, self._usual = np.empty((0, 5, 4)), np.empty((0, 4)), np.empty((0, 5, 4))
        self._reported: list[Finding] = []

    def update(self) -> None:
        """Measure the deviations of what is new, or along another line than before."""
        line, count = self._of._line, self._of._segments.count
        first = max(count - round(WINDOW_S * self._rate), self.first) // self._moments * self._moments
        frames, kept = line.locate(first, count), self.frames[first - self.first :]
        moved = np.abs(kept - frames[: len(kept)]) > _MOVED
        old = max(len(kept) - self._context, 0)
        old = min(old, int(moved.argmax())) if moved.any() else old
        used = np.concatenate([kept[:old], frames[old:]])
        begin = max(first + old - self._context, 0)
        along = np.concatenate([line.locate(begin, first), used[max(begin - first, 0) :]])
        part = take_out(self._of._performance(begin), self._of._offset)
        references, weights = self._of._references.working, self._of._weights
        new = merge_takes(compute_deviations(take, part, along, weights) for take in references)
        new = new.cut(slice(first + old - begin, None))
        if self._parts is not None and old:
            new = self._parts.cut(slice(first - self.first, first - self.first + old)).extend(new)
        self._parts, self.frames, self.first = new, used, first
        self._learn()

    def _learn(self, *, growth: float = 1.2, few_s: float = 1.0, history_s: float = 60.0, near_s: float = 0.6) -> None:
        """The tolerance, from the last minute, whenever more has been seen."""
        assert self._parts is not None
        last = self.first + len(self.frames) - self._context
        reach = min(round(near_s * self._rate), self._parts.center)
        if last > self._counted:
            part = self._parts.cut(slice(max(self._counted - self.first, 0), last - self.first))
            near = part.squared[:, part.center - reach : part.center + reach + 1].copy()
            self._history.append(replace(part, squared=near, center=reach))
            self._counted = last
            while sum(len(one.yaw) for one in self._history[1:]) > history_s * self._rate:
                self._measured -= len(self._history.pop(0).yaw)
        seen = sum(len(one.yaw) for one in self._history)
        if seen >= max(few_s * self._rate, growth * self._measured):
            self._measured = seen
            while len(self._history) > 1:
                self._history[-2:] = [self._history[-2].extend(self._history[-1])]
            self.tolerance = choose_tolerance(self._history[0])

    def settle(self, until: int, *, join_s: float = 0.35) -> list[Finding]:
        """Judge the moments before the working frame ``until``; errors that are over, in frames of the whole."""
        # join_s: s; nearer errors may become one
        assert self._parts is not None
        self._find_lapses(until)
        evidence = gather_evidence(self._parts, self.tolerance.angle, self.tolerance.lag_s, self._of._weights)
        self._judge(evidence, until)
        rate, begin = self._rate / self._moments, self.first // self._moments
        base, still, near = self._from - begin, len(self._body), 0.0
        leaving = (self._of._segments.count + self._of._hop) // self._moments - round(WINDOW_S * rate) - self._from
        suspects = []
        for one in reversed(decode(self._limbs, self._body, rate, load_judge().decoding)):
            # What touches an error that goes on may become part of it, or of a lapse that is not known yet.
            if one.end >= still - near and one.end > leaving:
                still, near = min(still, one.start), join_s * rate
            elif base + one.end > 0:
                suspects.append(replace(one, start=max(base + one.start, 0), end=base + one.end))
        moments = np.arange(0, len(self.frames), self._moments)
        spread = spread_in_time(self._of._references, self.frames)
        measured = (_move(one, self.first) for one in tell_errors(evidence, suspects, moments, spread))
        found = [one for one in map(self._cut_off, measured) if one is not None]
        self._reported = [one for one in self._reported if one.end >= self.first] + found
        return found

    def _judge(self, evidence: Evidence, until: int, *, kept_s: float = 60.0) -> None:
        """Add the log probabilities of the moments that are complete now; those long ago are dropped."""
        begin, known = self.first // self._moments, self._from + len(self._body)
        done = max(known, begin)
        wanted = slice(done - begin, max(until // self._moments, done) - begin)
        if wanted.start < wanted.stop:
            new = join_descriptors(describe(self._of._references, self.frames, evidence, wanted, self._usual))
            kept, fresh = round(kept_s * self._rate / self._moments), (*load_judge().weigh(new), new.usual)
            past = [one[: 0 if done > known else None] for one in (self._limbs, self._body, self._usual)]
            both = [np.concatenate(pair)[-kept:] for pair in zip(past, fresh, strict=True)]
            self._limbs, self._body, self._usual = both
            self._from = done + len(new.frames) - len(self._body)

    def _cut_off(self, finding: Finding, *, least_left_s: float = 0.5) -> Finding | None:
        """What of an error was not reported yet; None if it was, or too little is left."""
        start = finding.start
        for earlier in self._reported:
            same = earlier.kind == finding.kind and set(earlier.segments) & set(finding.segments)
            if same and earlier.start < finding.end and start < earlier.end:
                start = earlier.end
        if start > finding.start and finding.end - start < least_left_s * self._rate:
            return None
        return replace(finding, start=start, worst=max(finding.worst, start))

    def _find_lapses(self, until: int, *, near_s: float = 1.0) -> None:
        inner = [run.start for run in self._of._line.runs[1:] if self.first < run.start <= until]
        known = [(one.start_s - near_s, one.end_s + near_s) for one in self.lapses]
        fresh = [start for start in inner if not any(low <= start / self._rate <= high for low, high in known)]
        if fresh:
            runs = (Run(0, 1, 0.0), *(Run(start - self.first, start, 0.0) for start in fresh))
            alignment = Alignment(self.frames, runs, 0.0, 1.0)
            part = self._of._performance(self.first)
            found = find_lapses(alignment, self._of._references.working[0], part)
            self.lapses += [_place(one, self.first / self._rate) for one in found if one.kind in _ORDER]

    def grade(self) -> float:
        """Grade of what is kept, as that of a furi."""
        if self._parts is None:
            return np.nan
        of, references = self._of, self._of._references
        low, high = (round(edge * of._stride) for edge in (max(self.frames.min(), 0.0), self.frames.max() + 1.0))
        takes = [_cut(one, low, high) for one in (references.postures, *references.warped)]
        if takes[0].n_frames < FEWEST_FRAMES * of._stride:
            return np.nan
        ours = describe_movement(of._read_postures(self.first * of._stride))
        found = [compare_movements(describe_movement(take), ours) for take in takes]
        everywhere = np.ones(len(self.frames), np.bool_)
        return float(grade_performance(references, found, of._weights, everywhere).score)


def _cut(postures: PostureSequence, start: int, end: int) -> PostureSequence:
    """Some frames of a take."""
    span = slice(start, end)
    return replace(
        postures, segments=postures.segments[span], seen=postures.seen[span], positions=postures.positions[span]
    )


_ORDER = ("stop", "skip", "repeat")  # lapses that are no end


def _place(lapse: Lapse, begin_s: float) -> Lapse:
    """A lapse of a part that begins at a moment; what is danced again may not be over yet."""
    start_s, end_s = begin_s + lapse.start_s, begin_s + lapse.end_s
    if lapse.kind == "repeat":
        end_s = start_s + lapse.reference_end_s - lapse.reference_start_s
    return replace(lapse, start_s=start_s, end_s=end_s)


def _move(finding: Finding, by: int) -> Finding:
    return replace(finding, start=finding.start + by, end=finding.end + by, worst=finding.worst + by)


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
