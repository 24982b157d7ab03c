"""An independent examination of ``dousa.evaluation.assess``.

Errors of known class, time and size are put into real recordings and looked for blind, each performance beside a
clean twin. The constructions follow the words of the specification only. A plain baseline judges the same rows.

    python exam_evaluation.py [--data DIR] [--json FILE] [--only dousa|baseline] [--group NAME ...] [--seed N]
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import re
import time
import zlib
from collections import Counter, defaultdict
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.ndimage import binary_closing, gaussian_filter1d, median_filter, uniform_filter1d
from scipy.spatial.transform import Rotation
from sklearn.metrics import roc_auc_score

import dousa
from dousa.errors import DousaError
from dousa.evaluation import assess
from dousa.motion.canonical.joints import CANONICAL_PARENTS
from dousa.motion.canonical.joints import JOINT_INDEX as J

CLASSES = ("shift", "incomplete", "partial", "global")
KINDS = ("body shift", "limb shift", "stops short", "limb shrunk", "body shrunk", "partial", "global")
CLASS_OF = dict(
    zip(KINDS, ("shift", "shift", "incomplete", "incomplete", "incomplete", "partial", "global"), strict=True)
)
SETS = ("HDM05", "Bandai", "UTD", "dance", "CMU")
GROUPS = ("synthetic", "real", "made-up", "two at once", "clean", "grade", "irds")
SEGMENTS = {
    "trunk": ("pelvis", "neck"),
    **{f"{s}_upper_arm": (f"{s}_shoulder", f"{s}_elbow") for s in ("left", "right")},
    **{f"{s}_forearm": (f"{s}_elbow", f"{s}_wrist") for s in ("left", "right")},
    **{f"{s}_thigh": (f"{s}_hip", f"{s}_knee") for s in ("left", "right")},
    **{f"{s}_shank": (f"{s}_knee", f"{s}_ankle") for s in ("left", "right")},
}
NAMES = tuple(SEGMENTS)
START, END = (np.array([J[pair[i]] for pair in SEGMENTS.values()]) for i in (0, 1))
LIMBS = {
    f"{side} {limb}": ([J[f"{side}_{j}"] for j in joints], [NAMES.index(f"{side}_{s}") for s in parts])
    for side in ("left", "right")
    for limb, joints, parts in (
        ("arm", ("elbow", "wrist", "hand"), ("upper_arm", "forearm")),
        ("leg", ("knee", "ankle", "toe"), ("thigh", "shank")),
    )
}
ALL = list(range(len(NAMES)))
# What a teacher sees: deg that count as deviating, and the peak below which an error is not put to the candidate.
SEEN = {"shift": 6.0, "incomplete": 6.0, "partial": 12.0, "global": 12.0}
LEAST = {"shift": 12.0, "incomplete": 12.0, "partial": 20.0, "global": 20.0}
SEED = 20140


# ---------------------------------------------------------------- bodies


def unit(v):
    """Vectors of length 1."""
    return v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-9)


def angle(a, b):
    """Degrees between unit vectors."""
    return np.degrees(np.arccos(np.clip((a * b).sum(-1), -1, 1)))


def mix(a, b, weight):
    """Directions on the great circle from a (weight 0) to b (weight 1)."""
    weight = np.reshape(weight, np.shape(weight) + (1,) * (a.ndim - np.ndim(weight)))
    apart = np.clip(np.arccos(np.clip((a * b).sum(-1, keepdims=True), -1, 1)), 1e-6, np.pi - 1e-3)
    return unit(np.sin((1 - weight) * apart) * a + np.sin(weight * apart) * b)


def sample(values, at):
    """Values (T, ...) at fractional frames."""
    at = np.clip(at, 0, len(values) - 1)
    low = np.minimum(at.astype(int), max(len(values) - 2, 0))
    share = (at - low).reshape((-1,) + (1,) * (values.ndim - 1))
    return values[low] * (1 - share) + values[np.minimum(low + 1, len(values) - 1)] * share


@dataclass
class Body:
    """A motion as bone directions and lengths, so that edits keep the lengths."""

    dirs: np.ndarray
    lengths: np.ndarray
    root: np.ndarray
    rate: float
    template: object

    @classmethod
    def of(cls, motion):
        """The bones of a canonical motion."""
        step = max(1, round(motion.frame_rate / 60))  # 120 Hz thinned to 60: the exam is to be short
        points = np.array(motion.positions[::step])
        bones = points - points[:, [max(p, 0) for p in CANONICAL_PARENTS]]
        bones[:, 0] = 0
        return cls(unit(bones), np.linalg.norm(bones, axis=2), points[:, 0], motion.frame_rate / step, motion)

    def __len__(self):
        return len(self.dirs)

    def having(self, **changes):
        """A copy with other arrays."""
        return dataclasses.replace(self, **changes)

    def positions(self):
        """(T, 20, 3) joint positions."""
        points = np.empty_like(self.dirs)
        for joint, parent in enumerate(CANONICAL_PARENTS):
            bone = self.lengths[:, joint, None] * self.dirs[:, joint]
            points[:, joint] = self.root if parent < 0 else points[:, parent] + bone
        return points

    def motion(self):
        """As the candidate wants it."""
        points = np.ascontiguousarray(self.positions())
        points.flags.writeable = False
        return dataclasses.replace(self.template, positions=points, frame_rate=self.rate, missing=None, warnings=())

    def segments(self):
        """(T, 9, 3) unit directions of the nine segments."""
        points = self.positions()
        return unit(points[:, END] - points[:, START])

    def heading(self):
        """Radians about the vertical of the hips' axis."""
        points = self.positions()
        across = points[:, J["left_hip"]] - points[:, J["right_hip"]]
        return np.unwrap(np.arctan2(-across[:, 2], across[:, 0]))

    def turned(self, radians):
        """Turned about the vertical, by one angle or one for each frame."""
        turn = Rotation.from_rotvec(np.outer(np.broadcast_to(radians, len(self)), (0, 1, 0))).as_matrix()
        return self.having(
            dirs=np.einsum("tij,tbj->tbi", turn, self.dirs), root=np.einsum("tij,tj->ti", turn, self.root)
        )

    def axes(self, limb):
        """(T, 3, 3) columns left, up, front of the chest or the pelvis that a limb hangs on."""
        points = self.positions()
        part = "shoulder" if "arm" in limb else "hip"
        up = unit(points[:, J["neck"]] - points[:, J["pelvis"]])
        left = points[:, J[f"left_{part}"]] - points[:, J[f"right_{part}"]]
        left = unit(left - (left * up).sum(1, keepdims=True) * up)
        return np.stack([left, up, np.cross(left, up)], axis=2)

    def local(self, limb):
        """(T, 3, 3) directions of a limb's bones in its carrier's axes."""
        return np.einsum("tji,tbj->tbi", self.axes(limb), self.dirs[:, LIMBS[limb][0]])

    def with_local(self, limb, local):
        """With other directions of a limb."""
        dirs = self.dirs.copy()
        dirs[:, LIMBS[limb][0]] = np.einsum("tij,tbj->tbi", self.axes(limb), local)
        return self.having(dirs=dirs)

    def at(self, frames):
        """Another timing: the poses at these fractional frames."""
        return self.having(
            dirs=unit(sample(self.dirs, frames)), lengths=sample(self.lengths, frames), root=sample(self.root, frames)
        )

    def cut(self, a, b):
        """Frames a to b."""
        return self.having(dirs=self.dirs[a:b], lengths=self.lengths[a:b], root=self.root[a:b])


def medley(bodies, pause_s=0.4):
    """One clip after another, each facing as the one before ended, joined by a short passage."""
    whole = bodies[0]
    for body in bodies[1:]:
        body = body.turned(whole.heading()[-1] - body.heading()[0])  # noqa: PLW2901
        move = whole.root[-1] - body.root[0]
        body = body.having(root=[*body.root, move[0], 0, move[2]])  # noqa: PLW2901
        n = round(pause_s * whole.rate)
        w = smooth_step(np.arange(1, n + 1) / (n + 1))
        lin = w[:, None]
        between = mix(np.repeat(whole.dirs[-1:], n, 0), np.repeat(body.dirs[:1], n, 0), w)
        whole = whole.having(
            dirs=np.concatenate([whole.dirs, between, body.dirs]),
            lengths=np.concatenate(
                [whole.lengths, (1 - lin) * whole.lengths[-1] + lin * body.lengths[0], body.lengths]
            ),
            root=np.concatenate([whole.root, (1 - lin) * whole.root[-1] + lin * body.root[0], body.root]),
        )
    return whole


def smooth_step(x):
    """0 to 1 with level ends."""
    x = np.clip(x, 0, 1)
    return x * x * (3 - 2 * x)


def performer(body, rng):
    """Somebody else doing it well: posture and tempo wander, another build, another facing."""
    n, rate = len(body), body.rate

    def wander(size, rms, scale_s):
        noise = gaussian_filter1d(rng.standard_normal((n + 200, *size)), scale_s * rate, axis=0)[100:-100]
        return noise * rms / max(float(noise.std()), 1e-9)

    jitter = wander((), rng.uniform(0.010, 0.030), rng.uniform(0.6, 1.2)) * rate
    body = body.at(np.arange(n) + jitter)
    vectors = wander((20, 3), np.radians(rng.uniform(2, 3)) / np.sqrt(2), rng.uniform(0.3, 0.7))
    turn = Rotation.from_rotvec(vectors.reshape(-1, 3))
    build = rng.uniform(0.95, 1.05, 20)
    build[[J[f"right_{k}"] for k in ("elbow", "wrist", "knee", "ankle")]] = build[
        [J[f"left_{k}"] for k in ("elbow", "wrist", "knee", "ankle")]
    ]
    body = body.having(
        dirs=turn.apply(body.dirs.reshape(-1, 3)).reshape(n, 20, 3),
        lengths=body.lengths * build * rng.uniform(0.9, 1.1),
    )
    return body.turned(rng.uniform(-np.pi, np.pi))


# ---------------------------------------------------------------- errors


@dataclass
class Truth:
    """What was put in, in seconds of the performance."""

    kind: str
    start_s: float
    end_s: float
    segments: tuple[str, ...]
    lag_ms: float | None = None
    shortfall_deg: float | None = None
    found: bool = False


@dataclass
class Draw:
    """One attempt at an error: where it acts and how it comes and goes."""

    a: int
    b: int
    weight: np.ndarray
    rise_s: float
    fall_s: float


def draw_window(n, rate, rng, lag_s=0.0, window=None):
    """A window of 1 to 3 s with an onset and a fade of 0.1 to 0.8 s; time never runs backwards."""
    span = min(rng.uniform(1.1, 3.0), 0.6 * n / rate) if window is None else (window[1] - window[0]) / rate
    a = rng.uniform(0.2, max(0.21, n / rate - span - 0.2)) if window is None else window[0] / rate
    rise, fall = (
        float(np.clip(rng.uniform(0.1, 0.8), 1.5 * abs(lag_s), max(0.45 * span, 1.5 * abs(lag_s)))) for _ in "ab"
    )
    t = np.arange(n) / rate
    weight = smooth_step((t - a) / rise) * smooth_step((a + span - t) / fall)
    return Draw(round(a * rate), min(round((a + span) * rate), n - 1), weight, rise, fall)


def mean_direction(dirs):
    return unit(dirs.mean(0))


def body_shift(body, draw, lag_s):
    """The whole body late (positive) or early."""
    return body.at(np.arange(len(body)) - lag_s * body.rate * draw.weight)


def limb_shift(body, draw, limbs, lag_s):
    """Limbs late or early while the rest keeps time."""
    for limb in limbs:
        late = sample(body.local(limb), np.arange(len(body)) - lag_s * body.rate * draw.weight)
        body = body.with_local(limb, unit(late))
    return body


def stops_short(body, draw, limb, reached, holds):
    """A limb that goes out and back along its own path and turns before the extreme; None where it does not."""
    local, a, b = body.local(limb), draw.a, draw.b
    out = gaussian_filter1d(angle(local[a : b + 1, :2], local[a, :2]).max(1), 0.03 * body.rate)
    apex, top = int(out.argmax()), float(out.max())
    if not (5 < apex < len(out) - 5 and top > 25 and out[-1] < 0.4 * reached * top):
        return None
    cap = reached * top
    sharp = 12.0 / top
    short = -np.logaddexp(-sharp * out, -sharp * cap) / sharp if holds else out * reached
    ramp = np.arange(len(out)) * 1e-6
    going = np.maximum.accumulate(out[: apex + 1]) + ramp[: apex + 1]
    coming = np.maximum.accumulate(out[apex:][::-1]) + ramp[: len(out) - apex]
    out_at, back_at = np.interp(short, going, np.arange(apex + 1)), np.interp(short, coming, np.arange(len(coming)))
    even = 0.06 * body.rate  # a path that halts is not walked in leaps
    there = sample(local, a + gaussian_filter1d(out_at, even, mode="nearest"))
    back = sample(local, a + len(out) - 1 - gaussian_filter1d(back_at, even, mode="nearest"))
    turn = smooth_step((np.arange(len(out)) - apex) / (0.3 * body.rate) + 0.5)
    new = local.copy()
    edge = np.clip(np.minimum(np.arange(len(out)), np.arange(len(out))[::-1]) / (0.12 * body.rate), 0, 1)
    new[a : b + 1] = mix(local[a : b + 1], mix(unit(there), unit(back), turn), smooth_step(edge))
    return body.with_local(limb, new)


def limb_shrunk(body, draw, limb, gain):
    """A limb drawn toward its mean direction."""
    local = body.local(limb)
    middle = np.broadcast_to(mean_direction(local[draw.a : draw.b]), local.shape)
    return body.with_local(limb, mix(local, middle, (1 - gain) * draw.weight))


def body_shrunk(body, draw, gain):
    """Everything drawn toward its mean, in axes that turn with the hips."""
    facing = gaussian_filter1d(body.heading(), 0.2 * body.rate)
    level = body.turned(-facing)
    middle = np.broadcast_to(mean_direction(level.dirs[draw.a : draw.b]), level.dirs.shape)
    small = level.having(dirs=mix(level.dirs, middle, (1 - gain) * draw.weight)).turned(facing)
    return small.having(root=body.root)


def wrong_limb(body, draw, limb, donor, rng):
    """A limb that does something else: another motion, the other limb's mirrored, a foreign pose held, rotated."""
    local = body.local(limb)
    how = rng.choice(["other", "mirrored", "held", "rotated", "forearm"], p=[0.3, 0.2, 0.15, 0.25, 0.1])
    if how == "mirrored":
        other = limb.replace("left", "?").replace("right", "left").replace("?", "right")
        new = body.local(other) * [-1, 1, 1]
    elif how in ("other", "held"):
        from_it = donor.local(limb)
        first = rng.integers(0, max(1, len(from_it) - (draw.b - draw.a)))
        frames = np.arange(len(body)) - draw.a + first if how == "other" else np.full(len(body), first)
        new = unit(sample(from_it, frames.astype(float)))
    else:
        joints = slice(0 if how == "rotated" else 1, 3)
        main = mean_direction(local[draw.a : draw.b, 0 if how == "rotated" else 1])
        axis = unit(np.cross(main, rng.standard_normal(3)))
        new = local.copy()
        turn = Rotation.from_rotvec(np.radians(rng.uniform(28, 75)) * axis).as_matrix()
        new[:, joints] = local[:, joints] @ turn.T
    return body.with_local(limb, mix(local, new, draw.weight))


def other_figure(body, draw, donor, rng):
    """The whole body does a figure of another motion."""
    first = rng.integers(0, max(1, len(donor) - (draw.b - draw.a)))
    other = donor.at((np.arange(len(body)) - draw.a + first).astype(float))
    other = other.turned(body.heading()[draw.a] - other.heading()[draw.a])
    return body.having(dirs=mix(body.dirs, other.dirs, draw.weight))


def top_speed(body):
    """Greatest deg/s of a segment."""
    x = body.segments()
    return float(angle(x[1:], x[:-1]).max() * body.rate)


def level_segments(body, facing):
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


# ---------------------------------------------------------------- material


class Material:
    """The recordings that the candidate has not been trained on."""

    def __init__(self, root):
        self.root, self.cache = Path(root), {}
        self.hdm, self.utd, self.bandai = defaultdict(list), defaultdict(list), defaultdict(list)
        for path in sorted(self.root.glob("hdm05/*/HDM_dg_*")):
            self.hdm[path.parent.name].append(path)
        for path in sorted(self.root.glob("utd_mhad/skeleton/**/a*_s7_t*.c3d")):
            self.utd[path.stem[:3]].append(path)
        for path in sorted(self.root.glob("bandai/**/*.bvh")):
            pair = re.sub(r"_\d+$", "", path.stem)
            if zlib.crc32(pair.encode()) % 3 == 0:
                self.bandai[pair].append(path)
        for pair, paths in self.bandai.items():  # aborted takes are no takes
            lengths = [self.body(p).dirs.shape[0] for p in paths]
            middle = np.median(lengths)
            self.bandai[pair] = [p for p, n in zip(paths, lengths, strict=True) if 0.6 < n / middle < 1.6]
        self.alike = {
            "HDM05": {k: self.same_thing(v) for k, v in self.hdm.items() if len(v) >= 6},
            "UTD": {k: self.same_thing(v) for k, v in self.utd.items()},
            "Bandai": {k: self.same_thing(v) for k, v in self.bandai.items() if "hand" in k},
        }
        # Walks and runs may begin on the other foot: no second take of the same dance.
        for name, least in (("HDM05", 6), ("UTD", 4), ("Bandai", 6)):
            self.alike[name] = {k: v for k, v in self.alike[name].items() if len(v) >= least}
        dance = self.body(next(self.root.glob("bandai_dance/*.bvh")))
        dance = dance.cut(round(42 * dance.rate), len(dance))
        self.dance = [dance.cut(round(a * 30), round(b * 30)) for a, b in ((0, 9), (6, 16), (11, 21))]
        cmu = self.body(next(self.root.glob("cmu86/*.amc")))
        self.cmu = [
            cmu.cut(round(a * cmu.rate), round(b * cmu.rate)) for a, b in ((0, 10), (9, 19), (19, 29), (28, 38))
        ]
        legs = [self.utd[a][0] for a in ("a22", "a23", "a24", "a26", "a27")]
        self.donors = {
            "HDM05": [self.body(p[0]) for p in self.hdm.values()] + self.cmu,
            "Bandai": [self.body(p[0]) for p in self.bandai.values()] + self.dance,
            "UTD": [self.body(p[0]) for p in self.utd.values()] + 3 * [self.body(p) for p in legs],
        }
        self.donors |= {"dance": self.donors["Bandai"], "CMU": self.donors["HDM05"]}

    def body(self, path):
        """A recording, read once."""
        if path not in self.cache:
            self.cache[path] = Body.of(dousa.canonicalise(dousa.read_motion(path)))
        return self.cache[path]

    def takes(self, name, rng):
        """Several real takes of one thing by one person, in a random order."""
        table, least = self.alike[name], 4 if name == "UTD" else 6
        chosen = rng.choice(list(table), 1 if name == "Bandai" else min(4, len(table)), replace=False)
        orders = [rng.permutation(len(table[k])) for k in chosen]
        return [medley([self.body(table[k][o[i]]) for k, o in zip(chosen, orders, strict=True)]) for i in range(least)]

    def same_thing(self, paths, limit=15.0):
        """The takes that do what most others do: a take that a person does otherwise is no clean one."""
        bodies = [to_30(self.body(p).motion()) for p in paths]
        apart = np.array(
            [[residuals(x, y, follow(x, y)).mean() if x is not y else np.nan for x in bodies] for y in bodies]
        )
        return [p for p, row in zip(paths, apart, strict=True) if np.nanmedian(row) <= limit]

    def recording(self, name, index, rng):
        """One recording."""
        if name in ("dance", "CMU"):
            windows = self.dance if name == "dance" else self.cmu
            return windows[index % len(windows)]
        if name == "Bandai":
            pair = list(self.bandai)[index % len(self.bandai)]
            return self.body(self.bandai[pair][rng.integers(len(self.bandai[pair]))])
        table = self.hdm if name == "HDM05" else self.utd
        chosen = sorted(rng.choice(list(table), 4, replace=False), key=lambda k: k == "lieDownFloor")
        return medley([self.body(table[k][rng.integers(len(table[k]))]) for k in chosen])


@dataclass
class Case:
    """One performance with its clean twin and the references; ``counts`` says how many of them are shown."""

    group: str
    dataset: str
    references: list[Body]
    clean: Body
    wrong: Body
    truths: list[Truth]
    counts: tuple[int, ...] = (1,)
    twin: bool = True
    shown: list = field(default_factory=list)


SIZES = {
    "synthetic": {"HDM05": 10, "Bandai": 16, "UTD": 12, "dance": 6, "CMU": 8},
    "real": {"HDM05": 8, "Bandai": 14, "UTD": 10},
    "made-up": {"HDM05": 6, "Bandai": 6, "UTD": 4, "dance": 8, "CMU": 8},
    "two at once": {"HDM05": 8, "Bandai": 8, "UTD": 6, "dance": 4, "CMU": 6},
    "clean": {"HDM05": 8, "Bandai": 16, "UTD": 8},
}


def make_cases(material, groups, seed):
    """All performances; a group's own seed, so that leaving others out changes nothing."""
    cases = []
    for group in (g for g in GROUPS if g in SIZES and g in groups):
        deck = Deck(np.random.default_rng([seed, zlib.crc32(group.encode())]))
        for name, size in SIZES[group].items():
            for i in range(size):
                rng = np.random.default_rng([seed, zlib.crc32(f"{group}/{name}/{i}".encode())])
                cases.append(make_case(material, group, name, i, rng, deck))
    return cases


def make_case(material, group, name, index, rng, deck):
    """One case of a group."""
    if group in ("real", "clean") or (group == "two at once" and name in ("HDM05", "Bandai", "UTD") and index % 2):
        takes = material.takes(name, rng)
        references, clean = takes[1:], takes[0].turned(rng.uniform(-np.pi, np.pi))
        counts = (3,) if group == "two at once" else tuple(c for c in (1, 3, 5) if c <= len(references))
    else:
        recording = material.recording(name, index, rng)
        several = group == "made-up"
        references = [performer(recording, rng) for _ in range(5)] if several else [recording]
        clean, counts = performer(recording, rng), (1, 5) if several else (1,)
    donors = material.donors[name]
    seconds = len(clean) / clean.rate
    if group == "clean":
        wrong, truths = clean, []
    elif group == "two at once":
        wrong, truths = put_two(clean, rng, donors, index % 5)
    else:
        wrong, truths = put_errors(clean, 1 + (seconds > 5.5) + (seconds > 10.4), rng, deck, donors)
    return Case(group, name, references, clean, wrong, truths, counts, group != "clean")


# ---------------------------------------------------------------- baseline


def to_30(body_motion):
    """(T, 9, 3) segments at 30 Hz."""
    points = body_motion.positions
    step = body_motion.frame_rate / 30
    points = sample(np.asarray(points), np.arange(0, len(points) - 1 + 1e-6, step))
    return unit(points[:, END] - points[:, START])


def dtw(cost):
    """The cheapest path, by anti-diagonals: for each column the mean row."""
    n, m = cost.shape
    total = np.full((n + 1, m + 1), np.inf)
    total[0, 0] = 0
    for d in range(n + m - 1):
        i = np.arange(max(0, d - m + 1), min(n, d + 1))
        j = d - i
        total[i + 1, j + 1] = cost[i, j] + np.minimum(np.minimum(total[i, j + 1], total[i + 1, j]), total[i, j])
    rows, i, j = [[] for _ in range(m)], n, m
    while i and j:
        rows[j - 1].append(i - 1)
        i, j = min(((i - 1, j - 1), (i - 1, j), (i, j - 1)), key=lambda p: total[p])
    return np.array([np.mean(r) if r else 0.0 for r in rows])


def follow(x, y):
    """The frames of the reference x that y is at, by the mean cosine of the segments after the best turn."""
    plane = (x[..., 0] + 1j * x[..., 2]) @ (y[..., 0] + 1j * y[..., 2]).conj().T
    return dtw(1 - (np.abs(plane) + x[..., 1] @ y[..., 1].T) / 9)


def residuals(x, y, at):
    """Degrees (T, 9) between the reference x at these frames and y, after the best turn of every second."""
    r = unit(sample(x, at))
    turn = ((r[..., 0] + 1j * r[..., 2]).conj() * (y[..., 0] + 1j * y[..., 2])).sum(1)
    turn = uniform_filter1d(turn.real, 31) + 1j * uniform_filter1d(turn.imag, 31)
    flat = (r[..., 0] + 1j * r[..., 2]) * (turn / (np.abs(turn) + 1e-9))[:, None]
    return angle(np.stack([flat.real, r[..., 1], flat.imag], axis=2), y)


def half_range(x, width=61):
    return np.array([angle(x, unit(uniform_filter1d(x, width, axis=0)))]).max(0)


def baseline_one(x, y):
    """Against one reference: lag of the body, residual and lag of each limb, missing range."""
    at = follow(x, y)
    frames = np.arange(len(y))
    lag = uniform_filter1d((frames - at) / 30, 7)
    lag = lag - median_filter(lag, 121, mode="nearest")
    off = residuals(x, y, at)
    limb_lag = np.zeros((len(y), 4))
    shifts = [s for s in range(-12, 13) if abs(s) >= 3]
    tries = np.stack([uniform_filter1d(residuals(x, y, at - s), 31, axis=0) for s in shifts])
    now = uniform_filter1d(off, 31, axis=0)
    for k, (_, parts) in enumerate(LIMBS.values()):
        best, before = tries[:, :, parts].mean(2), now[:, parts].mean(1)
        better = (best.min(0) < 0.6 * before) & (before > 8)
        limb_lag[:, k] = np.where(better, np.array(shifts)[best.argmin(0)] / 30, 0)
    size = [half_range(v) for v in (unit(sample(x, at)), y)]
    size = [2 * np.stack([np.lib.stride_tricks.sliding_window_view(np.pad(v[:, s], 30, mode="edge"), 61).max(1)
                          for s in ALL], 1) for v in size]  # fmt: skip
    missing = np.where(size[1] < 0.75 * size[0], size[0] - size[1], 0)
    return lag, off, limb_lag, missing


@dataclass
class Found:
    """An event of the baseline."""

    kind: str
    start_s: float
    end_s: float
    segments: tuple[str, ...]
    lag_ms: float | None = None
    shortfall_deg: float | None = None


def baseline(references, performance):
    """(events, grade): fixed thresholds, the kindest of the references at every moment."""
    y = to_30(performance)
    lag, off, limb_lag, missing = (
        np.stack(v) for v in zip(*(baseline_one(to_30(r), y) for r in references), strict=True)
    )
    grade = float(np.clip(100 - 3 * off.mean((1, 2)).min(), 0, 100))

    def pick(v):
        return np.take_along_axis(v, np.abs(v).argmin(0)[None], 0)[0]

    lag, off, limb_lag, missing = pick(lag), off.min(0), pick(limb_lag), missing.min(0)
    late = np.abs(lag) > 0.08
    small = missing > 15
    limb_of = np.array([next((k for k, v in enumerate(LIMBS.values()) if s in v[1]), -1) for s in ALL])
    limb_late = np.where(limb_of >= 0, limb_lag[:, limb_of] != 0, False)
    wrong = off > 25
    everywhere = wrong.sum(1) >= 5
    rest = ~everywhere[:, None]
    masks = {
        "global": np.where(everywhere[:, None], wrong, False),
        "shift": (late[:, None] | limb_late) & rest,
        "incomplete": small & ~limb_late & rest,
        "partial": wrong & ~small & ~limb_late & rest,
    }
    events = []
    for kind, mask in masks.items():
        any_of = binary_closing(np.pad(mask.any(1), 8), np.ones(7))[8:-8]
        edges = np.flatnonzero(np.diff(np.concatenate([[0], any_of, [0]])))
        for a, b in zip(edges[::2], edges[1::2], strict=True):
            if b - a < 9:
                continue
            parts = tuple(NAMES[s] for s in ALL if mask[a:b, s].mean() > 0.3)
            delay = lag[a:b] if late[a:b].mean() > 0.3 else limb_lag[a:b][np.abs(limb_lag[a:b]) > 0]
            events.append(Found(kind, a / 30, b / 30, parts, 1e3 * float(np.median(delay)) if kind == "shift" else None,
                                float(missing[a:b].max()) if kind == "incomplete" else None))  # fmt: skip
    return events, grade


def ask_dousa(references, performance):
    """(events, grade) of the candidate; what it refuses has no events and no grade."""
    try:
        answer = assess(references, performance)
    except DousaError:
        return [], None
    return list(answer.events), answer.score


# ---------------------------------------------------------------- marks


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


# ---------------------------------------------------------------- grades


def grade_check(material, ask, seed):
    """What the grade is worth: second takes, severity, parts, other dances."""
    rows, none_as = {}, lambda g: 0.0 if g is None else g
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
    dg, s7 = (
        [material.body(p).motion() for p in paths][:4] for paths in (material.hdm["squat1Reps"], material.utd["a27"])
    )
    others = [none_as(ask([a], b)[1]) for a in dg for b in s7] + [none_as(ask([b], a)[1]) for a in dg for b in s7]
    rows["grade, other person (squat, dg and s7, two sensors): median"] = float(np.median(others))
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
    rows["grade, severity: share of steps that do not rise"] = float(np.mean(falls))
    rows["grade, severity: share of monotone ladders"] = float(np.mean(whole))
    rows["grade, severity: median fall from 0 to 1"] = float(np.median(span))
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
    rows["grade, 10 % of the dance: share without a good grade (none or < 50)"] = float(
        np.mean([none_as(g) < 50 for g in parts])
    )
    rows["grade, 10 % of the dance: median"] = float(np.median([none_as(g) for g in parts]))
    rows["grade, another dance: share none or < 20"] = float(np.mean([none_as(g) < 20 for g in strangers]))
    rows["grade, another dance: greatest"] = float(max(none_as(g) for g in strangers))
    return rows


def irds_plain(references, performance):
    """One dimension: the angle from the start of the segment that moves most, its range and its DTW distance."""
    refs, y = [to_30(r) for r in references], to_30(performance)
    main = int(np.mean([spread(x) for x in refs], 0).argmax())

    def curve(x):
        return angle(x[:, main], x[0, main])

    mine, marks = curve(y), []
    for x in refs:
        theirs = curve(x)
        at = dtw(np.abs(theirs[:, None] - mine[None, :]))
        marks.append(np.abs(sample(theirs, at) - mine).mean() + abs(np.ptp(theirs) - np.ptp(mine)))
    return None, -float(min(marks))


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
        got = [(label, 0.0 if g is None else g) for label, g in got]
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


# ---------------------------------------------------------------- the paper


def main():
    """Sit the examination and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    default = Path(dousa.__file__).resolve().parents[2] / "../shared/data"
    parser.add_argument("--data", type=Path, default=default, help="the folder of recordings")
    parser.add_argument("--json", type=Path, help="write the numbers here")
    parser.add_argument("--only", choices=("dousa", "baseline"))
    parser.add_argument("--group", nargs="+", choices=GROUPS, default=list(GROUPS))
    parser.add_argument("--seed", type=int, default=SEED)
    options = parser.parse_args()
    began = time.perf_counter()
    material = Material(options.data.resolve())
    cases = make_cases(material, options.group, options.seed)
    papers = [c for c in cases if c.truths]
    count = Counter(t.kind for c in papers for t in c.truths)
    shown = sum(len(c.counts) for c in papers)
    print(f"{len(papers)} performances with {count.total()} errors ({shown} rows with their references), each with a")
    print(
        f"clean twin; errors: {', '.join(f'{k} {count[k]}' for k in KINDS)}; built in {time.perf_counter() - began:.0f} s"  # noqa: E501
    )
    table, seconds = {}, {}  # of processor time: the machine may be shared
    for name, ask in (("dousa", ask_dousa), ("baseline", baseline)):
        if options.only not in (None, name):
            continue
        start = time.process_time()
        rows = summarise(*judge(cases, ask))
        if "grade" in options.group:
            rows |= grade_check(material, ask, options.seed)
        if "irds" in options.group:
            rows |= irds_check(options.data, ask if name == "dousa" else irds_plain)
        table[name], seconds[name] = rows, time.process_time() - start
    keys = list(dict.fromkeys(k for rows in table.values() for k in rows))
    width = max((len(k) for k in keys), default=0)
    print(f"{'':{width}}  " + "  ".join(f"{n:>9}" for n in table))
    for k in keys:
        print(f"{k:{width}}  " + "  ".join(f"{rows.get(k, float('nan')):9.3f}" for rows in table.values()))
    for name, rows in table.items():
        worse = [k for k, v in rows.items() if k.startswith("never worse") and v < 0]
        print(f"{name}: {seconds[name]:.0f} s of processor time; sets on which more references are worse: {len(worse)}")
    if options.json:
        content = {
            "performances": len(papers),
            "errors": dict(count),
            "rows": shown,
            "seconds": seconds,
            "table": table,
        }
        options.json.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
