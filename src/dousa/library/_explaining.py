"""Reasons for answers: the few tests that mattered most for a category, or for the likeness of two motions."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

from dousa.library._describing import StoredMotion, describe_clip
from dousa.library._forests import StoredForest
from dousa.library.answers import Hit, Verdict

__all__ = ["Explaining"]


class Explaining:
    """Explains what one forest says.

    Parameters
    ----------
    stored : the forest.
    """

    def __init__(self, stored: StoredForest) -> None:
        from dousa.retrieval.explanation import Explainer

        self._feature_set = stored.feature_set
        self._explainer = Explainer(stored.forest)

    def verdicts(self, verdicts: Sequence[Verdict], motion: StoredMotion) -> list[Verdict]:
        """The verdict on a motion, and on its mirror image if there are two, with the reasons for their guesses."""
        explained = []
        for verdict, own in zip(verdicts, (motion, motion.mirror()), strict=False):
            features = describe_clip(own, self._feature_set).features
            reasons = self._explainer.explain(features, own.duration, verdict.guess)
            explained.append(replace(verdict, explanation=reasons))
        return explained

    def hits(
        self, hits: Sequence[Hit], motion: StoredMotion, found: Iterable[StoredMotion]
    ) -> tuple[Hit, ...]:
        """Hits, with the reasons why they are like the query or its mirror image."""
        explained = []
        for hit, other in zip(hits, found, strict=True):
            own = motion.mirror() if hit.mirrored else motion
            likeness = self._explainer.explain_pair(
                describe_clip(own, self._feature_set).features,
                describe_clip(other, self._feature_set).features,
                (own.duration, other.duration),
            )
            explained.append(replace(hit, likeness=likeness))
        return tuple(explained)
