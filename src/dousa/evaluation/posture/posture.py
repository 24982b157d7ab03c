"""Posture: a frame as the directions of nine body segments, and the weights of these segments.

Source: Yamane and Shakunaga, eq. 1 and 2. Place and bone lengths drop out; the axes stay those of the world (Y up), so
that only the rotation about the vertical is left to normalise.

A file of weights is TOML or plain lines ``segment = number``; a segment that is not named weighs 1:

    arms = 2            # arms are what this dance is about
    left_forearm = 1.5  # the more exact name counts
    legs = 0            # not judged
"""

from __future__ import annotations

import os
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dousa.arrays import FloatArray, iterate_blocks
from dousa.errors import InvalidMotionError, MotionFileError, OptionError
from dousa.evaluation.words import SEGMENT_NAMES
from dousa.files.disk import read_small_text
from dousa.messages import Message
from dousa.motion.canonical.canonicalise import CanonicalMotion, check_positions
from dousa.motion.canonical.joints import CANONICAL_JOINTS, MIRRORED_JOINTS
from dousa.motion.canonical.joints import JOINT_INDEX as J
from dousa.motion.resampling import fill_gaps, find_neighbours

SEGMENT_JOINTS: tuple[tuple[str, str], ...] = (
    ("pelvis", "neck"),
    ("left_shoulder", "left_elbow"),
    ("left_elbow", "left_wrist"),
    ("right_shoulder", "right_elbow"),
    ("right_elbow", "right_wrist"),
    ("left_hip", "left_knee"),
    ("left_knee", "left_ankle"),
    ("right_hip", "right_knee"),
    ("right_knee", "right_ankle"),
)
"""Start and end of each segment as canonical joints. The trunk is drawn from the pelvis but measured from the
middle of the hips: the pelvis sits up to 10 cm higher in one kind of file than in another."""

SEGMENTS: tuple[str, ...] = tuple(SEGMENT_NAMES)

MIRRORED_SEGMENTS: tuple[int, ...] = (0, 3, 4, 1, 2, 7, 8, 5, 6)
"""Index of each segment's mirror image, by definition of `SEGMENTS`."""

LIMBS: dict[str, tuple[int, ...]] = {
    "trunk": (0,),
    "left_arm": (1, 2),
    "right_arm": (3, 4),
    "left_leg": (5, 6),
    "right_leg": (7, 8),
}
"""Segments of each limb, by definition of `SEGMENTS`."""

_STARTS = [J[start] for start, _ in SEGMENT_JOINTS]
_ENDS = [J[end] for _, end in SEGMENT_JOINTS]
_JOINTS_OF = np.zeros((len(SEGMENTS), len(CANONICAL_JOINTS)), bool)  # what each segment is measured from
_JOINTS_OF[range(len(SEGMENTS)), _STARTS] = True
_JOINTS_OF[range(len(SEGMENTS)), _ENDS] = True
_JOINTS_OF[0] = [name in ("left_hip", "right_hip", "neck") for name in CANONICAL_JOINTS]

# A segment that is never seen is by definition drawn hanging, the trunk upright.
REST = np.tile([0.0, -1.0, 0.0], (len(SEGMENTS), 1))
REST[0, 1] = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class PostureSequence:
    """A motion as the directions of nine body segments.

    Parameters
    ----------
    segments : (T, 9, 3) unit vectors, Y up, order of `SEGMENTS`; a segment that is not seen is filled from its
        neighbours in time.
    seen : (T, 9) False where the recording has a gap: such values are drawn, never judged.
    positions : (T, 20, 3) m, canonical joints, for pictures.
    frame_rate : Hz.
    name : of the recording.
    """

    segments: FloatArray
    seen: NDArray[np.bool_]
    positions: FloatArray
    frame_rate: float
    name: str = ""

    @property
    def n_frames(self) -> int:
        """Number of poses."""
        return len(self.segments)

    @property
    def duration(self) -> float:
        """Seconds."""
        return self.n_frames / self.frame_rate


def check_segments(values: ArrayLike, what: str) -> FloatArray:
    """Check postures (..., 9, 3) to be finite numbers; ``what`` names the argument in the error.

    Raises
    ------
    InvalidMotionError : another shape, no numbers, or values that are missing.
    """
    try:
        array = np.asarray(values, np.float64)
    except (TypeError, ValueError) as error:
        raise InvalidMotionError("postures.not_numbers", what=what, reason=error) from error
    if array.ndim < 2 or array.shape[-2:] != (len(SEGMENTS), 3):
        raise InvalidMotionError("postures.shape", what=what, shape=array.shape)
    if not np.isfinite(array.sum()):
        raise InvalidMotionError("postures.not_finite", what=what)
    return array


def find_lacking(sequences: Iterable[PostureSequence]) -> NDArray[np.bool_]:
    """(9,) segments that one of some motions never shows, as its body lacks joints or they were never seen."""
    lacking: NDArray[np.bool_] = np.any([~one.seen.any(axis=0) for one in sequences], axis=0)
    return lacking


def check_weights(weights: ArrayLike | None) -> FloatArray:
    """Check weights (9,) or (..., 9) of the segments, 0 or above and not all 0 in any row; equal ones for None.

    Raises
    ------
    OptionError : another shape, or values that are negative, missing or all 0.
    """
    if weights is None:
        return np.ones(len(SEGMENTS))
    array = np.asarray(weights, np.float64)
    if array.ndim < 1 or array.shape[-1] != len(SEGMENTS):
        raise OptionError("postures.weights_shape", shape=array.shape)
    if not (np.isfinite(array.sum()) and (array >= 0).all() and (array.sum(axis=-1) > 0).all()):
        raise OptionError("postures.weights")
    return array


def compute_segments(positions: ArrayLike, *, shortest: float = 1e-6) -> FloatArray:
    """Compute the directions of the nine segments of poses (..., 20, 3) m, canonical joints, Y up.

    Returns (..., 9, 3) unit vectors, order of `SEGMENTS`; NaN where a joint is missing or both ends coincide, or a
    segment is shorter than ``shortest`` m. Raises InvalidMotionError for another shape.

    Source: Yamane and Shakunaga, eq. 1 and 2. The trunk goes from the middle of the hips to the neck.
    """
    points = np.asarray(positions, np.float64)
    if points.ndim < 2 or points.shape[-2:] != (len(CANONICAL_JOINTS), 3):
        raise InvalidMotionError("postures.joints_shape", shape=points.shape)
    hips = 0.5 * (points[..., J["left_hip"], :] + points[..., J["right_hip"], :])
    vectors = points[..., _ENDS, :] - points[..., _STARTS, :]
    vectors[..., 0, :] = points[..., J["neck"], :] - hips
    lengths = np.sqrt(np.einsum("...k,...k->...", vectors, vectors))
    lengths[~(lengths > shortest)] = np.nan
    return cast(FloatArray, vectors / lengths[..., None])


def compute_postures(motion: CanonicalMotion, frame_rate: float | None = None, name: str = "") -> PostureSequence:
    """Compute the postures of a motion, at its own or another frame rate.

    The first frame stays at 0 s; the new frames go on as long as the old ones do. Positions are interpolated
    linearly. What is not seen is filled from the neighbours in time, and marked.

    Parameters
    ----------
    motion : canonical joints; where its ``missing`` is True, the segments that end there are not seen.
    frame_rate : Hz; None keeps the motion's.
    name : of the recording.

    Returns
    -------
    The postures, arrays read-only.

    Raises
    ------
    InvalidMotionError : no frame, another shape, or infinite positions.
    OptionError : a frame rate that is not above 0 or makes too many frames.
    """
    positions, seen = _read(motion)
    rate = motion.frame_rate
    if frame_rate is not None and frame_rate != rate:
        before, after, fraction = find_neighbours(len(positions), rate, float(frame_rate))
        share = fraction[:, None, None]
        positions = positions[before] * (1.0 - share) + positions[after] * share
        seen = seen[before] & (seen[after] | (fraction == 0.0)[:, None])
        rate = float(frame_rate)
    segments = np.empty((len(positions), len(SEGMENTS), 3))
    for some in iterate_blocks(len(positions)):
        segments[some] = compute_segments(positions[some])
        seen[some] &= ~np.isnan(segments[some]).any(axis=2)
    _fill(segments, seen)
    for array in (segments, seen, positions):
        array.flags.writeable = False
    return PostureSequence(segments, seen, positions, rate, name)


def _read(motion: CanonicalMotion) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Positions without gaps, as far as a joint is ever seen, and (T, 9) what is seen of the segments."""
    positions = check_positions(motion.positions)
    if positions.flags.writeable:
        positions = positions.copy()
    lost = cast(NDArray[np.bool_], np.isnan(positions).any(axis=2))
    if lost.any():
        positions = fill_gaps(positions)
    missing = motion.missing
    if missing is not None:
        if np.shape(missing) != lost.shape:
            raise InvalidMotionError("postures.missing_shape", expected=lost.shape, shape=np.shape(missing))
        lost |= np.asarray(missing, bool)
    lost_ends = cast(NDArray[np.bool_], (lost[:, None, :] & _JOINTS_OF).any(axis=2))
    return positions, ~lost_ends


def _fill(segments: FloatArray, seen: NDArray[np.bool_]) -> None:
    """Put directions where none was seen: between the neighbours in time, in place."""
    frames = np.arange(len(segments))
    for number in np.flatnonzero(~seen.all(axis=0)):
        known = frames[seen[:, number]]
        lost = frames[~seen[:, number]]
        if len(known) == 0:
            segments[:, number] = REST[number]
            continue
        for axis in range(3):
            segments[lost, number, axis] = np.interp(lost, known, segments[known, number, axis])
        lengths = np.linalg.norm(segments[lost, number], axis=1)
        # Halfway between opposite directions there is none: keep the earlier one.
        flat = lost[lengths < 0.01]
        segments[flat, number] = segments[known[np.searchsorted(known, flat) - 1], number]
        segments[lost, number] /= np.linalg.norm(segments[lost, number], axis=1, keepdims=True)


def mirror_postures(postures: PostureSequence) -> PostureSequence:
    """Mirror postures: x negated, left and right exchanged; arrays read-only."""
    flip = np.array([-1.0, 1.0, 1.0])
    arrays = (
        postures.segments[:, MIRRORED_SEGMENTS] * flip,
        postures.seen[:, MIRRORED_SEGMENTS],
        postures.positions[:, MIRRORED_JOINTS] * flip,
    )
    for array in arrays:
        array.flags.writeable = False
    return PostureSequence(*arrays, frame_rate=postures.frame_rate, name=postures.name)


WORKING_RATE = 30.0
"""Hz, see docs/evaluation.md; errors of a dance last half a second and more, so more frames only cost time."""


@dataclass(frozen=True, slots=True, eq=False)
class Working:
    """Postures at the working rate."""

    segments: FloatArray  # (T, 9, 3) unit vectors
    seen: NDArray[np.bool_]  # (T, 9)
    heading: FloatArray  # (T,) rad, unwrapped, of the line through hips and shoulders to the left
    frame_rate: float  # Hz
    stride: int  # frames of the full rate in one of these

    @property
    def n_frames(self) -> int:
        """Number of poses."""
        return len(self.segments)


def thin_postures(postures: PostureSequence, *, heading_s: float = 0.3) -> Working:
    """Average groups of frames to about `WORKING_RATE` a second; the frames of an incomplete group are dropped."""
    stride = max(1, round(postures.frame_rate / WORKING_RATE))
    stride = min(stride, postures.n_frames)
    count = postures.n_frames // stride
    groups = postures.segments[: count * stride].reshape(count, stride, 9, 3).mean(axis=1)
    length = np.linalg.norm(groups, axis=2, keepdims=True)
    groups = groups / np.maximum(length, 1e-9)
    seen: NDArray[np.bool_] = np.all(postures.seen[: count * stride].reshape(count, stride, 9), axis=1)
    rate = postures.frame_rate / stride
    heading = _measure_heading(postures.positions[: count * stride : stride], round(0.5 * heading_s * rate))
    return Working(groups, seen, heading, rate, stride)


def _measure_heading(positions: FloatArray, half: int) -> FloatArray:
    """(T,) rad about +Y, from +Z, of the way to the body's left, averaged over ``2 half + 1`` frames."""
    hips, shoulders = (
        positions[:, J[f"left_{joint}"]] - positions[:, J[f"right_{joint}"]] for joint in ("hip", "shoulder")
    )
    across = hips + shoulders
    if np.isnan(across).any():  # a body of which one of them is missing
        across = np.nan_to_num(hips) + np.nan_to_num(shoulders)
    front = across[:, 2] + 1j * across[:, 0]
    total = np.cumsum(np.pad(front, (half + 1, half), mode="edge"))
    return np.unwrap(np.angle(total[2 * half + 1 :] - total[: -2 * half - 1]))


def interpolate_segments(segments: FloatArray, frames: FloatArray) -> FloatArray:
    """Interpolate unit vectors at fractional frames, ends held; (N, 9, 3) for (N,) frames."""
    frames = np.clip(frames, 0.0, len(segments) - 1.0)
    found = np.empty((len(frames), *segments.shape[1:]))
    for some in iterate_blocks(len(frames)):
        low = np.minimum(frames[some].astype(np.intp), max(len(segments) - 2, 0))
        high = np.minimum(low + 1, len(segments) - 1)
        share = (frames[some] - low)[:, None, None]
        mixed = segments[low] * (1.0 - share) + segments[high] * share
        found[some] = mixed / np.maximum(np.linalg.norm(mixed, axis=2, keepdims=True), 1e-9)
    return found


# From the coarse names to the exact ones, which are laid over them.
LEVELS: tuple[dict[str, tuple[str, ...]], ...] = (
    {
        "arms": tuple(SEGMENTS[i] for i in (*LIMBS["left_arm"], *LIMBS["right_arm"])),
        "legs": tuple(SEGMENTS[i] for i in (*LIMBS["left_leg"], *LIMBS["right_leg"])),
    },
    {name: tuple(SEGMENTS[i] for i in members) for name, members in LIMBS.items() if name not in SEGMENTS},
    {name: (name,) for name in SEGMENTS},
)


def read_weights(path: str | os.PathLike[str]) -> dict[str, float]:
    """Read a file of weights.

    Parameters
    ----------
    path : TOML, or lines ``segment = number``; names of `SEGMENTS`, of `LIMBS`, or ``arms`` and ``legs``. Spaces
        in a name are underscores, capitals do not matter.

    Returns
    -------
    Weight of every one of the nine segments, 0 or more, at least one above 0.

    Raises
    ------
    OptionError : the file cannot be read, a name that is no segment, a weight that is no number of 0 or more,
        nothing that weighs.
    """
    where = os.fspath(path)
    entries: dict[str, Any] = {}
    try:
        text = read_small_text(path)
    except MotionFileError as error:
        raise OptionError("weights_file.unreadable", path=where, problem=error.message) from error
    for given, value in _parse(text, where).items():
        if _plain(given) in entries:
            raise OptionError("weights_file.repeated", path=where, name=given)
        entries[_plain(given)] = value
    known = [name for level in LEVELS for name in level]
    for name, value in entries.items():
        if name not in known:
            raise OptionError("weights_file.unknown", path=where, name=name, known=tuple(known))
        _check(value, name, where)
    weights = _lay_over(entries)
    if not any(weights.values()):
        raise OptionError("weights_file.nothing", path=where)
    return weights


def _parse(text: str, where: str) -> Mapping[str, Any]:
    try:
        entries = tomllib.loads(text)
    except (ValueError, RecursionError):  # no TOML, or a number of too many digits
        entries = _parse_lines(text, where)
    if len(entries) == 1 and isinstance(inner := next(iter(entries.values())), dict):
        entries = inner  # under one heading, such as [weights]
    if not entries:
        raise OptionError("weights_file.empty", path=where)
    return entries


def _parse_lines(text: str, where: str) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for number, line in enumerate(text.splitlines(), 1):
        content = line.partition("#")[0].strip()
        if not content or (content.startswith("[") and content.endswith("]")):
            continue
        name, equals, value = (part.strip() for part in content.partition("="))
        if not equals or not name or not value:
            raise OptionError("weights_file.form", path=where, line=number, found=_shown(content))
        if _plain(name) in found:
            raise OptionError("weights_file.repeated_line", path=where, line=number, name=name)
        try:
            found[_plain(name)] = float(value)
        except ValueError:
            raise OptionError("weights_file.number", path=where, line=number, name=name, found=_shown(value)) from None
    return found


def _plain(name: str) -> str:
    return "_".join(name.strip().lower().replace("-", " ").split())


def _check(value: Any, name: str, where: str) -> None:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    # nan is in no range; an integer may be too large for a float.
    if not number or not 0 <= value <= 1e6:
        raise OptionError("weights_file.weight", path=where, name=name, found=_shown(value))


def _shown(value: Any, *, shown: int = 40) -> str | Message:
    """The beginning of a wrong value."""
    # shown: letters of a wrong value in a message
    try:
        text = repr(value)
    except ValueError:  # an integer of more digits than Python writes
        return Message("weights_file.huge")
    return text if len(text) <= shown else text[:shown] + "..."


def spread_weights(weights: Mapping[str, float] | None) -> FloatArray:
    """(9,) weights; those above 0 have a mean of 1, so that leaving limbs out does not make the rest count more."""
    given = dict(weights or {})
    known = [name for level in LEVELS for name in level]
    for name, value in given.items():
        if name not in known:
            raise OptionError("evaluation.weight_name", known=tuple(known), name=name)
        if not isinstance(value, int | float) or not 0.0 <= value <= 1e6:
            raise OptionError("evaluation.weight", name=name, value=repr(value))
    shares = np.array(list(_lay_over(given).values()))
    if shares.sum() <= 0.0:
        raise OptionError("evaluation.no_weight")
    return np.asarray(shares / shares[shares > 0.0].mean())


def _lay_over(given: Mapping[str, float]) -> dict[str, float]:
    """Weight of every segment: what is named more exactly counts, in whatever order it comes."""
    weights = dict.fromkeys(SEGMENTS, 1.0)
    for level in LEVELS:
        for name in level.keys() & given.keys():
            weights.update(dict.fromkeys(level[name], float(given[name])))
    return weights
