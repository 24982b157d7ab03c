"""Rows on exercises that therapists or their makers called correct or incorrect."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from dousa.evaluation import SEGMENTS, compute_segments
from dousa.motion import mirror_canonical
from lab.exams.exercises.answers import Answer, Asker
from lab.exams.exercises.baselines import NAMES, Plain, make_both, measure_plainly
from lab.exams.exercises.material import (
    FAULTY,
    MOVEMENTS,
    Repetition,
    draw_others,
    draw_own,
    find_area,
    read_irds,
    read_uiprmd,
)

SYSTEMS = ("dousa", *NAMES)
_WITHHELD = 0.3


@dataclass(frozen=True, slots=True)
class Judged:
    """One repetition beside its references: how good it is by every system, larger is better."""

    repetition: Repetition
    draw: int
    goodness: dict[str, float]
    answer: Answer
    moving: frozenset[str]


class Judges:
    """Dousa and the plain measures, which see a motion once."""

    def __init__(self, asker: Asker, only: str | None = None) -> None:
        self.asker, self.only = asker, only
        self._plain: dict[int, list[Plain]] = {}
        self._kept: list[object] = []

    def _get(self, motion) -> list[Plain]:
        if id(motion) not in self._plain:
            self._plain[id(motion)] = make_both(motion)
            self._kept.append(motion)
        return self._plain[id(motion)]

    def judge(self, references: list[Repetition], one: Repetition, draw: int) -> Judged:
        """What everybody says of a repetition."""
        motions = [reference.motion for reference in references]
        goodness, answer = {}, Answer(math.nan)
        if self.only != "baseline":
            answer = self.asker.ask(motions, one.motion)
            goodness["dousa"] = -1.0 if math.isnan(answer.score) else answer.score
        if self.only != "dousa":
            plain = measure_plainly([self._get(motion)[0] for motion in motions], self._get(one.motion))
            goodness |= {name: -value for name, value in plain.items()}
        return Judged(one, draw, goodness, answer, find_moving(references[0]))


def find_moving(reference: Repetition) -> frozenset[str]:
    """Segments that move more than their twin of the other side, from their spread of directions."""
    spread = compute_segments(reference.motion.positions).std(axis=0).sum(axis=1)
    moves = dict(zip(SEGMENTS, spread, strict=True))
    return frozenset(
        name
        for name in SEGMENTS[1:]
        if moves[name] >= moves[name.replace("left", "RIGHT").replace("right", "left").replace("RIGHT", "right")]
    )


def judge_others(judges: Judges, repetitions: list[Repetition], count: int, draws: int) -> Iterator[Judged]:
    """Every repetition beside references by other people."""
    for draw in range(draws):
        for one in repetitions:
            references = draw_others(repetitions, one.person, count, draw)
            yield judges.judge(references, one, draw)


def judge_own(judges: Judges, repetitions: list[Repetition], count: int, draws: int) -> Iterator[Judged]:
    """Every repetition that is no reference beside references by the same person."""
    for draw in range(draws):
        for one in repetitions:
            references = draw_own(repetitions, one.person, one.exercise, count, draw)
            if len(references) == count and all(one is not other for other in references):
                yield judges.judge(references, one, draw)


def tell_areas(judged: list[Judged], system: str, within: bool = False) -> dict[str, float]:
    """AUROC of each exercise, all people together or the mean of each person's own, the mean over draws."""
    values: dict[tuple[str, int, str], tuple[list[float], list[float]]] = defaultdict(lambda: ([], []))
    for one in judged:
        person = one.repetition.person if within else ""
        values[one.repetition.exercise, one.draw, person][not one.repetition.correct].append(one.goodness[system])
    areas = defaultdict(list)
    for (exercise, _, _), both in sorted(values.items()):
        areas[exercise].append(find_area(*both))
    return {exercise: float(np.nanmean(some)) for exercise, some in areas.items()}


def sit_uiprmd(judges: Judges, options) -> dict[str, dict[str, float]]:
    """All rows of UI-PRMD: row -> system -> number."""
    rows: dict[str, dict[str, float]] = {}
    counts = (3,) if options.quick else (1, 3, 5)
    for sensor in options.sensors:
        pools: dict[int | str, list[Judged]] = defaultdict(list)
        for movement in MOVEMENTS:
            repetitions = read_uiprmd(options.data, sensor, movement, options.stride)
            for count in counts:
                pools[count] += judge_others(judges, repetitions, count, options.draws)
            if not options.quick:
                everything = read_uiprmd(options.data, sensor, movement, 1) if options.stride > 1 else repetitions
                taken = {one.name + str(one.correct) for one in repetitions}
                pools["own"] += [one for one in judge_own(judges, _thin(everything, taken), 3, 1)]
        for count, judged in pools.items():
            name = f"UI-PRMD {sensor}, own 3" if count == "own" else f"UI-PRMD {sensor}, {count} by others"
            rows |= _tell(name, judged, count == 3)
    return rows


def _thin(everything: list[Repetition], taken: set[str]) -> list[Repetition]:
    """All correct ones (of which references are drawn), and the incorrect ones that are asked about."""
    return [one for one in everything if one.correct or one.name + "False" in taken]


def _tell(name: str, judged: list[Judged], detailed: bool) -> dict[str, dict[str, float]]:
    systems = [system for system in SYSTEMS if system in judged[0].goodness]
    areas = {system: tell_areas(judged, system) for system in systems}
    rows = {f"{name}: AUROC, mean": {s: float(np.nanmean(list(areas[s].values()))) for s in systems}}
    within = {system: tell_areas(judged, system, within=True) for system in systems}
    rows[f"{name}: AUROC within each person, mean"] = {s: float(np.nanmean(list(within[s].values()))) for s in systems}
    rows[f"{name}: AUROC, worst movement"] = {s: float(np.nanmin(list(areas[s].values()))) for s in systems}
    if not detailed:
        return rows
    for exercise in areas[systems[0]]:
        rows[f"{name}: AUROC, {exercise}"] = {s: areas[s][exercise] for s in systems}
    rows[f"{name}: accuracy of the surer 70 %, gained"] = {s: gain_accuracy(judged, s) for s in systems}
    if "dousa" in systems:
        rows |= {f"{name}: {key}": {"dousa": value} for key, value in tell_words(judged).items()}
    return rows


def gain_accuracy(judged: list[Judged], system: str) -> float:
    """By how much leaving out the least sure 30 % lifts the accuracy of the rest.

    The limit between correct and incorrect is the best one on the other people, for each exercise. Least sure is
    what has no grade, then what lies closest to the limit in units of the half interval, where one is told.
    """
    surely, right = [], []
    for exercise in {one.repetition.exercise for one in judged}:
        some = [one for one in judged if one.repetition.exercise == exercise]
        for person in {one.repetition.person for one in some}:
            others = [one for one in some if one.repetition.person != person]
            if not others:
                continue
            values = np.array([one.goodness[system] for one in others])
            labels = np.array([one.repetition.correct for one in others])
            limits = np.unique(values)
            limits = np.append(limits, limits[-1] + 1.0)
            scores = [(((values >= limit) == labels).mean()) for limit in limits]
            best = int(np.argmax(scores))
            limit = (limits[best] + limits[max(best - 1, 0)]) / 2.0
            for one in some:
                if one.repetition.person == person:
                    value = one.goodness[system]
                    half = one.answer.half if system == "dousa" and one.answer.half > 0.0 else 1.0
                    spread = 1.0 if system == "dousa" else float(values.std()) or 1.0
                    told = system != "dousa" or not math.isnan(one.answer.score)
                    surely.append(abs(value - limit) / half / spread if told else -1.0)
                    right.append((value >= limit) == one.repetition.correct)
    order = np.argsort(surely, kind="stable")[round(_WITHHELD * len(surely)) :]
    return float(np.mean(np.array(right)[order]) - np.mean(right))


def tell_words(judged: list[Judged]) -> dict[str, float]:
    """What is said of repetitions, beside the grade."""
    wrong = [one for one in judged if not one.repetition.correct]
    good = [one for one in judged if one.repetition.correct]
    told = [one for one in wrong if one.answer.named]
    named = [_is_named(one) for one in told]
    by_chance = [np.mean([_at_fault(one, segment) for segment in SEGMENTS]) for one in told]
    return {
        "joint named rightly, of those with an answer": float(np.mean(named)) if named else math.nan,
        "the same, a segment at random": float(np.mean(by_chance)) if named else math.nan,
        "incorrect ones with something named": len(told) / len(wrong),
        "correct ones with something named": float(np.mean([bool(one.answer.named) for one in good])),
        "incorrect ones graded 90 or above": float(np.mean([one.answer.score >= 90.0 for one in wrong])),
        "correct ones without a grade": float(np.mean([math.isnan(one.answer.score) for one in good])),
        "incorrect ones without a grade": float(np.mean([math.isnan(one.answer.score) for one in wrong])),
    }


def _is_named(one: Judged) -> bool:
    """Most of what is told first is at fault; all nine segments name nothing."""
    if len(one.answer.named) == len(SEGMENTS):
        return False
    return float(np.mean([_at_fault(one, segment) for segment in one.answer.named])) > 0.5


def _at_fault(one: Judged, segment: str) -> bool:
    for fault in FAULTY[one.repetition.exercise]:
        part = fault.removeprefix("moving ")
        if segment.endswith(part) and (part == fault or segment in one.moving):
            return True
    return False


def sit_irds(judges: Judges, options) -> dict[str, dict[str, float]]:
    """Person 215 of IntelliRehabDS beside own correct repetitions; g1 has none: beside mirrored ones of g0."""
    everything = read_irds(options.data)
    for one in [one for one in everything if one.exercise == "g0"]:
        everything.append(Repetition("g1", one.person, True, one.name + "_mirrored", mirror_canonical(one.motion)))
    exercises = {one.exercise for one in everything if not one.correct}
    repetitions = [one for one in everything if one.exercise in exercises]
    rows = {}
    for count in (3,) if options.quick else (1, 3, 5):
        judged = list(judge_own(judges, repetitions, count, options.draws))
        systems = [system for system in SYSTEMS if system in judged[0].goodness]
        pooled = {s: find_pooled(judged, s) for s in systems}
        rows[f"IRDS 215, own {count}: AUROC, pooled"] = pooled
        areas = {s: tell_areas(judged, s) for s in systems}
        rows[f"IRDS 215, own {count}: AUROC, mean of exercises"] = {
            s: float(np.nanmean(list(areas[s].values()))) for s in systems
        }
    return rows


def find_pooled(judged: list[Judged], system: str) -> float:
    """AUROC over all exercises together."""
    good, bad = ([one.goodness[system] for one in judged if one.repetition.correct is label] for label in (True, False))
    return find_area(good, bad)
