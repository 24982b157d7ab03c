"""The picture of an exercise: the joint angles over time with the repetitions, and each repetition's measures."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from dousa.app.pictures.canvas import BLUE, FAINT, GREEN, GREY, INK, PURPLE, VERMILLION, new_figure, save_figure, write
from dousa.evaluation.exercises.range_of_motion import ANGLE_NAMES, compute_joint_angles
from dousa.messages import Message
from dousa.motion.canonical.canonicalise import mirror_canonical

if TYPE_CHECKING:
    from dousa.evaluation import RepetitionsAssessment
    from dousa.motion import CanonicalMotion

_WIDTH, _HEIGHT = 11.0, 6.6  # inches
_STYLES = ((BLUE, "-"), (VERMILLION, "--"), (GREEN, ":"), (PURPLE, "-."))


def draw_repetitions(
    assessment: RepetitionsAssessment,
    performance: CanonicalMotion,
    path: str | os.PathLike[str],
    angles: Sequence[str],
) -> None:
    """Draw what `dousa.evaluation.assess_repetitions` found.

    Parameters
    ----------
    assessment : what is shown.
    performance : the motion that was assessed.
    path : .png, .svg or .pdf.
    angles : joint angles of `dousa.evaluation.ANGLES`, four at most.

    Raises
    ------
    OptionError : another suffix.
    MotionWriteError : the picture cannot be written.
    """
    if assessment.side == "mirrored":
        performance = mirror_canonical(performance)  # as it was measured: left and right are the reference's
    figure = new_figure(_WIDTH, _HEIGHT)
    incomplete = len(assessment.repetitions) - assessment.count
    title = Message("exercise_table.picture_title", n=assessment.count, incomplete=incomplete)
    write(figure, 0.06, 0.955, str(title), 13)
    _draw_angles(figure.add_axes((0.06, 0.5, 0.92, 0.4)), assessment, performance, angles[: len(_STYLES)])
    texts = ("exercise_table.duration", "exercise_table.grade", "exercise_table.degrees_axis")
    main = max(angles, key=lambda name: assessment.reference_ranges[name])
    columns = (
        ([one.repetition.duration_s for one in assessment.repetitions], assessment.reference_s),
        ([one.score for one in assessment.repetitions], math.nan),
        ([one.get_range(main).range_deg for one in assessment.repetitions], assessment.reference_ranges[main]),
    )
    for place, (code, (values, reference)) in enumerate(zip(texts, columns, strict=True)):
        axes = figure.add_axes((0.06 + 0.32 * place, 0.09, 0.26, 0.28))
        heading = str(ANGLE_NAMES[main]) if place == len(texts) - 1 else str(Message(code))
        _draw_bars(axes, assessment, values, reference, heading)
    save_figure(figure, path)


def _draw_angles(
    axes: Any, assessment: RepetitionsAssessment, performance: CanonicalMotion, angles: Sequence[str]
) -> None:
    curves = compute_joint_angles(performance)
    times = np.arange(performance.n_frames) / performance.frame_rate
    _clean(axes)
    for name, (colour, style) in zip(angles, _STYLES, strict=False):
        axes.plot(times, curves[name], style, color=colour, linewidth=1.4)
    low, high = axes.get_ylim()
    for number, one in enumerate(assessment.repetitions, 1):
        found = one.repetition
        hatch = None if found.complete else "///"
        axes.axvspan(found.start_s, found.end_s, facecolor=FAINT, alpha=0.45, hatch=hatch, edgecolor=GREY, linewidth=0)
        label = str(number) if found.complete else f"({number})"
        write(axes, 0.5 * (found.start_s + found.end_s), high, label, 9, ha="center")
    axes.set_ylim(low, high)
    axes.set_xlim(0.0, max(performance.duration, 1e-3))
    for place, (name, (colour, style)) in enumerate(zip(angles, _STYLES, strict=False)):
        axes.plot(
            [0.005 + 0.24 * place, 0.035 + 0.24 * place],
            [-0.14] * 2,
            style,
            color=colour,
            transform=axes.transAxes,
            clip_on=False,
        )
        write(axes, 0.04 + 0.24 * place, -0.16, str(ANGLE_NAMES[name]), 9, transform=axes.transAxes)
    write(axes, 0.0, 1.04, str(Message("exercise_table.degrees_axis")), 9, transform=axes.transAxes)
    write(axes, 1.0, -0.16, str(Message("exercise_table.seconds_axis")), 9, transform=axes.transAxes, ha="right")


def _draw_bars(
    axes: Any, assessment: RepetitionsAssessment, values: Sequence[float], reference: float, heading: str
) -> None:
    _clean(axes)
    numbers = np.arange(1, len(values) + 1)
    for number, value, one in zip(numbers, values, assessment.repetitions, strict=True):
        if math.isfinite(value):
            complete = one.repetition.complete
            axes.bar(
                number,
                value,
                0.7,
                color=BLUE if complete else "white",
                edgecolor=BLUE,
                hatch=None if complete else "///",
            )
    if math.isfinite(reference):
        axes.axhline(reference, color=INK, linewidth=1.0, linestyle="--")
        write(axes, 1.0, 1.03, f"- - {Message('exercise_table.reference')}", 8, transform=axes.transAxes, ha="right")
    axes.set_xlim(0.4, len(values) + 0.6)
    axes.set_xticks(numbers[:: max(1, len(values) // 12)])
    write(axes, 0.0, 1.03, heading, 9, transform=axes.transAxes)


def _clean(axes: Any) -> None:
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    axes.tick_params(labelsize=8, colors=INK)
