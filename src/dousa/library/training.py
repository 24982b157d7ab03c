"""Training: one forest over all labelled clips, and a histogram for every clip."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np
import sqlalchemy as sa

from dousa.errors import TrainingError
from dousa.library import schema
from dousa.library._engine import reading, writing
from dousa.library._forests import StoredForest, ask_trees, load_features, save_answers, save_forest
from dousa.library._revision import next_revision, read_revision
from dousa.library.reports import TrainReport
from dousa.retrieval import MotionForest

__all__ = ["train_forest"]

TrainProgress = Callable[[int, int, str], None]


def train_forest(
    engine: sa.Engine, where: str, forest: MotionForest, progress: TrainProgress | None = None
) -> tuple[StoredForest, TrainReport]:
    """Fit a forest to the clips of a library and store it with all histograms, in one transaction.

    Parameters
    ----------
    engine, where : the library and its name for messages.
    forest : not yet fitted.
    progress : called with (steps done, steps, what comes now).

    Raises
    ------
    TrainingError : fewer than two categories.
    """
    start = time.perf_counter()
    report = progress or (lambda done, total, what: None)
    report(0, 3, "reading features")
    with reading(engine, where) as connection:
        seen = read_revision(connection)
        ids, features, categories = load_features(connection)
    labelled, counts = _check_categories(where, categories)
    report(1, 3, "growing trees")
    forest.fit(features[labelled], np.array([categories[index] for index in labelled], dtype=np.str_))
    names = tuple(str(name) for name in forest.classes_)
    report(2, 3, "writing histograms")
    answers = ask_trees(StoredForest(forest, 0, names), features)
    with writing(engine, where) as connection:
        revision = next_revision(connection)
        stored = StoredForest(forest, revision, names)
        if revision != seen + 1:
            # Another program added or removed clips while the trees grew.
            ids, features, _ = load_features(connection)
            answers = ask_trees(stored, features)
            next_revision(connection)  # the forest has not learned from what they did: it is not current
        save_forest(connection, stored, _plain_parameters(forest), len(labelled))
        connection.execute(sa.delete(schema.clip_histograms))
        save_answers(connection, ids, answers)
    report(3, 3, "done")
    done = TrainReport(
        n_trees=int(forest.get_params()["n_trees"]),
        n_clips=len(labelled),
        n_unlabelled=len(categories) - len(labelled),
        categories=counts,
        single=tuple(name for name, count in counts.items() if count == 1),
        seconds=time.perf_counter() - start,
    )
    return stored, done


def _check_categories(where: str, categories: list[str | None]) -> tuple[list[int], dict[str, int]]:
    labelled = [index for index, category in enumerate(categories) if category is not None]
    counts = dict(sorted(Counter(name for name in categories if name is not None).items()))
    if len(counts) < 2:
        found = f"one category ('{next(iter(counts))}')" if counts else "no category"
        raise TrainingError(
            f"{where}: expected clips of two categories or more, found {len(categories)} clips of {found}; "
            "add more, or give categories with: dousa relabel"
        )
    return labelled, counts


def _plain_parameters(forest: MotionForest) -> dict[str, Any]:
    """The parameters that make the forest what it is."""
    return {name: value for name, value in forest.get_params().items() if name != "n_jobs"}
