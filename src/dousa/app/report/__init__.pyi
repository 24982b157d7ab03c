from .beats import build_beats
from .curves import to_curves_csv, to_events_csv
from .exercise import build_exercise, build_exercise_page, to_repetitions_csv, write_exercise_report
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
    "build_beats",
    "build_exercise",
    "build_exercise_page",
    "build_frame",
    "build_page",
    "build_parts",
    "collect_data",
    "read_report_script",
    "read_report_style",
    "to_curves_csv",
    "to_events_csv",
    "to_repetitions_csv",
    "write_exercise_report",
    "write_report",
]
