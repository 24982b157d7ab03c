"""The text tables: everything that a plot shows, for those who read rather than look."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

from dousa.app.report._curves import summarise_seconds
from dousa.app.report._svg import element, format_number
from dousa.evaluation._types import Assessment
from dousa.evaluation.words import KIND_WORDS, LAPSE_WORDS, SEGMENT_WORDS, describe_segments, format_time

__all__ = ["build_details", "build_table", "build_tables", "format_optional"]


def format_optional(value: float | None, decimals: int = 0) -> str:
    """A number, or a dash if there is none."""
    return "–" if value is None else format_number(value, decimals)


def build_table(head: Sequence[str], rows: Iterable[Sequence[str]], caption: str) -> str:
    """A table whose first column names the row; a caption for screen readers."""
    top = "".join(element("th", {"scope": "col"}, text) for text in head)
    body = []
    for row in rows:
        cells = [element("th", {"scope": "row"}, row[0]), *(element("td", None, text) for text in row[1:])]
        body.append(element("tr", None, inner="".join(cells)))
    inner = (
        element("caption", {"class": "sr"}, caption)
        + element("thead", None, inner=element("tr", None, inner=top))
        + element("tbody", None, inner="".join(body))
    )
    return element("div", {"class": "table-wrap", "tabindex": "0"}, inner=element("table", None, inner=inner))


def build_details(title: str, content: str, count: int | None = None) -> str:
    """Something that opens when asked for."""
    number = "" if count is None else element("span", {"class": "amount"}, str(count))
    return element("details", None, inner=element("summary", None, title, number) + content)


def build_tables(assessment: Assessment, words: Mapping[str, str], language: str) -> str:
    """Errors, lapses, curves by the second, and what was not seen."""
    none = element("p", None, words["none"])
    events = _events(assessment, words, language)
    lapses = _lapses(assessment, words, language)
    seconds = _seconds(assessment, words, language)
    gaps = [
        (format_time(start), format_time(end), SEGMENT_WORDS[language].get(name, name))
        for start, end, name in assessment.gaps
    ]
    parts = []
    for name, head, rows in (
        (
            "events_table",
            _heads(words, "start end kind segments furi lag short_deg short_percent severity says"),
            events,
        ),
        ("lapses_table", _heads(words, "start end kind says"), lapses),
        ("seconds_table", _seconds_head(words), seconds),
        ("gaps_table", _heads(words, "start end segment"), gaps),
    ):
        content = build_table(head, rows, words[name]) if rows else none
        parts.append(build_details(words[name], content, len(rows)))
    return "".join(parts)


def _heads(words: Mapping[str, str], names: str) -> list[str]:
    return [words[f"col_{name}"] for name in names.split()]


def _events(assessment: Assessment, words: Mapping[str, str], language: str) -> list[tuple[str, ...]]:
    return [
        (
            format_time(event.start_s),
            format_time(event.end_s),
            KIND_WORDS[language][event.kind],
            describe_segments(event.segments, language),
            "–" if event.furi is None else str(event.furi + 1),
            format_optional(event.lag_ms),
            format_optional(event.shortfall_deg),
            format_optional(event.shortfall_percent),
            format_optional(event.severity, 1),
            event.says,
        )
        for event in assessment.events
    ]


def _lapses(assessment: Assessment, words: Mapping[str, str], language: str) -> list[tuple[str, ...]]:
    return [
        (
            format_time(lapse.start_s),
            format_time(lapse.end_s),
            LAPSE_WORDS[language].get(lapse.kind, lapse.kind),
            lapse.says,
        )
        for lapse in assessment.lapses
    ]


def _seconds_head(words: Mapping[str, str]) -> list[str]:
    return [words["col_time"], words["col_matched"], "d#", "d*", *_heads(words, "lag worst off")]


def _seconds(assessment: Assessment, words: Mapping[str, str], language: str) -> list[tuple[str, ...]]:
    names = SEGMENT_WORDS[language]
    return [
        (
            format_time(row.start_s).removesuffix(".0"),
            format_time(row.matched_s),
            format_number(row.d_space, 3),
            format_number(row.d_within, 3),
            format_number(row.lag_ms, 0),
            names.get(row.segment, "–"),
            format_number(row.residual_deg, 0) if math.isfinite(row.residual_deg) else "–",
        )
        for row in summarise_seconds(assessment)
    ]
