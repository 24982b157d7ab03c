"""Sections below the timeline: furi with their eigenspaces, worst moments in pictures, how to read the page."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from dousa.app.report._header import build_event_button
from dousa.app.report._marks import draw_mark
from dousa.app.report._moments import compute_residuals, draw_moment, draw_strip, pick_worst, view_moment
from dousa.app.report._shapes import compute_swings, count_axes, draw_shapes, estimate_mean_heading
from dousa.app.report._svg import element, format_number
from dousa.app.report._tables import build_details, build_table
from dousa.evaluation._types import Assessment, ErrorEvent, FuriAssessment
from dousa.evaluation.posture import SEGMENTS
from dousa.evaluation.words import (
    KIND_WORDS,
    SEGMENT_WORDS,
    describe_facing,
    describe_segments,
    format_time,
)

__all__ = ["build_furi", "build_moments", "build_reading"]

_MOMENTS = 6
_SHORT = 0.8  # a segment that reaches less of the reference's range is outlined
_FACING_WORTH_SAYING = math.radians(15.0)
_OPEN_SHAPES = 3  # so many figures are unfolded at first


def build_furi(assessment: Assessment, words: Mapping[str, str], language: str) -> str:
    """Table of all furi, and pictures of each different one."""
    if not assessment.furi:
        return element("p", None, words["furi_none"])
    text = element("p", {"class": "lead"}, words["furi_text"])
    key = element("p", {"class": "note"}, words["range_key"])
    shapes = element("h3", None, words["shapes_title"]) + element(
        "p", {"class": "lead"}, words["shapes_text"]
    )
    for k, numbers in enumerate(_group(assessment.furi)):
        shapes += _shape(assessment, numbers, k < _OPEN_SHAPES, words, language)
    return text + _furi_table(assessment, words, language) + key + shapes


def _group(furi: Sequence[FuriAssessment]) -> list[list[int]]:
    """Numbers of the furi that share a label, in order of the first."""
    groups: dict[str, list[int]] = {}
    for number, one in enumerate(furi):
        groups.setdefault(one.label, []).append(number)
    return list(groups.values())


def _furi_table(assessment: Assessment, words: Mapping[str, str], language: str) -> str:
    fixed = ("number", "label", "span", "score", "lag", "dims", "share")
    top = "".join(
        element("th", {"scope": "col", "rowspan": "2"}, words[f"furi_{name}"]) for name in fixed
    ) + element("th", {"scope": "colgroup", "colspan": str(len(SEGMENTS))}, words["furi_range"])
    below = "".join(
        element("th", {"scope": "col", "class": "narrow"}, SEGMENT_WORDS[language][name]) for name in SEGMENTS
    )
    rows = "".join(_furi_row(number, furi, words) for number, furi in enumerate(assessment.furi))
    inner = (
        element("caption", {"class": "sr"}, words["furi_title"])
        + element("thead", None, inner=element("tr", None, inner=top) + element("tr", None, inner=below))
        + element("tbody", None, inner=rows)
    )
    table = element("table", {"class": "furi-table"}, inner=inner)
    return element("div", {"class": "table-wrap", "tabindex": "0"}, inner=table)


def _furi_row(number: int, furi: FuriAssessment, words: Mapping[str, str]) -> str:
    reached = math.isfinite(furi.start_s) and math.isfinite(furi.end_s)
    span = f"{format_time(furi.start_s)}–{format_time(furi.end_s)}" if reached else words["furi_not_reached"]
    cells = [
        element("th", {"scope": "row"}, str(number + 1)),
        element("td", {"class": "label"}, furi.label),
        element("td", {"class": "span"}, span),
        element("td", {"class": "strong"}, format_number(furi.score, 0)),
        element("td", None, format_number(1000.0 * furi.lag_s, 0)),
        element("td", None, str(furi.n_dims)),
        element("td", None, f"{format_number(100.0 * furi.contribution, 1)} %"),
    ]
    for gain in furi.gain.tolist():
        if not math.isfinite(gain):
            cells.append(element("td", {"class": "gain still", "title": words["furi_still"]}, "–"))
            continue
        short = " short" if gain < _SHORT else ""
        bar = element("i", {"style": f"width:{min(max(gain, 0.0), 1.25) * 80:.0f}%"})
        cells.append(
            element("td", {"class": f"gain{short}"}, inner=bar + element("span", None, f"{100 * gain:.0f}"))
        )
    return element("tr", {"id": f"furi-{number + 1}"}, inner="".join(cells))


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
        cells += element("figure", {"class": "shape-cell"}, inner=caption + "".join(pictures))
    joined = ("、" if language == "ja" else ", ").join(str(n + 1) for n in numbers)
    title = element("b", None, words["shape_of"].format(label=furi.label)) + element(
        "span", None, words["shape_furi"].format(numbers=joined)
    )
    table = ""
    if count_axes(furi):
        rows = [
            (
                words["axis"].format(number=k + 1),
                f"{format_number(100.0 * swing.share, 1)} %",
                ", ".join(
                    f"{describe_segments([name], language)} {degrees:.0f}°"
                    for name, degrees in zip(swing.segments, swing.degrees, strict=True)
                ),
            )
            for k, swing in enumerate(swings)
        ]
        head = [words["axis"].format(number=""), words["furi_share"], words["axes_segments"]]
        table = build_details(words["axes_table"], build_table(head, rows, words["axes_table"]))
    summary = element("summary", None, inner=title)
    grid = element("div", {"class": "shape-grid"}, inner=cells)
    return element("details", {"class": "shape-card", "open": opened}, inner=summary + grid + table)


def build_moments(assessment: Assessment, words: Mapping[str, str], language: str) -> str:
    """Up to six of the worst moments, as pictures with words and numbers."""
    picks = pick_worst(assessment, _MOMENTS)
    if not picks:
        return element("p", {"class": "good"}, words["worst_none"])
    cards = "".join(_moment(assessment, k, words, language) for k in picks)
    return element("p", {"class": "lead"}, words["moments_text"]) + element(
        "div", {"class": "moments"}, inner=cards
    )


def _moment(assessment: Assessment, k: int, words: Mapping[str, str], language: str) -> str:
    event = assessment.events[k]
    view = view_moment(assessment, event)
    picture = draw_moment(assessment, event, view, words, language)
    notes = [
        words[f"seen_from_{view.azimuth:.0f}"],
        words["severity"].format(value=format_number(event.severity, 1)),
    ]
    facing = _facing(assessment, event)
    if abs(facing) > _FACING_WORTH_SAYING:
        notes.append(words["faces"].format(who=describe_facing(facing, language)))
    inner = build_event_button(k, event, words, language) + picture
    inner += element("p", {"class": "note"}, " · ".join(notes))
    inner += draw_strip(assessment, event, view, words, language)
    inner += element("p", {"class": "note"}, words["strip_text"])
    rows = [
        (SEGMENT_WORDS[language][name], f"{format_number(angle, 0)}°" if math.isfinite(angle) else "–")
        for name, angle in zip(SEGMENTS, compute_residuals(assessment, event).tolist(), strict=True)
    ]
    table = build_table([words["col_segment"], words["angle_off"]], rows, words["moment_table"])
    inner += build_details(words["moment_table"], table)
    return element("article", {"class": "card moment"}, inner=inner)


def _facing(assessment: Assessment, event: ErrorEvent) -> float:
    frame = round(event.worst_s * assessment.frame_rate) if math.isfinite(event.worst_s) else 0
    value = float(assessment.facing[min(max(frame, 0), len(assessment.facing) - 1)])
    return value if math.isfinite(value) else 0.0


def build_reading(assessment: Assessment, words: Mapping[str, str], language: str) -> str:
    """What the terms mean, in plain words."""
    pairs = [
        (element("b", None, words[f"read_{name}_term"]), words[f"read_{name}"])
        for name in ("space", "within", "limit")
    ]
    for kind, name in KIND_WORDS[language].items():
        pairs.append((draw_mark(kind, words) + element("b", None, name), words[f"read_{kind}"]))
    pairs.append(
        (draw_mark("lapse", words) + element("b", None, words["read_lapse_term"]), words["read_lapse"])
    )
    items = "".join(
        element("div", None, inner=element("dt", None, inner=term) + element("dd", None, text))
        for term, text in pairs
    )
    return element("dl", {"class": "reading"}, inner=items) + element(
        "p", {"class": "note"}, words["read_sides" if assessment.side == "same" else "read_sides_mirrored"]
    )
