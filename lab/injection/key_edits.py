"""Errors as an animator makes them: key poses retimed, rescaled, dropped or replaced, and eased in and out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from dousa.arrays import FloatArray, IndexArray
from dousa.motion.canonical.canonicalise import CanonicalMotion
from lab.injection.key_poses import (
    CHAINS,
    LIMB_NAMES,
    PAIRS,
    Chains,
    Rig,
    add_keys,
    build_positions,
    compare_chains,
    find_keys,
    interpolate_keys,
    limbs_of,
    measure_norm,
    mirror_points,
    normalise,
    read_rig,
    rotation_between,
    sample,
    turn_chain,
    unwrap_turns,
)
from lab.injection.key_truth import Draft

KEYFRAME_VARIANTS: dict[str, tuple[str, ...]] = {
    "shift": ("body_shift", "limb_shift", "pair_shift"),
    "incomplete": (
        *("limb_stops_short", "pair_stops_short", "body_stops_short"),
        *("limb_shrunk", "pair_shrunk", "body_shrunk"),
    ),
    "partial": ("other_movement", "other_side", "held", "other_direction"),
    "global": ("other_figure", "own_figure", "mirrored_figure"),
}
"""Variants of each kind of error."""

_EDGE_S = (0.1, 0.8)  # onset and fade
_PLATEAU_S, _PLATEAU_SHARE = (0.3, 3.0), 0.5
_APART_S, _TOGETHER = 0.5, 0.4
_LAG_S = (0.12, 0.4)
_STOPPING, _CATCHING_UP = 2.0, 1.2  # onset or fade over the lag
_GAP_S = 0.25
_NEIGHBOURS = 3  # key poses before and after one that a limb may come from and go to
_REACH_S = 2.0


@dataclass(frozen=True, slots=True)
class Taken:
    """Where an error is already: frames, group of limbs, kind."""

    start: int
    stop: int
    group: str
    kind: str


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """A motion that shall get an error.

    Parameters
    ----------
    rig : the motion with the errors so far.
    positions : (T, 20, 3) m, the same.
    donors : other motions.
    taken : errors so far.
    near : one of them, at the same time as which the next one shall be.
    keys : key poses of each group, as far as they were asked for.
    """

    rig: Rig
    positions: FloatArray
    donors: Sequence[CanonicalMotion]
    taken: tuple[Taken, ...] = ()
    near: Taken | None = None
    keys: dict[str, IndexArray] = field(default_factory=dict)

    def find_keys(self, group: str) -> IndexArray:
        """Frames of the key poses of a group."""
        if group not in self.keys:
            self.keys[group] = find_keys(self.rig, group)
        return self.keys[group]

    @property
    def has_room(self) -> bool:
        """Whether a short error has a place that no other has."""
        edges = sorted((other.start, other.stop) for other in self.taken)
        starts = [0, *(stop + _APART_S * self.rig.frame_rate for _, stop in edges)]
        stops = [*(start - _APART_S * self.rig.frame_rate for start, _ in edges), self.rig.n_frames]
        least = (_PLATEAU_S[0] + 2 * _EDGE_S[1] * 0.5) * self.rig.frame_rate
        return any(stop - start >= least for start, stop in zip(starts, stops, strict=True))

    def fits(self, start: int, stop: int, group: str, kind: str) -> bool:
        """Whether an error may be in these frames."""
        if start < 0 or stop > self.rig.n_frames:
            return False
        gap = _APART_S * self.rig.frame_rate
        for other in self.taken:
            if other is self.near:
                shared = min(stop, other.stop) - max(start, other.start)
                if shared < _TOGETHER * min(stop - start, other.stop - other.start) or not _get_along(
                    other, group, kind
                ):
                    return False
            elif start < other.stop + gap and stop > other.start - gap:
                return False
        return True


def _get_along(other: Taken, group: str, kind: str) -> bool:
    if other.group == "body":
        return other.kind == "shift" and kind in ("incomplete", "partial") and group != "body"
    return not set(limbs_of(other.group)) & set(limbs_of(group))


@dataclass(frozen=True, slots=True)
class _Window:
    """Frames: the error begins, is full, is no longer full, has gone."""

    start: int
    full: int
    fading: int
    last: int


def _draw_plateau(scene: Scene, rng: np.random.Generator, keys: IndexArray) -> tuple[int, int] | None:
    """Two key poses between which an error may be full."""
    rate, last = scene.rig.frame_rate, scene.rig.n_frames - 1
    longest = min(_PLATEAU_S[1], _PLATEAU_SHARE * last / rate)
    length = rng.uniform(_PLATEAU_S[0], longest) * rate
    before, after = (keys[index] for index in np.triu_indices(len(keys), 1))
    edge = _EDGE_S[0] * rate + 1
    fine = (after - before >= _PLATEAU_S[0] * rate) & (after - before <= longest * rate)
    fine &= (before >= edge) & (after <= last - edge)
    for other in scene.taken:
        if other is not scene.near:
            fine &= (before >= other.stop + _APART_S * rate) | (after <= other.start - _APART_S * rate)
    if scene.near is not None:
        fine &= (before < scene.near.stop) & (after > scene.near.start)
    chosen = np.flatnonzero(fine)
    if len(chosen):
        nearest = chosen[np.argsort(np.abs(after - before - length)[chosen], kind="stable")[: max(6, len(chosen) // 4)]]
        pick = int(rng.choice(nearest))
        return int(before[pick]), int(after[pick])
    room = last - 2 * edge - length
    if room < 1:
        return None
    first = int(edge + rng.uniform(0.0, room))
    return first, int(first + length)


def _draw_window(scene: Scene, rng: np.random.Generator, group: str, kind: str) -> _Window | None:
    rate, last = scene.rig.frame_rate, scene.rig.n_frames - 1
    for _ in range(6):
        plateau = _draw_plateau(scene, rng, scene.find_keys(group))
        if plateau is None:
            return None
        full, fading = plateau
        onset = round(rng.uniform(_EDGE_S[0] * rate, min(_EDGE_S[1] * rate, full)))
        fade = round(rng.uniform(_EDGE_S[0] * rate, min(_EDGE_S[1] * rate, last - fading)))
        window = _Window(full - max(onset, 1), full, fading, fading + max(fade, 1))
        if scene.fits(window.start, window.last + 1, group, kind):
            return window
    return None


def draft_shift(scene: Scene, rng: np.random.Generator, group: str) -> Draft | None:
    """Key poses come later or earlier than they should, all by about the same time."""
    rig = scene.rig
    rate = rig.frame_rate
    plateau = _draw_plateau(scene, rng, scene.find_keys(group))
    if plateau is None:
        return None
    lag = float(rng.uniform(*_LAG_S) * rng.choice([-1.0, 1.0]))
    slow, quick = _STOPPING * abs(lag), _CATCHING_UP * abs(lag)
    onset, fade = (
        rng.uniform(min(max(least, _EDGE_S[0]), _EDGE_S[1]), _EDGE_S[1]) * rate
        for least in ((slow, quick) if lag > 0 else (quick, slow))
    )
    full, fading = (frame + lag * rate for frame in plateau)
    start, last = int(np.floor(full - onset)), int(np.ceil(fading + fade))
    if not scene.fits(start, last + 1, group, "shift"):
        return None
    keys = scene.find_keys(group)
    moved = keys[(keys >= plateau[0]) & (keys <= plateau[1])] + lag * rate
    moved = np.unique([full, *moved, fading])
    lags = lag * rng.uniform(0.92, 1.0, len(moved))
    lags[np.unique([len(moved) // 2, max(len(moved) // 2 - 1, 0)])] = lag
    frames = np.arange(start, last + 1, dtype=np.float64)
    knots, values = np.array([start, *moved, last]), np.array([0.0, *lags, 0.0])
    late = interpolate_keys(knots, values, frames, cubic=False)
    asked = frames - late * rate
    if (np.diff(asked) <= 0.0).any() or asked[-1] > rig.n_frames - 1:
        return None
    variant = f"{_size_of(group)}_shift"
    return Draft("shift", variant, group, start, _retime(rig, group, start, asked), late)


def _size_of(group: str) -> str:
    return "body" if group == "body" else "pair" if group in PAIRS else "limb"


def _retime(rig: Rig, group: str, start: int, asked: FloatArray) -> FloatArray:
    """(N, 20, 3) positions from ``start`` on, of a group, or of everything, at the frames asked for."""
    span = slice(start, start + len(asked))
    if group == "body":
        directions = normalise(sample(rig.directions, asked))
        return build_positions(directions, rig.lengths[span], sample(rig.root, asked))
    directions = rig.directions[span].copy()
    for chains in CHAINS[group]:
        local = normalise(sample(rig.describe(chains), asked))
        directions[:, list(chains.joints)] = rig.to_world(chains, local, start)
    return rig.place(directions, start)


def draft_stops_short(scene: Scene, rng: np.random.Generator, group: str) -> Draft | None:
    """A key pose is not reached: the way to it ends early, the way back begins there."""
    rig, keys = scene.rig, scene.find_keys(group)
    chosen = _draw_excursion(scene, rng, group, keys)
    if chosen is None:
        return None
    first, key, last = chosen
    reach = float(rng.uniform(0.3, 0.68))
    stiff = float(rng.uniform(1.0, min(3.0, 0.95 / (1.0 - reach))))
    away = np.zeros(last - first + 1)
    for chains in CHAINS[group]:
        local = rig.describe(chains, slice(first, last + 1))[:, :, :2]
        away += np.sum(rotation_between(local, local[key - first]) ** 2, axis=(1, 2, 3))
    away = np.sqrt(away)
    scale = np.where(np.arange(len(away)) < key - first, away[0], away[-1])
    near = np.clip(1.0 - away / np.maximum(scale, 1e-9), 0.0, 1.0) ** stiff

    def turns(chains: Chains) -> FloatArray:
        local = rig.describe(chains)
        back = compare_chains(local[key], turn_chain(local[first], reach * compare_chains(local[first], local[key])))
        return np.asarray(near[:, None, None, None] * back)

    return _draft(scene, "incomplete", f"{_size_of(group)}_stops_short", group, first, last, turns)


def _draw_excursion(
    scene: Scene, rng: np.random.Generator, group: str, keys: IndexArray
) -> tuple[int, int, int] | None:
    """Frames of three key poses of which the middle one lies far from the others: the furthest of some drawn."""
    if len(keys) < 3:
        return None
    rate = scene.rig.frame_rate
    parts = [scene.rig.describe(chains)[keys][:, :, :2].reshape(len(keys), -1, 3) for chains in CHAINS[group]]
    poses = np.concatenate(parts, axis=1)
    best, furthest = None, float(np.radians(20.0))
    for _ in range(8):
        middle = int(rng.integers(1, len(keys) - 1))
        before = int(rng.integers(max(0, middle - _NEIGHBOURS), middle))
        after = int(rng.integers(middle + 1, min(len(keys), middle + 1 + _NEIGHBOURS)))
        first, key, last = int(keys[before]), int(keys[middle]), int(keys[after])
        if max(key - first, last - key) > _REACH_S * rate or min(key - first, last - key) < _EDGE_S[0] * rate:
            continue
        ways = [rotation_between(poses[middle], poses[other]) for other in (before, after)]
        far = min(float(measure_norm(way).max()) for way in ways)
        if far > furthest and scene.fits(first, last + 1, group, "incomplete"):
            best, furthest = (first, key, last), far
    return best


def draft_shrunk(scene: Scene, rng: np.random.Generator, group: str) -> Draft | None:
    """All key poses of a while are drawn towards one pose."""
    rig = scene.rig
    window = _draw_window(scene, rng, group, "incomplete")
    if window is None:
        return None
    less = float(rng.uniform(0.35, 0.7))
    towards_mean = rng.random() < 0.6

    def values(chains: Chains, knots: IndexArray) -> FloatArray:
        local = rig.describe(chains)
        middle = normalise(local[window.start : window.last + 1].mean(axis=0))
        return less * compare_chains(local[knots], middle if towards_mean else local[window.full])

    return _draft_layer(scene, rng, "incomplete", f"{_size_of(group)}_shrunk", group, window, values)


def draft_partial(scene: Scene, rng: np.random.Generator, group: str) -> Draft | None:
    """One limb does something else."""
    window = _draw_window(scene, rng, group, "partial")
    if window is None:
        return None
    variant = str(rng.choice(["other_movement", "other_movement", "other_side", "held", "other_direction"]))
    rig, chains = scene.rig, CHAINS[group][0]
    local = rig.describe(chains)
    if variant == "other_direction":
        turn = np.zeros((1, *chains.shape, 3))
        turn[0, 0, 0, rng.integers(3)] = np.radians(rng.uniform(35.0, 80.0 if chains.upright else 120.0)) * rng.choice(
            [-1.0, 1.0]
        )
        return _draft_layer(
            scene, rng, "partial", variant, group, window, lambda _, knots: np.repeat(turn, len(knots), axis=0)
        )
    if variant == "other_movement":
        borrowed = _borrow(scene, rng, window)
        if borrowed is None:
            return None
        target = borrowed.describe(chains)
        first, gap = window.start, _GAP_S
    elif variant == "other_side":
        other = CHAINS[LIMB_NAMES[LIMB_NAMES.index(group) ^ 1]][0]
        target, first, gap = rig.describe(other) * (-1.0, 1.0, 1.0), 0, _GAP_S
    else:
        target, first, gap = np.repeat(local[window.start][None], rig.n_frames, axis=0), 0, 0.07
    strength = float(rng.uniform(0.88, 1.0))
    return _draft_layer(
        *(scene, rng, "partial", variant, group, window),
        lambda _, knots: strength * compare_chains(local[knots], target[knots - first]),
        gap,
    )


def draft_global(scene: Scene, rng: np.random.Generator, group: str) -> Draft | None:
    """The body does another figure."""
    window = _draw_window(scene, rng, group, "global")
    if window is None:
        return None
    rig, first = scene.rig, window.start
    variant = str(rng.choice(["other_figure", "other_figure", "other_figure", "own_figure", "mirrored_figure"]))
    if variant == "other_figure" and not scene.donors:
        variant = "own_figure"
    if variant == "mirrored_figure":
        other: Rig | None = read_rig(mirror_points(scene.positions[first : window.last + 1]), rig.frame_rate)
    elif variant == "own_figure":
        other = _cut(rng, scene.positions, rig.frame_rate, window, rig.frame_rate)
    else:
        other = _borrow(scene, rng, window)
    if other is None:
        return None
    figure = other

    def values(chains: Chains, knots: IndexArray) -> FloatArray:
        return compare_chains(rig.describe(chains)[knots], figure.describe(chains)[knots - first])

    return _draft_layer(scene, rng, "global", variant, group, window, values)


def _borrow(scene: Scene, rng: np.random.Generator, window: _Window) -> Rig | None:
    """As many frames as the window has of another motion, or for want of one of this motion at another time."""
    rate = scene.rig.frame_rate
    if not scene.donors:
        return _cut(rng, scene.positions, rate, window, rate)
    donor = scene.donors[int(rng.integers(len(scene.donors)))]
    return _cut(rng, donor.positions, donor.frame_rate, window, rate)


def _cut(rng: np.random.Generator, positions: FloatArray, own_rate: float, window: _Window, rate: float) -> Rig | None:
    """Frames of a motion from a random moment on at another rate, back and forth if it is too short; or mirrored."""
    count = window.last + 1 - window.start
    needed = (count - 1) / rate * own_rate
    last = len(positions) - 1
    if last < 0.5 * needed or last < 2:
        return None
    first = float(rng.uniform(0.0, max(last - needed, 0.0)))
    frames = first + np.linspace(0.0, needed, count)
    frames = last - np.abs((frames % (2 * last)) - last)
    cut = sample(positions, frames)
    return read_rig(mirror_points(cut) if rng.random() < 0.5 else cut, rate)


def _draft_layer(
    scene: Scene,
    rng: np.random.Generator,
    kind: str,
    variant: str,
    group: str,
    window: _Window,
    values: Callable[[Chains, IndexArray], FloatArray],
    gap_s: float = _GAP_S,
) -> Draft:
    """An error whose turns are known at key poses, and are none at either end of the window."""
    knots = add_keys(scene.find_keys(group), window.full, window.fading, max(gap_s * scene.rig.frame_rate, 1.0))
    keys = np.array([window.start, *knots, window.last], np.float64)
    frames = np.arange(window.start, window.last + 1, dtype=np.float64)
    cubic = bool(rng.random() < 0.5)

    def turns(chains: Chains) -> FloatArray:
        known = unwrap_turns(values(chains, knots))
        none = np.zeros((1, *known.shape[1:]))
        known = np.concatenate([none, known, none])
        eased = interpolate_keys(keys, known, frames, cubic=False)
        if not cubic:
            return eased
        # The cubic belongs between the key poses; into and out of the error it would swing.
        inside = (frames >= keys[1]) & (frames <= keys[-2])
        eased[inside] = interpolate_keys(keys[1:-1], known[1:-1], frames[inside], cubic=True)
        return eased

    return _draft(scene, kind, variant, group, window.start, window.last, turns)


def _draft(
    scene: Scene, kind: str, variant: str, group: str, first: int, last: int, turns: Callable[[Chains], FloatArray]
) -> Draft:
    """An error from the turns of each chain, (N, C, K, 3) rad, in the frames from the first to the last."""
    rig = scene.rig
    directions = rig.directions[first : last + 1].copy()
    for chains in CHAINS[group]:
        turned = turn_chain(rig.describe(chains, slice(first, last + 1)), turns(chains))
        directions[:, list(chains.joints)] = rig.to_world(chains, turned, first)
    return Draft(kind, variant, group, first, rig.place(directions, first))
