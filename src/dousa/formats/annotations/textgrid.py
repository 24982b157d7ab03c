"""Praat's TextGrid files, long and short, in UTF-8 or UTF-16: tiers of intervals (Boersma and Weenink, Praat's manual).

Both forms are the same row of texts, numbers and flags; other text of the long form ("xmin =", "intervals [1]:") is
skipped, as in Praat itself. A tier of points has no lengths, and no segments.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

from dousa.errors import MotionFileError
from dousa.formats.annotations.label_file import (
    LabelFile,
    LabelTier,
    clean_category,
    decode_text,
    finish_tier,
    make_span,
    parse_number,
)
from dousa.motion.annotation import Stretch

_TOKEN = re.compile(
    r'"(?P<text>(?:[^"]|"")*)"'
    r"|(?P<comment>![^\n]*)"
    r"|(?<!\S)(?P<number>[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)(?!\S)"
    r"|<(?P<flag>exists|absent)>"
    r"|(?P<other>\S)"
)
_INTERVALS, _POINTS = "IntervalTier", ("TextTier", "PointTier")


@dataclass(frozen=True, slots=True)
class _Token:
    kind: str
    value: str
    line: int


class _Reader:
    """Takes tokens one by one."""

    def __init__(self, path: str, text: str) -> None:
        self.path = path
        self._tokens = self._split(text)
        self.line = 1

    def _split(self, text: str) -> Iterator[_Token]:
        line, at = 1, 0
        for match in _TOKEN.finditer(text):
            line += text.count("\n", at, match.start())
            at = match.start()
            kind = match.lastgroup or "other"
            if kind not in ("comment", "other"):
                yield _Token(kind, match.group(kind), line)
        self.line = line

    def take(self, kind: str) -> str:
        """Return the next value, which must be of this kind: text, number or flag."""
        token = next(self._tokens, None)
        if token is None:
            raise MotionFileError(self.path, "label_files.cut_off", self.line)
        self.line = token.line
        if token.kind != kind:
            raise MotionFileError(self.path, "label_files.grid_order", token.line, found=token.value[:40])
        return token.value.replace('""', '"') if kind == "text" else token.value

    def number(self) -> float:
        """Return the next number."""
        return parse_number(self.path, self.take("number"), "", self.line)

    def count(self) -> int:
        """Return the next number, of items that follow."""
        value = self.number()
        if value != int(value) or value < 0:
            raise MotionFileError(self.path, "label_files.grid_order", self.line, found=f"{value:g}")
        return int(value)


def read_textgrid(path: str, data: bytes) -> LabelFile:
    """Read the labels of a TextGrid; MotionFileError if it is no text, cut off, or a chronological one."""
    text = decode_text(path, data)
    head = text[:200]
    if "ooTextFile" not in head or "TextGrid" not in head:
        code = "label_files.chronological" if "chronological" in head.lower() else "label_files.not_textgrid"
        raise MotionFileError(path, code, 1)
    reader = _Reader(path, text)
    reader.take("text"), reader.take("text")
    reader.number(), reader.number()
    tiers = []
    if reader.take("flag") == "exists":
        tiers = [_read_tier(reader) for _ in range(reader.count())]
    return LabelFile(path, {"": tuple(tiers)})


def _read_tier(reader: _Reader) -> LabelTier:
    kind, name = reader.take("text"), reader.take("text")
    reader.number(), reader.number()
    count = reader.count()
    spans: list[Stretch] = []
    if kind == _INTERVALS:
        for _ in range(count):
            start, line = reader.number(), reader.line
            stop, category = reader.number(), clean_category(reader.take("text"))
            if category:
                spans.append(make_span(reader.path, start, stop, category, line))
        return finish_tier(reader.path, LabelTier(name, tuple(spans)))
    if kind not in _POINTS:
        raise MotionFileError(reader.path, "label_files.grid_order", reader.line, found=kind[:40])
    n_points = 0
    for _ in range(count):
        reader.number()
        n_points += bool(reader.take("text").strip())
    return LabelTier(name, (), n_points=n_points)
