"""Tables of the report, and curves and events as CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from dousa.app.drawing.markup import build_cells, build_heads, element, format_number, frame_table
from dousa.evaluation.grade.result import Assessment
from dousa.evaluation.posture.posture import SEGMENTS
from dousa.evaluation.words import KINDS, LAPSE_KINDS, SEGMENT_NAMES, describe_segments, format_time

_COLUMNS = (
    "time_s reference_s matched_s furi lag_ms facing_deg d_space d_space_limit d_within d_within_limit d_path"
).split()


def furi_numbers(assessment: Assessment) -> np.ndarray:
    """(T,) number of the furi of each frame, from 0; -1 outside all."""
    numbers = np.full(assessment.performance.n_frames, -1)
    times = assessment.times
    for number, furi in enumerate(assessment.furi):
        numbers[(times >= furi.start_s) & (times < furi.end_s)] = number
    return numbers


def to_curves_csv(assessment: Assessment) -> bytes:
    """All curves at the full frame rate; what there is none of stays empty."""
    numbers = furi_numbers(assessment)
    table = np.column_stack(
        [
            assessment.times,
            assessment.same_time,
            assessment.matched_time,
            np.where(numbers < 0, np.nan, numbers + 1.0),
            1000.0 * assessment.lag,
            np.degrees(assessment.facing),
            assessment.d_space,
            assessment.d_space_limit,
            assessment.d_within,
            assessment.d_within_limit,
            assessment.d_path,
            np.degrees(assessment.residual),
        ]
    )
    formats = ["%.4f"] * 3 + ["%.0f"] + ["%.1f"] * 2 + ["%.5f"] * 5 + ["%.2f"] * len(SEGMENTS)
    line = ",".join(formats)
    body = "\n".join([line % tuple(row) for row in table.tolist()])
    head = ",".join([*_COLUMNS, *(f"{name}_deg" for name in SEGMENTS)])
    return f"{head}\n{body}\n".replace("nan", "").replace("inf", "").encode("ascii")


def to_events_csv(assessment: Assessment, language: str | None = None) -> bytes:
    """Events and lapses in order of time; marked as UTF-8, which spreadsheets need for Japanese."""
    numbers = "lag_ms shortfall_deg shortfall_percent severity worst_s reference_s".split()
    rows: list[tuple[float, list[str]]] = []
    for event in assessment.events:
        furi = "" if event.furi is None else str(event.furi + 1)
        values = [_decimal(getattr(event, name)) for name in numbers]
        row = [event.kind, _decimal(event.start_s), _decimal(event.end_s), furi, " ".join(event.segments)]
        rows.append((event.start_s, [*row, *values, "", event.says.render(language)]))
    for lapse in assessment.lapses:
        row = [lapse.kind, _decimal(lapse.start_s), _decimal(lapse.end_s), *[""] * 7]
        span = [_decimal(lapse.reference_start_s), _decimal(lapse.reference_end_s)]
        rows.append((lapse.start_s, [*row, *span, lapse.says.render(language)]))
    rows.sort(key=lambda row: row[0] if np.isfinite(row[0]) else np.inf)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["kind", "start_s", "end_s", "furi", "segments", *numbers, "reference_end_s", "says"])
    writer.writerows(row for _, row in rows)
    return text.getvalue().encode("utf-8-sig")


def _decimal(value: float | None) -> str:
    return "" if value is None or not np.isfinite(value) else f"{value:.3f}"


def format_optional(value: float | None, decimals: int = 0) -> str:
    """A number, or a dash if there is none."""
    return "–" if value is None else format_number(value, decimals)


def build_table(head: Sequence[str], rows: Iterable[Sequence[str]], caption: str) -> str:
    """A table whose first column names the row; a caption for screen readers."""
    body = (element("tr", None, inner=element("th", {"scope": "row"}, row[0]) + build_cells(row[1:])) for row in rows)
    return frame_table(caption, [build_heads(head)], body)


def build_details(title: str, content: str, count: int | None = None) -> str:
    """Something that opens when asked for."""
    number = "" if count is None else element("span", "amount", str(count))
    return element("details", None, inner=element("summary", None, title, number) + content)


def build_tables(assessment: Assessment, words: Mapping[str, str], language: str) -> str:
    """Errors, lapses, and what was not seen."""
    lapses: list[tuple[str, ...]] = [
        (
            format_time(lapse.start_s),
            format_time(lapse.end_s),
            LAPSE_KINDS[lapse.kind].render(language),
            lapse.says.render(language),
        )
        for lapse in assessment.lapses
    ]
    gaps: list[tuple[str, ...]] = [
        (format_time(start), format_time(end), SEGMENT_NAMES[name].render(language))
        for start, end, name in assessment.gaps
    ]
    tables: dict[str, tuple[str, list[tuple[str, ...]]]] = {
        "events_table": (
            "start end kind segments furi lag short_deg short_percent severity says",
            _list_events(assessment, language),
        ),
        "lapses_table": ("start end kind says", lapses),
        "gaps_table": ("start end segment", gaps),
    }
    none = element("p", None, words["none"])
    return "".join(
        build_details(words[name], _name_columns(columns, rows, words[name], words) if rows else none, len(rows))
        for name, (columns, rows) in tables.items()
    )


def _name_columns(columns: str, rows: Sequence[Sequence[str]], caption: str, words: Mapping[str, str]) -> str:
    return build_table([words.get(f"col_{name}", name) for name in columns.split()], rows, caption)


def _list_events(assessment: Assessment, language: str) -> list[tuple[str, ...]]:
    return [
        (
            format_time(event.start_s),
            format_time(event.end_s),
            KINDS[event.kind].render(language),
            describe_segments(event.segments, language),
            "–" if event.furi is None else str(event.furi + 1),
            format_optional(event.lag_ms),
            format_optional(event.shortfall_deg),
            format_optional(event.shortfall_percent),
            format_optional(event.severity, 1),
            event.says.render(language),
        )
        for event in assessment.events
    ]
