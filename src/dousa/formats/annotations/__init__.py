"""Label tables of recordings: dousa's own CSV, ELAN, Praat, BORIS, and the lists of CMU."""

from __future__ import annotations

from dousa.formats.annotations.elan import write_eaf
from dousa.formats.annotations.label_file import LabelFile, LabelTier
from dousa.formats.annotations.reading import LABEL_SUFFIXES, is_label_file, read_label_file
from dousa.formats.annotations.tables import write_labels_csv

__all__ = [
    "LABEL_SUFFIXES",
    "LabelFile",
    "LabelTier",
    "is_label_file",
    "read_label_file",
    "write_eaf",
    "write_labels_csv",
]
