"""Pictures of an exercise: joint angles over time, measures by repetition, the furthest pose of each."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from dousa.app.report.figures import Placement, compute_heading, draw_body, measure_body, place, turn
from dousa.app.report.markup import Svg, element, format_number
from dousa.app.report.plot import Plot, number_labels
from dousa.app.report.timeline import choose_ticks, time_ticks, x_labels
from dousa.arrays import FloatArray
from dousa.evaluation.exercises.range_of_motion import ANGLE_NAMES, compute_joint_angles
from dousa.evaluation.exercises.repetitions import (
    PAIR_NAMES,
    AssessedRepetition,
    RepetitionsAssessment,
    choose_angles,
    choose_pair,
    compute_median,
)
from dousa.evaluation.words import format_time
from dousa.motion import CanonicalMotion
from dousa.motion.canonical.joints import JOINT_INDEX as J

_MOST_POINTS = 3000
_VIEWS = (0.0, 45.0, -45.0, 90.0, -90.0)  # degrees towards the performer's right
_CELL = (150.0, 190.0)
_MOST_POSES = 24


def draw_angles(
    done: RepetitionsAssessment, performance: CanonicalMotion, words: Mapping[str, str], language: str
) -> str:
    """The joint angles that move most, over time, with the repetitions as bands to press.

    Parameters
    ----------
    done : the repetitions.
    performance : as it was measured: mirrored if they were.
    words : texts of the page.
    language : of the names of joints.
    """
    names = choose_angles(done)
    curves = compute_joint_angles(performance)
    step = max(-(-performance.n_frames // _MOST_POINTS), 1)
    times = np.arange(performance.n_frames)[::step] / performance.frame_rate
    shown = {name: curves[name][::step] for name in names}
    known = np.concatenate([values[np.isfinite(values)] for values in shown.values()])
    low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 1.0)
    low, high = min(low - 3.0, 0.0), high + 0.12 * (high - low) + 3.0
    plot = Plot((0.0, max(done.duration_s, 1e-6)), (low, high), words["angles_label"], "angle-plot")
    for number, one in enumerate(done.repetitions, 1):
        found = one.repetition
        css = "repetition" if found.complete else "repetition incomplete"
        plot.span(found.start_s, found.end_s, css, str(number), data_repetition=str(number - 1))
    key = []
    for number, name in enumerate(names, 1):
        plot.curve(times, shown[name], f"angle angle-{number}")
        key.append((f"angle-{number}", ANGLE_NAMES[name].render(language)))
    plot.cursor()
    ticks = [(value, f"{value:.0f}°") for value in choose_ticks(low, high, 5)]
    labels = x_labels(time_ticks(done.duration_s), max(done.duration_s, 1e-6))
    return plot.to_markup(ticks, labels, key=key)


def draw_measures(done: RepetitionsAssessment, words: Mapping[str, str], language: str) -> str:
    """Grade, duration, ranges and sides from repetition to repetition, a column each; the reference as a line."""
    ones = done.repetitions
    plots = [
        _columns(done, [one.score for one in ones], words["grade"], "", digits=0, top=100.0, trend="score"),
        _columns(
            done,
            [one.repetition.duration_s for one in ones],
            words["duration"],
            " s",
            digits=1,
            reference=done.reference_s,
            trend="duration_s",
        ),
    ]
    for name in choose_angles(done):
        values = [one.get_range(name).range_deg for one in ones]
        title = words["range_of"].format(angle=ANGLE_NAMES[name].render(language))
        reference = done.reference_ranges[name]
        plots.append(_columns(done, values, title, "°", digits=0, reference=reference, trend=name))
    pair = choose_pair(done)
    if pair is not None:
        title = words["sides_of"].format(angle=PAIR_NAMES[pair].render(language))
        plots.append(_columns(done, [one.symmetry[pair] for one in ones], title, " %", digits=0, both=True))
    key = [("bar-of", words["key_complete"]), ("bar-of incomplete", words["key_incomplete"])]
    key += [("reference", words["reference"]), ("trend", words["key_trend"])]
    keys = "".join(
        element("span", None, inner=element("i", {"class": f"key-mark {css}"}) + element("span", None, text))
        for css, text in key
    )
    grid = element("div", {"class": "measures"}, inner="".join(plots))
    return grid + element("div", {"class": "plot-key"}, inner=keys)


def _columns(
    done: RepetitionsAssessment,
    values: Sequence[float],
    title: str,
    unit: str,
    *,
    digits: int,
    reference: float = math.nan,
    top: float = 0.0,
    trend: str = "",
    both: bool = False,
) -> str:
    known = [abs(value) for value in (*values, reference) if math.isfinite(value)]
    high = top or 1.25 * max([*known, 20.0 if both else 1e-6])
    low = -high if both else 0.0
    count = len(values)
    plot = Plot((0.5, count + 0.5), (low, high), title, "columns")
    if both:
        plot.level(0.0, "zero")
    plot.level(reference, "reference")
    for number, (value, one) in enumerate(zip(values, done.repetitions, strict=True), 1):
        css = "" if one.repetition.complete else "incomplete"
        text = f"{value:+.{digits}f}" if both else format_number(value, digits)
        plot.bar(number - 0.36, number + 0.36, value, css, text if count <= _MOST_POSES else "")
    _add_trend(plot, done, values, trend)
    ticks = [(value, f"{format_number(value, 1)}{unit}") for value in choose_ticks(low, high, 3)]
    labels = number_labels([str(number) for number in range(1, count + 1)], 12)
    return element("div", {"class": "card measure"}, inner=plot.to_markup(ticks, labels, name=title))


def _add_trend(plot: Plot, done: RepetitionsAssessment, values: Sequence[float], name: str) -> None:
    """The line of a trend that can be told from chance, through the middle of the complete repetitions."""
    found = done.trends.get(name)
    if found is None or not found.distinguishable:
        return
    complete = [
        (number, value)
        for number, (value, one) in enumerate(zip(values, done.repetitions, strict=True), 1)
        if one.repetition.complete and math.isfinite(value)
    ]
    order = np.arange(len(complete), dtype=np.float64)
    middle = compute_median([value - found.slope * place for place, (_, value) in enumerate(complete)])
    plot.curve(np.array([number for number, _ in complete], np.float64), middle + found.slope * order, "trend")


def draw_poses(
    done: RepetitionsAssessment, performance: CanonicalMotion, words: Mapping[str, str], language: str
) -> str:
    """The pose in which each repetition goes furthest, beside the reference's; seen from where it shows most.

    Parameters
    ----------
    done, performance : as of `draw_angles`.
    words : texts of the page.
    language : of the names of joints.
    """
    name = max(choose_angles(done), key=lambda angle: done.reference_ranges[angle])
    angle = compute_joint_angles(performance)[name]
    cells: list[tuple[FloatArray, str, str, str | None]] = []
    graded = next((one.assessment for one in done.repetitions if one.assessment is not None), None)
    ways: list[tuple[FloatArray, FloatArray]] = []
    if graded is not None:
        model = replace(
            performance,
            positions=np.asarray(graded.reference.positions, np.float64),
            frame_rate=graded.reference.frame_rate,
            missing=None,
        )
        theirs = compute_joint_angles(model)[name]
        first, pose = _find_furthest(model, theirs, 0, model.n_frames)
        ways.append((_face(model, first), _face(model, pose)))
        text = words["pose"].format(name=words["reference"], degrees=format_number(float(theirs[pose]), 0))
        cells.append((ways[0][1], text, "reference", None))
    for number, one in enumerate(done.repetitions[:_MOST_POSES], 1):
        found = one.repetition
        first, pose = _find_furthest(performance, angle, found.start, found.end)
        ways.append((_face(performance, first), _face(performance, pose)))
        text = words["pose"].format(name=_name(number, one, words), degrees=format_number(float(angle[pose]), 0))
        cells.append((ways[-1][1], text, "performance" if found.complete else "performance faint", str(number - 1)))
    azimuth = math.radians(_choose_view(ways))
    turned = [turn(pose, azimuth) for pose, *_ in cells]
    common = place(turned, *_CELL, 10.0)
    figures = [
        _draw_cell(pose, text, css, repetition, common)
        for pose, (_, text, css, repetition) in zip(turned, cells, strict=True)
    ]
    lead = words["poses_text"].format(angle=ANGLE_NAMES[name].render(language))
    return element("p", {"class": "lead"}, lead) + element("div", {"class": "poses"}, inner="".join(figures))


def _name(number: int, one: AssessedRepetition, words: Mapping[str, str]) -> str:
    return words["number_at"].format(number=number, time=format_time(one.repetition.start_s))


def _find_furthest(motion: CanonicalMotion, angle: FloatArray, start: int, end: int) -> tuple[int, int]:
    """Frames at which a repetition begins, and at which an angle is furthest from what it is then."""
    last = min(end, motion.n_frames)
    begin = min(start, last - 1)
    away = np.abs(angle[begin:last] - angle[begin])
    return begin, begin + (int(np.nanargmax(away)) if np.isfinite(away).any() else 0)


def _face(motion: CanonicalMotion, frame: int) -> FloatArray:
    """One pose (20, 3) over its own pelvis, in body lengths, facing the viewer, its lower foot on the floor."""
    pose = np.asarray(motion.positions[frame], np.float64) / measure_body(np.asarray(motion.positions, np.float64))
    pose = pose - pose[J["pelvis"]] * [1.0, 0.0, 1.0]
    return turn(pose - [0.0, float(np.nanmin(pose[:, 1])), 0.0], -compute_heading(pose))


def _choose_view(ways: Sequence[tuple[FloatArray, FloatArray]]) -> float:
    """Degrees from which the way from the first pose to the furthest one is longest in the picture."""
    shown = []
    for view in _VIEWS:
        gaps = [turn(pose - first, math.radians(view))[:, :2] for first, pose in ways]
        shown.append(float(np.nansum([np.linalg.norm(gap, axis=1).sum() for gap in gaps])))
    shown[0] *= 1.1  # the front wins ties
    return _VIEWS[int(np.argmax(shown))]


def _draw_cell(pose: FloatArray, text: str, css: str, repetition: str | None, common: Placement) -> str:
    svg = Svg(*_CELL, text, "figure pose")
    svg.line([(6.0, common.bottom), (_CELL[0] - 6.0, common.bottom)], "floor")
    draw_body(svg, pose, common, css)
    caption = element("span", {"class": "caption-text"}, text)
    if repetition is None:
        return element("div", {"class": "pose-cell"}, inner=svg.to_markup() + caption)
    tag = {"type": "button", "class": "pose-cell", "data-repetition": repetition}
    return element("button", tag, inner=svg.to_markup() + caption)
