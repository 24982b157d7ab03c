"""How answers are marked. Segments are (start s, end s, category, ...), those that are told end in a confidence."""

from __future__ import annotations

import numpy as np


def overlap(a, b):
    """Intersection over union of two stretches of time."""
    common = min(a[1], b[1]) - max(a[0], b[0])
    return max(common, 0.0) / (max(a[1], b[1]) - min(a[0], b[0]))


def match(truth, told, same=lambda a, b: a == b, least=0.5):
    """(hits, things that happen, things told): each answers one, of the same category, the best overlap first."""
    pairs = [(overlap(a, b), i, j) for i, a in enumerate(truth) for j, b in enumerate(told) if same(a[2], b[2])]
    rows, columns = set(), set()
    for share, i, j in sorted(pairs, reverse=True):
        if share >= least and i not in rows and j not in columns:
            rows.add(i)
            columns.add(j)
    return np.array((len(rows), len(truth), len(told)))


def f_measure(counts):
    """F of counts as by `match`, summed over takes."""
    hits, truth, told = np.sum(counts, axis=0)
    return 2 * hits / (truth + told) if truth + told else 1.0


def at_times(segments, times):
    """What is said of each time; where segments overlap the shorter one counts, None where there is none."""
    names = np.full(len(times), None, object)
    for start, end, name, *_ in sorted(segments, key=lambda s: s[0] - s[1]):
        names[(times >= start) & (times < end)] = name
    return names


def frames(truth, told, seconds, same=lambda a, b: a == b, step=0.1):
    """(annotated moments right, annotated, others called something, others): a moment every ``step`` s."""
    times = np.arange(step / 2, seconds, step)
    want, said = at_times(truth, times), at_times(told, times)
    right = sum(w is not None and s is not None and bool(same(w, s)) for w, s in zip(want, said, strict=True))
    there = np.array([w is not None for w in want], bool)
    called = np.array([s is not None for s in said], bool)
    return np.array((right, there.sum(), (called & ~there).sum(), (~there).sum()))


def named_right(truth, told, same=lambda a, b: a == b, step=0.05):
    """[(confidence, right)] of segments of which at least half is annotated: by what is annotated there most."""
    rows = []
    for start, end, name, confidence in told:
        want = at_times(truth, np.arange(start + step / 2, end, step))
        there = [w for w in want if w is not None]
        if len(there) * 2 >= len(want) > 0:
            rows.append((confidence, bool(same(max(sorted(set(there)), key=there.count), name))))
    return rows


def placed_right(truth, told, same=lambda a, b: a == b):
    """[(confidence, right)] of all segments: right where one of this name happens, IoU 0.5."""
    return [(t[3], any(same(a[2], t[2]) and overlap(a, t) >= 0.5 for a in truth)) for t in told]


def calibration_error(rows, bins=10):
    """Expected calibration error of [(confidence, right)], bins of equal width; NaN where there are none."""
    if not rows:
        return float("nan")
    p, right = np.array(rows, float).T
    bin_of = np.minimum((p * bins).astype(int), bins - 1)
    return float(sum(abs((p - right)[bin_of == b].sum()) for b in range(bins)) / len(p))


def luck(rows, seed=0, draws=200):
    """The calibration error that these confidences would have on average if they were exactly true."""
    p, rng = np.array([r[0] for r in rows]), np.random.default_rng(seed)
    return float(np.mean([calibration_error(list(zip(p, rng.random(len(p)) < p, strict=True))) for _ in range(draws)]))


def auroc(known, strange):
    """How often a known motion has a higher value than a strange one."""
    a, b = np.asarray(known)[:, None], np.asarray(strange)[None]
    return float(((a > b) + 0.5 * (a == b)).mean())


def counted(truth, told):
    """[(difference or None)] for each (start, end, category, count): by the told segment that overlaps it most.

    ``told``: (start, end, category, confidence, count); None where none of the category overlaps it.
    """
    rows = []
    for a in truth:
        there = [t for t in told if t[2] == a[2] and overlap(a, t) > 0]
        rows.append(max(there, key=lambda t, a=a: overlap(a, t))[4] - a[3] if there else None)
    return rows


def retrieved(found, relevant, tolerated=()):
    """(precision, recall, F) of a set of things found; nothing found where nothing is relevant is right."""
    relevant = set(relevant)
    found = set(found) - (set(tolerated) - relevant)
    if not relevant:
        return (float(not found),) * 3
    hits = len(found & relevant)
    return hits / len(found) if found else 0.0, hits / len(relevant), 2 * hits / (len(found) + len(relevant))
