"""What was wrong with a repetition: which joint, by how much, in which phase, beside repetitions done well.

Joint angles are compared along the path of best correspondence with each repetition of the references, with the
posture in which either begins and ends taken off: the build of a body, or how it stands, is no error. What three
quarters of them agree on counts, so that no single one makes a fault or hides one, and counts in multiples of what
people differ by who do the exercise well, with what the sensor trembles by. A joint that is still in the references
and moves here is compensation.

Chosen on UI-PRMD, people left out: ``python -m lab.trials.exercise_faults``, see docs/exercises.md.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray, IndexArray
from dousa.evaluation.alignment.correspondence import find_path
from dousa.evaluation.posture.posture import SEGMENTS, PostureSequence
from dousa.evaluation.posture.range_of_motion import ANGLES, MOVING_DEG
from dousa.messages import Message
from dousa.motion.canonical.joints import JOINT_INDEX as J
from dousa.motion.resampling import smooth_gaussian
from dousa.motion.runs import find_equal_runs

_RATE = 15.0  # Hz at which repetitions are compared; 10 do as well: measured by lab/trials/exercise_faults.py
_LASTING_S = 0.3  # for which a difference must last; also at either end what is the own posture (lab/trials/)
_LASTING_SHARE = 0.15  # of a quick repetition, instead: measured by lab/trials/exercise_faults.py
AGREE = 0.25
"""Share of the references that may disagree, measured by lab/trials/exercise_faults.py."""
_TREMBLES = 10.0  # what a sensor drifts by, of what it trembles by from frame to frame: measured there
_ONE_REFERENCE = 1.6  # times as far from one person as from three who agree: measured there
_FURTHEST = 0.8  # share of the reach from which on the body is at the furthest point, by definition
_LOWER = 0.1  # body heights by which the pelvis is lower there: the furthest point is the lowest, by definition

WELL = 75.0
"""Grade from which on no joint of a movement is at fault: nine of ten correct repetitions have it, and a fifth of the
incorrect ones, measured by lab/trials/exercise_faults.py."""

TOLERANCE_DEG: Mapping[str, float] = {
    "elbow_flexion": 12.0,
    "shoulder_elevation": 14.0,
    "shoulder_flexion": 26.0,
    "shoulder_abduction": 15.0,
    "hip_flexion": 17.0,
    "hip_abduction": 19.0,
    "knee_flexion": 20.0,
    "trunk_lean": 10.0,
    "trunk_forward_lean": 10.0,
    "trunk_side_lean": 6.0,
}
"""Angle -> degrees by which nine of ten correct repetitions differ at most from three by other people, and two for
rounding: measured by lab/trials/exercise_faults.py on correct repetitions of UI-PRMD, Kinect and Vicon."""


def drop_side(angle: str) -> str:
    """Name an angle of `ANGLES` without its side."""
    return angle.removeprefix("left_").removeprefix("right_")


_JOINTS = {name: name.partition(drop_side(name))[0] + drop_side(name).split("_")[0] for name in ANGLES}  # by definition
_MOVES = {
    "elbow": "forearm",
    "shoulder": "upper_arm",
    "hip": "thigh",
    "knee": "shank",
    "trunk": "trunk",
}  # by definition


def _find_segment(angle: str) -> int:
    """Number of the segment that the joint of an angle moves."""
    side, _, joint = _JOINTS[angle].rpartition("_")
    return SEGMENTS.index(f"{side}_{_MOVES[joint]}".lstrip("_"))


_SEGMENTS_OF_ANGLES = np.array([_find_segment(name) for name in ANGLES])


@dataclass(frozen=True, slots=True)
class Fault:
    """One joint of a repetition that goes otherwise than in the references.

    Parameters
    ----------
    angle : of `ANGLES`.
    kind : ``"short"``: it goes less far; ``"far"``: further; ``"compensation"``: it moves, and in the references not.
    phase : ``"there"``, ``"furthest"`` or ``"lowest"``, ``"back"``: when the difference is largest.
    time_s : s of the recording of that moment.
    start_s, end_s : s of the recording, around it, while the difference is half as large at least.
    degrees : of the angle then.
    expected : degrees of the references at the same moment, in the performer's own posture.
    severity : in multiples of what people differ by who do it well.
    is_clear : whether it is to be said: in a movement that is not done well all as severe as 1, and beside several
        references the worst; in one that is done well none.
    """

    angle: str
    kind: str
    phase: str
    time_s: float
    start_s: float
    end_s: float
    degrees: float
    expected: float
    severity: float
    is_clear: bool

    @property
    def segment(self) -> str:
        """The segment that the joint moves, such as ``left_shank``."""
        return SEGMENTS[_find_segment(self.angle)]

    @property
    def joint(self) -> str:
        """Such as ``left_knee``, or ``trunk``."""
        return _JOINTS[self.angle]

    @property
    def message(self) -> Message:
        """What is wrong, without when."""
        return describe_fault(self.angle, self.kind, self.phase, self.degrees, self.expected)

    def move(self, seconds: float) -> Fault:
        """The same so much later."""
        times = {name: getattr(self, name) + seconds for name in ("time_s", "start_s", "end_s")}
        return replace(self, **times)

    def to_json(self, language: str | None = None) -> dict[str, Any]:
        """As a dictionary, with the sentence."""
        return {
            "joint": self.joint,
            "angle": self.angle,
            "kind": self.kind,
            "phase": self.phase,
            "time_s": round(self.time_s, 3),
            "degrees": round(self.degrees, 1),
            "expected_deg": round(self.expected, 1),
            "severity": round(self.severity, 2),
            "clear": self.is_clear,
            "message": self.message.render(language),
        }


_WHEN = {
    "there": Message("fault.phase_there"),
    "furthest": Message("fault.phase_furthest"),
    "lowest": Message("fault.phase_lowest"),
    "back": Message("fault.phase_back"),
}


def describe_fault(angle: str, kind: str, phase: str, degrees: float, expected: float) -> Message:
    """Describe a fault; ``angle`` is of `ANGLES`, or one of both sides such as ``both_knee_flexion``."""
    shown = round(degrees)
    sign = -1 if (shown or round(expected)) < 0 else 1
    what = Message(f"fault_joint.{angle}" if sign > 0 else f"fault_joint.reverse_{angle}")
    wanted = sign * round(expected)
    code = "fault.other_way" if wanted < 0 else "fault.differs"
    said = Message(code, what=what, degrees=sign * shown, when=_WHEN[phase], expected=abs(wanted))
    return Message("fault.compensation", fault=said) if kind == "compensation" else said


@dataclass(frozen=True, slots=True, eq=False)
class DescribedRepetition:
    """One repetition as `find_faults` compares it, some fifteen frames a second."""

    segments: FloatArray  # (U, 9, 3) unit vectors
    angles: FloatArray  # (U, 17) degrees, smoothed, in the order of `ANGLES`; nan where never seen
    trembling: FloatArray  # (17,) degrees from frame to frame
    phases: NDArray[np.str_]  # (U,) of `Fault`
    times: FloatArray  # (U,) s of the recording
    margin: int  # frames at either end of which the mean is the own posture


def describe_repetition(
    postures: PostureSequence, angles: Mapping[str, FloatArray], start: int, end: int
) -> DescribedRepetition:
    """Describe the frames from ``start`` up to ``end`` of a recording.

    Parameters
    ----------
    postures : of the recording.
    angles : of `compute_joint_angles`, of the recording.
    start, end : frames, half-open, at least one.
    """
    rate = postures.frame_rate
    values = np.stack([angles[name][start:end] for name in ANGLES], axis=1)
    unseen = ~np.isfinite(values) | ~postures.seen[start:end, _SEGMENTS_OF_ANGLES].any(axis=0)
    values = np.where(unseen, 0.0, values)
    # Fourth differences at 30 Hz, the rate of most sensors: noise of s has 70 s^2 (by definition), movement hardly any.
    jitter = np.diff(values[:: max(1, round(rate / 30.0))], 4, axis=0)
    trembling = np.sqrt((jitter**2).mean(axis=0) / 70.0) if len(jitter) else np.zeros(len(ANGLES))
    smooth = smooth_gaussian(values, max(rate / 15.0, 0.3))
    smooth[:, unseen.all(axis=0)] = np.nan
    step = max(1, round(rate / _RATE))
    segments = np.ascontiguousarray(postures.segments[start:end:step])
    away = np.linalg.norm((segments - segments[0]).reshape(len(segments), -1), axis=1)
    top = int(away.argmax())
    height = postures.positions[start:end:step, J["pelvis"], 1]
    stature = float(np.nanmax(np.ptp(postures.positions[start:end:step, :, 1], axis=1), initial=1e-9))
    furthest = "lowest" if height[0] - height[top] > _LOWER * stature else "furthest"
    phases = np.where(away >= _FURTHEST * away[top], furthest, np.where(np.arange(len(away)) < top, "there", "back"))
    times = np.arange(start, end, step) / rate
    lasting = max(round(min(_LASTING_S * rate, _LASTING_SHARE * (end - start)) / step), 1)
    return DescribedRepetition(segments, smooth[::step], trembling, phases, times, lasting)


def find_faults(
    one: DescribedRepetition,
    references: Sequence[DescribedRepetition],
    n_people: int,
    tolerances: Mapping[str, float] = TOLERANCE_DEG,
    *,
    grade: float = math.nan,
    well: float = WELL,
    judged: NDArray[np.bool_] | None = None,
) -> tuple[Fault, ...]:
    """Find the joints that go otherwise than in repetitions done well, the worst first, one fault a joint.

    The worst comes even where its ``severity`` is below 1, and then alone.

    Parameters
    ----------
    one : the repetition.
    references : at least one.
    n_people : takes of the reference: what one person does alone is a weaker measure.
    tolerances : as `TOLERANCE_DEG`.
    grade : of the repetition; nan for none.
    well : grade from which on it is done well.
    judged : (9,) segments whose joints are looked at; None for all.
    """
    usual, theirs, lasting = compare_all(one, references)
    moments, sizes = lasting.argmax(axis=0), lasting.max(axis=0)
    people = 1.0 + (_ONE_REFERENCE - 1.0) * max(3 - n_people, 0) / 2.0
    limits = np.array([tolerances[drop_side(name)] for name in ANGLES])
    severity = sizes / (people * limits + _TREMBLES * one.trembling)
    if judged is not None:
        severity = np.where(judged[_SEGMENTS_OF_ANGLES], severity, 0.0)
    ranges = np.median([np.ptp(reference.angles, axis=0) for reference in references], axis=0)
    found: dict[str, Fault] = {}
    for k in np.argsort(-severity, kind="stable").tolist():
        if not severity[k] > 0.0 or (found and severity[k] < 1.0):
            break
        at = int(moments[k] + np.abs(usual[moments[k] : moments[k] + one.margin, k]).argmax())
        short = usual[at, k] * theirs[at, k] < 0
        kind = "compensation" if ranges[k] < MOVING_DEG else "short" if short else "far"
        degrees = float(one.angles[at, k])
        when = str(one.phases[at]), float(one.times[at])
        first, last = _find_span(lasting[:, k], moments[k])
        fault = Fault(
            ANGLES[k],
            kind,
            *when,
            start_s=float(one.times[first]),
            end_s=float(one.times[min(last + one.margin, len(one.times)) - 1]),
            degrees=degrees,
            expected=degrees - float(usual[at, k]),
            severity=float(severity[k]),
            is_clear=not grade >= well and bool(severity[k] >= 1.0 or (grade < well and n_people > 1 and not found)),
        )
        found.setdefault(fault.joint, fault)
    return tuple(found.values())


def _find_span(sizes: FloatArray, at: int) -> tuple[int, int]:
    """Span, half-open, around a moment in which sizes are half of that there at least."""
    small = np.flatnonzero(sizes < 0.5 * sizes[at])
    return int(small[small < at].max(initial=-1)) + 1, int(small[small > at].min(initial=len(sizes)))


def compare_all(
    one: DescribedRepetition, references: Sequence[DescribedRepetition]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(U, 17) degrees each, of `ANGLES`: the usual difference, the references' way from their own posture; and (fewer
    frames) the lasting difference, at least as large from three quarters of the references."""
    apart, theirs = (
        np.stack(some) for some in zip(*(_compare(one, reference) for reference in references), strict=True)
    )
    usual = np.median(apart, axis=0)
    agreed = np.quantile(apart * np.where(usual < 0, -1.0, 1.0), AGREE, axis=0)
    return usual, np.median(theirs, axis=0), _average(np.maximum(np.nan_to_num(agreed), 0.0), one.margin)


def _compare(one: DescribedRepetition, reference: DescribedRepetition) -> tuple[FloatArray, FloatArray]:
    """(U, 17) degrees each: how far each angle is from a reference's, and how far that is from its own posture."""
    path = find_path(one.segments, reference.segments)
    theirs = _follow(reference.angles - _find_own(reference), path)
    return one.angles - _find_own(one) - theirs, theirs


def _follow(values: FloatArray, path: IndexArray) -> FloatArray:
    """Values of the second motion of a path at each frame of the first, of several the one furthest from 0: who stops
    short is there while the other goes on to the end and comes back."""
    starts = find_equal_runs(path[:, 0])[:, 0]
    most, least = (reduce.reduceat(values[path[:, 1]], starts) for reduce in (np.maximum, np.minimum))
    return np.asarray(np.where(most >= -least, most, least))


def _find_own(one: DescribedRepetition) -> FloatArray:
    """(17,) degrees of the posture in which a repetition begins and ends."""
    return np.asarray(0.5 * (one.angles[: one.margin].mean(axis=0) + one.angles[-one.margin :].mean(axis=0)))


def _average(values: FloatArray, count: int) -> FloatArray:
    """The mean of so many frames in a row, at the first of them."""
    count = min(count, len(values))
    windows = np.lib.stride_tricks.sliding_window_view(values, count, axis=0)
    return np.asarray(windows.mean(axis=-1))
