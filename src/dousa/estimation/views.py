"""One view at a time, and several views put on one clock."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence

from dousa.errors import SilhouetteError
from dousa.estimation.silhouettes import Image, Mask, Silhouettes, checked_frame, checked_rate

__all__ = ["View", "synchronise"]

_SAME_RATE = 1e-3  # 29.97 and 30 Hz drift by a frame in half a minute; 29.97 and 29.98 are one


class View(ABC):
    """The silhouettes of one camera, from whatever source.

    Attributes
    ----------
    name : of the view.
    size : width and height in pixels.
    n_frames : number of frames.
    frame_rate : Hz.
    warnings : what a person should know; may grow while frames are read.
    """

    name: str
    size: tuple[int, int]
    n_frames: int
    frame_rate: float
    warnings: tuple[str, ...] = ()

    @abstractmethod
    def read(self, frame: int) -> Mask | None:
        """The mask (height, width) of a frame; None where there is no image."""

    def look(self, frame: int) -> Image | None:
        """The picture (height, width, 3) behind the mask of a frame; None where there is none."""
        return None

    def close(self) -> None:  # noqa: B027 - most kinds hold nothing open
        """Let go of open files; reading again opens them again."""


class _ViewsOnOneClock(Silhouettes):
    """Views read side by side; frame k is the time start + k / frame_rate of each."""

    def __init__(
        self,
        views: Sequence[View],
        frame_rate: float,
        starts: Sequence[float],
        first: int,
        n_frames: int,
        warnings: tuple[str, ...],
    ) -> None:
        self._views = tuple(views)
        self._starts = tuple(starts)
        self._first = first
        self._own_warnings = warnings
        self.frame_rate = frame_rate
        self.n_frames = n_frames
        self.names = _distinct(view.name for view in views)
        self.sizes = tuple(view.size for view in views)

    @property
    def warnings(self) -> tuple[str, ...]:  # type: ignore[override]
        return (*self._own_warnings, *(text for view in self._views for text in view.warnings))

    def read(self, frame: int) -> tuple[Mask | None, ...]:
        """The masks (height, width) of all views in one frame; None where a view has no image then."""
        return tuple(view.read(place) for view, place in self._places(frame))

    def look(self, frame: int) -> tuple[Image | None, ...]:
        """The pictures (height, width, 3) behind the masks; None where there is none."""
        return tuple(view.look(place) for view, place in self._places(frame))

    def _places(self, frame: int) -> list[tuple[View, int]]:
        """Each view, and which of its own frames is nearest."""
        moment = (checked_frame(frame, self.n_frames) + self._first) / self.frame_rate
        return [
            (view, min(_nearest((moment + start) * view.frame_rate), view.n_frames - 1))
            for view, start in zip(self._views, self._starts, strict=True)
        ]

    def close(self) -> None:
        """Let go of open files; reading again opens them again."""
        for view in self._views:
            view.close()


def _nearest(value: float) -> int:
    return math.floor(value + 0.5)


def _distinct(names: object) -> tuple[str, ...]:
    """The names, with a number behind one that occurred before."""
    seen: list[str] = []
    for name in names:  # type: ignore[attr-defined]
        candidate, count = name, 1
        while candidate in seen:
            count += 1
            candidate = f"{name} {count}"
        seen.append(candidate)
    return tuple(seen)


def synchronise(
    views: Sequence[View],
    frame_rate: float | None = None,
    offsets: Sequence[float] | None = None,
    frames: tuple[int, int] | None = None,
) -> Silhouettes:
    """Put views on one clock: each frame takes the nearest image of every view.

    Parameters
    ----------
    views : at least one.
    frame_rate : Hz of the common clock; by default that of the slowest view, so that no image is used twice.
    offsets : (V,) s from the start of each recording to one common moment, such as a clap; 0 by default.
    frames : first frame and the one after the last, on the common clock; all by default.

    Returns
    -------
    Silhouettes as long as the shortest view, with warnings where rates or lengths differ.

    Raises
    ------
    SilhouetteError : no views, views that share no moment, frames outside the sequence.
    """
    if not views:
        raise SilhouetteError("expected at least one view, got none")
    rates = [checked_rate(view.frame_rate, view.name) for view in views]
    rate = min(rates) if frame_rate is None else checked_rate(frame_rate)
    warnings = []
    if max(rates) > min(rates) * (1 + _SAME_RATE):
        listed = ", ".join(f"{value:g}" for value in rates)
        warnings.append(f"the views have {listed} Hz; the nearest images at {rate:g} Hz are used")
    elif frame_rate is None:
        rates = [rate] * len(views)  # rates that are the same but for rounding must not drift apart
    starts = _starts(views, offsets)
    lengths = [  # moments whose nearest image exists
        math.ceil(((view.n_frames - 0.5) / own - start) * rate - 1e-9)
        for view, own, start in zip(views, rates, starts, strict=True)
    ]
    length = min(lengths)
    if length < 1:
        raise SilhouetteError(
            f"the views share no moment: with these offsets '{views[lengths.index(length)].name}' is over before "
            "another begins"
        )
    if max(lengths) > length:
        listed = ", ".join(f"{view.name} {count}" for view, count in zip(views, lengths, strict=True))
        warnings.append(
            f"the views differ in length ({listed} frames at {rate:g} Hz); the first {length} are used"
        )
    first, stop = _span(frames, length)
    clocked = _OneRate.of(views, rates)
    return _ViewsOnOneClock(clocked, rate, starts, first, stop - first, tuple(warnings))


class _OneRate(View):
    """A view whose rate is taken for a slightly different one."""

    def __init__(self, view: View, frame_rate: float) -> None:
        self._view = view
        self.name, self.size, self.n_frames = view.name, view.size, view.n_frames
        self.frame_rate = frame_rate

    @classmethod
    def of(cls, views: Sequence[View], rates: Sequence[float]) -> list[View]:
        return [
            view if view.frame_rate == rate else cls(view, rate)
            for view, rate in zip(views, rates, strict=True)
        ]

    @property
    def warnings(self) -> tuple[str, ...]:  # type: ignore[override]
        return self._view.warnings

    def read(self, frame: int) -> Mask | None:
        return self._view.read(frame)

    def look(self, frame: int) -> Image | None:
        return self._view.look(frame)

    def close(self) -> None:
        self._view.close()


def _starts(views: Sequence[View], offsets: Sequence[float] | None) -> list[float]:
    """Seconds of each view at the first common moment."""
    if offsets is None:
        return [0.0] * len(views)
    values = [float(value) for value in offsets]
    if len(values) != len(views) or not all(map(math.isfinite, values)):
        raise SilhouetteError(f"expected {len(views)} offsets in seconds, one for each view, got {values}")
    return [value - min(values) for value in values]


def _span(frames: tuple[int, int] | None, length: int) -> tuple[int, int]:
    if frames is None:
        return 0, length
    first, stop = frames
    if not 0 <= first < stop <= length:
        raise SilhouetteError(f"expected frames within 0 to {length}, got {first} to {stop}")
    return first, stop
