"""The learned judge: boosted trees give the probability of each error at each moment, decoding makes errors of them.

Trees and prices are data of the package, written by ``lab/training/train_judge.py``, which puts errors into the motion
of many people.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import astuple, dataclass, replace
from functools import lru_cache
from importlib import resources

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dousa.arrays import FloatArray
from dousa.evaluation.alignment.dynamic_programming import follow_classes
from dousa.evaluation.errors.descriptors import N_LIMBS, Descriptors
from dousa.evaluation.posture.posture import LIMBS
from dousa.kernels import kernel
from dousa.motion.runs import find_equal_runs


@dataclass(frozen=True, slots=True, eq=False)
class BoostedTrees:
    """Trees whose leaves add up to the logits of classes."""

    feature: NDArray[np.uint16]  # (N,) uint16, of each node; of a leaf unused
    threshold: NDArray[np.float32]  # (N,) float32; a value at most this goes left; of a leaf its value
    left: NDArray[np.int32]  # (N,) child; -1 of a leaf
    right: NDArray[np.int32]  # (N,) child; -1 of a leaf
    roots: NDArray[np.int32]  # (R, C) int32, first node of each round's tree for each class
    start: FloatArray  # (C,) logits before the first tree

    def predict_log_proba(self, features: ArrayLike, *, block: int = 128) -> FloatArray:
        """(N, C) logarithms of the probabilities of the classes, of features (N, F)."""
        rows = np.ascontiguousarray(features, np.float32)
        logits = np.tile(self.start, (len(rows), 1))
        _add_up(rows, self.feature, self.threshold, self.left, self.right, self.roots, block, logits)
        most = logits.max(axis=1, keepdims=True)
        found: FloatArray = logits - most - np.log(np.exp(logits - most).sum(axis=1, keepdims=True))
        return found

    def to_arrays(self, prefix: str) -> dict[str, np.ndarray]:
        """The arrays by name, for a file."""
        return {f"{prefix}_{name}": getattr(self, name) for name in _ARRAYS}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, np.ndarray], prefix: str) -> BoostedTrees:
        """The trees whose ``to_arrays(prefix)`` these are."""
        return cls(**{name: np.ascontiguousarray(arrays[f"{prefix}_{name}"]) for name in _ARRAYS})


_ARRAYS = ("feature", "threshold", "left", "right", "roots", "start")


@kernel
def _add_up(
    rows: NDArray[np.float32],
    feature: NDArray[np.uint16],
    threshold: NDArray[np.float32],
    left: NDArray[np.int32],
    right: NDArray[np.int32],
    roots: NDArray[np.int32],
    block: int,
    logits: FloatArray,
) -> None:  # pragma: no cover - compiled
    """Add the leaf of every tree to logits (N, C): a tree for a block of rows, as both stay in the nearest cache."""
    for first in range(0, len(rows), block):
        last = min(first + block, len(rows))
        for turn in range(len(roots)):
            for c in range(roots.shape[1]):
                root = roots[turn, c]
                for i in range(first, last):
                    node = root
                    while left[node] >= 0:
                        node = left[node] if rows[i, feature[node]] <= threshold[node] else right[node]
                    logits[i, c] += threshold[node]


LIMB_CLASSES = ("ok", "shift", "incomplete", "partial")
BODY_CLASSES = ("ok", "shift", "incomplete", "global")
_EITHER = "either"  # incomplete or partial
_LIMB_SEGMENTS = tuple(LIMBS.values())


@dataclass(frozen=True, slots=True)
class Decoding:
    """How moments become errors; chosen on trials."""

    change: float = 3.0  # price of beginning or ending an error, nats
    # what speaks for an error of the class at every moment, nats
    shift: float = 0.0
    incomplete: float = 0.0  # of the body
    limb: float = 0.0  # incomplete or partial
    whole: float = 0.0  # global
    shortest_s: float = 0.25  # a shorter error is none
    surest: float = 0.5  # mean log odds against "ok" that an error must have, nats


@dataclass(frozen=True, slots=True)
class Suspect:
    """An error in moments."""

    kind: str  # class
    start: int  # moment
    end: int  # the moment after the last
    limbs: tuple[int, ...]  # numbers; all for an error of the body
    surety: float  # mean log odds against none, nats

    @property
    def segments(self) -> tuple[int, ...]:
        """Numbers of the segments."""
        return tuple(s for limb in self.limbs for s in _LIMB_SEGMENTS[limb])


def decode(limbs: FloatArray, body: FloatArray, rate: float, how: Decoding) -> list[Suspect]:
    """Decode probabilities of moments to errors, in order of time.

    Parameters
    ----------
    limbs : (N, 5, 4) log probabilities of `LIMB_CLASSES`.
    body : (N, 4) of `BODY_CLASSES`.
    rate : moments a second.
    how : prices.
    """
    found = _find_runs(body, BODY_CLASSES, tuple(range(limbs.shape[1])), rate, how)
    # Whether a limb is short or elsewhere shows in the whole stretch, not at a moment.
    either = np.concatenate([limbs[..., :2], np.logaddexp(limbs[..., 2:3], limbs[..., 3:])], axis=2)
    by_limb = [
        _name_class(suspect, limbs[:, limb])
        for limb in range(limbs.shape[1])
        for suspect in _find_runs(either[:, limb], (*LIMB_CLASSES[:2], _EITHER), (limb,), rate, how)
    ]
    by_limb = [suspect for suspect in by_limb if not _is_of(suspect, found)]
    return sorted([*found, *_join_limbs(by_limb)], key=lambda one: (one.start, one.end))


def _name_class(suspect: Suspect, logs: FloatArray) -> Suspect:
    """The suspect of a limb with the likelier of both classes, by log probabilities (N, 4) of all moments together."""
    if suspect.kind != _EITHER:
        return suspect
    of_both = logs[suspect.start : suspect.end, 2:].sum(axis=0)
    return replace(suspect, kind=LIMB_CLASSES[2 + int(of_both.argmax())])


def _find_runs(
    logs: FloatArray, names: Sequence[str], limbs: tuple[int, ...], rate: float, how: Decoding
) -> list[Suspect]:
    scores = logs.copy()
    scores[:, 1:] += [how.shift, how.limb] if _EITHER in names else [how.shift, how.incomplete, how.whole]
    classes = follow_classes(scores * (15.0 / rate), how.change)
    found = []
    for start, end in find_equal_runs(classes).tolist():
        name = names[classes[start]]
        if name == "ok" or end - start < how.shortest_s * rate:
            continue
        odds = scores[start:end, classes[start]] - scores[start:end, 0]
        if odds.mean() >= how.surest:
            found.append(Suspect(name, start, end, limbs, float(odds.mean())))
    return found


def _is_of(suspect: Suspect, body: Sequence[Suspect]) -> bool:
    """Whether an error of the body covers this one of a limb."""
    for other in body:
        shared = min(suspect.end, other.end) - max(suspect.start, other.start)
        if shared <= 0.5 * (suspect.end - suspect.start):
            continue
        if other.kind in ("global", suspect.kind):
            return True
        if other.kind == "incomplete" and suspect.kind != "shift":
            return True
    return False


def _join_limbs(suspects: Sequence[Suspect]) -> list[Suspect]:
    """Limbs that do the same at the same time are one error."""
    joined: list[Suspect] = []
    for one in sorted(suspects, key=lambda suspect: (suspect.kind, suspect.start)):
        for place, other in enumerate(joined):
            shared = min(one.end, other.end) - max(one.start, other.start)
            either = max(one.end, other.end) - min(one.start, other.start)
            if other.kind == one.kind and shared > 0.5 * either and not set(one.limbs) & set(other.limbs):
                limbs = tuple(sorted({*other.limbs, *one.limbs}))
                surety = max(one.surety, other.surety)
                joined[place] = Suspect(one.kind, min(one.start, other.start), max(one.end, other.end), limbs, surety)
                break
        else:
            joined.append(one)
    return joined


_FILE = "judge.npz"


@dataclass(frozen=True, slots=True, eq=False)
class Judge:
    """What was learned."""

    limbs: BoostedTrees  # classes of a limb at a moment
    body: BoostedTrees  # classes of the whole body at a moment
    decoding: Decoding  # how moments become errors

    def weigh(self, descriptors: Descriptors, first: int = 0) -> tuple[FloatArray, FloatArray]:
        """(N, 5, 4) and (N, 4) log probabilities of the classes of limbs and body; moments from ``first`` on."""
        limbs, body = descriptors.limbs[first:], descriptors.body[first:]
        of_limbs = self.limbs.predict_log_proba(limbs.reshape(-1, limbs.shape[2]))
        return of_limbs.reshape(len(limbs), N_LIMBS, -1), self.body.predict_log_proba(body)

    def find(self, descriptors: Iterable[Descriptors], rate: float) -> list[Suspect]:
        """Find errors in moments, of which there are ``rate`` a second; they come some at a time."""
        limbs, body = (np.concatenate(logs) for logs in zip(*map(self.weigh, descriptors), strict=True))
        return decode(limbs, body, rate, self.decoding)

    def to_arrays(self) -> dict[str, np.ndarray]:
        """Arrays by name, for a file."""
        prices = np.array(astuple(self.decoding), np.float64)
        return {**self.limbs.to_arrays("limbs"), **self.body.to_arrays("body"), "decoding": prices}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, np.ndarray]) -> Judge:
        """The judge whose ``to_arrays()`` these are."""
        limbs, body = (BoostedTrees.from_arrays(arrays, name) for name in ("limbs", "body"))
        return cls(limbs, body, Decoding(*(float(value) for value in arrays["decoding"])))


_chosen: list[Judge] = []


def load_judge() -> Judge:
    """Load the judge of the package, or the one given to `use_judge`."""
    return _chosen[-1] if _chosen else _read_judge()


def use_judge(judge: Judge | None) -> None:
    """Let another judge decide in this process, for trials; None for the package's own."""
    _chosen[:] = [] if judge is None else [judge]


@lru_cache(maxsize=1)
def _read_judge() -> Judge:
    source = resources.files("dousa.evaluation.errors").joinpath(_FILE)
    with source.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
        return Judge.from_arrays(arrays)
