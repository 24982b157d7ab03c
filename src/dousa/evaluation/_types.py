"""What an assessment is made of: postures over time, figures, events, lapses, and the whole."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from dousa.motion._types import FloatArray

if TYPE_CHECKING:
    from dousa.evaluation.eigenspace import Eigenspace

__all__ = ["Assessment", "ErrorEvent", "FuriAssessment", "Lapse", "PostureSequence"]


@dataclass(frozen=True, slots=True, eq=False)
class PostureSequence:
    """A motion as the directions of nine body segments.

    Parameters
    ----------
    segments : (T, 9, 3) unit vectors, Y up, order of `SEGMENTS`; a segment that is not seen is filled from its
        neighbours in time.
    seen : (T, 9) False where the recording has a gap: such values are drawn, never judged.
    positions : (T, 20, 3) m, canonical joints, for pictures.
    frame_rate : Hz.
    name : of the recording.
    """

    segments: FloatArray
    seen: np.ndarray
    positions: FloatArray
    frame_rate: float
    name: str = ""

    @property
    def n_frames(self) -> int:
        """Number of poses."""
        return len(self.segments)

    @property
    def duration(self) -> float:
        """Seconds."""
        return self.n_frames / self.frame_rate


@dataclass(frozen=True, slots=True)
class ErrorEvent:
    """One error of the performance.

    Parameters
    ----------
    kind : ``"global"``, ``"partial"``, ``"incomplete"`` or ``"shift"``.
    start_s, end_s : in the performance's own seconds.
    segments : names of the segments that are wrong; all nine for an error of the whole body.
    lag_ms : how late (positive) or early (negative), of a shift.
    shortfall_deg, shortfall_percent : how much of the range of motion is missing, of an incomplete motion; negative
        for a limb (a partial error) that goes further than the reference.
    severity : size in multiples of what is tolerated, 1 or above.
    worst_s : moment of the largest deviation, performance seconds.
    reference_s : moment of the reference that belongs to it.
    furi : number of the furi, from 0; None outside all.
    says : one sentence for a person.
    deviation_deg : largest lasting angle of a wrong segment from the reference's at the same time.
    facing_deg : median heading against the reference's while it lasts; positive is turned to the own left.
    """

    kind: str
    start_s: float
    end_s: float
    segments: tuple[str, ...]
    lag_ms: float | None
    shortfall_deg: float | None
    shortfall_percent: float | None
    severity: float
    worst_s: float
    reference_s: float
    furi: int | None
    says: str
    deviation_deg: float | None = None
    facing_deg: float | None = None


@dataclass(frozen=True, slots=True)
class Lapse:
    """A stretch where the performance is not at the reference's place: no error of form, but of order.

    Parameters
    ----------
    kind : ``"stop"`` (stands still, goes on later), ``"skip"`` (leaves reference time out), ``"repeat"`` (does
        reference time again), ``"late start"`` or ``"early end"`` (of the performance's part of the reference),
        ``"lead-in"`` or ``"lead-out"`` (motion before or after, that is not in the reference).
    start_s, end_s : performance seconds.
    reference_start_s, reference_end_s : reference seconds that are left out, done again or not reached.
    says : one sentence for a person.
    """

    kind: str
    start_s: float
    end_s: float
    reference_start_s: float
    reference_end_s: float
    says: str


@dataclass(frozen=True, slots=True, eq=False)
class FuriAssessment:
    """One furi (figure) of the dance and how it went.

    Parameters
    ----------
    start_s, end_s : in the performance's seconds; nan if the performance does not reach it.
    reference_start_s, reference_end_s : in the reference's seconds.
    label : equal furi have the same label and share one eigenspace.
    eigenspace : of the reference.
    gain : (9,) range of each segment as a share of the reference's; nan where the reference hardly moves.
    lag_s : median lag, s; nan if not reached.
    score : 0 to 100.
    """

    start_s: float
    end_s: float
    reference_start_s: float
    reference_end_s: float
    label: str
    eigenspace: Eigenspace
    gain: FloatArray
    lag_s: float
    score: float

    @property
    def n_dims(self) -> int:
        """Dimensions of the eigenspace."""
        return self.eigenspace.n_dims

    @property
    def contribution(self) -> float:
        """Share of the variance that they hold."""
        return self.eigenspace.contribution


@dataclass(frozen=True, slots=True, eq=False)
class Assessment:
    """How a performance differs from its reference: curves over the performance's frames, and events.

    All arrays have one row a frame of the performance; nan where there is nothing to compare (outside the
    reference, gaps).

    Parameters
    ----------
    frame_rate : Hz, of the performance; the reference is resampled to it.
    reference, performance : postures at that rate. The performance is mirrored already, if it was asked for.
    same_time : (T,) s, reference time that belongs to each frame if the tempo is kept (straight line).
    matched_time : (T,) s, reference time that each frame resembles (curve).
    lag : (T,) s, how late the performance is against the straight line; positive is late.
    facing : (T,) rad, heading of the performance against the reference's, its median taken off.
    d_space : (T,) d#, distance from the furi's eigenspace (eq. 10, 11).
    d_within : (T,) d*, distance inside it at the same time (eq. 12-14).
    d_path : (T,) distance to the reference trajectory, any time of the furi: wrong, though in the space.
    d_space_limit, d_within_limit : (T,) what the takes, or a steady performer, keep below. Drawn for orientation:
        the events come from deviations and lags.
    residual : (T, 9) rad, angle between each segment and the reference's at the same time.
    residual_limit : (9,) rad.
    path : (K, 2) frames of performance and reference that correspond, for the picture of the matrix.
    furi : figures in order of the reference.
    events : errors in order of time.
    lapses : in order of time, see `Lapse`.
    score : 0 to 100.
    score_formula : how the score came about, in words and numbers.
    calibrated : whether the grade rests on three takes of the reference or more.
    n_references : takes of the reference that were used; those left out are not counted.
    tempo : performance seconds per reference second.
    gaps : (start_s, end_s, segment name) of spans that were not seen and not judged.
    warnings : sentences.
    side : ``"mirrored"`` if the performance was mirrored first: left and right are the reference's, then.
    """

    frame_rate: float
    reference: PostureSequence
    performance: PostureSequence
    same_time: FloatArray
    matched_time: FloatArray
    lag: FloatArray
    facing: FloatArray
    d_space: FloatArray
    d_within: FloatArray
    d_path: FloatArray
    d_space_limit: FloatArray
    d_within_limit: FloatArray
    residual: FloatArray
    residual_limit: FloatArray
    path: np.ndarray
    furi: tuple[FuriAssessment, ...]
    events: tuple[ErrorEvent, ...]
    lapses: tuple[Lapse, ...]
    score: float
    score_formula: str
    calibrated: bool
    n_references: int
    tempo: float
    gaps: tuple[tuple[float, float, str], ...] = ()
    warnings: tuple[str, ...] = field(default=())
    side: str = "same"

    @property
    def times(self) -> FloatArray:
        """(T,) s, of the frames of the performance."""
        return np.arange(self.performance.n_frames) / self.frame_rate

    def to_json(self) -> dict[str, Any]:
        """The answer of ``dousa evaluate --json``."""
        from dousa.evaluation._to_json import describe_assessment

        return describe_assessment(self)
