from .estimation import print_estimation
from .evaluation import print_assessment, print_progress, print_repetitions
from .library import (
    print_add,
    print_check,
    print_clips,
    print_duplicates,
    print_info,
    print_journal,
    print_label_review,
    print_stats,
    print_tags,
    warn_of_files,
)
from .lines import print_some, print_tables
from .search import (
    describe_votes,
    print_classes,
    print_given,
    print_places,
    print_search,
    print_text_search,
    print_timeline,
)

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
