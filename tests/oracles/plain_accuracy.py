"""Accuracy of estimated joints in plain Python: one frame, one joint at a time."""

import math

import numpy as np

from dousa.motion.canonical.joints import CANONICAL_JOINTS


def seen(*points):
    return all(math.isfinite(value) for point in points for value in point)


def mean(values):
    values = [value for value in values if math.isfinite(value)]
    return sum(values) / len(values) if values else math.nan


def common_joints(names, truth_names):
    both = [name for name in truth_names if name in names]
    return [name for name in CANONICAL_JOINTS if name in both] + [name for name in both if name not in CANONICAL_JOINTS]


def angle(one, other):
    lengths = math.hypot(*one) * math.hypot(*other)
    cosine = sum(a * b for a, b in zip(one, other, strict=True)) / lengths
    return math.acos(max(-1.0, min(1.0, cosine)))


def minus(one, other):
    return tuple(a - b for a, b in zip(one, other, strict=True))


def middle(points):
    return tuple(sum(values) / len(points) for values in zip(*points, strict=True))


def align_horn(points, onto):
    """Best rotation and translation as a unit quaternion (Horn 1987): the greatest eigenvector of a 4 x 4 matrix."""
    centre, goal = middle(points), middle(onto)
    s = [[0.0] * 3 for _ in range(3)]
    for point, target in zip(points, onto, strict=True):
        a, b = minus(point, centre), minus(target, goal)
        for i in range(3):
            for j in range(3):
                s[i][j] += a[i] * b[j]
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = s
    matrix = [
        [xx + yy + zz, yz - zy, zx - xz, xy - yx],
        [yz - zy, xx - yy - zz, xy + yx, zx + xz],
        [zx - xz, xy + yx, yy - xx - zz, yz + zy],
        [xy - yx, zx + xz, yz + zy, zz - xx - yy],
    ]
    w, x, y, z = np.linalg.eigh(np.array(matrix))[1][:, 3]
    rotation = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    moved = []
    for point in points:
        a = minus(point, centre)
        moved.append(tuple(sum(rotation[i][j] * a[j] for j in range(3)) + goal[i] for i in range(3)))
    return moved


def score(names, estimated, truth_names, truth, frame_rate, bound, segments, angles):
    """The numbers of `Accuracy.to_json`, in metres and radians."""
    joints = common_joints(list(names), list(truth_names))
    frames = [
        (
            {name: tuple(estimated[t][list(names).index(name)]) for name in joints},
            {name: tuple(truth[t][list(truth_names).index(name)]) for name in joints},
        )
        for t in range(len(truth))
    ]
    raw, root, rigid, directions, flexions, accelerations, lost = [], [], [], [], [], [], []
    for e, g in frames:
        good = [name for name in joints if seen(e[name], g[name])]
        here = [math.dist(e[name], g[name]) for name in good]
        raw += here
        lost.append(bool(here) and mean(here) > bound)
        hips = ("left_hip", "right_hip")
        if all(name in joints and seen(e[name], g[name]) for name in hips):
            a, b = middle([e[name] for name in hips]), middle([g[name] for name in hips])
            root += [math.dist(minus(e[name], a), minus(g[name], b)) for name in good]
        if len(good) >= 3:
            moved = align_horn([e[name] for name in good], [g[name] for name in good])
            rigid += [math.dist(place, g[name]) for place, name in zip(moved, good, strict=True)]
        for start, end in segments.values():
            if start in good and end in good:
                directions.append(angle(minus(e[end], e[start]), minus(g[end], g[start])))
        for above, at, below in angles.values():
            if {above, at, below} <= set(good):
                one, other = (angle(minus(p[at], p[above]), minus(p[below], p[at])) for p in (e, g))
                flexions.append(abs(one - other))
    for t in range(1, len(frames) - 1):
        for name in joints:
            window = [frames[t + k][side][name] for k in (-1, 0, 1) for side in (0, 1)]
            if seen(*window):
                parts = [
                    [
                        frames[t - 1][s][name][i] - 2 * frames[t][s][name][i] + frames[t + 1][s][name][i]
                        for i in range(3)
                    ]
                    for s in (0, 1)
                ]
                accelerations.append(math.dist(*parts) * frame_rate**2)
    lengths, run = [], 0
    for flag in lost:
        if not flag and run:
            lengths.append(run / frame_rate)
        run = run + 1 if flag else 0
    return {
        "mean": mean(raw),
        "root": mean(root),
        "rigid": mean(rigid),
        "segment": mean(directions),
        "angle": mean(flexions),
        "jitter": mean(accelerations),
        "pck_50": mean([float(error <= 0.05) for error in raw]),
        "loss_rate": sum(lost) / len(lost) if lost else math.nan,
        "recovery": mean(lengths),
    }
