"""Recordings of several repetitions with known bounds, joined from recordings of single ones.

Each repetition keeps its own movement; tempo, pauses, a repetition that is broken off, and walking before and after
are put in. The body is turned and moved to where the piece before has left it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dousa.arrays import FloatArray
from dousa.evaluation.posture.posture import compute_segments
from dousa.motion import CanonicalMotion
from dousa.motion.canonical.joints import JOINT_INDEX as J
from dousa.motion.resampling import find_neighbours

RATE = 30.0
_ONSET = 0.1  # share of the largest displacement at which a repetition has begun, and until which it has not ended
_SWAY_M = 0.004
_TURN_S = 0.5  # at most, from the pose of one piece to that of the next


@dataclass(frozen=True, slots=True, eq=False)
class ExerciseSet:
    """A recording of several repetitions.

    Parameters
    ----------
    motion : at 30 Hz.
    spans : (start_s, end_s) of the complete repetitions: from where the posture has left the first one by 10 % of the
        largest displacement to where it has come as near to the last one.
    broken_off : (start_s, end_s) of those that were not.
    """

    motion: CanonicalMotion
    spans: tuple[tuple[float, float], ...]
    broken_off: tuple[tuple[float, float], ...]


def join_repetitions(
    clips: Sequence[CanonicalMotion],
    rng: np.random.Generator,
    *,
    tempo: tuple[float, float] = (0.7, 1.4),
    pause_s: tuple[float, float] = (0.2, 2.0),
    broken_off: Sequence[int] = (),
    before: CanonicalMotion | None = None,
    after: CanonicalMotion | None = None,
) -> ExerciseSet:
    """Join recordings of single repetitions.

    Parameters
    ----------
    clips : one repetition each.
    rng : of tempo, pauses and sway.
    tempo : range of the speed, as a share of the recorded one.
    pause_s : range of the pauses before, between and after, s.
    broken_off : indices of the clips that turn back half-way.
    before, after : another motion, such as walking.
    """
    pieces: list[tuple[FloatArray, str]] = [] if before is None else [(_at_rate(before, 1.0), "other")]
    for number, clip in enumerate(clips):
        played = _at_rate(clip, float(rng.uniform(*tempo)))
        half = number in broken_off
        pieces.append((_turn_back(played) if half else played, "half" if half else "whole"))
    if after is not None:
        pieces.append((_at_rate(after, 1.0), "other"))
    positions = _hold(pieces[0][0][0], pieces[0][0][0], float(rng.uniform(*pause_s)), rng)
    spans: dict[str, list[tuple[float, float]]] = {"whole": [], "half": [], "other": []}
    for piece, kind in pieces:
        placed = _place(piece, positions[-1])
        pause = _hold(positions[-1], placed[0], float(rng.uniform(*pause_s)), rng)
        begin = len(positions) + len(pause)
        start, end = find_onset(placed)
        spans[kind].append(((begin + start) / RATE, (begin + end) / RATE))
        positions = np.concatenate([positions, pause, placed])
    positions = np.concatenate([positions, _hold(positions[-1], positions[-1], float(rng.uniform(*pause_s)), rng)])
    motion = dataclasses.replace(clips[0], positions=positions, frame_rate=RATE, missing=None, warnings=())
    return ExerciseSet(motion, tuple(spans["whole"]), tuple(spans["half"]))


def find_onset(positions: FloatArray) -> tuple[int, int]:
    """Frames, half-open, between which a single repetition (T, 20, 3) moves."""
    segments = compute_segments(positions).reshape(len(positions), -1)
    left = np.linalg.norm(segments - segments[0], axis=1)
    right = np.linalg.norm(segments - segments[-1], axis=1)
    start = int(np.argmax(left > _ONSET * left.max())) if left.max() > 0 else 0
    end = len(right) - int(np.argmax(right[::-1] > _ONSET * right.max())) if right.max() > 0 else len(right)
    return max(start - 1, 0), end


def _at_rate(motion: CanonicalMotion, tempo: float) -> FloatArray:
    """(T, 20, 3) m at 30 Hz, so many times as fast."""
    before, after, fraction = find_neighbours(motion.n_frames, motion.frame_rate * tempo, RATE)
    share = fraction[:, None, None]
    return np.asarray(motion.positions[before] * (1.0 - share) + motion.positions[after] * share)


def _turn_back(positions: FloatArray) -> FloatArray:
    """To half of the largest displacement, a moment there, and the same way back."""
    segments = compute_segments(positions).reshape(len(positions), -1)
    away = np.linalg.norm(segments - segments[0], axis=1)
    turn = int(np.argmax(away >= 0.5 * away.max()))
    stay = np.repeat(positions[turn : turn + 1], 3, axis=0)
    return np.concatenate([positions[: turn + 1], stay, positions[turn::-1]])


def _heading(pose: FloatArray) -> float:
    across = pose[J["left_hip"]] + pose[J["left_shoulder"]] - pose[J["right_hip"]] - pose[J["right_shoulder"]]
    return float(np.arctan2(across[0], across[2]))


def _place(positions: FloatArray, pose: FloatArray) -> FloatArray:
    """The motion, turned and moved along the floor to where a pose (20, 3) is."""
    turn = _heading(pose) - _heading(positions[0])
    cosine, sine = np.cos(turn), np.sin(turn)
    x, z = positions[..., 0], positions[..., 2]
    turned = np.stack([x * cosine + z * sine, positions[..., 1], z * cosine - x * sine], axis=-1)
    moved = pose[J["pelvis"]] - turned[0, J["pelvis"]]
    return np.asarray(turned + moved * [1.0, 0.0, 1.0])


def _hold(pose: FloatArray, then: FloatArray, seconds: float, rng: np.random.Generator) -> FloatArray:
    """A pose held with a little sway, which at the end becomes the next one, smoothly."""
    times = np.arange(1, max(round(seconds * RATE), 2) + 1) / RATE
    turn = min(_TURN_S, float(times[-1]))
    share = np.clip((times - times[-1] + turn) / turn, 0.0, 1.0)
    share = (share * share * (3.0 - 2.0 * share))[:, None, None]
    phase, pace = rng.uniform(0.0, 2 * np.pi, (2, *pose.shape)), rng.uniform(0.2, 0.8, (2, *pose.shape))
    clock = times[:, None, None]
    sway = sum(np.sin(2 * np.pi * pace[k] * clock + phase[k]) - np.sin(phase[k]) for k in range(2))
    fade = np.minimum(1.0, (times[-1] - times) / turn)[:, None, None]
    return np.asarray(pose * (1.0 - share) + then * share + _SWAY_M * 0.5 * sway * fade)
