"""A performance against its reference, from joints to a grade.

postures -> lines -> deviations over time and lag -> stretches that differ -> what explains them
         -> figures, their eigenspaces, d# and d* over time
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from dousa.arrays import FloatArray
from dousa.errors import InvalidMotionError, OptionError
from dousa.evaluation.alignment.lines import find_lapses
from dousa.evaluation.alignment.pairing import Pairing, find_resembled, pair_motions, turn_takes
from dousa.evaluation.errors.evidence import Evidence, Tolerance, gather_evidence, refine_lag
from dousa.evaluation.errors.faults import WELL, describe_repetition, find_faults
from dousa.evaluation.errors.findings import Finding
from dousa.evaluation.figures.curves import Curves, compute_curves
from dousa.evaluation.figures.eigenspace import Eigenspace
from dousa.evaluation.figures.furi import Furi, find_furi, fit_furi_eigenspaces, pool_takes, scale_furi
from dousa.evaluation.grade.movement import compare_movements, describe_movement, find_side
from dousa.evaluation.grade.references import (
    Comparison,
    ReferenceTakes,
    choose_tolerance,
    compare,
    find_errors,
    prepare_references,
)
from dousa.evaluation.grade.result import (
    Assessment,
    FuriAssessment,
    describe_findings,
    describe_gaps,
    describe_offset,
    describe_warnings,
    name_joints,
)
from dousa.evaluation.grade.score import find_well, grade_performance
from dousa.evaluation.posture.posture import (
    SEGMENTS,
    PostureSequence,
    Working,
    compute_postures,
    find_lacking,
    mirror_postures,
    spread_weights,
    thin_postures,
)
from dousa.evaluation.posture.range_of_motion import compute_joint_angles
from dousa.evaluation.posture.yaw import take_out_of_postures
from dousa.motion import CanonicalMotion
from dousa.motion.runs import find_runs

_UNLIKE, _FAILING_S = 2.0, 0.3  # mean squared multiple of what is tolerated, and for how long


def assess(
    reference: CanonicalMotion | Sequence[CanonicalMotion],
    performance: CanonicalMotion,
    *,
    furi: Sequence[Furi] | None = None,
    side: str = "auto",
    tempo: str = "same",
    weights: Mapping[str, float] | None = None,
    names: Sequence[str] = (),
) -> Assessment:
    """Say what differs between a performance and its reference, where, and by how much.

    Parameters
    ----------
    reference : one take, or several takes of the same dance. The first gives the clock and the figures; what
        differs between the takes is tolerated. Three make a calibrated grade, five a good one.
    performance : what is judged; any frame rate, place, heading and stature.
    furi : figures in frames of the first reference at its own rate; found by themselves if None.
    side : ``"mirrored"`` for a pupil who dances facing the teacher, left for right, ``"same"`` for one who does not;
        ``"auto"``: found by itself, and said.
    tempo : ``"same"``: to the same music, being late is an error; ``"free"``: only hurrying and lagging within a
        few seconds is.
    weights : of segments, limbs, ``arms`` or ``legs``; 1 for those not named.
    names : of the references and, last, of the performance.

    Returns
    -------
    The assessment: curves, figures, events, lapses and the grade.

    Raises
    ------
    InvalidMotionError : a motion shorter than half a second, or seen for less; no reference.
    OptionError : an unknown side, tempo, segment, or a weight below 0; furi outside the reference.

    Source: Yamane and Shakunaga; the four classes and all numbers with a unit go beyond the paper, see
    docs/evaluation.md.
    """
    takes = [reference] if isinstance(reference, CanonicalMotion) else list(reference)
    shares = spread_weights(weights)
    postures, played, side = settle_side(takes, performance, side=side, tempo=tempo, names=names)
    check_common(shares, postures, played)
    references = prepare_references(postures, tempo, shares)
    figures = scale_furi(furi, takes[0], references.postures) if furi else find_furi(references.postures)
    return name_faults(references, judge(references, figures, played, side=side, tempo=tempo, weights=shares))


def settle_side(
    takes: Sequence[CanonicalMotion], performance: CanonicalMotion, *, side: str, tempo: str, names: Sequence[str] = ()
) -> tuple[list[PostureSequence], PostureSequence, str]:
    """`compute_all_postures`, and ``"same"`` or ``"mirrored"``, found by itself if the side is ``"auto"``."""
    asked = "same" if side == "auto" else side
    postures, played = compute_all_postures(takes, performance, side=asked, tempo=tempo, names=names)
    if side == "auto" and find_side(postures, played) == "mirrored":
        return postures, mirror_postures(played), "mirrored"
    return postures, played, asked


def compute_all_postures(
    takes: Sequence[CanonicalMotion],
    performance: CanonicalMotion,
    *,
    side: str,
    tempo: str,
    names: Sequence[str] = (),
) -> tuple[list[PostureSequence], PostureSequence]:
    """Compute postures of the takes and of the performance, at its rate, mirrored on request.

    Raises
    ------
    InvalidMotionError, OptionError : as `assess`.
    """
    check_takes(takes, performance, side, tempo)
    titles = [*names, *[""] * (len(takes) + 1 - len(names))]
    played = compute_postures(performance, name=titles[len(takes)])
    if side == "mirrored":
        played = mirror_postures(played)
    check_seen(played, is_reference=False)
    rate = played.frame_rate
    postures = [compute_postures(take, rate, name) for take, name in zip(takes, titles, strict=False)]
    for take in postures:
        check_seen(take, is_reference=True)
    return postures, played


def check_common(weights: FloatArray, takes: Sequence[PostureSequence], performance: PostureSequence) -> None:
    """Say that no segment of weights (9,) above 0 is shown by the performance and all takes."""
    if not (weights * ~find_lacking((*takes, performance))).any():
        raise InvalidMotionError("evaluation.nothing_common")


def judge(
    references: ReferenceTakes,
    furi: Sequence[Furi],
    performance: PostureSequence,
    *,
    side: str = "same",
    tempo: str,
    weights: FloatArray,
) -> Assessment:
    """Assess a performance against references that are ready, but for `name_faults`; weights (9,) of mean 1."""
    comparison, performance = compare_bodies(references, performance, tempo, weights)
    weighed = weigh(references, performance, comparison, weights)
    spaces = fit_furi_eigenspaces(references.postures, furi, more=pool_takes(references.warped, furi))
    return look_at_figures(references, furi, spaces, performance, weighed, side=side, tempo=tempo)


def compare_bodies(
    references: ReferenceTakes, performance: PostureSequence, tempo: str, weights: FloatArray
) -> tuple[Comparison, PostureSequence]:
    """Compare a performance with the takes, and remove the offset of its body."""
    working = thin_postures(performance)
    comparison = compare(references.working, working, tempo, weights, references.between)
    ours = describe_movement(performance)
    comparison = replace(comparison, movement=tuple(compare_movements(one, ours) for one in references.movements))
    return comparison, take_out_of_postures(performance, working, comparison.offset)


@dataclass(frozen=True, slots=True, eq=False)
class Weighed:
    """What a performance has been found to do wrong before its figures are looked at."""

    comparison: Comparison  # with the takes of the reference
    weights: FloatArray  # (9,) of the segments, those above 0 of mean 1
    tolerance: Tolerance  # of angles and lags
    findings: tuple[Finding, ...]  # errors, in frames at the working rate
    same: FloatArray  # (T,) s, reference time if the tempo is kept
    matched: FloatArray  # (T,) s, reference time that is resembled
    lag: FloatArray  # (T,) s, same less matched
    pairing: Pairing  # both motions at the same moments


def weigh(
    references: ReferenceTakes, performance: PostureSequence, comparison: Comparison, weights: FloatArray
) -> Weighed:
    """Find the errors of a performance from its comparison with the takes; weights (9,), those above 0 of mean 1."""
    tolerance = choose_tolerance(comparison.deviations)
    return _weigh(references, performance, comparison, tolerance, weights, None)


def reweigh(before: Weighed, references: ReferenceTakes, performance: PostureSequence, weights: FloatArray) -> Weighed:
    """Find the errors with other weights (9,) and the turns of the bodies from before: quick, nearly exact."""
    return _weigh(references, performance, before.comparison, before.tolerance, weights, before.pairing)


def _weigh(
    references: ReferenceTakes,
    performance: PostureSequence,
    comparison: Comparison,
    tolerance: Tolerance,
    weights: FloatArray,
    pairing: Pairing | None,
) -> Weighed:
    evidence = gather_evidence(comparison.deviations, tolerance.angle, tolerance.lag_s, weights)
    first, working = references.postures, thin_postures(performance)
    same, matched, lag = _make_clocks(comparison, evidence, working, performance, first)
    findings = tuple(find_errors(references, comparison.alignment.frames, evidence))
    del evidence  # what differs at the working rate is not held beside all poses of both
    if pairing is None:
        pairing = pair_motions(first, turn_takes(first, references.warped), performance, same, matched)
    else:
        late_frames, late_yaw = find_resembled(first, performance, matched, pairing.frames, pairing.yaw)
        pairing = replace(pairing, late_frames=late_frames, late_yaw=late_yaw)
    return Weighed(comparison, weights, tolerance, findings, same, matched, lag, pairing)


def look_at_figures(
    references: ReferenceTakes,
    furi: Sequence[Furi],
    spaces: Mapping[str, Eigenspace],
    performance: PostureSequence,
    weighed: Weighed,
    *,
    side: str,
    tempo: str,
) -> Assessment:
    """Assess the figures of a performance with known errors; ``spaces`` are those of the figures, by label."""
    working = thin_postures(performance)
    comparison, tolerance, weights = weighed.comparison, weighed.tolerance, weighed.weights
    same, matched = weighed.same, weighed.matched
    curves = compute_curves(
        references.postures, references.warped, performance, same, matched, furi, spaces, weighed.pairing
    )
    lapses = find_lapses(comparison.alignment, references.working[0], working)
    events = describe_findings(
        weighed.findings,
        lapses,
        working=working,
        same_time=same,
        residual=curves.residual,
        facing=curves.facing,
        furi_index=curves.furi_index,
    )
    grade = grade_performance(references, comparison.movement, weights)
    return Assessment(
        frame_rate=performance.frame_rate,
        reference=references.postures,
        performance=performance,
        same_time=same,
        matched_time=matched,
        lag=weighed.lag,
        facing=curves.facing,
        d_space=curves.d_space,
        d_within=curves.d_within,
        d_path=curves.d_path,
        d_space_limit=_limit(tolerance, curves.d_space_reference, same),
        d_within_limit=_limit(tolerance, curves.d_within_reference, same),
        residual=curves.residual,
        residual_limit=tolerance.angle,
        path=_make_path(matched, references.postures),
        furi=_assess_furi(furi, spaces, curves, comparison, references, performance, working, weights),
        events=events,
        lapses=lapses,
        score=grade.score,
        score_formula=grade.formula,
        calibrated=grade.calibrated,
        n_references=len(references.working),
        tempo=comparison.alignment.tempo,
        coverage=grade.coverage,
        score_interval=grade.interval,
        weights=weights,
        offset_deg=comparison.offset.degrees,
        gaps=describe_gaps(performance),
        not_judged=tuple(SEGMENTS[index] for index in np.flatnonzero(comparison.offset.missing)),
        warnings=(
            *describe_warnings(
                references,
                furi,
                performance,
                working,
                comparison,
                curves,
                tempo,
                weights,
                side,
                unlike=grade.formula.code == "grade.unlike",
            ),
            *describe_offset(comparison.offset, references.working[0]),
        ),
        side=side,
    )


def name_faults(references: ReferenceTakes, found: Assessment) -> Assessment:
    """Name the joints at fault in a single movement, such as an exercise, that is not done well."""
    if not is_single(found, WELL) or not math.isfinite(found.furi[0].start_s):
        return found
    well = find_well(references, found.weights)
    if not is_single(found, well):
        return found
    start, end = (round(time * found.frame_rate) for time in (found.furi[0].start_s, found.furi[0].end_s))
    ours, *theirs = (
        describe_repetition(one, compute_joint_angles(one), *span)
        for one, span in (
            (found.performance, (start, end)),
            *((take, (0, take.n_frames)) for take in (references.postures, *references.warped)),
        )
    )
    judged = (found.weights > 0.0) & ~np.isin(SEGMENTS, found.not_judged)
    return name_joints(found, find_faults(ours, theirs, len(theirs), grade=found.score, well=well, judged=judged))


def is_single(found: Assessment, well: float) -> bool:
    """Whether a performance is a single movement, and not graded as done well, or unlike the reference."""
    return len(found.furi) == 1 and (found.score < well or found.score_formula.code == "grade.unlike")


def _make_clocks(
    comparison: Comparison,
    evidence: Evidence,
    working: Working,
    performance: PostureSequence,
    reference: PostureSequence,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(T,) s: reference time of the straight lines, reference time that is resembled, and the lag."""
    center = np.arange(working.n_frames) * working.stride + 0.5 * (working.stride - 1)
    frames = np.arange(performance.n_frames)
    same = np.empty(performance.n_frames)
    rate = performance.frame_rate
    # Line by line: between two lines there is a jump, not a slope.
    runs = comparison.alignment.runs
    starts = [0] + [run.start for run in runs[1:]]
    ends = [*starts[1:], working.n_frames]
    for start, end in zip(starts, ends, strict=True):
        last = performance.n_frames if end == working.n_frames else end * working.stride
        span = frames[start * working.stride : last]
        there = comparison.alignment.frames[start:end] * working.stride + 0.5 * (working.stride - 1)
        slope = (there[-1] - there[0]) / max(center[end - 1] - center[start], 1e-9) if end - start > 1 else 1.0
        line = np.interp(span, center[start:end], there)
        line += slope * (np.minimum(span - center[start], 0.0) + np.maximum(span - center[end - 1], 0.0))
        same[span] = line / rate
    lag = np.interp(frames, center, _measure_lag(evidence))
    end_s = (reference.n_frames - 1) / reference.frame_rate
    inside = (same >= -0.5 / rate) & (same <= end_s + 0.5 / rate)
    same = np.where(inside, np.clip(same, 0.0, end_s), np.nan)
    lag = np.where(inside, lag, np.nan)
    return same, np.clip(same - np.nan_to_num(lag), 0.0, end_s), lag


def _measure_lag(evidence: Evidence) -> FloatArray:
    """(T,) s, at the working rate; nan where no moment nearby is resembled: there the correspondence has failed."""
    beyond = np.abs(evidence.course - evidence.center) > evidence.slack
    course = np.where(beyond, evidence.course, evidence.near)
    unlike = evidence.ratio.at_lag(course).mean(axis=1)
    window = np.ones(2 * round(0.5 * _FAILING_S * evidence.rate) + 1)
    unlike = np.convolve(unlike, window / len(window), mode="same")[: len(unlike)]
    unknown = (unlike > _UNLIKE) | ~evidence.deviations.judged.any(axis=1)
    return np.where(unknown, np.nan, refine_lag(evidence, course))


def _limit(tolerance: Tolerance, among: FloatArray, same_time: FloatArray, *, above: float = 1.05) -> FloatArray:
    """(T,) limit of a distance: what all segments at half of their tolerance come to; no take is beyond it."""
    # above: rounding, and frames between frames
    least = float(np.linalg.norm(tolerance.angle)) / 2.0
    shown = float(np.nanmax(among)) if np.isfinite(among).any() else 0.0
    return np.where(np.isfinite(same_time), max(least, above * shown), np.nan)


def _make_path(matched: FloatArray, reference: PostureSequence) -> np.ndarray:
    frames = np.flatnonzero(np.isfinite(matched))
    there = np.rint(matched[frames] * reference.frame_rate).astype(np.intp)
    return np.column_stack([frames, np.clip(there, 0, reference.n_frames - 1)])


def _assess_furi(
    furi: Sequence[Furi],
    spaces: Mapping[str, Eigenspace],
    curves: Curves,
    comparison: Comparison,
    references: ReferenceTakes,
    performance: PostureSequence,
    working: Working,
    weights: FloatArray,
) -> tuple[FuriAssessment, ...]:
    rate = performance.frame_rate
    thinned = curves.furi_index[:: working.stride][: working.n_frames]
    result = []
    for number, one in enumerate(furi):
        spans = find_runs(curves.furi_index == number).tolist()
        longest = max(spans, key=lambda span: span[1] - span[0], default=None)
        score = grade_performance(references, comparison.movement, weights, thinned == number).score
        result.append(
            FuriAssessment(
                start_s=longest[0] / rate if longest else np.nan,
                end_s=longest[1] / rate if longest else np.nan,
                reference_start_s=one.start / rate,
                reference_end_s=one.end / rate,
                label=one.label,
                eigenspace=spaces[one.label],
                gain=curves.gain[number],
                lag_s=float(curves.lag_by_furi[number]),
                score=score,
            )
        )
    return tuple(result)


SHORTEST_S, FEWEST_FRAMES = 0.5, 3  # of a motion that can be assessed
ABOUT_REFERENCES = ("evaluation.short_reference", "evaluation.unseen_reference", "evaluation.no_reference")
"""Codes of errors that are about the takes of the reference, not about the performance."""


def check_takes(takes: Sequence[CanonicalMotion], performance: CanonicalMotion, side: str, tempo: str) -> None:
    """Say what is wrong with motions or options before anything is computed."""
    if not takes:
        raise InvalidMotionError("evaluation.no_reference")
    if side not in ("same", "mirrored"):
        raise OptionError("evaluation.side", side=side)
    if tempo not in ("same", "free"):
        raise OptionError("evaluation.tempo", tempo=tempo)
    for motion in (*takes, performance):
        if motion.duration < SHORTEST_S or motion.n_frames < FEWEST_FRAMES:
            raise InvalidMotionError(
                "evaluation.short_performance" if motion is performance else "evaluation.short_reference",
                least_s=SHORTEST_S,
                least_frames=FEWEST_FRAMES,
                n_frames=motion.n_frames,
                rate=motion.frame_rate,
                duration=motion.duration,
            )


def check_seen(postures: PostureSequence, *, is_reference: bool) -> None:
    """Say who is not seen."""
    seen_s = postures.seen.any(axis=1).sum() / postures.frame_rate
    if seen_s < SHORTEST_S:
        raise InvalidMotionError(
            "evaluation.unseen_reference" if is_reference else "evaluation.unseen_performance",
            least_s=SHORTEST_S,
            seen_s=float(seen_s),
            duration=postures.duration,
        )


_Frames = tuple[tuple[int, int], ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Prepared:
    """All that figures do not change, and the eigenspaces of figures that were looked at."""

    references: ReferenceTakes  # prepared with these weights
    weighed: Weighed  # the performance compared with them
    performance: PostureSequence  # by the body of the reference
    # by the frames that they were learnt from
    spaces: OrderedDict[_Frames, Eigenspace] = field(default_factory=OrderedDict)

    def fit_spaces(self, figures: Sequence[Furi], *, most_spaces: int = 60) -> dict[str, Eigenspace]:
        """Fit eigenspaces by label; those of figures at the same frames as before are reused."""
        frames: dict[str, _Frames] = {}
        for one in figures:
            frames[one.label] = (*frames.get(one.label, ()), (one.start, one.end))
        new = [one for one in figures if frames[one.label] not in self.spaces]
        if new:
            more = pool_takes(self.references.warped, new)
            made = fit_furi_eigenspaces(self.references.postures, new, more=more)
            self.spaces.update({frames[label]: space for label, space in made.items()})
        found = {label: self.spaces[key] for label, key in frames.items()}
        for key in frames.values():
            self.spaces.move_to_end(key)
        while len(self.spaces) > max(most_spaces, len(frames)):
            self.spaces.popitem(last=False)
        return found


class AdjustableAssessment:
    """A performance and its reference, ready to be assessed with other figures and weights.

    Parameters
    ----------
    takes : of the reference; the first gives the clock and the figures.
    performance : what is judged.
    side, tempo, names : as in `dousa.evaluation.assess`.

    Raises
    ------
    InvalidMotionError, OptionError : as in `dousa.evaluation.assess`.
    """

    def __init__(
        self,
        takes: Sequence[CanonicalMotion],
        performance: CanonicalMotion,
        *,
        side: str = "auto",
        tempo: str = "same",
        names: Sequence[str] = (),
    ) -> None:
        self._postures, self._performance, self._side = settle_side(
            takes, performance, side=side, tempo=tempo, names=names
        )
        self._tempo, self._take = tempo, takes[0]
        self._prepared: OrderedDict[bytes, _Prepared] = OrderedDict()
        self._found: tuple[Furi, ...] = find_furi(self._postures[0])

    @property
    def frame_rate(self) -> float:
        """Hz, of the first take as it was recorded: figures are counted in its frames."""
        return self._take.frame_rate

    @property
    def n_frames(self) -> int:
        """Frames of the first take."""
        return self._take.n_frames

    @property
    def found(self) -> tuple[Furi, ...]:
        """The figures that are found in the reference, in frames of the first take."""
        ratio = self._take.frame_rate / self._postures[0].frame_rate
        cuts = [min(round(one.end * ratio), self.n_frames) for one in self._found]
        starts = [round(one.start * ratio) for one in self._found]
        return tuple(Furi(start, end, one.label) for start, end, one in zip(starts, cuts, self._found, strict=True))

    @property
    def n_bytes(self) -> int:
        """About how much memory is kept."""
        motions = sum(one.positions.nbytes + one.segments.nbytes for one in self._postures)
        kept = sum(
            one.weighed.comparison.deviations.squared.nbytes
            + sum(take.positions.nbytes + take.segments.nbytes for take in one.references.warped)
            for one in self._prepared.values()
        )
        return 2 * motions + kept

    def assess(
        self,
        furi: Sequence[Furi] | None = None,
        weights: Mapping[str, float] | None = None,
    ) -> Assessment:
        """Assess with these figures and weights, as `dousa.evaluation.assess`.

        Figures are in frames of the first take at its own rate; None for those that are found. Raises OptionError for
        figures outside the reference or impossible weights.
        """
        prepared = self._prepare(spread_weights(weights))
        return self._look(prepared, prepared.weighed, furi)

    def preview(
        self,
        furi: Sequence[Furi] | None = None,
        weights: Mapping[str, float] | None = None,
    ) -> tuple[Assessment, bool]:
        """Assess in a fraction of the time; the second result is whether the answer is exact.

        With weights that are new, the takes and the performance stay turned onto each other as they were with the
        weights before, and so does what is tolerated; how much the segments count is that of the new weights.

        Parameters
        ----------
        furi, weights : as in `assess`.
        """
        shares = spread_weights(weights)
        if shares.tobytes() in self._prepared or not self._prepared:
            return self.assess(furi, weights), True
        prepared = next(reversed(self._prepared.values()))
        weighed = reweigh(prepared.weighed, prepared.references, prepared.performance, shares)
        return self._look(prepared, weighed, furi), False

    def _prepare(self, shares: FloatArray, *, most_weights: int = 3) -> _Prepared:
        # most_weights: sets of weights whose comparison is kept: those found first, and the last ones tried
        key = shares.tobytes()
        if key not in self._prepared:
            references = prepare_references(self._postures, self._tempo, shares)
            compared, performance = compare_bodies(references, self._performance, self._tempo, shares)
            weighed = weigh(references, performance, compared, shares)
            self._prepared[key] = _Prepared(references, weighed, performance)
            while len(self._prepared) > most_weights:
                self._prepared.popitem(last=False)
        self._prepared.move_to_end(key)
        return self._prepared[key]

    def _look(
        self,
        prepared: _Prepared,
        weighed: Weighed,
        furi: Sequence[Furi] | None,
    ) -> Assessment:
        references = prepared.references
        figures = scale_furi(furi, self._take, references.postures) if furi else self._found
        found = look_at_figures(
            references,
            figures,
            prepared.fit_spaces(figures),
            prepared.performance,
            weighed,
            side=self._side,
            tempo=self._tempo,
        )
        return name_faults(references, found)
