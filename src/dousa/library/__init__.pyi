from .engine import choose_jobs
from .export.clip_export import ExportReport
from .front.library import Library
from .journal.entries import JournalEntry
from .labels import parse_label_rule
from .marks.searches import SavedSearch
from .marks.tags import CHECKED, FAVOURITE
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
from .review.clip_map import ClipMap
from .review.duplicates import DuplicateGroup
from .review.label_doubts import LabelDoubt, LabelReview
from .selection import UNCHANGED
from .text.answers import TextHit, TextMatches, TextResult
from .upkeep.compact import CompactReport
from .upkeep.report import CheckReport, Damage

__all__ = [
    "CHECKED",
    "FAVOURITE",
    "UNCHANGED",
    "AddReport",
    "CheckReport",
    "Classification",
    "ClipInfo",
    "ClipMap",
    "CompactReport",
    "Damage",
    "Duplicate",
    "DuplicateGroup",
    "ExportReport",
    "FindResult",
    "Hit",
    "JournalEntry",
    "LabelDoubt",
    "LabelReview",
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
    "TextMatches",
    "TextResult",
    "TrainReport",
    "Verdict",
    "choose_jobs",
    "parse_label_rule",
]
