"""TOML of unknown origin: a key of thousands of parts takes the square of that in memory."""

from __future__ import annotations

import tomllib
from typing import Any

__all__ = ["parse_toml"]

_MOST_DOTS = 200  # in a line; numbers have them too


def parse_toml(text: str) -> dict[str, Any]:
    """The document, with any line ends.

    Raises
    ------
    tomllib.TOMLDecodeError : no TOML.
    RecursionError : brackets or keys are nested too deep.
    """
    lines = text.replace("\r\n", "\n")
    if any(line.count(".") > _MOST_DOTS for line in lines.split("\n")):
        raise RecursionError("a line with more dots than any key or list of numbers needs")
    return tomllib.loads(lines)
