"""The answer of the trial of long takes as tables for people."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rich.table import Table

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["print_takes_trial"]

_COLUMNS = {
    "frame_accuracy": "frames right",
    "precision": "precision",
    "recall": "recall",
    "f_measure": "F",
    "boundary_error_s": "boundary error, s",
}


def print_takes_trial(out: Console, answer: dict[str, Any]) -> None:
    """Print the JSON answer of the trial of long takes: labels, then searches, then how to read them."""
    labels = Table(
        title=f"Takes of {len(answer['performers'])} people left out in turn, labelled", title_justify="left"
    )
    labels.add_column("takes")
    labels.add_column("method")
    for name in _COLUMNS.values():
        labels.add_column(name, justify="right")
    for kind, methods in answer["labelled"].items():
        for place, (method, scores) in enumerate(methods.items()):
            cells = [_tell(scores[name]) for name in _COLUMNS]
            labels.add_row(kind if place == 0 else "", method, *cells, style="bold" if place == 0 else None)
        labels.add_section()
    out.print(labels)
    if answer["found"]:
        searches = Table(title="Clips of the others looked for in them", title_justify="left")
        searches.add_column("queries")
        for name in ("MAP", "P@1", "number"):
            searches.add_column(name, justify="right")
        for kind, scores in answer["found"].items():
            shown = _tell(scores["mean_average_precision"]), _tell(scores["precision_at_1"])
            searches.add_row(kind, *shown, str(scores["n_queries"]))
        out.print(searches)
    out.print(
        "precision, recall, F: of labelled stretches that overlap a true piece of their category by half or more; "
        "'all said': nothing is called unknown; seed "
        f"{answer['random_state']}; {answer['label_frames_per_second']:.0f} frames/s labelled",
        markup=False,
        soft_wrap=True,
    )


def _tell(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"
