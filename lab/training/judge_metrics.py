"""How well reported errors agree with true ones: by class and time, event by event.

A report and an error agree if they are of one class and overlap by half (intersection over union): best pairs first,
each once.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from dousa.evaluation.errors.descriptors import LIMB_OF
from dousa.evaluation.grade.result import ErrorEvent
from dousa.evaluation.posture.posture import SEGMENTS
from lab.errors.results import match_events
from lab.injection.injection import Error

KINDS = ("shift", "incomplete", "partial", "global")
_LIMBS_OF_BODY = 4


@dataclass(frozen=True, slots=True)
class Report:
    """An error as a judge reports it; times in seconds of the performance, segments as numbers."""

    kind: str
    start_s: float
    end_s: float
    segments: tuple[int, ...]
    lag_ms: float | None = None
    shortfall_deg: float | None = None

    @classmethod
    def from_event(cls, event: ErrorEvent) -> Report:
        """The same of an event."""
        segments = tuple(SEGMENTS.index(name) for name in event.segments)
        return cls(event.kind, event.start_s, event.end_s, segments, event.lag_ms, event.shortfall_deg)


def name_variant(error: Error) -> str:
    """What a row of recall is about: the class, whether it is the body's, and the variant."""
    limbs = {int(LIMB_OF[SEGMENTS.index(name)]) for name in error.segments}
    whole = error.kind == "global" or len(limbs) >= _LIMBS_OF_BODY
    return f"{error.kind}, {'body' if whole else 'limb'}: {error.variant}"


@dataclass(slots=True)
class Score:
    """Counts over performances.

    Parameters
    ----------
    agreed, wrong, missed : by class.
    found : by variant, (found, all).
    lags_ms, shortfalls_deg : sizes of the differences of the agreed ones.
    false_events, clean_s : of performances without errors.
    """

    agreed: Counter[str] = field(default_factory=Counter)
    wrong: Counter[str] = field(default_factory=Counter)
    missed: Counter[str] = field(default_factory=Counter)
    found: dict[str, tuple[int, int]] = field(default_factory=dict)
    lags_ms: list[float] = field(default_factory=list)
    shortfalls_deg: list[float] = field(default_factory=list)
    false_events: int = 0
    clean_s: float = 0.0

    def add(self, reports: Sequence[Report], errors: Sequence[Error], duration_s: float) -> None:
        """Count one performance."""
        if not errors:
            self.false_events += len(reports)
            self.clean_s += duration_s
        partners = {i: reports[j] for i, j in match_events(errors, reports)}
        self.wrong.update(report.kind for report in reports)
        self.wrong.subtract(partner.kind for partner in partners.values())
        for i, error in enumerate(errors):
            partner = partners.get(i)
            (self.missed if partner is None else self.agreed)[error.kind] += 1
            name = name_variant(error)
            done, total = self.found.get(name, (0, 0))
            self.found[name] = (done + (partner is not None), total + 1)
            if partner is None:
                continue
            if partner.lag_ms is not None and error.lag_ms is not None:
                self.lags_ms.append(abs(partner.lag_ms - error.lag_ms))
            if partner.shortfall_deg is not None and error.shortfall_deg is not None:
                self.shortfalls_deg.append(abs(partner.shortfall_deg - error.shortfall_deg))

    def f_of(self, kind: str) -> float:
        """F of a class; nan where there is nothing of it."""
        true, reported = self.agreed[kind] + self.missed[kind], self.agreed[kind] + self.wrong[kind]
        return 2.0 * self.agreed[kind] / (true + reported) if true + reported else float("nan")

    @property
    def macro_f(self) -> float:
        """Mean of F over the classes that there are."""
        present = [self.f_of(kind) for kind in KINDS if self.agreed[kind] + self.missed[kind]]
        return float(np.mean(present)) if present else float("nan")

    @property
    def false_per_minute(self) -> float:
        """Events a minute on performances without errors."""
        return 60.0 * self.false_events / self.clean_s if self.clean_s else float("nan")
