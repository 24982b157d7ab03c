"""Commands that try things out: experiment and demo."""

from __future__ import annotations

import enum
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dousa.app import _options as o
from dousa.app._output import console, print_json, progress_bar, warn
from dousa.errors import OptionError

if TYPE_CHECKING:
    from dousa.app._output import ProgressCallback
    from dousa.library import Skipped
    from dousa.retrieval import LabelledClip

__all__ = ["register"]


class SplitName(enum.StrEnum):
    """How clips are divided into those that train and those that are tested."""

    HALF = "half"
    LEAVE_PERFORMER_OUT = "leave-performer-out"


class SystemName(enum.StrEnum):
    """What is compared: the first four tell categories apart, the last seven rank."""

    FULL_TREE = "full_tree"
    RANDOM_TREE = "random_tree"
    FOREST = "forest"
    MOTION_TEMPLATES = "motion_templates"
    FUSED = "fused"
    HISTOGRAM = "histogram"
    LEAVES = "leaves"
    POSE = "pose"
    EUCLIDEAN = "euclidean"
    DTW = "dtw"


_SAMPLES = 8


def register(app: typer.Typer) -> None:
    """Hang this module's commands on the application."""
    app.command(rich_help_panel="Trials")(experiment)
    app.command(rich_help_panel="Trials")(demo)


def experiment(
    path: Annotated[list[Path], typer.Argument(metavar="PATH...", help="Folders of motion files.")],
    test: Annotated[
        list[Path] | None,
        typer.Option("--test", help="Train on PATH and test on this folder instead of splitting."),
    ] = None,
    split: Annotated[
        SplitName | None, typer.Option("--split", help="How PATH is split.", show_default="half")
    ] = None,
    train_share: Annotated[
        float | None,
        typer.Option("--train-share", help="Of every category trains, instead of half.", show_default="0.5"),
    ] = None,
    repeats: Annotated[
        int, typer.Option("--repeats", min=1, help="How often, with other random numbers.")
    ] = 1,
    ranking: Annotated[
        bool,
        typer.Option(
            "--ranking", help="Ask how good the order of the clips found is, instead of their categories."
        ),
    ] = False,
    takes: Annotated[
        bool,
        typer.Option("--takes", help="Ask how well takes joined of clips are labelled and searched."),
    ] = False,
    unknown: Annotated[
        bool,
        typer.Option("--unknown", help="Ask how well unknown motions are told, and new categories taken in."),
    ] = False,
    features: Annotated[
        o.FeatureSetName | None,
        typer.Option(
            "--features",
            help="paper: the 56 pose features; extended: also speeds, spreads, trends.",
            show_default="paper; extended with --ranking, --takes and --unknown",
        ),
    ] = None,
    system: Annotated[
        list[SystemName] | None,
        typer.Option(
            "--system",
            help="Only this system; can be given several times.",
            show_default="all four; with --ranking the last seven",
        ),
    ] = None,
    samples: Annotated[
        int,
        typer.Option(
            "--samples", min=1, help="Poses averaged for each of the 10 frames; 1 is plain thinning."
        ),
    ] = _SAMPLES,
    trees: Annotated[int, typer.Option("--trees", min=1, help="Trees of the forest.")] = 100,
    seed: Annotated[int, typer.Option("--seed", min=0, help="The same seed gives the same table.")] = 0,
    category_from: o.CategoryFrom = "folder",
    performer_from: o.PerformerFrom = None,
    unit: o.Unit = None,
    up: o.Up = None,
    skeleton: o.SkeletonFile = None,
    joint_map: o.JointMap = None,
    jobs: o.Jobs = None,
    figure: Annotated[
        Path | None, typer.Option("--figure", help="Draw the table: .png, .svg or .pdf.")
    ] = None,
    json: o.Json = False,
) -> None:
    """How well are categories told apart: single trees, the forest and motion templates, on clips not seen.

    The paper's figures 4 and 5 as a table. Without --split half of every category trains and half is tested. With
    --ranking: how good is the order in which clips are found, by our rankings, Euclidean distance, DTW and motion
    templates. With --takes: how well are long takes of people left out labelled and searched. With --unknown: are
    motions of no known category told, and how good are categories that were added later.

    Example: dousa experiment hdm05/ --split leave-performer-out --performer-from 'name:HDM_(..)_'
    """
    from dousa.app.trials import read_labelled_clips, refuse_clips_in_both
    from dousa.library import ReadOptions

    kind = _choose_kind(ranking=ranking, takes=takes, unknown=unknown)
    _check_split(split, bool(test), performer_from)
    given = {
        "--train-share": train_share is not None,
        "--repeats": repeats != 1,
        "--samples": samples != _SAMPLES,
        "--figure": figure is not None,
        "--split": split is not None,
        "--test": bool(test),
        "--system": bool(system),
    }
    _refuse_ignored(kind, given)
    if train_share is not None and (test or split is SplitName.LEAVE_PERFORMER_OUT):
        raise OptionError("--train-share needs a split by halves; leave it out, or --split and --test")
    systems = _choose_systems(system, ranking)
    options = ReadOptions(o.load_joint_map(joint_map), unit, up, skeleton)
    with progress_bar() as progress:

        def read(paths: list[Path]) -> tuple[list[LabelledClip], list[Skipped]]:
            return read_labelled_clips(
                paths,
                category_from=category_from,
                performer_from=performer_from,
                options=options,
                n_jobs=jobs,
                progress=progress,
            )

        clips, skipped = read(path)
        tested, more = read(test) if test else (None, [])
        refuse_clips_in_both(clips, tested or [])
        trial = _Trial(
            clips, tested, None if test else (split or SplitName.HALF).value, systems, seed, trees, jobs or -1
        )
        if kind is _Kind.RECOGNITION:
            answer = trial.recognise(
                features or o.FeatureSetName.PAPER, train_share or 0.5, (repeats, samples), progress
            )
        else:
            answer = trial.go_beyond(kind, features or o.FeatureSetName.EXTENDED, repeats, progress)
    skipped += more
    answer["skipped"] = [{"path": s.path, "reason": s.reason} for s in skipped]
    _warn_skipped(skipped)
    _show(kind, answer, figure, json)


class _Kind(enum.Enum):
    """What an experiment asks, and the options that have nothing to do with it."""

    RECOGNITION = ("", ())
    RANKING = ("--ranking", ("--train-share", "--repeats", "--samples", "--figure"))
    TAKES = (
        "--takes",
        ("--train-share", "--repeats", "--samples", "--figure", "--split", "--test", "--system"),
    )
    UNKNOWN = ("--unknown", ("--train-share", "--samples", "--figure", "--split", "--test", "--system"))


def _choose_kind(*, ranking: bool, takes: bool, unknown: bool) -> _Kind:
    asked = {_Kind.RANKING: ranking, _Kind.TAKES: takes, _Kind.UNKNOWN: unknown}
    kinds = [kind for kind, wanted in asked.items() if wanted]
    if len(kinds) > 1:
        names = " and ".join(kind.value[0] for kind in kinds)
        raise OptionError(f"expected one kind of experiment, got {names}; run them one after the other")
    return kinds[0] if kinds else _Kind.RECOGNITION


def _refuse_ignored(kind: _Kind, given: dict[str, bool]) -> None:
    """Refuse what would be ignored."""
    name, ignored = kind.value
    for option in ignored:
        if given[option]:
            raise OptionError(f"{option} has nothing to do with {name}; leave one of them out")


@dataclass(frozen=True, slots=True)
class _Trial:
    """What both kinds of experiment are asked."""

    clips: list[LabelledClip]
    tested: list[LabelledClip] | None
    split: str | None
    systems: list[str]
    seed: int
    trees: int
    jobs: int

    def recognise(
        self, features: o.FeatureSetName, share: float, counts: tuple[int, int], progress: ProgressCallback
    ) -> dict[str, Any]:
        """Tell categories apart; ``counts`` are the repeats and the poses averaged for a frame."""
        from dousa.retrieval.experiment import run_experiment

        return run_experiment(
            self.clips,
            test_clips=self.tested,
            split=self.split,
            train_share=share,
            repeats=counts[0],
            random_state=self.seed,
            systems=self.systems,
            feature_set=features.value,
            samples_per_frame=counts[1],
            n_trees=self.trees,
            n_jobs=self.jobs,
            progress=progress,
        ).to_json()

    def go_beyond(
        self, kind: _Kind, features: o.FeatureSetName, repeats: int, progress: ProgressCallback
    ) -> dict[str, Any]:
        """Put clips in order, label takes, or tell what is unknown."""
        if kind is _Kind.RANKING:
            from dousa.retrieval.ranking_experiment import run_ranking_experiment

            return run_ranking_experiment(
                self.clips,
                test_clips=self.tested,
                split=self.split,
                random_state=self.seed,
                systems=self.systems,
                feature_set=features.value,
                n_trees=self.trees,
                n_jobs=self.jobs,
                progress=progress,
            ).to_json()
        if kind is _Kind.TAKES:
            from dousa.retrieval.takes_experiment import run_takes_experiment

            return run_takes_experiment(
                self.clips,
                feature_set=features.value,
                n_trees=self.trees,
                random_state=self.seed,
                n_jobs=self.jobs,
                progress=progress,
            ).to_json()
        from dousa.retrieval.novelty_experiment import run_novelty_experiment

        return run_novelty_experiment(
            self.clips,
            repeats=repeats,
            n_trees=self.trees,
            feature_set=features.value,
            random_state=self.seed,
            n_jobs=self.jobs,
            progress=progress,
        ).to_json()


def _choose_systems(asked: list[SystemName] | None, ranking: bool) -> list[str]:
    """The systems asked for, or all that this kind of experiment has."""
    from dousa.retrieval._ranking_systems import RANKING_SYSTEMS
    from dousa.retrieval.experiment import SYSTEMS

    able = RANKING_SYSTEMS if ranking else SYSTEMS
    names = [name.value for name in dict.fromkeys(asked or ())] or list(able)
    wrong = [name for name in names if name not in able]
    if wrong:
        remedy = "leave --ranking out" if ranking else "add --ranking"
        raise OptionError(f"--system: expected some of {', '.join(able)}, got {', '.join(wrong)}; {remedy}?")
    return names


def _check_split(split: SplitName | None, test_given: bool, performer_from: str | None) -> None:
    if test_given and split is not None:
        raise OptionError(
            "--test gives the clips to test, so --split has nothing to do; leave one of them out"
        )
    if split is SplitName.LEAVE_PERFORMER_OUT and performer_from is None:
        raise OptionError(
            "--split leave-performer-out needs to know the performers: add --performer-from, for instance "
            "--performer-from 'name:_s(\\d+)_' where file names hold _s1_, _s2_ ..."
        )


def _show(kind: _Kind, answer: dict[str, Any], figure: Path | None, json: bool) -> None:
    from dousa.app import _novelty_tables, _ranking_tables, _tables, _takes_trial_tables

    shown = {
        _Kind.RECOGNITION: _tables.print_experiment,
        _Kind.RANKING: _ranking_tables.print_ranking,
        _Kind.TAKES: _takes_trial_tables.print_takes_trial,
        _Kind.UNKNOWN: _novelty_tables.print_novelty,
    }
    if json:
        print_json(answer)
    else:
        shown[kind](console(), answer)
    if figure:  # last, so that an answer that took long is not lost where the picture cannot be written
        from dousa.app.pictures import draw_experiment_figure

        draw_experiment_figure(answer, figure)


def _warn_skipped(skipped: list[Skipped]) -> None:
    for item in skipped[:5]:
        warn(f"left out {item.path}: {item.reason}")
    if len(skipped) > 5:
        warn(f"left out {len(skipped) - 5} more files")


def demo(
    data: Annotated[
        Path | None, typer.Option("--data", help="Do it with the motion files of this folder instead.")
    ] = None,
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Folder for the motions, the library and the picture.")
    ] = Path("demo-output"),
    category_from: o.CategoryFrom = "folder",
    performer_from: o.PerformerFrom = None,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Other performers and motions.")] = 0,
    jobs: o.Jobs = None,
    studio: Annotated[
        bool,
        typer.Option(
            "--studio",
            help="Then open the studio on the demo library; at once if the folder has one already.",
        ),
    ] = False,
    no_browser: Annotated[
        bool, typer.Option("--no-browser", help="With --studio: only print the address.")
    ] = False,
) -> None:
    """Show the main jobs with nothing but the package: make a library of motions, train it, search it and look
    into an uncut take; make a dance and a pupil who gets parts of it wrong, and tell them; see a performer with four
    cameras, estimate the motion from the silhouettes, and find and judge it (the last two not with --data).

    Example: dousa demo --output demo-output

    Example: dousa demo --studio
    """
    from dousa.app.demo import run_demo
    from dousa.app.demo_estimation import run_estimation_demo
    from dousa.app.demo_evaluation import run_dance_demo
    from dousa.app.demo_studio import LIBRARY, open_demo_studio

    if studio and (output / LIBRARY).is_file():
        open_demo_studio(console(), output, opens_browser=not no_browser)
        return
    run_demo(
        console(),
        data,
        output,
        seed=seed,
        n_jobs=jobs,
        category_from=category_from,
        performer_from=performer_from,
    )
    if data is None:
        run_dance_demo(console(), output, seed=seed)
        run_estimation_demo(console(), output, seed=seed)
    if studio:
        open_demo_studio(console(), output, opens_browser=not no_browser)
