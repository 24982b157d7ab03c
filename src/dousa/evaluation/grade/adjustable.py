"""An assessment that answers again quickly when figures or weights are changed: what they do not touch is kept.

Where the figures are cut changes the eigenspaces of the figures concerned and the curves; weights change everything,
since they turn the bodies onto each other; importance changes the grades alone. `preview` keeps how the bodies were
turned onto each other and changes only what the segments count; `assess` does all of it.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from dousa.arrays import FloatArray
from dousa.evaluation.figures.eigenspace import Eigenspace
from dousa.evaluation.figures.furi import Furi, find_furi, fit_furi_eigenspaces, pool_takes, scale_furi
from dousa.evaluation.grade.assessment import (
    Weighed,
    check_importance,
    compare_bodies,
    compute_all_postures,
    look_at_figures,
    reweigh,
    weigh,
)
from dousa.evaluation.grade.references import (
    ReferenceTakes,
    prepare_references,
    set_importance,
)
from dousa.evaluation.grade.result import Assessment
from dousa.evaluation.posture.posture import PostureSequence
from dousa.evaluation.posture.weights import spread_weights
from dousa.motion import CanonicalMotion

_MOST_WEIGHTS = 3  # sets of weights whose comparison is kept: those found first, and the last ones tried
_MOST_SPACES = 60
_Frames = tuple[tuple[int, int], ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Prepared:
    """All that figures do not change, and the eigenspaces of figures that were looked at.

    Parameters
    ----------
    references : prepared with these weights.
    weighed : the performance compared with them.
    performance : by the body of the reference.
    spaces : by the frames that they were learnt from.
    """

    references: ReferenceTakes
    weighed: Weighed
    performance: PostureSequence
    spaces: OrderedDict[_Frames, Eigenspace] = field(default_factory=OrderedDict)

    def fit_spaces(self, figures: Sequence[Furi]) -> dict[str, Eigenspace]:
        """Eigenspaces by label; those of figures that lay there before are not made again."""
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
        while len(self.spaces) > max(_MOST_SPACES, len(frames)):
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
        side: str = "same",
        tempo: str = "same",
        names: Sequence[str] = (),
    ) -> None:
        self._postures, self._performance = compute_all_postures(
            takes, performance, side=side, tempo=tempo, names=names
        )
        self._side, self._tempo, self._take = side, tempo, takes[0]
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
        *,
        importance: str = "learned",
    ) -> Assessment:
        """What `dousa.evaluation.assess` says of these figures, weights and importance.

        Parameters
        ----------
        furi : in frames of the first take at its own rate; None for those that are found.
        weights : of segments or limbs.
        importance : ``"learned"`` or ``"equal"``: whether what matters in the reference counts more in the grade.

        Raises
        ------
        OptionError : furi outside the reference, weights that cannot be, another importance.
        """
        check_importance(importance)
        prepared = self._prepare(spread_weights(weights))
        references = set_importance(prepared.references, importance)
        return self._look(prepared, references, prepared.weighed, furi)

    def preview(
        self,
        furi: Sequence[Furi] | None = None,
        weights: Mapping[str, float] | None = None,
        *,
        importance: str = "learned",
    ) -> tuple[Assessment, bool]:
        """The same in a fraction of the time, and whether it is exactly the same.

        With weights that are new, the takes and the performance stay turned onto each other as they were with the
        weights before, and so does what is tolerated; how much the segments count is that of the new weights.

        Parameters
        ----------
        furi, weights, importance : as in `assess`.
        """
        check_importance(importance)
        shares = spread_weights(weights)
        if shares.tobytes() in self._prepared or not self._prepared:
            return self.assess(furi, weights, importance=importance), True
        prepared = next(reversed(self._prepared.values()))
        references = set_importance(prepared.references, importance)
        weighed = reweigh(prepared.weighed, references, prepared.performance, shares)
        return self._look(prepared, references, weighed, furi), False

    def _prepare(self, shares: FloatArray) -> _Prepared:
        key = shares.tobytes()
        if key not in self._prepared:
            references = prepare_references(self._postures, self._tempo, shares)
            compared, performance = compare_bodies(references, self._performance, self._tempo, shares)
            weighed = weigh(references, performance, compared, shares)
            self._prepared[key] = _Prepared(references, weighed, performance)
            while len(self._prepared) > _MOST_WEIGHTS:
                self._prepared.popitem(last=False)
        self._prepared.move_to_end(key)
        return self._prepared[key]

    def _look(
        self,
        prepared: _Prepared,
        references: ReferenceTakes,
        weighed: Weighed,
        furi: Sequence[Furi] | None,
    ) -> Assessment:
        figures = scale_furi(furi, self._take, references.postures) if furi else self._found
        return look_at_figures(
            references,
            figures,
            prepared.fit_spaces(figures),
            prepared.performance,
            weighed,
            side=self._side,
            tempo=self._tempo,
        )
