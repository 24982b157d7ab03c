"""What an error amounts to, measured between a carrier and its wrong copy, whoever made it.

The lag is the one at which the copy agrees best with the carrier; at that lag the gain says how large its movement is
and the correlation how like it. Angles are in degrees between segments; of an error of the whole body the yaw between
the two is taken out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dousa.arrays import FloatArray, Mask
from dousa.evaluation.posture.posture import LIMBS, SEGMENTS
from lab.injection.edits import (
    LIMB_BONES,
    Take,
    find_bones,
    find_heading,
    measure_angles,
    measure_segments,
    put_together,
    turn,
    turn_onto,
)
from lab.injection.injection import Error, is_possible, measure_range

_LONGEST_LAG_S = 0.7
_LAG_STEP_S = 1.0 / 60.0
_MOST_MOMENTS = 60
_CORE = 0.9  # of the error: where it is wholly there
_ELSEWHEN_S = 1.0
_N_ELSEWHEN = 15


@dataclass(frozen=True, slots=True)
class Group:
    """What goes wrong together.

    Parameters
    ----------
    name : such as ``"left_arm"``, ``"legs"``, ``"body"``.
    bones : indices of `edits.LIMB_BONES`, of the 19.
    segments : indices of the nine.
    """

    name: str
    bones: tuple[int, ...]
    segments: tuple[int, ...]

    @property
    def is_whole(self) -> bool:
        """Whether it is the whole body."""
        return len(self.segments) == len(SEGMENTS)


def _join(name: str, *limbs: str) -> Group:
    bones = tuple(bone for limb in limbs for bone in LIMB_BONES[limb])
    return Group(name, bones, tuple(segment for limb in limbs for segment in LIMBS[limb]))


BODY = Group("body", tuple(range(19)), tuple(range(len(SEGMENTS))))
LIMB_GROUPS: tuple[Group, ...] = (
    *(_join(limb, limb) for limb in LIMB_BONES),
    _join("arms", "left_arm", "right_arm"),
    _join("legs", "left_leg", "right_leg"),
)
"""Each limb, both arms, both legs."""
LOWER_GROUPS: dict[str, Group] = {
    limb: Group(
        f"{limb} below",
        find_bones(*(f"{limb[:-4]}_{joint}" for joint in joints)),
        (LIMBS[limb][1],),
    )
    for limb in LIMB_BONES
    for joints in [("wrist", "hand") if limb.endswith("arm") else ("ankle", "toe")]
}
"""The forearm or shank of each limb, with what hangs on it."""


@dataclass(frozen=True, slots=True, eq=False)
class Stretch:
    """Frames ``start`` to ``stop`` (exclusive) of a carrier that go wrong.

    Parameters
    ----------
    start, stop : frames.
    rise, fall : frames over which the error comes and goes; together less than the stretch.
    frame_rate : Hz.
    """

    start: int
    stop: int
    rise: float
    fall: float
    frame_rate: float

    @property
    def n_frames(self) -> int:
        """Length."""
        return self.stop - self.start

    @property
    def duration_s(self) -> float:
        """Seconds."""
        return self.n_frames / self.frame_rate

    @property
    def weight(self) -> FloatArray:
        """(n,) 0 at both ends to 1, raised cosines."""
        frame = np.arange(self.n_frames)
        edge = np.minimum(frame / self.rise, (self.n_frames - 1 - frame) / self.fall)
        return 0.5 - 0.5 * np.cos(np.pi * np.clip(edge, 0.0, 1.0))


@dataclass(frozen=True, slots=True, eq=False)
class Draft:
    """The wrong motion of a stretch.

    Parameters
    ----------
    positions : (n, 20, 3) m.
    weight : (n,) 0 to 1, how much of the error is there.
    group : what was meant to be wrong.
    lag_s : (n,) seconds late, where it is known; of a shift without it the lag is measured.
    """

    positions: FloatArray
    weight: FloatArray
    group: Group
    lag_s: FloatArray | None = None


@dataclass(frozen=True, slots=True)
class Sight:
    """What an error must be to count; smaller ones are not made.

    Parameters
    ----------
    seen_deg, seen_lag_ms, moving_deg_s : a moment counts as seen if some segment is off by this, or if it is late by
        this while some segment moves as fast as this; the truth runs from the first such moment to the last.
    seen_share, shortest_s : of the moments between them that must be seen; how long.
    lag_ms, moved_deg : of a shift, and the range that the carrier has while it is that late.
    shortfall_deg, shortfall_percent : loss of range of the most affected segment.
    partial_deg, partial_left_deg : peak of the most wrong segment; root mean square of what is left of it at the lag
        that explains it best, for else it would be a shift.
    global_deg, n_global, global_left_deg : mean of this many segments at least, and of all nine; mean over segments
        at the shift in time, of up to 1 s, that explains it best.
    """

    seen_deg: float = 8.0
    seen_lag_ms: float = 60.0
    moving_deg_s: float = 30.0
    seen_share: float = 0.5
    shortest_s: float = 0.35
    lag_ms: float = 100.0
    moved_deg: float = 15.0
    shortfall_deg: float = 12.0
    shortfall_percent: float = 15.0
    partial_deg: float = 20.0
    partial_left_deg: float = 12.0
    global_deg: float = 18.0
    n_global: int = 5
    global_left_deg: float = 14.0


@dataclass(frozen=True, slots=True)
class Fit:
    """How a copy follows its carrier.

    Parameters
    ----------
    lag_s : s late (positive) at the best agreement.
    gain, correlation : of the copy's movement about its mean on the carrier's, at that lag.
    left_deg : root mean square angle of the worst segment, at that lag.
    share_left : of the squared difference without any lag.
    """

    lag_s: float
    gain: float
    correlation: float
    left_deg: float
    share_left: float

    @property
    def is_copy(self) -> bool:
        """Whether the copy is the carrier at another time, as large and alike."""
        return self.correlation > 0.9 and abs(self.gain - 1.0) < 0.15

    @property
    def is_smaller(self) -> bool:
        """Whether the copy is too small, and in time as far as its shape tells."""
        return self.gain < 0.9 and (abs(self.lag_s) < 0.08 or self.correlation < 0.7)


def fit_copy(carrier: FloatArray, copy: FloatArray, frames: FloatArray, frame_rate: float) -> tuple[Fit, Fit]:
    """Lag, gain and correlation of a copy: at the lag with the least difference, and with the highest correlation.

    The first is that of a copy as large as the carrier; of one that is too small, the least difference is where the
    carrier happens to pass near it, and only the shape tells the time.

    Parameters
    ----------
    carrier : (T, K, 3) unit vectors, heading-free.
    copy : (n, K, 3) unit vectors, heading-free.
    frames : (n,) frames of the carrier at which the copy's moments lie.
    frame_rate : Hz.
    """
    few = np.unique(np.linspace(0, len(frames) - 1, min(len(frames), _MOST_MOMENTS)).round().astype(int))
    frames, copy = frames[few], copy[few]
    step = max(round(_LAG_STEP_S * frame_rate), 1)
    reach = int(_LONGEST_LAG_S * frame_rate) // step
    lags = step * np.arange(-reach, reach + 1)
    index = np.clip(frames[None] - lags[:, None], 0, len(carrier) - 1).astype(np.intp)
    delayed = carrier[index]
    # Squared chords of unit vectors.
    costs = 2.0 - 2.0 * np.einsum("ltkc,tkc->ltk", delayed, copy).mean(axis=(1, 2))
    moved = copy - copy.mean(axis=0)
    delayed = delayed - delayed.mean(axis=1, keepdims=True)
    power = np.sqrt(np.maximum((delayed**2).sum(axis=(1, 2, 3)) * (moved**2).sum(), 1e-12))
    unlike = 1.0 - np.einsum("ltkc,tkc->l", delayed, moved) / power

    def fit_at(badness: FloatArray) -> Fit:
        best = int(badness.argmin())
        lag = lags[best] + step * _find_vertex(badness, best)
        target = _interpolate(carrier, frames - lag)
        a = target - target.mean(axis=0)
        power, product = max(float((a * a).sum()), 1e-9), float((a * moved).sum())
        return Fit(
            lag_s=float(lag / frame_rate),
            gain=product / power,
            correlation=product / float(np.sqrt(power * max(float((moved**2).sum()), 1e-9))),
            left_deg=float(np.sqrt((measure_angles(target, copy) ** 2).mean(axis=0)).max()),
            share_left=float(costs[best] / max(costs[reach], 1e-12)),
        )

    return fit_at(costs), fit_at(unlike)


def _find_vertex(costs: FloatArray, best: int) -> float:
    """Where the parabola through the least cost and its neighbours is lowest, in steps from the least."""
    if not 0 < best < len(costs) - 1:
        return 0.0
    before, here, after = costs[best - 1 : best + 2]
    bend = before - 2.0 * here + after
    return float(0.5 * (before - after) / bend) if bend > 1e-12 else 0.0


def _interpolate(values: FloatArray, frames: FloatArray) -> FloatArray:
    inside = np.clip(frames, 0.0, len(values) - 1.0)
    low = inside.astype(np.intp)
    share = (inside - low)[:, None, None]
    mixed: FloatArray = (1.0 - share) * values[low] + share * values[np.minimum(low + 1, len(values) - 1)]
    mixed /= np.maximum(np.linalg.norm(mixed, axis=2, keepdims=True), 1e-9)
    return mixed


@dataclass(frozen=True, slots=True, eq=False)
class _Compared:
    """A draft beside its carrier; only the group's segments, heading-free unless said otherwise."""

    take: Take
    stretch: Stretch
    draft: Draft
    sight: Sight
    clean: FloatArray  # (n, K, 3)
    wrong: FloatArray  # (n, K, 3)
    angles: FloatArray  # (n, K) degrees, after yaw
    world: FloatArray  # (n, 9, 3)

    def fit(self, core: Mask) -> tuple[Fit, Fit] | None:
        """How the copy follows the carrier in these moments (`fit_copy`); None if they are too few."""
        inside = np.flatnonzero(core)
        if len(inside) < max(0.2 * self.stretch.frame_rate, 3.0):
            return None
        reach = int(_LONGEST_LAG_S * self.stretch.frame_rate) + 1
        first = max(self.stretch.start - reach, 0)
        around = slice(first, self.stretch.stop + reach)
        segments = self.take.segments[around][:, self.draft.group.segments]
        carrier = turn(segments, -self.take.heading[around])
        frames = self.stretch.start - first + inside
        return fit_copy(carrier, self.wrong[inside], frames.astype(np.float64), self.stretch.frame_rate)


def judge(
    kind: str, variant: str, take: Take, stretch: Stretch, draft: Draft, sight: Sight | None = None
) -> Error | None:
    """The truth of a draft; None if nobody would see it, if it is not of its kind, or if no body could do it.

    Parameters
    ----------
    kind, variant : what it is meant to be.
    take : the carrier.
    stretch : where.
    draft : the wrong motion there.
    sight : what counts.
    """
    sight = sight or Sight()
    compared = _compare(take, stretch, draft, sight)
    found = _JUDGES[kind](compared)
    if found is None:
        return None
    error, lag_s = found
    seen = compared.angles.max(axis=1) >= sight.seen_deg
    speed = _measure_speed(compared.clean, take.frame_rate)
    if lag_s is not None:
        seen |= (1000.0 * np.abs(lag_s) >= sight.seen_lag_ms) & (speed.max(axis=1) >= sight.moving_deg_s)
    moments = np.flatnonzero(seen)
    if len(moments) < max(sight.shortest_s * take.frame_rate, 2.0):
        return None
    first, last = int(moments[0]), int(moments[-1]) + 1
    if seen[first:last].mean() < sight.seen_share:
        return None
    if kind == "incomplete":
        measured = _measure_shortfall(compared, slice(first, last))
        if measured is None:
            return None
        error = replace(error, shortfall_deg=measured[0], shortfall_percent=measured[1])
    off = compared.angles[first:last].max(axis=0) >= sight.seen_deg
    if lag_s is not None:
        off |= measure_range(compared.clean[first:last]) >= sight.moved_deg
    names = tuple(SEGMENTS[s] for s, is_off in zip(draft.group.segments, off, strict=True) if is_off)
    whole = draft.group.is_whole and kind in ("shift", "global")
    return replace(
        error,
        variant=variant,
        start_s=(stretch.start + first) / take.frame_rate,
        end_s=(stretch.start + last) / take.frame_rate,
        segments=SEGMENTS if whole else names,
    )


def _compare(take: Take, stretch: Stretch, draft: Draft, sight: Sight) -> _Compared:
    part, chosen = slice(stretch.start, stretch.stop), list(draft.group.segments)
    world, clean, heading = measure_segments(draft.positions), take.segments[part], take.heading[part]
    if draft.group.is_whole:
        angles = measure_angles(turn_onto(world, clean), clean)
        wrong = turn(world, -find_heading(draft.positions, take.frame_rate))
    else:
        angles = measure_angles(world[:, chosen], clean[:, chosen])
        wrong = turn(world, -heading)[:, chosen]
    free = turn(clean, -heading)[:, chosen]
    return _Compared(take, stretch, draft, sight, free, wrong, angles, world)


def _measure_speed(directions: FloatArray, frame_rate: float) -> FloatArray:
    """(n, K) degrees a second."""
    steps = measure_angles(directions[1:], directions[:-1]) * frame_rate
    return np.concatenate([steps, steps[-1:]])


_Found = tuple[Error, FloatArray | None]


def _blank(kind: str, lag_ms: float | None = None) -> Error:
    return Error(kind, "", 0.0, 0.0, (), lag_ms=lag_ms)


def _judge_shift(compared: _Compared) -> _Found | None:
    draft, sight = compared.draft, compared.sight
    core = draft.weight >= _CORE
    fits = compared.fit(core)
    if fits is None:
        return None
    fit, lag = fits[0], draft.lag_s
    # A limb that is late on a body that is not looks less like a copy than the body as a whole does.
    alike = fit.is_copy if lag is None else fit.correlation > 0.8
    if not alike or fit.share_left > 0.35:
        return None
    if lag is None:
        lag = fit.lag_s * draft.weight
    most = float(lag[np.abs(lag).argmax()])
    late = np.abs(lag) >= sight.lag_ms / 1000.0
    if 1000.0 * abs(most) < sight.lag_ms or not late.any():
        return None
    # What repeats itself within the lag may as well be early as late.
    if abs(fit.lag_s - most) > max(0.03, 0.15 * abs(most)):
        return None
    if measure_range(compared.clean[late]).max() < sight.moved_deg:
        return None
    return _blank("shift", 1000.0 * most), lag


def _judge_incomplete(compared: _Compared) -> _Found | None:
    fits = compared.fit(compared.draft.weight >= _CORE)
    if fits is None or fits[0].is_copy or not fits[1].is_smaller:
        return None
    return _blank("incomplete"), None


def _measure_shortfall(compared: _Compared, part: slice) -> tuple[float, float] | None:
    """Loss of range of the most affected segment, degrees and percent."""
    full = measure_range(compared.clean[part])
    loss = full - measure_range(compared.wrong[part])
    most = int(loss.argmax())
    percent = float(100.0 * loss[most] / max(full[most], 1e-6))
    if loss[most] < compared.sight.shortfall_deg or percent < compared.sight.shortfall_percent:
        return None
    return float(loss[most]), percent


def _judge_partial(compared: _Compared) -> _Found | None:
    core, sight = compared.draft.weight >= 0.5, compared.sight
    if not core.any() or compared.angles[core].max() < sight.partial_deg:
        return None
    fits = compared.fit(core)
    if fits is None or fits[0].left_deg < sight.partial_left_deg or fits[0].share_left < 0.3:
        return None
    part = slice(compared.stretch.start, compared.stretch.stop)
    before = put_together(compared.take.body.cut(part.start, part.stop))
    if not is_possible(before, compared.draft.positions, compared.take.heading[part]):
        return None
    return _blank("partial"), None


def _judge_global(compared: _Compared) -> _Found | None:
    core, sight = compared.draft.weight >= _CORE, compared.sight
    if not core.any():
        return None
    means = np.sort(compared.angles[core].mean(axis=0))[::-1]
    if means.mean() < sight.global_deg or means[sight.n_global - 1] < sight.global_deg * 0.75:
        return None
    frames, take = compared.stretch.start + np.flatnonzero(core), compared.take
    few = np.linspace(0, len(frames) - 1, min(len(frames), 30)).round().astype(int)
    wrong = compared.world[core][few]
    for time in np.linspace(-_ELSEWHEN_S, _ELSEWHEN_S, _N_ELSEWHEN):
        there = np.clip(frames[few] + round(time * take.frame_rate), 0, len(take.segments) - 1)
        clean = take.segments[there]
        if measure_angles(turn_onto(wrong, clean), clean).mean() < sight.global_left_deg:
            return None
    return _blank("global"), None


_JUDGES = {
    "shift": _judge_shift,
    "incomplete": _judge_incomplete,
    "partial": _judge_partial,
    "global": _judge_global,
}
