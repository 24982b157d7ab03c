"""The parts of a report, each as markup of its own: what its page is put together from, and what the studio replaces.

A page that shows them needs the frame (`build_frame`), the style (`read_report_style`), the script of the player and
that of the report (`read_report_script`), whose head says how they are bound together.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Mapping
from importlib import resources
from types import MappingProxyType
from typing import Any

from dousa.app.report._curves import furi_numbers
from dousa.app.report._header import build_events, build_header, make_title
from dousa.app.report._matrix import draw_matrix
from dousa.app.report._sections import build_furi, build_moments, build_reading
from dousa.app.report._svg import escape
from dousa.app.report._tables import build_tables
from dousa.app.report._texts import TEXTS
from dousa.app.report._timeline import draw_timeline
from dousa.evaluation._types import Assessment
from dousa.evaluation.posture import SEGMENTS
from dousa.evaluation.words import SEGMENT_WORDS
from dousa.motion._types import FloatArray

__all__ = [
    "PARTS",
    "QUICK_PARTS",
    "build_frame",
    "build_parts",
    "collect_data",
    "fill_slots",
    "read_file",
    "read_report_script",
    "read_report_style",
]

_READOUTS = 2000  # values of each curve that the page can say beside the cursor

PARTS: Mapping[str, Callable[[Assessment, Mapping[str, str], str], str]] = MappingProxyType(
    {
        "events": build_events,
        "timeline": draw_timeline,
        "matrix": lambda assessment, words, language: draw_matrix(assessment, words),
        "furi": build_furi,
        "moments": build_moments,
        "reading": build_reading,
        "tables": build_tables,
    }
)
"""What builds each part, besides the header."""

QUICK_PARTS = ("header", "events", "timeline", "tables")
"""Parts without figures of people: what follows while somebody is still changing something."""


def build_parts(
    assessment: Assessment, language: str, names: Collection[str] | None = None
) -> dict[str, str]:
    """Parts of the report by name.

    Parameters
    ----------
    assessment : what they show.
    language : ``"en"`` or ``"ja"``.
    names : which; all if None.
    """
    words = TEXTS[language]
    found = {
        name: build(assessment, words, language)
        for name, build in PARTS.items()
        if names is None or name in names
    }
    if names is None or "header" in names:
        title = make_title(assessment, words)
        found["header"] = build_header(assessment, title, assessment.warnings, words, language)
    return found


def build_frame(language: str) -> str:
    """The markup around the parts, which are empty: elements with ``data-part``."""
    slots = dict.fromkeys((*PARTS, "header", "files"), "")
    slots |= {f"text_{name}": escape(text) for name, text in TEXTS[language].items()}
    return fill_slots(read_file("report.html"), slots)


def read_report_script() -> str:
    """The script that makes ``dousa.bindReport``; the player's comes before it."""
    return read_file("report.js")


def read_report_style() -> str:
    """The style of the report for a page that shows other things as well: it ends at ``.dousa-report``."""
    return f"{read_file('colours.css')}:where(.dousa-report) {{\n{read_file('report.css')}}}\n"


def read_file(name: str) -> str:
    """A file of this package."""
    return resources.files("dousa.app.report").joinpath(name).read_text(encoding="utf-8")


def fill_slots(template: str, slots: Mapping[str, str]) -> str:
    """The template with its slots filled, in one pass: what is filled in is not looked at again."""
    return re.sub(r"\{\{(\w+)\}\}", lambda match: slots[match.group(1)], template)


def collect_data(assessment: Assessment, language: str) -> dict[str, Any]:
    """What report.js needs: events to go to, and values to say beside the cursor."""
    words = TEXTS[language]
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
