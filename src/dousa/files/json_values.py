"""Conversion of values to JSON."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from typing import Any, NoReturn

from dousa.messages import Message


def to_json_value(value: Any, infinite: Callable[[float], Any] = lambda value: None) -> Any:
    """Convert a value: numbers that are not finite to None, arrays and tuples to lists, messages to text.

    Parameters
    ----------
    value : of dictionaries, sequences, numpy arrays and numbers, messages, objects with ``to_json()``, dataclasses;
        anything else is kept.
    infinite : called with infinite numbers; returns what stands for them, or raises.
    """
    if isinstance(value, Message):
        return str(value)
    if isinstance(value, float):
        return value if math.isfinite(value) else None if math.isnan(value) else infinite(value)
    if isinstance(value, list | tuple):
        return [to_json_value(item, infinite) for item in value]
    plain = _simplify(value)
    if isinstance(plain, Mapping):
        return {str(key): to_json_value(item, infinite) for key, item in plain.items()}
    return plain if plain is value else to_json_value(plain, infinite)


def refuse_infinite(value: float) -> NoReturn:
    """Raise OptionError, of `to_json_value`, where an infinity would say that something is known."""
    from dousa.errors import OptionError

    raise OptionError("output.infinite")


def round_number(value: float | None, digits: int) -> float | None:
    """Round a number; None if it is not finite, and never -0.0."""
    if value is None or not math.isfinite(value):
        return None
    return round(float(value), digits) + 0.0


def _simplify(value: Any) -> Any:
    """Arrays as lists, objects by their ``to_json()``, dataclasses by their fields."""
    if hasattr(value, "tolist"):  # numpy scalars and arrays
        return value.tolist()
    if hasattr(value, "to_json"):
        return value.to_json()
    if dataclasses.is_dataclass(value):
        return {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
    return value
