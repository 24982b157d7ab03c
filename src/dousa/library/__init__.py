"""The motion library: clips with their categories, features, histograms and the forest, in one file.

``Library.open("moves.dousa", create=True)`` opens or makes one. Loaded name by name when first used.
"""

from __future__ import annotations

import importlib
from typing import Any

_HOME = {
    "AddReport": "reports",
    "Classification": "reports",
    "ClipInfo": "reports",
    "Duplicate": "reports",
    "Hit": "reports",
    "Library": "store",
    "LibraryStats": "reports",
    "ReadOptions": "ingest",
    "SearchResult": "reports",
    "Skipped": "reports",
    "TrainReport": "reports",
    "UNCHANGED": "selection",
    "find_motion_files": "ingest",
    "parse_label_rule": "labels",
}

__all__ = sorted(_HOME)  # noqa: PLE0605


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'dousa.library' has no attribute '{name}'")
    value = getattr(importlib.import_module(f"dousa.library.{_HOME[name]}"), name)
    globals()[name] = value
    return value
