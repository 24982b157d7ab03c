"""How well an estimated motion fits what the cameras saw."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from dousa.app.tables.lines import make_table, say_line, to_cell
from dousa.messages import Message
from dousa.retrieval.explain.phrases import say_part

if TYPE_CHECKING:
    from rich.console import Console

    from dousa.app.pipelines.estimate import Estimation
    from dousa.app.pipelines.projects import Project


def print_estimation(out: Console, done: Estimation, good: float = 0.75, fair: float = 0.5) -> None:
    """Overlap per view, what was lost, how sure the joints are, and what was written.

    Parameters
    ----------
    out : where to print.
    done : the answer.
    good, fair : overlap of model and silhouette from which it is green or yellow.
    """
    answer = done.estimate
    length = {"n": answer.n_frames, "rate": answer.frame_rate, "seconds": answer.n_frames / answer.frame_rate}
    found = {"speed": answer.frames_per_second, "body": done.body, "start": done.start}
    say_line(out, "estimated.frames", **length, **found)
    numbers = ("columns.overlap", "columns.worst", "columns.in_frame")
    table = make_table("columns.view", *numbers, right=numbers)
    for name, column in zip(done.views, answer.iou.T, strict=True):
        if not np.isfinite(column).any():
            table.add_row(to_cell(name), str(Message("estimated.no_image")), "", "")
            continue
        worst = int(np.nanargmin(column))
        mean = float(np.nanmean(column))
        colour = "green" if mean >= good else "yellow" if mean >= fair else "red"
        cells = f"[{colour}]{mean:.2f}[/]", f"{column[worst]:.2f}", str(done.first_frame + worst)
        table.add_row(to_cell(name), *cells)
    out.print(table)
    lost = np.flatnonzero(answer.lost)
    if len(lost):
        frames = describe_frames(lost + done.first_frame)
        seconds = describe_seconds(lost + done.first_frame, answer.frame_rate)
        say_line(out, "estimated.lost", n=len(lost), total=answer.n_frames, frames=frames, seconds=seconds)
    else:
        say_line(out, "estimated.none_lost")
    lengths = [
        f"{say_part(name)} {100 * mean:.1f} ± {100 * spread:.1f}" for name, (mean, spread) in answer.lengths.items()
    ]
    if lengths:
        say_line(out, "estimated.lengths", lengths=lengths)
    _print_uncertainty(out, done)
    for path in done.outputs:
        say_line(out, "estimated.wrote", path=path)


def describe_frames(frames: Sequence[int] | np.ndarray) -> str:
    """Numbers of frames as stretches: ``3-7, 12``."""
    return _describe_stretches(frames, lambda first, last: f"{first}" if first == last else f"{first}-{last}")


def describe_seconds(frames: Sequence[int] | np.ndarray, rate: float) -> str:
    """Stretches of frames in seconds: ``0.10-0.27, 0.40-0.43``."""
    return _describe_stretches(frames, lambda first, last: f"{first / rate:.2f}-{(last + 1) / rate:.2f}")


def _describe_stretches(frames: Sequence[int] | np.ndarray, describe: Callable[[int, int], str]) -> str:
    numbers = np.asarray(frames)
    if len(numbers) == 0:
        return str(Message("estimated.no_frames"))
    cuts = np.flatnonzero(np.diff(numbers) > 1) + 1
    stretches = [describe(int(part[0]), int(part[-1])) for part in np.split(numbers, cuts)]
    more = len(stretches) - 6
    shown = ", ".join(stretches[:6])
    return str(Message("estimated.more_stretches", shown=shown, n=more)) if more > 0 else shown


def _print_uncertainty(out: Console, done: Estimation, shown: int = 5) -> None:
    answer = done.estimate
    kept = answer.uncertainty[~answer.lost] if (~answer.lost).any() else answer.uncertainty
    if not np.isfinite(kept).any():
        return
    means = np.nanmean(kept, axis=0) * 1000.0
    names = answer.points.names
    order = [joint for joint in np.argsort(-means) if np.isfinite(means[joint])]
    least_sure = ", ".join(f"{say_part(names[joint])} {means[joint]:.0f}" for joint in order[:shown])
    say_line(out, "estimated.uncertainty", median=float(np.nanmedian(means)), joints=least_sure)
    hidden = answer.occluded.mean(axis=0)
    parts = [
        f"{say_part(answer.body.names[part])} {hidden[part]:.0%}" for part in np.argsort(-hidden) if hidden[part] >= 0.1
    ]
    if parts:
        say_line(out, "estimated.hidden", parts=parts[:shown])


def print_project(out: Console, project: Project) -> None:
    """What is in the folder of a project, and the command that goes on with each take."""
    from dousa.app.pipelines.projects import write_command

    say_line(out, "project.of" if project.program else "project.films", path=project.folder, program=project.program)
    if project.calibration is not None:
        say_line(out, "project.cameras", cameras=len(project.cameras), names=project.cameras, path=project.calibration)
    elif project.problem is not None:
        say_line(out, "project.no_cameras_for", problem=project.problem)
    else:
        say_line(out, "project.no_cameras")
    if project.rate is not None:
        say_line(out, "project.rate", rate=project.rate)
    if project.stature is not None:
        say_line(out, "project.stature", stature=project.stature)
    for take in project.takes:
        counts = {"films": len(take.films), "views": len(take.keypoints), "results": len(take.results)}
        say_line(out, "project.take", name=take.name, **counts)
        for path in take.results:
            say_line(out, "project.result", path=path)
        say_line(out, "project.next", command=write_command(project, take))
