"""The top of the page: who against whom, the grade and how sure it is, the three worst moments in words."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from dousa.app.report._marks import draw_mark
from dousa.app.report._moments import pick_worst
from dousa.app.report._svg import element, format_number
from dousa.evaluation._types import Assessment, ErrorEvent
from dousa.evaluation.words import KIND_WORDS, format_time

__all__ = ["build_event_button", "build_events", "build_header", "make_title", "strip_time"]


def make_title(assessment: Assessment, words: Mapping[str, str]) -> str:
    """Who against whom."""
    return words["title"].format(
        performance=assessment.performance.name or words["unnamed_performance"],
        reference=assessment.reference.name or words["unnamed_reference"],
    )


def strip_time(says: str, *moments: float) -> str:
    """A sentence without the time at its beginning, where the time stands beside it already."""
    for moment in moments:
        for mark in (", ", " "):
            says = says.removeprefix(format_time(moment) + mark)
    return says


def build_header(
    assessment: Assessment, title: str, warnings: tuple[str, ...], words: Mapping[str, str], language: str
) -> str:
    """Title, grade, facts, worst moments and warnings."""
    head = element("p", {"class": "overline"}, words["overline"]) + element("h1", None, title)
    parts = [
        element("div", {"class": "heading"}, inner=head),
        _grade(assessment, words),
        _worst(assessment, words, language),
        _facts(assessment, words, language),
        _warnings(warnings, words),
    ]
    return element("header", {"class": "top"}, inner="".join(parts))


def _grade(assessment: Assessment, words: Mapping[str, str]) -> str:
    score = min(max(assessment.score, 0.0), 100.0) if math.isfinite(assessment.score) else 0.0
    number = format_number(assessment.score, 0)
    figure = element("span", {"class": "number"}, number) + element("span", {"class": "of"}, words["out_of"])
    meter = element(
        "div", {"class": "meter", "aria-hidden": "true"}, inner=element("i", {"style": f"width:{score:.1f}%"})
    )
    if assessment.calibrated:
        text = words["calibrated"].format(count=assessment.n_references)
        state = element("p", {"class": "badge sure"}, text)
        note = ""
    else:
        state = element("p", {"class": "badge unsure"}, words["uncalibrated"])
        note = element(
            "p", {"class": "note"}, words["uncalibrated_note"].format(count=assessment.n_references)
        )
    inner = (
        element("h2", None, words["grade"])
        + element("div", {"class": "figures"}, inner=figure + state)
        + meter
        + element("p", {"class": "formula"}, assessment.score_formula)
        + note
    )
    css = "card grade" + ("" if assessment.calibrated else " uncalibrated")
    return element("section", {"class": css}, inner=inner)


def build_event_button(k: int, event: ErrorEvent, words: Mapping[str, str], language: str) -> str:
    """One error as a button: mark, time, kind, words."""
    times = f"{format_time(event.start_s)}–{format_time(event.end_s)}"
    says = strip_time(event.says, event.start_s, event.worst_s)
    inner = (
        draw_mark(event.kind, words)
        + element("span", {"class": "when"}, times)
        + element("span", {"class": "kind"}, KIND_WORDS[language][event.kind])
        + element("span", {"class": "says"}, says)
    )
    return element(
        "button", {"type": "button", "class": f"event {event.kind}", "data-event": str(k)}, inner=inner
    )


def _worst(assessment: Assessment, words: Mapping[str, str], language: str) -> str:
    picks = pick_worst(assessment, 3)
    if picks:
        items = "".join(
            element("li", None, inner=build_event_button(k, assessment.events[k], words, language))
            for k in picks
        )
        content = element("ol", {"class": "worst-list", "id": "worst"}, inner=items)
        content += element("p", {"class": "note"}, words["worst_help"])
    else:
        content = element("p", {"class": "good"}, words["worst_none"])
    return element("section", {"class": "card worst"}, inner=element("h2", None, words["worst"]) + content)


def _tempo(tempo: float, words: Mapping[str, str]) -> str:
    change = 100.0 * (tempo - 1.0)
    if not math.isfinite(change):
        return "–"
    if abs(change) < 0.5:
        return words["tempo_same"]
    return words["tempo_slow" if change > 0 else "tempo_fast"].format(percent=format_number(abs(change), 0))


def _median_lag(assessment: Assessment, words: Mapping[str, str]) -> str:
    known = assessment.lag[np.isfinite(assessment.lag)]
    if not len(known):
        return "–"
    lag = round(1000.0 * float(np.median(known)))
    if abs(lag) < 10:
        return words["lag_even"]
    return words["lag_late" if lag > 0 else "lag_early"].format(ms=abs(lag))


def _facts(assessment: Assessment, words: Mapping[str, str], language: str) -> str:
    length = words["fact_length_value"].format(
        performance=format_time(assessment.performance.duration),
        reference=format_time(assessment.reference.duration),
    )
    pairs = [
        (words["fact_length"], element("span", None, length)),
        (words["fact_tempo"], element("span", None, _tempo(assessment.tempo, words))),
        (words["fact_lag"], element("span", None, _median_lag(assessment, words))),
        (words["fact_references"], element("span", None, str(assessment.n_references))),
        (words["fact_furi"], element("span", None, str(len(assessment.furi)))),
        (words["fact_errors"], _counts(assessment, words, language)),
    ]
    items = "".join(
        element("div", None, inner=element("dt", None, name) + element("dd", None, inner=value))
        for name, value in pairs
    )
    return element("dl", {"class": "facts", "aria-label": words["facts"]}, inner=items)


def _counts(assessment: Assessment, words: Mapping[str, str], language: str) -> str:
    out = []
    for kind, name in KIND_WORDS[language].items():
        count = sum(event.kind == kind for event in assessment.events)
        inner = (
            draw_mark(kind, words)
            + element("span", None, str(count))
            + element("span", {"class": "sr"}, f" {name}; ")
        )
        out.append(element("span", {"class": "count", "title": name}, inner=inner))
    inner = draw_mark("lapse", words) + element("span", None, str(len(assessment.lapses)))
    inner += element("span", {"class": "sr"}, f" {words['lapses']}")
    out.append(element("span", {"class": "count", "title": words["lapses"]}, inner=inner))
    return "".join(out)


def _warnings(warnings: tuple[str, ...], words: Mapping[str, str]) -> str:
    if not warnings:
        return ""
    items = "".join(element("li", None, text) for text in warnings)
    inner = element("h2", None, words["warnings"]) + element("ul", None, inner=items)
    return element("aside", {"class": "warnings"}, inner=inner)


def build_events(assessment: Assessment, words: Mapping[str, str], language: str) -> str:
    """All errors and lapses in order of time, as buttons."""
    from dousa.evaluation.words import LAPSE_WORDS

    items = [
        (event.start_s, build_event_button(k, event, words, language))
        for k, event in enumerate(assessment.events)
    ]
    for k, lapse in enumerate(assessment.lapses):
        times = format_time(lapse.start_s)
        if lapse.end_s - lapse.start_s >= 0.05:
            times += f"–{format_time(lapse.end_s)}"
        inner = (
            draw_mark("lapse", words)
            + element("span", {"class": "when"}, times)
            + element("span", {"class": "kind"}, LAPSE_WORDS[language].get(lapse.kind, lapse.kind))
            + element("span", {"class": "says"}, strip_time(lapse.says, lapse.start_s))
        )
        tag = {"type": "button", "class": "event lapse", "data-lapse": str(k)}
        items.append((lapse.start_s, element("button", tag, inner=inner)))
    if not items:
        return element("p", {"class": "good"}, words["events_none"])
    items.sort(key=lambda item: item[0] if math.isfinite(item[0]) else math.inf)
    return element(
        "ol",
        {"class": "event-list", "id": "events"},
        inner="".join(element("li", None, inner=i) for _, i in items),
    )
