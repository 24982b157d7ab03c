"""What a person corrects in a take is learned from single examples, at once.

A labeller is fitted on thousands of moments; one more clip among them says next to nothing. So an example corrects what
the labeller would have said of its moments: what is missing is spread over other moments by the share of the trees in
which they reach the same leaves (ridge regression of the residuals, shared leaves as kernel), such that the moments of
the examples come out right. Moments of other categories, kept since the training, are held fast: what is said of them
must not change.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray, IntArray
from dousa.retrieval.features.posed_motion import PosedMotion, check_motion
from dousa.retrieval.takes.label import TakeLabeller, Taught
from dousa.retrieval.takes.made_takes import JoinedTake, disturb
from dousa.retrieval.takes.moments import HOP, describe_moments
from dousa.retrieval.takes.sequence import N_PHASES, PHASE_FRAMES

_RIDGE = 0.2  # how far an example gives way to others and to the moments that are held, as a share of all trees
_OTHERS = 1.6  # other people share fewer leaves with an example than its disturbed copies do
_MOST_TAUGHT = 1500  # moments of all examples together
_COPIES = 5  # disturbed ones of an example
_LEAST = 3  # moments of an example that teaches something


@dataclass(frozen=True, slots=True, eq=False)
class Example:
    """A part of a recording that shows one category.

    Parameters
    ----------
    motion : the part alone.
    category : what it shows.
    """

    motion: PosedMotion
    category: str


def teach_labeller(labeller: TakeLabeller, examples: Sequence[Example]) -> TakeLabeller:
    """A labeller that knows examples too.

    Parameters
    ----------
    labeller : that no example has taught.
    examples : of categories old or new. One of less than half a second teaches nothing.

    Returns
    -------
    A new labeller with the same calibration; new categories come last.

    Raises
    ------
    InvalidMotionError : another shape than (n, 20, 3), positions that are not finite, no body height.
    """
    most = max(_MOST_TAUGHT // max(len(examples) * (_COPIES + 1), 1), _LEAST)
    shown = [(leaves, one.category) for one in examples for leaves in _reach(labeller, one.motion)]
    shown = [(leaves, name) for leaves, name in shown if len(leaves) >= _LEAST]
    if not shown:
        return labeller
    new = sorted({name for _, name in shown} - set(labeller.classes))
    classes = (*labeller.classes, *new)
    parts = [np.unique(np.linspace(0, len(leaves) - 1, most).astype(np.int64)) for leaves, _ in shown]
    phases = [
        _phases(len(leaves), classes.index(name))[part] for (leaves, name), part in zip(shown, parts, strict=True)
    ]
    taught = {classes.index(name) for _, name in shown}
    held = labeller.held[[state // N_PHASES not in taught for state in labeller.held_states.tolist()]]
    leaves = np.concatenate([held, *(leaves[part] for (leaves, _), part in zip(shown, parts, strict=True))])
    missing = _find_missing(labeller, leaves, len(classes), np.concatenate(phases))
    shared = _count_shared(leaves)
    shared[np.diag_indices(len(leaves))] += _RIDGE
    additions = (_OTHERS * np.linalg.solve(shared, missing)).astype(np.float32)
    lengths = [[float(len(leaves) * HOP) for leaves, name in shown if name == one] for one in new]
    sequence = labeller.sequence.with_lengths(lengths) if new else labeller.sequence
    return replace(labeller, classes=classes, sequence=sequence, taught=Taught(leaves, additions))


def _reach(labeller: TakeLabeller, motion: PosedMotion) -> list[NDArray[np.int32]]:
    """(M, n_trees) leaves of the moments of a part as it is, and of disturbed copies: others do the same otherwise."""
    from dousa.retrieval.features.channels import sample_positions

    generator = np.random.default_rng(0)
    part = JoinedTake(sample_positions(check_motion(motion), motion.frame_rate), motion.height, ())
    copies = [part, *(disturb(part, generator) for _ in range(_COPIES if len(part.positions) > HOP else 0))]
    scale, reached = labeller.forest.scale, []
    for copy in copies:
        sampled = sample_positions(copy.positions, copy.frame_rate)
        codes = [scale.encode(values) for _, values in describe_moments(sampled, copy.height)]
        reached.append(labeller.forest.apply(np.concatenate(codes)))
    return reached


def _phases(n_moments: int, category: int) -> IntArray:
    edge = min(PHASE_FRAMES / HOP, 0.5 * n_moments)
    middles = np.arange(n_moments) + 0.5
    phase: IntArray = N_PHASES * category + 1 - (middles < edge) + (middles >= n_moments - edge)
    return phase


def _find_missing(labeller: TakeLabeller, leaves: NDArray[np.int32], n_categories: int, phases: IntArray) -> FloatArray:
    """(K, 3 C + 1) what the last moments, which show phases, lack of them; nothing is wrong with those before."""
    said = labeller.judge_leaves(leaves[len(leaves) - len(phases) :])
    wanted = np.zeros((len(phases), N_PHASES * n_categories + 1))
    wanted[:, : said.shape[1] - 1] -= said[:, :-1]
    wanted[:, -1] -= said[:, -1]
    # What trees that have seen the very example say of its category is no sign that they know others like it.
    own = phases[:, None] // N_PHASES * N_PHASES + np.arange(N_PHASES)
    np.put_along_axis(wanted, own, 0.0, axis=1)
    wanted[np.arange(len(phases)), phases] = 1.0
    missing = np.zeros((len(leaves), wanted.shape[1]))
    missing[len(leaves) - len(phases) :] = wanted
    return missing


def _count_shared(leaves: NDArray[np.int32]) -> FloatArray:
    """(K, K) shares of the trees in which two moments reach the same leaf."""
    from dousa.retrieval.takes.window_kernels import compare_leaves

    shared = np.empty((len(leaves), len(leaves)))
    for row, own in zip(shared, leaves, strict=True):
        compare_leaves(leaves, own, row)
    return shared
