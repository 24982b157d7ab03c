"""The report of an assessment: one HTML page that opens anywhere, offline, and two CSV files."""

from __future__ import annotations

from dousa._lazy import load_when_used

__all__ = ["write_report"]

__getattr__ = load_when_used(__name__, {"write_report": "dousa.app.report._writing"})
