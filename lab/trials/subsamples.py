"""Large libraries in small: trees that grow from samples of the clips, and what they learn later, against all clips.

    python -m lab.trials.subsamples [FOLDER] [--performer-from RULE] [--clips N] [--drawn M ...] [--folds K]
    python -m lab.trials.subsamples [FOLDER] [--performer-from RULE] [--clips N] [--drawn M ...] --new C [--most O ...]
        [--examples E ...] [--silent S ...] [--fold K] [--seed S]

So many clips with names cannot be had, so each is made of two recorded ones of a category: the weighted mean of their
features, and noise of a tenth of their spread. The people of each fold do not train; on their clips, as they were
recorded, the forests are tested. Without a folder all recordings are made. Prints the macro F of a forest whose trees
grow from all clips, and of those whose trees draw so many each, with the same seed; seconds are of processors.

With ``--new`` forests are trained without so many categories, and learn them from 5 recorded clips each, and then from
30: prints how often clips of the new categories and of the others are told right, for each share of a leaf that
strangers must be before it grows (one of so many), and of how many clips of the training the features were read: where
leaves keep a few of their clips as examples, as those of large libraries do, and where all that is in them is read.
With examples, clips that came later count in a leaf where they are one of so many (``--silent``) of its clips.
"""

from __future__ import annotations

import argparse
import itertools
import time
from collections.abc import Callable
from pathlib import Path
from unittest import mock

import numpy as np
from numpy.typing import NDArray

from dousa.experiments.metrics import compute_scores
from dousa.retrieval import MotionForest
from dousa.retrieval.forest import growth, trees
from dousa.retrieval.forest.growth import Growth, StandingClips, grow_forest
from dousa.retrieval.forest.standing_leaves import MOST_EXAMPLES, choose_examples
from lab.benchmarks.take_material import FEATURE_SET, read_or_make_clips

NOISE = 0.1  # of the spread of each number between the clips
LEARNED = 5, 30  # recorded clips of a new category


def mix_clips(
    features: NDArray[np.float32], categories: NDArray[np.str_], count: int, draw: np.random.Generator
) -> tuple[NDArray[np.float32], NDArray[np.str_]]:
    """So many clips (count, T, F), each between two of a category, which are as frequent as they were."""
    first = draw.integers(len(features), size=count)
    inside = {name: np.flatnonzero(categories == name) for name in np.unique(categories)}
    second = np.array([draw.choice(inside[name]) for name in categories[first]])
    spread = NOISE * features.std(axis=0)
    mixed = np.empty((count, *features.shape[1:]), np.float32)
    for place in range(count):  # one at a time: all of it is a gigabyte
        share = np.float32(draw.random())
        mixed[place] = share * features[first[place]] + (1 - share) * features[second[place]]
        mixed[place] += spread * draw.standard_normal(spread.shape, np.float32)
    return mixed, categories[first]


def train(features: NDArray[np.float32], categories: NDArray[np.str_], drawn: int, seed: int) -> MotionForest:
    """A forest whose trees draw so many clips each, if there are more."""
    forest = MotionForest(thresholds=FEATURE_SET.thresholds, random_state=seed, n_jobs=1)
    with mock.patch.object(trees, "MOST_GROWN", drawn):
        return forest.fit(features, categories, feature_set=FEATURE_SET)


def compare_samples(
    known: tuple[NDArray[np.float32], NDArray[np.str_]],
    fold_of: NDArray[np.int64],
    n_folds: int,
    n_clips: int,
    drawn: list[int],
) -> None:
    """Print the macro F on the clips of each fold."""
    features, categories = known
    found: dict[int, list[float]] = {}
    for fold in range(n_folds):
        test = fold_of == fold
        made = mix_clips(features[~test], categories[~test], n_clips, np.random.default_rng(fold))
        for count in (n_clips, *drawn):
            start = time.process_time()
            forest = train(*made, count, fold)
            seconds = time.process_time() - start
            scores = compute_scores(categories[test], forest.predict(features[test]))
            found.setdefault(count, []).append(scores.f_measure)
            n_leaves = forest.trees_.n_leaves // len(forest.trees_.roots)
            told = f"macro F {scores.f_measure:.4f}, accuracy {scores.accuracy:.4f}"
            print(f"fold {fold + 1}, {count} a tree: {told}, {n_leaves} leaves, {seconds:.0f} s", flush=True)
    whole = np.mean(found[n_clips])
    for count, values in found.items():
        print(f"{count} of {n_clips} a tree: macro F {np.mean(values):.4f}, {np.mean(values) - whole:+.4f}")


def compare_growth(
    known: tuple[NDArray[np.float32], NDArray[np.str_]],
    fold_of: NDArray[np.int64],
    n_clips: int,
    drawn: int,
    n_new: int,
    options: argparse.Namespace,
) -> None:
    """Print how well new categories are learned by a forest that was trained without them."""
    features, categories = known
    test, draw = fold_of == options.fold, np.random.default_rng(options.seed)
    is_new = np.isin(categories, draw.permutation(np.unique(categories))[:n_new])
    made, names = mix_clips(features[~test & ~is_new], categories[~test & ~is_new], n_clips, draw)
    trained = train(made, names, drawn, options.seed)
    later = [
        draw.permutation(np.flatnonzero(~test & (categories == name)))[: LEARNED[-1]]
        for name in np.unique(categories[is_new])
    ]
    numbers = np.unique(names, return_inverse=True)[1].astype(np.int32)
    kinds = [*itertools.product(options.examples, options.silent), (None, options.silent[0])]
    for (n_examples, silent), others in itertools.product(kinds, options.most):
        examples, how = None, "all clips"
        if n_examples is not None:
            shown = [(np.arange(n_clips), numbers, trained.apply(made))]
            examples = choose_examples(shown, trained.trees_.n_leaves, n_examples).__getitem__
            how = f"{n_examples} examples, later ones count from 1 of {silent} on"
        rows, leaves, forest = np.zeros(0, np.int64), trained.apply(made), trained
        for count, sooner in zip(LEARNED, (0, *LEARNED), strict=False):
            some = np.concatenate([own[sooner:count] for own in later])
            start = time.process_time()
            with mock.patch.multiple(growth, _MOST_OTHERS=others, _MOST_SILENT=silent):
                grown, n_read = teach(forest, (made, names), (features, categories), (rows, some), (leaves, examples))
            seconds = time.process_time() - start
            leaves[grown.moved] = grown.moved_leaves
            leaves, rows, forest = np.concatenate([leaves, grown.leaves]), np.append(rows, some), grown.forest
            right = forest.predict(features[test]) == categories[test]
            told = f"new {right[is_new[test]].mean():.3f}, others {right[~is_new[test]].mean():.3f}"
            told += f", all {right.mean():.3f}"
            print(f"{how}, 1 of {others}, {count} clips each: {told}; {n_read} read, {seconds:.1f} s", flush=True)


def teach(
    forest: MotionForest,
    made: tuple[NDArray[np.float32], NDArray[np.str_]],
    recorded: tuple[NDArray[np.float32], NDArray[np.str_]],
    rows: tuple[NDArray[np.int64], NDArray[np.int64]],
    standing: tuple[NDArray[np.int32], Callable[[NDArray[np.int64]], NDArray[np.int32]] | None],
) -> tuple[Growth, int]:
    """Let a forest learn recorded clips, after others of them; also how many clips of the training were read."""
    sooner, some = rows
    features = np.concatenate([made[0], recorded[0][sooner]])
    names = np.append(made[1], recorded[1][sooner])
    n_clips, read = len(made[0]), set[int]()

    def give(places: NDArray[np.int64]) -> NDArray[np.float32]:
        read.update(places[places < n_clips].tolist())
        return features[places]

    # Keys stand for contents: those of recorded clips follow from which they are.
    keys = np.concatenate([np.arange(n_clips), n_clips + sooner]).astype(np.uint64)
    later = np.arange(len(names)) >= n_clips
    known = StandingClips(names, standing[0], give, keys, later, examples=standing[1])
    new = (n_clips + some).astype(np.uint64)
    grown = grow_forest(forest, known, recorded[0][some], recorded[1][some], keys=new, feature_set=FEATURE_SET)
    return grown, len(read)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--performer-from", default=None)
    parser.add_argument("--clips", type=int, default=60_000)
    parser.add_argument("--drawn", type=int, nargs="+", default=[6_000, 30_000], metavar="M")
    parser.add_argument("--folds", type=int, default=2)
    parser.add_argument("--new", type=int, metavar="C")
    parser.add_argument("--examples", type=int, nargs="+", default=[MOST_EXAMPLES], metavar="E")
    parser.add_argument("--silent", type=int, nargs="+", default=[growth._MOST_SILENT], metavar="S")
    parser.add_argument("--fold", type=int, default=0, help="of the people who are tested, with --new")
    parser.add_argument("--seed", type=int, default=0, help="of the new categories that are drawn")
    parser.add_argument("--most", type=int, nargs="+", default=[64], metavar="O")
    options = parser.parse_args()
    clips = read_or_make_clips(options.folder, options.performer_from)
    features = np.stack([FEATURE_SET.compute(clip) for clip in clips]).astype(np.float32)
    categories = np.array([clip.category for clip in clips])
    people = np.array([str(clip.performer) for clip in clips])
    n_people = len(np.unique(people))
    fold_of = np.unique(people, return_inverse=True)[1] % max(2, n_people // 2)
    print(f"{len(clips)} clips of {len(np.unique(categories))} categories and {n_people} people")
    if options.new:
        compare_growth((features, categories), fold_of, options.clips, options.drawn[0], options.new, options)
    else:
        compare_samples((features, categories), fold_of, options.folds, options.clips, options.drawn)


if __name__ == "__main__":
    main()
