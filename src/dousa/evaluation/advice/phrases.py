"""A teacher's words: what to move which way, when, and in which figure."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

from dousa.evaluation.advice.directions import Correction
from dousa.evaluation.posture.posture import SEGMENTS
from dousa.evaluation.words import group_segments
from dousa.messages import Message

_STEP_DEG, _STEP_S = 5.0, 0.05  # what a person can do something with

_PARTS: Mapping[str, Message] = {
    "body_segments.trunk": Message("advice_parts.trunk"),
    "body_segments.left_upper_arm": Message("advice_parts.left_upper_arm"),
    "body_segments.left_forearm": Message("advice_parts.left_forearm"),
    "body_segments.right_upper_arm": Message("advice_parts.right_upper_arm"),
    "body_segments.right_forearm": Message("advice_parts.right_forearm"),
    "body_segments.left_thigh": Message("advice_parts.left_thigh"),
    "body_segments.left_shank": Message("advice_parts.left_shank"),
    "body_segments.right_thigh": Message("advice_parts.right_thigh"),
    "body_segments.right_shank": Message("advice_parts.right_shank"),
    "body_segments.both_arms": Message("advice_parts.both_arms"),
    "body_segments.left_arm": Message("advice_parts.left_arm"),
    "body_segments.right_arm": Message("advice_parts.right_arm"),
    "body_segments.both_upper_arms": Message("advice_parts.both_upper_arms"),
    "body_segments.both_forearms": Message("advice_parts.both_forearms"),
    "body_segments.both_legs": Message("advice_parts.both_legs"),
    "body_segments.left_leg": Message("advice_parts.left_leg"),
    "body_segments.right_leg": Message("advice_parts.right_leg"),
    "body_segments.both_thighs": Message("advice_parts.both_thighs"),
    "body_segments.both_shanks": Message("advice_parts.both_shanks"),
    "body_segments.whole_body": Message("advice_parts.whole_body"),
}
_JOINTS: Mapping[str, Message] = {
    "body_segments.both_arms": Message("advice_parts.both_elbows"),
    "body_segments.left_arm": Message("advice_parts.left_elbow"),
    "body_segments.right_arm": Message("advice_parts.right_elbow"),
    "body_segments.both_legs": Message("advice_parts.both_knees"),
    "body_segments.left_leg": Message("advice_parts.left_knee"),
    "body_segments.right_leg": Message("advice_parts.right_knee"),
}
_OF_LIMBS: Mapping[str, str] = {
    "up": "advice_corrections.up",
    "down": "advice_corrections.down",
    "forward": "advice_corrections.forward",
    "back": "advice_corrections.back",
    "outward": "advice_corrections.outward",
    "inward": "advice_corrections.inward",
    "bend": "advice_corrections.bend",
    "straighten": "advice_corrections.straighten",
}
_OF_THE_TRUNK: Mapping[str, str] = {
    "upright": "advice_corrections.upright",
    "lean_forward": "advice_corrections.lean_forward",
    "lean_back": "advice_corrections.lean_back",
    "lean_left": "advice_corrections.lean_left",
    "lean_right": "advice_corrections.lean_right",
    "turn_left": "advice_corrections.turn_left",
    "turn_right": "advice_corrections.turn_right",
}


def name_parts(segments: Iterable[str]) -> tuple[Message, ...]:
    """Parts of the body as a teacher names them: ``the left arm``, ``both legs``."""
    return tuple(_PARTS[message.code] for message in group_segments(segments))


def say_correction(correction: Correction) -> Message:
    """One correction, without its moment: ``raise the left arm 25 deg higher``."""
    degrees = round_degrees(correction.amount_deg)
    if correction.direction in _OF_THE_TRUNK:
        return Message(_OF_THE_TRUNK[correction.direction], degrees=degrees)
    part = Message("advice_parts.several", names=name_parts(correction.segments))
    if correction.direction in ("bend", "straighten"):
        part = _JOINTS[group_segments(correction.segments)[0].code]
    return Message(_OF_LIMBS[correction.direction], part=part, degrees=degrees)


def say_size(segments: Iterable[str], shortfall_deg: float) -> Message:
    """A movement that is too small, or too large if this is negative, where no direction can be said."""
    part = Message("advice_parts.several", names=name_parts(segments))
    degrees = round_degrees(abs(shortfall_deg))
    if shortfall_deg < 0:
        return Message("advice_corrections.smaller", part=part, degrees=degrees)
    return Message("advice_corrections.larger", part=part, degrees=degrees)


def say_timing(segments: Iterable[str], lag_ms: float | None, where: Message) -> Message:
    """Too late or too early: ``you were 0.2 s late with both legs at 0:31``."""
    names = tuple(segments)
    if lag_ms is None or not math.isfinite(lag_ms):
        return Message("advice.out_of_time", where=where)
    late = lag_ms > 0
    seconds = round(max(round(abs(lag_ms) / 1000.0 / _STEP_S), 1) * _STEP_S, 2)
    if not names or len(names) == len(SEGMENTS):
        return Message("advice.late" if late else "advice.early", seconds=seconds, where=where)
    code = "advice.late_with" if late else "advice.early_with"
    return Message(code, who=name_parts(names), seconds=seconds, where=where)


def round_degrees(degrees: float) -> int:
    """To 5 degrees, 5 at least."""
    return int(max(round(degrees / _STEP_DEG), 1) * _STEP_DEG)


def format_moment(seconds: float) -> str:
    """A moment as the counter of a player shows it: ``m:ss``."""
    if not math.isfinite(seconds):
        return "–"
    whole = max(int(seconds), 0)
    return f"{whole // 60}:{whole % 60:02d}"


def say_where(times: Sequence[float], furi: Sequence[int | None], labels: Sequence[str]) -> Message:
    """When, and in which figures.

    Parameters
    ----------
    times : s, one or several, in the order in which they are to be named.
    furi : figure of each, from 0; None outside all.
    labels : of all figures.
    """
    numbers = sorted({number for number in furi if number is not None})
    named = tuple(number + 1 for number in numbers)
    moments = tuple(dict.fromkeys(format_moment(time) for time in sorted(times)))
    if None in furi or not numbers:
        return Message("advice_when.times", times=moments)
    if len(numbers) == 1:
        return Message("advice_when.in_figure", times=moments, number=named[0])
    alike = {labels[number] for number in numbers}
    if len(alike) == 1 and len(numbers) == sum(label in alike for label in labels):
        return Message("advice_when.every_time", numbers=named)
    return Message("advice_when.in_figures", numbers=named, time=moments[0])
