"""Where the category and the performer of a clip come from when its file is added.

A rule is written as a short text:

``folder``        the file's folder below the given PATH, such as ``squat1Reps`` or ``walk/active``;
                  none for a file that lies directly in PATH or is PATH itself
``name:REGEX``    the group ``category`` (or ``performer``) of the expression, else its first group, found
                  in the file's name
``path:REGEX``    the same, found in the file's path below PATH (written with ``/``)
``csv:FILE``      a table with a column ``path`` or ``file`` and a column ``category`` (or ``performer``);
                  paths are relative to the table or to PATH; a file without a row has no label
``none``          no label
"""

from __future__ import annotations

import csv
import io
import os
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from dousa.errors import OptionError

if TYPE_CHECKING:
    from _csv import Reader

__all__ = ["LabelRule", "no_label", "parse_label_rule"]

LabelRule = Callable[[Path, Path], "str | None"]
"""Label of a file: called with the PATH that was given and the file found there, both absolute."""

_RULES = "folder, name:REGEX, path:REGEX, csv:FILE or none"


def parse_label_rule(text: str | None, label: str) -> LabelRule:
    """The rule that a text describes.

    Parameters
    ----------
    text : see the head of this module; None is ``none``.
    label : ``"category"`` or ``"performer"``, what the rule finds.

    Returns
    -------
    A function of the given PATH and a file, which returns the label or None.

    Raises
    ------
    OptionError : no such rule, an expression that cannot be compiled or has no group, a table that cannot be
        read or lacks a column.
    """
    kind, _, rest = (text or "none").partition(":")
    if kind in ("folder", "none") and not rest:
        return _folder if kind == "folder" else no_label
    if kind in ("name", "path") and rest:
        return _expression_rule(kind, rest, label)
    if kind == "csv" and rest:
        return _table_rule(Path(rest).expanduser(), label)
    raise OptionError(f"--{label}-from: expected {_RULES}, got '{text}'")


def no_label(root: Path, file: Path) -> None:
    """The rule ``none``."""
    return None


def _below(root: Path, file: Path) -> Path:
    """Path of the file below the given PATH, its bare name if it is PATH itself."""
    return Path(file.name) if file == root else file.relative_to(root)


def _folder(root: Path, file: Path) -> str | None:
    folder = _below(root, file).parent.as_posix()
    return None if folder == "." else folder


def _expression_rule(kind: str, text: str, label: str) -> LabelRule:
    try:
        expression = re.compile(text)
    except re.error as error:
        raise OptionError(f"--{label}-from: '{text}' is not a regular expression: {error}") from error
    if label not in expression.groupindex and not expression.groups:
        raise OptionError(
            f"--{label}-from: '{text}' needs a group that holds the {label}, such as '([a-z]+)'"
        )
    group: str | int = label if label in expression.groupindex else 1

    def rule(root: Path, file: Path) -> str | None:
        found = expression.search(file.name if kind == "name" else _below(root, file).as_posix())
        return (found.group(group) or "").strip() or None if found else None

    return rule


def _table_rule(path: Path, label: str) -> LabelRule:
    column, rows = _read_table(path, label)
    base = os.path.abspath(path.parent)
    by_text: dict[str, str | None] = {}
    by_place: dict[str, str | None] = {}
    for line, name, value in rows:
        # Tables are often made on Windows; a name that holds a backslash itself is hardly ever met.
        relative = os.path.normpath(name.replace("\\", "/"))
        if by_text.setdefault(relative, value) != value:
            raise OptionError(
                f"{path}:{line}: '{name}' has a second {label} '{value}', the first is '{by_text[relative]}'"
            )
        by_place[os.path.normpath(os.path.join(base, relative))] = value

    def rule(root: Path, file: Path) -> str | None:
        for table, key in ((by_place, str(file)), (by_text, str(_below(root, file)))):
            if key in table:
                return table[key]
        # A column called "file" promises no folders.
        return by_text.get(file.name) if column == "file" else None

    return rule


def _read_table(path: Path, label: str) -> tuple[str, list[tuple[int, str, str | None]]]:
    """Name of the column of files, and (line, file, label) of each row."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise OptionError(f"--{label}-from: {path} cannot be read: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise OptionError(f"--{label}-from: {path} is not text in UTF-8; save it as CSV UTF-8") from error
    header = text.partition("\n")[0]
    delimiter = max(",;\t", key=header.count)
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter)
    try:
        names = [name.strip().lower() for name in next(reader, [])]
        column = next((name for name in ("path", "file") if name in names), "")
        if not column or label not in names:
            found = ", ".join(names) or "nothing"
            raise OptionError(
                f"{path}:1: expected a column 'path' or 'file' and a column '{label}', got {found}"
            )
        return column, list(_rows(reader, path, names.index(column), names.index(label)))
    except csv.Error as error:
        raise OptionError(
            f"{path}:{reader.line_num}: not a table of comma-separated values: {error}"
        ) from error


def _rows(reader: Reader, path: Path, file: int, label: int) -> Iterator[tuple[int, str, str | None]]:
    for row in reader:
        line = reader.line_num
        if not any(cell.strip() for cell in row):
            continue
        if len(row) <= max(file, label):
            raise OptionError(
                f"{path}:{line}: expected at least {max(file, label) + 1} columns, got {len(row)}"
            )
        yield line, row[file].strip(), row[label].strip() or None
