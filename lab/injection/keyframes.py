"""Errors and performers made over key poses: the generator that is kept whole for the last reading.

Nothing that is trained or tuned may see what comes from here.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from dousa.arrays import FloatArray
from dousa.motion.canonical.canonicalise import CanonicalMotion
from dousa.motion.canonical.joints import JOINT_INDEX as J
from lab.injection.injection import Error, Injection
from lab.injection.key_edits import (
    Scene,
    Taken,
    draft_global,
    draft_partial,
    draft_shift,
    draft_shrunk,
    draft_stops_short,
)
from lab.injection.key_poses import (
    CHAINS,
    GIRDLES,
    LIMB_NAMES,
    TRUNK,
    Rig,
    add_keys,
    build_positions,
    find_keys,
    interpolate_keys,
    limbs_of,
    normalise,
    read_rig,
    replace_frames,
    rotate,
    sample,
    smooth,
    turn_chain,
)
from lab.injection.key_truth import Draft, judge_draft

_SHORTEST_S = 1.2
_TRIES, _TRIES_TOGETHER = 7, 5
_TOGETHER = 0.6  # of the motions with several errors
_PAIRS_OF_ERRORS = (
    (("shift", "body"), ("partial", "limb")),
    (("shift", "body"), ("incomplete", "limb")),
    (("shift", "arm"), ("incomplete", "leg")),
    (("shift", "leg"), ("incomplete", "arm")),
    (("shift", "arm"), ("partial", "leg")),
    (("incomplete", "arm"), ("partial", "arm")),
)

_VARIES_DEG, _EARLY_S, _STANDS_DEG = (2.0, 4.0), (0.010, 0.035), 10.0
_TRUNK_SHARE, _GIRDLE_SHARE, _ON_TOP = 0.4, 0.25, 0.5
_VARY_GAP_S = 0.7
_STATURES, _BUILDS = (0.9, 1.12), (0.93, 1.07)
_PLACE_M = 2.0
_NOISE_M = (0.0005, 0.004)
_SWAY_S = 0.15

_REGIONS = (
    ("spine", "neck", "head"),
    ("left_shoulder", "right_shoulder"),
    ("left_hip", "right_hip"),
    *(tuple(f"{side}_{name}" for side in ("left", "right")) for name in ("elbow", "wrist", "hand")),
    *(tuple(f"{side}_{name}" for side in ("left", "right")) for name in ("knee", "ankle", "toe")),
)
_FEET = [J[f"{side}_{name}"] for side in ("left", "right") for name in ("ankle", "toe")]


def inject_keyframes(
    motion: CanonicalMotion, rng: np.random.Generator, donors: Sequence[CanonicalMotion], n_errors: int = 1
) -> Injection | None:
    """Put errors into a motion.

    Parameters
    ----------
    motion : finite positions, 1.5 to 60 s, any frame rate.
    rng : all randomness comes from here.
    donors : other motions, of any frame rate, for movements that do not belong here; may be empty.
    n_errors : how many are wanted, 1 or more. Those that find no place, or turn out too small to be seen as what
        they are, are left out. Two may overlap in time.

    Returns
    -------
    The motion with its errors in order of time, bone lengths and number of frames as before, all frames before the
    first and behind the last change of an error as before; None if no error is possible, or none is wanted.
    """
    if motion.duration < _SHORTEST_S or motion.n_frames < 12:
        return None
    usable = [donor for donor in donors if donor.n_frames >= 12]
    scene = Scene(read_rig(motion.positions, motion.frame_rate), motion.positions, usable)
    errors: list[Error] = []
    current = motion
    for wanted in _plan(rng, n_errors):
        made = _make_error(scene, rng, wanted)
        if made is None:
            continue
        draft, error = made
        errors.append(error)
        current = replace_frames(current, draft.start, draft.positions)
        taken = (*scene.taken, Taken(draft.start, draft.stop, draft.group, draft.kind))
        scene = Scene(read_rig(current.positions, current.frame_rate), current.positions, usable, taken)
    if not errors:
        return None
    return Injection(current, tuple(sorted(errors, key=lambda error: (error.start_s, error.end_s))))


@dataclass(frozen=True, slots=True)
class _Wanted:
    """Kind of an error, where (limb, arm, leg, body), and whether at the same time as the one before; None: any."""

    kind: str | None = None
    where: str | None = None
    together: bool = False


def _plan(rng: np.random.Generator, n_errors: int) -> list[_Wanted]:
    plan = [_Wanted() for _ in range(n_errors)]
    if n_errors >= 2 and rng.random() < _TOGETHER:
        one, other = _PAIRS_OF_ERRORS[int(rng.integers(len(_PAIRS_OF_ERRORS)))]
        plan[:2] = [_Wanted(*one), _Wanted(*other, together=True)]
    return plan


_DRAFTS: dict[str, tuple[Callable[[Scene, np.random.Generator, str], Draft | None], ...]] = {
    "shift": (draft_shift,),
    "incomplete": (draft_stops_short, draft_shrunk),
    "partial": (draft_partial,),
    "global": (draft_global,),
}


def _make_error(scene: Scene, rng: np.random.Generator, wanted: _Wanted) -> tuple[Draft, Error] | None:
    attempts: list[tuple[Scene, str, str | None]] = []
    beside = dataclasses.replace(scene, near=scene.taken[-1]) if scene.taken else scene
    if wanted.kind is not None:
        attempts += [(beside if wanted.together else scene, wanted.kind, wanted.where)] * _TRIES_TOGETHER
    place = scene if scene.has_room else beside
    possible = list(_DRAFTS) if scene.has_room else ["shift", "incomplete", "partial"]
    for kind in rng.permutation(possible):
        attempts += [(place, str(kind), None)] * (_TRIES if scene.has_room else _TRIES_TOGETHER)
    for place, kind, where in attempts:
        makers = _DRAFTS[kind]
        maker = makers[int(rng.integers(len(makers)))]
        draft = maker(place, rng, _draw_group(rng, kind, where, place.near))
        error = None if draft is None else judge_draft(place.rig, place.positions, draft)
        if draft is not None and error is not None:
            return draft, error
    return None


def _draw_group(rng: np.random.Generator, kind: str, where: str | None, near: Taken | None) -> str:
    """Which limb, limbs or body; none that the error at the same time already has, unless that has all."""
    if kind == "global" or where == "body":
        return "body"
    size = "limb"
    if kind != "partial" and where != "limb":
        shares = (0.4, 0.2, 0.4) if kind == "shift" else (0.5, 0.2, 0.3)
        size = str(rng.choice(["limb", "pair", "body"], p=shares))
    if size == "body" and where is None:
        return "body"
    part = where if where in ("arm", "leg") else str(rng.choice(["arm", "leg"], p=[0.6, 0.4]))
    busy = set() if near is None or near.group == "body" else set(limbs_of(near.group))
    if size == "pair" and not busy & set(limbs_of(f"{part}s")):
        return f"{part}s"
    names = [name for name in LIMB_NAMES if name.endswith(part) and name not in busy]
    return str(rng.choice(names or list(LIMB_NAMES)))


def perform_keyframes(motion: CanonicalMotion, rng: np.random.Generator) -> CanonicalMotion:
    """The same motion by somebody else, without a mistake.

    Postures vary by 2 to 4 deg and moments by 10 to 35 ms (root mean square) around those of the motion; somebody of
    another build stands up to 10 deg differently throughout, faces elsewhere, at another place, seen by a noisy
    sensor.

    Parameters
    ----------
    motion : finite positions.
    rng : all randomness comes from here.

    Returns
    -------
    As many frames at the same rate.
    """
    rig = _vary_moments(read_rig(motion.positions, motion.frame_rate), rng)
    rig = dataclasses.replace(rig, directions=_vary_postures(rig, rng))
    stature = float(rng.uniform(*_STATURES))
    factors = _draw_build(rng, stature)
    points = build_positions(rig.directions, rig.lengths * factors, rig.root)
    points = _stand(points, motion.positions, rig.root, float(factors[J["left_knee"]]))
    yaw = float(rng.uniform(-np.pi, np.pi))
    turn = np.array([[np.cos(yaw), 0.0, np.sin(yaw)], [0.0, 1.0, 0.0], [-np.sin(yaw), 0.0, np.cos(yaw)]])
    points = points @ turn.T + np.array([1.0, 0.0, 1.0]) * rng.uniform(-_PLACE_M, _PLACE_M, 3)
    points += _draw_noise(rng, points.shape, motion.frame_rate)
    points.flags.writeable = False
    return dataclasses.replace(motion, positions=points, height=motion.height * stature)


def _vary_moments(rig: Rig, rng: np.random.Generator) -> Rig:
    """Every key pose a little early or late: that of the body, and of each limb against the body."""
    if rig.n_frames < 4:
        return rig
    size = rng.uniform(*_EARLY_S) * rig.frame_rate
    asked = _draw_moments(rig, rng, "body", 0.9 * size)
    directions, root = normalise(sample(rig.directions, asked)), sample(rig.root, asked)
    moved = read_rig(build_positions(directions, rig.lengths, root), rig.frame_rate)
    directions = moved.directions.copy()
    for name in LIMB_NAMES:
        (chains,) = CHAINS[name]
        local = normalise(sample(moved.describe(chains), _draw_moments(moved, rng, name, 0.4 * size)))
        directions[:, list(chains.joints)] = moved.to_world(chains, local, 0)
    return dataclasses.replace(moved, directions=directions)


def _draw_moments(rig: Rig, rng: np.random.Generator, group: str, size: float) -> FloatArray:
    """(T,) frames that are shown: those of a clock which is wrong by about ``size`` frames at key poses."""
    keys = add_keys(find_keys(rig, group), 0, rig.n_frames - 1, 1.5 * rig.frame_rate).astype(np.float64)
    late = np.clip(rng.normal(0.0, size, len(keys)), -2.0 * size, 2.0 * size)
    # A clock that is right at the ends, and nowhere runs backwards.
    late[[0, -1]] = 0.0
    closest = 0.4 * np.minimum(np.diff(keys, prepend=-1e9), np.diff(keys, append=1e9))
    late = np.clip(late, -closest, closest)
    frames = np.arange(rig.n_frames, dtype=np.float64)
    return np.maximum.accumulate(frames - interpolate_keys(keys, late, frames, cubic=False))


def _vary_postures(rig: Rig, rng: np.random.Generator) -> FloatArray:
    """(T, 20, 3) directions with other key poses by a few degrees, and throughout by some more."""
    directions = rig.directions.copy()
    frames = np.arange(rig.n_frames, dtype=np.float64)
    size = np.radians(rng.uniform(*_VARIES_DEG))
    for group in (*LIMB_NAMES, "body"):
        keys = add_keys(find_keys(rig, group), 0, rig.n_frames - 1, max(_VARY_GAP_S * rig.frame_rate, 1.0))
        varied = ((TRUNK, _TRUNK_SHARE), (GIRDLES, _GIRDLE_SHARE)) if group == "body" else ((CHAINS[group][0], 1.0),)
        for chains, share in varied:
            shape = (*chains.shape, 3)
            # Two of three axes turn a direction: the third only turns it about itself.
            noise = rng.normal(0.0, share * size / np.sqrt(2.0), (len(keys), *shape))
            noise[..., 1:, :] *= _ON_TOP  # a forearm is already carried along by the upper arm
            most = share * np.radians(_STANDS_DEG)
            stands = normalise(rng.normal(size=shape)) * rng.uniform(0.0, most, (*chains.shape, 1))
            turns = interpolate_keys(keys.astype(np.float64), noise, frames, cubic=True)
            local = turn_chain(rig.describe(chains), turns)
            directions[:, list(chains.joints)] = rig.to_world(chains, rotate(stands, local), 0)
    return directions


def _draw_build(rng: np.random.Generator, stature: float) -> FloatArray:
    """(20,) factors of the lengths of the bones, the same on the left and on the right."""
    factors = np.full(len(J), stature)
    for region in _REGIONS:
        factors[[J[name] for name in region]] *= rng.uniform(*_BUILDS)
    return factors


def _stand(points: FloatArray, before: FloatArray, root: FloatArray, legs: float) -> FloatArray:
    """Move a body of other size to where its feet touch the floor, and let it travel by the length of its legs."""
    travel = (root - root[0]) * (legs - 1.0)
    travel[:, 1] = 0.0
    points = points + travel[:, None]
    lift = before[:, _FEET, 1].min(axis=1) - points[:, _FEET, 1].min(axis=1)
    points[..., 1] += np.median(lift)
    # What is left is a floor that gives way: even it out slowly, so that no step is lost.
    points[..., 1] += smooth(lift - np.median(lift), min(8, max(1, len(lift) // 8)))[:, None]
    return points


def _draw_noise(rng: np.random.Generator, shape: tuple[int, ...], rate: float) -> FloatArray:
    """(T, 20, 3) m: what a sensor adds, part of it from frame to frame, part of it slowly."""
    size = float(rng.uniform(*_NOISE_M))
    slow = smooth(rng.normal(size=shape), max(1, round(_SWAY_S * rate)))
    slow *= 1.0 / max(float(slow.std()), 1e-12)
    return size * (0.8 * rng.normal(size=shape) + 0.6 * slow)
