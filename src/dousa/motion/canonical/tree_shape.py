"""Canonical joints from the shape of the tree, where names are no help.

A body is a tree with two pairs of equal branches, the legs and the arms. All pairs of branches, split at all joints,
are tried, and those of which the proportions of `anthropometry` make the likeliest person are taken, wherever the forks
are. Left follows from the front of the body.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np
from numpy.typing import ArrayLike

from dousa.arrays import BoolArray, FloatArray
from dousa.motion.canonical.anthropometry import score_ratio
from dousa.motion.canonical.joints import CANONICAL_JOINTS
from dousa.motion.canonical.joints import JOINT_INDEX as J
from dousa.motion.canonical.recipes import Recipe, compile_recipe
from dousa.motion.rotations import cross


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


def _forward(vectors: FloatArray, sizes: FloatArray) -> FloatArray:
    """Unit vectors (T, 3) to the front, from the rows of `_ROWS` (T, 13, 3) and their lengths."""
    across = vectors[:, :2] / sizes[:, :2, None]
    forward = cross(across[:, 0] + across[:, 1], vectors[:, 2])
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
        self.parents, self.positions = parents, positions
        self._distances: dict[tuple[int, int], float] = {}
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

    def longest_way(self) -> float:
        """Length of the longest way from one place to another: from anywhere to the farthest, from there the same."""
        longest = 0.0
        for root in np.flatnonzero(self.parents < 0).tolist():
            _, path = max((self.branch(root, first) for first in self.neighbours[root]), default=(0.0, []))
            end = path[-1] if path else root
            longest = max([longest, *(self.branch(end, first)[0] for first in self.neighbours[end])])
        return longest

    def distance(self, a: int, b: int) -> float:
        if (a, b) not in self._distances:
            offset = self.positions[:, a] - self.positions[:, b]
            self._distances[a, b] = float(np.median(np.sqrt((offset * offset).sum(axis=1))))
        return self._distances[a, b]

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


@dataclass(frozen=True, slots=True)
class _Pair:
    """Two branches of a fork, split at three joints like legs or arms.

    Parameters
    ----------
    fork : where they meet.
    paths : places of both, without the fork.
    joints : positions in the paths of hip, knee, ankle, or of shoulder, elbow, wrist.
    bones : lengths of the upper bones, left and right, then of the lower ones.
    inside : joints within the bones.
    """

    fork: int
    paths: tuple[list[int], list[int]]
    joints: tuple[int, int, int]
    bones: tuple[float, ...]
    inside: int

    @property
    def upper(self) -> float:
        return 0.5 * (self.bones[0] + self.bones[1])

    @property
    def lower(self) -> float:
        return 0.5 * (self.bones[2] + self.bones[3])

    def ends(self, which: int) -> tuple[int, int]:
        """The two places of one of the three joints."""
        return self.paths[0][self.joints[which]], self.paths[1][self.joints[which]]


def _list_pairs(
    tree: _Tree, most_unequal: float = 0.12, shortest: float = 0.08, longest: int = 12, most: int = 10
) -> list[_Pair]:
    """All pairs of branches that may be limbs, split in every way.

    Parameters
    ----------
    most_unequal : difference of the branches as a share of their sum.
    shortest : share of the longest way through the tree; arms of people are 0.15 of it.
    longest : places of a branch that are looked at.
    most : branches of a fork that are looked at, the longest: hair and skirts have hundreds.
    """
    found = []
    whole = tree.longest_way()
    for fork, neighbours in tree.neighbours.items():
        if len(neighbours) < 3:
            continue
        branches = sorted((tree.branch(fork, first) for first in neighbours), reverse=True)[:most]
        for (a, one), (b, other) in combinations(branches, 2):
            if abs(a - b) > most_unequal * (a + b) or 0.5 * (a + b) < shortest * whole:
                continue
            for joints in combinations(range(min(len(one), len(other), longest)), 3):
                upper, lower = (
                    tuple(tree.distance(path[a], path[b]) for path in (one, other)) for a, b in pairwise(joints)
                )
                bones = upper + lower
                if min(bones) > 0 and sum(bones) > 2 * shortest * whole:
                    found.append(_Pair(fork, (one, other), joints, bones, joints[2] - joints[0] - 2))
    return found


_Body = tuple[float, _Pair, _Pair]


def _find_body(tree: _Tree, most_cost: float = 30.0, tried: int = 6) -> _Body | None:
    """The two pairs of branches that are most like a person's legs and arms: (cost, legs, arms).

    Parameters
    ----------
    most_cost : as of `Proportions.is_person`.
    tried : ways to split two branches that are tried with others, those most like the limb first.
    """
    pairs = _list_pairs(tree)
    legs, arms = (_best_splits(pairs, ratio, tried) for ratio in ("thigh_per_shank", "upper_arm_per_forearm"))
    best: _Body | None = None
    for leg in legs:
        for arm in arms:
            if (best is None or leg[0] + arm[0] < best[0]) and _are_apart(tree, leg[1], arm[1]):
                cost = leg[0] + arm[0] + _judge(tree, leg[1], arm[1])
                if cost < (most_cost if best is None else best[0]):
                    best = (cost, leg[1], arm[1])
    return best


def _best_splits(
    pairs: list[_Pair], ratio: str, tried: int, inside: float = 1.0, most: int = 200
) -> list[tuple[float, _Pair]]:
    """At most ``most`` pairs with their own cost: bones of a person's ratio, equal sides, and no joints ``inside``."""
    groups: dict[tuple[int, int, int], list[tuple[float, _Pair]]] = {}  # by the two branches
    for pair in pairs:
        cost = score_ratio(ratio, pair.upper / pair.lower) + inside * pair.inside
        cost += sum(score_ratio("left_per_right", one / other) for one, other in (pair.bones[:2], pair.bones[2:]))
        groups.setdefault((pair.fork, pair.paths[0][0], pair.paths[1][0]), []).append((cost, pair))
    best = (one for group in groups.values() for one in sorted(group, key=lambda one: one[0])[:tried])
    return sorted(best, key=lambda one: one[0])[:most]


def _are_apart(tree: _Tree, legs: _Pair, arms: _Pair) -> bool:
    """Whether no limb is on the way to the others."""
    firsts = [path[0] for pair in (legs, arms) for path in pair.paths]
    if legs.fork == arms.fork:
        return len(set(firsts)) == 4
    trunk = tree.path(legs.fork, arms.fork)
    return len(trunk) > 1 and trunk[1] not in firsts[:2] and trunk[-2] not in firsts[2:]


def _judge(tree: _Tree, legs: _Pair, arms: _Pair) -> float:
    """How unlike a person's the limbs are to each other, and whether the legs lead away from the arms."""
    leg = legs.upper + legs.lower
    hips, shoulders, feet = (
        0.5 * (tree.positions[:, one] + tree.positions[:, other])
        for one, other in (legs.ends(0), arms.ends(0), legs.ends(2))
    )
    up, down = shoulders - hips, feet - hips
    trunk, fall = (np.sqrt(np.einsum("tk,tk->t", vectors, vectors)) for vectors in (up, down))
    with np.errstate(invalid="ignore", divide="ignore"):
        cosine = float(np.median(np.einsum("tk,tk->t", up, down) / (trunk * fall)))
    ratios = {
        "arm_per_leg": arms.upper + arms.lower,
        "trunk_per_leg": float(np.median(trunk)),
        "hips_per_leg": tree.distance(*legs.ends(0)),
        "shoulders_per_leg": tree.distance(*arms.ends(0)),
    }
    return 1.0 + cosine + sum(score_ratio(name, length / leg) for name, length in ratios.items())


def _tip(tree: _Tree, limb: list[int], last: int, share: float) -> int | None:
    """Joint beyond wrist or ankle nearest to a share of the lower bone; None if the limb ends there."""
    rest = limb[last + 1 :]
    bone = tree.distance(limb[last], limb[last - 1])
    inner = rest[:-1] or rest
    return min(inner, key=lambda j: abs(tree.distance(j, limb[last]) - share * bone)) if rest else None


def _limb_sources(tree: _Tree, pair: _Pair, joints: tuple[str, ...], share: float) -> list[dict[str, int]]:
    """The four canonical joints of both limbs of a pair; the tip only if there is one."""
    found = []
    for limb in pair.paths:
        sources = {joint: limb[place] for joint, place in zip(joints, pair.joints, strict=False)}
        tip = _tip(tree, limb, pair.joints[-1], share)
        found.append(sources if tip is None else sources | {joints[-1]: tip})
    return found


def _trunk_sources(tree: _Tree, legs: _Pair, arms: _Pair, spine_share: float = 0.38) -> dict[str, int]:
    """The joints of the trunk; the spine is the one nearest to a share of the way from pelvis to neck."""
    trunk = tree.path(legs.fork, arms.fork)
    chest = trunk[-1]
    used = {*trunk, *(path[0] for pair in (legs, arms) for path in pair.paths)}
    heads = [tree.branch(chest, n) for n in tree.neighbours[chest] if n not in used]
    upper = [chest, *max(heads)[1]] if heads else [chest]
    hips, shoulders = (tree.positions[:, list(pair.ends(0))].mean(axis=1) for pair in (legs, arms))

    def off(node: int, middle: FloatArray = shoulders) -> float:
        gap = tree.positions[:, node] - middle
        return float(np.median(np.sqrt((gap * gap).sum(axis=1))))

    # The chest fork may itself lie between the shoulders; else the neck is the joint nearest to there.
    neck = chest if off(chest) < 0.3 * tree.distance(*arms.ends(0)) else min(upper[:-1] or upper, key=off)
    spine = [*trunk, *upper[1 : upper.index(neck) + 1]]
    whole = tree.length(spine)
    inner = spine[1:-1]
    sources = {"neck": neck}
    if trunk[0] != neck and off(trunk[0], hips) < off(trunk[0]):  # not where limbs and head meet in the chest
        sources["pelvis"] = trunk[0]
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
    _, legs, arms = body
    # A person's: toe per shank, hand per forearm.
    legs_found = _limb_sources(tree, legs, ("hip", "knee", "ankle", "toe"), share=0.35)
    arms_found = _limb_sources(tree, arms, ("shoulder", "elbow", "wrist", "hand"), share=0.8)
    hips, shoulders = legs.ends(0), arms.ends(0)
    across = (seen[:, hips[0]] - seen[:, hips[1]]) * (seen[:, shoulders[0]] - seen[:, shoulders[1]])
    if across.sum() < 0:
        arms_found.reverse()
    central = _trunk_sources(tree, legs, arms)
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
