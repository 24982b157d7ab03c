"""Errors put in: each acts on a body within a window that comes and goes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from lab.exams.dance.bodies import angle, mix, sample, smooth_step, unit


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
    """The direction that they have on average."""
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
