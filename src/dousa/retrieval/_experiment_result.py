"""What an experiment takes and gives: labelled clips, scores with spread, times, confusions."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa.retrieval.metrics import Confusion, Scores

__all__ = ["ExperimentResult", "FoldResult", "LabelledClip", "SystemResult"]

_SCORES = ("recall", "precision", "f_measure", "accuracy")


@dataclass(frozen=True, slots=True, eq=False)
class LabelledClip:
    """A motion on canonical joints, with what it shows and who performs it.

    Parameters
    ----------
    name : path or other name, for messages.
    category : the label.
    performer : who moves; None where unknown.
    positions : (T, 20, 3) m.
    frame_rate : Hz.
    height : m, of the performer.
    """

    name: str
    category: str
    performer: str | None
    positions: NDArray[np.float64]
    frame_rate: float
    height: float


@dataclass(frozen=True, slots=True)
class FoldResult:
    """One system's scores on the clips of one performer, averaged over the repeats."""

    name: str
    n_train: int
    n_test: int
    scores: Scores


@dataclass(frozen=True, slots=True)
class SystemResult:
    """What one system reached.

    Parameters
    ----------
    scores : means over the repeats.
    spread : standard deviations over the repeats (n - 1); None with one repeat.
    fit_seconds, query_seconds : mean over the repeats, for all folds together.
    query_milliseconds : per test clip, its features being computed already.
    confusions : the most frequent mistakes, counted over all repeats.
    folds : per performer, if performers were left out.
    repeats_that_differ : false for a system without randomness on unchanging splits; its spread is 0 for
        that reason.
    """

    scores: Scores
    spread: Scores | None
    fit_seconds: float
    query_seconds: float
    query_milliseconds: float
    confusions: tuple[Confusion, ...] = ()
    folds: tuple[FoldResult, ...] = ()
    repeats_that_differ: bool = True

    def to_json(self) -> dict[str, Any]:
        """The four scores by name, then everything else."""
        return {
            **asdict(self.scores),
            **{f"{name}_std": self.spread and getattr(self.spread, name) for name in _SCORES},
            "fit_seconds": self.fit_seconds,
            "query_seconds": self.query_seconds,
            "query_milliseconds": self.query_milliseconds,
            "repeats_differ": self.repeats_that_differ,
            "confusions": [asdict(confusion) for confusion in self.confusions],
            "folds": [
                {"name": fold.name, "n_train": fold.n_train, "n_test": fold.n_test, **asdict(fold.scores)}
                for fold in self.folds
            ],
        }


@dataclass(frozen=True, slots=True)
class ExperimentResult:
    """What all systems reached on the same splits.

    Parameters
    ----------
    systems : results by name, in the order they were asked for.
    n_train, n_test : clips that train and clips that are tested in one repeat; with performers left out every
        clip is tested once, and ``n_train`` is the mean over the performers, rounded.
    categories : all categories, sorted.
    split : ``"half"``, ``"leave-performer-out"`` or ``"given"``.
    repeats : how often everything was done.
    random_state : the seed of it all.
    untrained : test clips of categories that had no training clip, by category (with performers left out: in
        that performer's fold); they count as wrong.
    untested : categories that had training clips only.
    feature_seconds : time to compute the forest's features, once for all systems and repeats.
    relational_seconds : the same for the features of motion templates.
    compile_seconds : time to make the kernels ready before anything was timed.
    """

    systems: dict[str, SystemResult]
    n_train: int
    n_test: int
    categories: tuple[str, ...]
    split: str
    repeats: int
    random_state: int
    untrained: dict[str, int] = field(default_factory=dict)
    untested: tuple[str, ...] = ()
    feature_seconds: float = 0.0
    relational_seconds: float = 0.0
    compile_seconds: float = 0.0

    def to_json(self) -> dict[str, Any]:
        """Plain dictionaries, lists, numbers and strings, ready for ``json.dumps``."""
        return {
            "systems": {name: system.to_json() for name, system in self.systems.items()},
            "n_train": self.n_train,
            "n_test": self.n_test,
            "categories": list(self.categories),
            "split": self.split,
            "repeats": self.repeats,
            "random_state": self.random_state,
            "untrained": dict(self.untrained),
            "untested": list(self.untested),
            "feature_seconds": self.feature_seconds,
            "relational_seconds": self.relational_seconds,
            "compile_seconds": self.compile_seconds,
        }
