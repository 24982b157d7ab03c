"""Settings and results of the tracker."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray
from dousa.errors import OptionError
from dousa.messages import Message
from dousa.notebooks import short_repr

if TYPE_CHECKING:
    from dousa.estimation.body.body import BodyModel
    from dousa.motion import Motion, Trajectories

Reading = Literal["masked", "residual", "union", "plain", "literal"]
Evidence = Literal["log", "local", "global"]

READINGS: tuple[Reading, ...] = ("masked", "residual", "union", "plain", "literal")
"""How the mismatch of eq. 2 is read, with S the silhouette, F the parts already placed (P_fixed), P the candidate.

``masked`` (default): S xor P outside F: a hidden part is tied, a part that is partly hidden is not pushed out.
``residual`` (the paper, with the overline that its print lost): (S minus F) xor P.
``union``: (S or F) xor P. ``plain``: S xor P. ``literal``, as printed: (S and F) xor P."""

EVIDENCES: tuple[Evidence, ...] = ("log", "local", "global")
"""How the mismatch m is weighed against W of eq. 3.

``log`` (default): -m / lambda + log W. ``global``, as printed: W / (1 + m) with all of the silhouette counted.
``local``: W / (1 + m) with only those pixels of the silhouette counted that some candidate can reach."""


@dataclass(frozen=True, slots=True)
class TrackerSettings:
    """Settings of the search; `PAPER` is the method as published, the defaults extend it.

    Parameters
    ----------
    reading, evidence : how eq. 2 is read and weighed, see `READINGS` and `EVIDENCES`.
    max_change : rad at 30 frames/s, dR of eq. 1; scaled by 30 / rate at other rates.
    agility : ``"body"`` scales dR by joint as the body model has it, ``"uniform"`` does not (the paper).
    root_change : statures at 30 frames/s, dR of the root's place.
    n_candidates : per axis, odd, at most `MOST_CANDIDATES`; the paper's 13 are 2 dR / s + 1.
    n_candidates_later : the same for the passes after the first.
    thinning : 1 tries all candidates, 2 every other one and then the neighbours of the best.
    candidates : ``"part"`` judges a candidate by its own part before those already placed (the paper), ``"subtree"``
        by the part and all below it, with everything else in place.
    passes : of each frame, share of dR that the candidates span; the first is the search, the others are revisits.
    inertia : weight of log W against the image; 0 is the previous method (W = 1).
    image_scale : lambda of the evidence ``"log"``, as a share of the mean area of a silhouette.
    damping : shares of the last velocity, one prediction each; 1 is constant velocity.
    stiffness : log score that a joint at the end of its range costs, times the body's own stiffness.
    beam : poses kept from frame to frame; None for 12 over the number of views, at least 3.
    lag : frames after which a pose is settled.
    smoothing : Hz, cut-off of the final smoothing; 0 for none.
    height : px, taller silhouettes are shrunk before the search.
    """

    MOST_CANDIDATES: ClassVar[int] = 63

    reading: Reading = field(default="masked", metadata={"choices": READINGS})
    evidence: Evidence = field(default="log", metadata={"choices": EVIDENCES})
    max_change: float = float(np.deg2rad(16.0))
    agility: Literal["body", "uniform"] = field(default="body", metadata={"choices": ("body", "uniform")})
    root_change: float = 0.0225
    n_candidates: int = 13
    n_candidates_later: int = 9
    thinning: int = 2
    candidates: Literal["part", "subtree"] = field(default="subtree", metadata={"choices": ("part", "subtree")})
    passes: tuple[float, ...] = (1.0, 0.5, 0.25)
    inertia: float = 1.0
    image_scale: float = 0.011
    damping: tuple[float, ...] = (0.2, 0.9)
    stiffness: float = 4.0
    beam: int | None = None
    lag: int = 30
    smoothing: float = 6.0
    height: int = 260

    def __post_init__(self) -> None:
        for option in fields(self):
            known, value = option.metadata.get("choices"), getattr(self, option.name)
            if known and value not in known:
                raise OptionError("tracker.choice", option=option.name, known=known, found=str(value))
        if not (0 < self.max_change < np.pi and 0 < self.root_change < 1):
            raise OptionError("tracker.change", change=self.max_change, root=self.root_change)
        for count in (self.n_candidates, self.n_candidates_later):
            if count < 3 or count % 2 == 0 or count > self.MOST_CANDIDATES:
                raise OptionError("tracker.candidates", most=self.MOST_CANDIDATES, found=count)
            if self.thinning == 2 and count % 4 != 1:
                raise OptionError("tracker.thinned", found=count)
        if (
            not self.passes
            or not self.damping
            or (self.beam is not None and self.beam < 1)
            or self.thinning not in (1, 2)
            or self.lag < 1
        ):
            raise OptionError("tracker.search")


PAPER = TrackerSettings(
    reading="residual",
    evidence="global",
    max_change=float(np.deg2rad(6.0)),
    agility="uniform",
    root_change=0.03,
    thinning=1,
    candidates="part",
    passes=(1.0,),
    damping=(1.0,),
    stiffness=0.0,
    beam=1,
    smoothing=0.0,
)
"""The method as published: dR = 6 degrees, s = 1 degree, one pass from the root to the leaves.

The paper has no limit for the root's place: here it moves at most 3 % of the stature beyond the prediction."""


@dataclass(frozen=True, slots=True, eq=False)
class TrackedFrame:
    """A frame during tracking.

    Parameters
    ----------
    frame : its number, from 0.
    pose : (7 + A,), not smoothed yet.
    overlap : (V,) as `Estimate.iou`.
    occluded : (P,) as `Estimate.occluded`.
    lost : no person is seen, or the pose is probably wrong.
    settled : false if a later frame may still change the pose.
    body : the tracked body with fitted girths.
    """

    frame: int
    pose: FloatArray
    overlap: FloatArray
    occluded: NDArray[np.bool_]
    lost: bool
    settled: bool
    body: BodyModel


@short_repr
@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """A motion estimated from silhouettes, with its expected error.

    Parameters
    ----------
    body : the tracked body, with P parts, K tips and A joint angles.
    poses : (T, 7 + A) pose rows, see `BodyModel`.
    frame_rate : Hz.
    iou : (T, V) intersection over union of model and silhouette; NaN where a view has no image.
    uncertainty : (T, P + K) m, expected error of each joint and tip.
    occluded : (T, P) true where a part is hidden in every view, so that inertia alone places it.
    lost : (T,) true without a person, or where the mean joint error is too likely above 150 mm.
    warnings : notes for the user.
    frames_per_second : tracking speed in wall-clock time.
    lengths : of the body that were found, as `MEASURES`, and the stature: m, and the spread (one sigma) of each.
    depth_spread : (T,) m, one sigma of the body's distance from a single view; None where several determine it.
    """

    body: BodyModel
    poses: FloatArray
    frame_rate: float
    iou: FloatArray
    uncertainty: FloatArray
    occluded: NDArray[np.bool_]
    lost: NDArray[np.bool_]
    warnings: tuple[Message, ...] = ()
    frames_per_second: float = 0.0
    lengths: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    depth_spread: FloatArray | None = None

    @property
    def n_frames(self) -> int:
        """Number of poses."""
        return len(self.poses)

    @property
    def expected_error(self) -> FloatArray:
        """Mean expected error (T,) m of the joints and tips of each frame."""
        return np.asarray(self.uncertainty.mean(axis=1))

    @property
    def motion(self) -> Motion:
        """The estimate as a motion with the body's joint names."""
        from dousa.estimation.body.kinematics import to_motion

        return to_motion(self.body, self.poses, self.frame_rate)

    @property
    def points(self) -> Trajectories:
        """Joints and tips (T, P + K, 3) m over time."""
        from dousa.estimation.body.kinematics import compute_points, point_names
        from dousa.motion import Trajectories

        return Trajectories(point_names(self.body), compute_points(self.body, self.poses), self.frame_rate)

    def to_json(self) -> dict[str, Any]:
        """Return the summary that ``dousa estimate --json`` prints."""
        with np.errstate(invalid="ignore"):
            per_view = [
                float(np.nanmean(column)) if np.isfinite(column).any() else float("nan") for column in self.iou.T
            ]
        known = [mean for mean in per_view if np.isfinite(mean)]
        return {
            "n_frames": self.n_frames,
            "frame_rate": self.frame_rate,
            "iou": {"mean": float(np.mean(known)) if known else float("nan"), "per_view": per_view},
            "lost_frames": np.flatnonzero(self.lost).tolist(),
            "expected_error_m": np.round(self.expected_error, 4).tolist(),
            "depth_spread_m": None if self.depth_spread is None else np.round(self.depth_spread, 4).tolist(),
            "frames_per_second": self.frames_per_second,
            "lengths_m": {
                name: {"length": length, "spread": spread} for name, (length, spread) in self.lengths.items()
            },
            "warnings": [str(warning) for warning in self.warnings],
        }
