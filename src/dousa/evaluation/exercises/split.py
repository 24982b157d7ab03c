"""Repetitions of an exercise in one recording: found, counted, and bounded to the frame.

The posture is a point in the space of nine segment directions without its heading; a repetition leaves a rest and
returns to it. A template, one repetition of the reference, is searched by subsequence dynamic time warping of the
displacements from rest: an exercise is recognised in a body that stands differently. Without a reference the
repetitions are those of `dousa.motion.repetitions`.

Source: the one-stage method of connected word recognition: H. Ney, "The use of a one-stage dynamic programming
algorithm for connected word recognition", IEEE Trans. ASSP 32(2), 263-271, 1984.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import BoolArray, FloatArray, IntArray
from dousa.evaluation.posture.posture import PostureSequence, compute_postures, thin_postures
from dousa.evaluation.posture.yaw import rotate_yaw
from dousa.kernels import kernel
from dousa.motion import CanonicalMotion
from dousa.motion.repetitions import find_spans, fold_poses, trace_movement
from dousa.motion.resampling import smooth_gaussian
from dousa.motion.runs import find_runs

_STAY, _SKIP = 0.2, 0.2  # price of a frame during which the template waits, of each of its frames left out: lab/trials/
_ENTRY = 0.03  # price of beginning a pass, as a share of the template's frames: lab/trials/count_repetitions.py


@kernel(linear=True, allocates=True)
def _accumulate(cost, outside, stay, skip, entry):  # type: ignore[no-untyped-def]
    """Cheapest prices (T, n + 1), and the way back: column 0 is outside, j + 1 the template."""
    n_frames, n = cost.shape
    total = np.full((n_frames, n + 1), np.inf)
    origin = np.full((n_frames, n + 1), -1, np.int8)  # 0 from outside or a pass's end, 1 stay, 2, 3, 4: so many on
    from_pass = np.zeros(n_frames, np.bool_)  # whether what is outside, or begins, follows a pass
    total[0, 0] = outside[0]
    total[0, 1] = entry + cost[0, 0]
    origin[0, 1] = 0
    for t in range(1, n_frames):
        before, here = total[t - 1], total[t]
        from_pass[t] = before[n] < before[0]
        outer = min(before[0], before[n])
        here[0] = outer + outside[t]
        for j in range(1, n + 1):
            best, way = before[j] + stay, 1
            if j == 1 and outer + entry < best:
                best, way = outer + entry, 0
            for step in range(1, 4):
                if j - step >= 1 and before[j - step] + skip * (step - 1) < best:
                    best, way = before[j - step] + skip * (step - 1), 1 + step
            here[j] = best + cost[t, j - 1]
            origin[t, j] = way
    return total, origin, from_pass


def _trace(origin: NDArray[np.int8], from_pass: BoolArray, in_pass: bool) -> IntArray:
    """(R, 2) bounds of the passes on the cheapest chain."""
    n = origin.shape[1] - 1
    bounds: list[tuple[int, int]] = []
    place, end = n if in_pass else 0, len(origin)
    for t in range(len(origin) - 1, -1, -1):
        if place:
            way = int(origin[t, place])
            if way:
                place -= way - 1
                continue
            bounds.append((t, end))
            place = 0
        if t > 0 and from_pass[t]:
            place, end = n, t
    return np.array(bounds[::-1], np.int64).reshape(-1, 2)


@dataclass(frozen=True, slots=True, eq=False)
class PostureCurve:
    """Postures without heading, as points of a space in which distances are chords."""

    fine: FloatArray  # (T, 27) nine unit vectors in the body's frame, at the full rate
    fine_rate: float  # Hz
    coarse: FloatArray  # (U, 27) the same at about 15 Hz
    stride: int  # frames of ``fine`` in one of ``coarse``


def _compute_curve(
    postures: PostureSequence, *, heading_s: float = 0.5, smooth_s: float = 0.06, coarse_rate: float = 15.0
) -> PostureCurve:
    """Take the heading off, which turns slowly, and smooth what a sensor adds."""
    # heading_s, smooth_s: standard deviations; coarse_rate: Hz at which repetitions are looked for
    rate, working = postures.frame_rate, thin_postures(postures)
    slow = smooth_gaussian(working.heading, heading_s * working.frame_rate)
    heading = np.interp(np.arange(postures.n_frames), np.arange(working.n_frames) * working.stride, slow)
    turned = rotate_yaw(postures.segments, -heading).reshape(postures.n_frames, -1)
    fine = smooth_gaussian(turned, max(smooth_s * rate, 0.3))
    stride = max(1, round(rate / coarse_rate))
    return PostureCurve(fine, rate, np.ascontiguousarray(fine[::stride]), stride)


def _find_rests(curve: PostureCurve) -> FloatArray:
    """(3, 27): where a repetition may begin: the first and the last posture, and the median of the quieter half."""
    points = curve.coarse
    speed = np.linalg.norm(np.gradient(points, axis=0), axis=1) if len(points) > 1 else np.zeros(1)
    return np.stack([points[0], points[-1], np.median(points[speed <= np.median(speed)], axis=0)])


def _compute_squares(a: FloatArray, b: FloatArray) -> FloatArray:
    """(N, M) squared distances of (N, D) and (M, D)."""
    sums = (a * a).sum(axis=1)[:, None] + (b * b).sum(axis=1)[None] - 2.0 * (a @ b.T)
    return np.asarray(np.maximum(sums, 0.0))


LEAST_EXCURSION = 0.25
"""Chord: what moves less is standing still; by geometry that of a limb of two segments that turns by 10 degrees."""
_OTHER = 2.0  # mean squared residual, a share of the template's power, of other motion: by definition, two unrelated
# motions of equal power differ by twice it
_ONSET = 0.12  # share of the displacement at which a repetition has begun, see docs/exercises.md
_ALIKE = 1.0  # misfit, a share of the template's power, from which on a pass is another motion, see docs/exercises.md
COMPLETE = 0.65
"""Share of the displacement of the template, or of the usual repetition if that is more; see docs/exercises.md."""
_RETURNS = 0.55  # share of its reach within which a repetition begins and ends at rest, see docs/exercises.md


@dataclass(frozen=True, slots=True)
class Repetition:
    """One repetition of an exercise.

    Parameters
    ----------
    start, end : frames of the recording, half-open.
    start_s, end_s : s.
    extent : furthest displacement as a share of the template's (of the reference, or of the recording's own median).
    complete : whether it goes far enough to count.
    """

    start: int
    end: int
    start_s: float
    end_s: float
    extent: float
    complete: bool

    @property
    def duration_s(self) -> float:
        """Seconds."""
        return self.end_s - self.start_s


@dataclass(frozen=True, slots=True)
class RepetitionSplit:
    """The repetitions in a recording.

    Parameters
    ----------
    repetitions : in order of time, incomplete ones among them.
    likeness : s of the recording in them, each counting less the less it is like the reference's; 0 without one.
    """

    repetitions: tuple[Repetition, ...]
    likeness: float = 0.0

    @property
    def complete(self) -> tuple[Repetition, ...]:
        """Those that count."""
        return tuple(one for one in self.repetitions if one.complete)

    @property
    def count(self) -> int:
        """How many count."""
        return len(self.complete)


@dataclass(frozen=True, slots=True, eq=False)
class _Template:
    """One repetition as displacements (n, D) from its rest, the length of the furthest one, and the mean square."""

    path: FloatArray
    reach: float
    power: float


@dataclass(frozen=True, slots=True, eq=False)
class _Parse:
    """Passes (R, 2) through a template in frames of the coarse curve, and the rest that they start from; the frames in
    them, each counting less the less it is like the template."""

    rest: FloatArray
    passes: IntArray
    likeness: float


def find_repetitions(motion: CanonicalMotion, references: Sequence[CanonicalMotion] = ()) -> RepetitionSplit:
    """Find and count the repetitions of an exercise in one recording.

    Parameters
    ----------
    motion : any frame rate, heading and stature; pauses, and walking into place, may come with it.
    references : the same exercise done well, one or several repetitions a take, the first one leading. Without any,
        what the recording itself repeats is the exercise; of a single excursion from rest, that one.

    Returns
    -------
    The repetitions; none if nothing is found. One that goes less than `COMPLETE` of the way is there, but not
    complete, and does not count.

    Raises
    ------
    InvalidMotionError : no frame, another shape, or infinite positions.
    """
    postures = compute_postures(motion)
    curve = _compute_curve(postures)
    if not references:
        return RepetitionSplit(tuple(_find_alone(postures, curve)))
    templates = [template for reference in references for template in _list_templates(reference)]
    if not templates:
        return RepetitionSplit(())
    # Of middle reach: neither the best nor the worst repetition of the references is the measure.
    template = sorted(templates, key=lambda one: one.reach)[len(templates) // 2]
    parse = _follow(curve, template)
    return RepetitionSplit(tuple(_describe(curve, template, parse)), parse.likeness * curve.stride / curve.fine_rate)


def _find_alone(postures: PostureSequence, curve: PostureCurve) -> list[Repetition]:
    """What `count_repetitions` finds; how far each goes from its first posture is compared with the usual one."""
    rate = curve.fine_rate
    spans = find_spans(trace_movement(fold_poses(postures.positions, rate), rate))
    reaches = [float(np.linalg.norm(curve.fine[start:end] - curve.fine[start], axis=1).max()) for start, end in spans]
    usual = float(np.median(reaches)) if reaches else 0.0
    if usual < LEAST_EXCURSION:
        return []
    return [
        Repetition(start, end, start / rate, end / rate, round(reach / usual, 3), reach >= COMPLETE * usual)
        for (start, end), reach in zip(spans, reaches, strict=True)
    ]


# Templates


def _trim(points: FloatArray) -> tuple[int, int]:
    """First frame, and frame after the last, between which points (n, D) leave the first and reach the last one."""
    left, right = (np.linalg.norm(points - points[end], axis=1) for end in (0, -1))
    first = max(int(np.argmax(left > _ONSET * left.max())) - 1, 0)
    last = len(points) - max(int(np.argmax(right[::-1] > _ONSET * right.max())) - 1, 0)
    return first, last


def _make_template(points: FloatArray) -> _Template:
    """A repetition (n, D) of displacements, without the waiting before and after it."""
    first, last = _trim(points)
    sizes = np.linalg.norm(points[first:last], axis=1)
    return _Template(points[first:last], float(sizes.max()), max(float((sizes**2).mean()), 1e-9))


def find_reference_repetitions(reference: CanonicalMotion) -> tuple[tuple[int, int], ...]:
    """Find the frames, half-open, of the repetitions in a take of the reference.

    A take that begins and ends in about the same pose, and repeats nothing, is one repetition. Empty without movement.
    """
    return tuple(_split_reference(reference)[1])


def _split_reference(reference: CanonicalMotion) -> tuple[PostureCurve, list[tuple[int, int]]]:
    """The curve, and the spans of repetitions in frames."""
    postures = compute_postures(reference)
    curve = _compute_curve(postures)
    points = curve.coarse
    if len(points) < 2:
        return curve, []
    spans = [(one.start, one.end) for one in _find_alone(postures, curve) if one.complete]
    away = np.linalg.norm(points - points[0], axis=1)
    if len(spans) > 1 or (spans and away[-1] >= _RETURNS * away.max()):
        return curve, spans
    if away.max() < LEAST_EXCURSION:
        return curve, []
    first, last = _trim(points)
    return curve, [(first * curve.stride, min(last * curve.stride, len(curve.fine)))]


def _list_templates(reference: CanonicalMotion) -> list[_Template]:
    """The repetitions of a reference that go anywhere."""
    curve, spans = _split_reference(reference)
    step = curve.stride
    parts = [curve.coarse[start // step : -(-end // step) + 1] for start, end in spans]
    templates = [_make_template(part - part[0]) for part in parts]
    return [one for one in templates if one.reach >= LEAST_EXCURSION]


# With a template


def _follow(curve: PostureCurve, template: _Template) -> _Parse:
    """The passes through a reference's repetition, and those like the best of them.

    How the body of this recording stands is not known beforehand: the rest that explains most is taken. A person
    repeats themselves better than a reference: what was surely found is looked for in turn.
    """
    scale = _OTHER * template.power
    found = max((_parse(curve, template, rest, scale) for rest in _find_rests(curve)), key=lambda one: one.likeness)
    if not len(found.passes):
        return found
    own = [_make_template(curve.coarse[start:end] - found.rest) for start, end in found.passes]
    again = max((_parse(curve, one, found.rest, scale) for one in own), key=lambda one: one.likeness)
    apart = [(again.passes[:, 1] <= start) | (again.passes[:, 0] >= end) for start, end in found.passes]
    kept = np.concatenate([again.passes, found.passes[[bool(one.all()) for one in apart]]])
    return dataclasses.replace(found, passes=kept[kept[:, 0].argsort()])


def _parse(curve: PostureCurve, template: _Template, rest: FloatArray, scale: float) -> _Parse:
    """The cheapest reading of a recording as passes through a template and the time between them; without passes
    that differ from the template by its own power or more."""
    moved = curve.coarse - rest
    cost = _compute_squares(moved, template.path) / scale
    outside = np.minimum((moved * moved).sum(axis=1) / scale, 1.0)
    total, origin, from_pass = _accumulate(cost, outside, _STAY, _SKIP, _ENTRY * cost.shape[1])
    passes = _trace(origin, from_pass, bool(total[-1, -1] < total[-1, 0]))
    before = np.array([total[start - 1, [0, -1]].min() if start else 0.0 for start, _ in passes])
    frames = passes[:, 1] - passes[:, 0]
    misfits = (total[passes[:, 1] - 1, -1] - before) / np.maximum(frames, 1) * scale / template.power
    kept = misfits <= _ALIKE
    return _Parse(rest, passes[kept], float((frames[kept] * (_ALIKE - misfits[kept])).sum()))


# From passes to repetitions


def _describe(curve: PostureCurve, template: _Template, parse: _Parse) -> list[Repetition]:
    """Repetitions with bounds at the full rate, and those that were broken off between them."""
    moved = curve.fine - parse.rest
    away = np.linalg.norm(moved, axis=1)
    rate = curve.fine_rate
    spans = [(int(a) * curve.stride, min(int(b) * curve.stride, len(moved))) for a, b in parse.passes]
    usual = float(np.median([away[a:b].max() for a, b in spans])) if spans else 0.0
    least = COMPLETE * max(1.0, usual / template.reach)
    spans = sorted(spans + _find_broken_off(moved, template, spans, rate))
    peaks = [0, *(a + int(away[a:b].argmax()) for a, b in spans), len(moved) - 1]
    found = []
    for (a, b), before, peak, after in zip(spans, peaks, peaks[1:], peaks[2:], strict=False):
        start, end = _bound(away, (a, b), peak, (before, after))
        extent = float(away[peak]) / template.reach
        found.append(Repetition(start, end, start / rate, end / rate, round(extent, 3), extent >= least))
    return found


def _find_broken_off(
    moved: FloatArray,
    template: _Template,
    spans: Sequence[tuple[int, int]],
    rate: float,
    *,
    incomplete: float = 0.25,
    beside_share: float = 0.5,
    shortest_s: float = 0.2,
) -> list[tuple[int, int]]:
    """Excursions outside the passes that follow the exercise's path, and not to its end."""
    # beside_share: share of its displacement by which a broken-off repetition may be beside the exercise's path
    # incomplete: share below which it is not even tried
    away = np.linalg.norm(moved, axis=1)
    free = away > incomplete * template.reach
    for start, end in spans:
        free[start:end] = False
    found = []
    for start, end in find_runs(free).tolist():
        peak = start + int(away[start:end].argmax())
        beside = float(np.linalg.norm(template.path - moved[peak], axis=1).min())
        if end - start >= shortest_s * rate and away[peak] < template.reach and beside <= beside_share * away[peak]:
            found.append((start, end))
    return found


def _bound(away: FloatArray, span: tuple[int, int], peak: int, between: tuple[int, int]) -> tuple[int, int]:
    """Frames, half-open, where the movement of a pass begins and ends: `_ONSET` of the way from the lowest place."""
    slack = (span[1] - span[0]) // 3
    first, last = max(between[0], span[0] - slack), min(between[1] + 1, span[1] + slack)
    rise, fall = away[first : peak + 1], away[peak:last]
    begun = np.flatnonzero(rise <= rise.min() + _ONSET * (away[peak] - rise.min()))[-1]
    ended = np.flatnonzero(fall <= fall.min() + _ONSET * (away[peak] - fall.min()))[0]
    return first + int(begun), peak + int(ended) + 1
