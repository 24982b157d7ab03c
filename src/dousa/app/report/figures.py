"""Figures of the report: the axes of a furi, and the worst moments, reference and performance side by side."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dousa.app.drawing.body import (
    Placement,
    compute_heading,
    draw_body,
    draw_limb,
    hang_segments,
    measure_body,
    place,
    turn,
)
from dousa.app.drawing.markup import Svg
from dousa.arrays import FloatArray
from dousa.evaluation.grade.result import Assessment, ErrorEvent, FuriAssessment
from dousa.evaluation.posture.posture import LIMBS, SEGMENT_JOINTS, SEGMENTS
from dousa.evaluation.posture.yaw import estimate_robust_yaw, estimate_yaw
from dousa.evaluation.words import describe_segments, format_time
from dousa.motion import JOINT_INDEX as J

_DEVIATIONS = 2.0  # standard deviations to both sides: by definition of the normal, 19 frames of 20 lie within


@dataclass(frozen=True, slots=True)
class AxisSwing:
    """What moves along one eigen axis.

    Parameters
    ----------
    share : of the variance.
    segments : the ones that swing most, the greatest first.
    degrees : how far each swings from one end to the other.
    """

    share: float
    segments: tuple[str, ...]
    degrees: tuple[float, ...]

    def describe(self, language: str) -> str:
        """Say how far each segment swings."""
        swings = zip(self.segments, self.degrees, strict=True)
        return ", ".join(f"{describe_segments([name], language)} {degrees:.0f}°" for name, degrees in swings)


def count_axes(furi: FuriAssessment, most: int = 3) -> int:
    """How many axes are drawn, from 0."""
    return min(most, furi.n_dims)


def _along(furi: FuriAssessment, axis: int, deviations: float) -> FloatArray:
    """Unit segments (9, 3) so many standard deviations along an axis."""
    space = furi.eigenspace
    spread = math.sqrt(max(float(space.variances[axis]), 0.0))
    segments = np.reshape(space.mean, (9, 3)) + deviations * spread * np.reshape(space.axes[:, axis], (9, 3))
    size = np.linalg.norm(segments, axis=1, keepdims=True)
    unit: FloatArray = segments / np.where(size > 1e-9, size, 1.0)
    return unit


def compute_swings(furi: FuriAssessment) -> tuple[AxisSwing, ...]:
    """What moves along each of the axes that are drawn."""
    variances = np.asarray(furi.eigenspace.variances, float)
    total = variances.sum() / max(furi.contribution, 1e-12)
    swings = []
    for axis in range(count_axes(furi)):
        cosines = (_along(furi, axis, -_DEVIATIONS) * _along(furi, axis, _DEVIATIONS)).sum(axis=1)
        degrees = np.degrees(np.arccos(np.clip(cosines, -1.0, 1.0)))
        order = np.argsort(-degrees)[:3]
        swings.append(
            AxisSwing(
                float(variances[axis] / total) if total > 0 else 0.0,
                tuple(SEGMENTS[k] for k in order),
                tuple(float(degrees[k]) for k in order),
            )
        )
    return tuple(swings)


def estimate_mean_heading(assessment: Assessment, furi: FuriAssessment) -> float:
    """Heading of the mean posture, rad: nine segments have no front, but the frames they came from have."""
    reference = assessment.reference
    first = round(furi.reference_start_s * assessment.frame_rate)
    last = round(furi.reference_end_s * assessment.frame_rate) - 1
    frames = np.unique(np.linspace(first, max(last, first), 15).round().astype(int))
    frames = frames[(frames >= 0) & (frames < reference.n_frames)]
    if not len(frames):
        return 0.0
    mean = np.reshape(furi.eigenspace.mean, (9, 3))
    onto = estimate_yaw(mean, reference.segments[frames])
    headings = np.array([compute_heading(reference.positions[frame]) for frame in frames])
    return float(np.angle(np.exp(1j * (headings + onto)).sum()))


def draw_shapes(
    furi: FuriAssessment,
    heading: float,
    words: Mapping[str, str],
    language: str,
    size: tuple[float, float] = (130.0, 180.0),
) -> tuple[tuple[str, str], ...]:
    """Front and side of the mean posture, then of each axis: the mean and both ends. All in one scale.

    Parameters
    ----------
    furi : whose eigenspace.
    heading : of the mean posture, rad.
    words : texts of the page.
    language : of the names of segments.
    size : of each drawing.
    """
    mean = np.reshape(furi.eigenspace.mean, (9, 3))
    cells = [[mean]]
    for axis in range(count_axes(furi)):
        cells.append([mean, _along(furi, axis, -_DEVIATIONS), _along(furi, axis, _DEVIATIONS)])
    hung = [[hang_segments(turn(segments, -heading)) for segments in cell] for cell in cells]
    columns = []
    for side, azimuth in (("front", 0.0), ("side", math.pi / 2)):  # the viewer stands at the dancer's right
        turned = [[turn(pose, azimuth) for pose in cell] for cell in hung]
        placement = place([pose for cell in turned for pose in cell], *size, 9.0)
        drawn = []
        for k, (mean, *ends) in enumerate(turned):
            svg = Svg(*size, _label(furi, k, side, words, language), "figure shape")
            letters = words["sides"] if side == "front" and k == 0 else ""
            draw_body(svg, mean, placement, "mean behind" if ends else "mean", letters)
            for pose, name in zip(ends, ("minus", "plus"), strict=False):
                draw_body(svg, pose, placement, name)
            drawn.append(svg.to_markup())
        columns.append(drawn)
    return tuple(zip(*columns, strict=True))


def _label(furi: FuriAssessment, column: int, side: str, words: Mapping[str, str], language: str) -> str:
    view = words[f"view_{side}"]
    if column == 0:
        return f"{words['mean_posture']}, {view}"
    parts = compute_swings(furi)[column - 1].describe(language)
    return f"{words['axis'].format(number=column)}, {view}: {parts}"


def pick_worst(assessment: Assessment, count: int) -> tuple[int, ...]:
    """Places in ``assessment.events`` of the most severe ones, the worst first."""
    events = assessment.events
    order = sorted(range(len(events)), key=lambda k: -events[k].severity if math.isfinite(events[k].severity) else 0.0)
    return tuple(order[:count])


@dataclass(frozen=True, slots=True)
class MomentView:
    """How a moment is looked at.

    Parameters
    ----------
    turn_reference, turn_performance : rad about the vertical, so that both face the same way.
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
    # Recordings drift: a body far above or below the floor is put on it.
    pose = pose - [0.0, floor if abs(lowest - floor) < 0.5 else lowest, 0.0]
    return turn(pose, angle)


def view_moment(
    assessment: Assessment,
    event: ErrorEvent,
    views: Sequence[float] = (0.0, 30.0, -30.0, 60.0, -60.0),
    bonus: float = 1.1,
) -> MomentView:
    """Turn both dancers to the viewer, and stand where the wrong segments differ most.

    Parameters
    ----------
    assessment, event : what is shown.
    views : degrees towards the dancer's right, the front first.
    bonus : how many times more of the error another view than the front must show.
    """
    reference, performance = assessment.reference, assessment.performance
    one = _frame(assessment, event.reference_s, reference.n_frames)
    two = _frame(assessment, event.worst_s, performance.n_frames)
    heading = compute_heading(reference.positions[one])
    onto, _ = estimate_robust_yaw(reference.segments[one], performance.segments[two])
    turn_reference, turn_performance = -heading, -heading + float(onto)
    wrong = [SEGMENTS.index(name) for name in event.segments] or list(range(len(SEGMENTS)))
    gap = turn(performance.segments[two], turn_performance) - turn(reference.segments[one], turn_reference)
    seen = [float(np.linalg.norm(turn(gap[wrong], math.radians(view))[:, :2])) for view in views]
    seen[0] *= bonus
    return MomentView(turn_reference, turn_performance, views[int(np.argmax(seen))])


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


def _draw_arrow(svg: Svg, poses: tuple[FloatArray, FloatArray], placement: Placement, segments: Sequence[str]) -> None:
    """From where the performance has a limb to where the reference has it: at the joint that is farthest off."""
    for line in _ghost(poses[0], poses[1], tuple(segments)):
        limb = next(members for members in LIMBS.values() if SEGMENTS.index(segments[0]) in members)
        names = [SEGMENTS[k] for k in limb if SEGMENTS[k] in segments]
        own = poses[1][[J[SEGMENT_JOINTS[SEGMENTS.index(name)][1]] for name in names]]
        ways = placement.to_drawing(line[1:]) - placement.to_drawing(own)
        lengths = np.linalg.norm(ways, axis=1)
        place = int(np.argmax(lengths))
        if not np.isfinite(lengths[place]) or lengths[place] < 3.0:
            continue
        way = ways[place] / lengths[place]
        start = placement.to_drawing(own)[place] + 8.0 * way
        tip = start + max(lengths[place] - 8.0, 24.0) * way
        side = np.array([-way[1], way[0]])
        head = np.array([tip, tip - 11.0 * way + 6.0 * side, tip - 11.0 * way - 6.0 * side])
        for layer in ("arrow-edge", "arrow"):
            svg.line([(float(x), float(y)) for x, y in (start, tip - 8.0 * way)], layer)
        svg.add("polygon", {"points": " ".join(f"{x:.1f},{y:.1f}" for x, y in head), "class": "arrow-head"})


def draw_moment(
    assessment: Assessment,
    event: ErrorEvent,
    view: MomentView,
    words: Mapping[str, str],
    language: str,
    *,
    size: tuple[float, float] = (420.0, 250.0),
    arrows: Sequence[Sequence[str]] = (),
) -> str:
    """Both poses at the worst moment of an event, as an inline drawing.

    Parameters
    ----------
    assessment, event : what is shown.
    view : from `view_moment`.
    words : texts of the page.
    language : of the names of segments.
    size : of the drawing.
    arrows : segments of each limb at which an arrow shows where it should go.
    """
    poses = _poses_at(assessment, view, event.reference_s, event.worst_s)
    width, height = size
    common = place(poses, width / 2, height - 24.0, 16.0)
    right = Placement(common.scale, common.left + width / 2, common.bottom)
    label = words["moment_label"].format(
        who=describe_segments(event.segments, language), says=event.says.render(language)
    )
    svg = Svg(width, height, label, "figure")
    svg.line([(8.0, common.bottom), (width - 8.0, common.bottom)], "floor")
    _draw_pair(svg, poses, (common, right), event.segments, words["sides"])
    for segments in arrows:
        _draw_arrow(svg, poses, right, segments)
    for x, name, seconds in (
        (width / 4, "reference", event.reference_s),
        (3 * width / 4, "performance", event.worst_s),
    ):
        text = f"{words[name]} {format_time(seconds)}"
        svg.add("text", {"x": x, "y": height - 6.0, "class": "caption"}, text)
    return svg.to_markup()


def draw_strip(
    assessment: Assessment, event: ErrorEvent, view: MomentView, words: Mapping[str, str], language: str
) -> str:
    """Five moments around the worst one, reference above, performance below, as in the paper's figure 15."""
    width, height, steps_s = 620.0, 250.0, (-0.4, -0.2, 0.0, 0.2, 0.4)
    cell, row = width / len(steps_s), (height - 20.0) / 2
    pairs = [_poses_at(assessment, view, event.reference_s + step, event.worst_s + step) for step in steps_s]
    common = place([pose for pair in pairs for pose in pair], cell, row, 8.0)
    label = words["strip_label"].format(who=describe_segments(event.segments, language))
    svg = Svg(width, height, label, "figure strip")
    svg.add("rect", {"x": 2 * cell, "y": 0.0, "width": cell, "height": height, "rx": 6.0, "class": "strip-now"})
    for k, (pair, step) in enumerate(zip(pairs, steps_s, strict=True)):
        top = Placement(common.scale, common.left + k * cell, common.bottom)
        low = Placement(common.scale, top.left, common.bottom + row)
        _draw_pair(svg, pair, (top, low), event.segments, "")
        text = format_time(event.worst_s + step) if step == 0 else f"{step:+.1f} s".replace("-", "−")
        svg.add("text", {"x": (k + 0.5) * cell, "y": height - 5.0, "class": "caption"}, text)
    return svg.to_markup()


def compute_residuals(assessment: Assessment, event: ErrorEvent) -> FloatArray:
    """(9,) deg, angle of each segment to the reference's at the worst moment."""
    frame = _frame(assessment, event.worst_s, assessment.performance.n_frames)
    degrees: FloatArray = np.degrees(assessment.residual[frame])
    return degrees
