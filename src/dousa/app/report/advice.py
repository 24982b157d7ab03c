"""What to work on: a sentence each, and beside it the picture of the moment with an arrow for the direction."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from dousa.app.report.figures import draw_moment, view_moment
from dousa.app.report.markup import draw_mark, element
from dousa.evaluation.advice.advice import Advice, advise, praise
from dousa.evaluation.grade.result import Assessment
from dousa.evaluation.posture.posture import LIMBS, SEGMENTS
from dousa.evaluation.words import KINDS, LAPSE_KINDS

_SIZE = (330.0, 210.0)


def build_advice(assessment: Assessment, words: Mapping[str, str], language: str) -> str:
    """The most important things to do differently, as buttons, and what went well."""
    said = advise(assessment, "brief")
    told = [one for one in said if one.event is not None or one.lapse is not None]
    parts = [element("p", {"class": "good"}, one.message.render(language)) for one in said if one not in told]
    if told:
        items = "".join(element("li", None, inner=_tip(assessment, one, words, language)) for one in told)
        parts.append(element("ol", {"class": "advice-list", "id": "advice"}, inner=items))
        parts.append(element("p", {"class": "note"}, words["advice_help"]))
    good = praise(assessment)
    if good is not None and good.message not in [one.message for one in said]:
        parts.append(element("p", {"class": "good"}, good.message.render(language)))
    return "".join(parts)


def _tip(assessment: Assessment, advice: Advice, words: Mapping[str, str], language: str) -> str:
    """One sentence as a button that plays its moment."""
    if advice.event is None:
        kind, name = "lapse", LAPSE_KINDS[advice.about]
        tag = {"data-lapse": str(advice.lapse)}
    else:
        kind, name = advice.about, KINDS[advice.about]
        tag = {"data-event": str(advice.event)}
    label = draw_mark(kind, words) + element("span", None, name.render(language))
    inner = element("span", {"class": "tip-kind"}, inner=label)
    inner += element("span", {"class": "says"}, advice.message.render(language))
    text = element("span", {"class": "tip-words"}, inner=inner)
    picture = _draw(assessment, advice, words, language)
    if picture:
        picture = element("span", {"class": "tip-picture"}, inner=picture)
    return element("button", {"type": "button", "class": f"tip {kind}", **tag}, inner=picture + text)


def _draw(assessment: Assessment, advice: Advice, words: Mapping[str, str], language: str) -> str:
    """Both dancers at the moment of a sentence; empty where there is nothing to show beside each other."""
    if advice.event is None or not (math.isfinite(advice.time_s) and math.isfinite(advice.reference_s)):
        return ""
    event = assessment.events[advice.event]
    wrong = [name for one in advice.corrections for name in one.segments]
    shown = replace(
        event,
        worst_s=advice.time_s,
        reference_s=advice.reference_s,
        segments=tuple(name for name in SEGMENTS if name in wrong) or event.segments,
    )
    view = view_moment(assessment, shown)
    return draw_moment(assessment, shown, view, words, language, size=_SIZE, arrows=_split_limbs(wrong))


def _split_limbs(segments: Sequence[str]) -> list[list[str]]:
    """The same segments, limb by limb."""
    limbs = [[SEGMENTS[index] for index in limb if SEGMENTS[index] in segments] for limb in LIMBS.values()]
    return [limb for limb in limbs if limb]
