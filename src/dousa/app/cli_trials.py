"""Commands that try things out: experiment and demo."""

from __future__ import annotations

import enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dousa.app import _options as o
from dousa.app._output import console, print_json, progress_bar, warn
from dousa.errors import OptionError

if TYPE_CHECKING:
    from dousa.library import Skipped
    from dousa.retrieval import LabelledClip

__all__ = ["register"]


class SplitName(enum.StrEnum):
    """How clips are divided into those that train and those that are tested."""

    HALF = "half"
    LEAVE_PERFORMER_OUT = "leave-performer-out"


class SystemName(enum.StrEnum):
    """What is compared."""

    FULL_TREE = "full_tree"
    RANDOM_TREE = "random_tree"
    FOREST = "forest"
    MOTION_TEMPLATES = "motion_templates"


class FeatureSet(enum.StrEnum):
    """What the trees look at."""

    PAPER = "paper"
    EXTENDED = "extended"


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
    repeats: Annotated[
        int, typer.Option("--repeats", min=1, help="How often, with other random numbers.")
    ] = 1,
    features: Annotated[
        FeatureSet,
        typer.Option(
            "--features", help="paper: the 56 pose features; extended: also turn, travel, speed, duration."
        ),
    ] = FeatureSet.PAPER,
    system: Annotated[
        list[SystemName] | None,
        typer.Option(
            "--system", help="Only this system; can be given several times.", show_default="all four"
        ),
    ] = None,
    samples: Annotated[
        int,
        typer.Option(
            "--samples", min=1, help="Poses averaged for each of the 10 frames; 1 is plain thinning."
        ),
    ] = 8,
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

    The paper's figures 4 and 5 as a table. Without --split half of every category trains and half is tested.

    Example: dousa experiment hdm05/ --split leave-performer-out --performer-from 'name:HDM_(..)_'
    """
    from dousa.app.trials import read_labelled_clips, refuse_clips_in_both
    from dousa.library import ReadOptions
    from dousa.retrieval.experiment import run_experiment

    _check_split(split, bool(test), performer_from)
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
        result = run_experiment(
            clips,
            test_clips=tested,
            split=None if test else (split or SplitName.HALF).value,
            repeats=repeats,
            random_state=seed,
            systems=[name.value for name in system or SystemName],
            feature_set=features.value,
            samples_per_frame=samples,
            n_trees=trees,
            n_jobs=jobs or -1,
            progress=progress,
        )
    skipped += more
    answer = {**result.to_json(), "skipped": [{"path": s.path, "reason": s.reason} for s in skipped]}
    _warn_skipped(skipped)
    _show_experiment(answer, figure, json)


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


def _show_experiment(answer: dict[str, Any], figure: Path | None, json: bool) -> None:
    if json:
        print_json(answer)
    else:
        from dousa.app import _tables

        _tables.print_experiment(console(), answer)
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
) -> None:
    """Show the main jobs with nothing but the package: make a library of motions, train it and search it;
    make a dance and a pupil who gets parts of it wrong, and tell them; see a performer with four cameras,
    estimate the motion from the silhouettes, and find and judge it (the last two not with --data).

    Example: dousa demo --output demo-output
    """
    from dousa.app.demo import run_demo
    from dousa.app.demo_estimation import run_estimation_demo
    from dousa.app.demo_evaluation import run_dance_demo

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
