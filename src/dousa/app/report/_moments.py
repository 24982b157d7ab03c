"""The worst moments as pictures: reference and performance side by side, the wrong limb marked twice."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from dousa.app.report._figures import (
    Placement,
    compute_heading,
    draw_body,
    draw_limb,
    measure_body,
    place,
    turn,
)
from dousa.app.report._svg import Svg
from dousa.evaluation._types import Assessment, ErrorEvent
from dousa.evaluation.posture import LIMBS, SEGMENT_JOINTS, SEGMENTS
from dousa.evaluation.words import describe_segments, format_time
from dousa.evaluation.yaw import estimate_robust_yaw
from dousa.motion import JOINT_INDEX as J
from dousa.motion._types import FloatArray

__all__ = ["MomentView", "compute_residuals", "draw_moment", "draw_strip", "pick_worst", "view_moment"]

_VIEWS = (0.0, 30.0, -30.0, 60.0, -60.0)  # degrees towards the dancer's right; the front wins ties
_FRONT_BONUS = 1.1  # another view must show this many times more of the error
_PAIR = (420.0, 250.0)
_STRIP = (620.0, 250.0)
_STRIP_STEPS_S = (-0.4, -0.2, 0.0, 0.2, 0.4)


def pick_worst(assessment: Assessment, count: int) -> tuple[int, ...]:
    """Places in ``assessment.events`` of the most severe ones, the worst first."""
    events = assessment.events
    order = sorted(
        range(len(events)), key=lambda k: -events[k].severity if math.isfinite(events[k].severity) else 0.0
    )
    return tuple(order[:count])


@dataclass(frozen=True, slots=True)
class MomentView:
    """How a moment is looked at.

    Parameters
    ----------
    turn_reference, turn_performance : rad about the vertical, so that both face alike.
    azimuth : where the viewer stands, degrees from the front towards the dancer's right.
    """

    turn_reference: float
    turn_performance: float
    azimuth: float


def _frame(assessment: Assessment, seconds: float, n_frames: int) -> int:
    at = round(seconds * assessment.frame_rate) if math.isfinite(seconds) else 0
    return min(max(at, 0), n_frames - 1)


def _pose(positions: FloatArray, frame: int, size: float, angle: float) -> FloatArray:
    """One pose over its own pelvis, in body lengths, turned; heights stay those over the floor."""
    pose = positions[frame] / size
    pose = pose - pose[J["pelvis"]] * [1.0, 0.0, 1.0]
    feet = positions[:, [J["left_ankle"], J["right_ankle"], J["left_toe"], J["right_toe"]], 1].min(axis=1)
    floor = float(np.percentile(feet[:: max(len(feet) // 500, 1)], 2)) / size
    lowest = float(pose[:, 1].min())
    # Recordings drift: somebody far above or below the floor is put on it.
    pose = pose - [0.0, floor if abs(lowest - floor) < 0.5 else lowest, 0.0]
    return turn(pose, angle)


def view_moment(assessment: Assessment, event: ErrorEvent) -> MomentView:
    """Turn both dancers to the viewer, and stand where the wrong segments differ most."""
    reference, performance = assessment.reference, assessment.performance
    one = _frame(assessment, event.reference_s, reference.n_frames)
    two = _frame(assessment, event.worst_s, performance.n_frames)
    heading = compute_heading(reference.positions[one])
    onto, _ = estimate_robust_yaw(reference.segments[one], performance.segments[two])
    turn_reference, turn_performance = -heading, -heading + float(onto)
    wrong = [SEGMENTS.index(name) for name in event.segments] or list(range(len(SEGMENTS)))
    gap = turn(performance.segments[two], turn_performance) - turn(reference.segments[one], turn_reference)
    seen = [float(np.linalg.norm(turn(gap[wrong], math.radians(view))[:, :2])) for view in _VIEWS]
    seen[0] *= _FRONT_BONUS
    return MomentView(turn_reference, turn_performance, _VIEWS[int(np.argmax(seen))])


def _poses_at(
    assessment: Assessment, view: MomentView, reference_s: float, performance_s: float
) -> tuple[FloatArray, FloatArray]:
    """Both poses as the viewer sees them, in body lengths."""
    azimuth = math.radians(view.azimuth)
    out = []
    for sequence, seconds, angle in (
        (assessment.reference, reference_s, view.turn_reference),
        (assessment.performance, performance_s, view.turn_performance),
    ):
        frame = _frame(assessment, seconds, sequence.n_frames)
        size = measure_body(sequence.positions)
        out.append(_pose(sequence.positions, frame, size, angle + azimuth))
    return out[0], out[1]


def _ghost(reference: FloatArray, performance: FloatArray, segments: tuple[str, ...]) -> list[FloatArray]:
    """Lines of the reference's limbs, hung where the performance's limbs begin."""
    lines = []
    for members in LIMBS.values():
        names = [SEGMENTS[k] for k in members if SEGMENTS[k] in segments]
        if names:
            joints = [SEGMENT_JOINTS[SEGMENTS.index(names[0])][0]]
            joints += [SEGMENT_JOINTS[SEGMENTS.index(name)][1] for name in names]
            line = reference[[J[name] for name in joints]]
            lines.append(line - line[0] + performance[J[joints[0]]])
    return lines


def _draw_pair(
    svg: Svg,
    poses: tuple[FloatArray, FloatArray],
    placements: tuple[Placement, Placement],
    segments: tuple[str, ...],
    sides: str,
) -> None:
    """Reference and performance; few wrong segments are marked, and dashed as they should be."""
    draw_body(svg, poses[0], placements[0], "reference", sides)
    whole = not 0 < len(segments) < len(SEGMENTS)
    if whole:
        draw_body(svg, poses[0], placements[1], "ghost-body")
    draw_body(svg, poses[1], placements[1], "performance", sides)
    if whole:
        return
    draw_limb(svg, poses[0], placements[0], segments, "shown")
    draw_limb(svg, poses[1], placements[1], segments, "wrong")
    for line in _ghost(poses[0], poses[1], segments):
        svg.line([(float(x), float(y)) for x, y in placements[1].to_drawing(line)], "ghost")


def draw_moment(
    assessment: Assessment, event: ErrorEvent, view: MomentView, words: Mapping[str, str], language: str
) -> str:
    """Both poses at the worst moment of an event, as an inline drawing."""
    poses = _poses_at(assessment, view, event.reference_s, event.worst_s)
    width, height = _PAIR
    common = place(poses, width / 2, height - 24.0, 16.0)
    right = Placement(common.scale, common.left + width / 2, common.bottom)
    label = words["moment_label"].format(who=describe_segments(event.segments, language), says=event.says)
    svg = Svg(width, height, label, "figure")
    _floor(svg, width, common.bottom)
    _draw_pair(svg, poses, (common, right), event.segments, words["sides"])
    for x, name, seconds in (
        (width / 4, "reference", event.reference_s),
        (3 * width / 4, "performance", event.worst_s),
    ):
        text = f"{words[name]} {format_time(seconds)}"
        svg.add("text", {"x": x, "y": height - 6.0, "class": "caption"}, text)
    return svg.to_markup()


def _floor(svg: Svg, width: float, y: float) -> None:
    svg.line([(8.0, y), (width - 8.0, y)], "floor")


def draw_strip(
    assessment: Assessment, event: ErrorEvent, view: MomentView, words: Mapping[str, str], language: str
) -> str:
    """Five moments around the worst one, reference above, performance below, as in the paper's figure 15."""
    width, height = _STRIP
    cell, row = width / len(_STRIP_STEPS_S), (height - 20.0) / 2
    pairs = [
        _poses_at(assessment, view, event.reference_s + step, event.worst_s + step) for step in _STRIP_STEPS_S
    ]
    common = place([pose for pair in pairs for pose in pair], cell, row, 8.0)
    label = words["strip_label"].format(who=describe_segments(event.segments, language))
    svg = Svg(width, height, label, "figure strip")
    svg.add(
        "rect", {"x": 2 * cell, "y": 0.0, "width": cell, "height": height, "rx": 6.0, "class": "strip-now"}
    )
    for k, (pair, step) in enumerate(zip(pairs, _STRIP_STEPS_S, strict=True)):
        top = Placement(common.scale, common.left + k * cell, common.bottom)
        low = Placement(common.scale, top.left, common.bottom + row)
        _draw_pair(svg, pair, (top, low), event.segments, "")
        svg.add(
            "text",
            {"x": (k + 0.5) * cell, "y": height - 5.0, "class": "caption"},
            format_time(event.worst_s + step) if step == 0 else f"{step:+.1f} s".replace("-", "−"),
        )
    return svg.to_markup()


def compute_residuals(assessment: Assessment, event: ErrorEvent) -> FloatArray:
    """(9,) deg, angle of each segment to the reference's at the worst moment."""
    frame = _frame(assessment, event.worst_s, assessment.performance.n_frames)
    degrees: FloatArray = np.degrees(assessment.residual[frame])
    return degrees
