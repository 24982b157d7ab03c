"""The tests of a forest in words: plain, short, with seconds and units that a person can picture."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from dousa.retrieval.channels import Channel

__all__ = ["FEW", "Fact", "say_fact", "say_shared_fact"]

FEW = 4.0
"""Clips added to those that a test could have sent away, so that the last two of a tree do not count as most."""

_MOST, _MANY = 0.5, 0.25


@dataclass(frozen=True, slots=True)
class Fact:
    """What is true of a clip, and not of most others.

    Parameters
    ----------
    channel, kind : what was measured; the kind is ``"mean"``, ``"spread"`` or ``"trend"``.
    above : whether the value lies above the threshold.
    start, end : s, the interval; ``whole`` if that is the whole clip.
    value, threshold : in the unit of the channel.
    others, away : number of other clips that it was compared with, and of those on the other side of the threshold.
    """

    channel: Channel
    kind: str
    above: bool
    start: float
    end: float
    whole: bool
    value: float
    threshold: float
    others: int
    away: int

    @property
    def share(self) -> float:
        """Of the others on the other side; of few, cautiously."""
        return self.away / (self.others + FEW)


@dataclass(frozen=True, slots=True)
class _Words:
    """How to speak of a channel.

    Parameters
    ----------
    more, less : of a large and of a small mean: "the right hand is higher".
    signs : what a mean above and below 0 is called: ("above the pelvis", "below the pelvis").
    varies : of the spread: "the height of the right hand varies".
    rises, falls : of the trend.
    ways : what a change above and below 0 is called: ("up", "down").
    """

    more: str
    less: str
    signs: tuple[str, str]
    varies: str
    rises: str
    falls: str
    ways: tuple[str, str]


def say_fact(fact: Fact) -> str:
    """One fact as a sentence without its full stop: "the right hand is higher than usual from 0.4 s to 1.1 s: ..."."""
    return _say([fact], _when(fact))


def say_shared_fact(fact: Fact, other: Fact) -> str:
    """A fact that is true of two clips; ``other`` has the interval and the value of the second."""
    when = _when(fact)
    if not fact.whole and abs(other.start - fact.start) + abs(other.end - fact.end) >= 0.1:
        when += f" (there {_when(other)})"
    return _say([fact, other], when)


def _say(facts: Sequence[Fact], when: str) -> str:
    fact = facts[0]
    words = _find_words(fact.channel.name)
    signs = ("", "")
    if fact.kind == "spread":
        side, amount = words.varies + (" more" if fact.above else " less"), "by "
    elif fact.kind == "trend":
        side, amount, signs = _say_trend(facts, words), "by ", words.ways
    else:
        side, amount, signs = words.more if fact.above else words.less, "on average ", words.signs
    usual = " than usual" if fact.share >= _MOST else " than in many others"
    if fact.channel.name == "duration":
        when, amount = "", ""
    measured = _say_values(facts, signs, told=fact.kind == "trend")
    return f"{side}{usual}{when and ' '}{when}: {amount}{measured} ({_say_others(facts, signs)})"


def _say_trend(facts: Sequence[Fact], words: _Words) -> str:
    """ "The right hand rises more", "rises less" or "sinks more": by the direction in which all of them go."""
    if all(fact.value <= 0 for fact in facts):
        return words.falls + (" less" if facts[0].above else " more")
    return words.rises + (" more" if facts[0].above else " less")


def _say_others(facts: Sequence[Fact], signs: tuple[str, str]) -> str:
    """Where the others are: on the other side of the threshold; the direction only where it is another."""
    fact = facts[0]
    who = "most" if fact.share >= _MOST else "many" if fact.share >= _MANY else "some"
    number, unit = _convert(fact.threshold, fact.channel.unit)
    text = f"{abs(number):.{_count_digits(facts)}f}"
    up, down = (_IT.sub(r"\1 it", sign) for sign in signs)
    if any(signs) and not float(text):
        return f"{who} others: {down if fact.above else up}"
    positive = number >= 0 or not any(signs)
    same = all((each.value >= 0) == positive for each in facts)
    sign = "" if same else up if positive else down
    per_cent = " %" if unit.startswith("%") else ""
    return f"{who} others: {'more' if fact.above != positive else 'less'} than {text}{per_cent}{sign and ' '}{sign}"


_IT = re.compile("(above|below|of|in front of|behind) the .+")


def _say_values(facts: Sequence[Fact], signs: tuple[str, str], *, told: bool) -> str:
    """ "0.42 and 0.45 body heights above the pelvis"; no direction if it was ``told`` and is the same for all."""
    digits = _count_digits(facts)
    converted = [_convert(fact.value, fact.channel.unit) for fact in facts]
    numbers = [f"{abs(number):.{digits}f}" for number, _ in converted]
    ends = [signs[0] if number >= 0 else signs[1] for number, _ in converted]
    unit = f" {converted[0][1]}".rstrip()
    if len(set(ends)) == 1:
        end = "" if told or not ends[0] else f" {ends[0]}"
        return f"{' and '.join(dict.fromkeys(numbers))}{unit}{end}"
    return " and ".join(f"{number}{unit} {end}".rstrip() for number, end in zip(numbers, ends, strict=True))


def _convert(value: float, unit: str) -> tuple[float, str]:
    """In units that people picture: degrees for radians, per cent for shares."""
    if unit.startswith("radians"):
        return float(np.degrees(value)), unit.replace("radians", "degrees")
    if unit.startswith("share of"):
        return 100.0 * value, unit.replace("share", "%", 1)
    return value, unit


def _count_digits(facts: Sequence[Fact]) -> int:
    """Decimals as people say them, and one more where that tells a value from the threshold."""
    bound, unit = _convert(facts[0].threshold, facts[0].channel.unit)
    digits = 0 if unit.startswith(("degrees", "%")) else 1 if unit == "s" else 2
    numbers = (abs(_convert(fact.value, fact.channel.unit)[0]) for fact in facts)
    return digits + any(f"{number:.{digits}f}" == f"{abs(bound):.{digits}f}" for number in numbers)


def _when(fact: Fact) -> str:
    if fact.whole:
        return "over the whole motion"
    digits = 1 if fact.end - fact.start >= 0.195 else 2
    return f"from {fact.start:.{digits}f} s to {fact.end:.{digits}f} s"


def _the(part: str) -> str:
    return part if part.startswith("the ") else f"the {part}"


def _place(match: re.Match[str]) -> _Words:
    one, where, other = _the(match[1]), match[2], _the(match[3])
    if where == "above":
        signs = (f"above {other}", f"below {other}")
        name = f"the height of {one} varies"
        return _Words(
            f"{one} is higher", f"{one} is lower", signs, name, f"{one} rises", f"{one} sinks", ("up", "down")
        )
    if where == "in front of":
        signs = (f"in front of {other}", f"behind {other}")
        more, less = f"{one} is farther forward", f"{one} is farther back"
        ways, name = ("forward", "back"), f"{one} moves forward and back"
        return _Words(more, less, signs, name, f"{one} moves forward", f"{one} moves back", ways)
    side, opposite = ("left", "right") if "left" in where else ("right", "left")
    signs = (f"to the {side} of {other}", f"to the {opposite} of {other}")
    more, less = f"{one} is farther to the {side}", f"{one} is farther to the {opposite}"
    ways = (f"to the {side}", f"to the {opposite}")
    rises, falls = f"{one} moves {ways[0]}", f"{one} moves {ways[1]}"
    return _Words(more, less, signs, f"{one} moves sideways", rises, falls, ways)


def _distance(match: re.Match[str]) -> _Words:
    pair = f"{_the(match[1])} and {_the(match[2])}"
    return _Words(
        f"{pair} are farther apart",
        f"{pair} are closer together",
        ("apart", "apart"),
        f"the distance of {pair} varies",
        f"{pair} move apart",
        f"{pair} come together",
        ("apart", "together"),
    )


def _speed(match: re.Match[str]) -> _Words:
    one = _the(match[1])
    changes = (f"{one} speeds up", f"{one} slows down")
    return _Words(
        f"{one} moves faster",
        f"{one} moves slower",
        ("", ""),
        f"the speed of {one} varies",
        *changes,
        ("faster", "slower"),
    )


_OPPOSITE = {
    "to the left": "to the right",
    "upwards": "downwards",
    "forwards": "backwards",
    "left": "right",
    "forward": "back",
}


def _moving(match: re.Match[str]) -> _Words:
    one, way = _the(match[1]), match[2]
    signs = (way, _OPPOSITE[way])
    return _Words(
        f"{one} moves more {way}",
        f"{one} moves more {signs[1]}",
        signs,
        f"the speed of {one} {way} varies",
        f"{one} speeds up {way}",
        f"{one} speeds up {signs[1]}",
        signs,
    )


def _turning(match: re.Match[str]) -> _Words:
    one = _the(match[1])
    signs = ("to the left", "to the right")
    return _Words(
        f"{one} turns more to the left",
        f"{one} turns more to the right",
        signs,
        f"the turning of {one} varies",
        f"{one} turns more and more to the left, it changes",
        f"{one} turns more and more to the right, it changes",
        signs,
    )


def _leaning(match: re.Match[str]) -> _Words:
    way, back = match[1], _OPPOSITE[match[1]]
    signs = ("to the left", "to the right") if way == "left" else ("forward", "back")
    return _Words(
        f"the trunk leans more {signs[0]}",
        f"the trunk leans more {signs[1]}",
        signs,
        f"the lean of the trunk {way} and {back} varies",
        f"the trunk bends {signs[0]}",
        f"the trunk bends {signs[1]}",
        signs,
    )


def _upright(match: re.Match[str]) -> _Words:
    return _Words(
        "the trunk is farther from upright",
        "the trunk is more upright",
        ("from upright", "from upright"),
        "the lean of the trunk varies",
        "the trunk leans away from upright",
        "the trunk comes upright",
        ("away from upright", "towards upright"),
    )


_TURNS = {
    "seen from the front": ("counterclockwise", "clockwise"),
    "seen from the side": ("clockwise", "counterclockwise"),
    "seen from above": ("counterclockwise", "clockwise"),
}
"""Left, up and forward are x, y and z; from the side is from the performer's right."""


def _curving(match: re.Match[str]) -> _Words:
    one, plane = _the(match[1]), match[2]
    seen = "seen from the right side" if plane == "seen from the side" else plane
    signs = _TURNS[plane]
    ways = tuple(f"{one} curves {way}" for way in signs)
    return _Words(
        f"{seen}, {ways[0]} more",
        f"{seen}, {ways[1]} more",
        signs,
        f"{seen}, the curving of {one} varies",
        f"{seen}, {one} turns from {signs[1]} to {signs[0]}",
        f"{seen}, {one} turns from {signs[0]} to {signs[1]}",
        signs,
    )


def _heading(match: re.Match[str]) -> _Words:
    one, way, back = _the(match[1]), match[2], _OPPOSITE[match[2]]
    return _Words(
        f"{one} goes {way} more",
        f"{one} goes {back} more",
        (way, back),
        f"{one} goes {way} and {back}",
        f"{one} turns from going {back} to going {way}",
        f"{one} turns from going {way} to going {back}",
        (way, back),
    )


def _duration(match: re.Match[str]) -> _Words:
    return _Words("the motion is longer", "the motion is shorter", ("", ""), "", "", "", ("", ""))


def _anything(match: re.Match[str]) -> _Words:
    name = match[0]
    return _Words(
        f"{name} is larger",
        f"{name} is smaller",
        ("", "below zero"),
        f"{name} varies",
        f"{name} grows",
        f"{name} shrinks",
        ("more", "less"),
    )


_PATTERNS: tuple[tuple[str, Callable[[re.Match[str]], _Words]], ...] = (
    (r"distance (.+) - (.+)", _distance),
    (r"(.+?) ((?:to the )?(?:left|right) of|above|in front of) (.+)", _place),
    (r"speed of (.+)", _speed),
    (r"(.+) moving (to the left|upwards|forwards)", _moving),
    (r"(.+) turning to the left", _turning),
    (r"trunk leaning (left|forward)", _leaning),
    (r"trunk away from upright", _upright),
    (r"(.+) heading (to the left|upwards|forwards)", _heading),
    (r"(.+) curving, (seen from (?:the front|the side|above))", _curving),
    (r"duration", _duration),
    (r".*", _anything),
)


def _find_words(name: str) -> _Words:
    matches = ((re.fullmatch(pattern, name, re.DOTALL), make) for pattern, make in _PATTERNS)
    return next(make(match) for match, make in matches if match)
