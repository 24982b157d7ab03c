"""Made takes: clips joined without a leap, and a made figure that repeats itself."""

from __future__ import annotations

import numpy as np

from lab.exams.search.material import JOINTS, J, Points, load

RATE = 30.0


def heading(pose):
    """The angle about the vertical that a pose (20, 3) faces, rad: across hips and shoulders."""
    across = pose[J["left_hip"]] - pose[J["right_hip"]] + pose[J["left_shoulder"]] - pose[J["right_shoulder"]]
    return np.arctan2(across[2], across[0])


def turn(positions, angle, about):
    """Turned about the vertical through a point, so that the heading becomes larger by ``angle``."""
    c, s = np.cos(angle), np.sin(angle)
    return (positions - about) @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]) + about


def join(parts, least_pause=0.4, speed=1.0, rate=RATE):
    """One take of ``parts``, [(Points, category)], with its truth.

    Each part goes on where and facing as the one before ended. In between the joints go straight, at most ``speed``
    m/s, for at least ``least_pause`` s.

    Returns
    -------
    The take, and [(start, end, category), ...] in s.
    """
    whole, truth, n = [], [], 0
    for points, category in parts:
        positions = points.at_rate(rate).positions
        if whole:
            last, first = whole[-1][-1], positions[0]
            positions = turn(positions, heading(last) - heading(first), first[0])
            positions = positions + (last[0] - first[0]) * (1, 0, 1)
            way = np.linalg.norm(positions[0] - last, axis=1).max()
            steps = round(max(least_pause, way / speed) * rate)
            share = (1 - np.cos(np.pi * np.arange(1, steps + 1) / (steps + 1))) / 2
            whole.append(last + share[:, None, None] * (positions[0] - last))
            n += steps
        truth.append((n / rate, (n + len(positions)) / rate, category))
        whole.append(positions)
        n += len(positions)
    return Points(np.concatenate(whole), rate), truth


def draw_take(clips, rng, tempo=None, share=1.0):
    """A take of one clip of each category in a random order; who lies down at the end stays there.

    ``tempo``: (least, greatest), each clip is slower or quicker; ``share`` of the categories.
    """
    names = sorted({c.category for c in clips})
    names = [names[i] for i in rng.permutation(len(names))[: max(round(share * len(names)), 2)]]
    names.sort(key=lambda name: name == "lieDownFloor")
    parts = []
    for name in names:
        choice = [c for c in clips if c.category == name]
        points = load(choice[rng.integers(len(choice))].path)
        factor = np.exp(rng.uniform(*np.log(tempo))) if tempo else 1.0
        parts.append((points.at_rate(RATE, factor), name))
    return join(parts)


def draw_cycles(clips, names, rng, most=8):
    """A take in which every category of ``names`` is done 1 to ``most`` times on end; truth with the number."""
    parts, truth = [], []
    for name in rng.permutation(names):
        choice = [c for c in clips if c.category == name]
        cycles = [load(choice[i].path) for i in rng.integers(len(choice), size=rng.integers(1, most + 1))]
        parts.append((join([(p, name) for p in cycles], least_pause=0.1, speed=2.0)[0], name))
        truth.append(len(cycles))
    take, places = join(parts, least_pause=0.8)
    return take, [(*place, count) for place, count in zip(places, truth, strict=True)]


# The made figure: metres of a body 1.7 m high that faces +z; its left is +x.
REST = {
    **{"pelvis": (0, 0.95, 0), "spine": (0, 1.15, 0), "neck": (0, 1.42, 0), "head": (0, 1.6, 0)},
    **{"left_shoulder": (0.18, 1.38, 0), "left_hip": (0.1, 0.9, 0)},
}
UPPER_ARM, FOREARM, HAND, THIGH, SHANK, TOE = 0.28, 0.25, 0.09, 0.42, 0.4, 0.14
MOTIONS = ("raise_arms", "wave_right", "squat", "clap_front", "jumping_jack", "lift_right_knee")


def bend(hip, ankle):
    """The knee of a leg from hip to ankle, in front."""
    way = ankle - hip
    length = min(np.linalg.norm(way), THIGH + SHANK - 1e-6)
    along = (THIGH**2 - SHANK**2 + length**2) / (2 * length)
    aside = np.sqrt(max(THIGH**2 - along**2, 0))
    axis = way / np.linalg.norm(way)
    front = np.array((0.0, 0, 1)) - axis[2] * axis
    return hip + along * axis + aside * front / np.linalg.norm(front)


def make_pose(name, x, raised):
    """A pose (20, 3): ``x`` 0 to 1, how far the movement has gone; ``raised`` 0 to 1, how far it is begun."""
    drop = 0.38 * x if name == "squat" else -0.08 * x if name == "jumping_jack" else 0.02
    joints = {k: np.array(v, float) - (0, drop, 0) for k, v in REST.items()}
    joints["right_shoulder"], joints["right_hip"] = (joints[f"left_{k}"] * (-1, 1, 1) for k in ("shoulder", "hip"))
    for side, sign in (("left", 1), ("right", -1)):
        out, ahead, elbow = 0.15, 0.0, 0.15  # rad: upper arm out and ahead, bend of the elbow
        lean = 0.0
        if name in ("raise_arms", "jumping_jack"):
            out = 0.15 + 2.6 * x
        elif name == "wave_right" and side == "right":
            out, elbow, lean = 0.15 + 1.4 * raised, 0.15 + 1.4 * raised, 1.1 * (x - 0.5) * raised
        elif name == "clap_front":
            ahead, elbow, lean = 1.3 * raised, 0.15, (0.25 - 0.9 * x) * raised
            out = 0.15 * (1 - raised)
        elif name == "squat":
            ahead = 1.3 * x
        upper = np.array((sign * np.sin(out), -np.cos(out) * np.cos(ahead), np.cos(out) * np.sin(ahead)))
        if name == "wave_right" and side == "right":  # the forearm stands up and swings aside
            fore = np.array((sign * np.sin(out + elbow + lean), -np.cos(out + elbow + lean), 0.1))
        else:
            fore = upper + np.array((sign * lean, 0, 0.3 * elbow))
            upper = upper + np.array((sign * lean, 0, 0))
        upper, fore = upper / np.linalg.norm(upper), fore / np.linalg.norm(fore)
        joints[f"{side}_elbow"] = joints[f"{side}_shoulder"] + UPPER_ARM * upper
        joints[f"{side}_wrist"] = joints[f"{side}_elbow"] + FOREARM * fore
        joints[f"{side}_hand"] = joints[f"{side}_wrist"] + HAND * fore
        ankle = np.array((sign * (0.1 + (0.22 * x if name == "jumping_jack" else 0)), 0.08, 0.0))
        ankle[1] += 0.08 * (1 - abs(2 * x - 1)) if name == "jumping_jack" else 0
        if name == "lift_right_knee" and side == "right":
            ankle += (0, 0.38 * x, 0.18 * x)
        joints[f"{side}_knee"] = bend(joints[f"{side}_hip"], ankle)
        joints[f"{side}_ankle"], joints[f"{side}_toe"] = ankle, ankle + np.array((0, -0.05, TOE))
    return np.array([joints[k] for k in JOINTS])


def make_cycles(name, count, rng, size=1.0):
    """``count`` cycles of one of MOTIONS by somebody ``size`` times as large: periods and reach differ by a tenth."""
    period = rng.uniform(0.8, 1.9)
    x, reach = [], rng.uniform(0.75, 1.0)
    for _ in range(count):
        steps = round(period * rng.uniform(0.9, 1.1) * RATE)
        x.append(reach * rng.uniform(0.9, 1.0) * (1 - np.cos(2 * np.pi * np.arange(steps) / steps)) / 2)
    x, rise = np.concatenate(x), round(0.5 * RATE)
    ramp = np.linspace(0, 1, rise)
    poses = [make_pose(name, 0.0, r) for r in ramp] if name in ("wave_right", "clap_front") else []
    before = len(poses)
    poses = np.array([*poses, *(make_pose(name, v, 1.0) for v in x), *poses[::-1][:before]])
    return Points(poses * size + rng.normal(0, 0.004, poses.shape), RATE)


def draw_made(rng, most=10):
    """A take by a made figure with all of MOTIONS, each 1 to ``most`` times; truth with the number."""
    size, parts, counts = rng.uniform(0.85, 1.15), [], []
    for name in rng.permutation(MOTIONS):
        counts.append(int(rng.integers(1, most + 1)))
        parts.append((make_cycles(name, counts[-1], rng, size), str(name)))
    take, places = join(parts, least_pause=1.0)
    noisy = Points(take.positions + rng.normal(0, 0.01, take.positions.shape), take.rate)
    return noisy, [(*place, count) for place, count in zip(places, counts, strict=True)]
