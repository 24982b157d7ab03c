"""The paper's experiment: how well four systems tell the categories of clips they have not seen.

``full_tree`` one tree that tries every test at every node, without randomness; ``random_tree`` one tree of
the forest; ``forest`` all of them; ``motion_templates`` the method the paper compares itself with. Source:
Hamada, Kuriyama, Mukai, "Human motion retrieval using random forest", section 4, figures 4 and 5.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa.errors import TrainingError
from dousa.experiments.metrics import Confusion, Scores, compute_scores, list_confusions
from dousa.experiments.runner import (
    Split,
    Steps,
    check_at_least,
    check_categories,
    check_some,
    choose_split,
    describe_copies,
    fit_forest,
    make_folds,
    make_forest,
)
from dousa.experiments.table import Cell, Result, ResultTable, show
from dousa.messages import Message, Progress
from dousa.retrieval.features.feature_sets import FeatureSet, get_feature_set
from dousa.retrieval.features.posed_motion import LabelledClip
from dousa.retrieval.forest.calibration import Copies

SYSTEMS: tuple[str, ...] = ("full_tree", "random_tree", "forest", "motion_templates")

_SYSTEM_WORDS = {
    "full_tree": Message("trial_words.full_tree"),
    "random_tree": Message("trial_words.random_tree"),
    "forest": Message("trial_words.forest"),
    "motion_templates": Message("trial_words.motion_templates"),
}

_WITHOUT_RANDOMNESS = ("full_tree", "motion_templates")


@dataclass(frozen=True, slots=True)
class FoldResult(Result):
    """One system's scores on the clips of one performer, averaged over the repeats."""

    name: str
    n_train: int
    n_test: int
    scores: Scores

    def to_json(self) -> dict[str, Any]:
        """The scores by name beside the rest."""
        return {"name": self.name, "n_train": self.n_train, "n_test": self.n_test, **asdict(self.scores)}


@dataclass(frozen=True, slots=True)
class SystemResult(Result):
    """What one system reached.

    Parameters
    ----------
    scores : means over the repeats.
    spread : standard deviations over the repeats (n - 1); None with one repeat.
    fit_seconds, query_seconds : mean over the repeats, for all folds together.
    query_milliseconds : per test clip, its features being computed already.
    repeats_differ : false for a system without randomness on unchanging splits; its spread is 0 for that reason.
    confusions : the most frequent mistakes, counted over all repeats.
    folds : per performer, if performers were left out.
    """

    scores: Scores
    spread: Scores | None
    fit_seconds: float
    query_seconds: float
    query_milliseconds: float
    repeats_differ: bool = True
    confusions: tuple[Confusion, ...] = ()
    folds: tuple[FoldResult, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """The four scores by name and their spreads, then everything else."""
        rest = Result.to_json(self)
        scores, spread = rest.pop("scores"), rest.pop("spread") or {}
        return {**scores, **{f"{name}_std": spread.get(name) for name in scores}, **rest}


@dataclass(frozen=True, slots=True)
class ExperimentResult(Result):
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
    feature_set : name of the forest's features.
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
    feature_set: str = ""

    def to_tables(self) -> tuple[ResultTable, ...]:
        """A row a system; below it what was counted how, and the forest's most frequent mistakes."""
        seconds = (self.feature_seconds, self.relational_seconds, self.compile_seconds)
        templates = "motion_templates" in self.systems
        mistakes = self.systems["forest"].confusions if "forest" in self.systems else ()
        notes = [
            Message("trial_recognition.how", features=seconds[0], kernels=seconds[2]),
            *([Message("trial_recognition.how_templates", relational=seconds[1])] if templates else ()),
            *(Message("trial_recognition.untrained", name=k, n=n) for k, n in self.untrained.items()),
            *(
                Message("trial_recognition.mistake", true=one.truth, said=one.predicted, n=one.count)
                for one in mistakes[:5]
            ),
        ]
        heads = ("system", "recall", "precision", "f_measure", "accuracy", "train_s", "query_ms")
        return (
            ResultTable(
                tuple(_HEADS[name] for name in heads),
                tuple(_make_row(name, result) for name, result in self.systems.items()),
                title=Message(
                    "trial_recognition.title",
                    categories=len(self.categories),
                    train=self.n_train,
                    test=self.n_test,
                    split=self.split,
                    repeats=self.repeats,
                    features=self.feature_set,
                ),
                notes=tuple(notes),
                bold=frozenset(row for row, name in enumerate(self.systems) if name == "forest"),
            ),
        )


_HEADS: dict[str, Cell] = {
    "system": Message("trial_words.system"),
    "recall": Message("trial_words.recall"),
    "precision": Message("trial_words.precision"),
    "f_measure": "F",
    "accuracy": Message("trial_words.accuracy"),
    "train_s": Message("trial_words.train_s"),
    "query_ms": Message("trial_words.query_ms"),
}


def _make_row(name: str, result: SystemResult) -> tuple[Message | str, ...]:
    cells = [show(getattr(result.scores, score.name)) for score in fields(Scores)]
    if result.spread is not None:
        spreads = [show(getattr(result.spread, score.name)) for score in fields(Scores)]
        cells = [f"{mean} ± {spread}" for mean, spread in zip(cells, spreads, strict=True)]
    return (_SYSTEM_WORDS[name], *cells, show(result.fit_seconds, 2), show(result.query_milliseconds))


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
    split = choose_split(split, test_clips is not None)
    check_some("systems", systems, SYSTEMS)
    check_at_least(repeats=(repeats, 1), seed=(random_state, 0))
    settings = _Settings(get_feature_set(feature_set), n_trees, sampling_rate, template_threshold, n_jobs)
    tested = [*clips, *(test_clips or ())]
    _check_clips(clips, test_clips)
    first = make_folds(tested, len(clips), split, [random_state, 0], train_share)
    redrawn = split == "half"
    rounds = [first] + [
        make_folds(tested, len(clips), split, [random_state, repeat], train_share) if redrawn else first
        for repeat in range(1, repeats)
    ]
    material = _describe(tested, systems, settings, samples_per_frame, progress)
    compile_seconds = _warm_up(settings, systems)
    steps = Steps(progress, len(systems) * sum(len(folds) for folds in rounds))
    results = {
        system: _run_system(settings, system, material, rounds, redrawn, random_state, steps) for system in systems
    }
    steps.finish()
    untrained, untested = _find_gaps(material.categories, first)
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
        feature_set=settings.feature_set.name,
    )


def _check_clips(clips: Sequence[LabelledClip], test_clips: Sequence[LabelledClip] | None) -> None:
    if not clips:
        raise TrainingError("trials.no_training")
    if test_clips is not None and not test_clips:
        raise TrainingError("trials.no_test")
    check_categories([*clips, *(test_clips or ())])
    found = sorted({clip.category for clip in clips})
    if len(found) < 2:
        raise TrainingError("trials.one_training_category", clips=len(clips), category=found[0])


@dataclass(frozen=True, slots=True)
class _Settings:
    """How the systems are made."""

    feature_set: FeatureSet
    n_trees: int
    sampling_rate: float
    threshold: float
    n_jobs: int | None


@dataclass(frozen=True, slots=True)
class _Material:
    """The clips as the systems see them, computed once."""

    categories: NDArray[Any]  # (N,) str objects
    features: NDArray[np.float64]  # (N, T, F)
    sequences: list[NDArray[np.bool_]]  # N of (T_i, 39)
    copies: Copies  # of all clips, or none
    feature_seconds: float = 0.0
    relational_seconds: float = 0.0


@dataclass(frozen=True, slots=True)
class _Trial:
    """One system's predictions in one repeat, fold by fold."""

    folds: tuple[Split, ...]
    predicted: list[NDArray[Any]]
    fit_seconds: float
    query_seconds: float


def _describe(
    clips: Sequence[LabelledClip],
    systems: Sequence[str],
    settings: _Settings,
    samples_per_frame: int,
    progress: Progress | None,
) -> _Material:
    """Compute what the asked systems look at, once for all repeats."""
    features, sequences = np.empty((len(clips), settings.feature_set.n_frames, 0)), []
    steps, started = Steps(progress), time.perf_counter()
    if set(systems) - {"motion_templates"}:
        steps.say(Message("trial_progress.features"))
        features = np.stack([settings.feature_set.compute(clip, samples_per_frame) for clip in clips])
    copies = describe_copies(clips if "forest" in systems else (), settings.feature_set)
    between = time.perf_counter()
    if "motion_templates" in systems:
        from dousa.retrieval.ranking.templates import compute_relational_sequence

        steps.say(Message("trial_progress.relational"))
        sequences = [compute_relational_sequence(clip, settings.sampling_rate) for clip in clips]
    ended = time.perf_counter()
    categories = np.array([clip.category for clip in clips], dtype=object)
    return _Material(categories, features, sequences, copies, between - started, ended - between)


def _warm_up(settings: _Settings, systems: Sequence[str]) -> float:
    """Compile the kernels on a toy, so that the first system's time is not the compiler's; seconds."""
    started = time.perf_counter()
    generator = np.random.default_rng(0)
    toy = _Material(
        np.array(["a", "a", "b", "b"], dtype=object),
        generator.random((4, settings.feature_set.n_frames, settings.feature_set.n_columns)),
        [generator.random((3, 39)) > 0.5 for _ in range(4)],
        describe_copies((), settings.feature_set),
    )
    everything = np.arange(4)
    for system in systems:
        _train_and_predict(settings, system, toy, Split(everything, everything), 0)
    return time.perf_counter() - started


def _train_and_predict(
    settings: _Settings, system: str, material: _Material, fold: Split, seed: int
) -> tuple[NDArray[Any], float, float]:
    """Predictions for the fold's test clips, seconds to fit, seconds to predict."""
    started = time.perf_counter()
    labels = material.categories[fold.train].astype(str)
    if system == "motion_templates":
        from dousa.retrieval.ranking.templates import MotionTemplates

        templates = MotionTemplates(settings.threshold, n_jobs=settings.n_jobs)
        templates.fit([material.sequences[k] for k in fold.train], labels)
        fitted = time.perf_counter()
        predicted = templates.predict([material.sequences[k] for k in fold.test])
    else:
        forest = _make_system(settings, system, seed)
        # The paper's trees learn from the clips alone.
        copies = material.copies if system == "forest" else describe_copies((), settings.feature_set)
        fit_forest(forest, material.features, fold.train, labels, copies, settings.feature_set)
        fitted = time.perf_counter()
        predicted = forest.predict(material.features[fold.test])
    return np.asarray(predicted).astype(object), fitted - started, time.perf_counter() - fitted


def _make_system(settings: _Settings, system: str, seed: int) -> Any:
    from dousa.retrieval.forest.forest import MotionForest

    if system == "full_tree":
        return MotionForest(n_trees=1, n_trials="all", random_state=seed, n_jobs=settings.n_jobs)
    n_trees = 1 if system == "random_tree" else settings.n_trees
    return make_forest(settings.feature_set, n_trees, seed, settings.n_jobs)


def _run_system(
    settings: _Settings,
    system: str,
    material: _Material,
    rounds: list[tuple[Split, ...]],
    redrawn: bool,
    random_state: int,
    steps: Steps,
) -> SystemResult:
    """All repeats of one system; a system without randomness runs once where the splits are not redrawn."""
    once = not redrawn and system in _WITHOUT_RANDOMNESS
    trials = []
    for repeat, folds in enumerate(rounds[:1] if once else rounds):
        answers = []
        for number, fold in enumerate(folds):
            steps.say(Message("trial_progress.fold", system=system, fold=fold.name))
            generator = np.random.default_rng([random_state, repeat, number, SYSTEMS.index(system)])
            seed = int(generator.integers(2**31 - 1))
            answers.append(_train_and_predict(settings, system, material, fold, seed))
            steps.done += 1
        predicted, fit_seconds, query_seconds = zip(*answers, strict=True)
        trials.append(_Trial(folds, list(predicted), sum(fit_seconds), sum(query_seconds)))
    if once:
        steps.done += sum(len(folds) for folds in rounds[1:])
    return _summarise(trials * (len(rounds) if once else 1), material.categories, not once)


def _summarise(trials: list[_Trial], categories: NDArray[Any], differ: bool) -> SystemResult:
    """Mean and spread over the repeats; the folds of one repeat are pooled."""
    truths = [np.concatenate([categories[fold.test] for fold in trial.folds]) for trial in trials]
    answers = [np.concatenate(trial.predicted) for trial in trials]
    scores = [compute_scores(truth, answer) for truth, answer in zip(truths, answers, strict=True)]
    query = float(np.mean([trial.query_seconds for trial in trials]))
    return SystemResult(
        scores=_combine(scores, _mean),
        spread=_combine(scores, lambda values: float(np.std(values, ddof=1))) if len(scores) > 1 else None,
        fit_seconds=_mean([trial.fit_seconds for trial in trials]),
        query_seconds=query,
        query_milliseconds=1000.0 * query / len(truths[0]),
        confusions=list_confusions(np.concatenate(truths), np.concatenate(answers), 20),
        folds=_summarise_folds(trials, categories) if len(trials[0].folds) > 1 else (),
        repeats_differ=differ,
    )


def _summarise_folds(trials: list[_Trial], categories: NDArray[Any]) -> tuple[FoldResult, ...]:
    results = []
    for number, fold in enumerate(trials[0].folds):
        scores = [compute_scores(categories[fold.test], trial.predicted[number]) for trial in trials]
        results.append(FoldResult(fold.name, len(fold.train), len(fold.test), _combine(scores, _mean)))
    return tuple(results)


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values))


def _combine(scores: Sequence[Scores], combine: Callable[[list[float]], float]) -> Scores:
    return Scores(*(combine([getattr(one, score.name) for one in scores]) for score in fields(Scores)))


def _find_gaps(categories: NDArray[Any], folds: Sequence[Split]) -> tuple[dict[str, int], tuple[str, ...]]:
    """Test clips whose category was never trained, and categories that were never tested."""
    untrained: Counter[str] = Counter()
    tested: set[str] = set()
    for fold in folds:
        trained = set(categories[fold.train])
        untrained.update(category for category in categories[fold.test] if category not in trained)
        tested.update(categories[fold.test])
    return dict(sorted(untrained.items())), tuple(sorted(set(categories) - tested))
