"""Reading of label tables of any kind, by the suffix or the head of the text."""

from __future__ import annotations

import os
from collections.abc import Callable

from dousa.files.disk import read_bytes
from dousa.formats.annotations.elan import read_eaf
from dousa.formats.annotations.label_file import LabelFile
from dousa.formats.annotations.tables import find_head, is_cmu_list, read_cmu_list, read_table
from dousa.formats.annotations.textgrid import read_textgrid

LABEL_SUFFIXES = (".labels.csv", ".labels.tsv", ".eaf", ".textgrid", ".boris.csv", ".boris.tsv")
"""What a file that can hold nothing but labels ends in, in small letters."""

_MOST_BYTES = 20_000  # searched for the head of a table


def read_label_file(path: str | os.PathLike[str]) -> LabelFile:
    """Read ELAN's ``.eaf``, Praat's ``.TextGrid``, else text: a table (dousa's, BORIS's), or a list of CMU.

    Raises
    ------
    MotionFileError : it cannot be read, or is no such table; with the line.
    """
    name = os.fspath(path)
    data = read_bytes(name)
    reader: Callable[[str, bytes], LabelFile] = read_table
    if name.lower().endswith(".eaf"):
        reader = read_eaf
    elif name.lower().endswith(".textgrid"):
        reader = read_textgrid
    elif is_cmu_list(data[:_MOST_BYTES].decode(errors="replace")):
        reader = read_cmu_list
    return reader(name, data)


def is_label_file(path: str | os.PathLike[str]) -> bool:
    """Return whether a file is a table of labels, by its suffix or, for .csv and .tsv, by its head."""
    name = os.fspath(path).lower()
    if name.endswith(LABEL_SUFFIXES):
        return True
    if not name.endswith((".csv", ".tsv", ".txt")):
        return False
    try:
        with open(path, "rb") as file:
            text = file.read(_MOST_BYTES).decode(errors="replace")
    except OSError:
        return False
    return find_head(text.removeprefix("\ufeff")) is not None
