"""Silhouettes S(t) of one or more views, and views synchronised to one clock."""

from __future__ import annotations

import math
import operator
from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dousa.arrays import FloatArray, Image, Mask, nearest_frames
from dousa.errors import SilhouetteError
from dousa.estimation.cameras.camera import format_size
from dousa.messages import Message

PackedMasks = NDArray[np.uint8]


class Silhouettes(ABC):
    """Masks of one or more views over time, read one frame at a time to save memory.

    Attributes
    ----------
    names : (V,) names of the views.
    sizes : (V,) width and height of each view in pixels.
    n_frames : number of frames (of the shortest view after synchronisation).
    frame_rate : Hz.
    warnings : notes for the user; may grow while frames are read.
    """

    names: tuple[str, ...]
    sizes: tuple[tuple[int, int], ...]
    n_frames: int
    frame_rate: float
    warnings: tuple[Message, ...] = ()

    @abstractmethod
    def read(self, frame: int) -> tuple[Mask | None, ...]:
        """Return the masks (height, width) of all views in one frame; None where a view has no image.

        Rising order of frames is cheapest; any order works.

        Raises
        ------
        SilhouetteError : no such frame, or its image is damaged.
        """

    def read_view(self, view: int, frame: int) -> Mask | None:
        """Return the mask of one view."""
        return self.read(frame)[view]

    def look(self, frame: int) -> tuple[Image | None, ...]:
        """Return the images (height, width, 3) blue, green, red behind the masks; None where there is none.

        Cheap right after `read` of the same frame.
        """
        return (None,) * self.n_views

    def close(self) -> None:  # noqa: B027 - most kinds hold nothing open
        """Close open files; reading opens them again."""

    @property
    def n_views(self) -> int:
        """Number of views."""
        return len(self.names)

    def __enter__(self) -> Silhouettes:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


class WrappedSilhouettes(Silhouettes):
    """Silhouettes made from others, which have the same views."""

    def __init__(self, inner: Silhouettes) -> None:
        self.names, self.sizes = inner.names, inner.sizes
        self.n_frames, self.frame_rate = inner.n_frames, inner.frame_rate
        self._inner = inner

    @property
    def warnings(self) -> tuple[Message, ...]:  # type: ignore[override]
        """The warnings of the source."""
        return self._inner.warnings

    def look(self, frame: int) -> tuple[Image | None, ...]:
        """Return the images behind the masks."""
        return self._inner.look(frame)

    def close(self) -> None:
        """Close open files."""
        self._inner.close()


def checked_frame(frame: int, n_frames: int) -> int:
    """Return the frame if it is one of n_frames, else raise SilhouetteError."""
    try:
        index = operator.index(frame)
    except TypeError:
        raise SilhouetteError("masks.frame_number", found=repr(frame)) from None
    if not 0 <= index < n_frames:
        raise SilhouetteError("masks.frame", last=n_frames - 1, found=index)
    return index


def checked_rate(rate: float, where: str = "", highest: float = 100_000.0) -> float:
    """Return the frame rate in Hz if it is valid, at most ``highest``, else raise SilhouetteError with ``where``."""
    try:
        value = float(rate)
    except (TypeError, ValueError):
        value = float("nan")
    if not 0 < value <= highest:
        raise SilhouetteError("masks.rate", found=repr(rate)).at(where)
    return value


class PackedSilhouettes(Silhouettes):
    """Silhouettes in memory, one bit a pixel.

    Parameters
    ----------
    masks : (V, T, H, W) bool, or one (T, H, W) bool per view: sizes and lengths may differ, the shortest counts (with
        a warning). Numbers other than 0 are foreground.
    frame_rate : Hz.
    names : (V,) names of the views; view1, view2 ... by default.
    missing : (V, T) bool, True where a view has no image; none by default.

    Raises
    ------
    SilhouetteError : no views, frames or pixels, arrays of another shape, an invalid frame rate.
    """

    def __init__(
        self,
        masks: ArrayLike | Sequence[ArrayLike],
        frame_rate: float,
        names: Sequence[str] | None = None,
        missing: ArrayLike | None = None,
    ) -> None:
        packed, sizes = [], []
        for view, array in enumerate(masks):  # type: ignore[arg-type]  # an array is a sequence of views
            values = np.asarray(array)
            if values.ndim != 3 or values.dtype.kind not in "buif":
                found = f"{values.shape} {values.dtype}"
                raise SilhouetteError("masks.view_shape", view=view + 1, found=found)
            packed.append(np.packbits(values.astype(bool, copy=False), axis=2))
            sizes.append((values.shape[2], values.shape[1]))
        self._fill(packed, sizes, frame_rate, names, missing)

    @classmethod
    def from_packed(
        cls,
        packed: Sequence[PackedMasks],
        sizes: Sequence[tuple[int, int]],
        frame_rate: float,
        names: Sequence[str] | None = None,
        missing: ArrayLike | None = None,
    ) -> PackedSilhouettes:
        """Create silhouettes from packed masks; the other arguments are those of the class.

        Parameters
        ----------
        packed : per view (T, H, ceil(W / 8)) uint8, as ``np.packbits(masks, axis=2)`` returns.
        sizes : (V,) width and height in pixels.
        """
        made = cls.__new__(cls)
        made._fill(list(packed), list(sizes), frame_rate, names, missing)
        return made

    def _fill(
        self,
        packed: list[PackedMasks],
        sizes: list[tuple[int, int]],
        frame_rate: float,
        names: Sequence[str] | None,
        missing: ArrayLike | None,
    ) -> None:
        if not packed:
            raise SilhouetteError("masks.no_view")
        for view, (array, (width, height)) in enumerate(zip(packed, sizes, strict=True)):
            if array.dtype != np.uint8 or array.ndim != 3 or array.shape[1:] != (height, (width + 7) // 8):
                found = f"{array.shape} {array.dtype}"
                raise SilhouetteError("masks.packed", view=view + 1, size=format_size((width, height)), found=found)
            if min(array.shape) < 1:
                raise SilhouetteError("masks.empty", view=view + 1, found=str(array.shape))
        lengths = [len(array) for array in packed]
        self.n_frames = min(lengths)
        self.frame_rate = checked_rate(frame_rate)
        self.sizes = tuple((int(width), int(height)) for width, height in sizes)
        self.names = tuple(names) if names is not None else tuple(f"view{k + 1}" for k in range(len(packed)))
        if len(self.names) != len(packed):
            raise SilhouetteError("masks.names", expected=len(packed), found=len(self.names))
        self._packed = packed
        self._missing = np.zeros((len(packed), self.n_frames), bool)
        if missing is not None:
            flags = np.asarray(missing, bool)
            if flags.ndim != 2 or flags.shape[0] != len(packed) or flags.shape[1] < self.n_frames:
                raise SilhouetteError("masks.missing", expected=str(self._missing.shape), found=str(flags.shape))
            self._missing = flags[:, : self.n_frames].copy()
        self.warnings = ()
        if max(lengths) > self.n_frames:
            self.warnings = (Message("masks.frame_counts", counts=lengths, used=self.n_frames),)

    def read(self, frame: int) -> tuple[Mask | None, ...]:
        """Return the masks (height, width) of all views in one frame; None where a view has no image."""
        return tuple(self.read_view(view, frame) for view in range(self.n_views))

    def read_view(self, view: int, frame: int) -> Mask | None:
        """Return the mask of one view."""
        frame = checked_frame(frame, self.n_frames)
        if self._missing[view, frame]:
            return None
        return np.unpackbits(self._packed[view][frame], axis=1, count=self.sizes[view][0]).view(bool)


class View(ABC):
    """The silhouettes of one camera, from any source: as `Silhouettes`, with one name and one size.

    ``times`` (T,) are s of each frame since the first, None where ``frame_rate`` says them.
    """

    name: str
    size: tuple[int, int]
    n_frames: int
    frame_rate: float
    times: FloatArray | None = None
    warnings: Sequence[Message] = ()

    @abstractmethod
    def read(self, frame: int) -> Mask | None:
        """Return the mask (height, width) of a frame; None where there is no image."""

    def look(self, frame: int) -> Image | None:
        """Return the image (height, width, 3) behind the mask of a frame; None where there is none."""
        return None

    def close(self) -> None:  # noqa: B027 - most kinds hold nothing open
        """Close open files; reading opens them again."""


class _ViewsOnOneClock(Silhouettes):
    """Views on a common clock; frame k is the time start + k / frame_rate of each."""

    def __init__(
        self,
        views: Sequence[View],
        clocks: Sequence[FloatArray],
        frame_rate: float,
        frames: tuple[int, int],
        warnings: Sequence[Message],
    ) -> None:
        self._views, self._own_warnings = tuple(views), warnings
        self.n_frames, self.frame_rate = frames[1] - frames[0], frame_rate
        self._frames = [nearest_frames(times, np.arange(*frames) / frame_rate) for times in clocks]
        self.names = _distinct(view.name for view in views)
        self.sizes = tuple(view.size for view in views)

    @property
    def warnings(self) -> tuple[Message, ...]:  # type: ignore[override]
        return (*self._own_warnings, *(text for view in self._views for text in view.warnings))

    def read(self, frame: int) -> tuple[Mask | None, ...]:
        return tuple(view.read(place) for view, place in self._places(frame))

    def look(self, frame: int) -> tuple[Image | None, ...]:
        return tuple(view.look(place) for view, place in self._places(frame))

    def _places(self, frame: int) -> list[tuple[View, int]]:
        """Return each view with the nearest of its own frames."""
        frame = checked_frame(frame, self.n_frames)
        return [(view, int(places[frame])) for view, places in zip(self._views, self._frames, strict=True)]

    def close(self) -> None:
        for view in self._views:
            view.close()


def _distinct(names: Iterable[str]) -> tuple[str, ...]:
    """Return the names, with a number added to repeated ones."""
    seen: list[str] = []
    for name in names:
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
    same_rate: float = 1e-3,
) -> Silhouettes:
    """Synchronise views: each frame takes the nearest image of every view, as long as the shortest view lasts.

    Parameters
    ----------
    views : at least one.
    frame_rate : Hz of the common clock; by default that of the slowest view, so that no image is used twice.
    offsets : (V,) s from the start of each recording to a common moment, such as a clap; 0 by default.
    frames : first frame and the one after the last, on the common clock; all by default.
    same_rate : share by which rates may differ and be one: 29.97 and 29.98 Hz are, 30 Hz drifts by a frame in half a
        minute.

    Raises
    ------
    SilhouetteError : no views, views that share no moment, frames outside the sequence.
    """
    if not views:
        raise SilhouetteError("masks.no_view")
    rates = [checked_rate(view.frame_rate, view.name) for view in views]
    rate = min(rates) if frame_rate is None else checked_rate(frame_rate)
    warnings: list[Message] = []
    if max(rates) > min(rates) * (1 + same_rate):
        warnings.append(Message("masks.rates", rates=rates, rate=rate))
    elif frame_rate is None:
        rates = [rate] * len(views)  # rates that are the same but for rounding must not drift apart
    times = [0.0] * len(views) if offsets is None else [float(value) for value in offsets]
    if len(times) != len(views) or not all(map(math.isfinite, times)):
        raise SilhouetteError("masks.offsets", expected=len(views), found=str(times))
    starts = [time - min(times) for time in times]
    clocks = [
        (np.arange(view.n_frames) / own if view.times is None else view.times) - start
        for view, own, start in zip(views, rates, starts, strict=True)
    ]
    lengths = [  # moments whose nearest image exists
        math.ceil((clock[-1] + 0.5 / own) * rate - 1e-9) for clock, own in zip(clocks, rates, strict=True)
    ]
    length = min(lengths)
    if length < 1:
        raise SilhouetteError("masks.no_common_moment", view=views[lengths.index(length)].name)
    if max(lengths) > length:
        named = tuple(f"{view.name} {count}" for view, count in zip(views, lengths, strict=True))
        warnings.append(Message("masks.lengths", lengths=named, rate=rate, used=length))
    first, stop = frames or (0, length)
    if not 0 <= first < stop <= length:
        raise SilhouetteError("masks.frames", frames=length, first=first, stop=stop)
    return _ViewsOnOneClock(views, clocks, rate, (first, stop), warnings)
