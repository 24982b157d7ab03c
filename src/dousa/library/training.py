"""Training: one forest over all labelled clips, leaves for every clip, and windows for every take."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import sqlalchemy as sa

from dousa.errors import TrainingError
from dousa.library import schema
from dousa.library._engine import reading, writing
from dousa.library._features import ClipFeatures, load_features, save_descriptions
from dousa.library._forests import StoredForest, ask_trees, fit_grid, replace_forest, save_answers
from dousa.library._revision import next_revision, note_changed_clips, read_revision
from dousa.library._take_windows import describe_takes, save_windows
from dousa.library.reports import TrainReport
from dousa.retrieval import MotionForest
from dousa.retrieval.calibration import Assessor, guess_performers, learn_calibration
from dousa.retrieval.feature_sets import FeatureSet, get_feature_set

__all__ = ["train_forest"]

TrainProgress = Callable[[int, int, str], None]

_STEPS = 5
_MOST_HELD_BACK = 3000  # clips that the rounds of a calibration use: enough for two curves


def train_forest(
    engine: sa.Engine,
    where: str,
    forest: MotionForest,
    feature_set: str,
    n_jobs: int | None = None,
    progress: TrainProgress | None = None,
) -> tuple[StoredForest, TrainReport]:
    """Fit a forest to the clips of a library and store it with all that it says, in one transaction.

    Parameters
    ----------
    engine, where : the library and its name for messages.
    forest : not yet fitted.
    feature_set : name of the features that it asks for; those that are not stored are computed.
    n_jobs : clips and takes described at a time.
    progress : called with (steps done, steps, what comes now).

    Raises
    ------
    TrainingError : fewer than two categories.
    OptionError : no such set of features.
    """
    start = time.perf_counter()
    report = progress or (lambda done, total, what: None)
    kind = get_feature_set(feature_set)
    report(0, _STEPS, "describing clips")

    def tell(what: str, step: int) -> Callable[[int, int], None]:
        return lambda done, total: report(step, _STEPS, f"describing {what} ({done} of {total})")

    with reading(engine, where) as connection:
        seen = read_revision(connection)
        _check_categories(where, _read_categories(connection))  # before the work
        clips = load_features(connection, feature_set, n_jobs=n_jobs, progress=tell("clips", 0))
        grid = fit_grid(connection)
    labelled, counts = _check_categories(where, clips.categories)
    report(1, _STEPS, "growing trees")
    categories = np.array([clips.categories[row] for row in labelled], dtype=np.str_)
    forest.fit(clips.features[labelled], categories, feature_set=kind)
    report(2, _STEPS, "learning what is unknown")
    assessor = _learn_unknown(forest, clips, labelled, kind)
    names = tuple(str(name) for name in forest.classes_)
    stored = StoredForest(forest, names, feature_set, grid, assessor, 0, 0)
    report(3, _STEPS, "describing takes")
    with reading(engine, where) as connection:
        windows = describe_takes(connection, stored, n_jobs=n_jobs, progress=tell("takes", 3))
    report(4, _STEPS, "writing")
    stored = _store(engine, where, stored, seen, clips, windows, len(labelled))
    report(_STEPS, _STEPS, "done")
    done = TrainReport(
        feature_set=feature_set,
        n_trees=int(forest.get_params()["n_trees"]),
        n_clips=len(labelled),
        n_unlabelled=len(clips.categories) - len(labelled),
        categories=counts,
        calibration=None if assessor is None else assessor.calibration,
        single=tuple(name for name, count in counts.items() if count == 1),
        seconds=time.perf_counter() - start,
    )
    return stored, done


def _learn_unknown(
    forest: MotionForest, clips: ClipFeatures, labelled: Sequence[int], kind: FeatureSet
) -> Assessor | None:
    """Tell known motions from unknown ones; None where there are too few clips or categories to learn that."""
    step = -(-len(labelled) // _MOST_HELD_BACK)
    order = sorted(labelled, key=lambda row: str(clips.categories[row]))
    rows = order[::step]  # every n-th clip of every category
    people = guess_performers([clips.heights[row] for row in rows])
    try:
        calibration = learn_calibration(
            forest,
            clips.features[rows],
            np.array([clips.categories[row] for row in rows], dtype=np.str_),
            [clips.performers[row] or guess for row, guess in zip(rows, people, strict=True)],
            feature_set=kind,
        )
    except TrainingError:
        return None
    return Assessor(forest, calibration)


def _store(
    engine: sa.Engine,
    where: str,
    stored: StoredForest,
    seen: int,
    clips: ClipFeatures,
    windows: dict[int, bytes],
    n_clips: int,
) -> StoredForest:
    """Write the forest, and what it says of clips and takes."""
    answers = ask_trees(stored, clips.features)
    with writing(engine, where) as connection:
        revision = next_revision(connection)
        stored = stored.with_revision(revision)
        if revision != seen + 1:
            # Another program added or removed clips while the trees grew.
            clips = load_features(connection, stored.feature_set)
            windows = describe_takes(connection, stored, known=windows)
            answers = ask_trees(stored, clips.features)
            next_revision(connection)
            note_changed_clips(connection)  # the forest has not learned from what they did: it is not current
        replace_forest(connection, stored, _plain_parameters(stored.forest), n_clips)
        save_descriptions(connection, list(clips.computed), list(clips.computed.values()))
        connection.execute(sa.delete(schema.clip_leaves))
        save_answers(connection, clips.ids, answers)
        connection.execute(sa.delete(schema.take_windows))
        save_windows(connection, stored, windows)
    return stored


def _read_categories(connection: sa.Connection) -> list[str | None]:
    table = schema.clips.c
    return list(connection.execute(sa.select(table.category).where(table.kind == schema.CLIP)).scalars())


def _check_categories(where: str, categories: Sequence[str | None]) -> tuple[list[int], dict[str, int]]:
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
