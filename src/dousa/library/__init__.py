"""The motion library: clips with their categories, features, histograms and the forest, in one file.

``Library.open("moves.dousa", create=True)`` opens or makes one. Loaded name by name when first used.
"""

from __future__ import annotations

from dousa._lazy import load_when_used

_HOME = {
    "AddReport": "reports",
    "Classification": "answers",
    "ClipInfo": "reports",
    "Duplicate": "reports",
    "FindResult": "take_answers",
    "Hit": "answers",
    "LabelledTake": "take_answers",
    "Library": "store",
    "LibraryStats": "reports",
    "Place": "take_answers",
    "ReadOptions": "ingest",
    "SearchResult": "answers",
    "Skipped": "reports",
    "TrainReport": "reports",
    "UNCHANGED": "selection",
    "Verdict": "answers",
    "choose_jobs": "_jobs",
    "find_motion_files": "ingest",
    "parse_label_rule": "labels",
}

__all__ = sorted(_HOME)  # noqa: PLE0605

__getattr__ = load_when_used(__name__, {name: f"{__name__}.{module}" for name, module in _HOME.items()})
