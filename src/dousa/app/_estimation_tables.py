"""The answer of ``estimate`` as tables for people."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from rich.markup import escape
from rich.table import Table

from dousa.app._output import one_line

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rich.console import Console

    from dousa.app.estimating import Estimation

__all__ = ["describe_frames", "print_estimation"]

_GOOD, _FAIR = 0.75, 0.5  # overlap of model and silhouette
_SHOWN_STRETCHES = 6
_SHOWN_JOINTS = 5


def print_estimation(out: Console, done: Estimation) -> None:
    """Overlap per view, what was lost, how sure the joints are, and what was written.

    Parameters
    ----------
    out : where to print.
    done : the answer.
    """
    answer = done.estimate
    seconds = answer.n_frames / answer.frame_rate
    out.print(
        f"{answer.n_frames} frames at {answer.frame_rate:g} Hz ({seconds:.1f} s), "
        f"{answer.frames_per_second:.0f} frames/s; body: {done.body}; start: {done.start}",
        markup=False,
        soft_wrap=True,
    )
    table = Table(box=None)
    table.add_column("view")
    for name in ("overlap", "worst", "in frame"):
        table.add_column(name, justify="right")
    for name, column in zip(done.views, answer.iou.T, strict=True):
        if not np.isfinite(column).any():
            table.add_row(escape(one_line(name)), "no image", "", "")
            continue
        worst = int(np.nanargmin(column))
        mean = float(np.nanmean(column))
        colour = "green" if mean >= _GOOD else "yellow" if mean >= _FAIR else "red"
        table.add_row(
            escape(one_line(name)),
            f"[{colour}]{mean:.2f}[/]",
            f"{column[worst]:.2f}",
            str(done.first_frame + worst),
        )
    out.print(table)
    lost = np.flatnonzero(answer.lost)
    if len(lost):
        out.print(
            f"[red]lost[/] in {len(lost)} of {answer.n_frames} frames: {describe_frames(lost + done.first_frame)}"
        )
    else:
        out.print("no frame lost")
    _print_uncertainty(out, done)
    for path in done.outputs:
        out.print(f"wrote {path}", markup=False, soft_wrap=True)


def describe_frames(frames: Sequence[int] | np.ndarray) -> str:
    """Numbers of frames as stretches: ``3-7, 12``."""
    numbers = np.asarray(frames)
    if len(numbers) == 0:
        return "none"
    cuts = np.flatnonzero(np.diff(numbers) > 1) + 1
    stretches = [
        f"{part[0]}" if len(part) == 1 else f"{part[0]}-{part[-1]}" for part in np.split(numbers, cuts)
    ]
    more = len(stretches) - _SHOWN_STRETCHES
    return ", ".join(stretches[:_SHOWN_STRETCHES]) + (f" and {more} more stretches" if more > 0 else "")


def _print_uncertainty(out: Console, done: Estimation) -> None:
    answer = done.estimate
    kept = answer.uncertainty[~answer.lost] if (~answer.lost).any() else answer.uncertainty
    if not np.isfinite(kept).any():
        return
    means = np.nanmean(kept, axis=0) * 1000.0
    names = answer.points.names
    order = [joint for joint in np.argsort(-means) if np.isfinite(means[joint])]
    least_sure = ", ".join(f"{names[joint]} {means[joint]:.0f}" for joint in order[:_SHOWN_JOINTS])
    out.print(
        f"could lie elsewhere by {np.nanmedian(means):.0f} mm (median of the joints); least sure (mm): {least_sure}",
        markup=False,
        soft_wrap=True,
    )
    hidden = answer.occluded.mean(axis=0)
    parts = [
        f"{answer.body.names[part]} {hidden[part]:.0%}" for part in np.argsort(-hidden) if hidden[part] >= 0.1
    ]
    if parts:
        out.print(
            f"hidden in every view: {', '.join(parts[:_SHOWN_JOINTS])} of the time",
            markup=False,
            soft_wrap=True,
        )
