"""How good the order is in which clips are found: our rankings, Euclidean distance, DTW and motion templates.

python -m lab.ranking FOLDER [--split leave-performer-out --performer-from RULE] [--system pose ...] [--json]
"""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from dousa.app.cli.usage import Json
from dousa.app.output import progress_bar
from dousa.app.pipelines.experiment_clips import read_labelled_clips, refuse_clips_in_both
from dousa.app.requests.library import LabelRules
from dousa.app.requests.reading import Reading
from dousa.errors import OptionError
from lab.command_line import Jobs, run_command
from lab.ranking.experiment import run_ranking_experiment
from lab.ranking.systems import RANKING_SYSTEMS
from lab.recognition_options import ForestOptions, print_result

SystemName = StrEnum("SystemName", [(name.upper(), name) for name in RANKING_SYSTEMS])  # type: ignore[misc]


def ranking(
    path: Annotated[list[Path], typer.Argument(metavar="PATH...", help="Folders of motion files.")],
    *,
    test: Annotated[
        list[Path] | None, typer.Option("--test", help="Search PATH for the clips of this folder instead of splitting.")
    ] = None,
    split: Annotated[
        Literal["half", "leave-performer-out"] | None, typer.Option("--split", help="How PATH is split.")
    ] = None,
    system: Annotated[
        list[SystemName] | None, typer.Option("--system", help="Only this ranking; can be repeated.")
    ] = None,
    forest_options: ForestOptions,
    rules: LabelRules,
    reading: Reading,
    jobs: Jobs = None,
    json: Json = False,
) -> None:
    """Evaluate the ranking of retrieved clips.

    Example: python -m lab.ranking hdm05/ --split leave-performer-out --performer-from 'name:HDM_(..)_'
    """
    if test and split is not None:
        raise OptionError("experiments_cli.split_and_test")
    if split == "leave-performer-out" and rules.performer_from is None:
        raise OptionError("experiments_cli.no_performers")
    files: dict[str, Any] = {
        "category_from": rules.category_from,
        "performer_from": rules.performer_from,
        "options": reading.load(),
        "n_jobs": jobs,
    }
    with progress_bar() as progress:
        clips, skipped = read_labelled_clips(path, **files, progress=progress)
        tested, more = read_labelled_clips(test, **files, progress=progress) if test else (None, [])
        refuse_clips_in_both(clips, tested or [])
        result = run_ranking_experiment(
            clips,
            test_clips=tested,
            split=None if tested else split or "half",
            systems=[name.value for name in system or SystemName],
            n_jobs=jobs or -1,
            progress=progress,
            **forest_options.to_arguments(),
        )
    print_result(result, skipped + more, json=json)


if __name__ == "__main__":
    run_command(ranking)
