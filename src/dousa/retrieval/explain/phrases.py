"""Describe the tests of a forest in plain sentences, with seconds and familiar units.

A sentence is a message made of messages: a clause ("the right hand is higher than usual"), an interval, the
measurement, and the bound of the other clips. The name of a channel selects its clause.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dousa.messages import Message
from dousa.retrieval.features.channels import Channel

_MOST, _MANY = 0.5, 0.25


def share_away(away: Any, others: Any, few: float = 4.0) -> Any:
    """Return the share of the ``others`` of a test that went the other way, ``away``; both numbers or arrays.

    ``few`` clips are added to the others, so that the last few of a tree do not dominate.
    """
    return away / (others + few)


@dataclass(frozen=True, slots=True)
class Fact:
    """A test that a clip passes, unlike most others.

    Parameters
    ----------
    channel, kind : what was measured; the kind is ``"mean"``, ``"spread"`` or ``"trend"``.
    above : whether the value lies above the threshold.
    start, end : s, the interval; ``whole`` if that is the whole clip.
    value, threshold : in the unit of the channel.
    others, away : number of other clips compared, and of those on the other side of the threshold.
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
        """Share of the others on the other side, reduced if they are few."""
        return float(share_away(self.away, self.others))


@dataclass(frozen=True, slots=True)
class _Form:
    """Codes of the clauses of a kind of channel.

    Parameters
    ----------
    mean : of a large and of a small mean.
    varies : of the spread.
    trend : of a rise and of a fall.
    signs : names of a mean above and below 0; None without a direction.
    ways : names of a change above and below 0.
    measure : of a mean with one direction only.

    If ways and signs are the same, the clause names the direction.
    """

    mean: tuple[str, str]
    varies: str = ""
    trend: tuple[str, str] = ("", "")
    signs: tuple[str | None, str] | None = None
    ways: tuple[str, str] | None = None
    measure: str | None = None


_LEFT_RIGHT = ("reasons.to_the_left", "reasons.to_the_right")
_UP_DOWN = ("reasons.upwards", "reasons.downwards")
_FORTH_BACK = ("reasons.forwards", "reasons.backwards")
_FORWARD_BACK = ("reasons.forward", "reasons.back")
_TURNS = ("reasons.counterclockwise", "reasons.clockwise")

_HEIGHT = _Form(
    ("reasons.higher", "reasons.lower"),
    "reasons.height_varies",
    ("reasons.rises", "reasons.sinks"),
    ("reasons.above", "reasons.below"),
    ("reasons.up", "reasons.down"),
)
_DEPTH = _Form(
    ("reasons.farther_forward", "reasons.farther_back"),
    "reasons.depth_varies",
    ("reasons.goes_forward", "reasons.goes_back"),
    ("reasons.in_front_of", "reasons.behind"),
    _FORWARD_BACK,
)
_LEFT = _Form(
    ("reasons.farther_left", "reasons.farther_right"),
    "reasons.side_varies",
    ("reasons.goes_left", "reasons.goes_right"),
    ("reasons.left_of", "reasons.right_of"),
    _LEFT_RIGHT,
)
_RIGHT = _Form(
    ("reasons.farther_right", "reasons.farther_left"),
    "reasons.side_varies",
    ("reasons.goes_right", "reasons.goes_left"),
    ("reasons.right_of", "reasons.left_of"),
    ("reasons.to_the_right", "reasons.to_the_left"),
)
_DISTANCE = _Form(
    ("reasons.farther_apart", "reasons.closer_together"),
    "reasons.distance_varies",
    ("reasons.moves_apart", "reasons.comes_together"),
    ways=("reasons.apart", "reasons.together"),
    measure="reasons.measured_apart",
)
_SPEED = _Form(
    ("reasons.faster", "reasons.slower"),
    "reasons.speed_varies",
    ("reasons.speeds_up", "reasons.slows_down"),
    ways=("reasons.way_faster", "reasons.way_slower"),
)
_UPRIGHT = _Form(
    ("reasons.less_upright", "reasons.more_upright"),
    "reasons.lean_varies",
    ("reasons.leans_away", "reasons.comes_upright"),
    ways=("reasons.away_from_upright", "reasons.towards_upright"),
    measure="reasons.measured_from_upright",
)
_DURATION = _Form(("reasons.longer", "reasons.shorter"))
_ANYTHING = _Form(
    ("reasons.larger", "reasons.smaller"),
    "reasons.varies",
    ("reasons.grows", "reasons.shrinks"),
    (None, "reasons.below_zero"),
    ("reasons.way_more", "reasons.way_less"),
)


def _directed(mean: str, varies: str, trend: str, ways: tuple[str, str]) -> _Form:
    return _Form((mean, mean), varies, (trend, trend), ways, ways)


def _moving(ways: tuple[str, str]) -> _Form:
    return _directed("reasons.moves_more", "reasons.speed_along_varies", "reasons.speeds_up_along", ways)


def _leaning(ways: tuple[str, str]) -> _Form:
    return _directed("reasons.leans_more", "reasons.lean_along_varies", "reasons.bends", ways)


def _heading(ways: tuple[str, str]) -> _Form:
    return _directed("reasons.goes_more", "reasons.goes_both_ways", "reasons.turns_round", ways)


def _curving(ways: tuple[str, str]) -> _Form:
    return _directed("reasons.curves_more", "reasons.curving_varies", "reasons.curve_turns", ways)


_TURNING = _directed("reasons.turns_more", "reasons.turning_varies", "reasons.turning_changes", _LEFT_RIGHT)

# Patterns of channel names -> form. Left, up and forward are x, y and z; the side view is from the performer's right.
_FORMS: tuple[tuple[str, _Form], ...] = (
    (r"distance (?P<part>.+) - (?P<other>.+)", _DISTANCE),
    (r"(?P<part>.+?) (?:to the )?left of (?P<other>.+)", _LEFT),
    (r"(?P<part>.+?) (?:to the )?right of (?P<other>.+)", _RIGHT),
    (r"(?P<part>.+?) above (?P<other>.+)", _HEIGHT),
    (r"(?P<part>.+?) in front of (?P<other>.+)", _DEPTH),
    (r"speed of (?P<part>.+)", _SPEED),
    (r"(?P<part>.+) moving to the left", _moving(_LEFT_RIGHT)),
    (r"(?P<part>.+) moving upwards", _moving(_UP_DOWN)),
    (r"(?P<part>.+) moving forwards", _moving(_FORTH_BACK)),
    (r"(?P<part>.+) turning to the left", _TURNING),
    (r"(?P<part>trunk) leaning left", _leaning(_LEFT_RIGHT)),
    (r"(?P<part>trunk) leaning forward", _leaning(_FORWARD_BACK)),
    (r"(?P<part>trunk) away from upright", _UPRIGHT),
    (r"(?P<part>.+) heading to the left", _heading(_LEFT_RIGHT)),
    (r"(?P<part>.+) heading upwards", _heading(_UP_DOWN)),
    (r"(?P<part>.+) heading forwards", _heading(_FORTH_BACK)),
    (r"(?P<part>.+) curving, (?P<view>seen from the front|seen from above)", _curving(_TURNS)),
    (
        r"(?P<part>.+) curving, (?P<view>seen from the side)",
        _curving(("reasons.clockwise", "reasons.counterclockwise")),
    ),
    (r"duration", _DURATION),
)

_VIEWS = {
    "seen from the front": "reasons.from_the_front",
    "seen from the side": "reasons.from_the_side",
    "seen from above": "reasons.from_above",
}

_SIDES = {"left": "reasons.left_part", "right": "reasons.right_part"}

_PARTS = {
    "lower foot": "reasons.lower_foot",
    "shoulder": "reasons.shoulder",
    "upper arm": "reasons.upper_arm",
    "elbow": "reasons.elbow",
    "forearm": "reasons.forearm",
    "wrist": "reasons.wrist",
    "hand": "reasons.hand",
    "hip": "reasons.hip",
    "thigh": "reasons.thigh",
    "knee": "reasons.knee",
    "shank": "reasons.shank",
    "ankle": "reasons.ankle",
    "foot": "reasons.foot",
    "toe": "reasons.toe",
    "head": "reasons.head",
    "neck": "reasons.neck",
    "spine": "reasons.spine",
    "pelvis": "reasons.pelvis",
    "trunk": "reasons.trunk",
    "shoulder breadth": "reasons.shoulder_breadth",
    "hip breadth": "reasons.hip_breadth",
    "body": "reasons.body",
}

# Unit -> factor of a value, digits, code of a value, code of a bound.
_UNITS = {
    "body heights": (1.0, 2, "reasons.body_heights", "reasons.bound_body_heights"),
    "body heights a second": (1.0, 2, "reasons.body_heights_a_second", "reasons.bound_body_heights"),
    "radians": (180.0 / np.pi, 0, "reasons.degrees", "reasons.bound_degrees"),
    "radians a second": (180.0 / np.pi, 0, "reasons.degrees_a_second", "reasons.bound_degrees"),
    "share of its speed": (100.0, 0, "reasons.percent_of_speed", "reasons.bound_percent"),
    "s": (1.0, 1, "reasons.seconds", "reasons.bound_seconds"),
}


def say_fact(fact: Fact) -> Message:
    """Return a sentence without its full stop: "the right hand is higher than usual from 0.4 s to 1.1 s: ..."."""
    return _say([fact], _when(fact))


def say_shared_fact(fact: Fact, other: Fact) -> Message:
    """Describe a fact of two clips; ``other`` has the interval and the value of the second."""
    when = _when(fact)
    if not fact.whole and abs(other.start - fact.start) + abs(other.end - fact.end) >= 0.1:
        when = Message("reasons.when_both", when=when, there=_when(other))
    return _say([fact, other], when)


def _say(facts: Sequence[Fact], when: Message) -> Message:
    fact = facts[0]
    form, named = _find_form(fact.channel.name)
    clause = _say_clause(facts, form, named)
    signs = {"mean": form.signs, "trend": form.ways}.get(fact.kind)
    others = _say_others(facts, signs, named.get("other"))
    values = _say_values(facts, signs, named.get("other"))
    if form is _DURATION:
        return Message("reasons.said", clause=clause, measured=values, others=others)
    if fact.kind == "mean" and form.measure is not None:
        values = Message(form.measure, amount=values)
    code = {"mean": "reasons.average", "spread": "reasons.spread", "trend": "reasons.change"}[fact.kind]
    measured = Message(code, values=values)
    return Message("reasons.said_when", clause=clause, when=when, measured=measured, others=others)


def _say_clause(facts: Sequence[Fact], form: _Form, named: dict[str, Message]) -> Message:
    """Return "the right hand is higher than usual"; a trend takes the direction that all facts share."""
    fact = facts[0]
    usual = Message("reasons.than_usual" if fact.share >= _MOST else "reasons.than_many")
    names = {name: value for name, value in named.items() if name != "other" or form is _DISTANCE}
    if fact.kind == "mean" or form is _DURATION:
        code, second = form.mean[not fact.above], not fact.above
    else:
        second = fact.kind == "trend" and all(each.value <= 0 for each in facts)
        code = form.varies if fact.kind == "spread" else form.trend[second]
        names["more"] = Message("reasons.more" if fact.above != second else "reasons.less")
    if form.signs is not None and form.signs == form.ways:
        names |= {"way": Message(form.ways[second]), "back": Message(form.ways[not second])}
    return Message(code, usual=usual, **names)


def _say_others(facts: Sequence[Fact], signs: tuple[str | None, str] | None, other: Message | None) -> Message:
    """Describe the others: beyond the threshold, with a direction only if it differs."""
    fact = facts[0]
    who = (
        "reasons.others_most"
        if fact.share >= _MOST
        else "reasons.others_many"
        if fact.share >= _MANY
        else "reasons.others_some"
    )
    factor, _, _, code = _find_unit(fact)
    number = factor * fact.threshold
    text = f"{abs(number):.{_count_digits(facts)}f}"
    it = None if other is None else Message("reasons.it")
    zero = signs[int(fact.above)] if signs is not None and not float(text) else None
    if zero is not None:
        return Message(who, bound=_say_way(zero, it))
    positive = number >= 0 or signs is None
    bound = Message(code, number=text)
    if signs is not None and any((each.value >= 0) != positive for each in facts):
        bound = _add_way(bound, signs[0 if positive else 1], it)
    way = "reasons.more_than" if fact.above != positive else "reasons.less_than"
    return Message(who, bound=Message(way, bound=bound))


def _say_values(facts: Sequence[Fact], signs: tuple[str | None, str] | None, other: Message | None) -> Message:
    """Return "0.42 and 0.45 body heights above the pelvis"; no direction if the clause has it for all."""
    factor, _, code, _ = _find_unit(facts[0])
    digits = _count_digits(facts)
    numbers = [f"{abs(factor * fact.value):.{digits}f}" for fact in facts]
    ways = [None if signs is None else signs[bool(fact.value < 0)] for fact in facts]
    if len(set(ways)) == 1:
        amount = Message(code, numbers=tuple(dict.fromkeys(numbers)))
        return amount if facts[0].kind == "trend" else _add_way(amount, ways[0], other)
    pairs = zip(numbers, ways, strict=True)
    return Message(
        "reasons.both",
        values=tuple(_add_way(Message(code, numbers=(text,)), way, other) for text, way in pairs),
    )


def _add_way(amount: Message, way: str | None, other: Message | None) -> Message:
    return amount if way is None else Message("reasons.amount_way", amount=amount, way=_say_way(way, other))


def _say_way(way: str, other: Message | None) -> Message:
    return Message(way) if other is None else Message(way, other=other)


def _find_unit(fact: Fact) -> tuple[float, int, str, str]:
    return _UNITS.get(fact.channel.unit, (1.0, 2, "reasons.number", "reasons.bound_number"))


def _count_digits(facts: Sequence[Fact]) -> int:
    """Return the usual decimals, plus one where a value would equal the threshold."""
    factor, digits, _, _ = _find_unit(facts[0])
    bound = f"{abs(factor * facts[0].threshold):.{digits}f}"
    return digits + any(f"{abs(factor * fact.value):.{digits}f}" == bound for fact in facts)


def _when(fact: Fact) -> Message:
    if fact.whole:
        return Message("reasons.whole")
    digits = 1 if fact.end - fact.start >= 0.195 else 2
    return Message("reasons.when", start=f"{fact.start:.{digits}f}", end=f"{fact.end:.{digits}f}")


def _find_form(name: str) -> tuple[_Form, dict[str, Message]]:
    """Return the clauses of a channel, and the parts that it names: ``part``, ``other``, ``view``."""
    matches = ((re.fullmatch(pattern, name, re.DOTALL), form) for pattern, form in _FORMS)
    match, form = next(((match, form) for match, form in matches if match), (None, _ANYTHING))
    if match is None:
        return form, {"part": Message("text.verbatim", text=name)}
    named = {key: say_part(text) for key, text in match.groupdict().items() if key != "view"}
    if "view" in match.groupdict():
        named["view"] = Message(_VIEWS[match["view"]])
    return form, named


def say_part(name: str) -> Message:
    """Name a joint or a part of the body: ``left_forearm`` is "the left forearm"; one that is not known as it is."""
    name = name.removeprefix("the ").replace("_", " ")
    side, _, bare = name.partition(" ")
    code, bare = (_SIDES[side], bare) if side in _SIDES else ("reasons.part", name)
    part = Message(_PARTS[bare]) if bare in _PARTS else Message("text.verbatim", text=bare)
    return Message(code, part=part)
