"""The report of an assessment: one HTML page that opens anywhere, offline, and two CSV files; and its parts by name,
for a page that shows them live."""

from __future__ import annotations

from dousa._lazy import load_when_used

_HOME = {
    "QUICK_PARTS": "_parts",
    "build_frame": "_parts",
    "build_page": "_page",
    "build_parts": "_parts",
    "collect_data": "_parts",
    "find_font": "_fonts",
    "read_report_script": "_parts",
    "read_report_style": "_parts",
    "to_curves_csv": "_curves",
    "to_events_csv": "_curves",
    "write_report": "_writing",
}

__all__ = sorted(_HOME)  # noqa: PLE0605

__getattr__ = load_when_used(__name__, {name: f"{__name__}.{module}" for name, module in _HOME.items()})
