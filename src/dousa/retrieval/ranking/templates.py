"""Motion templates on 39 boolean relational features: the baseline for the random forest.

A template gives, frame by frame, the relational features that are always true, always false or vary in the motions of a
category. Source: Müller, Röder, "Motion templates for automatic classification and retrieval of motion capture data",
SCA 2006. Every training motion in turn is the reference to which the others are warped; frames weigh less where a
motion is stretched and are averaged where it is squeezed; the weighted mean is stretched back to frames of equal
weight. This repeats until nothing changes. Entries near 0 or 1 are then rounded; the others are grey and ignored.

Deviations: whole clips are compared instead of stretches of a recording, so diagonal steps weigh double and the sum is
divided by both lengths. In a large category only some motions serve as references (all are averaged).

Each feature is a yes-or-no question about a pose: is the right hand raised, are the feet crossed, is the root fast? The
generic features (side of a plane, speed along its normal, angle, speed) are those of Müller, Röder, Clausen, "Efficient
content-based retrieval of motion capture data", ACM TOG 24(3), 2005; the choice of 39 (arms F1-F14, legs F15-F26, the
whole body F27-F39) is that of the motion templates. A measure has two thresholds: the answer turns yes at the strong
one and stays yes until the weak one fails, to avoid flicker. Thresholds are in body measures: ``humerus`` (upper arm),
``shoulders`` and ``hips`` (widths), ``height``; speeds are per second.

Deviations, as the canonical joints have one spine joint instead of belly and chest: trunk directions run from pelvis to
neck (F5, F6, F27-F30, F32) or from spine to neck (F3, F4); leg planes contain the hip line and the leg (F15, F16),
which also works where the pelvis joint lies on the hip line. F35 and F36 use the sine of the angle of the shoulder line
to the hip plane; F38 is the largest horizontal distance between two joints, independent of the heading. The thresholds
of F37 and F38 are chosen for these joints and this height.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dousa.arrays import BoolArray, FloatArray, IndexArray
from dousa.errors import InvalidMotionError, NotTrainedError, OptionError, TrainingError
from dousa.kernels import kernel, part
from dousa.motion import Trajectories, resample
from dousa.motion.canonical.joints import CANONICAL_JOINTS, JOINT_INDEX
from dousa.retrieval.features.posed_motion import PosedMotion, check_shape
from dousa.workers.threads import map_pieces


@dataclass(frozen=True, slots=True)
class RelationalFeature:
    """A yes-or-no question about a pose.

    Parameters
    ----------
    name : the positive answer in words.
    weak, strong : the answer turns yes when the measure exceeds ``strong`` and no when it falls to ``weak``.
    unit : of the thresholds: ``"humerus"``, ``"humerus/s"``, ``"shoulders"``, ``"hips"``, ``"height"``,
        ``"degrees"`` or ``"sine"``. Negative thresholds belong to measures that must stay small.
    """

    name: str
    weak: float
    strong: float
    unit: str


def _both(name: str, weak: float, strong: float, unit: str) -> tuple[RelationalFeature, RelationalFeature]:
    return (
        RelationalFeature(name.replace("this", "right").replace("other", "left"), weak, strong, unit),
        RelationalFeature(name.replace("this", "left").replace("other", "right"), weak, strong, unit),
    )


RELATIONAL_FEATURES: tuple[RelationalFeature, ...] = (
    *_both("this hand moving forwards", 1.3, 1.8, "humerus/s"),
    *_both("this hand above neck", 0.0, 0.2, "humerus"),
    *_both("this hand moving upwards", 1.3, 1.8, "humerus/s"),
    *_both("this elbow bent", 60.0, 70.0, "degrees"),
    RelationalFeature("hands far apart sideways", 2.0, 2.5, "shoulders"),
    RelationalFeature("hands approaching each other", 1.2, 1.4, "humerus/s"),
    *_both("this hand moving away from root", 1.2, 1.4, "humerus/s"),
    *_both("this hand fast", 2.0, 2.5, "humerus/s"),
    *_both("this foot behind other leg", 0.0, 0.38, "humerus"),
    *_both("this foot raised", 1.0, 1.2, "humerus"),
    RelationalFeature("feet far apart sideways", 1.8, 2.1, "hips"),
    *_both("this knee bent", 60.0, 70.0, "degrees"),
    RelationalFeature("feet crossed", 0.0, 0.125, "hips"),
    RelationalFeature("feet approaching each other sideways", 1.3, 1.5, "humerus/s"),
    RelationalFeature("feet moving apart sideways", 1.3, 1.5, "humerus/s"),
    *_both("this foot fast", 2.0, 2.5, "humerus/s"),
    *_both("this upper arm abducted", 25.0, 30.0, "degrees"),
    *_both("this thigh abducted", 45.0, 50.0, "degrees"),
    RelationalFeature("root behind the plane of feet and neck", 0.35, 0.5, "humerus"),
    RelationalFeature("spine horizontal", -30.0, -20.0, "degrees"),
    *_both("this hand lowered", -1.4, -1.2, "humerus"),
    *_both("shoulders rotated to the this", 0.35, 0.4, "sine"),
    RelationalFeature("body low", -0.9, -0.8, "height"),
    RelationalFeature("body stretched out sideways", 0.7, 0.8, "height"),
    RelationalFeature("root fast", 2.0, 2.3, "humerus/s"),
)
"""F1 to F39 in the order of the paper, table 1; of pairs, right before left."""

_SIDES = ("right", "left")


def compute_relational_features(positions: ArrayLike, frame_rate: float, height: float) -> BoolArray:
    """Compute the 39 features of every frame: (T, 39) bool, columns as ``RELATIONAL_FEATURES``.

    Parameters
    ----------
    positions : (T, 20, 3) m, canonical joints, Y up, finite; the thresholds are for 30 Hz.
    frame_rate : Hz.
    height : m, of the performer.

    Raises
    ------
    InvalidMotionError : positions of another shape or not finite; a rate or height not above zero.

    Source: Müller, Röder 2006, table 1; deviations in the module's docstring.
    """
    joints = check_shape(positions, height)
    if not np.isfinite(joints).all():
        raise InvalidMotionError("posed_motion.not_finite")
    if not (np.isfinite(frame_rate) and frame_rate > 0):
        raise InvalidMotionError("posed_motion.rate_and_height", rate=frame_rate, height=height)
    body = _Body(joints, float(frame_rate), float(height))
    measures = np.stack([*_hands(body), *_feet(body), *_whole_body(body)], axis=1)
    scale = np.array([body.sizes[feature.unit.removesuffix("/s")] for feature in RELATIONAL_FEATURES])
    weak = np.array([feature.weak for feature in RELATIONAL_FEATURES]) * scale
    strong = np.array([feature.strong for feature in RELATIONAL_FEATURES]) * scale
    return apply_hysteresis(measures > weak, measures > strong)


class _Body:
    """Positions by name, and body measures and directions shared by questions."""

    def __init__(self, joints: FloatArray, frame_rate: float, height: float) -> None:
        self.joints = joints
        self.frame_rate = frame_rate
        arms = [self._length(f"{side}_shoulder", f"{side}_elbow") for side in _SIDES]
        self.sizes = {
            "humerus": max(float(np.mean(arms)), 1e-6),
            "shoulders": max(self._length("left_shoulder", "right_shoulder"), 1e-6),
            "hips": max(self._length("left_hip", "right_hip"), 1e-6),
            "height": height,
            "degrees": np.pi / 180.0,
            "sine": 1.0,
        }
        self.hip_line = _unit(self["left_hip"] - self["right_hip"])
        self.shoulder_line = _unit(self["left_shoulder"] - self["right_shoulder"])
        self.trunk = _unit(self["neck"] - self["pelvis"])
        hips = 0.5 * (self["left_hip"] + self["right_hip"])
        self.forward = _unit(np.cross(self.hip_line, self["neck"] - hips))
        self.lowest = joints[:, :, 1].min(axis=1)

    def __getitem__(self, name: str) -> FloatArray:
        return self.joints[:, JOINT_INDEX[name]]

    def _length(self, one: str, other: str) -> float:
        # The median over time, as bones of camera skeletons vary in length.
        return float(np.median(np.linalg.norm(self[one] - self[other], axis=1)))

    def velocity(self, points: FloatArray, window: float = 0.1) -> FloatArray:
        """Return the (T, 3) velocity in m/s of points averaged over a window in seconds."""
        if len(points) < 2:
            return np.zeros_like(points)
        half = round(window * self.frame_rate) // 2
        if half:
            padded = np.pad(points, ((half, half), (0, 0)), mode="edge")
            sums = np.cumsum(np.vstack([np.zeros((1, 3)), padded]), axis=0)
            width = 2 * half + 1
            points = (sums[width:] - sums[:-width]) / width
        return np.gradient(points, 1.0 / self.frame_rate, axis=0)


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    found: FloatArray = np.einsum("tk,tk->t", a, b)
    return found


def _unit(vectors: FloatArray) -> FloatArray:
    """Scale vectors to length 1; a zero vector stays zero, so questions on it are negative."""
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    found: FloatArray = np.divide(vectors, lengths, out=np.zeros_like(vectors), where=lengths > 1e-12)
    return found


def _angle(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the angle in radians between directions, accurate near 0 and pi."""
    found: FloatArray = np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), _dot(a, b))
    return found


def _flexion(body: _Body, upper: str, middle: str, lower: str) -> list[FloatArray]:
    return [
        _angle(body[f"{s}_{middle}"] - body[f"{s}_{upper}"], body[f"{s}_{lower}"] - body[f"{s}_{middle}"])
        for s in _SIDES
    ]


def _hands(body: _Body) -> list[FloatArray]:
    """Measures of F1 to F14."""
    wrists = [body[f"{side}_wrist"] for side in _SIDES]
    # Directed movements are slower than tremor.
    from_neck = [body.velocity(wrist - body["neck"], window=0.25) for wrist in wrists]
    upper_spine = _unit(body["neck"] - body["spine"])
    right, left = wrists
    between = _unit(right - left)
    from_root = [wrist - body["pelvis"] for wrist in wrists]
    return [
        *(_dot(speed, body.forward) for speed in from_neck),
        *(_dot(wrist - body["neck"], upper_spine) for wrist in wrists),
        *(_dot(speed, body.trunk) for speed in from_neck),
        *_flexion(body, "shoulder", "elbow", "wrist"),
        np.abs(_dot(left - right, body.shoulder_line)),
        -_dot(body.velocity(right - left), between),
        *(_dot(body.velocity(offset), _unit(offset)) for offset in from_root),
        *(np.linalg.norm(body.velocity(wrist), axis=1) for wrist in wrists),
    ]


def _feet(body: _Body) -> list[FloatArray]:
    """Measures of F15 to F26."""
    ankles = {side: body[f"{side}_ankle"] for side in _SIDES}
    behind = []
    for side, other in (("right", "left"), ("left", "right")):
        hip = body[f"{other}_hip"]
        ahead_of_leg = _unit(np.cross(body.hip_line, hip - ankles[other]))
        behind.append(-_dot(ankles[side] - hip, ahead_of_leg))
    spread = ankles["left"] - ankles["right"]
    sideways = _dot(body.velocity(spread), body.hip_line)
    speeds = [
        np.minimum(*(np.linalg.norm(body.velocity(body[f"{side}_{j}"]), axis=1) for j in ("ankle", "toe")))
        for side in _SIDES
    ]
    apart = _dot(spread, body.hip_line)
    return [
        *behind,
        *(ankles[side][:, 1] - body.lowest for side in _SIDES),
        np.abs(apart),
        *_flexion(body, "hip", "knee", "ankle"),
        -apart,
        -sideways,
        sideways,
        *speeds,
    ]


def _whole_body(body: _Body) -> list[FloatArray]:
    """Measures of F27 to F39."""
    ankles_line = body["left_ankle"] - body["right_ankle"]
    between_ankles = 0.5 * (body["left_ankle"] + body["right_ankle"])
    ahead = _unit(np.cross(ankles_line, body["neck"] - between_ankles))
    up = np.broadcast_to(np.array([0.0, 1.0, 0.0]), body.trunk.shape)
    left_ahead = _dot(body.shoulder_line, body.forward)  # the shoulders are turned to the right
    ground = body.joints[:, :, ::2]
    # The widest pair of joints, as the extent along fixed axes varies with the heading.
    x, z = (ground[:, :, None, k] - ground[:, None, :, k] for k in (0, 1))
    width = np.sqrt((x * x + z * z).max(axis=(1, 2)))
    down = -body.trunk
    return [
        *(_angle(down, body[f"{side}_elbow"] - body[f"{side}_shoulder"]) for side in _SIDES),
        *(_angle(down, body[f"{side}_knee"] - body[f"{side}_hip"]) for side in _SIDES),
        -_dot(body["pelvis"] - between_ankles, ahead),
        -np.abs(_angle(body.trunk, up) - 0.5 * np.pi),
        *(body.lowest - body[f"{side}_wrist"][:, 1] for side in _SIDES),
        left_ahead,
        -left_ahead,
        -np.ptp(body.joints[:, :, 1], axis=1),
        width,
        np.linalg.norm(body.velocity(body["pelvis"]), axis=1),
    ]


def apply_hysteresis(weak: BoolArray, strong: BoolArray) -> BoolArray:
    """Return true from a frame where ``strong`` holds until ``weak`` fails; both (T, F)."""
    frames = np.arange(len(weak))[:, None]
    last_strong = np.maximum.accumulate(np.where(strong, frames, -1), axis=0)
    last_failure = np.maximum.accumulate(np.where(weak, -1, frames), axis=0)
    return last_strong > last_failure


def compute_relational_sequence(clip: PosedMotion, sampling_rate: float = 30.0) -> BoolArray:
    """Compute the (T', 39) features of a clip of canonical positions, resampled to a rate in Hz."""
    positions, rate = clip.positions, clip.frame_rate
    if not np.isclose(rate, sampling_rate):
        positions = resample(Trajectories(CANONICAL_JOINTS, positions, rate), sampling_rate).positions
    return compute_relational_features(positions, sampling_rate, clip.height)


class MotionTemplates:
    """One template per category; a motion has the category of the nearest.

    Parameters
    ----------
    threshold : share of the training motions that may disagree about an entry that is not grey; 0 to below 0.5.
    n_iterations : greatest number of rounds of warping and averaging.
    max_references : motions of a category that serve as references.
    n_jobs : threads (joblib); None for one.

    Attributes
    ----------
    classes_ : (C,) the categories, sorted.
    templates_ : C arrays (K, 39) of int8: 0 never, 1 always, -1 grey.
    averages_ : C arrays (K, 39) before rounding: shares of the training motions.
    """

    def __init__(
        self, threshold: float = 0.1, n_iterations: int = 12, max_references: int = 10, n_jobs: int | None = None
    ) -> None:
        if not 0 <= threshold < 0.5:
            raise OptionError("templates.threshold", found=threshold)
        if n_iterations < 1 or max_references < 1:
            raise OptionError("templates.counts", iterations=n_iterations, references=max_references)
        self.threshold, self.n_jobs = threshold, n_jobs
        self.n_iterations, self.max_references = n_iterations, max_references

    def fit(self, sequences: Sequence[BoolArray], categories: ArrayLike) -> Self:
        """Learn a template for every category from training motions and their labels (N,).

        ``sequences`` are relational features (T, 39) of ``compute_relational_sequence``. TrainingError : none, or
        another number of labels.
        """
        labels = np.asarray(categories)
        if len(sequences) == 0 or labels.shape != (len(sequences),):
            raise TrainingError("templates.labels", clips=len(sequences), shape=labels.shape)
        self.classes_, numbers = np.unique(labels, return_inverse=True)
        groups = [
            [np.asarray(sequences[int(k)], dtype=np.float64) for k in np.flatnonzero(numbers == c)]
            for c in range(len(self.classes_))
        ]
        learn = partial(_learn_average, n_iterations=self.n_iterations, max_references=self.max_references)
        self.averages_ = map_pieces(learn, groups, self.n_jobs, at_a_time=1)
        self.templates_ = [_round_off(average, self.threshold) for average in self.averages_]
        self._weights, self._offsets, self._bounds = _cost_matrices(self.templates_)
        return self

    def distances(self, sequences: Sequence[BoolArray]) -> FloatArray:
        """Compute the (N, C) distances of motions to templates, from 0 (equal wherever not grey) to 1.

        NotTrainedError : before ``fit``.
        """
        if not hasattr(self, "classes_"):
            raise NotTrainedError("templates.not_trained")
        rows = map_pieces(self._distances_of_one, sequences, self.n_jobs)
        return np.array(rows, dtype=np.float64).reshape(len(sequences), len(self.classes_))

    def predict(self, sequences: Sequence[BoolArray]) -> NDArray[Any]:
        """Return the category of the nearest template for every motion, (N,)."""
        nearest = np.argmin(self.distances(sequences), axis=1)
        found: NDArray[Any] = self.classes_[nearest]
        return found

    def _distances_of_one(self, sequence: BoolArray) -> FloatArray:
        costs = self._weights @ np.asarray(sequence, dtype=np.float64).T
        costs += self._offsets[:, None]
        found: FloatArray = warped_costs(costs, self._bounds)
        return found


def _learn_average(motions: list[FloatArray], n_iterations: int, max_references: int) -> FloatArray:
    """Return the average (K, F) of motions (T_i, F) after warping them in time, before rounding."""
    if len(motions) == 1:
        return motions[0]
    by_length = np.argsort([len(motion) for motion in motions], kind="stable")
    chosen = np.linspace(0, len(motions) - 1, min(max_references, len(motions))).round().astype(int)
    references = [motions[by_length[k]] for k in chosen]
    current = motions
    for _ in range(n_iterations):
        merged = [_merge(reference, current)[0] for reference in references]
        pairs = zip(references, merged, strict=True)
        # The rounds end when no entry changes by more than a thousandth on average.
        stable = all(old.shape == new.shape and float(np.abs(old - new).mean()) <= 1e-3 for old, new in pairs)
        references = current = merged
        if stable:
            break
    # The rounds make the references similar; the motions choose among them.
    costs = [_merge(reference, motions)[1] / len(reference) for reference in references]
    found: FloatArray = references[int(np.argmin(costs))]
    return found


def _merge(reference: FloatArray, motions: Sequence[FloatArray]) -> tuple[FloatArray, float]:
    """Average the motions warped to the reference, at frames of equal weight; also return the cost of warping."""
    values = np.zeros_like(reference)
    weights = np.zeros(len(reference))
    cost = 0.0
    for motion in motions:
        cost += merge_along_path(reference, np.ascontiguousarray(motion.T), values, weights)
    return _equalise(values / weights[:, None], weights / len(motions)), cost


def _equalise(values: FloatArray, weights: FloatArray) -> FloatArray:
    """Stretch frames of weight above 1 and average those below: (K', F), K' the total weight.

    A frame of weight w fills a length w; a new frame is the mean over an equal part of the whole.
    """
    ends = np.concatenate([[0.0], np.cumsum(weights)])
    integral = np.vstack([np.zeros(values.shape[1]), np.cumsum(values * weights[:, None], axis=0)])
    count = max(round(float(ends[-1])), 1)
    cuts = np.linspace(0.0, ends[-1], count + 1)
    piece = np.clip(np.searchsorted(ends, cuts, side="right") - 1, 0, len(weights) - 1)
    at_cuts = integral[piece] + (cuts - ends[piece])[:, None] * values[piece]
    found: FloatArray = np.clip(np.diff(at_cuts, axis=0) * (count / ends[-1]), 0.0, 1.0)
    return found


def _round_off(average: FloatArray, threshold: float) -> NDArray[np.int8]:
    """Return 0 and 1 where the motions agree up to ``threshold``, -1 (grey) elsewhere."""
    # Room for rounding of weighted means.
    room = threshold + 1e-9
    return np.where(average <= room, 0, np.where(average >= 1.0 - room, 1, -1)).astype(np.int8)


def _cost_matrices(templates: Sequence[NDArray[np.int8]]) -> tuple[FloatArray, FloatArray, IndexArray]:
    """Return weights and offsets of the local costs ``weights @ X.T + offsets`` of a motion X (T, F); template bounds.

    The cost of a template frame is the share of its 0 and 1 entries that the motion contradicts, 0 if all are grey.
    """
    stacked = np.concatenate(templates)
    fixed = np.maximum((stacked >= 0).sum(axis=1), 1)
    weights = ((stacked == 0).astype(np.float64) - (stacked == 1)) / fixed[:, None]
    offsets = (stacked == 1).sum(axis=1) / fixed
    bounds = np.concatenate([[0], np.cumsum([len(template) for template in templates])]).astype(np.intp)
    return weights, offsets, bounds


@part(allocates=True)
def _accumulate(reference: FloatArray, motion_by_feature: FloatArray) -> FloatArray:
    """Return the (K, L) cost of the best path to each pair of frames; local costs are Manhattan distances."""
    n_reference, n_features = reference.shape
    n_motion = motion_by_feature.shape[1]
    total = np.zeros((n_reference, n_motion))
    for i in range(n_reference):
        row = total[i]
        for f in range(n_features):
            here = reference[i, f]
            there = motion_by_feature[f]
            for j in range(n_motion):
                row[j] += abs(here - there[j])
        if i == 0:
            for j in range(1, n_motion):
                row[j] += row[j - 1]
        else:
            above = total[i - 1]
            row[0] += above[0]
            for j in range(1, n_motion):
                row[j] += min(above[j - 1], above[j], row[j - 1])
    return total


@kernel(allocates=True)
def merge_along_path(
    reference: FloatArray, motion_by_feature: FloatArray, values: FloatArray, weights: FloatArray
) -> float:
    """Warp a motion to a reference, add it to the sums of the reference, and return the cost of the best path.

    Parameters
    ----------
    reference : (K, F).
    motion_by_feature : (F, L), transposed for access in memory order.
    values : (K, F), increased by weight x motion frame for every pair on the best path.
    weights : (K,), increased by 1/n for each of the n reference frames of a motion frame, so by L in all.
    """
    total = _accumulate(reference, motion_by_feature)
    i = len(total) - 1
    for j in range(total.shape[1] - 1, -1, -1):
        last = i  # motion frame j has the reference frames i..last
        while i > 0 and (j == 0 or total[i - 1, j] < min(total[i, j - 1], total[i - 1, j - 1])):
            i -= 1
        share = 1.0 / (last - i + 1)
        for k in range(i, last + 1):
            weights[k] += share
            for f in range(reference.shape[1]):
                values[k, f] += share * motion_by_feature[f, j]
        if i > 0 and total[i - 1, j - 1] <= total[i, j - 1]:
            i -= 1
    found: float = total[-1, -1]
    return found


@kernel(allocates=True)
def warped_costs(costs: FloatArray, bounds: IndexArray) -> FloatArray:
    """Compute the (C,) costs of the best warping of a motion to each of several templates.

    ``costs`` (sum of template lengths, L) are local costs of template and motion frames, ``bounds`` (C + 1,) the starts
    of the templates there. Diagonal steps count twice, and the sum is divided by K + L.
    """
    n_motion = costs.shape[1]
    answer = np.empty(len(bounds) - 1)
    row = np.empty(n_motion)
    for c in range(len(bounds) - 1):
        start, stop = bounds[c], bounds[c + 1]
        row[0] = 2.0 * costs[start, 0]
        for j in range(1, n_motion):
            row[j] = row[j - 1] + costs[start, j]
        for i in range(start + 1, stop):
            diagonal = row[0]
            row[0] += costs[i, 0]
            for j in range(1, n_motion):
                cost = costs[i, j]
                best = min(diagonal + cost, row[j], row[j - 1]) + cost
                diagonal = row[j]
                row[j] = best
        answer[c] = row[n_motion - 1] / (stop - start + n_motion)
    return answer
