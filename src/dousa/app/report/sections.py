"""Sections of the report: advice, segments, furi with their eigenspaces, worst moments, how to read the page."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from dousa.app.drawing.markup import (
    build_cells,
    build_heads,
    build_list,
    build_terms,
    build_warnings,
    draw_mark,
    element,
    escape,
    format_grade,
    format_number,
    frame_table,
)
from dousa.app.report.curves import build_details, build_table
from dousa.app.report.figures import (
    compute_residuals,
    compute_swings,
    count_axes,
    draw_moment,
    draw_shapes,
    draw_strip,
    estimate_mean_heading,
    pick_worst,
    view_moment,
)
from dousa.arrays import FloatArray
from dousa.evaluation.advice.advice import Advice, advise, praise
from dousa.evaluation.grade.result import Assessment, ErrorEvent, FuriAssessment
from dousa.evaluation.posture.posture import LIMBS, SEGMENTS
from dousa.evaluation.words import (
    KINDS,
    LAPSE_KINDS,
    SEGMENT_NAMES,
    describe_heading,
    describe_segments,
    format_time,
    name_all,
)


def make_title(assessment: Assessment, words: Mapping[str, str]) -> str:
    """Who against whom."""
    return words["title"].format(
        performance=assessment.performance.name or words["unnamed_performance"],
        reference=assessment.reference.name or words["unnamed_reference"],
    )


def build_header(
    assessment: Assessment, title: str, warnings: tuple[str, ...], words: Mapping[str, str], language: str
) -> str:
    """Title, grade and warnings."""
    head = element("p", "overline", words["overline"]) + element("h1", None, title)
    parts = element("div", "heading", inner=head) + _grade(assessment, words, language)
    return element("header", "top", inner=parts + build_warnings(words["warnings"], warnings))


def _grade(assessment: Assessment, words: Mapping[str, str], language: str) -> str:
    formula = element("p", "formula", assessment.score_formula.render(language))
    if not math.isfinite(assessment.score):  # instead of a number why there is none, as for another dance
        why = "another_dance" if assessment.is_other_dance else "no_grade"
        figures = element("div", "figures", inner=element("p", "badge unsure", words[why]))
        inner = element("h2", None, words["grade"]) + figures + formula
        return element("section", "card grade uncalibrated", inner=inner)
    score = min(max(assessment.score, 0.0), 100.0)
    figure = element("span", "number", format_grade(assessment.score)) + element("span", "of", words["out_of"])
    low, high = (format_grade(value) for value in assessment.score_interval)
    if assessment.calibrated:
        state = element("p", "badge sure", words["calibrated"].format(count=assessment.n_references))
    else:
        state = element("p", "badge unsure", words["uncalibrated"])
    parts = (
        element("h2", None, words["grade"]),
        element("p", "note", words["coverage"].format(percent=format_number(100.0 * assessment.coverage, 0))),
        element("div", "figures", inner=figure + state),
        element("div", {"class": "meter", "aria-hidden": "true"}, inner=element("i", {"style": f"width:{score:.1f}%"})),
        element("p", "note", words["interval"].format(low=low, high=high)),
        build_details(words["formula_title"], formula),
    )
    if assessment.calibrated:
        return element("section", "card grade", inner=parts)
    note = element("p", "note", words["uncalibrated_note"].format(count=assessment.n_references))
    return element("section", "card grade uncalibrated", inner=(*parts, note))


def build_event_button(k: int, event: ErrorEvent, words: Mapping[str, str], language: str) -> str:
    """One error as a button: mark, time, kind, words."""
    times = f"{format_time(event.start_s)}–{format_time(event.end_s)}"
    texts = (times, KINDS[event.kind].render(language), event.says_in_furi.render(language))
    return _build_button(event.kind, {"data-event": str(k)}, texts, words)


def _build_button(kind: str, place: dict[str, str], texts: tuple[str, str, str], words: Mapping[str, str]) -> str:
    inner = (element("span", css, text) for css, text in zip(("when", "kind", "says"), texts, strict=True))
    tag = {"type": "button", "class": f"event {kind}", **place}
    return element("button", tag, inner=(draw_mark(kind, words), *inner))


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


def build_facts(assessment: Assessment, words: Mapping[str, str], language: str) -> str:
    """Length, tempo, timing, and how many errors of each kind."""
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
    return build_terms(
        ((escape(name), value) for name, value in pairs), {"class": "facts", "aria-label": words["facts"]}
    )


def _counts(assessment: Assessment, words: Mapping[str, str], language: str) -> str:
    out = []
    for kind, name in name_all(KINDS, language).items():
        count = sum(event.kind == kind for event in assessment.events)
        inner = draw_mark(kind, words) + element("span", None, str(count)) + element("span", "sr", f" {name}; ")
        out.append(element("span", {"class": "count", "title": name}, inner=inner))
    inner = draw_mark("lapse", words) + element("span", None, str(len(assessment.lapses)))
    inner += element("span", "sr", f" {words['lapses']}")
    out.append(element("span", {"class": "count", "title": words["lapses"]}, inner=inner))
    return "".join(out)


def build_events(assessment: Assessment, words: Mapping[str, str], language: str) -> str:
    """All errors and lapses in order of time, as buttons."""
    items = [
        (event.start_s, build_event_button(k, event, words, language)) for k, event in enumerate(assessment.events)
    ]
    for k, lapse in enumerate(assessment.lapses):
        times = format_time(lapse.start_s)
        if lapse.end_s - lapse.start_s >= 0.05:
            times += f"–{format_time(lapse.end_s)}"
        texts = (times, LAPSE_KINDS[lapse.kind].render(language), lapse.message.render(language))
        items.append((lapse.start_s, _build_button("lapse", {"data-lapse": str(k)}, texts, words)))
    if not items:
        return element("p", "good", words["not_looked_for" if assessment.is_other_dance else "events_none"])
    items.sort(key=lambda item: item[0] if math.isfinite(item[0]) else math.inf)
    return build_list((item for _, item in items), {"class": "event-list", "id": "events"}, "ol")


def build_furi(assessment: Assessment, words: Mapping[str, str], language: str) -> str:
    """Table of all furi, and pictures of each different one."""
    if not assessment.furi:
        return element("p", None, words["furi_none"])
    text = element("p", "lead", words["furi_text"])
    key = element("p", "note", words["range_key"])
    shapes = element("h3", None, words["shapes_title"]) + element("p", "lead", words["shapes_text"])
    groups: dict[str, list[int]] = {}
    for number, furi in enumerate(assessment.furi):
        groups.setdefault(furi.label, []).append(number)
    for k, numbers in enumerate(groups.values()):  # the first three are unfolded
        shapes += _shape(assessment, numbers, k < 3, words, language)
    return text + _furi_table(assessment, words, language) + key + shapes


def _furi_table(assessment: Assessment, words: Mapping[str, str], language: str) -> str:
    fixed = ("number", "label", "span", "score", "lag", "dims", "share")
    top = build_heads((words[f"furi_{name}"] for name in fixed), rowspan="2")
    top += element("th", {"scope": "colgroup", "colspan": str(len(SEGMENTS))}, words["furi_range"])
    below = build_heads(name_all(SEGMENT_NAMES, language).values(), **{"class": "narrow"})
    name = element("th", {"scope": "row", "colspan": str(len(fixed))}, words["segments_counts"])
    counts = build_cells(f"× {float(weight):.2f}" for weight in assessment.weights)
    rows = [element("tr", "counts-row", inner=name + counts)]
    rows += [_furi_row(number, furi, words) for number, furi in enumerate(assessment.furi)]
    return frame_table(words["furi_title"], [top, below], rows, "furi-table")


def _furi_row(number: int, furi: FuriAssessment, words: Mapping[str, str]) -> str:
    reached = math.isfinite(furi.start_s) and math.isfinite(furi.end_s)
    span = f"{format_time(furi.start_s)}–{format_time(furi.end_s)}" if reached else words["furi_not_reached"]
    cells = [
        element("th", {"scope": "row"}, str(number + 1)),
        element("td", "label", furi.label),
        element("td", "span", span),
        element("td", "strong", format_grade(furi.score)),
        element("td", None, format_number(1000.0 * furi.lag_s, 0)),
        element("td", None, str(furi.n_dims)),
        element("td", None, f"{format_number(100.0 * furi.contribution, 1)} %"),
    ]
    for gain in furi.gain.tolist():
        if not math.isfinite(gain):
            cells.append(element("td", {"class": "gain still", "title": words["furi_still"]}, "–"))
            continue
        short = " short" if gain < 0.8 else ""  # a segment that reaches less of the reference's range is outlined
        bar = element("i", {"style": f"width:{min(max(gain, 0.0), 1.25) * 80:.0f}%"})
        cells.append(element("td", f"gain{short}", inner=bar + element("span", None, f"{100 * gain:.0f}")))
    return element("tr", {"id": f"furi-{number + 1}"}, inner=cells)


def _shape(
    assessment: Assessment, numbers: Sequence[int], opened: bool, words: Mapping[str, str], language: str
) -> str:
    furi = assessment.furi[numbers[0]]
    heading = estimate_mean_heading(assessment, furi)
    swings = compute_swings(furi)
    cells = ""
    for place_in_row, pictures in enumerate(draw_shapes(furi, heading, words, language)):
        label = element("b", None, words["mean_posture"])
        if place_in_row:
            swing = swings[place_in_row - 1]
            label = element("b", None, words["axis"].format(number=place_in_row))
            percent = 100.0 * swing.share
            share = words["axis_share"].format(percent=format_number(percent, 0 if percent >= 9.5 else 1))
            most = f"{describe_segments(swing.segments[:1], language)} {swing.degrees[0]:.0f}°"
            label += element("span", None, share) + element("span", None, most)
        caption = element("figcaption", None, inner=label)
        cells += element("figure", "shape-cell", inner=caption + "".join(pictures))
    joined = ("、" if language == "ja" else ", ").join(str(n + 1) for n in numbers)
    title = element("b", None, words["shape_of"].format(label=furi.label)) + element(
        "span", None, words["shape_furi"].format(numbers=joined)
    )
    table = ""
    if count_axes(furi):
        rows = [
            (words["axis"].format(number=k), f"{format_number(100.0 * swing.share, 1)} %", swing.describe(language))
            for k, swing in enumerate(swings, start=1)
        ]
        head = [words["axis"].format(number=""), words["furi_share"], words["axes_segments"]]
        table = build_details(words["axes_table"], build_table(head, rows, words["axes_table"]))
    summary = element("summary", None, inner=title)
    grid = element("div", "shape-grid", inner=cells)
    return element("details", {"class": "shape-card", "open": opened}, inner=summary + grid + table)


def build_moments(assessment: Assessment, words: Mapping[str, str], language: str) -> str:
    """Up to six of the worst moments, as pictures with words and numbers."""
    picks = pick_worst(assessment, 6)
    if not picks:
        return element("p", "good", words["not_looked_for" if assessment.is_other_dance else "worst_none"])
    cards = "".join(_moment(assessment, k, words, language) for k in picks)
    return element("p", "lead", words["moments_text"]) + element("div", "moments", inner=cards)


def _moment(assessment: Assessment, k: int, words: Mapping[str, str], language: str) -> str:
    event = assessment.events[k]
    view = view_moment(assessment, event)
    picture = draw_moment(assessment, event, view, words, language)
    notes = [
        words[f"seen_from_{view.azimuth:.0f}"],
        words["severity"].format(value=format_number(event.severity, 1)),
    ]
    facing = _facing(assessment, event)
    if abs(facing) > math.radians(15.0):
        notes.append(words["faces"].format(who=describe_heading(facing).render(language)))
    inner = build_event_button(k, event, words, language) + picture
    inner += element("p", "note", " · ".join(notes))
    inner += draw_strip(assessment, event, view, words, language)
    inner += element("p", "note", words["strip_text"])
    rows = [
        (SEGMENT_NAMES[name].render(language), f"{format_number(angle, 0)}°" if math.isfinite(angle) else "–")
        for name, angle in zip(SEGMENTS, compute_residuals(assessment, event).tolist(), strict=True)
    ]
    table = build_table([words["col_segment"], words["angle_off"]], rows, words["moment_table"])
    inner += build_details(words["moment_table"], table)
    return element("article", "card moment", inner=inner)


def _facing(assessment: Assessment, event: ErrorEvent) -> float:
    frame = round(event.worst_s * assessment.frame_rate) if math.isfinite(event.worst_s) else 0
    value = float(assessment.facing[min(max(frame, 0), len(assessment.facing) - 1)])
    return value if math.isfinite(value) else 0.0


def build_reading(assessment: Assessment, words: Mapping[str, str], language: str) -> str:
    """What the terms mean, in plain words."""
    pairs = [
        (element("b", None, words[f"read_{name}_term"]), words[f"read_{name}"]) for name in ("space", "within", "limit")
    ]
    for kind, name in name_all(KINDS, language).items():
        pairs.append((draw_mark(kind, words) + element("b", None, name), words[f"read_{kind}"]))
    pairs.append((draw_mark("lapse", words) + element("b", None, words["read_lapse_term"]), words["read_lapse"]))
    note = words["read_sides" if assessment.side == "same" else "read_sides_mirrored"]
    return build_terms(((term, escape(text)) for term, text in pairs), "reading") + element("p", "note", note)


def build_advice(assessment: Assessment, words: Mapping[str, str], language: str) -> str:
    """The most important things to do differently, as buttons, and what went well."""
    tips = advise(assessment, "brief")
    placed = [tip for tip in tips if tip.event is not None or tip.lapse is not None]
    parts = [element("p", "good", tip.message.render(language)) for tip in tips if tip not in placed]
    if placed:
        items = (_tip(assessment, tip, words, language) for tip in placed)
        parts.append(build_list(items, {"class": "advice-list", "id": "advice"}, "ol"))
        parts.append(element("p", "note", words["advice_help"]))
    good = praise(assessment)
    if good is not None and good.message not in [tip.message for tip in tips]:
        parts.append(element("p", "good", good.message.render(language)))
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
    inner = element("span", "tip-kind", inner=label)
    inner += element("span", "says", advice.message.render(language))
    text = element("span", "tip-words", inner=inner)
    picture = _draw_tip(assessment, advice, words, language)
    if picture:
        picture = element("span", "tip-picture", inner=picture)
    return element("button", {"type": "button", "class": f"tip {kind}", **tag}, inner=picture + text)


def _draw_tip(assessment: Assessment, advice: Advice, words: Mapping[str, str], language: str) -> str:
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
    limbs = [[SEGMENTS[index] for index in limb if SEGMENTS[index] in wrong] for limb in LIMBS.values()]
    arrows = [limb for limb in limbs if limb]
    return draw_moment(assessment, shown, view, words, language, size=(330.0, 210.0), arrows=arrows)


def build_segments(assessment: Assessment, words: Mapping[str, str], language: str) -> str:
    """A row for each of the nine segments: how much it counts, and how far off it is."""
    columns = ("counts", "off", "over", "limit", "body")
    head = build_heads([words["col_segment"], *(words[f"segments_{name}"] for name in columns)])
    off, over = _measure_segments(assessment.residual, assessment.residual_limit)
    most = max(float(np.max(assessment.weights)), 1e-9)
    rows = (_segment_row(assessment, k, (off[k], over[k]), most, language) for k in range(len(SEGMENTS)))
    equal = bool(np.ptp(assessment.weights) < 0.005)  # the table shows two decimals
    lead = element("p", "lead", words["segments_alike" if equal else "segments_text"])
    return lead + frame_table(words["segments_title"], [head], rows, "segment-table")


def _measure_segments(residual: FloatArray, limit: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(9,) deg, the median angle of each segment; and (9,) percent of the time over its limit; nan where unseen."""
    with warnings.catch_warnings(), np.errstate(invalid="ignore"):
        warnings.simplefilter("ignore", RuntimeWarning)  # a segment that was never seen
        off = np.degrees(np.nanmedian(residual, axis=0))
        known = np.isfinite(residual)
        over = 100.0 * np.nanmean(np.where(known, residual > limit, np.nan), axis=0)
    return off, over


def _segment_row(
    assessment: Assessment,
    k: int,
    measured: tuple[float, float],
    most: float,
    language: str,
    longest_em: float = 5.0,
) -> str:
    weight = float(assessment.weights[k])
    bar = element("i", {"style": f"width:{longest_em * weight / most:.2f}em", "aria-hidden": "true"})
    counts = element("td", "counts", inner=element("span", None, f"× {weight:.2f}") + bar)
    limit = math.degrees(float(assessment.residual_limit[k]))
    texts = (
        _show_number(measured[0], "°"),
        _show_number(measured[1], " %"),
        _show_number(limit, "°"),
        _show_number(float(assessment.offset_deg[k]), "°", 1),
    )
    name = element("th", {"scope": "row"}, SEGMENT_NAMES[SEGMENTS[k]].render(language))
    return element("tr", None, inner=name + counts + build_cells(texts))


def _show_number(value: float, unit: str, decimals: int = 0) -> str:
    return f"{format_number(value, decimals)}{unit}" if math.isfinite(value) else "–"
