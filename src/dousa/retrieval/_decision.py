"""What a tree asked about a clip."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Decision"]


@dataclass(frozen=True, slots=True)
class Decision:
    """One question that a tree asked about a clip, and the answer.

    Parameters
    ----------
    tree : which tree, from 0.
    node : number of the node that asked, through all trees.
    feature : name of the pose feature, or channel.
    kind : ``"mean"``, ``"spread"`` (standard deviation) or ``"trend"`` (change along the fitted line).
    start, stop : the interval, frames ``start ... stop - 1`` of the thinned clip, counted from 0.
    threshold : of the mean, spread or trend of the feature over the interval.
    value : that of this clip.
    """

    tree: int
    node: int
    feature: str
    kind: str
    start: int
    stop: int
    threshold: float
    value: float

    @property
    def above(self) -> bool:
        """Whether the clip lies above the threshold."""
        return self.value > self.threshold
