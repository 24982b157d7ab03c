"""Figures of people: canonical joints turned towards the viewer and drawn as limbs, trunk and head; and the worst
moments, reference and performance side by side, the wrong limb marked twice."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dousa.app.report.markup import Svg
from dousa.arrays import FloatArray
from dousa.evaluation.grade.result import Assessment, ErrorEvent, FuriAssessment
from dousa.evaluation.posture.posture import LIMBS, SEGMENT_JOINTS, SEGMENTS
from dousa.evaluation.posture.yaw import estimate_robust_yaw, estimate_yaw
from dousa.evaluation.words import describe_segments, format_time
from dousa.motion import JOINT_INDEX as J

_LIMBS = (
    ("left_shoulder", "left_elbow", "left_wrist", "left_hand"),
    ("right_shoulder", "right_elbow", "right_wrist", "right_hand"),
    ("left_hip", "left_knee", "left_ankle", "left_toe"),
    ("right_hip", "right_knee", "right_ankle", "right_toe"),
)
_TRUNK = ("left_shoulder", "right_shoulder", "right_hip", "left_hip")
_HEAD_RADIUS = 0.075  # of the length that `measure_body` returns

# Shares of the stature: segment lengths and half widths of a grown person (after Winter 2009, table 4.1).
_LENGTHS = {"trunk": 0.288, "upper_arm": 0.186, "forearm": 0.146, "thigh": 0.245, "shank": 0.246}
_SHOULDER, _HIP, _NECK_TO_HEAD = 0.11, 0.055, 0.1


@dataclass(frozen=True, slots=True)
class Placement:
    """How metres become places on the drawing: ``x = left + scale * metres``, ``y = bottom - scale * metres``.

    Parameters
    ----------
    scale : units of the drawing per metre.
    left, bottom : where the origin lies.
    """

    scale: float
    left: float
    bottom: float

    def to_drawing(self, points: FloatArray) -> FloatArray:
        """(..., 2) places of (..., 3) m, seen along the depth axis."""
        out = np.empty((*points.shape[:-1], 2))
        out[..., 0] = self.left + self.scale * points[..., 0]
        out[..., 1] = self.bottom - self.scale * points[..., 1]
        return out


def compute_heading(points: FloatArray) -> float:
    """Heading of one pose (20, 3): rad from +Z towards the body's left; 0 if it cannot be told."""
    across = points[J["left_hip"]] - points[J["right_hip"]]
    across = across + points[J["left_shoulder"]] - points[J["right_shoulder"]]
    if not np.isfinite(across).all() or math.hypot(across[0], across[2]) < 1e-6:
        return 0.0
    return math.atan2(-across[2], across[0])


def turn(points: FloatArray, angle: float) -> FloatArray:
    """Points (..., 3) turned about the vertical by so many rad, to the left of a person who stands there."""
    cosine, sine = math.cos(angle), math.sin(angle)
    matrix = np.array([[cosine, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, cosine]])
    turned: FloatArray = points @ matrix.T
    return turned


def measure_body(positions: FloatArray) -> float:
    """Length of trunk, thigh and shank together over a motion (T, 20, 3), m: what figures are scaled by."""
    sample = positions[np.linspace(0, len(positions) - 1, min(len(positions), 32)).round().astype(int)]
    total = 0.0
    for start, end in (("pelvis", "neck"), ("left_hip", "left_knee"), ("left_knee", "left_ankle")):
        total += float(np.median(np.linalg.norm(sample[:, J[end]] - sample[:, J[start]], axis=1)))
    return total if math.isfinite(total) and total > 1e-6 else 1.0


def place(poses: Iterable[FloatArray], width: float, height: float, margin: float = 14.0) -> Placement:
    """One placement that shows all poses (K, 3) whole, standing on the lowest point of any of them."""
    points = np.concatenate([np.reshape(pose, (-1, 3)) for pose in poses])
    points = points[np.isfinite(points).all(axis=1)]
    if not len(points):
        return Placement(1.0, width / 2, height - margin)
    low, high = points.min(axis=0), points.max(axis=0)
    across, up = max(high[0] - low[0], 1e-6), max(high[1] - low[1] + 0.15, 1e-6)
    scale = min((width - 2 * margin) / across, (height - 2 * margin) / up)
    return Placement(scale, width / 2 - scale * (low[0] + high[0]) / 2, height - margin + scale * float(low[1]))


def _path(svg: Svg, places: FloatArray, names: Sequence[str], css_class: str) -> None:
    svg.line([(float(x), float(y)) for x, y in places[[J[name] for name in names]]], css_class)


def draw_body(svg: Svg, pose: FloatArray, placement: Placement, css_class: str, sides: str = "") -> None:
    """Draw one pose.

    Parameters
    ----------
    svg : to draw on.
    pose : (20, 3) m, turned already so that +Z is towards the viewer.
    placement : from `place`.
    css_class : ``"reference"``, ``"performance"`` ...: colour and width of the lines.
    sides : two letters, for left and right, that are written at the hands; empty for none.
    """
    places = placement.to_drawing(pose)
    if not np.isfinite(places).all():
        return
    trunk = places[[J[name] for name in _TRUNK]]
    svg.add("polygon", {"points": " ".join(f"{x:.1f},{y:.1f}" for x, y in trunk), "class": f"trunk {css_class}"})
    far_first = sorted(_LIMBS, key=lambda names: float(pose[[J[name] for name in names], 2].mean()))
    for names in far_first:
        _path(svg, places, names, f"limb {css_class}")
    _path(svg, places, ("neck", "head"), f"limb {css_class}")
    stature = float(np.linalg.norm(pose[J["neck"]] - pose[J["pelvis"]])) * 2.6
    radius = max(_HEAD_RADIUS * stature * placement.scale, 2.0)
    head = places[J["head"]]
    svg.add(
        "circle",
        {"cx": float(head[0]), "cy": float(head[1]), "r": float(radius), "class": f"head {css_class}"},
    )
    if sides:
        middle = float(places[J["neck"], 0])
        for letter, name in zip(sides, ("left_hand", "right_hand"), strict=True):
            x, y = (float(v) for v in places[J[name]])
            outward = 9.0 if x >= middle else -9.0
            svg.add("text", {"x": x + outward, "y": y + 4.0, "class": "side"}, letter)


def draw_limb(svg: Svg, pose: FloatArray, placement: Placement, segments: Iterable[str], css_class: str) -> None:
    """Draw some segments thick over a pose: an edge below, the class above it; ``"wrong"`` gets stripes too."""
    places = placement.to_drawing(pose)
    lines = [_ends(places, name) for name in segments]
    for layer in ("edge", css_class, *(("stripes",) if css_class == "wrong" else ())):
        for line in lines:
            svg.line(line, layer)


def _ends(places: FloatArray, segment: str) -> tuple[tuple[float, float], tuple[float, float]]:
    start, end = (places[J[name]] for name in SEGMENT_JOINTS[SEGMENTS.index(segment)])
    return (float(start[0]), float(start[1])), (float(end[0]), float(end[1]))


def hang_segments(segments: FloatArray) -> FloatArray:
    """A pose (20, 3) m of a typical person 1.7 m tall out of nine unit segments (9, 3) that face +Z.

    Hands and toes lie on wrists and ankles: the nine segments do not tell where they are.
    """
    size = np.linalg.norm(segments, axis=1, keepdims=True)
    unit = segments / np.where(size > 1e-9, size, 1.0)
    part = {name: unit[k] * _LENGTHS.get(name, 0.0) for k, name in enumerate(SEGMENTS)}
    for name in SEGMENTS[1:]:
        part[name] = unit[SEGMENTS.index(name)] * _LENGTHS[name.split("_", 1)[1]]
    left = np.array([1.0, 0.0, 0.0])
    pose = np.zeros((20, 3))
    pose[J["neck"]] = part["trunk"]
    pose[J["spine"]] = part["trunk"] / 2
    pose[J["head"]] = part["trunk"] + _NECK_TO_HEAD * unit[0]
    for sign, side in ((1.0, "left"), (-1.0, "right")):
        shoulder = pose[J["neck"]] + sign * _SHOULDER * left - 0.02 * unit[0]
        chain = (("shoulder", shoulder), ("hip", sign * _HIP * left))
        for root, start in chain:
            upper, lower, middle, end, tip = (
                ("upper_arm", "forearm", "elbow", "wrist", "hand")
                if root == "shoulder"
                else ("thigh", "shank", "knee", "ankle", "toe")
            )
            pose[J[f"{side}_{root}"]] = start
            pose[J[f"{side}_{middle}"]] = start + part[f"{side}_{upper}"]
            pose[J[f"{side}_{end}"]] = pose[J[f"{side}_{middle}"]] + part[f"{side}_{lower}"]
            pose[J[f"{side}_{tip}"]] = pose[J[f"{side}_{end}"]]
    hung: FloatArray = 1.7 * pose
    return hung


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


_VIEWS = (0.0, 30.0, -30.0, 60.0, -60.0)  # degrees towards the dancer's right; the front wins ties
_FRONT_BONUS = 1.1  # another view must show this many times more of the error
_PAIR = (420.0, 250.0)
_STRIP = (620.0, 250.0)
_LEAST_WAY, _LEAST_ARROW = 3.0, 24.0  # units of the drawing
_STRIP_STEPS_S = (-0.4, -0.2, 0.0, 0.2, 0.4)


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


def _draw_arrow(svg: Svg, poses: tuple[FloatArray, FloatArray], placement: Placement, segments: Sequence[str]) -> None:
    """From where the performance has a limb to where the reference has it: at the joint that is farthest off."""
    for line in _ghost(poses[0], poses[1], tuple(segments)):
        limb = next(members for members in LIMBS.values() if SEGMENTS.index(segments[0]) in members)
        names = [SEGMENTS[k] for k in limb if SEGMENTS[k] in segments]
        own = poses[1][[J[SEGMENT_JOINTS[SEGMENTS.index(name)][1]] for name in names]]
        ways = placement.to_drawing(line[1:]) - placement.to_drawing(own)
        lengths = np.linalg.norm(ways, axis=1)
        place = int(np.argmax(lengths))
        if not np.isfinite(lengths[place]) or lengths[place] < _LEAST_WAY:
            continue
        way = ways[place] / lengths[place]
        start = placement.to_drawing(own)[place] + 8.0 * way
        tip = start + max(lengths[place] - 8.0, _LEAST_ARROW) * way
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
    size: tuple[float, float] = _PAIR,
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
    _floor(svg, width, common.bottom)
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


def _floor(svg: Svg, width: float, y: float) -> None:
    svg.line([(8.0, y), (width - 8.0, y)], "floor")


def draw_strip(
    assessment: Assessment, event: ErrorEvent, view: MomentView, words: Mapping[str, str], language: str
) -> str:
    """Five moments around the worst one, reference above, performance below, as in the paper's figure 15."""
    width, height = _STRIP
    cell, row = width / len(_STRIP_STEPS_S), (height - 20.0) / 2
    pairs = [_poses_at(assessment, view, event.reference_s + step, event.worst_s + step) for step in _STRIP_STEPS_S]
    common = place([pose for pair in pairs for pose in pair], cell, row, 8.0)
    label = words["strip_label"].format(who=describe_segments(event.segments, language))
    svg = Svg(width, height, label, "figure strip")
    svg.add("rect", {"x": 2 * cell, "y": 0.0, "width": cell, "height": height, "rx": 6.0, "class": "strip-now"})
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
