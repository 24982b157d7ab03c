"""Where errors are put, and what a teacher sees of them: the truth of a performance."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from lab.exams.dance.bodies import ALL, LIMBS, NAMES, angle
from lab.exams.dance.errors import (
    body_shift,
    body_shrunk,
    draw_window,
    limb_shift,
    limb_shrunk,
    other_figure,
    stops_short,
    wrong_limb,
)

CLASSES = ("shift", "incomplete", "partial", "global")
KINDS = ("body shift", "limb shift", "stops short", "limb shrunk", "body shrunk", "partial", "global")
CLASS_OF = dict(
    zip(KINDS, ("shift", "shift", "incomplete", "incomplete", "incomplete", "partial", "global"), strict=True)
)


# What a teacher sees: deg that count as deviating, and the peak below which an error is not put to the candidate.
SEEN = {"shift": 6.0, "incomplete": 6.0, "partial": 12.0, "global": 12.0}
LEAST = {"shift": 12.0, "incomplete": 12.0, "partial": 20.0, "global": 20.0}


@dataclass
class Truth:
    """What was put in, in seconds of the performance."""

    kind: str
    start_s: float
    end_s: float
    segments: tuple[str, ...]
    lag_ms: float | None = None
    shortfall_deg: float | None = None


def top_speed(body):
    """Greatest deg/s of a segment."""
    x = body.segments()
    return float(angle(x[1:], x[:-1]).max() * body.rate)


def level_segments(body, facing):
    """(T, 9, 3) directions of the segments, seen from the body."""
    return body.turned(-facing).segments()


def spread(dirs):
    """Largest angle between two of the directions (T, S, 3), for each segment."""
    few = dirs[:: max(1, len(dirs) // 80)]
    return np.array(
        [np.degrees(np.arccos(np.clip(few[:, s] @ few[:, s].T, -1, 1))).max() for s in range(dirs.shape[1])]
    )


def measure(kind, clean, wrong, draw, among, lag_s=None):
    """The truth of an error if a teacher can see it, else None."""
    group, rate = CLASS_OF[kind], clean.rate
    facing = clean.heading()
    x, y = level_segments(clean, facing), level_segments(wrong, facing)
    off = angle(x, y)
    acting = np.zeros(len(clean), bool)
    acting[draw.a : draw.b + 1] = True
    acting &= draw.weight >= 0.5 if kind != "stops short" else True
    seen = (off[:, among].max(1) > SEEN[group]) & acting
    if not seen.any():
        return None
    first, last = np.flatnonzero(seen)[[0, -1]]
    inside = slice(first, last + 1)
    if (last + 1 - first) / rate < 0.4 or seen[inside].mean() < 0.55:
        return None
    peak = off[inside].max(0)
    wide = slice(max(0, first - round(0.5 * rate)), last + 1 + round(0.5 * rate))
    shortfall = None
    if group == "shift":
        strong = peak >= LEAST[group]
    elif group == "incomplete":
        missing = spread(x[wide]) - spread(y[wide])
        strong = missing >= LEAST[group]
        shortfall = float(missing[among].max())
    else:  # a posture that the clean path does not have anywhere near
        path = x[wide][:: max(1, int(rate // 30))]
        dots = np.einsum("tsk,usk->tus", y[inside], path)
        strong = np.degrees(np.arccos(np.clip(dots, -1, 1))).min(1).max(0) >= LEAST[group]
    if strong[among].sum() < (5 if kind == "global" else 1):
        return None
    told = tuple(NAMES[s] for s in among if peak[s] > SEEN[group])
    return Truth(kind, first / rate, (last + 1) / rate, told, None if lag_s is None else 1e3 * lag_s, shortfall)


def try_error(kind, body, rng, donors, window=None, limb=None):
    """One attempt: the wrong body, its truth and the draw, or None."""
    lag = rng.choice([-1, 1]) * rng.uniform(0.1, 0.4) if "shift" in kind else 0.0
    draw = draw_window(len(body), body.rate, rng, lag, window)
    limb = limb or rng.choice(list(LIMBS))
    limbs = ["left arm", "right arm"] if kind == "limb shift" and "arm" in limb and rng.random() < 0.35 else [limb]
    among = ALL if kind in ("body shift", "body shrunk", "global") else sorted(s for k in limbs for s in LIMBS[k][1])
    donor = donors[rng.integers(len(donors))]
    wrong = {
        "body shift": lambda: body_shift(body, draw, lag),
        "limb shift": lambda: limb_shift(body, draw, limbs, lag),
        "stops short": lambda: stops_short(body, draw, limb, rng.uniform(0.4, 0.7), rng.random() < 0.5),
        "limb shrunk": lambda: limb_shrunk(body, draw, limb, rng.uniform(0.25, 0.6)),
        "body shrunk": lambda: body_shrunk(body, draw, rng.uniform(0.3, 0.6)),
        "partial": lambda: wrong_limb(body, draw, limb, donor, rng),
        "global": lambda: other_figure(body, draw, donor, rng),
    }[kind]()
    if wrong is None or top_speed(wrong) > max(1.5 * top_speed(body), 1500):  # nobody moves like that
        return None
    truth = measure(kind, body, wrong, draw, among, lag if "shift" in kind else None)
    return None if truth is None else (wrong, truth, draw, lag)


class Deck:
    """Kinds in a shuffled order; one that cannot be placed waits for the next performance."""

    SHARES = (8, 9, 8, 5, 4, 12, 9)

    def __init__(self, rng):
        self.rng, self.cards = rng, []

    def next(self, tried):
        """The first kind not yet tried."""
        while not any(c not in tried for c in self.cards):
            cards = [k for k, n in zip(KINDS, self.SHARES, strict=True) for _ in range(n)]
            self.cards += [cards[i] for i in self.rng.permutation(len(cards))]
        return next(c for c in self.cards if c not in tried)


def put_errors(body, count, rng, deck, donors):
    """Errors at different places of one performance: (wrong body, truths)."""
    truths, wrong = [], body
    while len(truths) < count:
        tried: set[str] = set()
        placed = None
        while placed is None and len(tried) < len(KINDS):
            kind = deck.next(tried)
            tried.add(kind)
            for _ in range(45):
                placed = try_error(kind, wrong, rng, donors)
                if placed and any(
                    placed[1].start_s < t.end_s + 0.7 and t.start_s < placed[1].end_s + 0.7 for t in truths
                ):
                    placed = None
                if placed:
                    break
        if placed is None:
            break
        deck.cards.remove(placed[1].kind)
        wrong = placed[0]
        truths.append(placed[1])
    return wrong, truths


def put_two(body, rng, donors, first):
    """Two errors at the same time: a shifted body with a wrong or small limb, or two limbs wrong each in its way."""
    plans = [
        ("body shift", "partial"), ("limb shift", "stops short"), ("limb shift", "partial"),
        ("body shift", "stops short"), ("body shift", "limb shrunk"),
    ]  # fmt: skip
    for plan in plans[first:] + plans[:first]:
        for _ in range(120):
            two = try_error(plan[1], body, rng, donors, None, rng.choice(list(LIMBS)))
            if two is None:
                continue
            limbs_left = [k for k in LIMBS if not set(two[1].segments) & {NAMES[s] for s in LIMBS[k][1]}]
            one = try_error(plan[0], body, rng, donors, (two[2].a, two[2].b), rng.choice(limbs_left))
            if one is None or (plan[0] == "limb shift" and set(one[1].segments) & set(two[1].segments)):
                continue
            if plan[0] == "body shift":
                wrong = body_shift(two[0], one[2], one[3])
                delay = one[3] * one[2].weight
                moved = [t + delay[min(round(t * body.rate), len(body) - 1)] for t in (two[1].start_s, two[1].end_s)]
                second = dataclasses.replace(two[1], start_s=moved[0], end_s=moved[1])
            else:
                moving = [k for k in LIMBS if {NAMES[s] for s in LIMBS[k][1]} & set(one[1].segments)]
                wrong, second = limb_shift(two[0], one[2], moving, one[3]), two[1]
            return wrong, [one[1], second]
    return body, []
