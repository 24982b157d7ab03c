"""Marks: which reports agree with what was put in, and the rows of the table."""

from __future__ import annotations

import dataclasses
from collections import Counter, defaultdict
from dataclasses import dataclass, field

import numpy as np

from lab.exams.dance.cases import GROUPS, SETS
from lab.exams.dance.placing import CLASS_OF, CLASSES, KINDS


@dataclass
class Tally:
    """Right and wrong reports of some rows."""

    right: Counter = field(default_factory=Counter)
    truth: Counter = field(default_factory=Counter)
    told: Counter = field(default_factory=Counter)
    kinds: dict = field(default_factory=lambda: defaultdict(lambda: [0, 0]))
    lags: list = field(default_factory=list)
    shortfalls: list = field(default_factory=list)
    minutes: float = 0.0
    alarms: int = 0

    def add(self, case, events, twin_events):
        """One row: pairs of the same class at IoU >= 0.5, best first, each used once."""
        pairs = []
        for i, t in enumerate(case.truths):
            for j, e in enumerate(events):
                both = min(t.end_s, e.end_s) - max(t.start_s, e.start_s)
                iou = both / (max(t.end_s, e.end_s) - min(t.start_s, e.start_s))
                needs_limb = t.kind not in ("global", "body shift")
                if CLASS_OF[t.kind] == e.kind and iou >= 0.5 and (not needs_limb or set(t.segments) & set(e.segments)):
                    pairs.append((iou, i, j))
        used_t, used_e = set(), set()
        for _, i, j in sorted(pairs, reverse=True):
            if i in used_t or j in used_e:
                continue
            used_t.add(i)
            used_e.add(j)
            t, e = case.truths[i], events[j]
            self.right[CLASS_OF[t.kind]] += 1
            if t.lag_ms is not None and e.lag_ms is not None:
                self.lags.append(abs(t.lag_ms - e.lag_ms))
            if t.shortfall_deg is not None and e.shortfall_deg is not None:
                self.shortfalls.append(abs(t.shortfall_deg - e.shortfall_deg))
        for i, t in enumerate(case.truths):
            self.truth[CLASS_OF[t.kind]] += 1
            self.kinds[t.kind][0] += i in used_t
            self.kinds[t.kind][1] += 1
        for e in events:
            self.told[e.kind] += 1
        self.alarms += len(twin_events)
        self.minutes += len(case.clean) / case.clean.rate / 60

    def scores(self):
        """Precision, recall and F of each class."""
        result = {}
        for c in CLASSES:
            if self.truth[c] or self.told[c]:
                p, r = self.right[c] / max(self.told[c], 1), self.right[c] / max(self.truth[c], 1)
                result[c] = {"precision": p, "recall": r, "f": 2 * p * r / max(p + r, 1e-9)}
        return result

    def macro(self):
        """Mean F over the classes."""
        values = [v["f"] for v in self.scores().values()]
        return float(np.mean(values)) if values else float("nan")

    def micro(self):
        """F over all events."""
        return 2 * self.right.total() / max(self.told.total() + self.truth.total(), 1)

    def wrong(self):
        """Reports that match nothing, twins included."""
        return self.told.total() - self.right.total() + self.alarms


def judge(cases, ask):
    """Tallies by row key: (group, dataset, number of references), and of clean real takes."""
    tallies, clean = defaultdict(Tally), defaultdict(Tally)
    for case in cases:
        references = [r.motion() for r in case.references]
        good, bad = case.clean.motion(), case.wrong.motion()
        for count in case.counts:
            twin_events, _ = ask(references[:count], good)
            if case.group in ("real", "clean"):
                clean[case.dataset, count].add(dataclasses.replace(case, truths=[]), [], twin_events)
            if case.twin and case.truths:
                tallies[case.group, case.dataset, count].add(case, ask(references[:count], bad)[0], twin_events)
    return tallies, clean


def join(tallies, wanted=lambda key: True):
    """One tally of many."""
    whole = Tally()
    for key, t in tallies.items():
        if wanted(key):
            whole.right += t.right
            whole.truth += t.truth
            whole.told += t.told
            for kind, (a, b) in t.kinds.items():
                whole.kinds[kind] = [whole.kinds[kind][0] + a, whole.kinds[kind][1] + b]
            whole.lags += t.lags
            whole.shortfalls += t.shortfalls
            whole.minutes += t.minutes
            whole.alarms += t.alarms
    return whole


def summarise(tallies, clean):
    """The rows of the main table for one candidate."""
    rows, whole = {}, join(tallies)
    if tallies:
        rows["macro F, all"] = whole.macro()
        rows["F over all events, reports on clean twins counted as wrong"] = (
            2 * whole.right.total() / (whole.told.total() + whole.alarms + whole.truth.total())
        )
        for c, v in whole.scores().items():
            rows |= {f"{c}: {k}": v[k] for k in ("precision", "recall", "f")}
        rows |= {f"macro F, {s}": join(tallies, lambda k, s=s: k[1] == s).macro() for s in SETS}
        for g, c in sorted({(k[0], k[2]) for k in tallies}, key=lambda p: (GROUPS.index(p[0]), p[1])):
            part = join(tallies, lambda k, g=g, c=c: k[0] == g and k[2] == c)
            rows[f"macro F, {g}, {c} ref"] = part.macro()
        rows["F, two at once (all events)"] = join(tallies, lambda k: k[0] == "two at once").micro()
        rows |= {f"recall, {k} ({whole.kinds[k][1]})": whole.kinds[k][0] / max(whole.kinds[k][1], 1) for k in KINDS}
        rows["lag MAE, ms"] = float(np.mean(whole.lags)) if whole.lags else float("nan")
        rows["shortfall MAE, deg"] = float(np.mean(whole.shortfalls)) if whole.shortfalls else float("nan")
        rows["false events a minute, all clean twins"] = whole.alarms / whole.minutes
        rows["wrong reports"] = float(whole.wrong())
        for g in ("real", "made-up"):
            for s in SETS:
                first = join(tallies, lambda k, g=g, s=s: k == (g, s, 1)).macro()
                for c in (3, 5):
                    if (g, s, c) in tallies:
                        more = tallies[g, s, c].macro()
                        rows[f"never worse: {g}, {s}, {c} minus 1 ref"] = more - first
    for c in (1, 3, 5):
        for s in ("all", "HDM05", "Bandai", "UTD"):
            part = join(clean, lambda k, c=c, s=s: k[1] == c and s in ("all", k[0]))
            if part.minutes:
                rows[f"clean real takes, events a minute, {s}, {c} ref"] = part.alarms / part.minutes
    return rows
