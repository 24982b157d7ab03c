"""Names of segments, errors and lapses, and sentences of a teacher about them.

The Japanese names of the four errors are those of Yamane and Shakunaga, section 2.3.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import TypeGuard

from dousa.errors import OptionError
from dousa.messages import LANGUAGES, Message

_SEGMENTS = (
    "trunk left_upper_arm left_forearm right_upper_arm right_forearm left_thigh left_shank right_thigh right_shank"
)
SEGMENT_NAMES: Mapping[str, Message] = {name: Message(f"body_segments.{name}") for name in _SEGMENTS.split()}
"""Segment -> its name."""

KINDS: Mapping[str, Message] = {
    kind: Message(f"error_kinds.{kind}") for kind in ("global", "partial", "incomplete", "shift")
}
"""Kind of error -> its name."""

CAUSES: tuple[str, ...] = (
    "late",
    "early",
    "exchanged",
    "left_for_right",
    "right_for_left",
    "copied",
    "compensation",
)
"""What is known of an error besides its class: late or early by no sure number; left and right exchanged, or one used
for the other that should have moved; a limb that does what the other side should; movement where the reference has
none."""

LAPSE_KINDS: Mapping[str, Message] = {
    code.replace("_", " ").replace("lead ", "lead-"): Message(f"lapse_kinds.{code}")
    for code in ("stop", "skip", "repeat", "late_start", "early_end", "lead_in", "lead_out")
}
"""Kind of lapse -> its name."""

# The larger whole first, and the segments that it takes.
_WHOLES: Mapping[str, tuple[str, ...]] = {
    "both_arms": ("left_upper_arm", "left_forearm", "right_upper_arm", "right_forearm"),
    "left_arm": ("left_upper_arm", "left_forearm"),
    "right_arm": ("right_upper_arm", "right_forearm"),
    "both_upper_arms": ("left_upper_arm", "right_upper_arm"),
    "both_forearms": ("left_forearm", "right_forearm"),
    "both_legs": ("left_thigh", "left_shank", "right_thigh", "right_shank"),
    "left_leg": ("left_thigh", "left_shank"),
    "right_leg": ("right_thigh", "right_shank"),
    "both_thighs": ("left_thigh", "right_thigh"),
    "both_shanks": ("left_shank", "right_shank"),
}


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


def group_segments(segments: Iterable[str], table: str = "body_segments") -> tuple[Message, ...]:
    """Group segments to whole limbs, from the trunk to the legs; none is the whole body.

    Parameters
    ----------
    segments : of `SEGMENT_NAMES`.
    table : of the messages; ``"advice_parts"`` are the words of a teacher: ``the left arm``, ``both legs``.

    Raises
    ------
    OptionError : a segment that there is not.
    """
    return tuple(Message(f"{table}.{name}") for name in _list_wholes(segments))


def _list_wholes(segments: Iterable[str]) -> list[str]:
    left = set(segments)
    if unknown := left - set(SEGMENT_NAMES):
        raise OptionError("body_segments.unknown", known=tuple(SEGMENT_NAMES), names=unknown)
    if not left or len(left) == len(SEGMENT_NAMES):
        return ["whole_body"]
    # Each word stands where its first segment stands, so that the trunk comes before arms and legs.
    order = list(SEGMENT_NAMES)
    found: dict[str, int] = {}
    for name, members in _WHOLES.items():
        if left.issuperset(members):
            left.difference_update(members)
            found[name] = order.index(members[0])
    found |= {segment: order.index(segment) for segment in left}
    return sorted(found, key=found.__getitem__)


def describe_event(
    kind: str,
    segments: Iterable[str],
    *,
    lag_ms: float | None = None,
    shortfall_deg: float | None = None,
    shortfall_percent: float | None = None,
    deviation_deg: float | None = None,
    cause: str | None = None,
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
    cause : of `CAUSES`, or None.

    Raises
    ------
    OptionError : a kind or segment that there is not.
    """
    who = group_segments(segments)
    if cause is not None:
        return Message(f"error_causes.{cause}", who=who, degrees=-shortfall_deg if _is_number(shortfall_deg) else 0.0)
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
    if kind not in LAPSE_KINDS:
        raise OptionError("error_kinds.unknown", known=tuple(LAPSE_KINDS), kind=kind)
    own, missed = _say_seconds(end_s - start_s), _say_seconds(reference_end_s - reference_start_s)
    start, end = format_time(reference_start_s), format_time(reference_end_s)
    if kind == "skip":
        return Message("lapse.skip", missed=missed, start=start, end=end)
    if kind == "repeat":
        return Message("lapse.repeat", missed=missed, start=start, end=end)
    if kind in ("late start", "early end"):
        return Message("lapse.late_start" if kind == "late start" else "lapse.early_end", missed=missed)
    code = {"stop": "lapse.stop", "lead-in": "lapse.lead_in", "lead-out": "lapse.lead_out"}[kind]
    return Message(code, own=own)


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


_JOINTS: Mapping[str, Message] = {
    "both_arms": Message("advice_parts.both_elbows"),
    "left_arm": Message("advice_parts.left_elbow"),
    "right_arm": Message("advice_parts.right_elbow"),
    "both_legs": Message("advice_parts.both_knees"),
    "left_leg": Message("advice_parts.left_knee"),
    "right_leg": Message("advice_parts.right_knee"),
}


def name_parts(segments: Iterable[str]) -> tuple[Message, ...]:
    """Name parts of the body as a teacher does: ``the left arm``, ``both legs``."""
    return group_segments(segments, "advice_parts")


def say_correction(direction: str, segments: Iterable[str], amount_deg: float) -> Message:
    """Name one correction, without its moment: ``raise the left arm 25 deg higher``."""
    names = tuple(segments)
    code, degrees = f"advice_corrections.{direction}", round_degrees(amount_deg)
    if direction.startswith(("upright", "lean_", "turn_")):
        return Message(code, degrees=degrees)
    if direction in ("bend", "straighten"):
        return Message(code, part=_JOINTS[_list_wholes(names)[0]], degrees=degrees)
    return Message(code, part=Message("advice_parts.several", names=name_parts(names)), degrees=degrees)


def say_size(segments: Iterable[str], shortfall_deg: float) -> Message:
    """Name a movement that is too small, or too large if this is negative, without a direction."""
    part = Message("advice_parts.several", names=name_parts(segments))
    degrees = round_degrees(abs(shortfall_deg))
    code = "advice_corrections.smaller" if shortfall_deg < 0 else "advice_corrections.larger"
    return Message(code, part=part, degrees=degrees)


def say_timing(
    segments: Iterable[str], lag_ms: float | None, where: Message, cause: str | None = None, *, step_s: float = 0.05
) -> Message:
    """Name lateness or earliness in steps of 0.05 s: ``you were 0.2 s late with both legs at 0:31``.

    Where the number is not sure the cause is ``"late"`` or ``"early"``.
    """
    names = tuple(segments)
    if lag_ms is None or not math.isfinite(lag_ms):
        if cause is not None:
            said = "advice.is_late" if cause == "late" else "advice.is_early"
            return Message(said, who=name_parts(names), where=where)
        return Message("advice.out_of_time", where=where)
    late = lag_ms > 0
    seconds = round(max(round(abs(lag_ms) / 1000.0 / step_s), 1) * step_s, 2)
    if not names or len(names) == len(SEGMENT_NAMES):
        return Message("advice.late" if late else "advice.early", seconds=seconds, where=where)
    code = "advice.late_with" if late else "advice.early_with"
    return Message(code, who=name_parts(names), seconds=seconds, where=where)


def say_side(segments: Iterable[str], cause: str, where: Message) -> Message:
    """Name limbs that were exchanged, or that did what the other side should: ``you used the left arm ...``."""
    names = tuple(segments)
    if cause in ("left_for_right", "right_for_left"):
        used, _, meant = cause.partition("_for_")
        ours, theirs = ([name for name in names if name.startswith(side)] for side in (used, meant))
        return Message("advice.instead", who=name_parts(ours), other=name_parts(theirs), where=where)
    if cause == "copied":
        swapped = {"left": "right", "right": "left"}
        other = [f"{swapped[side]}_{part}" for side, _, part in (name.partition("_") for name in names)]
        return Message("advice.copied", who=name_parts(names), other=name_parts(other), where=where)
    return Message("advice.exchanged", who=name_parts(names), where=where)


def round_degrees(degrees: float) -> int:
    """Round to 5 degrees, 5 at least."""
    return max(round(degrees / 5.0), 1) * 5


def format_moment(seconds: float, tenths_s: float = 10.0) -> str:
    """Format a moment as the counter of a player, ``m:ss``; in the first ten seconds with its tenth."""
    if not math.isfinite(seconds) or seconds < tenths_s:
        return format_time(max(seconds, 0.0))
    whole = int(seconds)
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
