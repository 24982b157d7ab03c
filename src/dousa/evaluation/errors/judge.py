"""The judge: which errors a performance has, learned from errors that were put into the motion of many people.

The trees and the prices are data of the package, written by ``benchmarks/train_judge.py``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import astuple, dataclass
from functools import lru_cache
from importlib import resources

import numpy as np

from dousa.arrays import FloatArray
from dousa.evaluation.errors.boosting import BoostedTrees
from dousa.evaluation.errors.decode import Decoding, Suspect, decode
from dousa.evaluation.errors.descriptors import N_LIMBS, Descriptors

_FILE = "judge.npz"


@dataclass(frozen=True, slots=True, eq=False)
class Judge:
    """What was learned.

    Parameters
    ----------
    limbs, body : say what is likely of a limb and of the body at a moment.
    decoding : how moments become errors.
    """

    limbs: BoostedTrees
    body: BoostedTrees
    decoding: Decoding

    def weigh(self, descriptors: Descriptors, first: int = 0) -> tuple[FloatArray, FloatArray]:
        """(N, 5, 4) and (N, 4) log probabilities of the classes of limbs and body; moments from ``first`` on."""
        limbs, body = descriptors.limbs[first:], descriptors.body[first:]
        of_limbs = self.limbs.predict_log_proba(limbs.reshape(-1, limbs.shape[2]))
        return of_limbs.reshape(len(limbs), N_LIMBS, -1), self.body.predict_log_proba(body)

    def find(self, descriptors: Descriptors, rate: float) -> list[Suspect]:
        """Errors in moments, of which there are ``rate`` a second."""
        return decode(*self.weigh(descriptors), rate, self.decoding)

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
    """The judge of the package, or the one given to `use_judge`."""
    return _chosen[-1] if _chosen else _read_judge()


def use_judge(judge: Judge | None) -> None:
    """Let another judge decide in this process, for trials; None for the package's own."""
    _chosen[:] = [] if judge is None else [judge]


@lru_cache(maxsize=1)
def _read_judge() -> Judge:
    source = resources.files("dousa.evaluation.errors").joinpath(_FILE)
    with source.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
        return Judge.from_arrays(arrays)
