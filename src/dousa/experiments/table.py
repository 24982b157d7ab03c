"""What a trial answers: the same JSON for programs and the same tables for people, whatever was tried."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

from dousa.files.json_values import to_json_value
from dousa.messages import Message

Cell = Message | str


@dataclass(frozen=True, slots=True)
class ResultTable:
    """A table, ready to be printed in any language.

    Parameters
    ----------
    columns : headings; without any there are only the lines around the table.
    rows : as many cells each, numbers as text.
    title : above the table.
    preface, notes : lines before and after it.
    n_words : columns of words, on the left; the others are numbers.
    bold : rows that stand out.
    sections : rows after which a line is drawn.
    framed : false for a list without lines.
    """

    columns: tuple[Cell, ...] = ()
    rows: tuple[tuple[Cell, ...], ...] = ()
    title: Cell = ""
    preface: tuple[Cell, ...] = ()
    notes: tuple[Cell, ...] = ()
    n_words: int = 1
    bold: frozenset[int] = frozenset()
    sections: frozenset[int] = frozenset()
    framed: bool = True


class Result:
    """Base of what trials answer, dataclasses all."""

    __slots__ = ()

    def to_json(self) -> dict[str, Any]:
        """The fields by name, in values as JSON has them; null for a number that is none."""
        fields = dataclasses.fields(self)  # type: ignore[arg-type]  # of the dataclasses below this one
        return {field.name: to_json_value(getattr(self, field.name)) for field in fields}

    def to_tables(self) -> tuple[ResultTable, ...]:
        """The answer for people."""
        return ()


def show(value: float | None, digits: int = 3, by: float = 1.0, sign: str = "") -> str:
    """A number of so many digits after the point, ``by`` times as large; a dash where there is none."""
    return "-" if value is None or not math.isfinite(value) else f"{by * value:{sign}.{digits}f}"
