"""Key poses of a limb or the body, and what an animator does to them: turn, retime, interpolate.

A motion is taken apart into directions and lengths of its bones, so that whatever is done to the directions keeps
the lengths. A chain is a limb, or one bone of the trunk; it is described in axes of the body: those of the chest for
an arm, those of the heading for the rest. Axes are rows left, up, front.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from dousa.arrays import BoolArray, FloatArray, IndexArray
from dousa.motion.canonical.canonicalise import CanonicalMotion
from dousa.motion.canonical.joints import CANONICAL_JOINTS, CANONICAL_PARENTS, MIRRORED_JOINTS
from dousa.motion.canonical.joints import JOINT_INDEX as J

_PARENTS = np.array(CANONICAL_PARENTS)
_FEET = [J[f"{side}_{name}"] for side in ("left", "right") for name in ("ankle", "toe")]
_SMOOTHED_S = 0.07
_STILL = 0.35  # rad/s of a chain: slower is a stop
_STOP_S, _SPACING_S = 0.25, 0.12
_DIP = 0.62  # of the speed on either side: as slow as this is an extreme


@dataclass(frozen=True, slots=True)
class Chains:
    """Chains of equally many bones, each of which hangs on the one before.

    Parameters
    ----------
    joints : C chains of K canonical joints, those at which the bones end.
    upright : described in the axes of the heading; else in those of the chest.
    """

    joints: tuple[tuple[int, ...], ...]
    upright: bool

    @property
    def shape(self) -> tuple[int, int]:
        """C and K."""
        return len(self.joints), len(self.joints[0])


_JOINTS = {
    f"{side}_{limb}": tuple(J[f"{side}_{name}"] for name in names.split())
    for limb, names in (("arm", "elbow wrist hand"), ("leg", "knee ankle toe"))
    for side in ("left", "right")
}

TRUNK = Chains(tuple((J[name],) for name in ("spine", "neck", "head")), True)
"""Bones of the trunk, each on its own."""
GIRDLES = Chains(tuple((J[f"{side}_{name}"],) for name in ("shoulder", "hip") for side in ("left", "right")), True)
"""Collar bones and halves of the pelvis, each on its own."""

PAIRS: dict[str, tuple[str, str]] = {"arms": ("left_arm", "right_arm"), "legs": ("left_leg", "right_leg")}
"""Limbs of each pair."""

LIMB_NAMES: tuple[str, ...] = ("left_arm", "right_arm", "left_leg", "right_leg")
"""Arms and legs."""


def limbs_of(group: str) -> tuple[str, ...]:
    """Names of the limbs of a limb, a pair of `PAIRS` or the ``"body"``."""
    return ("trunk", *LIMB_NAMES) if group == "body" else PAIRS.get(group, (group,))


def _chains_of(group: str) -> tuple[Chains, ...]:
    if group == "body":
        return TRUNK, GIRDLES, Chains(tuple(_JOINTS[name] for name in LIMB_NAMES), True)
    return (Chains(tuple(_JOINTS[name] for name in limbs_of(group)), group.endswith(("leg", "legs"))),)


CHAINS: dict[str, tuple[Chains, ...]] = {name: _chains_of(name) for name in ("body", *PAIRS, *LIMB_NAMES)}
"""Chains of each limb, each pair and the body; all upright for the body."""


@dataclass(frozen=True, slots=True, eq=False)
class Rig:
    """A motion as directions and lengths of bones.

    Parameters
    ----------
    directions : (T, 20, 3) unit vectors, world, from the parent to the joint; the root's is unused.
    lengths : (T, 20) m.
    root : (T, 3) m, the pelvis.
    chest, heading : (T, 3, 3) axes of the body in the world, rows left, up, front.
    frame_rate : Hz.
    """

    directions: FloatArray
    lengths: FloatArray
    root: FloatArray
    chest: FloatArray
    heading: FloatArray
    frame_rate: float

    @property
    def n_frames(self) -> int:
        """Number of poses."""
        return len(self.root)

    def describe(self, chains: Chains, frames: slice = slice(None)) -> FloatArray:
        """(N, C, K, 3) unit vectors of chains in their axes of the body, of some frames or all."""
        axes = (self.heading if chains.upright else self.chest)[frames]
        return rotate_axes(axes.transpose(0, 2, 1), self.directions[frames][:, list(chains.joints)])

    def to_world(self, chains: Chains, local: FloatArray, start: int) -> FloatArray:
        """(N, C, K, 3) world directions of chains of N frames from ``start`` on."""
        return rotate_axes((self.heading if chains.upright else self.chest)[start : start + len(local)], local)

    def place(self, directions: FloatArray, start: int) -> FloatArray:
        """(N, 20, 3) m with directions of N frames from ``start`` on; the lowest foot keeps its height."""
        span = slice(start, start + len(directions))
        points = build_positions(directions, self.lengths[span], self.root[span])
        before = build_positions(self.directions[span], self.lengths[span], self.root[span])
        points[..., 1] += (before[:, _FEET, 1].min(axis=1) - points[:, _FEET, 1].min(axis=1))[:, None]
        return points


def rotate_axes(axes: FloatArray, vectors: FloatArray) -> FloatArray:
    """(N, ..., 3) vectors times (N, 3, 3) axes, row by row."""
    return np.asarray(vectors.reshape(len(axes), -1, 3) @ axes).reshape(vectors.shape)


def build_positions(directions: FloatArray, lengths: FloatArray, root: FloatArray) -> FloatArray:
    """(T, 20, 3) m from directions (T, 20, 3), lengths (T, 20) m and the pelvis (T, 3) m."""
    points = directions * lengths[..., None]
    points[:, 0] = root
    for joint in range(1, len(CANONICAL_JOINTS)):
        points[:, joint] += points[:, _PARENTS[joint]]
    return points


def read_rig(positions: FloatArray, frame_rate: float) -> Rig:
    """Take positions (T, 20, 3) in m apart."""
    bones = positions - positions[:, np.maximum(_PARENTS, 0)]
    lengths = np.linalg.norm(bones, axis=2)
    directions = np.where(lengths[..., None] > 1e-9, bones / np.maximum(lengths, 1e-9)[..., None], (0.0, -1.0, 0.0))
    hips = positions[:, J["left_hip"]] - positions[:, J["right_hip"]]
    shoulders = positions[:, J["left_shoulder"]] - positions[:, J["right_shoulder"]]
    spine = positions[:, J["neck"]] - 0.5 * (positions[:, J["left_hip"]] + positions[:, J["right_hip"]])
    half = max(1, round(_SMOOTHED_S * frame_rate))
    hips, shoulders, spine = (smooth(part, half) for part in (hips, shoulders, spine))
    up = np.tile([0.0, 1.0, 0.0], (len(positions), 1))
    heading = _make_axes(hips + shoulders, up)
    return Rig(directions, lengths, positions[:, 0], _make_axes(shoulders, spine), heading, frame_rate)


def _make_axes(left: FloatArray, up: FloatArray) -> FloatArray:
    up = normalise(up)
    left = normalise(left - up * np.sum(left * up, axis=1, keepdims=True) + (1e-6, 0.0, 1e-7))
    left = normalise(left - up * np.sum(left * up, axis=1, keepdims=True))
    return np.stack([left, up, cross(left, up)], axis=1)


def normalise(vectors: FloatArray) -> FloatArray:
    """Unit vectors along the last axis."""
    return np.asarray(vectors / np.maximum(measure_norm(vectors), 1e-12))


def measure_norm(vectors: FloatArray) -> FloatArray:
    """(..., 1) lengths along the last axis."""
    return np.asarray(np.sqrt(np.einsum("...k,...k->...", vectors, vectors))[..., None])


def cross(one: FloatArray, other: FloatArray) -> FloatArray:
    """Vector products along the last axis; NumPy's own spends its time on moving axes."""
    (a, b, c), (x, y, z) = np.moveaxis(one, -1, 0), np.moveaxis(other, -1, 0)
    return np.stack([b * z - c * y, c * x - a * z, a * y - b * x], axis=-1)


def smooth(values: FloatArray, half: int) -> FloatArray:
    """(T, ...) averaged twice over ``2 half + 1`` frames, ends held."""
    width = 2 * half + 1
    for _ in range(2):
        total = np.cumsum(np.pad(values, [(half + 1, half)] + [(0, 0)] * (values.ndim - 1), mode="edge"), axis=0)
        values = (total[width:] - total[:-width]) / width
    return values


def find_keys(rig: Rig, group: str) -> IndexArray:
    """Frames of the key poses of a group, in order: extremes, both ends of each stop, both ends of the motion."""
    speed = measure_speed(rig, group)
    rate, last = rig.frame_rate, rig.n_frames - 1
    found = [0, last, *_find_extremes(speed)]
    for start, stop in find_runs(speed < _STILL):
        if stop - start >= _STOP_S * rate:
            found += [start, stop - 1]
    kept = [0]
    for key in sorted(found):
        if key - kept[-1] >= _SPACING_S * rate and last - key >= _SPACING_S * rate:
            kept.append(key)
    return np.array([*kept, last], np.intp)


def measure_speed(rig: Rig, group: str) -> FloatArray:
    """(T,) rad/s of the fastest chain of a group, smoothed."""
    half = max(1, round(_SMOOTHED_S * rig.frame_rate))
    fastest = np.zeros(rig.n_frames)
    for chains in CHAINS[group]:
        series = smooth(rig.describe(chains)[:, :, :2], half)
        steps = np.gradient(series, axis=0).reshape(rig.n_frames, len(chains.joints), -1)
        fastest = np.maximum(fastest, np.sqrt((steps**2).sum(axis=2)).max(axis=1) * rig.frame_rate)
    return fastest


def _find_extremes(speed: FloatArray) -> list[int]:
    """Frames at which the speed is a good deal lower than before and after."""
    found, falling, top, low, where = [], False, float(speed[0]), float(speed[0]), 0
    for frame, value in enumerate(speed.tolist()):
        if falling:
            if value < low:
                low, where = value, frame
            elif value > _STILL and value * _DIP > low:
                found.append(where)
                falling, top = False, value
        elif value > top:
            top = value
        elif value < top * _DIP:
            falling, low, where = True, value, frame
    return found


def find_runs(flags: BoolArray) -> list[tuple[int, int]]:
    """Start and stop of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def rotation_between(before: FloatArray, after: FloatArray) -> FloatArray:
    """Rotation vectors (..., 3) in rad, the shortest from unit vectors to others."""
    axis = cross(before, after)
    sine = measure_norm(axis)
    cosine = np.einsum("...k,...k->...", before, after)[..., None]
    axis = axis / np.maximum(sine, 1e-12)
    opposite = (sine[..., 0] < 1e-7) & (cosine[..., 0] < 0.0)
    if opposite.any():
        flat = np.where(np.abs(before[..., :1]) < 0.6, (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
        axis[opposite] = normalise(cross(before, flat))[opposite]
    return np.asarray(axis * np.arctan2(sine, cosine))


def rotate(rotation: FloatArray, vectors: FloatArray) -> FloatArray:
    """Turn (..., 3) vectors by (..., 3) rotation vectors in rad (Rodrigues)."""
    angle = measure_norm(rotation)
    axis = rotation / np.maximum(angle, 1e-12)
    cosine = np.cos(angle)
    along = np.einsum("...k,...k->...", axis, vectors)[..., None] * (1.0 - cosine)
    return np.asarray(vectors * cosine + cross(axis, vectors) * np.sin(angle) + axis * along)


def compare_chains(before: FloatArray, after: FloatArray) -> FloatArray:
    """(..., K, 3) rad: how each joint of a chain turns, carrying what hangs on it, to get from a pose to another."""
    before, after = np.broadcast_arrays(before, after)
    turns = np.zeros(after.shape)
    for bone in range(after.shape[-2]):
        target = after[..., bone, :]
        for parent in range(bone):
            target = rotate(-turns[..., parent, :], target)
        turns[..., bone, :] = rotation_between(before[..., bone, :], target)
    return turns


def turn_chain(pose: FloatArray, turns: FloatArray) -> FloatArray:
    """(..., K, 3) directions of a chain whose joints turn by (..., K, 3) rad: undoes `compare_chains`."""
    turned = np.empty(np.broadcast_shapes(pose.shape, turns.shape))
    for bone in range(turns.shape[-2]):
        vector = pose[..., bone, :]
        for parent in range(bone, -1, -1):
            vector = rotate(turns[..., parent, :], vector)
        turned[..., bone, :] = vector
    return turned


def unwrap_turns(turns: FloatArray) -> FloatArray:
    """(M, ..., 3) rotation vectors, each the long way round where that is nearer to the one before."""
    angles = measure_norm(turns)
    if angles.max(initial=0.0) < 0.5 * np.pi:
        return turns
    turns = turns.copy()
    others = turns * (1.0 - 2.0 * np.pi / np.maximum(angles, 1e-9))
    for index in range(1, len(turns)):
        step, other = measure_norm(turns[index] - turns[index - 1]), measure_norm(others[index] - turns[index - 1])
        turns[index] = np.where(other < step, others[index], turns[index])
    return turns


def ease(share: FloatArray) -> FloatArray:
    """Minimum-jerk progress from 0 to 1 for shares of the time (Flash and Hogan 1985)."""
    share = np.clip(share, 0.0, 1.0)
    return np.asarray(share**3 * (10.0 - 15.0 * share + 6.0 * share**2))


def interpolate_keys(keys: FloatArray, values: FloatArray, frames: FloatArray, cubic: bool) -> FloatArray:
    """(N, ...) values at frames between keys (M,), ascending, with values (M, ...); ends held.

    Minimum-jerk from key to key, or a cubic whose slope at an inner key is that of the line through its neighbours.
    """
    index = np.clip(np.searchsorted(keys, frames, side="right") - 1, 0, len(keys) - 2)
    step = np.maximum(keys[index + 1] - keys[index], 1e-9)
    share = np.clip((frames - keys[index]) / step, 0.0, 1.0)
    column = (-1, *[1] * (values.ndim - 1))
    low, high = values[index], values[index + 1]
    if not cubic:
        return np.asarray(low + (high - low) * ease(share).reshape(column))
    slopes = np.zeros_like(values)
    slopes[1:-1] = (values[2:] - values[:-2]) / (keys[2:] - keys[:-2]).reshape(column)
    share, step = share.reshape(column), step.reshape(column)
    late = share**2 * (3.0 - 2.0 * share)
    bulge = slopes[index] * (share * (1.0 - share) ** 2) - slopes[index + 1] * (share**2 * (1.0 - share))
    return np.asarray(low + (high - low) * late + bulge * step)


def add_keys(keys: IndexArray, start: int, stop: int, widest: float) -> IndexArray:
    """Frames of the keys from ``start`` to ``stop``, both of them included, and more where gaps exceed ``widest``."""
    inner = keys[(keys > start) & (keys < stop)]
    knots = [start, *inner.tolist(), max(stop, start + 1)]
    dense = [
        np.linspace(a, b, max(1, int(np.ceil((b - a) / widest))), endpoint=False) for a, b in pairwise(knots) if b > a
    ]
    return np.unique(np.round([*np.concatenate(dense), knots[-1]])).astype(np.intp)


def sample(values: FloatArray, frames: FloatArray) -> FloatArray:
    """(N, ...) values at fractional frames, linear, ends held."""
    frames = np.clip(frames, 0.0, len(values) - 1.0)
    low = np.minimum(frames.astype(np.intp), max(len(values) - 2, 0))
    high = np.minimum(low + 1, len(values) - 1)
    share = (frames - low).reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray(values[low] * (1.0 - share) + values[high] * share)


def mirror_points(positions: FloatArray) -> FloatArray:
    """(T, 20, 3) in a mirror: x negated, left and right changed."""
    return np.asarray(positions[:, list(MIRRORED_JOINTS)] * (-1.0, 1.0, 1.0))


def replace_frames(motion: CanonicalMotion, start: int, positions: FloatArray) -> CanonicalMotion:
    """The motion with other positions from a frame on; all other frames to the last bit as they were."""
    points = motion.positions.copy()
    points[start : start + len(positions)] = positions
    points.flags.writeable = False
    return dataclasses.replace(motion, positions=points)
