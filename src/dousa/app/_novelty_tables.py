"""Tables of ``dousa experiment --unknown``: unknown motions and new categories."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rich.console import Console
from rich.table import Table

__all__ = ["print_novelty"]


def print_novelty(console: Console, answer: dict[str, Any]) -> None:
    """Both tables, with a line on what was done."""
    console.print(
        f"{answer['n_clips']} clips of {answer['n_categories']} categories, split {answer['split']}, "
        f"features {answer['feature_set']}, {answer['n_trees']} trees, {answer['repeats']} repeats, "
        f"seed {answer['random_state']}"
    )
    console.print(_tabulate_unknown(answer["unknown"]))
    if answer["new"]:
        console.print(_tabulate_new(answer["new"]))


def _tabulate_unknown(unknown: dict[str, Any]) -> Table:
    table = Table(title=f"Unknown motions: half of the categories held back, {unknown['n_trials']} trials")
    table.add_column("")
    table.add_column("measured", justify="right")
    table.add_column("foretold", justify="right")
    table.add_row("AUROC", f"{unknown['auroc']:.3f} ± {unknown['auroc_std']:.3f}", "")
    for words, key in (("known called unknown", "false_alarms"), ("unknown taken for known", "misses")):
        table.add_row(words, f"{unknown[key]:.3f}", f"{unknown[f'expected_{key}']:.3f}")
    for threshold, alarms, misses in unknown["curve"]:
        if threshold in (0.2, 0.3, 0.7, 0.8):
            table.add_row(f"at threshold {threshold}", f"{alarms:.3f}, {misses:.3f}", "")
    table.add_row("category of known clips right", f"{unknown['accuracy']:.3f}", "")
    seconds = f"{unknown['train_seconds']:.2f} s, {unknown['calibrate_seconds']:.2f} s"
    table.add_row("training, calibration", seconds, "")
    return table


def _tabulate_new(rows: Sequence[dict[str, Any]]) -> Table:
    table = Table(title=f"New categories, {rows[0]['n_clips']} clips of each")
    for heading in ("new", "forest"):
        table.add_column(heading)
    for heading in ("all clips", "of new", "of old", "new called unknown", "seconds"):
        table.add_column(heading, justify="right")
    for row in rows:
        shares = (row[key] for key in ("accuracy", "recall_new", "recall_old", "called_unknown"))
        table.add_row(
            str(row["n_new"]), row["forest"], *(f"{share:.3f}" for share in shares), f"{row['seconds']:.2f}"
        )
    return table
