"""Several errors put into one motion, one over the other: where they lie, what they befall, in which order.

A whole-body error comes into a part of the motion that is still right. A limb may go wrong within a body that is late,
or beside another limb that is wrong too; each truth is measured against the motion as it was before that error.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from dousa.arrays import FloatArray
from dousa.evaluation.posture.posture import SEGMENTS
from dousa.motion.canonical.canonicalise import CanonicalMotion
from lab.injection.edits import Take, measure_angles, prepare_take, put_together, turn
from lab.injection.injection import Error, Injection
from lab.injection.truth import BODY, LIMB_GROUPS, LOWER_GROUPS, Draft, Group, Stretch, judge

_DURATIONS_S = (0.5, 4.0)
_MOST_SHARE = 0.85  # of the motion
_FADES_S = (0.1, 0.8)
_MARGIN_S = 0.1
_GAP_S = 0.4  # between errors that do not overlap
_SHORTEST_MOTION_S = 1.0
_ELSEWHERE_S = 1.0  # a section nearer than this would be a shift
_OWN_SHARE = 0.5  # of the sections from elsewhere, where donors are given
_BESIDE = 0.45  # chance that an error is put over another one
_N_RECIPES = 4  # tried for an error, the first two of one kind
_N_TRIES = 5  # of each
_N_PLACES = 6  # looked at for each try
_TRAVEL_DEG = 30.0  # on its way, for a segment that is to be late or smaller
_KINDS = {"shift": 0.3, "incomplete": 0.28, "partial": 0.27, "global": 0.15}
_SINGLE = 0.72  # of the errors of limbs befall one limb only


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """What a maker of errors sees.

    Parameters
    ----------
    take : the carrier as it is now.
    stretch : where the error shall be.
    group : what shall go wrong.
    section : gives (n, 20, 3) m positions from elsewhere, as long as the stretch; None if there are none.
    """

    take: Take
    stretch: Stretch
    group: Group
    section: Callable[[np.random.Generator], FloatArray | None]

    @property
    def clean(self) -> FloatArray:
        """(n, 20, 3) m, of the stretch."""
        return put_together(self.take.body.cut(self.stretch.start, self.stretch.stop))

    @property
    def heading(self) -> FloatArray:
        """(n,) rad, of the stretch."""
        return self.take.heading[self.stretch.start : self.stretch.stop]


Maker = Callable[[Scene, np.random.Generator], Draft | None]


@dataclass(frozen=True, slots=True)
class Recipe:
    """One way to go wrong.

    Parameters
    ----------
    kind, variant : of the error.
    make : the wrong motion; None where it cannot be.
    whole : of the whole body, or of limbs.
    moving : only where there is movement.
    lower : may befall a forearm or shank alone.
    """

    kind: str
    variant: str
    make: Maker
    whole: bool
    moving: bool = True
    lower: bool = False


def keep_floor(clean: FloatArray, positions: FloatArray) -> FloatArray:
    """Raise or lower poses (n, 20, 3) m so that the lowest joint of each is as high as it was."""
    kept = positions.copy()
    kept[..., 1] += (clean[..., 1].min(axis=1) - positions[..., 1].min(axis=1))[:, None]
    return kept


def compose(
    motion: CanonicalMotion,
    rng: np.random.Generator,
    donors: Sequence[CanonicalMotion],
    wanted: int,
    recipes: Sequence[Recipe],
) -> Injection | None:
    """A motion with as many of the wanted errors as find a place.

    Parameters
    ----------
    motion : clean, of any frame rate.
    rng : the only source of chance.
    donors : motions that wrong figures may be taken from, besides the motion itself.
    wanted : number of errors.
    recipes : to choose from, kinds by their own odds.

    Returns
    -------
    None if none found a place.
    """
    if motion.duration < _SHORTEST_MOTION_S or motion.n_frames < 8 or wanted < 1:
        return None
    board = _Board(motion, donors, by_kind={kind: [r for r in recipes if r.kind == kind] for kind in _KINDS})
    for _ in range(wanted):
        _place_one(board, rng)
    if not board.placed:
        return None
    positions = board.positions
    positions.flags.writeable = False
    errors = sorted((error for error, _, _ in board.placed), key=lambda error: error.start_s)
    return Injection(replace(motion, positions=positions), tuple(errors))


def _place_one(board: _Board, rng: np.random.Generator) -> None:
    kind = ""
    for number in range(_N_RECIPES):
        if number % 2 == 0:
            kinds = [kind for kind in _KINDS if board.by_kind[kind]]
            odds = np.array([_KINDS[kind] for kind in kinds])
            kind = str(rng.choice(kinds, p=odds / odds.sum()))
        recipes = board.by_kind[kind]
        recipe = recipes[int(rng.integers(len(recipes)))]
        if any(board.try_error(recipe, rng) for _ in range(_N_TRIES)):
            return


@dataclass(slots=True)
class _Board:
    """The motion as it stands, and the errors in it so far."""

    motion: CanonicalMotion
    donors: Sequence[CanonicalMotion]
    by_kind: Mapping[str, Sequence[Recipe]]
    placed: list[tuple[Error, Stretch, Group]] = field(default_factory=list)
    positions: FloatArray = field(init=False)
    take: Take = field(init=False)
    travel: FloatArray = field(init=False)  # (T, 9) degrees since the start

    def __post_init__(self) -> None:
        self.positions = np.array(self.motion.positions, dtype=np.float64)
        self._look_again()

    def _look_again(self) -> None:
        self.take = prepare_take(replace(self.motion, positions=self.positions))
        free = turn(self.take.segments, -self.take.heading)
        steps = measure_angles(free[1:], free[:-1])
        self.travel = np.concatenate([np.zeros((1, len(SEGMENTS))), np.cumsum(steps, axis=0)])

    def try_error(self, recipe: Recipe, rng: np.random.Generator) -> bool:
        """Draw a place and limbs; whether that gave an error."""
        place = self._find_place(recipe, rng)
        if place is None:
            return False
        stretch, group = place
        scene = Scene(self.take, stretch, group, lambda chance: self._draw_section(stretch, chance))
        draft = recipe.make(scene, rng)
        if draft is None:
            return False
        error = judge(recipe.kind, recipe.variant, self.take, stretch, draft)
        if error is None:
            return False
        self.positions[stretch.start : stretch.stop] = draft.positions
        self.placed.append((error, stretch, draft.group))
        self._look_again()
        return True

    def _find_place(self, recipe: Recipe, rng: np.random.Generator) -> tuple[Stretch, Group] | None:
        for _ in range(_N_PLACES):
            stretch = self._draw_stretch(recipe, rng)
            group = None if stretch is None else self._draw_group(recipe, stretch, rng)
            if stretch is not None and group is not None:
                return stretch, group
        return None

    def _draw_stretch(self, recipe: Recipe, rng: np.random.Generator) -> Stretch | None:
        rate, seconds = self.take.frame_rate, self.take.n_frames / self.take.frame_rate
        longest = min(_DURATIONS_S[1], _MOST_SHARE * seconds)
        duration = float(rng.uniform(np.sqrt(_DURATIONS_S[0]), np.sqrt(longest)) ** 2)
        margin = min(_MARGIN_S, 0.05 * seconds)
        room = seconds - 2.0 * margin - duration
        if room < 0.0:
            return None
        limbs = [stretch for _, stretch, group in self.placed if not recipe.whole or group.is_whole]
        if not recipe.whole and limbs and rng.random() < _BESIDE:
            other = limbs[int(rng.integers(len(limbs)))]
            middle = rng.uniform(other.start, other.stop) / rate
            start = float(np.clip(middle - 0.5 * duration, margin, margin + room))
        else:
            start = margin + rng.uniform(0.0, room)
        first = round(start * rate)
        last = min(first + max(round(duration * rate), 6), self.take.n_frames)
        rise, fall = rng.uniform(_FADES_S[0], _FADES_S[1], 2)
        squeeze = min(1.0, 0.6 * duration / (rise + fall))
        fades = np.maximum(np.array([rise, fall]) * squeeze * rate, 1.0)
        return Stretch(first, last, float(fades[0]), float(fades[1]), rate)

    def _draw_group(self, recipe: Recipe, stretch: Stretch, rng: np.random.Generator) -> Group | None:
        """What may go wrong here, beside what is wrong already."""
        gap = _GAP_S * stretch.frame_rate
        met = [p for p in self.placed if stretch.start < p[1].stop + gap and p[1].start < stretch.stop + gap]
        travel = self.travel[stretch.stop - 1] - self.travel[stretch.start]
        if recipe.whole:
            still = recipe.moving and travel.max() < _TRAVEL_DEG
            return None if met or still else BODY
        taken: set[int] = set()
        for error, _, group in met:
            # Within a late body a limb may be wrong or stop short; no more than one kind of lag at a time.
            if group.is_whole and (error.kind != "shift" or recipe.kind == "shift"):
                return None
            taken |= set() if group.is_whole else set(group.segments)
        free = [group for group in LIMB_GROUPS if not taken & set(group.segments)]
        if recipe.moving:
            free = [group for group in free if all(travel[list(part)].max() > _TRAVEL_DEG for part in _halves(group))]
        if not free:
            return None
        odds = np.array([_SINGLE / 4 if len(group.segments) == 2 else (1.0 - _SINGLE) / 2 for group in free])
        chosen = free[int(rng.choice(len(free), p=odds / odds.sum()))]
        if recipe.lower and chosen.name in LOWER_GROUPS and rng.random() < 0.25:
            return LOWER_GROUPS[chosen.name]
        return chosen

    def _draw_section(self, stretch: Stretch, rng: np.random.Generator) -> FloatArray | None:
        """(n, 20, 3) m from elsewhere in the motion, or from a donor."""
        n, source = stretch.n_frames, self.motion
        own = self.motion.n_frames - n >= 2.0 * _ELSEWHERE_S * stretch.frame_rate
        if self.donors and (not own or rng.random() > _OWN_SHARE):
            source = self.donors[int(rng.integers(len(self.donors)))]
        elif not own:
            return None
        step = source.frame_rate / stretch.frame_rate
        room = source.n_frames - 1 - (n - 1) * step
        if room < 0:
            return None
        first = rng.uniform(0.0, room)
        if source is self.motion and abs(first - stretch.start) < _ELSEWHERE_S * stretch.frame_rate:
            return None
        frames = first + step * np.arange(n)
        low = np.minimum(frames.astype(np.intp), source.n_frames - 1)
        share = (frames - low)[:, None, None]
        positions = np.asarray(source.positions, dtype=np.float64)
        mixed: FloatArray = positions[low] * (1.0 - share)
        mixed += positions[np.minimum(low + 1, source.n_frames - 1)] * share
        return mixed


def _halves(group: Group) -> list[tuple[int, ...]]:
    """The segments of each limb of a group."""
    return [group.segments[k : k + 2] for k in range(0, len(group.segments), 2)]
