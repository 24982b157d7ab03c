"""Rows about takes: strangers labelled, and repetitions counted."""

from __future__ import annotations

import csv
import re
from pathlib import Path

import numpy as np

from lab.exams.search.commands import build, label
from lab.exams.search.context import Line
from lab.exams.search.marks import calibration_error, counted, f_measure, frames, luck, match, named_right, placed_right
from lab.exams.search.material import Clip, cut_segments, disturb, hold_out, load
from lab.exams.search.takes import MOTIONS, draw_cycles, draw_made, draw_take, make_cycles
from lab.places import ROOT

PERSON = r"name:(s\d+)_"  # of the takes of UTKinect


def without(takes, people):
    """Takes of all others."""
    return {p: t for p, t in takes.items() if p.name[:3] not in people}


def calibration_line(name, rows, plain=(), target="<= 0.05"):
    """The calibration error of dousa and of the baseline."""
    if not rows:
        return Line(name, float("nan"), note="nothing said")
    said, right = np.mean([r[0] for r in rows]), np.mean([r[1] for r in rows])
    note = f"n {len(rows)}, said {said:.2f}, right {right:.2f}; {luck(rows):.3f} by luck alone"
    return Line(name, calibration_error(rows), calibration_error(list(plain)), target, note)


def strangers(context):
    """1. UTKinect: learned from the annotated takes of four people, both takes of the fifth labelled; all five."""
    marks = {"dousa": [], "never unknown": [], "baseline": [], "baseline, never unknown": []}
    events = {name: [] for name in marks}
    usual = {"dousa": [], "baseline": []}  # without one table's push of 35 s, in which most else happens, too
    named, placed, plain, unknown_at_0 = [], [], [], []
    by_person, names = {}, {}
    for person in sorted({p.name[:3] for p in context.takes}):
        others = without(context.takes, (person,))
        library = context.folder / f"utkinect_without_{person}.dousa"
        build(library, (), others, "beside", PERSON)
        nearest = context.nearest(cut_segments(others, context.folder / "segments"))
        for path, truth in context.takes.items():
            if path in others:
                continue
            take = load(path)
            told = {
                "dousa": label(library, path),
                "never unknown": label(library, path, "--threshold", 0),
                "baseline": nearest.label(take),
                "baseline, never unknown": nearest.label(take, never_unknown=True),
            }
            for name, segments in told.items():
                marks[name].append(frames(truth, segments, take.seconds))
                events[name].append(match(truth, segments))
                if name in usual:
                    usual[name] += [frames([t], segments, take.seconds) for t in truth if t[1] - t[0] < 20]
            by_person.setdefault(person, []).append(marks["dousa"][-1])
            for part in truth:
                names.setdefault(part[2], []).append(frames([part], told["dousa"], take.seconds))
            named += named_right(truth, [t[:4] for t in told["dousa"]])
            placed += placed_right(truth, told["dousa"])
            plain += placed_right(truth, told["baseline"])
            unknown_at_0.append(1 - sum(t[1] - t[0] for t in told["never unknown"]) / take.seconds)
    total = {name: np.sum(rows, axis=0) for name, rows in marks.items()}
    share = {name: (t[0] / t[1], t[2] / t[3]) for name, t in total.items()}
    people = {p: np.sum(r, axis=0) for p, r in by_person.items()}
    note = ", ".join(f"{p} {r[0] / r[1]:.2f}" for p, r in people.items())
    each = ", ".join(f"{k} {np.sum(r, axis=0)[0] / np.sum(r, axis=0)[1]:.2f}" for k, r in names.items())
    return [
        Line("annotated frames right", share["dousa"][0], share["baseline"][0], ">= 0.92", note),
        Line("the same without a push of 35 s", *(_share(rows) for rows in usual.values()), ">= 0.92"),
        Line("by category, mean", float(np.mean([s[0] / s[1] for s in _sums(names)])), note=each),
        Line("unlabelled frames called something", share["dousa"][1], share["baseline"][1]),
        Line("event F, IoU 0.5", f_measure(events["dousa"]), f_measure(events["baseline"])),
        Line("frames right, threshold 0", share["never unknown"][0], share["baseline, never unknown"][0]),
        Line("time unknown at threshold 0", float(np.mean(unknown_at_0)), target="0"),
        calibration_line("calibration error, place right", placed, plain),
        calibration_line("calibration error, name right", named),
    ]


def _sums(table):
    return [np.sum(rows, axis=0) for rows in table.values()]


def _share(rows):
    right, there, *_ = np.sum(rows, axis=0)
    return right / there


CONDITIONS = {"clean": (None, False), "Kinect-like": (None, True), "tempo 0.7 to 1.4": ((0.7, 1.4), False)}
CONDITIONS["tempo and Kinect-like"] = ((0.7, 1.4), True)


def joined(context):
    """2. Takes of a clip of each category by a person held out (UTD s7, s1; HDM05 dg, bd; 2 takes each), joined."""
    lines = []
    for dataset, people in (("utd", ("7", "1")), ("hdm05", ("dg", "bd"))):
        counts = {name: ([], []) for name in CONDITIONS}
        for person in people:
            learned, asked = hold_out(context.sets[dataset], person)
            library = context.folder / f"joined_{dataset}_{person}.dousa"
            build(library, learned)
            nearest = context.nearest(learned)
            for i in range(2):
                for name, (tempo, bad) in CONDITIONS.items():
                    take, truth = draw_take(asked, context.rng("joined", dataset, person, i), tempo)
                    if bad:
                        take = disturb(take, context.rng("sensor", dataset, person, i))
                    path = context.write(take, "joined", dataset, person, i, name.replace(" ", ""))
                    counts[name][0].append(match(truth, label(library, path)))
                    counts[name][1].append(match(truth, nearest.label(take)))
        for name, (ours, plain) in counts.items():
            hits, there, told = np.sum(ours, axis=0)
            target = {"utd": ">= 0.922", "hdm05": ">= 0.979"}[dataset] if name == "clean" else ""
            note = f"{hits} of {there} found, {told} told"
            lines.append(Line(f"{dataset}, {name}: event F", f_measure(ours), f_measure(plain), target, note))
    return lines


# Frames: the first is 0; what lies between the earliest and the latest end of an action belongs to nobody.
NAMES_86 = {
    "walk": ("sneak2StepsLStart", "walk"),
    "jump": ("hopBothLegs1hops",),
    "leg_kick": ("kickLFront1Reps",),
    "punch": ("boxing",),
}


def read_list(path, take="86 01", rate=120.0):
    """A take of CMU's list: [(start, end, name)] in s."""
    text = re.split(r"\n\s*\n", Path(path).read_text(encoding="utf-8").replace("\r", ""))
    lines = next(part for part in text if part.strip().startswith(take)).strip().splitlines()[1:]
    truth, start = [], 0
    for name, earliest, _, latest in (line.split() for line in lines):
        truth.append((start / rate, int(earliest) / rate, name))
        start = int(latest)
    return truth


def foreign_take(context):
    """4. cmu86 01 by the labels of others: walk = sneak2Steps or walk (not jog), jump = hop, leg_kick = kick, punch =
    boxing; two libraries."""
    path = next(context.root.glob("cmu86/*.amc"))
    truth, seconds = read_list(context.root / "cmu86/mocap.txt"), load(path).seconds
    hdm, utd = context.sets["hdm05"], context.sets["utd"]
    lines = []
    for sets, learned in (("HDM05", hdm), ("HDM05 and UTD s1 s3", hdm + [c for c in utd if c.person in "13"])):
        names = {c.category for c in learned}
        shared = [t for t in truth if names & set(NAMES_86[t[2]])]
        library = context.folder / f"cmu86_{len(learned)}.dousa"
        build(library, learned)
        told, plain = label(library, path), context.nearest(learned).label(load(path))
        told_0 = label(library, path, "--threshold", 0)

        def same(want, name):
            return name in NAMES_86[want]

        marks = [frames(shared, t, seconds, same) for t in (told, plain, told_0)]
        parts = [frames([t], told, seconds, same) for t in shared]
        note = ", ".join(f"{t[2]} {m[0] / m[1]:.2f}" for t, m in zip(shared, parts, strict=True))
        share = [m[0] / m[1] for m in marks]
        lines += [
            Line(f"{sets}: frames of shared names right", share[0], share[1], ">= 0.6", note),
            Line(f"{sets}: the same, threshold 0", share[2]),
            Line(f"{sets}: actions found", match(shared, told, same)[0] / len(shared), note=f"of {len(shared)}"),
        ]
    return lines


def repetitions(context):
    """5. How often: UTKinect waves and claps (2 people left out at a time), HDM05 joined cycles, a made figure.

    dousa has to find the segments itself; the baseline is told where they lie."""
    lines = []
    for name, ask in (("UTKinect", count_utkinect), ("HDM05 joined", count_cycles), ("made figure", count_made)):
        rows, plain = ask(context)
        off, table = [d for _, d in rows], {}
        for category, d in rows:
            table.setdefault(category, []).append("none" if d is None else f"{d:+d}" if d else "0")
        found = [d for d in off if d is not None]
        note = f"n {len(off)}; differences: " + "; ".join(f"{k} {' '.join(v)}" for k, v in table.items())
        lines += [
            Line(f"{name}: exact", _within(off, 0), _within(plain, 0), ">= 0.8", note),
            Line(f"{name}: within one", _within(off, 1), _within(plain, 1), ">= 0.95"),
            Line(f"{name}: exact, of those found", _within(found, 0)),
        ]
    return lines


def _within(off, most):
    return float(np.mean([d is not None and abs(d) <= most for d in off])) if off else float("nan")


def plain_count(points):
    """The baseline, which is told where the segment lies: how often its main movement crosses its middle upwards."""
    centred = (points.positions - points.positions[:, :1]).reshape(len(points), -1)
    centred = centred - centred.mean(0)
    x = centred @ np.linalg.svd(centred, full_matrices=False)[2][0]
    steps = max(round(0.3 * points.rate), 1)
    x = np.convolve(x, np.ones(steps) / steps, "same") - np.median(x)
    up = max(int(((x[1:] > 0) & (x[:-1] <= 0)).sum()), int(((x[1:] <= 0) & (x[:-1] > 0)).sum()))
    return max(up, 1)


def _marked(take, truth, told):
    off = zip((str(t[2]) for t in truth), counted(truth, told), strict=True)
    return list(off), [plain_count(take.cut(t[0], t[1])) - t[3] for t in truth]


def count_utkinect(context):
    """Waves and claps, counted by eye in a table of the benchmarks."""
    with open(ROOT / "lab/training/utkinect_counts.csv", newline="", encoding="utf-8") as file:
        seen = {(r["take"], r["category"]): int(r["count"]) for r in csv.DictReader(file) if r["count"]}
    off, plain = [], []
    for people in (("s01", "s02"), ("s03", "s04"), ("s05",)):
        others = without(context.takes, people)
        library = context.folder / f"counts_without_{people[0]}.dousa"
        build(library, (), others, "beside", PERSON)
        for path in (p for p in context.takes if p not in others):
            truth = [(*t, seen[path.stem, t[2]]) for t in context.takes[path] if (path.stem, t[2]) in seen]
            rows = _marked(load(path), truth, label(library, path))
            off, plain = off + rows[0], plain + rows[1]
    return off, plain


CYCLES = (
    "squat1Reps",
    "elbowToKnee1RepsLelbowStart",
    "hopBothLegs1hops",
    "kickLFront1Reps",
    "rotateArmsBothBackward1Reps",
)


def count_cycles(context):
    """Single cycles of HDM05 by dg and by bd (held out), 1 to 8 of each end to end, 3 takes each."""
    off, plain = [], []
    for person in ("dg", "bd"):
        learned, asked = hold_out(context.sets["hdm05"], person)
        library = context.folder / f"cycles_{person}.dousa"
        build(library, learned)
        for i in range(3):
            take, truth = draw_cycles(asked, CYCLES, context.rng("cycles", person, i))
            rows = _marked(take, truth, label(library, context.write(take, "cycles", person, i)))
            off, plain = off + rows[0], plain + rows[1]
    return off, plain


def count_made(context):
    """A made figure: learned from 6 bodies with 2 clips of 1 or 2 cycles each, asked about 6 others, 1 to 10 cycles."""
    rng, clips = context.rng("made"), []
    for person in range(6):
        size = rng.uniform(0.85, 1.15)
        for name in MOTIONS:
            for i in range(2):
                path = context.write(make_cycles(name, i + 1, rng, size), "made", person, name, i)
                clips.append(Clip("made", path, name, str(person)))
    library = context.folder / "made.dousa"
    build(library, clips)
    off, plain = [], []
    for i in range(6):
        take, truth = draw_made(context.rng("made take", i))
        rows = _marked(take, truth, label(library, context.write(take, "made_take", i)))
        off, plain = off + rows[0], plain + rows[1]
    return off, plain
