"""What the player is fed: both figures as short integers, which moments belong together, events and words."""

from __future__ import annotations

import base64
import math
from typing import Any

import numpy as np

from dousa.app.player._texts import KIND_LETTERS, PLAYER_TEXTS
from dousa.errors import OptionError
from dousa.evaluation._types import Assessment, PostureSequence
from dousa.motion._types import FloatArray
from dousa.motion.geometry import chain_height
from dousa.motion.joints import CANONICAL_JOINTS, CANONICAL_PARENTS
from dousa.motion.joints import JOINT_INDEX as J
from dousa.motion.sides import compute_forward

__all__ = ["encode_player_data"]

# Both figures together: 120 B a frame, a third more as base64. 13,500 frames are 2.2 MB; a longer take is thinned
# (the player draws between frames), but never below 10 Hz, where fast limbs would cut corners.
_MOST_FRAMES = 13_500
_LOWEST_RATE = 10.0
_MILLIMETRES = 1000.0
_HIPS = [J["left_hip"], J["right_hip"]]
_FEET = [J[f"{side}_{end}"] for side in ("left", "right") for end in ("ankle", "toe")]
_LOWEST_SHARE = 0.5  # percent of frames whose feet may lie below the floor: single bad frames lift nobody


def encode_player_data(
    assessment: Assessment, language: str = "en", max_rate: float = 30.0
) -> dict[str, Any]:
    """An assessment as the player wants it: plain values that JSON can hold.

    Parameters
    ----------
    assessment : any; only its fields are read.
    language : ``"en"`` or ``"ja"``, of buttons and names.
    max_rate : Hz, at most so many frames a second are stored; fewer if the recording has fewer, or if both
        figures together would be more than 13,500 frames (3:45 at 30 Hz).

    Returns
    -------
    ``rate`` Hz; ``reference`` and ``performance`` with ``positions`` (n_frames, 20, 3) int16 mm over the floor and
    about the hips' middle, ``path`` (n_frames, 2) int32 mm of that middle (x, z), both base64, and ``stature`` m;
    ``step`` and ``time``: base64 int32, for each frame of the performance the reference's time in ms that it
    resembles, and that it has if the tempo is kept, the nearest one as -1 - ms where there is none; ``joints``,
    ``parents``, ``segments``, ``events``, ``furi``, ``kinds``, ``texts``. Both figures face +Z on average.

    Raises
    ------
    OptionError : another language, or a rate that is not above 0.
    """
    from dousa.evaluation.words import check_language

    check_language(language)
    if not (math.isfinite(max_rate) and max_rate > 0):
        raise OptionError(f"max_rate: expected Hz above 0, got {max_rate}")
    performance, reference = assessment.performance, assessment.reference
    rate = _choose_rate(assessment, max_rate)
    frames = _frames_at(performance, rate)
    end = (reference.n_frames - 1) / reference.frame_rate
    step = _match(assessment.matched_time, frames, end)
    same = _match(assessment.same_time, frames, end)
    turn = -_mean_heading(performance.positions)
    reference_turn = turn + _relative_heading(assessment)
    start = step[0] if step[0] >= 0 else -1 - step[0]
    first = round(start / _MILLIMETRES * reference.frame_rate)
    return {
        "version": 1,
        "language": language,
        "rate": rate,
        "reference": _encode_figure(reference, rate, reference_turn, first),
        "performance": _encode_figure(performance, rate, turn, 0),
        "step": _encode(step, "<i4"),
        "time": _encode(same, "<i4"),
        "joints": list(CANONICAL_JOINTS),
        "parents": list(CANONICAL_PARENTS),
        "segments": _describe_segments(language),
        "events": _describe_events(assessment),
        "furi": _describe_furi(assessment),
        "kinds": _describe_kinds(language),
        "texts": dict(PLAYER_TEXTS[language]),
    }


def _choose_rate(assessment: Assessment, max_rate: float) -> float:
    seconds = assessment.performance.duration + assessment.reference.duration
    affordable = max(_MOST_FRAMES / seconds, _LOWEST_RATE)
    return float(min(max_rate, assessment.performance.frame_rate, affordable))


def _frames_at(sequence: PostureSequence, rate: float) -> FloatArray:
    """Positions (n,) on the sequence's own frames of the frames that are stored."""
    # A hair more, so that rounding does not lose the last frame.
    last = math.floor((sequence.n_frames - 1) / sequence.frame_rate * rate + 1e-6)
    frames = np.arange(last + 1) * (sequence.frame_rate / rate)
    return np.minimum(frames, sequence.n_frames - 1)


def _match(times: FloatArray, frames: FloatArray, end: float) -> np.ndarray:
    """Reference times (n,) ms of stored frames; -1 - the nearest valid one's where there is none."""
    times = np.asarray(times, dtype=float)
    good = np.flatnonzero(np.isfinite(times) & (times >= 0) & (times <= end))
    if len(good) == 0:
        nearest = np.clip(frames / max(len(times) - 1, 1) * end, 0, end)
        return (-1 - np.rint(nearest * _MILLIMETRES)).astype(np.int64)
    wanted = np.rint(frames).astype(int)
    valid = np.isin(wanted, good)
    middles = (good[1:] + good[:-1]) / 2
    nearest = times[good[np.searchsorted(middles, wanted)]]
    # Between frames the curve is straight, unless a gap lies there.
    smooth = np.where(valid, np.interp(frames, good, times[good]), nearest)
    milliseconds = np.rint(np.clip(smooth, 0, end) * _MILLIMETRES).astype(np.int64)
    return np.where(valid, milliseconds, -1 - milliseconds)


def _relative_heading(assessment: Assessment) -> float:
    """Angle about +Y, rad, that turns the reference to look where the performance looks; eq. 7 over all frames."""
    for times in (assessment.matched_time, assessment.same_time):
        frames = np.rint(np.asarray(times, dtype=float) * assessment.reference.frame_rate)
        seen = np.isfinite(frames) & (frames >= 0) & (frames < assessment.reference.n_frames)
        if seen.any():
            ours = assessment.performance.segments[seen]
            theirs = assessment.reference.segments[frames[seen].astype(int)]
            here, there = (part[..., 2] + 1j * part[..., 0] for part in (ours, theirs))
            turn = np.nansum(here * there.conj())
            if abs(turn) > 0:
                return float(np.angle(turn))
    return _mean_heading(assessment.performance.positions) - _mean_heading(assessment.reference.positions)


def _mean_heading(positions: FloatArray) -> float:
    """Heading, rad about +Y from +Z, that the body has on average."""
    forward = compute_forward(positions)
    total = np.nansum(forward[:, 2] + 1j * forward[:, 0])
    return float(np.angle(total)) if abs(total) > 0 else 0.0


def _encode_figure(sequence: PostureSequence, rate: float, turn: float, origin: int) -> dict[str, Any]:
    """Positions turned about +Y, over the floor; the path starts at the frame `origin`."""
    positions = _stand_on_floor(np.nan_to_num(np.asarray(sequence.positions, dtype=float)))
    cos, sin = math.cos(turn), math.sin(turn)
    x, z = positions[..., 0], positions[..., 2]
    positions[..., 0], positions[..., 2] = cos * x + sin * z, cos * z - sin * x
    path = positions[:, _HIPS][..., [0, 2]].mean(axis=1)
    positions[..., [0, 2]] -= path[:, None]
    path = path - path[min(max(origin, 0), len(path) - 1)]
    frames = _frames_at(sequence, rate)
    stored = _MILLIMETRES * _interpolate(positions, frames)
    return {
        "name": sequence.name,
        "n_frames": len(frames),
        "shape": [len(frames), len(CANONICAL_JOINTS), 3],
        "positions": _encode(np.clip(np.rint(stored), -32767, 32767), "<i2"),
        "path": _encode(np.rint(np.clip(_MILLIMETRES * _interpolate(path, frames), -2e9, 2e9)), "<i4"),
        "stature": round(_finite_or(chain_height(positions), 1.6), 4),
    }


def _stand_on_floor(positions: FloatArray) -> FloatArray:
    lowest = positions[:, _FEET, 1].min(axis=1)
    lifted = positions.copy()
    lifted[..., 1] -= np.percentile(lowest, _LOWEST_SHARE)
    return lifted


def _interpolate(values: FloatArray, frames: FloatArray) -> FloatArray:
    before = np.minimum(frames.astype(int), len(values) - 1)
    after = np.minimum(before + 1, len(values) - 1)
    share = (frames - before).reshape(-1, *[1] * (values.ndim - 1))
    mixed: FloatArray = (1 - share) * values[before] + share * values[after]
    return mixed


def _encode(values: np.ndarray, kind: str) -> str:
    return base64.b64encode(np.ascontiguousarray(values.astype(kind)).tobytes()).decode("ascii")


def _finite_or(value: float, otherwise: float) -> float:
    return float(value) if math.isfinite(value) and value > 0 else otherwise


def _seconds(value: float) -> float | None:
    return round(float(value), 4) if math.isfinite(value) else None


def _describe_segments(language: str) -> list[dict[str, Any]]:
    from dousa.evaluation.posture import SEGMENT_JOINTS, SEGMENTS
    from dousa.evaluation.words import SEGMENT_WORDS

    return [
        {"name": name, "label": SEGMENT_WORDS[language][name], "joints": [J[start], J[end]]}
        for name, (start, end) in zip(SEGMENTS, SEGMENT_JOINTS, strict=True)
    ]


def _describe_kinds(language: str) -> dict[str, dict[str, str]]:
    from dousa.evaluation.words import KIND_WORDS

    return {
        kind: {"label": label, "letter": KIND_LETTERS[language][kind]}
        for kind, label in KIND_WORDS[language].items()
    }


def _describe_events(assessment: Assessment) -> list[dict[str, Any]]:
    return [
        {
            "kind": event.kind,
            "start": _seconds(event.start_s),
            "end": _seconds(event.end_s),
            "worst": _seconds(event.worst_s),
            "segments": list(event.segments),
            "says": event.says,
        }
        for event in sorted(assessment.events, key=lambda event: (event.start_s, event.end_s))
        if math.isfinite(event.start_s) and math.isfinite(event.end_s)
    ]


def _describe_furi(assessment: Assessment) -> list[dict[str, Any]]:
    return [
        {"start": _seconds(furi.start_s), "end": _seconds(furi.end_s), "label": furi.label}
        for furi in assessment.furi
        if math.isfinite(furi.start_s) and math.isfinite(furi.end_s)
    ]
