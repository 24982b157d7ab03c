"""The whole page in one string: markup, style, scripts, data and font."""

from __future__ import annotations

import html
import math
import re
from collections.abc import Mapping
from importlib import resources
from typing import Any

from dousa.app.report._curves import furi_numbers
from dousa.app.report._fonts import embed_font, font_rule
from dousa.app.report._header import build_events, build_header, make_title
from dousa.app.report._matrix import draw_matrix
from dousa.app.report._sections import build_furi, build_moments, build_reading
from dousa.app.report._svg import element, escape
from dousa.app.report._tables import build_tables
from dousa.app.report._texts import TEXTS
from dousa.app.report._timeline import draw_timeline
from dousa.evaluation._types import Assessment
from dousa.evaluation.posture import SEGMENTS
from dousa.evaluation.words import SEGMENT_WORDS
from dousa.motion._types import FloatArray

__all__ = ["CURVES_NAME", "EVENTS_NAME", "build_page"]

CURVES_NAME, EVENTS_NAME = "curves.csv", "events.csv"
_READOUTS = 2000  # values of each curve that the page can say beside the cursor


def build_page(assessment: Assessment, language: str, title: str | None = None) -> str:
    """The page.

    Parameters
    ----------
    assessment : what it shows.
    language : ``"en"`` or ``"ja"``.
    title : its title; None for who against whom.

    Returns
    -------
    HTML that needs no other file.
    """
    from dousa.app.player import (
        encode_player_data,
        format_player_data,
        read_player_script,
        read_player_style,
    )

    words = TEXTS[language]
    title = title or make_title(assessment, words)
    slots = {
        "language": language,
        "title": escape(title),
        "events": build_events(assessment, words, language),
        "timeline": draw_timeline(assessment, words, language),
        "matrix": draw_matrix(assessment, words),
        "furi": build_furi(assessment, words, language),
        "moments": build_moments(assessment, words, language),
        "reading": build_reading(assessment, words, language),
        "tables": build_tables(assessment, words, language),
        "files": _files(words),
        "data": format_player_data(_data(assessment, words, language)),
        "player_data": format_player_data(encode_player_data(assessment, language)),
        "player_style": read_player_style(),
        "player_script": read_player_script(),
        "style": _read("page.css"),
        "script": _read("page.js"),
    }
    slots.update({f"text_{name}": escape(text) for name, text in words.items()})
    shown = _collect_text(
        *slots.values(), build_header(assessment, title, assessment.warnings, words, language)
    )
    font = embed_font(shown)
    warnings = assessment.warnings
    if font.problem:
        warnings = (*warnings, words["font_missing"].format(reason=font.problem))
    slots["header"] = build_header(assessment, title, warnings, words, language)
    slots["font"] = font_rule(font)
    return _fill(_read("page.html"), slots)


def _read(name: str) -> str:
    return resources.files("dousa.app.report").joinpath(name).read_text(encoding="utf-8")


def _fill(template: str, slots: Mapping[str, str]) -> str:
    """The template with its slots filled, in one pass: what is filled in is not looked at again."""
    return re.sub(r"\{\{(\w+)\}\}", lambda match: slots[match.group(1)], template)


def _collect_text(*markup: str) -> str:
    """Every character that may be shown; tags and codes do no harm."""
    text = "".join(markup)
    text = re.sub(r"\\u([0-9a-fA-F]{4})", lambda match: chr(int(match.group(1), 16)), text)
    text = text.encode("utf-16", "surrogatepass").decode("utf-16", "replace")
    return "".join(set(html.unescape(text)))


def _files(words: Mapping[str, str]) -> str:
    links = {
        name: element("a", {"href": file}, file)
        for name, file in (("curves", CURVES_NAME), ("events", EVENTS_NAME))
    }
    return escape(words["tables_text"]).format(**links)


def _data(assessment: Assessment, words: Mapping[str, str], language: str) -> dict[str, Any]:
    """What page.js needs: events to go to, and values to say beside the cursor."""
    step = max(-(-assessment.performance.n_frames // _READOUTS), 1)
    worst = [_worst_segment(row) for row in assessment.residual[::step]]
    numbers = furi_numbers(assessment)[::step]
    return {
        "duration": assessment.performance.duration,
        "step": step / assessment.frame_rate,
        "events": [_moments(event.start_s, event.end_s, event.worst_s) for event in assessment.events],
        "lapses": [_moments(lapse.start_s, lapse.end_s, lapse.start_s) for lapse in assessment.lapses],
        "space": _round(assessment.d_space[::step], 3),
        "within": _round(assessment.d_within[::step], 3),
        "lag": _round(1000.0 * assessment.lag[::step], 0),
        "matched": _round(assessment.matched_time[::step], 2),
        "furi": [int(number) for number in numbers],
        "worst": [segment for segment, _ in worst],
        "off": [angle for _, angle in worst],
        "segments": [SEGMENT_WORDS[language][name] for name in SEGMENTS],
        "texts": {name: words[name] for name in ("furi", "lag_title", "now_reference", "now_worst")},
    }


def _moments(start: float, end: float, worst: float) -> list[float]:
    first = start if math.isfinite(start) else 0.0
    last = end if math.isfinite(end) else first
    return [round(v if math.isfinite(v) else first, 3) for v in (first, last, worst)]


def _round(values: FloatArray, decimals: int) -> list[float | int | None]:
    rounded = [round(v, decimals) if math.isfinite(v) else None for v in values.tolist()]
    return [int(v) if v is not None and decimals == 0 else v for v in rounded]


def _worst_segment(row: FloatArray) -> tuple[int | None, int | None]:
    known = [(float(angle), k) for k, angle in enumerate(row) if math.isfinite(angle)]
    if not known:
        return None, None
    angle, k = max(known)
    return k, round(math.degrees(angle))
