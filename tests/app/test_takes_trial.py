"""The trial of long takes as tables."""

from __future__ import annotations

import io

from oracles.short_actions import make_library
from rich.console import Console

from dousa.app.tables.lines import print_tables
from dousa.experiments.takes import run_takes_experiment


def test_the_answer_is_shown_in_full():
    clips = make_library((0, 1), 2)
    answer = run_takes_experiment(clips, n_trees=10, random_state=0, n_jobs=1)
    out = io.StringIO()
    print_tables(Console(file=out, width=160), answer.to_tables())
    text = out.getvalue()
    for words in (
        "as recorded",
        "tempo 0.5 to 2",
        "unknown pieces",
        "votes, frame by frame",
        "MAP",
        "seed 0",
    ):
        assert words in text
    assert f"{answer.labelled['as recorded']['discriminants of moments, best sequence'].f_measure:.3f}" in text
