"""Answers as JSON, whatever is in them."""

from __future__ import annotations

import json
import math
from typing import Any

from starlette.responses import JSONResponse

__all__ = ["BYTES", "Answer"]

BYTES: dict[int | str, dict[str, Any]] = {
    200: {"content": {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}}}
}
"""What the description of the interface says of an answer that is no JSON."""


class Answer(JSONResponse):
    """JSON in which numbers that are not finite are null and halves of characters are question marks."""

    def render(self, content: Any) -> bytes:
        """The bytes of an answer."""
        try:
            text = _ENCODER.encode(content)
        except ValueError:
            text = _ENCODER.encode(_finite(content))
        return text.encode("utf-8", "replace")


_ENCODER = json.JSONEncoder(ensure_ascii=False, allow_nan=False, separators=(",", ":"))


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
