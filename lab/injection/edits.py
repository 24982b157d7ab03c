"""The errors themselves: each takes a window of a clean take and gives the wrong motion for it.

A motion is taken apart into what an error changes: place, directions of the bones, lengths of the bones. Directions
are edited as unit vectors, by slerp, so that there is no joint-angle trouble; positions are rebuilt after that.
"Heading-free" means turned so that the body's left is +X and its front +Z.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from dousa.arrays import FloatArray, IndexArray
from dousa.evaluation.posture.posture import LIMBS, SEGMENTS, compute_segments
from dousa.evaluation.posture.yaw import estimate_yaw, rotate_yaw
from dousa.motion.canonical.canonicalise import CanonicalMotion
from dousa.motion.canonical.joints import CANONICAL_PARENTS, JOINT_INDEX, MIRRORED_JOINTS

_HEADING_S = 0.3  # smoothing of the heading: a twist of the shoulders is no turn of the body
_PARENTS = np.array(CANONICAL_PARENTS[1:])


def find_bones(*names: str) -> tuple[int, ...]:
    """Indices of the bones (0 to 18) that end in these joints."""
    return tuple(JOINT_INDEX[name] - 1 for name in names)


TRUNK_BONES = find_bones("spine", "neck", "left_shoulder", "right_shoulder", "left_hip", "right_hip")
LIMB_BONES: dict[str, tuple[int, ...]] = {
    f"{side}_{limb}": find_bones(*(f"{side}_{joint}" for joint in joints))
    for side in ("left", "right")
    for limb, joints in (("arm", ("elbow", "wrist", "hand")), ("leg", ("knee", "ankle", "toe")))
}


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """Place of the pelvis (T, 3) m, unit directions (T, 19, 3) and lengths (T, 19) m of the bones.

    Bone k runs from the parent of canonical joint k + 1 to that joint.
    """

    root: FloatArray
    directions: FloatArray
    lengths: FloatArray

    def cut(self, start: int, stop: int) -> Body:
        """The frames from ``start`` up to ``stop``."""
        return Body(self.root[start:stop], self.directions[start:stop], self.lengths[start:stop])


@dataclass(frozen=True, slots=True, eq=False)
class Take:
    """A clean motion, ready to be edited.

    Parameters
    ----------
    body : (T, ...).
    segments : (T, 9, 3) unit vectors, world.
    heading : (T,) rad about the vertical, unwrapped; turning by ``-heading`` makes the body face +Z.
    frame_rate : Hz.
    """

    body: Body
    segments: FloatArray
    heading: FloatArray
    frame_rate: float

    @property
    def n_frames(self) -> int:
        """Number of poses."""
        return len(self.segments)


def take_apart(positions: FloatArray) -> Body:
    """Canonical positions (T, 20, 3) m as place, directions and lengths; `put_together` is the inverse."""
    bones = positions[:, 1:] - positions[:, _PARENTS]
    lengths = np.linalg.norm(bones, axis=2)
    # A bone without length points down: its direction shows nowhere.
    directions = np.where(lengths[..., None] > 1e-9, bones, (0.0, -1.0, 0.0))
    return Body(positions[:, 0].copy(), _unit(directions), lengths)


def put_together(body: Body) -> FloatArray:
    """Canonical positions (T, 20, 3) m."""
    bones = body.directions * body.lengths[..., None]
    positions = np.empty((len(body.root), len(_PARENTS) + 1, 3))
    positions[:, 0] = body.root
    for bone, parent in enumerate(_PARENTS):
        positions[:, bone + 1] = positions[:, parent] + bones[:, bone]
    return positions


def prepare_take(motion: CanonicalMotion) -> Take:
    """Take a motion apart and find its heading."""
    positions = np.asarray(motion.positions, dtype=np.float64)
    heading = find_heading(positions, motion.frame_rate)
    return Take(take_apart(positions), measure_segments(positions), heading, motion.frame_rate)


def find_heading(positions: FloatArray, frame_rate: float) -> FloatArray:
    """Heading (T,) rad of canonical positions (T, 20, 3), unwrapped: hips and shoulders, smoothed over 0.3 s."""
    joint = JOINT_INDEX
    across = (positions[:, joint["left_hip"]] - positions[:, joint["right_hip"]]) + (
        positions[:, joint["left_shoulder"]] - positions[:, joint["right_shoulder"]]
    )
    horizontal = smooth(np.stack([across[:, 2], across[:, 0]], axis=1), _HEADING_S * frame_rate)
    heading: FloatArray = np.unwrap(np.arctan2(horizontal[:, 1], horizontal[:, 0]) - 0.5 * np.pi)
    return heading


def sample_body(body: Body, frames: FloatArray) -> Body:
    """The body at fractional frames (N,), held at its ends; directions stay unit vectors."""
    low, share = _neighbours(frames, len(body.root))
    high = np.minimum(low + 1, len(body.root) - 1)

    def mix(values: FloatArray) -> FloatArray:
        part = share.reshape(-1, *(1,) * (values.ndim - 1))
        return (1.0 - part) * values[low] + part * values[high]

    return Body(mix(body.root), _unit(mix(body.directions)), mix(body.lengths))


def _neighbours(frames: FloatArray, n_frames: int) -> tuple[IndexArray, FloatArray]:
    inside = np.clip(frames, 0.0, n_frames - 1.0)
    low = inside.astype(np.intp)
    return low, inside - low


def _unit(vectors: FloatArray) -> FloatArray:
    norms = np.linalg.norm(vectors, axis=-1, keepdims=True)
    unit: FloatArray = vectors / np.maximum(norms, 1e-12)
    return unit


def slerp(start: FloatArray, end: FloatArray, share: FloatArray) -> FloatArray:
    """Unit vectors on the great circle from ``start`` to ``end`` (..., 3); ``share`` broadcasts to (..., 1)."""
    cosine = np.clip((start * end).sum(axis=-1, keepdims=True), -1.0, 1.0)
    across = end - cosine * start
    norms = np.linalg.norm(across, axis=-1, keepdims=True)
    # Opposite or equal vectors have no circle of their own: any one will do.
    spare = np.where(np.abs(start[..., :1]) < 0.9, (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    spare = spare - (spare * start).sum(axis=-1, keepdims=True) * start
    across = np.where(norms > 1e-9, across, spare)
    angle = np.arccos(cosine) * share
    between: FloatArray = np.cos(angle) * start + np.sin(angle) * _unit(across)
    return between


def turn(vectors: FloatArray, angle: FloatArray) -> FloatArray:
    """Turn vectors (T, ..., 3) about the vertical by ``angle`` (T,) or () rad."""
    angle = np.asarray(angle)
    angle = angle.reshape(*angle.shape, *(1,) * (vectors.ndim - 1 - angle.ndim))
    cosine, sine = np.cos(angle), np.sin(angle)
    x, y, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    return np.stack([cosine * x + sine * z, np.broadcast_to(y, x.shape), cosine * z - sine * x], axis=-1)


def turn_onto(segments: FloatArray, target: FloatArray) -> FloatArray:
    """Turn each posture (T, 9, 3) about the vertical so that it agrees best with ``target`` (eq. 5-7)."""
    return rotate_yaw(segments, estimate_yaw(target, segments))


def measure_segments(positions: FloatArray) -> FloatArray:
    """`compute_segments`, with segments of no length pointing down."""
    segments = compute_segments(positions)
    return np.where(np.isnan(segments), (0.0, -1.0, 0.0), segments)


def rotate(vectors: FloatArray, axis: FloatArray, angle: FloatArray) -> FloatArray:
    """Rotate vectors (T, K, 3) about a unit axis (3,) by ``angle`` (T,) rad (Rodrigues)."""
    angle = angle[:, None, None]
    along = (vectors @ axis)[..., None] * axis
    return vectors * np.cos(angle) + np.cross(axis, vectors) * np.sin(angle) + along * (1.0 - np.cos(angle))


def measure_angles(a: FloatArray, b: FloatArray) -> FloatArray:
    """Angles in degrees between unit vectors (..., 3)."""
    # The chord is exact for small angles, where the cosine is not.
    chord = np.linalg.norm(a - b, axis=-1)
    angles: FloatArray = np.degrees(2.0 * np.arcsin(np.clip(0.5 * chord, 0.0, 1.0)))
    return angles


def smooth(values: FloatArray, sigma: float) -> FloatArray:
    """Gaussian smoothing over axis 0, ``sigma`` in frames; ends are mirrored."""
    reach = min(int(4.0 * sigma) + 1, len(values) - 1)
    if sigma <= 0.0 or reach < 1:
        return values
    offsets = np.arange(-reach, reach + 1)
    kernel = np.exp(-0.5 * (offsets / sigma) ** 2)
    kernel /= kernel.sum()
    padded = np.concatenate([values[reach:0:-1], values, values[-2 : -reach - 2 : -1]])
    columns = padded.reshape(len(padded), -1)
    smoothed = np.stack([np.convolve(column, kernel, mode="valid") for column in columns.T], axis=1)
    return smoothed.reshape(values.shape)


def smooth_noise(
    n_frames: int, shape: tuple[int, ...], correlation_frames: float, rng: np.random.Generator
) -> FloatArray:
    """Gaussian noise (n_frames, *shape) of variance 1 whose autocorrelation falls to 1/e in the given time."""
    sigma = max(0.5 * correlation_frames, 1e-3)  # of the kernel; autocorrelation exp(-t^2 / 4 sigma^2)
    length = n_frames + int(8.0 * sigma) + 2
    white = rng.standard_normal((length, *shape))
    response = np.exp(-0.5 * (2.0 * np.pi * np.fft.rfftfreq(length) * sigma) ** 2)
    mirrored = response[1 : (length + 1) // 2]
    power = (response @ response + mirrored @ mirrored) / length
    spectrum = np.fft.rfft(white, axis=0) * response.reshape(-1, *(1,) * len(shape))
    noise: FloatArray = np.fft.irfft(spectrum, n=length, axis=0)[:n_frames] / np.sqrt(power)
    return noise


# Edits

VARIANTS: dict[str, tuple[str, ...]] = {
    "shift": ("late", "early"),
    "incomplete": ("stops short", "limb shrunk", "body shrunk"),
    "partial": ("limb from elsewhere", "limb held", "limb rotated", "limb mirrored"),
    "global": ("section from elsewhere",),
}
"""What each class of error can look like."""

_ALL = tuple(range(len(SEGMENTS)))
_STEEPEST = 0.85  # of real time: the most that a shift gains or loses, so that time never runs backwards
_FLAT_SHARE = 0.15  # of a shift's window has the full lag at least
_LAGS_S = (0.12, 0.5)
_GAINS = (0.3, 0.7)  # what is left of the range of a shrunk motion
_REACHES = (0.4, 0.75)  # of the way to the turning point
_RETRACES = 0.6  # out and back differ by no more than this share of the way out
_MOST_TURN = np.radians(30.0)
_SLOW = 0.5  # of the fastest in the window: the speed at a turning point
_ANGLES = (35.0, 80.0)  # degrees
_ELSEWHERE_S = 1.0  # a section nearer than this would be a shift


@dataclass(frozen=True, slots=True, eq=False)
class Window:
    """Frames ``start`` to ``stop`` (exclusive) of a take, and how the error fades in and out.

    Parameters
    ----------
    start, stop : frames.
    ramp : frames of each fade.
    """

    start: int
    stop: int
    ramp: float

    @property
    def n_frames(self) -> int:
        """Length."""
        return self.stop - self.start

    @property
    def weight(self) -> FloatArray:
        """(n,) 0 outside to 1 inside, raised cosines."""
        frame = np.arange(self.n_frames)
        edge = np.minimum(frame, self.n_frames - 1 - frame) / self.ramp
        return 0.5 - 0.5 * np.cos(np.pi * np.clip(edge, 0.0, 1.0))


@dataclass(frozen=True, slots=True, eq=False)
class Edit:
    """The wrong motion of a window.

    Parameters
    ----------
    body : (n, ...), world.
    weight : (n,) 0 to 1, how much of the error is there.
    segments : indices of those that are meant to be wrong.
    lag_s : of a shift.
    """

    body: Body
    weight: FloatArray
    segments: tuple[int, ...]
    lag_s: float | None = None


class Sources:
    """Where wrong motion is taken from: other sections of the take, other motions."""

    def __init__(self, take: Take, donors: Sequence[CanonicalMotion]) -> None:
        self.take, self.donors = take, donors
        self._prepared: dict[int, Take] = {}

    def draw(self, window: Window, rng: np.random.Generator) -> tuple[Body, FloatArray] | None:
        """A section as long as the window with its headings (n,); None if there is none."""
        duration = window.n_frames / self.take.frame_rate
        own = self.take.n_frames / self.take.frame_rate > 2.0 * (duration + _ELSEWHERE_S)
        if own and (not self.donors or rng.random() < 0.6):
            source = self.take
        elif self.donors:
            source = self._donor(int(rng.integers(len(self.donors))))
        else:
            return None
        frames = np.arange(window.n_frames) * (source.frame_rate / self.take.frame_rate)
        room = source.n_frames - 1 - frames[-1]
        if room < 0:
            return None
        first = rng.uniform(0.0, room)
        if source is self.take and abs(first - window.start) < _ELSEWHERE_S * source.frame_rate:
            return None
        headings = np.interp(first + frames, np.arange(source.n_frames), source.heading)
        return sample_body(source.body, first + frames), headings

    def _donor(self, number: int) -> Take:
        if number not in self._prepared:
            self._prepared[number] = prepare_take(self.donors[number])
        return self._prepared[number]


def make_edit(
    kind: str,
    variant: str,
    sources: Sources,
    window: Window,
    rng: np.random.Generator,
    size: float | None,
) -> Edit | None:
    """The wrong motion of one variant in a window; None where the motion there does not allow it.

    ``size`` is the lag in ms of a shift, the missing share of an incomplete motion, the angle in degrees of a
    limb that is rotated; drawn if None.
    """
    if kind == "shift":
        return _shift(variant, sources.take, window, rng, size)
    if kind == "global":
        return _replace_body(sources, window, rng)
    return _MAKERS[variant](sources, window, rng, size)


def _ease(share: FloatArray) -> FloatArray:
    return 0.5 - 0.5 * np.cos(np.pi * np.clip(share, 0.0, 1.0))


def _keep_floor(clean: Body, body: Body) -> Body:
    """Raise or lower the body so that its lowest joint is as high as before."""
    lowest = put_together(clean)[..., 1].min(axis=1) - put_together(body)[..., 1].min(axis=1)
    root = body.root.copy()
    root[:, 1] += lowest
    return Body(root, body.directions, body.lengths)


def _with_directions(take: Take, window: Window, directions: FloatArray) -> Body:
    clean = take.body.cut(window.start, window.stop)
    return _keep_floor(clean, Body(clean.root, directions, clean.lengths))


def _free_directions(take: Take, window: Window) -> tuple[FloatArray, FloatArray]:
    """Heading-free directions (n, 19, 3) of the window and its headings (n,)."""
    heading = take.heading[window.start : window.stop]
    return turn(take.body.directions[window.start : window.stop], -heading), heading


# Shift


def _shift(variant: str, take: Take, window: Window, rng: np.random.Generator, size: float | None) -> Edit | None:
    """Time runs slower, then faster (late), or the other way round (early), with a flat top of full lag."""
    n, rate = window.n_frames, take.frame_rate
    widest = 0.5 * (1.0 - _FLAT_SHARE) * n
    longest_s = widest / rate * _STEEPEST / (0.5 * np.pi)
    if longest_s < (_LAGS_S[0] if size is None else size / 1000.0):
        return None
    lag_s = size / 1000.0 if size is not None else rng.uniform(_LAGS_S[0], min(_LAGS_S[1], longest_s))
    # A large lag needs a long ramp: time must not run backwards.
    shortest = lag_s * rate * 0.5 * np.pi / _STEEPEST
    weight = Window(window.start, window.stop, rng.uniform(shortest, widest)).weight
    lag_s = -lag_s if variant == "early" else lag_s
    body = sample_body(take.body, np.arange(window.start, window.stop) - lag_s * rate * weight)
    return Edit(body, weight, _ALL, lag_s)


# Incomplete


def _stop_short(sources: Sources, window: Window, rng: np.random.Generator, size: float | None) -> Edit | None:
    """Only part of the way to a turning point, then back along the way that leads away from it."""
    take, n = sources.take, window.n_frames
    segments = take.segments[window.start : window.stop]
    peak = _find_turning_point(segments, take.frame_rate)
    # Who turns less far faces elsewhere, which is no loss of range.
    if peak is None or np.ptp(take.heading[window.start : window.stop]) > _MOST_TURN:
        return None
    steps = np.radians(measure_angles(segments[1:], segments[:-1])).sum(axis=1)
    way = np.concatenate([[0.0], np.cumsum(steps)])
    reach = 1.0 - size if size is not None else rng.uniform(*_REACHES)
    share = 1.0 - (1.0 - reach) * window.weight
    frames = np.arange(n)
    # Out: the pose at a share of the way from the start. Back: at that share of the way from the end.
    out = np.interp(share * np.minimum(way, way[peak]), way[: peak + 1], frames[: peak + 1])
    back = np.interp(way[-1] - share * np.minimum(way[-1] - way, way[-1] - way[peak]), way[peak:], frames[peak:])
    apart = measure_angles(segments[int(out[peak])], segments[int(back[peak])]).mean()
    deep = measure_angles(segments[peak], segments[0]).mean()
    if apart > _RETRACES * deep:
        return None
    there = sample_body(take.body, window.start + out)
    here = sample_body(take.body, window.start + back)
    turned = _ease(0.5 + (frames - peak) / max(0.5 * n, 1.0))
    body = Body(
        there.root + turned[:, None] * (here.root - there.root),
        slerp(there.directions, here.directions, turned[:, None, None]),
        there.lengths,
    )
    return Edit(body, window.weight, _ALL)


def _find_turning_point(segments: FloatArray, frame_rate: float) -> int | None:
    """Frame that is far from both ends of the window, at low speed; None if there is none."""
    far = [measure_angles(segments, segments[end]).mean(axis=1) for end in (0, -1)]
    peak = int(np.minimum(*far).argmax())
    if not 0.25 * len(segments) < peak < 0.75 * len(segments):
        return None
    speed = smooth(measure_angles(segments[1:], segments[:-1]).mean(axis=1), 0.03 * frame_rate)
    near = max(int(0.12 * frame_rate), 1)
    if speed[max(peak - near, 0) : peak + near].min() > _SLOW * speed.max():
        return None
    return peak


def _shrink_limb(sources: Sources, window: Window, rng: np.random.Generator, size: float | None) -> Edit | None:
    limb = str(rng.choice(tuple(LIMB_BONES)))
    return _shrink(sources.take, window, LIMB_BONES[limb], LIMBS[limb], _draw_gain(rng, size))


def _shrink_body(sources: Sources, window: Window, rng: np.random.Generator, size: float | None) -> Edit:
    everything = tuple(range(len(MIRRORED_JOINTS) - 1))
    return _shrink(sources.take, window, everything, _ALL, _draw_gain(rng, size))


def _draw_gain(rng: np.random.Generator, size: float | None) -> float:
    return 1.0 - size if size is not None else float(rng.uniform(*_GAINS))


def _shrink(take: Take, window: Window, bones: tuple[int, ...], segments: tuple[int, ...], gain: float) -> Edit:
    """Directions drawn toward their mean over the window, relative to where the body faces."""
    free, heading = _free_directions(take, window)
    mean = free[:, bones].mean(axis=0)
    mean /= np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-9)
    share = (1.0 - gain) * window.weight
    free[:, bones] = slerp(free[:, bones], np.broadcast_to(mean, free[:, bones].shape), share[:, None, None])
    return Edit(_with_directions(take, window, turn(free, heading)), window.weight, segments)


# Partial


def _draw_limbs(rng: np.random.Generator) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Bones and segments: an arm (often), a forearm, both arms, or a leg."""
    side = "left" if rng.random() < 0.5 else "right"
    draw = rng.random()
    if draw < 0.2:
        return find_bones(f"{side}_wrist", f"{side}_hand"), (SEGMENTS.index(f"{side}_forearm"),)
    if draw < 0.35:
        return LIMB_BONES["left_arm"] + LIMB_BONES["right_arm"], LIMBS["left_arm"] + LIMBS["right_arm"]
    limb = f"{side}_leg" if draw > 0.8 else f"{side}_arm"
    return LIMB_BONES[limb], LIMBS[limb]


def _replace_limb(
    sources: Sources,
    window: Window,
    chosen: tuple[tuple[int, ...], tuple[int, ...]],
    wrong: FloatArray,
) -> Edit:
    """Blend the chosen bones to the heading-free directions ``wrong`` (n, bones, 3)."""
    bones, segments = chosen
    free, heading = _free_directions(sources.take, window)
    free[:, bones] = slerp(free[:, bones], wrong, window.weight[:, None, None])
    body = _with_directions(sources.take, window, turn(free, heading))
    return Edit(body, window.weight, segments)


def _limb_from_elsewhere(sources: Sources, window: Window, rng: np.random.Generator, size: float | None) -> Edit | None:
    chosen, section = _draw_limbs(rng), sources.draw(window, rng)
    if section is None:
        return None
    body, headings = section
    return _replace_limb(sources, window, chosen, turn(body.directions, -headings)[:, chosen[0]])


def _limb_held(sources: Sources, window: Window, rng: np.random.Generator, size: float | None) -> Edit | None:
    """A pose of the limb from another moment, held."""
    chosen, section = _draw_limbs(rng), sources.draw(window, rng)
    if section is None:
        return None
    body, headings = section
    pose = turn(body.directions[:1], -headings[:1])[:, chosen[0]]
    return _replace_limb(sources, window, chosen, np.broadcast_to(pose, (window.n_frames, *pose.shape[1:])))


def _limb_rotated(sources: Sources, window: Window, rng: np.random.Generator, size: float | None) -> Edit:
    """The whole limb turned about its shoulder or hip: to the front, to the side, or between."""
    limb = str(rng.choice(tuple(LIMB_BONES), p=(0.35, 0.15, 0.35, 0.15)))
    degrees = size if size is not None else rng.uniform(*_ANGLES)
    angle = np.radians(degrees) * (1.0 if rng.random() < 0.5 else -1.0)
    tilt = rng.uniform(0.0, 2.0 * np.pi)
    axis = np.array([np.cos(tilt), 0.2 * rng.standard_normal(), np.sin(tilt)])
    bones = LIMB_BONES[limb]
    free, heading = _free_directions(sources.take, window)
    free[:, bones] = rotate(free[:, bones], axis / np.linalg.norm(axis), angle * window.weight)
    return Edit(_with_directions(sources.take, window, turn(free, heading)), window.weight, LIMBS[limb])


def _limb_mirrored(sources: Sources, window: Window, rng: np.random.Generator, size: float | None) -> Edit:
    """A limb does the mirror image of what the limb of the other side does: the wrong arm is raised."""
    limb = str(rng.choice(tuple(LIMB_BONES), p=(0.35, 0.15, 0.35, 0.15)))
    both = limb.removeprefix("left_").removeprefix("right_")
    names = (f"left_{both}", f"right_{both}") if rng.random() < 0.5 else (limb,)
    bones = tuple(bone for name in names for bone in LIMB_BONES[name])
    segments = tuple(segment for name in names for segment in LIMBS[name])
    free, _ = _free_directions(sources.take, window)
    opposite = [MIRRORED_JOINTS[bone + 1] - 1 for bone in bones]
    return _replace_limb(sources, window, (bones, segments), free[:, opposite] * (-1.0, 1.0, 1.0))


# Global


def _replace_body(sources: Sources, window: Window, rng: np.random.Generator) -> Edit | None:
    """The whole body does another section; it faces as the take does at both joints."""
    section = sources.draw(window, rng)
    if section is None:
        return None
    body, headings = section
    own = sources.take.heading[window.start : window.stop]
    ends = own[[0, -1]] - headings[[0, -1]]
    ends = np.unwrap(ends)
    turned = ends[0] + (ends[1] - ends[0]) * _ease(np.linspace(0.0, 1.0, window.n_frames))
    clean = sources.take.body.directions[window.start : window.stop]
    wrong = slerp(clean, turn(body.directions, turned), window.weight[:, None, None])
    return Edit(_with_directions(sources.take, window, wrong), window.weight, _ALL)


_Maker = Callable[[Sources, Window, np.random.Generator, float | None], Edit | None]

_MAKERS: dict[str, _Maker] = {
    "stops short": _stop_short,
    "limb shrunk": _shrink_limb,
    "body shrunk": _shrink_body,
    "limb from elsewhere": _limb_from_elsewhere,
    "limb held": _limb_held,
    "limb rotated": _limb_rotated,
    "limb mirrored": _limb_mirrored,
}
