"""The report of an assessment: one HTML page that opens anywhere, offline, and two CSV files."""

from __future__ import annotations

from dousa._lazy import load_when_used

_HOME = {"find_font": "_fonts", "write_report": "_writing"}

__all__ = sorted(_HOME)  # noqa: PLE0605

__getattr__ = load_when_used(__name__, {name: f"{__name__}.{module}" for name, module in _HOME.items()})
