"""Rules for the category and performer of a clip when its file is added.

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
import fnmatch
import io
import os
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from dousa.errors import OptionError
from dousa.messages import Message

if TYPE_CHECKING:
    from _csv import Reader

LabelRule = Callable[[Path, Path], "str | None"]
"""Label of a file: called with the given PATH and the file found there, both absolute."""

_WORDS = {
    "category": Message("label_rules.category"),
    "performer": Message("label_rules.performer"),
    "takes": Message("label_rules.takes"),
}

# A database server cannot look up text of a third of a page, 2.7 kB: https://www.postgresql.org/docs/current/btree.html
MOST_BYTES = 1000
"""Most bytes of a label in UTF-8."""


def check_text(text: str) -> None:
    """Raise OptionError for a label or name that some databases cannot store."""
    shown = text[:40].encode(errors="backslashreplace").decode()
    if "\0" in text:
        raise OptionError("label_rules.zero", text=shown)
    if len(text.encode(errors="surrogatepass")) > MOST_BYTES:
        raise OptionError("label_rules.too_long", text=shown, most=MOST_BYTES)


def check_labels(*labels: object) -> None:
    """Raise OptionError for an empty label, or one that some databases cannot store; None is no label."""
    if any(isinstance(label, str) and not label.strip() for label in labels):
        raise OptionError("library_clips.empty_label")
    for label in labels:
        if isinstance(label, str):
            check_text(label)


def parse_label_rule(text: str | None, label: str) -> LabelRule:
    """Parse a rule into a function of the given PATH and a file, which returns the label or None.

    Parameters
    ----------
    text : see the module docstring; None is ``none``.
    label : ``"category"``, ``"performer"`` or ``"takes"``.

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
    raise OptionError("label_rules.unknown", label=_WORDS[label], text=text)


def no_label(root: Path, file: Path) -> None:
    """The rule ``none``."""
    return None


def _below(root: Path, file: Path) -> Path:
    return Path(file.name) if file == root else file.relative_to(root)


def _folder(root: Path, file: Path) -> str | None:
    folder = _below(root, file).parent.as_posix()
    return None if folder == "." else folder


def _expression_rule(kind: str, text: str, label: str) -> LabelRule:
    try:
        expression = re.compile(text)
    except re.error as error:
        raise OptionError("label_rules.not_an_expression", label=_WORDS[label], text=text, reason=error) from error
    if label not in expression.groupindex and not expression.groups:
        raise OptionError("label_rules.no_group", label=_WORDS[label], text=text)
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
        # Tables are often made on Windows; names with a real backslash are very rare.
        relative = os.path.normpath(name.replace("\\", "/"))
        if by_text.setdefault(relative, value) != value:
            first, word = by_text[relative], _WORDS[label]
            raise OptionError(
                "label_rules.second_label", path=path, line=line, name=name, label=word, second=value, first=first
            )
        by_place[os.path.normpath(os.path.join(base, relative))] = value

    def rule(root: Path, file: Path) -> str | None:
        for table, key in ((by_place, str(file)), (by_text, str(_below(root, file)))):
            if key in table:
                return table[key]
        # A column called "file" may lack folders.
        return by_text.get(file.name) if column == "file" else None

    return rule


def _read_table(path: Path, label: str) -> tuple[str, list[tuple[int, str, str | None]]]:
    """Read the name of the file column, and (line, file, label) of each row."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise OptionError("label_rules.unreadable", label=_WORDS[label], path=path, reason=error) from error
    except UnicodeDecodeError as error:
        raise OptionError("label_rules.not_utf8", label=_WORDS[label], path=path) from error
    header = text.partition("\n")[0]
    delimiter = max(",;\t", key=header.count)
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter)
    try:
        names = [name.strip().lower() for name in next(reader, [])]
        column = next((name for name in ("path", "file") if name in names), "")
        if not column or label not in names:
            if not any(names):
                raise OptionError("label_rules.empty_table", path=path, column=label)
            raise OptionError("label_rules.no_column", path=path, column=label, found=tuple(names))
        return column, list(_rows(reader, path, names.index(column), names.index(label)))
    except csv.Error as error:
        raise OptionError("label_rules.not_a_table", path=path, line=reader.line_num, reason=error) from error


def _rows(reader: Reader, path: Path, file: int, label: int) -> Iterator[tuple[int, str, str | None]]:
    for row in reader:
        line = reader.line_num
        if not any(cell.strip() for cell in row):
            continue
        if len(row) <= max(file, label):
            expected = max(file, label) + 1
            raise OptionError("label_rules.too_few_columns", path=path, line=line, expected=expected, found=len(row))
        yield line, row[file].strip(), row[label].strip() or None


def fits_category(category: str | None, wanted: str) -> bool:
    """Whether a category is the wanted one, is below it, or has it among its levels.

    ``walk`` fits ``walk``, ``walk/active`` and ``hdm05/walk``; ``hdm05/`` all below it, from the top; ``kick*`` a level
    that begins so (``*``, ``?`` and ``[...]`` as in names of files).
    """
    if category is None or category == wanted:
        return category is not None
    if wanted.endswith("/"):
        return f"{category}/".startswith(wanted)
    levels, n_levels = category.split("/"), wanted.count("/") + 1
    runs = ("/".join(levels[start : start + n_levels]) for start in range(len(levels) - n_levels + 1))
    return any(fnmatch.fnmatchcase(run, wanted) for run in runs)
