from .annotations.tags import CHECKED, FAVOURITE, SavedSearch
from .care.clip_map import ClipMap
from .care.compact import CompactReport
from .care.damage import CheckReport, Damage
from .care.review import DuplicateGroup, LabelDoubt, LabelReview
from .export import ExportReport
from .history.journal import JournalEntry
from .label_rules import parse_label_rule
from .library import Library
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
from .search.text import TextHit, TextMatches, TextResult
from .store.engine import choose_jobs
from .store.selection import UNCHANGED

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
