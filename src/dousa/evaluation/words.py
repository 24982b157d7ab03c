"""Names of segments, errors and lapses, and sentences of a teacher about them.

The Japanese names of the four errors are those of Yamane and Shakunaga, section 2.3.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import TypeGuard

from dousa.errors import OptionError
from dousa.messages import LANGUAGES, Message

SEGMENT_NAMES: Mapping[str, Message] = {
    "trunk": Message("body_segments.trunk"),
    "left_upper_arm": Message("body_segments.left_upper_arm"),
    "left_forearm": Message("body_segments.left_forearm"),
    "right_upper_arm": Message("body_segments.right_upper_arm"),
    "right_forearm": Message("body_segments.right_forearm"),
    "left_thigh": Message("body_segments.left_thigh"),
    "left_shank": Message("body_segments.left_shank"),
    "right_thigh": Message("body_segments.right_thigh"),
    "right_shank": Message("body_segments.right_shank"),
}
"""Segment -> its name."""

KINDS: Mapping[str, Message] = {
    "global": Message("error_kinds.global"),
    "partial": Message("error_kinds.partial"),
    "incomplete": Message("error_kinds.incomplete"),
    "shift": Message("error_kinds.shift"),
}
"""Kind of error -> its name."""

LAPSE_KINDS: Mapping[str, Message] = {
    "stop": Message("lapse_kinds.stop"),
    "skip": Message("lapse_kinds.skip"),
    "repeat": Message("lapse_kinds.repeat"),
    "late start": Message("lapse_kinds.late_start"),
    "early end": Message("lapse_kinds.early_end"),
    "lead-in": Message("lapse_kinds.lead_in"),
    "lead-out": Message("lapse_kinds.lead_out"),
}
"""Kind of lapse -> its name."""

# The larger whole first, and the segments that it takes.
_WHOLES: tuple[tuple[Message, tuple[str, ...]], ...] = (
    (
        Message("body_segments.both_arms"),
        ("left_upper_arm", "left_forearm", "right_upper_arm", "right_forearm"),
    ),
    (Message("body_segments.left_arm"), ("left_upper_arm", "left_forearm")),
    (Message("body_segments.right_arm"), ("right_upper_arm", "right_forearm")),
    (Message("body_segments.both_upper_arms"), ("left_upper_arm", "right_upper_arm")),
    (Message("body_segments.both_forearms"), ("left_forearm", "right_forearm")),
    (Message("body_segments.both_legs"), ("left_thigh", "left_shank", "right_thigh", "right_shank")),
    (Message("body_segments.left_leg"), ("left_thigh", "left_shank")),
    (Message("body_segments.right_leg"), ("right_thigh", "right_shank")),
    (Message("body_segments.both_thighs"), ("left_thigh", "right_thigh")),
    (Message("body_segments.both_shanks"), ("left_shank", "right_shank")),
)


def check_language(language: str) -> str:
    """Check that there are words for a language, and return it.

    Raises
    ------
    OptionError : another one than those of `dousa.messages.LANGUAGES`.
    """
    if language not in LANGUAGES:
        raise OptionError("language.unknown", known=LANGUAGES, language=language)
    return language


def name_all(names: Mapping[str, Message], language: str | None = None) -> dict[str, str]:
    """Render a table of names in a language: ``name_all(KINDS, "ja")["shift"]``."""
    return {key: message.render(language) for key, message in names.items()}


def format_time(seconds: float) -> str:
    """Format a moment as ``m:ss.s``; a dash for one that is nan or infinite."""
    if not math.isfinite(seconds):
        return "–"
    tenths = round(abs(seconds) * 10)
    sign = "-" if seconds < 0 and tenths else ""
    return f"{sign}{tenths // 600}:{tenths % 600 / 10:04.1f}"


def describe_segments(segments: Iterable[str], language: str | None = None) -> str:
    """Describe segments, by limbs: ``"right arm"``, ``"trunk and both legs"``, ``"whole body"`` (also for none).

    Raises OptionError for an unknown segment. The language is one of `dousa.messages.LANGUAGES`, None for the current.
    """
    return Message("body_segments.several", names=group_segments(segments)).render(language)


def group_segments(segments: Iterable[str]) -> tuple[Message, ...]:
    """Group segments to whole limbs, from the trunk to the legs; none is the whole body.

    Raises
    ------
    OptionError : a segment that there is not.
    """
    left = set(segments)
    if unknown := left - set(SEGMENT_NAMES):
        raise OptionError("body_segments.unknown", known=tuple(SEGMENT_NAMES), names=unknown)
    if not left or len(left) == len(SEGMENT_NAMES):
        return (Message("body_segments.whole_body"),)
    # Each word stands where its first segment stands, so that the trunk comes before arms and legs.
    order = list(SEGMENT_NAMES)
    found: list[tuple[int, Message]] = []
    for name, members in _WHOLES:
        if left.issuperset(members):
            left.difference_update(members)
            found.append((order.index(members[0]), name))
    found.extend((order.index(segment), SEGMENT_NAMES[segment]) for segment in left)
    return tuple(name for _, name in sorted(found, key=lambda pair: pair[0]))


def describe_event(
    kind: str,
    segments: Iterable[str],
    *,
    lag_ms: float | None = None,
    shortfall_deg: float | None = None,
    shortfall_percent: float | None = None,
    deviation_deg: float | None = None,
) -> Message:
    """Describe an error, such as ``"right arm: 24 deg short, reaches 62 % of the range"``.

    Parameters
    ----------
    kind : of `KINDS`.
    segments : names of the wrong segments.
    lag_ms : how late, negative is early; of a shift.
    shortfall_deg, shortfall_percent : missing range of motion, in degrees and percent of the reference's; negative
        if it goes further than the reference.
    deviation_deg : largest lasting angle from the reference, of a partial error.

    Raises
    ------
    OptionError : a kind or segment that there is not.
    """
    who = group_segments(segments)
    if kind == "global":
        return Message("error_event.global")
    if kind == "partial":
        return _describe_partial(who, shortfall_deg, deviation_deg)
    if kind == "shift":
        return _describe_shift(who, lag_ms)
    if kind == "incomplete":
        return _describe_incomplete(who, shortfall_deg, shortfall_percent)
    raise OptionError("error_kinds.unknown", known=tuple(KINDS), kind=kind)


def _describe_partial(who: tuple[Message, ...], missing_deg: float | None, away_deg: float | None) -> Message:
    if _is_number(missing_deg) and missing_deg < 0:
        return Message("error_event.further", who=who, degrees=-missing_deg)
    if _is_number(away_deg):
        return Message("error_event.partial_by", who=who, degrees=away_deg)
    return Message("error_event.partial", who=who)


def _describe_shift(who: tuple[Message, ...], lag_ms: float | None) -> Message:
    if not _is_number(lag_ms):
        return Message("error_event.out_of_time", who=who)
    return Message("error_event.late" if lag_ms > 0 else "error_event.early", who=who, lag_ms=abs(lag_ms))


def _describe_incomplete(who: tuple[Message, ...], degrees: float | None, missing: float | None) -> Message:
    if not _is_number(missing):
        if not _is_number(degrees):
            return Message("error_event.incomplete", who=who)
        return Message("error_event.short", who=who, degrees=degrees)
    percent = round(min(100.0, max(0.0, 100.0 - missing)))
    if not _is_number(degrees):
        return Message("error_event.reaching", who=who, percent=percent)
    return Message("error_event.short_reaching", who=who, degrees=degrees, percent=percent)


def _is_number(value: float | None) -> TypeGuard[float]:
    return value is not None and math.isfinite(value)


def describe_lapse(
    kind: str, start_s: float, end_s: float, reference_start_s: float, reference_end_s: float
) -> Message:
    """Describe one lapse of order, such as ``"leaves out 2.0 s of the reference (0:30.0 to 0:32.0)"``.

    Times are seconds of the performance and seconds of the reference left out, done again or not reached. Raises
    OptionError for an unknown kind.
    """
    own, missed = _say_seconds(end_s - start_s), _say_seconds(reference_end_s - reference_start_s)
    start, end = format_time(reference_start_s), format_time(reference_end_s)
    said = {
        "stop": Message("lapse.stop", own=own),
        "skip": Message("lapse.skip", missed=missed, start=start, end=end),
        "repeat": Message("lapse.repeat", missed=missed, start=start, end=end),
        "late start": Message("lapse.late_start", missed=missed),
        "early end": Message("lapse.early_end", missed=missed),
        "lead-in": Message("lapse.lead_in", own=own),
        "lead-out": Message("lapse.lead_out", own=own),
    }
    if kind not in said:
        raise OptionError("error_kinds.unknown", known=tuple(said), kind=kind)
    return said[kind]


def _say_seconds(duration: float) -> Message:
    if not math.isfinite(duration):
        return Message("lapse.a_part")
    return Message("lapse.seconds", seconds=abs(duration))


def date(what: Message, start_s: float) -> Message:
    """Put the moment before an event: ``"0:31.0, stands still for 1.2 s, then goes on"``."""
    return Message("error_event.dated", time=format_time(start_s), what=what)


def describe_heading(angle: float) -> Message:
    """Describe a heading, such as ``"turned 25 deg to the left"``.

    Parameters
    ----------
    angle : rad about the vertical, positive is to the dancer's own left; nan is unknown.
    """
    if not math.isfinite(angle):
        return Message("dance_heading.unknown")
    turned = math.degrees(math.remainder(angle, 2.0 * math.pi))
    degrees = round(abs(turned))
    if degrees == 0:
        return Message("dance_heading.same")
    return Message("dance_heading.left" if turned > 0 else "dance_heading.right", degrees=degrees)


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
    """Name parts of the body as a teacher does: ``the left arm``, ``both legs``."""
    return tuple(_PARTS[message.code] for message in group_segments(segments))


def say_correction(direction: str, segments: Iterable[str], amount_deg: float) -> Message:
    """Name one correction, without its moment: ``raise the left arm 25 deg higher``."""
    names = tuple(segments)
    degrees = round_degrees(amount_deg)
    if direction in _OF_THE_TRUNK:
        return Message(_OF_THE_TRUNK[direction], degrees=degrees)
    part = Message("advice_parts.several", names=name_parts(names))
    if direction in ("bend", "straighten"):
        part = _JOINTS[group_segments(names)[0].code]
    return Message(_OF_LIMBS[direction], part=part, degrees=degrees)


def say_size(segments: Iterable[str], shortfall_deg: float) -> Message:
    """Name a movement that is too small, or too large if this is negative, without a direction."""
    part = Message("advice_parts.several", names=name_parts(segments))
    degrees = round_degrees(abs(shortfall_deg))
    if shortfall_deg < 0:
        return Message("advice_corrections.smaller", part=part, degrees=degrees)
    return Message("advice_corrections.larger", part=part, degrees=degrees)


def say_timing(segments: Iterable[str], lag_ms: float | None, where: Message) -> Message:
    """Name lateness or earliness: ``you were 0.2 s late with both legs at 0:31``."""
    names = tuple(segments)
    if lag_ms is None or not math.isfinite(lag_ms):
        return Message("advice.out_of_time", where=where)
    late = lag_ms > 0
    seconds = round(max(round(abs(lag_ms) / 1000.0 / _STEP_S), 1) * _STEP_S, 2)
    if not names or len(names) == len(SEGMENT_NAMES):
        return Message("advice.late" if late else "advice.early", seconds=seconds, where=where)
    code = "advice.late_with" if late else "advice.early_with"
    return Message(code, who=name_parts(names), seconds=seconds, where=where)


def round_degrees(degrees: float) -> int:
    """Round to 5 degrees, 5 at least."""
    return int(max(round(degrees / _STEP_DEG), 1) * _STEP_DEG)


def format_moment(seconds: float) -> str:
    """Format a moment as the counter of a player: ``m:ss``."""
    if not math.isfinite(seconds):
        return "–"
    whole = max(int(seconds), 0)
    return f"{whole // 60}:{whole % 60:02d}"


def say_where(times: Sequence[float], furi: Sequence[int | None], labels: Sequence[str]) -> Message:
    """Name moments and their figures.

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
    found = {labels[number] for number in numbers}
    if len(found) == 1 and len(numbers) == sum(label in found for label in labels):
        return Message("advice_when.every_time", numbers=named)
    return Message("advice_when.in_figures", numbers=named, time=moments[0])
