"""Somebody who looks on while a motion is estimated: what is seen, and every frame as soon as it has a pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from dousa.estimation import Camera
    from dousa.estimation._types import Estimate, TrackedFrame
    from dousa.estimation.silhouettes import Image, Mask

__all__ = ["Scene", "Watcher"]


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """What is tracked.

    Parameters
    ----------
    names : (V,) of the views.
    cameras : (V,) of the size of the masks.
    frame_rate : Hz.
    n_frames : T.
    resumed : frames that an earlier run had looked at.
    """

    names: tuple[str, ...]
    cameras: Sequence[Camera]
    frame_rate: float
    n_frames: int
    resumed: int


class Watcher(Protocol):
    """Is told what happens, in the order of these methods."""

    def begin(self, scene: Scene) -> None:
        """Tracking is about to begin, or to go on."""

    def see(self, frame: int, masks: Sequence[Mask | None], pictures: Sequence[Image | None]) -> None:
        """Masks and pictures (V,) of a frame were read for the first time in this run."""

    def follow(self, tracked: TrackedFrame) -> None:
        """A frame has a pose, or its pose is settled."""

    def end(self, estimate: Estimate) -> None:
        """All frames are settled and smoothed."""
