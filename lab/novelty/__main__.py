"""How well motions of no known category are recognised as such, and how good categories are that are added later.

python -m lab.novelty FOLDER [--performer-from RULE] [--repeats N] [--json]
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dousa.app.cli.usage import Json
from dousa.app.output import progress_bar
from dousa.app.pipelines.experiment_clips import read_labelled_clips
from dousa.app.requests.library import LabelRules
from dousa.app.requests.reading import Reading
from lab.command_line import Jobs, run_command
from lab.novelty.experiment import run_novelty_experiment
from lab.recognition_options import ForestOptions, print_result


def novelty(
    path: Annotated[list[Path], typer.Argument(metavar="PATH...", help="Folders of motion files.")],
    *,
    repeats: Annotated[int, typer.Option("--repeats", min=1, help="Number of repeats, with different seeds.")] = 1,
    forest_options: ForestOptions,
    rules: LabelRules,
    reading: Reading,
    jobs: Jobs = None,
    json: Json = False,
) -> None:
    """Evaluate the detection of unknown motions and the learning of new categories.

    Example: python -m lab.novelty hdm05/ --performer-from 'name:HDM_(..)_' --repeats 3
    """
    with progress_bar() as progress:
        clips, skipped = read_labelled_clips(
            path,
            category_from=rules.category_from,
            performer_from=rules.performer_from,
            options=reading.load(),
            n_jobs=jobs,
            progress=progress,
        )
        result = run_novelty_experiment(
            clips, repeats=repeats, n_jobs=jobs or -1, progress=progress, **forest_options.to_arguments()
        )
    print_result(result, skipped, json=json)


if __name__ == "__main__":
    run_command(novelty)
