"""Files of one skeleton vote on their up axis and unit.

A program writes all its files in the same axes and unit. Where a file's own evidence is only a guess, the files with
the same joints that were read together decide, if most of those with clear evidence agree.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import dataclass, field

import numpy as np

from dousa.messages import Message
from dousa.motion import CanonicalMotion, Motion, Trajectories

OVERRULED = frozenset({"units.guessed_up", "units.assumed", "units.normalised"})
"""Codes of the notes that no longer hold where others decided."""

_SAME_SIZE = 1.6  # bodies of one unit are at most this much taller than each other in the files' own units
_TYPICAL_HEIGHT = 1.55  # m, over the joints
_MAJORITY = 0.75


@dataclass(frozen=True, slots=True)
class FrameClaim:
    """Axes and unit of a file, declared or guessed.

    Parameters
    ----------
    skeleton : names and tree of the joints.
    up, up_source, unit, unit_source : as in a ``Provenance``.
    height : of the body in units of the file.
    """

    skeleton: tuple[object, ...]
    up: str
    up_source: str
    unit: float
    unit_source: str
    height: float

    @property
    def doubtful(self) -> bool:
        """Whether other files could have better evidence."""
        return self.up_source == "guessed" or self.unit_source == "assumed"


def describe_frame(motion: Motion | Trajectories, canonical: CanonicalMotion) -> FrameClaim | None:
    """Return the claim of a file that was read; None for a motion without a file."""
    origin = motion.provenance
    if origin is None:
        return None
    if isinstance(motion, Motion):
        skeleton: tuple[object, ...] = (motion.skeleton.names, motion.skeleton.parents.tobytes())
    else:
        skeleton = (tuple(sorted(motion.names)),)
    return FrameClaim(
        (origin.format, *skeleton),
        origin.up,
        origin.up_source,
        origin.unit,
        origin.unit_source,
        canonical.height / origin.unit,
    )


@dataclass(slots=True)
class FrameVotes:
    """The claims of files read together, by skeleton."""

    claims: dict[tuple[object, ...], list[FrameClaim]] = field(default_factory=lambda: defaultdict(list))

    def count(self, claim: FrameClaim) -> None:
        """Add the claim of one more file."""
        self.claims[claim.skeleton].append(claim)

    def elect(self, claim: FrameClaim) -> tuple[str | None, float | None, tuple[Message, ...]]:
        """Let the other files of its skeleton decide on a doubtful claim.

        Returns
        -------
        Up axis and unit to read the file with, None where undecided, and notes for the user.
        """
        others = self.claims[claim.skeleton]
        up, unit = self._elect_up(claim, others), self._elect_unit(claim, others)
        notes = []
        if up is not None and up != claim.up:
            known = sum(other.up_source != "guessed" for other in others)
            notes.append(Message("units.voted_up", up=up, n=known, own=claim.up))
        if unit is not None:
            notes.append(Message("units.voted_unit", unit=unit, n=len(others), own=claim.unit))
        return up, unit, tuple(notes)

    @staticmethod
    def _elect_up(claim: FrameClaim, others: list[FrameClaim]) -> str | None:
        known = Counter(other.up for other in others if other.up_source != "guessed")
        if claim.up_source != "guessed" or not known:
            return None
        up, votes = known.most_common(1)[0]
        return up if votes >= _MAJORITY * known.total() else None

    @staticmethod
    def _elect_unit(claim: FrameClaim, others: list[FrameClaim]) -> float | None:
        alike = [other for other in others if 1 / _SAME_SIZE < other.height / claim.height < _SAME_SIZE]
        if claim.unit_source != "assumed" or len(alike) < 2:
            return None
        known = Counter(other.unit for other in alike if other.unit_source != "assumed")
        if known:
            return known.most_common(1)[0][0]
        heights = np.array([other.height for other in alike])
        unit = float(_TYPICAL_HEIGHT / np.exp(np.log(heights).mean()))
        return unit if abs(unit / claim.unit - 1) > 1e-6 else None
