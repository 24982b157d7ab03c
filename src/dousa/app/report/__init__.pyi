from .curves import to_curves_csv, to_events_csv
from .page import (
    QUICK_PARTS,
    build_frame,
    build_page,
    build_parts,
    collect_data,
    read_report_script,
    read_report_style,
    write_report,
)

__all__ = [
    "QUICK_PARTS",
    "build_frame",
    "build_page",
    "build_parts",
    "collect_data",
    "read_report_script",
    "read_report_style",
    "to_curves_csv",
    "to_events_csv",
    "write_report",
]
