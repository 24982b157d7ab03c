"""The paper's experiment: how well four systems tell the categories of clips they have not seen.

``full_tree`` one tree that tries every test at every node, without randomness; ``random_tree`` one tree of
the forest; ``forest`` all of them; ``motion_templates`` the method the paper compares itself with. Source:
Hamada, Kuriyama, Mukai, "Human motion retrieval using random forest", section 4, figures 4 and 5.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa.errors import OptionError, TrainingError
from dousa.retrieval._experiment_progress import Progress, Reporter
from dousa.retrieval._experiment_result import ExperimentResult, FoldResult, LabelledClip, SystemResult
from dousa.retrieval.feature_sets import FeatureSet, get_feature_set
from dousa.retrieval.metrics import Scores, compute_scores, list_confusions
from dousa.retrieval.splits import Split, leave_performer_out, split_half

__all__ = [
    "SPLITS",
    "SYSTEMS",
    "ExperimentResult",
    "FoldResult",
    "LabelledClip",
    "SystemResult",
    "run_experiment",
]

SYSTEMS: tuple[str, ...] = ("full_tree", "random_tree", "forest", "motion_templates")
SPLITS: tuple[str, ...] = ("half", "leave-performer-out")

_WITHOUT_RANDOMNESS = ("full_tree", "motion_templates")
_LISTED_CONFUSIONS = 20


def run_experiment(
    clips: Sequence[LabelledClip],
    *,
    test_clips: Sequence[LabelledClip] | None = None,
    split: str | None = None,
    train_share: float = 0.5,
    repeats: int = 1,
    random_state: int = 0,
    systems: Sequence[str] = SYSTEMS,
    n_trees: int = 100,
    feature_set: str = "paper",
    samples_per_frame: int = 8,
    sampling_rate: float = 30.0,
    template_threshold: float = 0.1,
    n_jobs: int | None = None,
    progress: Progress | None = None,
) -> ExperimentResult:
    """Train and test the systems on the same splits.

    Parameters
    ----------
    clips : all clips, or those that train if ``test_clips`` is given.
    test_clips : clips to test on; nothing is split then.
    split : ``"half"`` (default: half of every category trains, drawn anew in each repeat) or
        ``"leave-performer-out"`` (the predictions of all folds are pooled before they are scored).
    train_share : of every category, with ``"half"``.
    repeats : how often, 1 or more.
    random_state : seed; the same seed gives the same scores.
    systems : which, of ``SYSTEMS``.
    n_trees : trees of the forest.
    feature_set : what the trees look at and how they grow, a name of ``FEATURE_SETS``.
    samples_per_frame : how clips are thinned for the ``paper`` features, see ``compute_clip_features``.
    sampling_rate, template_threshold : of motion templates (Hz; share of the motions, see there). 0.1 is the
        publication's; on real recordings 0.3 was better.
    n_jobs : threads; None for one.
    progress : called with the number of trainings done, their total, and what comes next.

    Returns
    -------
    ExperimentResult.

    Raises
    ------
    TrainingError : no clips, a clip without category, fewer than two categories to train, nothing to test, or
        an unknown performer where performers are left out.
    OptionError : an unknown split or system, or a number outside its range.
    """
    _check_options(split, test_clips is not None, systems)
    if repeats < 1 or random_state < 0:
        raise OptionError(
            f"expected 1 repeat or more and a seed of 0 or more, got {repeats} and {random_state}"
        )
    features_of = get_feature_set(feature_set)
    tested = list(clips) + list(test_clips or ())
    _check_clips(clips, test_clips)
    split = "given" if test_clips is not None else split or "half"
    rounds = _make_rounds(clips, tested, split, (repeats, random_state, train_share))
    material = _describe(
        tested,
        systems,
        features_of,
        samples_per_frame=samples_per_frame,
        sampling_rate=sampling_rate,
        progress=progress,
    )
    workers = _Workers(features_of, n_trees, sampling_rate, template_threshold, n_jobs)
    compile_seconds = workers.warm_up(systems)
    report = Reporter(progress, len(systems) * sum(len(folds) for folds in rounds))
    results = {
        system: _run_system(
            workers,
            system,
            material,
            rounds,
            redrawn=split == "half",
            random_state=random_state,
            report=report,
        )
        for system in systems
    }
    report("done")
    untrained, untested = _gaps(material.categories, rounds)
    first = rounds[0]
    return ExperimentResult(
        systems=results,
        n_train=round(float(np.mean([len(fold.train) for fold in first]))),
        n_test=sum(len(fold.test) for fold in first),
        categories=tuple(sorted(set(material.categories))),
        split=split,
        repeats=repeats,
        random_state=random_state,
        untrained=untrained,
        untested=untested,
        feature_seconds=material.feature_seconds,
        relational_seconds=material.relational_seconds,
        compile_seconds=compile_seconds,
    )


@dataclass(frozen=True, slots=True)
class _Material:
    """The clips as the systems see them, computed once."""

    categories: NDArray[Any]  # (N,) str objects
    features: NDArray[np.float64]  # (N, T, F)
    sequences: list[NDArray[np.bool_]]  # N of (T_i, 39)
    feature_seconds: float
    relational_seconds: float


@dataclass(frozen=True, slots=True)
class _Trial:
    """One system's predictions in one repeat, fold by fold."""

    folds: tuple[Split, ...]
    predicted: list[NDArray[Any]]
    fit_seconds: float
    query_seconds: float


class _Workers:
    """Makes and times the systems."""

    def __init__(
        self,
        feature_set: FeatureSet,
        n_trees: int,
        sampling_rate: float,
        threshold: float,
        n_jobs: int | None,
    ) -> None:
        self.feature_set, self.n_trees, self.n_jobs = feature_set, n_trees, n_jobs
        self.sampling_rate, self.threshold = sampling_rate, threshold

    def train_and_predict(
        self, system: str, material: _Material, fold: Split, seed: int
    ) -> tuple[NDArray[Any], float, float]:
        """Predictions for the fold's test clips, seconds to fit, seconds to predict."""
        started = time.perf_counter()
        labels = material.categories[fold.train].astype(str)
        if system == "motion_templates":
            from dousa.retrieval.templates import MotionTemplates

            templates = MotionTemplates(self.sampling_rate, self.threshold, n_jobs=self.n_jobs)
            templates.fit_sequences([material.sequences[k] for k in fold.train], labels)
            fitted = time.perf_counter()
            predicted = templates.predict_sequences([material.sequences[k] for k in fold.test])
        else:
            forest = self._forest(system, seed)
            forest.fit(material.features[fold.train], labels, feature_set=self.feature_set)
            fitted = time.perf_counter()
            predicted = forest.predict(material.features[fold.test])
        return np.asarray(predicted).astype(object), fitted - started, time.perf_counter() - fitted

    def _forest(self, system: str, seed: int) -> Any:
        from dousa.retrieval.forest import MotionForest

        if system == "full_tree":
            return MotionForest(n_trees=1, n_trials="all", random_state=seed, n_jobs=self.n_jobs)
        return MotionForest(
            n_trees=1 if system == "random_tree" else self.n_trees,
            n_trials=self.feature_set.n_trials,
            thresholds=self.feature_set.thresholds,
            random_state=seed,
            n_jobs=self.n_jobs,
        )

    def warm_up(self, systems: Sequence[str]) -> float:
        """Compile the kernels on a toy, so that the first system's time is not the compiler's; seconds."""
        started = time.perf_counter()
        generator = np.random.default_rng(0)
        toy = _Material(
            categories=np.array(["a", "a", "b", "b"], dtype=object),
            features=generator.random((4, self.feature_set.n_frames, self.feature_set.n_columns)),
            sequences=[generator.random((3, 39)) > 0.5 for _ in range(4)],
            feature_seconds=0.0,
            relational_seconds=0.0,
        )
        everything = np.arange(4)
        for system in systems:
            self.train_and_predict(system, toy, Split(everything, everything), 0)
        return time.perf_counter() - started


def _check_options(split: str | None, test_given: bool, systems: Sequence[str]) -> None:
    if split is not None and split not in SPLITS:
        raise OptionError(f"split: expected {' or '.join(SPLITS)}, got '{split}'")
    if split == "leave-performer-out" and test_given:
        raise OptionError("test clips were given, so no performer can be left out; give one or the other")
    unknown = [system for system in systems if system not in SYSTEMS]
    if unknown or not systems:
        raise OptionError(
            f"systems: expected some of {', '.join(SYSTEMS)}, got {', '.join(unknown) or 'none'}"
        )


def _check_clips(clips: Sequence[LabelledClip], test_clips: Sequence[LabelledClip] | None) -> None:
    if not clips:
        raise TrainingError("expected clips to train on, got none")
    if test_clips is not None and not test_clips:
        raise TrainingError("expected clips to test on, got none")
    for clip in [*clips, *(test_clips or ())]:
        if not clip.category:
            raise TrainingError(f"{clip.name}: expected a category, the clip has none")
    found = sorted({clip.category for clip in clips})
    if len(found) < 2:
        raise TrainingError(
            f"expected at least two categories to train on, all {len(clips)} clips are '{found[0]}'; "
            "is the category taken from the right place (--category-from)?"
        )


def _make_rounds(
    clips: Sequence[LabelledClip],
    tested: Sequence[LabelledClip],
    split: str,
    draws: tuple[int, int, float],
) -> list[tuple[Split, ...]]:
    """The folds of every repeat; ``draws`` are the repeats, the seed and the share that trains."""
    repeats, random_state, share = draws
    if split == "given":
        given = Split(np.arange(len(clips)), np.arange(len(clips), len(tested)))
        return [(given,)] * repeats
    if split == "leave-performer-out":
        folds = leave_performer_out([clip.performer for clip in clips])
        for fold in folds:
            left = {clips[k].category for k in fold.train}
            if len(left) < 2:
                raise TrainingError(
                    f"without performer '{fold.name}' only the category '{min(left)}' is left to train on; "
                    "expected at least two"
                )
        return [folds] * repeats
    labels = [clip.category for clip in clips]
    generators = (np.random.default_rng([random_state, repeat]) for repeat in range(repeats))
    return [(split_half(labels, generator, share),) for generator in generators]


def _describe(
    clips: Sequence[LabelledClip],
    systems: Sequence[str],
    feature_set: FeatureSet,
    *,
    samples_per_frame: int,
    sampling_rate: float,
    progress: Progress | None,
) -> _Material:
    """Compute what the asked systems look at, once for all repeats."""
    features, sequences = np.empty((len(clips), feature_set.n_frames, 0)), []
    started = time.perf_counter()
    if set(systems) - {"motion_templates"}:
        if progress is not None:
            progress(0, 0, "pose features")
        features = np.stack([feature_set.compute(clip, samples_per_frame) for clip in clips])
    between = time.perf_counter()
    if "motion_templates" in systems:
        from dousa.retrieval.templates import compute_relational_sequence

        if progress is not None:
            progress(0, 0, "relational features")
        sequences = [compute_relational_sequence(clip, sampling_rate) for clip in clips]
    ended = time.perf_counter()
    categories = np.array([clip.category for clip in clips], dtype=object)
    return _Material(categories, features, sequences, between - started, ended - between)


def _run_system(
    workers: _Workers,
    system: str,
    material: _Material,
    rounds: list[tuple[Split, ...]],
    *,
    redrawn: bool,
    random_state: int,
    report: Reporter,
) -> SystemResult:
    """All repeats of one system; a system without randomness runs once where the splits are not redrawn."""
    once = not redrawn and system in _WITHOUT_RANDOMNESS
    trials = [
        _run_folds(workers, system, material, folds, seeds=(random_state, repeat), report=report)
        for repeat, folds in enumerate(rounds[:1] if once else rounds)
    ]
    report.skip(sum(len(folds) for folds in rounds) - sum(len(trial.folds) for trial in trials))
    return _summarise(trials * (len(rounds) if once else 1), material.categories, not once)


def _run_folds(
    workers: _Workers,
    system: str,
    material: _Material,
    folds: tuple[Split, ...],
    *,
    seeds: tuple[int, int],
    report: Reporter,
) -> _Trial:
    predicted, fit_seconds, query_seconds = [], 0.0, 0.0
    for number, fold in enumerate(folds):
        report(f"{system}, {fold.name}")
        generator = np.random.default_rng([*seeds, number, SYSTEMS.index(system)])
        answer, fit, query = workers.train_and_predict(
            system, material, fold, int(generator.integers(2**31 - 1))
        )
        predicted.append(answer)
        fit_seconds += fit
        query_seconds += query
        report.skip(1)
    return _Trial(folds, predicted, fit_seconds, query_seconds)


def _summarise(trials: list[_Trial], categories: NDArray[Any], differ: bool) -> SystemResult:
    """Mean and spread over the repeats; the folds of one repeat are pooled."""
    truths = [np.concatenate([categories[fold.test] for fold in trial.folds]) for trial in trials]
    answers = [np.concatenate(trial.predicted) for trial in trials]
    scores = [compute_scores(truth, answer) for truth, answer in zip(truths, answers, strict=True)]
    query = float(np.mean([trial.query_seconds for trial in trials]))
    return SystemResult(
        scores=_over(scores, lambda values: float(np.mean(values))),
        spread=_over(scores, lambda values: float(np.std(values, ddof=1))) if len(scores) > 1 else None,
        fit_seconds=float(np.mean([trial.fit_seconds for trial in trials])),
        query_seconds=query,
        query_milliseconds=1000.0 * query / len(truths[0]),
        confusions=list_confusions(np.concatenate(truths), np.concatenate(answers), _LISTED_CONFUSIONS),
        folds=_summarise_folds(trials, categories) if len(trials[0].folds) > 1 else (),
        repeats_that_differ=differ,
    )


def _summarise_folds(trials: list[_Trial], categories: NDArray[Any]) -> tuple[FoldResult, ...]:
    results = []
    for number, fold in enumerate(trials[0].folds):
        scores = [compute_scores(categories[fold.test], trial.predicted[number]) for trial in trials]
        mean = _over(scores, lambda values: float(np.mean(values)))
        results.append(FoldResult(fold.name, len(fold.train), len(fold.test), mean))
    return tuple(results)


def _over(scores: Sequence[Scores], combine: Callable[[list[float]], float]) -> Scores:
    return Scores(
        recall=combine([one.recall for one in scores]),
        precision=combine([one.precision for one in scores]),
        f_measure=combine([one.f_measure for one in scores]),
        accuracy=combine([one.accuracy for one in scores]),
    )


def _gaps(
    categories: NDArray[Any], rounds: list[tuple[Split, ...]]
) -> tuple[dict[str, int], tuple[str, ...]]:
    """Test clips whose category was never trained, and categories that were never tested (first repeat)."""
    untrained: Counter[str] = Counter()
    tested: set[str] = set()
    for fold in rounds[0]:
        trained = set(categories[fold.train])
        untrained.update(category for category in categories[fold.test] if category not in trained)
        tested.update(categories[fold.test])
    return dict(sorted(untrained.items())), tuple(sorted(set(categories) - tested))
