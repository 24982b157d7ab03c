"""What a person corrects in a take is learned from single examples, at once.

A labeller is fitted on thousands of moments; one more clip among them says next to nothing. So an example corrects what
the labeller would have said of its moments: what is missing is added to the discriminants such that the moments of the
examples come out right, by as little as possible (ridge regression of the residuals). Moments of other categories, kept
since the training, are held fast: what is said of them must not change.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import IntArray
from dousa.retrieval.features.posed_motion import PosedMotion, check_motion
from dousa.retrieval.takes.label import TakeLabeller
from dousa.retrieval.takes.material.disturbances import disturb
from dousa.retrieval.takes.material.made_takes import JoinedTake
from dousa.retrieval.takes.moment_model import Codes, MomentModel
from dousa.retrieval.takes.moments import HOP, describe_moments
from dousa.retrieval.takes.sequence import N_PHASES, PHASE_FRAMES

_RIDGE = 0.2  # how far an example gives way to others and to the moments that are held; a moment is as like itself as 1
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
    shown = [(codes, one.category) for one in examples for codes in _describe(labeller, one.motion)]
    shown = [(codes, name) for codes, name in shown if len(codes) >= _LEAST]
    if not shown:
        return labeller
    new = sorted({name for _, name in shown} - set(labeller.classes))
    classes = (*labeller.classes, *new)
    parts = [np.unique(np.linspace(0, len(codes) - 1, most).astype(np.int64)) for codes, _ in shown]
    states = np.concatenate(
        [_phases(len(codes), classes.index(name))[part] for (codes, name), part in zip(shown, parts, strict=True)]
    )
    taught = {classes.index(name) for _, name in shown}
    held = labeller.held[[state // N_PHASES not in taught for state in labeller.held_states.tolist()]]
    scale, model = labeller.model.scale, _widen(labeller.model, N_PHASES * len(new))
    own = scale.standardise(np.concatenate([codes[part] for (codes, _), part in zip(shown, parts, strict=True)]))
    seen = np.concatenate([scale.standardise(held), own])
    missing = np.zeros((len(seen), model.weights.shape[1]), np.float32)
    missing[len(held) :] = _find_missing(own @ model.weights, states)
    alike = seen @ seen.T / seen.shape[1]
    alike[np.diag_indices(len(seen))] += np.float32(_RIDGE)
    added = seen.T @ np.linalg.solve(alike, missing) * np.float32(1.0 / seen.shape[1])
    lengths = [[float(len(codes) * HOP) for codes, name in shown if name == one] for one in new]
    sequence = labeller.sequence.with_lengths(lengths) if new else labeller.sequence
    model = replace(model, weights=model.weights + added)
    return replace(labeller, classes=classes, sequence=sequence, model=model)


def _widen(model: MomentModel, count: int) -> MomentModel:
    """Room for so many states more before nothing, which are nowhere likely."""
    weights = model.weights
    return replace(model, weights=np.insert(weights, [weights.shape[1] - 1] * count, 0.0, axis=1))


def _describe(labeller: TakeLabeller, motion: PosedMotion) -> list[Codes]:
    """(M, F) bytes of the moments of a part as it is, and of disturbed copies: others do the same otherwise."""
    from dousa.retrieval.features.channels import sample_positions

    generator = np.random.default_rng(0)
    part = JoinedTake(sample_positions(check_motion(motion), motion.frame_rate), motion.height, ())
    copies = [part, *(disturb(part, generator) for _ in range(_COPIES if len(part.positions) > HOP else 0))]
    described = []
    for copy in copies:
        sampled = sample_positions(copy.positions, copy.frame_rate)
        codes = [labeller.model.scale.encode(values) for _, values in describe_moments(sampled, copy.height)]
        described.append(np.concatenate(codes))
    return described


def _phases(n_moments: int, category: int) -> IntArray:
    edge = min(PHASE_FRAMES / HOP, 0.5 * n_moments)
    middles = np.arange(n_moments) + 0.5
    phase: IntArray = N_PHASES * category + 1 - (middles < edge) + (middles >= n_moments - edge)
    return phase


def _find_missing(said: NDArray[np.float32], states: IntArray) -> NDArray[np.float32]:
    """(K, S) what the discriminants (K, S) of moments that show states lack: 1 for its own, 0 for those of others."""
    missing = -said
    # What is said of another phase of its category is no mistake.
    own = states[:, None] // N_PHASES * N_PHASES + np.arange(N_PHASES)
    np.put_along_axis(missing, own, 0.0, axis=1)
    rows = np.arange(len(states))
    missing[rows, states] = 1.0 - np.minimum(said[rows, states], 0.0)
    return missing
