"""What a leaf says about a window: weights of every leaf for every category, fitted on windows of joined takes.

The trees are grown on whole clips, and say little of windows that cut an action or hold parts of two. So each leaf gets
a weight for each category, such that the sum over the leaves of a window comes near to how well the window covers an
action of the category: least squares on windows of takes joined from the training clips, the trees unchanged. Source:
"global refinement" of random forests, Ren, Cao, Wei, Sun, CVPR 2015, there with a hinge loss.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray, IndexArray, IntArray
from dousa.errors import TrainingError
from dousa.motion.canonical.joints import JOINT_INDEX
from dousa.retrieval.features.posed_motion import LabelledClip
from dousa.retrieval.takes.windows import TAKE_RATE

BLEND_SECONDS = (0.3, 0.5)
_LEFT_HIP, _RIGHT_HIP = JOINT_INDEX["left_hip"], JOINT_INDEX["right_hip"]
_LEFT_SHOULDER, _RIGHT_SHOULDER = JOINT_INDEX["left_shoulder"], JOINT_INDEX["right_shoulder"]


@dataclass(frozen=True, slots=True)
class Piece:
    """What a take shows from ``start`` to ``stop`` (frames at ``TAKE_RATE``, halves in the middle of a blend)."""

    start: float
    stop: float
    category: str


@dataclass(frozen=True, slots=True, eq=False)
class JoinedTake:
    """A take of known pieces.

    Parameters
    ----------
    positions : (n, 20, 3) m at ``frame_rate``.
    height : m.
    pieces : in the order of time, each beginning where the one before it ends.
    """

    positions: FloatArray
    height: float
    pieces: tuple[Piece, ...]
    frame_rate: float = TAKE_RATE


def join_clips(
    clips: Sequence[LabelledClip], generator: np.random.Generator, *, tempos: Sequence[float] | None = None
) -> JoinedTake:
    """Play clips of one performer one after another.

    Parameters
    ----------
    clips : at least one.
    generator : draws the lengths of the blends, 0.3 to 0.5 s.
    tempos : how much faster than recorded each clip is played; None for as recorded.

    Raises
    ------
    TrainingError : no clip.
    """
    from dousa.retrieval.features.channels import sample_positions

    if not clips:
        raise TrainingError("labeller.no_clips")
    speeds = [1.0] * len(clips) if tempos is None else list(tempos)
    # A clip played at double speed has the poses of a clip of half the frame rate.
    played = [
        sample_positions(clip.positions, clip.frame_rate * speed) / clip.height * clips[0].height
        for clip, speed in zip(clips, speeds, strict=True)
    ]
    parts, edges, length = [played[0]], [0.0], len(played[0])
    for clip in played[1:]:
        count = round(generator.uniform(*BLEND_SECONDS) * TAKE_RATE)
        last = parts[-1][-1]
        following = _go_on(last, clip)
        share = (np.arange(1, count + 1) / (count + 1))[:, None, None]
        ease = share * share * (3.0 - 2.0 * share)
        parts += [last * (1.0 - ease) + following[0] * ease, following]
        edges.append(length + count / 2)
        length += count + len(following)
    edges.append(float(length))
    pieces = tuple(Piece(edges[k], edges[k + 1], clip.category) for k, clip in enumerate(clips))
    return JoinedTake(np.concatenate(parts), clips[0].height, pieces)


def _go_on(last: FloatArray, clip: FloatArray) -> FloatArray:
    """A clip (n, 20, 3) turned about the vertical and moved along the floor to follow a pose (20, 3)."""
    turn = _heading(clip[0]) - _heading(last)
    across, along = np.cos(turn), np.sin(turn)
    moved = clip - clip[0, 0] * (1.0, 0.0, 1.0)
    x, z = moved[..., 0].copy(), moved[..., 2].copy()
    moved[..., 0] = x * across + z * along
    moved[..., 2] = z * across - x * along
    found: FloatArray = moved + last[0] * (1.0, 0.0, 1.0)
    return found


def _heading(pose: FloatArray) -> float:
    """rad, from the line of hips and shoulders: the hips of a person who lies on one side say nothing."""
    line = pose[_LEFT_HIP] - pose[_RIGHT_HIP] + 0.5 * (pose[_LEFT_SHOULDER] - pose[_RIGHT_SHOULDER])
    return float(np.arctan2(line[2], line[0]))


def shuffle_into_takes(
    clips: Sequence[LabelledClip], generator: np.random.Generator, n_clips: int = 12
) -> list[list[int]]:
    """The clips of every performer in a random order, in groups of ``n_clips`` or a few more: indices."""
    groups = []
    performers = sorted({clip.performer or "" for clip in clips})
    for performer in performers:
        own = np.array([k for k, clip in enumerate(clips) if (clip.performer or "") == performer])
        order = generator.permutation(own)
        count = max(1, len(order) // n_clips)
        groups += [group.tolist() for group in np.array_split(order, count)]
    return groups


_RIDGE = 1000.0
_ITERATIONS = 15
_NOTHING = 0.3  # overlap (intersection over union) up to which a window counts as not covering an action


@dataclass(frozen=True, slots=True, eq=False)
class LeafWeights:
    """Weights of leaves.

    Parameters
    ----------
    weights : (leaves, C) float32.
    offset : (C,) float32, the score of a window of which the leaves say nothing.
    """

    weights: NDArray[np.float32]
    offset: NDArray[np.float32]

    def score(self, leaves: NDArray[Any]) -> NDArray[np.float32]:
        """(W, C) how well windows with leaves (W, n_trees) cover an action of each category; about 0 to 1."""
        from dousa.retrieval.takes.window_kernels import score_windows

        scores = np.empty((len(leaves), len(self.offset)), np.float32)
        scores[:] = self.offset
        score_windows(leaves, self.weights, scores)
        return scores


def covered_pieces(starts: IntArray, stops: IntArray, pieces: Sequence[Piece]) -> tuple[IndexArray, FloatArray]:
    """For each window the piece that it covers best, and the intersection over union with it."""
    begins, ends = np.array([piece.start for piece in pieces]), np.array([piece.stop for piece in pieces])
    shared = np.minimum(stops[:, None], ends) - np.maximum(starts[:, None], begins)
    union = np.maximum(stops[:, None], ends) - np.minimum(starts[:, None], begins)
    overlaps = np.maximum(shared, 0.0) / union
    best = overlaps.argmax(axis=1)
    return best, np.take_along_axis(overlaps, best[:, None], axis=1)[:, 0]


def fit_leaf_weights(
    leaves: NDArray[Any], categories: IndexArray, overlaps: FloatArray, n_leaves: int, n_categories: int
) -> LeafWeights:
    """Least squares with a penalty on large weights, by conjugate gradients, all categories at once.

    Parameters
    ----------
    leaves : (W, n_trees) of windows.
    categories : (W,) number of the category that each covers best, -1 for one that is not known.
    overlaps : (W,) how well, intersection over union.
    """
    wanted = np.zeros((len(leaves), n_categories), np.float32)
    known = np.flatnonzero(categories >= 0)
    wanted[known, categories[known]] = np.maximum(overlaps[known] - _NOTHING, 0.0) / (1.0 - _NOTHING)
    offset = wanted.mean(axis=0)
    return LeafWeights(_solve(leaves, wanted - offset, n_leaves), offset)


def _solve(leaves: NDArray[Any], wanted: NDArray[np.float32], n_leaves: int) -> NDArray[np.float32]:
    """(leaves, C) weights w that make |reached w - wanted|^2 + ridge |w|^2 small, reached having ones."""
    from dousa.retrieval.takes.window_kernels import score_windows, spread_to_leaves

    weights = np.zeros((n_leaves, wanted.shape[1]), np.float32)
    residual, back, ahead = np.zeros_like(weights), np.empty_like(weights), np.empty_like(wanted)
    spread_to_leaves(leaves, wanted, residual)
    direction = residual.copy()
    size = np.einsum("lc,lc->c", residual, residual)
    for _ in range(_ITERATIONS):
        ahead[:], back[:] = 0.0, 0.0
        score_windows(leaves, direction, ahead)
        spread_to_leaves(leaves, ahead, back)
        back += _RIDGE * direction
        step = size / np.maximum(np.einsum("lc,lc->c", direction, back), 1e-30)
        weights += step * direction
        residual -= step * back
        smaller = np.einsum("lc,lc->c", residual, residual)
        direction = residual + direction * (smaller / np.maximum(size, 1e-30))
        size = smaller
    return weights.astype(np.float32)
