from .assessment import print_assessment
from .contents import print_clips, print_stats
from .estimation import print_estimation
from .files import print_add, print_info, warn_of_files
from .hits import print_search, print_text_search
from .lines import print_some
from .places import print_given, print_places, print_timeline
from .progress import print_progress
from .repetitions import print_repetitions
from .review import print_duplicates, print_label_review
from .trials import print_tables
from .upkeep import print_check, print_journal, print_tags
from .verdicts import describe_votes, print_classes

__all__ = [
    "describe_votes",
    "print_add",
    "print_assessment",
    "print_check",
    "print_classes",
    "print_clips",
    "print_duplicates",
    "print_estimation",
    "print_given",
    "print_info",
    "print_journal",
    "print_label_review",
    "print_places",
    "print_progress",
    "print_repetitions",
    "print_search",
    "print_some",
    "print_stats",
    "print_tables",
    "print_tags",
    "print_text_search",
    "print_timeline",
    "warn_of_files",
]
