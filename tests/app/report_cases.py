"""Assessments that a report must bear, and the data that a page carries."""

import dataclasses
import json
import math
import re
from html.parser import HTMLParser
from typing import Any

import numpy as np

from dousa.evaluation import Assessment

_VOID = {"meta", "img", "br", "link", "input", "col", "hr"}


class PageReader(HTMLParser):
    """Elements, shown text, and whether every element that was opened was closed."""

    def __init__(self, page: str) -> None:
        super().__init__(convert_charrefs=True)
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.texts: list[str] = []
        self.stack: list[str] = []
        self.feed(page)
        assert not self.stack

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        if tag not in _VOID:
            self.stack.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.stack and self.stack[-1] == tag, f"</{tag}> closes {self.stack[-3:]}"
        self.stack.pop()

    def handle_data(self, data: str) -> None:
        if self.stack and self.stack[-1] not in ("script", "style"):
            self.texts.append(data)

    @property
    def text(self) -> str:
        return "".join(self.texts)

    def with_class(self, name: str) -> list[dict[str, str | None]]:
        return [attrs for _, attrs in self.elements if name in (attrs.get("class") or "").split()]


def page_data(page: str, name: str = "report-data") -> Any:
    found = re.search(rf'<script type="application/json" id="{name}">(.*?)</script>', page, re.DOTALL)
    assert found
    return json.loads(found.group(1))


def change(assessment: Assessment, **changes: Any) -> Assessment:
    return dataclasses.replace(assessment, **changes)


def _cut(assessment: Assessment, n_frames: int) -> Assessment:
    """The first frames of an assessment."""
    changes: dict[str, Any] = {}
    for field in dataclasses.fields(assessment):
        value = getattr(assessment, field.name)
        if isinstance(value, np.ndarray) and field.name not in ("residual_limit", "path", "weights", "offset_deg"):
            changes[field.name] = value[:n_frames]
    for name in ("reference", "performance"):
        whole = getattr(assessment, name)
        changes[name] = dataclasses.replace(
            whole, segments=whole.segments[:n_frames], seen=whole.seen[:n_frames], positions=whole.positions[:n_frames]
        )
    return change(assessment, path=assessment.path[:n_frames], events=(), lapses=(), gaps=(), **changes)


def _nan_curves(assessment: Assessment) -> Assessment:
    names = "same_time matched_time lag facing d_space d_within d_path d_space_limit d_within_limit residual".split()
    empty = {name: np.full_like(getattr(assessment, name), np.nan) for name in names}
    furi = tuple(
        dataclasses.replace(
            f, start_s=math.nan, end_s=math.nan, lag_s=math.nan, score=math.nan, gain=np.full(9, math.nan)
        )
        for f in assessment.furi
    )
    events = tuple(
        dataclasses.replace(e, severity=math.nan, worst_s=math.nan, reference_s=math.nan, furi=None)
        for e in assessment.events
    )
    path = np.zeros((0, 2), int)
    return change(assessment, furi=furi, events=events, path=path, score=math.nan, tempo=math.nan, **empty)


UNUSUAL = {
    "nothing found": lambda a: change(a, events=(), lapses=(), gaps=(), warnings=()),
    "calibrated": lambda a: change(a, calibrated=True, n_references=5, score=100.0),
    "one frame": lambda a: change(_cut(a, 1), furi=a.furi[:1]),
    "two frames": lambda a: _cut(a, 2),
    "one furi": lambda a: change(a, furi=a.furi[:1]),
    "no furi": lambda a: change(a, furi=()),
    "no values": _nan_curves,
    "no names": lambda a: change(
        a, reference=dataclasses.replace(a.reference, name=""), performance=dataclasses.replace(a.performance, name="")
    ),
    "a space of no dimensions": lambda a: change(
        a,
        furi=tuple(
            dataclasses.replace(
                f,
                eigenspace=type(f.eigenspace)(
                    mean=f.eigenspace.mean,
                    axes=np.zeros((27, 0)),
                    variances=np.zeros(0),
                    contribution=1.0,
                    n_dims=0,
                    n_frames=1,
                ),
            )
            for f in a.furi
        ),
    ),
}
