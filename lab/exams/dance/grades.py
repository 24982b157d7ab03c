"""What the grade is worth: takes, other people, severity, parts and other dances; and exercises."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from sklearn.metrics import roc_auc_score

import dousa
from lab.exams.dance.bodies import mix, performer
from lab.exams.dance.cases import SETS
from lab.exams.dance.placing import Deck, put_errors


def none_as(grade):
    """No grade counts as 0."""
    return 0.0 if grade is None else grade


def grade_check(material, ask, seed):
    """What the grade is worth: second takes, severity, parts, other dances."""
    return (
        check_takes(material, ask, seed)
        | check_people(material, ask)
        | check_severity(material, ask, seed)
        | check_parts(material, ask, seed)
    )


def check_takes(material, ask, seed):
    """Grades of real second takes by the same person."""
    rows = {}
    for count in (1, 3, 5):
        for name in ("HDM05", "Bandai", "UTD"):
            grades = []
            for i in range(12):
                takes = [b.motion() for b in material.takes(name, np.random.default_rng([seed, 77, i]))]
                if len(takes) > count:
                    grades.append(none_as(ask(takes[1 : count + 1], takes[0])[1]))
            if grades:
                rows[f"grade, own second take, {name}, {count} ref: median"] = float(np.median(grades))
                rows[f"grade, own second take, {name}, {count} ref: 10th percentile"] = float(np.percentile(grades, 10))
    return rows


def check_people(material, ask):
    """Grades of another person, of another system."""
    dg, s7 = (
        [material.body(p).motion() for p in paths][:4] for paths in (material.hdm["squat1Reps"], material.utd["a27"])
    )
    others = [none_as(ask([a], b)[1]) for a in dg for b in s7] + [none_as(ask([b], a)[1]) for a in dg for b in s7]
    return {"grade, other person (squat, dg and s7, two sensors): median": float(np.median(others))}


def check_severity(material, ask, seed):
    """Grades of errors that grow."""
    falls, whole, span = [], [], []
    for i in range(20):
        rng = np.random.default_rng([seed, 78, i])
        recording = material.recording(SETS[i % 5], i, rng)
        clean = performer(recording, rng)
        wrong, truths = put_errors(clean, 2, rng, Deck(rng), material.donors[SETS[i % 5]])
        if truths:
            ladder = [
                none_as(ask([recording.motion()], clean.having(dirs=mix(clean.dirs, wrong.dirs, s)).motion())[1])
                for s in (0, 0.25, 0.5, 0.75, 1)
            ]
            steps = np.diff(ladder)
            falls += list(steps <= 1.0)
            whole.append(bool((steps <= 1.0).all() and ladder[-1] < ladder[0]))
            span.append(ladder[0] - ladder[-1])
    return {
        "grade, severity: share of steps that do not rise": float(np.mean(falls)),
        "grade, severity: share of monotone ladders": float(np.mean(whole)),
        "grade, severity: median fall from 0 to 1": float(np.median(span)),
    }


def check_parts(material, ask, seed):
    """Grades of a tenth of the dance, and of another dance."""
    parts, strangers = [], []
    for i in range(20):
        rng = np.random.default_rng([seed, 79, i])
        name = ("HDM05", "UTD", "dance", "CMU")[i % 4]
        recording = material.recording(name, i, rng)
        n = len(recording)
        a = rng.integers(0, n - n // 10)
        parts.append(ask([recording.motion()], performer(recording, rng).cut(a, a + n // 10).motion())[1])
        other = material.recording(("dance", "CMU", "HDM05", "UTD")[i % 4], i + 1, rng)
        strangers.append(ask([recording.motion()], other.motion())[1])
    parts, strangers = [none_as(g) for g in parts], [none_as(g) for g in strangers]
    return {
        "grade, 10 % of the dance: share without a good grade (none or < 50)": float(np.mean([g < 50 for g in parts])),
        "grade, 10 % of the dance: median": float(np.median(parts)),
        "grade, another dance: share none or < 20": float(np.mean([g < 20 for g in strangers])),
        "grade, another dance: greatest": float(max(strangers)),
    }


def irds_check(root, ask):
    """AUROC of the grade for repetitions that a physiotherapist called correct, first five as references."""
    rows, labels, grades, means = {}, [], [], []
    for folder in sorted((Path(root) / "irds").glob("g*")):

        def load(kind, f=folder):
            return [dousa.canonicalise(dousa.read_motion(p)) for p in sorted((f / kind).glob("*.trc"))]

        good, bad = load("correct"), load("incorrect")
        if len(good) < 5:
            continue
        judged = [(1, m) for m in good[5:]] + [(0, m) for m in bad]
        got = [(label, ask(good[:5], m)[1]) for label, m in judged]
        got = [(label, none_as(g)) for label, g in got]
        labels += [label for label, _ in got]
        grades += [g for _, g in got]
        if len({label for label, _ in got}) == 2:
            means.append(roc_auc_score(*zip(*got, strict=True)))
            rows[f"IRDS AUROC, {folder.name} ({len(good) - 5} correct, {len(bad)} not)"] = float(means[-1])
    rows["IRDS AUROC, mean of exercises"] = float(np.mean(means))
    rows[f"IRDS AUROC, pooled ({sum(labels)} correct, {len(labels) - sum(labels)} not)"] = float(
        roc_auc_score(labels, grades)
    )
    return rows
