"""The channels of the ``extended`` features: numbers that describe the body in every frame at 30 Hz.

Examples are the place of a joint, a distance, a speed, the turning of a hand. None depends on the performer's place,
heading or height, so windows of a recording share its channels. ``feature_sets`` lists the tests of them.

The body-fixed system is that of ``pose_features``, but its lateral axis is smoothed over time against noise of the
hips.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from dousa.arrays import BoolArray, FloatArray, IntArray, read_only
from dousa.motion.canonical.joints import CANONICAL_JOINTS, JOINT_INDEX, MIRRORED_JOINTS
from dousa.retrieval.features import channel_kernels as kernels
from dousa.retrieval.features.pose_features import HIPS, SHOULDERS, say_joint
from dousa.retrieval.features.posed_motion import check_frame_rate

CHANNEL_RATE = 30.0
"""Hz of all channels (docs/retrieval.md)."""

# Frames, standard deviation: without it speeds and turns of Kinect recordings drown in noise.
_POSE_SMOOTHING, _HEADING_SMOOTHING = 1.0, 8.0

AT_REST = 0.5
"""Body heights a second by which standing still counts in motion time; in walking all speeds sum to about 5
(docs/retrieval.md)."""


@dataclass(frozen=True, slots=True)
class Channel:
    """One channel.

    Parameters
    ----------
    name : in words.
    relation : the words without the direction, the same for all directions of one quantity.
    unit : of its values.
    joints : canonical joints that it needs, beside those that give the body's place and heading.
    """

    name: str
    relation: str
    unit: str
    joints: tuple[str, ...] = ()


_PLACED = (
    "head",
    "neck",
    *(f"{side}_{joint}" for joint in ("shoulder", "elbow", "hand", "knee", "ankle") for side in ("left", "right")),
)
_APART = (
    ("left_hand", "right_hand"),
    ("left_hand", "head"),
    ("right_hand", "head"),
    ("left_hand", "left_shoulder"),
    ("right_hand", "right_shoulder"),
    ("left_hand", "right_shoulder"),
    ("right_hand", "left_shoulder"),
    ("left_ankle", "right_ankle"),
    ("left_hip", "left_ankle"),
    ("right_hip", "right_ankle"),
    ("left_elbow", "right_elbow"),
)
_FAST = ("head", "left_elbow", "right_elbow", "left_hand", "right_hand", "left_ankle", "right_ankle")
_POINTING = ("left_hand", "right_hand")
_FOOT_JOINTS = ("left_ankle", "right_ankle")
_PLANE_WORDS = ("seen from the front", "seen from the side", "seen from above")
_DIRECTIONS = ("to the left of", "above", "in front of")
_WAYS = ("to the left", "upwards", "forwards")


def _list_channels() -> tuple[Channel, ...]:
    heights, speed, turn = "body heights", "body heights a second", "radians a second"

    def undirected(name: str, unit: str, *joints: str) -> Channel:
        return Channel(name, name, unit, joints)

    return (
        *(
            Channel(f"{say_joint(joint)} {where} the pelvis", f"{say_joint(joint)} and pelvis", heights, (joint,))
            for joint, where in product(_PLACED, _DIRECTIONS)
        ),
        *(undirected(f"distance {say_joint(a)} - {say_joint(b)}", heights, a, b) for a, b in _APART),
        undirected("pelvis above the lower foot", heights, *_FOOT_JOINTS),
        *(Channel(f"body moving {way}", "body moving", speed) for way in _WAYS),
        Channel("body turning to the left", "body turning", turn),
        *(undirected(f"speed of the {say_joint(joint)}", speed, joint) for joint in _FAST),
        *(
            Channel(f"{say_joint(joint)} curving, {plane}", f"{say_joint(joint)} curving", turn, (joint,))
            for joint, plane in product(_FAST, _PLANE_WORDS)
        ),
        *(
            Channel(f"{say_joint(joint)} heading {way}", f"{say_joint(joint)} heading", "share of its speed", (joint,))
            for joint, way in product(_POINTING, _WAYS)
        ),
    )


CHANNELS: tuple[Channel, ...] = _list_channels()
"""The channels in their order."""


def _list_mirrored() -> tuple[IntArray, FloatArray]:
    other = {CANONICAL_JOINTS[k]: CANONICAL_JOINTS[mirrored] for k, mirrored in enumerate(MIRRORED_JOINTS)}
    kinds: list[tuple[str, frozenset[str], int, bool]] = [
        *(("placed", frozenset((joint,)), k, k == 0) for joint, k in product(_PLACED, range(3))),
        *(("apart", frozenset(pair), 0, False) for pair in _APART),
        ("above", frozenset(), 0, False),
        *(("moving", frozenset(), k, k == 0) for k in range(3)),
        ("turning", frozenset(), 0, True),
        *(("fast", frozenset((joint,)), 0, False) for joint in _FAST),
        *(("curving", frozenset((joint,)), k, k != 1) for joint, k in product(_FAST, range(3))),
        *(("heading", frozenset((joint,)), k, k == 0) for joint, k in product(_POINTING, range(3))),
    ]
    places = {kind[:3]: number for number, kind in enumerate(kinds)}
    order = [places[kind, frozenset(other[joint] for joint in joints), k] for kind, joints, k, _ in kinds]
    return np.array(order, np.intp), np.array([-1.0 if turned else 1.0 for *_, turned in kinds])


MIRRORED_CHANNELS: tuple[IntArray, FloatArray] = _list_mirrored()
"""(C,) each: the channel in the mirror image that corresponds to each channel, and its sign there."""

_PLACED_INDEX = np.array([JOINT_INDEX[joint] for joint in _PLACED])
_APART_INDEX = np.array([[JOINT_INDEX[joint] for joint in pair] for pair in _APART])
_FAST_INDEX = np.array([JOINT_INDEX[joint] for joint in _FAST])
_POINTING_INDEX = np.array([JOINT_INDEX[joint] for joint in _POINTING])
_FEET = np.array([JOINT_INDEX[joint] for joint in _FOOT_JOINTS])
_FIRST_SPEED = [channel.name for channel in CHANNELS].index("speed of the head")


def sample_positions(positions: FloatArray, frame_rate: float) -> FloatArray:
    """Resample positions to ``CHANNEL_RATE``: means over frames of faster recordings, interpolation in slower ones.

    Parameters
    ----------
    positions : (n, J, 3).
    frame_rate : Hz.

    Returns (m, J, 3), m = the duration times ``CHANNEL_RATE``, rounded, at least 1. Raises InvalidMotionError: a frame
    rate below 1 Hz.
    """
    check_frame_rate(frame_rate)
    count = count_samples(len(positions), frame_rate)
    if count == len(positions):
        return np.asarray(positions, np.float64)
    flat = np.asarray(positions, np.float64).reshape(len(positions), -1)
    if count < len(positions):
        edges = np.linspace(0.0, len(flat), count + 1)
        summed = np.zeros((len(flat) + 1, flat.shape[1]))
        np.cumsum(flat, axis=0, out=summed[1:])
        sampled = np.diff(read_between(summed, edges), axis=0) * (count / len(flat))
    else:
        sampled = read_between(flat, np.clip((np.arange(count) + 0.5) * len(flat) / count - 0.5, 0, len(flat) - 1))
    return sampled.reshape(count, *positions.shape[1:])


def count_samples(n_frames: int, frame_rate: float) -> int:
    """Return the number of frames that ``sample_positions`` makes of ``n_frames``."""
    return max(1, round(n_frames * CHANNEL_RATE / frame_rate))


def read_between(rows: FloatArray, places: FloatArray) -> FloatArray:
    """Return rows (n, K) at fractional places (m,), interpolated linearly."""
    below = np.minimum(places.astype(np.intp), max(len(rows) - 2, 0))
    share = (places - below)[:, None]
    read: FloatArray = rows[below] * (1.0 - share) + rows[np.minimum(below + 1, len(rows) - 1)] * share
    return read


def compute_channels(positions: FloatArray, height: float) -> FloatArray:
    """Compute the channels (n, C) of every frame, in the order of ``CHANNELS``.

    ``positions`` are (n, 20, 3) m, canonical joints at ``CHANNEL_RATE``, Y up, finite; ``height`` is in m.
    """
    rows = np.empty((len(positions), len(CHANNELS)))
    _describe_frames(positions, height, _Room(len(positions)), rows)
    return rows


class _Room:
    """Working memory for the channels of up to n frames."""

    def __init__(self, n: int) -> None:
        self.points, self.lefts = np.empty((3, n, len(CANONICAL_JOINTS), 3)), np.empty((2, n, 2))
        self.headings, self.angles = np.empty(n), np.empty((2, n, 3 * len(_FAST)))


def _describe_frames(positions: FloatArray, height: float, room: _Room, rows: FloatArray) -> None:
    kernels.describe_frames(
        read_only(np.ascontiguousarray(positions, np.float64)), float(height), _POSE_WEIGHTS, _HEADING_WEIGHTS,
        HIPS, SHOULDERS, _FAST_INDEX, _PLACED_INDEX, _APART_INDEX, _FEET, _POINTING_INDEX, CHANNEL_RATE,
        room.points, room.lefts, room.headings, room.angles, rows,
    )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class WantedMeans:
    """Means over ``n_cells`` cells of equal motion time, of channels ``columns`` (K,) times ``scale`` (K,)."""

    n_cells: int
    columns: IntArray
    scale: FloatArray


def describe_clips(
    clips: Sequence[FloatArray], heights: FloatArray, answered: BoolArray, n_cells: int, wanted: WantedMeans
) -> tuple[FloatArray, FloatArray]:
    """Compute means, duration, means of squares and of values times time in the cells of clips.

    Parameters
    ----------
    clips : N times (n, 20, 3) m, each as for ``compute_channels``; at least one.
    heights : (N,) m.
    answered : (C,) whether a channel counts; the others are 0.
    n_cells : T, of equal motion time.
    wanted : further means.

    Returns
    -------
    cells : (N, T, 3 C + 1).
    means : (N, cells, K) of ``wanted``.
    """
    n, n_channels = max(map(len, clips)), len(CHANNELS)
    room, rows, integrals = _Room(n), np.empty((n, n_channels)), np.zeros((n + 1, 3 * n_channels))
    times, work, edges = np.zeros(n + 1), np.empty((2, integrals.shape[1])), np.empty((1, n_cells + 1))
    parts, mean_parts = np.linspace(0.0, 1.0, n_cells + 1), np.linspace(0.0, 1.0, wanted.n_cells + 1)
    mean_edges, start, silent = np.empty((1, wanted.n_cells + 1)), np.zeros(1), ~answered
    cells = np.empty((len(clips), n_cells, integrals.shape[1] + 1))
    means = np.empty((len(clips), wanted.n_cells, len(wanted.columns)))
    for k, positions in enumerate(clips):
        own, own_times, own_integrals = (
            rows[: len(positions)],
            times[: len(positions) + 1],
            integrals[: len(positions) + 1],
        )
        _describe_frames(positions, heights[k], room, own)
        own[:, silent] = 0.0
        kernels.integrate_rows(own, _FIRST_SPEED, len(_FAST), AT_REST, 1.0 / CHANNEL_RATE, own_times, own_integrals)
        stop = np.array([float(len(positions))])
        kernels.find_edges(own_times, start, stop, parts, edges)
        cells[k, :, n_channels] = len(positions) / CHANNEL_RATE
        kernels.read_cells(own_integrals, own_times, edges, n_channels, work, cells[k : k + 1])
        if len(wanted.columns):
            kernels.find_edges(own_times, start, stop, mean_parts, mean_edges)
            kernels.read_means(own_integrals, own_times, mean_edges, wanted.columns, wanted.scale, means[k : k + 1])
    return cells, means


def integrate_channels(rows: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Compute motion time, and the integrals over it of the channels (n, C) of ``compute_channels``.

    Returns
    -------
    times : (n + 1,) from 0. A second adds the sum of the speeds of head, elbows, hands and feet, in body heights a
        second, and ``AT_REST``.
    integrals : (n + 1, 3 C) of the values, of their squares, and of the values times the time.
    """
    times, integrals = np.zeros(len(rows) + 1), np.zeros((len(rows) + 1, 3 * rows.shape[1]))
    kernels.integrate_rows(rows, _FIRST_SPEED, len(_FAST), AT_REST, 1.0 / CHANNEL_RATE, times, integrals)
    return times, integrals


def smooth_positions(positions: FloatArray, deviation: float) -> FloatArray:
    """Smooth positions (n, J, 3) over time with a Gaussian of a standard deviation in frames; ends are held."""
    values, weights = np.asarray(positions, np.float64), gaussian_weights(deviation)
    n, reach = len(values), len(weights) - 1
    held = np.concatenate([np.repeat(values[:1], reach, 0), values, np.repeat(values[-1:], reach, 0)])
    even: FloatArray = weights[0] * values
    for step in range(1, reach + 1):
        even += weights[step] * (held[reach - step : reach - step + n] + held[reach + step : reach + step + n])
    return even


def gaussian_weights(deviation: float, reach: float = 3.0) -> FloatArray:
    """Return weights of the middle and of the frames up to ``reach`` standard deviations away; these in frames."""
    weights = np.exp(-0.5 * (np.arange(int(reach * deviation + 0.5) + 1) / deviation) ** 2)
    shares: FloatArray = weights / (2.0 * weights.sum() - weights[0])
    return shares


_POSE_WEIGHTS, _HEADING_WEIGHTS = gaussian_weights(_POSE_SMOOTHING), gaussian_weights(_HEADING_SMOOTHING)
