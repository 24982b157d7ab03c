from .engine import choose_jobs
from .export.clip_export import ExportReport
from .front.library import Library
from .journal.entries import JournalEntry
from .labels import parse_label_rule
from .marks.searches import SavedSearch
from .marks.tags import FAVOURITE
from .results import (
    AddReport,
    Classification,
    ClipInfo,
    Duplicate,
    FindResult,
    Hit,
    LabelledTake,
    LibraryStats,
    Place,
    SearchResult,
    Skipped,
    TakeAnnotation,
    TakeSegment,
    TrainReport,
    Verdict,
)
from .selection import UNCHANGED
from .text.answers import TextHit, TextResult
from .upkeep.compact import CompactReport
from .upkeep.report import CheckReport, Damage

__all__ = [
    "FAVOURITE",
    "UNCHANGED",
    "AddReport",
    "CheckReport",
    "Classification",
    "ClipInfo",
    "CompactReport",
    "Damage",
    "Duplicate",
    "ExportReport",
    "FindResult",
    "Hit",
    "JournalEntry",
    "LabelledTake",
    "Library",
    "LibraryStats",
    "Place",
    "SavedSearch",
    "SearchResult",
    "Skipped",
    "TakeAnnotation",
    "TakeSegment",
    "TextHit",
    "TextResult",
    "TrainReport",
    "Verdict",
    "choose_jobs",
    "parse_label_rule",
]
