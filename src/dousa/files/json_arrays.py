"""JSON whose numbers become arrays while it is parsed: as lists of Python they take ten times their bytes.

The entries of the outer lists are decoded one by one; lists of numbers of one shape are arrays from then on.
"""

from __future__ import annotations

import json
import re
from typing import Any

import numpy as np

_SPACE = re.compile(r"[ \t\r\n]*")
_FEWEST = 6
"""Numbers, by definition: shorter lists, such as an id or a size, stay lists."""

_decoder = json.JSONDecoder()


def parse_arrays(text: str) -> Any:
    """Parse JSON; lists of numbers, and lists of such of equal length, are float64 arrays if they hold six or more.

    ``true`` and ``false`` are no numbers: lists that hold them stay lists.

    Raises
    ------
    json.JSONDecodeError : it is none; more than one value is called ``Extra data``.
    RecursionError : it is nested too deeply.
    """
    value, end = _parse(text, _skip(text, 0), "true" in text or "false" in text)
    if end < len(text):
        raise json.JSONDecodeError("Extra data", text, end)
    return value


def _skip(text: str, position: int) -> int:
    found = _SPACE.match(text, position)
    return found.end() if found else position


def _parse(text: str, start: int, mixed: bool, deepest: int = 4) -> tuple[Any, int]:
    """The value at a place and where the next text is; outer lists and objects are taken apart here."""
    sign = text[start : start + 1]
    if sign not in ("[", "{") or not deepest:
        value, end = _decoder.raw_decode(text, start)
        return _pack(value, mixed), _skip(text, end)
    end = _skip(text, start + 1)
    if sign == "[":
        runs: list[Any] = []
        entries: list[Any] = []
        while text[end : end + 1] != "]" or entries:
            value, end = _decoder.raw_decode(text, end)
            entries.append(value)
            end, more = _next(text, end, "]")
            if len(entries) == 1000 or not more:
                runs.append(_pack(entries, mixed))
                entries = []
            if not more:
                break
        return _join(runs), _skip(text, end + 1)
    content: dict[str, Any] = {}
    while text[end : end + 1] != "}" or content:
        if text[end : end + 1] != '"':
            raise json.JSONDecodeError("Expecting property name enclosed in double quotes", text, end)
        key, end = _decoder.raw_decode(text, end)
        end = _skip(text, end)
        if text[end : end + 1] != ":":
            raise json.JSONDecodeError("Expecting ':' delimiter", text, end)
        content[key], end = _parse(text, _skip(text, end + 1), mixed, deepest - 1)
        end, more = _next(text, end, "}")
        if not more:
            break
    return content, _skip(text, end + 1)


def _next(text: str, end: int, closing: str) -> tuple[int, bool]:
    """The place of the next entry, or of the closing bracket, and whether there is one more."""
    end = _skip(text, end)
    sign = text[end : end + 1]
    if sign not in (",", closing) or not sign:
        raise json.JSONDecodeError("Expecting ',' delimiter", text, end)
    return (_skip(text, end + 1), True) if sign == "," else (end, False)


def _join(runs: list[Any]) -> Any:
    """One list of the entries, or one array if all are arrays of one shape."""
    if runs and all(isinstance(run, np.ndarray) and run.shape[1:] == runs[0].shape[1:] for run in runs):
        return np.concatenate(runs)
    return [entry for run in runs for entry in run]


def _pack(value: Any, mixed: bool) -> Any:
    """The value with arrays; ``mixed`` : whether truth values may be among the numbers."""
    if isinstance(value, dict):
        return {key: _pack(entry, mixed) for key, entry in value.items()}
    if not isinstance(value, list) or not value:
        return value
    if isinstance(value[0], int | float | list) and not isinstance(value[0], bool):
        try:
            array = np.array(value)
        except (ValueError, OverflowError):  # lists of unequal lengths
            array = np.zeros(0, object)
        if array.dtype.kind in "iuf" and not (mixed and _holds_truth(value)):
            return array.astype(np.float64) if array.size >= _FEWEST else value
    return [_pack(entry, mixed) for entry in value]


def _holds_truth(value: Any) -> bool:
    return any(map(_holds_truth, value)) if isinstance(value, list) else isinstance(value, bool)
