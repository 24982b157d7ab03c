"""Canonical joints from the shape of the tree, where names are no help.

A body is a tree with two forks: at the pelvis two long, equal branches; at the chest two shorter equal branches and a
short one to the head. All pairs of forks are tried and the one with the proportions nearest to a person's is taken.
The joints of a limb are those that split it like thigh and shank, or upper arm and forearm. Left follows from the front
of the body.
"""

from __future__ import annotations

from itertools import combinations, pairwise

import numpy as np
from numpy.typing import ArrayLike

from dousa.arrays import BoolArray, FloatArray
from dousa.motion.canonical.joints import CANONICAL_JOINTS
from dousa.motion.canonical.joints import JOINT_INDEX as J
from dousa.motion.canonical.recipes import Recipe, compile_recipe


def _rows(*terms: tuple[float, str]) -> FloatArray:
    row = np.zeros(len(CANONICAL_JOINTS))
    for weight, name in terms:
        row[J[name]] += weight
    return row


# By definition: across hips and shoulders; the trunk; mean foot; mean reach of the arms; then for both legs and both
# arms the upper bone (hip to knee, shoulder to elbow) and the whole limb.
_ROWS = np.stack(
    [
        _rows((1, "left_hip"), (-1, "right_hip")),
        _rows((1, "left_shoulder"), (-1, "right_shoulder")),
        _rows((1, "neck"), (-1, "pelvis")),
        _rows((0.5, "left_toe"), (0.5, "right_toe"), (-0.5, "left_ankle"), (-0.5, "right_ankle")),
        _rows((0.5, "left_wrist"), (0.5, "right_wrist"), (-0.5, "left_shoulder"), (-0.5, "right_shoulder")),
        *(
            _rows((1, f"{side}_{end}"), (-1, f"{side}_{start}"))
            for ends in (("knee", "elbow"), ("ankle", "wrist"))
            for start, end in zip(("hip", "shoulder"), ends, strict=True)
            for side in ("left", "right")
        ),
    ]
)
# Trunks of a part of a body, by definition: legs, or head and elbows.
_PART_TRUNKS = np.stack(
    [
        _rows((0.5, "left_hip"), (0.5, "right_hip"), (-0.5, "left_ankle"), (-0.5, "right_ankle")),
        _rows((1.0, "head"), (-0.5, "left_elbow"), (-0.5, "right_elbow")),
    ]
)


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Cross product (..., 3), several times faster than numpy's on small arrays."""
    result = np.empty(np.broadcast(a, b).shape)
    result[..., 0] = a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1]
    result[..., 1] = a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2]
    result[..., 2] = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return result


def _forward(vectors: FloatArray, sizes: FloatArray) -> FloatArray:
    """Unit vectors (T, 3) to the front, from the rows of `_ROWS` (T, 13, 3) and their lengths."""
    across = vectors[:, :2] / sizes[:, :2, None]
    forward = _cross(across[:, 0] + across[:, 1], vectors[:, 2])
    size = np.sqrt(np.einsum("tk,tk->t", forward, forward))
    size[size == 0] = np.nan
    directions: FloatArray = forward / size[:, None]
    return directions


def _measure(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The vectors of `_ROWS` (T, 13, 3) and their lengths (T, 13), NaN instead of 0."""
    vectors = _ROWS @ points
    if np.isnan(vectors).any():
        vectors = _differences(_ROWS, points)
    if np.isnan(vectors[0, :3]).any():
        _stand_in(vectors, points)
    sizes = np.sqrt(np.einsum("tjk,tjk->tj", vectors, vectors))
    sizes[sizes == 0] = np.nan
    return vectors, sizes


def _differences(rows: FloatArray, points: FloatArray) -> FloatArray:
    """``rows @ points`` where points are missing: NaN only in the rows that need them."""
    gone: BoolArray = np.any(np.isnan(points), axis=2)
    vectors: FloatArray = rows @ np.where(gone[..., None], 0.0, points)
    vectors[gone @ (rows != 0).T > 0] = np.nan
    return vectors


def _stand_in(vectors: FloatArray, points: FloatArray) -> None:
    """Complete the front of a part of a body: hips or shoulders for both, legs or upper arms for the trunk."""
    for absent, other in ((0, 1), (1, 0)):
        if np.isnan(vectors[:, absent]).all():
            vectors[:, absent] = vectors[:, other]
    if np.isnan(vectors[:, 2]).all():
        trunks = _differences(_PART_TRUNKS, points)
        vectors[:, 2] = trunks[:, 0] if not np.isnan(trunks[:, 0]).all() else trunks[:, 1]


def compute_forward(points: FloatArray) -> FloatArray:
    """Compute unit vectors (T, 3) to the front of the body, for correct sides and right-handed axes; NaN if unclear."""
    return _forward(*_measure(points))


def spread_frames(points: FloatArray, most: int = 32) -> FloatArray:
    """Return at most 32 frames of (T, ..., 3), evenly spread: enough for sides, heights and shapes."""
    if len(points) <= most:
        return points
    return points[np.linspace(0, len(points) - 1, most).round().astype(np.intp)]


def score_sides(
    points: FloatArray,
    *,
    outward_weights: tuple[float, float] = (4.0, 0.5),
    bend_weights: tuple[float, float] = (1.0, 0.5),
    slack: float = 0.05,
    most: float = 3.0,
) -> float:
    """Score the named sides: +1 if left is left, -1 if the body looks mirrored, near 0 if unclear (0 if all is NaN).

    Parameters
    ----------
    points : (T, 20, 3) in right-handed axes, any unit; at most 32 frames, evenly spread, are used.
    outward_weights : of feet and arms to the front, in lengths of the trunk.
    bend_weights : of a knee to the front, and of an elbow to the back.
    slack : a limb straighter than this share of its length has no bend.
    most : of the score of one frame: a joint far away in some frames counts no more than others.
    """
    points = spread_frames(points)
    vectors, sizes = _measure(points)
    ahead = np.einsum("tjk,tk->tj", vectors, _forward(vectors, sizes))
    # How far the knee or elbow is off the line from hip to ankle or shoulder to wrist, to the front.
    upper, whole = slice(5, 9), slice(9, 13)
    share = np.einsum("tjk,tjk->tj", vectors[:, upper], vectors[:, whole]) / sizes[:, whole] ** 2
    bend = (ahead[:, upper] - share * ahead[:, whole]) / (2.0 * sizes[:, upper])
    bend -= np.clip(bend, -slack, slack)
    bend[np.isnan(bend)] = 0.0  # a bone of no length does not bend
    outward = ahead[:, 3:5]
    outward[:, np.isnan(outward).all(axis=0)] = 0.0  # no feet, or no arms
    knee, elbow = bend_weights
    scores = (outward @ np.array(outward_weights)) / sizes[:, 2] + bend @ np.array([knee, knee, -elbow, -elbow])
    scores = np.clip(scores, -most, most)
    total = float(scores.mean())
    if np.isnan(total):
        scores = scores[~np.isnan(scores)]
        total = float(scores.mean()) if len(scores) else 0.0
    return total


def compare_sides(points: FloatArray, clear: float = 0.08) -> str:
    """Return whether named and geometrical sides ``"agree"``, ``"disagree"`` or are ``"unclear"``."""
    score = score_sides(points)
    if abs(score) < clear:
        return "unclear"
    return "agree" if score > 0 else "disagree"


class _Tree:
    """The places of a skeleton as an undirected tree with bone lengths.

    Joints nearer to each other than the share ``coincident`` of the median bone are one place.
    """

    def __init__(self, parents: FloatArray, positions: FloatArray, coincident: float = 1e-3) -> None:
        self.positions = positions
        self.neighbours: dict[int, dict[int, float]] = {}
        place = list(range(len(parents)))
        bones = [self.distance(j, int(p)) for j, p in enumerate(parents) if p >= 0]
        limit = coincident * float(np.median([b for b in bones if b > 0] or [0.0]))
        for joint, parent in enumerate(parents):
            if parent < 0:
                self.neighbours[joint] = {}
                continue
            home = place[int(parent)]
            near = [home, *(n for n in self.neighbours[home] if n > home)]
            same = next((n for n in near if self.distance(joint, n) <= limit), None)
            if same is not None:
                place[joint] = same
                continue
            length = self.distance(joint, home)
            self.neighbours[joint] = {home: length}
            self.neighbours[home][joint] = length

    def distance(self, a: int, b: int) -> float:
        offset = self.positions[:, a] - self.positions[:, b]
        return float(np.median(np.sqrt((offset * offset).sum(axis=1))))

    def branch(self, start: int, first: int) -> tuple[float, list[int]]:
        """Length and places of the longest path that leaves ``start`` through ``first``."""
        best: tuple[float, list[int]] = (0.0, [])
        stack = [(first, start, self.neighbours[start][first], [first])]
        while stack:
            node, before, length, path = stack.pop()
            if length > best[0]:
                best = (length, path)
            for after, bone in self.neighbours[node].items():
                if after != before:
                    stack.append((after, node, length + bone, [*path, after]))
        return best

    def path(self, start: int, goal: int) -> list[int]:
        """Places from start to goal, both included; empty if they are in different trees."""
        stack = [(start, [start])]
        while stack:
            node, path = stack.pop()
            if node == goal:
                return path
            stack += [(n, [*path, n]) for n in self.neighbours[node] if n not in path[-2:]]
        return []

    def length(self, path: list[int]) -> float:
        return sum(self.neighbours[a][b] for a, b in pairwise(path))


class _Fork:
    """A place with its branches, longest path each."""

    def __init__(self, tree: _Tree, node: int) -> None:
        self.node = node
        self.branches = {first: tree.branch(node, first) for first in tree.neighbours[node]}

    def pairs(self, without: int, most_unequal: float = 0.12) -> list[tuple[float, float, list[int], list[int]]]:
        """Pairs of branches of nearly equal length: (mean length, inequality as a share of the sum, path, path)."""
        found = []
        others = [branch for first, branch in self.branches.items() if first != without]
        for (a, path_a), (b, path_b) in combinations(others, 2):
            unequal = abs(a - b) / (a + b)
            if unequal < most_unequal and min(len(path_a), len(path_b)) >= 3:
                found.append((0.5 * (a + b), unequal, path_a, path_b))
        return found


_Body = tuple[float, list[int], list[list[int]], list[list[int]]]


def _judge(
    tree: _Tree,
    pelvis: _Fork,
    chest: _Fork,
    leg_per_trunk: tuple[float, float] = (2.9, 0.35),
    arm_per_leg: tuple[float, float] = (0.72, 0.2),
) -> _Body | None:
    """The cheapest reading of two forks as pelvis and chest: (cost, trunk, legs, arms).

    ``leg_per_trunk``, ``arm_per_leg`` : a person's proportions, and how much their logarithms scatter over skeletons.
    """
    trunk = tree.path(pelvis.node, chest.node)
    if len(trunk) < 2:
        return None
    size = tree.length(trunk)
    best: _Body | None = None
    up = tree.positions[:, chest.node] - tree.positions[:, pelvis.node]
    for leg, leg_unequal, *legs in pelvis.pairs(without=trunk[1]):
        tips = 0.5 * (tree.positions[:, legs[0][-1]] + tree.positions[:, legs[1][-1]])
        down = tips - tree.positions[:, pelvis.node]
        cosine = np.median((up * down).sum(axis=1) / np.sqrt((up * up).sum(axis=1) * (down * down).sum(axis=1)))
        for arm, arm_unequal, *arms in chest.pairs(without=trunk[-2]):
            cost = (np.log(leg / size / leg_per_trunk[0]) / leg_per_trunk[1]) ** 2
            cost += (np.log(arm / leg / arm_per_leg[0]) / arm_per_leg[1]) ** 2
            cost += 5.0 * (leg_unequal + arm_unequal) + (1.0 + cosine)
            cost += 0.5 * (len(chest.branches) < 4) + 0.2 * (len(pelvis.branches) > 3)
            if best is None or cost < best[0]:
                best = (float(cost), trunk, legs, arms)
    return best


def _find_body(tree: _Tree, most_cost: float = 4.0) -> _Body | None:
    forks = [_Fork(tree, node) for node, neighbours in tree.neighbours.items() if len(neighbours) >= 3]
    bodies = [_judge(tree, a, b) for a in forks for b in forks if a is not b]
    found = [body for body in bodies if body is not None and body[0] < most_cost]
    return min(found, key=lambda body: body[0]) if found else None


def _split_limbs(tree: _Tree, limbs: list[list[int]], ratio: float) -> tuple[int, int, int]:
    """Positions in both limbs of a pair of hip, knee and ankle, or of shoulder, elbow and wrist."""
    best, best_cost = (0, 1, 2), np.inf
    for indices in combinations(range(min(map(len, limbs))), 3):
        cost = sum(_split_cost(tree, [limb[i] for i in indices], tree.length(limb), ratio) for limb in limbs)
        # No joint should lie inside the two long bones.
        cost += 0.2 * (indices[2] - indices[0] - 2)
        if cost < best_cost:
            best, best_cost = indices, cost
    return best


def _split_cost(tree: _Tree, joints: list[int], whole: float, ratio: float) -> float:
    """Cost of two long bones of a limb: they should be of similar length and most of the limb."""
    upper, lower = tree.distance(joints[0], joints[1]), tree.distance(joints[1], joints[2])
    if upper <= 0 or lower <= 0:
        return np.inf
    return float(np.log(upper / lower / ratio) ** 2 + 0.3 * np.log((upper + lower) / whole) ** 2)


def _tip(tree: _Tree, limb: list[int], last: int, share: float) -> int | None:
    """Joint beyond wrist or ankle nearest to a share of the lower bone; None if the limb ends there."""
    rest = limb[last + 1 :]
    bone = tree.distance(limb[last], limb[last - 1])
    inner = rest[:-1] or rest
    return min(inner, key=lambda j: abs(tree.distance(j, limb[last]) - share * bone)) if rest else None


def _limb_sources(
    tree: _Tree, limbs: list[list[int]], joints: tuple[str, ...], ratio: float, share: float
) -> list[dict[str, int]]:
    """The four canonical joints of both limbs of a pair; the tip only if there is one."""
    indices = _split_limbs(tree, limbs, ratio)
    found = []
    for limb in limbs:
        sources = {joint: limb[i] for joint, i in zip(joints, indices, strict=False)}
        tip = _tip(tree, limb, indices[-1], share)
        found.append(sources if tip is None else sources | {joints[-1]: tip})
    return found


def _trunk_sources(tree: _Tree, body: _Body, shoulders: list[int], spine_share: float = 0.38) -> dict[str, int]:
    """The joints of the trunk; the spine is the one nearest to a share of the way from pelvis to neck."""
    _, trunk, _, arms = body
    chest = trunk[-1]
    used = {trunk[-2], arms[0][0], arms[1][0]}
    heads = [tree.branch(chest, n) for n in tree.neighbours[chest] if n not in used]
    upper = [chest, *max(heads)[1]] if heads else [chest]
    middle = tree.positions[:, shoulders].mean(axis=1)
    width = tree.distance(*shoulders)

    def off(node: int) -> float:
        gap = tree.positions[:, node] - middle
        return float(np.median(np.sqrt((gap * gap).sum(axis=1))))

    # The chest fork may itself lie between the shoulders; else the neck is the joint nearest to there.
    neck = chest if off(chest) < 0.3 * width else min(upper[:-1] or upper, key=off)
    spine = [*trunk, *upper[1 : upper.index(neck) + 1]]
    whole = tree.length(spine)
    inner = spine[1:-1]
    sources = {"pelvis": trunk[0], "neck": neck}
    if inner:
        sources["spine"] = min(inner, key=lambda j: abs(tree.length(spine[: spine.index(j) + 1]) - spine_share * whole))
    if upper[-1] != neck:
        sources["head"] = upper[-1]
    return sources


def shape_sources(parents: ArrayLike, positions: FloatArray) -> dict[str, tuple[int, ...]] | None:
    """Find canonical joint -> index (as a tuple) from the shape alone; None if the tree is not a body.

    Parameters
    ----------
    parents : (J,) parent before child, -1 for a root.
    positions : (T, J, 3) some frames, right-handed axes, any unit.
    """
    parents = np.asarray(parents)
    seen = positions[~np.isnan(positions).any(axis=(1, 2))]
    if not len(seen) or not 8 <= len(parents) <= 1000:
        return None
    seen = spread_frames(seen)
    tree = _Tree(parents, seen)
    body = _find_body(tree)
    if body is None:
        return None
    _, _, legs, arms = body
    # A person's: thigh per shank and toe per shank, upper arm per forearm and hand per forearm.
    legs_found = _limb_sources(tree, legs, ("hip", "knee", "ankle", "toe"), ratio=1.0, share=0.35)
    arms_found = _limb_sources(tree, arms, ("shoulder", "elbow", "wrist", "hand"), ratio=1.2, share=0.8)
    shoulders = [arm["shoulder"] for arm in arms_found]
    hips = [leg["hip"] for leg in legs_found]
    across = (seen[:, hips[0]] - seen[:, hips[1]]) * (seen[:, shoulders[0]] - seen[:, shoulders[1]])
    if across.sum() < 0:
        arms_found.reverse()
    central = _trunk_sources(tree, body, shoulders)
    sources = _with_sides(central, legs_found, arms_found)
    if score_sides(compile_recipe("tree shape", sources).apply(seen)) < 0:
        sources = _with_sides(central, legs_found[::-1], arms_found[::-1])
    return sources


def _with_sides(
    central: dict[str, int], legs: list[dict[str, int]], arms: list[dict[str, int]]
) -> dict[str, tuple[int, ...]]:
    sources: dict[str, tuple[int, ...]] = {joint: (index,) for joint, index in central.items()}
    for side, leg, arm in zip(("left", "right"), legs, arms, strict=True):
        sources |= {f"{side}_{joint}": (index,) for joint, index in (leg | arm).items()}
    return sources


def shape_recipe(parents: ArrayLike, positions: FloatArray) -> Recipe | None:
    """Compile the mapping by the shape of the tree; None if it is not a body's."""
    sources = shape_sources(parents, positions)
    return None if sources is None else compile_recipe("tree shape", sources)
