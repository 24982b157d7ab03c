"""What a furi consists of: its mean posture and first eigen axes, projected back into figures.

Source: Yamane and Shakunaga, figures 9, 11 and 13.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from dousa.app.report._figures import Placement, compute_heading, draw_body, hang_segments, place, turn
from dousa.app.report._svg import Svg
from dousa.evaluation._types import Assessment, FuriAssessment
from dousa.evaluation.posture import SEGMENTS
from dousa.evaluation.words import describe_segments
from dousa.evaluation.yaw import estimate_yaw
from dousa.motion._types import FloatArray

__all__ = ["AxisSwing", "compute_swings", "count_axes", "draw_shapes", "estimate_mean_heading"]

_SHOWN_AXES = 3
_DEVIATIONS = 2.0  # standard deviations to both sides, as far as the reference goes in 19 frames of 20
_SIZE = (130.0, 180.0)
_MARGIN = 9.0
_SIDE = math.pi / 2  # the viewer stands at the dancer's right


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


def count_axes(furi: FuriAssessment) -> int:
    """How many axes are drawn, 0 to 3."""
    return min(_SHOWN_AXES, furi.n_dims)


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
    furi: FuriAssessment, heading: float, words: Mapping[str, str], language: str
) -> tuple[tuple[str, str], ...]:
    """Front and side of the mean posture, then of each axis: the mean and both ends. All in one scale.

    Parameters
    ----------
    furi : whose eigenspace.
    heading : of the mean posture, rad.
    words : texts of the page.
    language : of the names of segments.
    """
    mean = np.reshape(furi.eigenspace.mean, (9, 3))
    cells = [[mean]]
    for axis in range(count_axes(furi)):
        cells.append([mean, _along(furi, axis, -_DEVIATIONS), _along(furi, axis, _DEVIATIONS)])
    hung = [[hang_segments(turn(segments, -heading)) for segments in cell] for cell in cells]
    columns = []
    for side, azimuth in (("front", 0.0), ("side", _SIDE)):
        turned = [[turn(pose, azimuth) for pose in cell] for cell in hung]
        placement = place([pose for cell in turned for pose in cell], *_SIZE, _MARGIN)
        letters = words["sides"] if side == "front" else ""
        columns.append(
            [
                _draw_cell(cell, placement, _label(furi, k, side, words, language), letters if k == 0 else "")
                for k, cell in enumerate(turned)
            ]
        )
    return tuple(zip(*columns, strict=True))


def _draw_cell(poses: list[FloatArray], placement: Placement, label: str, sides: str) -> str:
    svg = Svg(*_SIZE, label, "figure shape")
    draw_body(svg, poses[0], placement, "mean" if len(poses) == 1 else "mean behind", sides)
    for pose, name in zip(poses[1:], ("minus", "plus"), strict=False):
        draw_body(svg, pose, placement, name)
    return svg.to_markup()


def _label(furi: FuriAssessment, column: int, side: str, words: Mapping[str, str], language: str) -> str:
    view = words[f"view_{side}"]
    if column == 0:
        return f"{words['mean_posture']}, {view}"
    swing = compute_swings(furi)[column - 1]
    parts = ", ".join(
        f"{describe_segments([name], language)} {degrees:.0f}°"
        for name, degrees in zip(swing.segments, swing.degrees, strict=True)
    )
    return f"{words['axis'].format(number=column)}, {view}: {parts}"
