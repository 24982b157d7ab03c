"""Silhouettes S(t): which pixels of each view show the person, frame by frame."""

from __future__ import annotations

import operator
from abc import ABC, abstractmethod
from collections.abc import Sequence
from types import TracebackType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dousa.errors import SilhouetteError

__all__ = ["Image", "Mask", "PackedSilhouettes", "Silhouettes"]

Mask = NDArray[np.bool_]
Image = NDArray[np.uint8]
PackedMasks = NDArray[np.uint8]

_HIGHEST_RATE = 100_000.0


class Silhouettes(ABC):
    """Masks of one or more views over time, read a frame at a time so that long recordings need no memory.

    Attributes
    ----------
    names : (V,) names of the views.
    sizes : (V,) width and height of each view in pixels.
    n_frames : number of frames (of the shortest view, once the views are on one clock).
    frame_rate : Hz.
    warnings : what a person should know, in sentences; some are known only after frames were read.
    """

    names: tuple[str, ...]
    sizes: tuple[tuple[int, int], ...]
    n_frames: int
    frame_rate: float
    warnings: tuple[str, ...] = ()

    @abstractmethod
    def read(self, frame: int) -> tuple[Mask | None, ...]:
        """The masks (height, width) of all views in one frame; None where a view has no image then.

        Cheapest in rising order of frames; any order works.

        Raises
        ------
        SilhouetteError : no such frame, or its image is damaged.
        """

    def look(self, frame: int) -> tuple[Image | None, ...]:
        """The pictures (height, width, 3) blue, green, red behind the masks; None where there is none.

        Costs little right after the masks of the same frame were read.
        """
        return (None,) * self.n_views

    def close(self) -> None:  # noqa: B027 - most kinds hold nothing open
        """Let go of open files; reading again opens them again."""

    @property
    def n_views(self) -> int:
        """Number of views."""
        return len(self.names)

    def __enter__(self) -> Silhouettes:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def checked_frame(frame: int, n_frames: int) -> int:
    """The frame if it is one of n_frames, else a SilhouetteError."""
    try:
        index = operator.index(frame)
    except TypeError:
        raise SilhouetteError(f"expected a whole number as frame, got {frame!r}") from None
    if not 0 <= index < n_frames:
        raise SilhouetteError(f"expected a frame from 0 to {n_frames - 1}, got {index}")
    return index


def checked_rate(rate: float, where: str = "silhouettes") -> float:
    """The frame rate in Hz if it is one, else a SilhouetteError."""
    try:
        value = float(rate)
    except (TypeError, ValueError):
        value = float("nan")
    if not 0 < value <= _HIGHEST_RATE:
        raise SilhouetteError(f"{where}: expected a frame rate in Hz above 0, got {rate!r}")
    return value


class PackedSilhouettes(Silhouettes):
    """Silhouettes in memory, one bit a pixel.

    Parameters
    ----------
    masks : (V, T, H, W) bool; or one (T, H, W) bool per view, whose sizes and lengths may differ: the shortest
        counts, and a warning says so. Numbers count as foreground where they are not 0.
    frame_rate : Hz.
    names : (V,) names of the views; view1, view2 ... by default.
    missing : (V, T) bool, True where a view has no image; none by default.

    Raises
    ------
    SilhouetteError : no views, frames or pixels, arrays of another shape, a frame rate that is none.
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
                raise SilhouetteError(
                    f"view {view + 1}: expected masks of shape (frames, height, width), "
                    f"got {values.shape} of {values.dtype}"
                )
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
        """Silhouettes from masks that are packed already.

        Parameters
        ----------
        packed : per view (T, H, ceil(W / 8)) uint8, as ``np.packbits(masks, axis=2)`` gives.
        sizes : (V,) width and height in pixels.
        frame_rate, names, missing : as for the class.
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
            raise SilhouetteError("expected the masks of at least one view, got none")
        for view, (array, (width, height)) in enumerate(zip(packed, sizes, strict=True)):
            if array.dtype != np.uint8 or array.ndim != 3 or array.shape[1:] != (height, (width + 7) // 8):
                raise SilhouetteError(
                    f"view {view + 1}: expected packed masks of {width} x {height} pixels, "
                    f"got {array.shape} of {array.dtype}"
                )
            if min(array.shape) < 1:
                raise SilhouetteError(
                    f"view {view + 1}: expected at least one frame and pixel, got {array.shape}"
                )
        lengths = [len(array) for array in packed]
        self.n_frames = min(lengths)
        self.frame_rate = checked_rate(frame_rate)
        self.sizes = tuple((int(width), int(height)) for width, height in sizes)
        self.names = tuple(names) if names is not None else tuple(f"view{k + 1}" for k in range(len(packed)))
        if len(self.names) != len(packed):
            raise SilhouetteError(f"expected {len(packed)} names of views, got {len(self.names)}")
        self._packed = packed
        self._missing = np.zeros((len(packed), self.n_frames), bool)
        if missing is not None:
            flags = np.asarray(missing, bool)
            if flags.ndim != 2 or flags.shape[0] != len(packed) or flags.shape[1] < self.n_frames:
                raise SilhouetteError(
                    f"expected missing frames of shape {self._missing.shape}, got {flags.shape}"
                )
            self._missing = flags[:, : self.n_frames].copy()
        self.warnings = ()
        if max(lengths) > self.n_frames:
            self.warnings = (
                f"the views have {', '.join(map(str, lengths))} frames; only the first {self.n_frames} are used",
            )

    def read(self, frame: int) -> tuple[Mask | None, ...]:
        """The masks (height, width) of all views in one frame; None where a view has no image then."""
        frame = checked_frame(frame, self.n_frames)
        return tuple(
            None if missing else np.unpackbits(array[frame], axis=1, count=width).view(bool)
            for array, (width, _), missing in zip(
                self._packed, self.sizes, self._missing[:, frame], strict=True
            )
        )
