"""What values look like in a notebook: short texts, tables, and data frames of pandas or polars."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from dataclasses import fields
from importlib import import_module
from importlib.util import find_spec
from typing import Any, ClassVar, TypeVar

import numpy as np

from dousa.errors import DousaError
from dousa.extras import require

_Class = TypeVar("_Class", bound=type)


def short_repr(kind: _Class) -> _Class:
    """Give a dataclass a repr on one line: arrays by their shape, long texts and collections by their length."""
    setattr(kind, "__repr__", _describe)  # noqa: B010  (a method of no type that a checker knows)
    return kind


def plays(kind: _Class) -> _Class:
    """Let a notebook play a motion where it is the last value of a cell; bodies that are no person's are written."""
    setattr(kind, "_repr_html_", _play)  # noqa: B010  (as above)
    return kind


def _play(value: Any) -> str | None:
    try:
        return str(import_module("dousa").plot(value)._repr_html_())  # by name: what motions know lies below them
    except DousaError:
        return None  # the notebook shows its repr


def _describe(value: Any) -> str:
    parts = (f"{field.name}={_shorten(getattr(value, field.name))}" for field in fields(value) if field.repr)
    return f"{type(value).__name__}({', '.join(parts)})"


def _shorten(value: Any, most: int = 60) -> str:
    if isinstance(value, np.ndarray):
        return f"<{value.dtype} {' x '.join(map(str, value.shape)) or 'number'}>"
    if isinstance(value, Sequence | Mapping) and not isinstance(value, str) and len(value) > 3:
        return f"<{len(value)} in a {type(value).__name__}>"
    text = repr(value)
    return text if len(text) <= most else f"<{type(value).__name__}>"


class Tabular:
    """An answer that is a table: its rows are the list ``_rows`` of its JSON, its ``_columns`` those without rows."""

    __slots__ = ()
    _rows: ClassVar[str]
    _columns: ClassVar[str] = ""

    def to_frame(self) -> Any:
        """Return the rows as a data frame; see `to_frame`."""
        return to_frame(self)

    def _repr_html_(self) -> str:
        rows = _list_rows(self)
        names = list(rows[0]) if rows else self._columns.split()
        lines = ["".join(f"<th>{html.escape(name)}</th>" for name in names)]
        lines += ["".join(f"<td>{html.escape(_to_cell(row[name]))}</td>" for name in names) for row in rows]
        return f"<table>{''.join(f'<tr>{line}</tr>' for line in lines)}</table>"


def _to_cell(value: Any) -> str:
    return "" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)


def to_frame(answer: Any) -> Any:
    """Make a data frame of an answer: of pandas, or of polars where only that is installed.

    Parameters
    ----------
    answer : clips found, places, labels, an assessment (its errors), repetitions; or a list: ``library.clips()``.

    Returns
    -------
    A row for each clip, place, segment, error or repetition, a column for each number and word of its JSON.

    Raises
    ------
    MissingExtraError : neither pandas nor polars is installed.

    >>> dousa.to_frame(library.clips())["category"].nunique()  # doctest: +SKIP
    3
    """
    rows = _list_rows(answer)
    names = rows[0] if rows else getattr(answer, "_columns", "").split()
    columns = {name: [row[name] for row in rows] for name in names}
    frames = require("polars" if find_spec("pandas") is None and find_spec("polars") else "pandas", "frames")
    return frames.DataFrame(columns)


def _list_rows(answer: Any) -> list[dict[str, Any]]:
    """The rows as dictionaries of the same keys, without what is nested."""
    name = getattr(answer, "_rows", None)
    rows = answer.to_json()[name] if name else [one.to_json() for one in answer]
    names = dict.fromkeys(name for row in rows for name, value in row.items() if not isinstance(value, dict))
    plain = [{name: row.get(name) for name in names} for row in rows]
    nested = {name for row in plain for name, value in row.items() if isinstance(value, list | dict)}
    return [{name: value for name, value in row.items() if name not in nested} for row in plain]
