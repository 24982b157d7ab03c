"""Silhouettes that are looked at while they are read: what a person should know before trusting the result."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from dousa.errors import OptionError
from dousa.estimation.silhouettes import Image, Mask, Silhouettes

__all__ = ["MirroredSilhouettes", "WatchedSilhouettes", "parse_frames"]

Masks = Sequence[Mask | None]
Pictures = Sequence[Image | None]

_FULL = 0.9  # share of the image that no person fills and is still seen whole
_EMPTY = 2e-4  # share of the image below which a silhouette is a few specks
_SECOND = 0.3  # of the largest region: another region of this size is another person, or a part cut off
_EVERY = 7  # frames between two looks for regions, which cost more than the rest
_OFTEN = 0.2  # share of the frames from which something is said
_EDGE = 0.02  # of the outline's pixels lying on the border of the image


def parse_frames(text: str | None, n_frames: int, what: str) -> tuple[int, int]:
    """``A:B`` as the frames from A to before B; either may be left out, negative numbers count from the end.

    Raises
    ------
    OptionError : not two numbers, or no frame between them.
    """
    if text is None:
        return 0, n_frames
    words = text.split(":")
    try:
        if len(words) != 2:
            raise ValueError
        first, last = (int(word) if word.strip() else None for word in words)
    except ValueError:
        raise OptionError(f"--frames: expected A:B, such as 0:100, got '{text}'") from None
    start, stop, _ = slice(first, last).indices(n_frames)
    if start >= stop:
        raise OptionError(f"--frames {text}: {what} has the frames 0 to {n_frames - 1}, that leaves none")
    return start, stop


@dataclass(slots=True)
class _ViewCount:
    seen: int = 0
    missing: int = 0
    empty: int = 0
    full: int = 0
    cut: int = 0
    looked: int = 0
    several: int = 0


@dataclass(slots=True)
class _Counts:
    views: list[_ViewCount] = field(default_factory=list)
    frames: set[int] = field(default_factory=set)


class MirroredSilhouettes(Silhouettes):
    """Silhouettes with left and right of every image exchanged.

    Parameters
    ----------
    inner : where the masks come from.
    """

    def __init__(self, inner: Silhouettes) -> None:
        self.names, self.sizes, self.frame_rate = inner.names, inner.sizes, inner.frame_rate
        self.n_frames = inner.n_frames
        self._inner = inner

    @property
    def warnings(self) -> tuple[str, ...]:  # type: ignore[override]
        """What the source says."""
        return self._inner.warnings

    def read(self, frame: int) -> tuple[Mask | None, ...]:
        """The masks (height, width) of all views in one frame; None where a view has no image then."""
        return tuple(
            None if mask is None else np.ascontiguousarray(mask[:, ::-1]) for mask in self._inner.read(frame)
        )

    def look(self, frame: int) -> tuple[Image | None, ...]:
        """The pictures (height, width, 3) behind the masks; None where there is none."""
        return tuple(
            None if picture is None else np.ascontiguousarray(picture[:, ::-1])
            for picture in self._inner.look(frame)
        )

    def close(self) -> None:
        """Let go of open files."""
        self._inner.close()


class WatchedSilhouettes(Silhouettes):
    """Some frames of silhouettes; counts while reading what spoils an estimate.

    Parameters
    ----------
    inner : where the masks come from.
    start, stop : the frames of it, from start to before stop.
    most_kept : bytes of masks that are kept, one bit a pixel, so that drawings need not find them again.
    """

    def __init__(self, inner: Silhouettes, start: int, stop: int, most_kept: int = 0) -> None:
        self.names, self.sizes, self.frame_rate = inner.names, inner.sizes, inner.frame_rate
        self.n_frames = stop - start
        self._inner, self._start = inner, start
        self._counts = _Counts([_ViewCount() for _ in inner.names])
        self._kept: dict[int, tuple[NDArray[np.uint8] | None, ...]] = {}
        each = sum(((width + 7) // 8) * height for width, height in inner.sizes)
        self._most_kept = most_kept // each
        self._show: Callable[[int, Masks, Pictures], None] | None = None
        self._shown: set[int] = set()

    def show(self, see: Callable[[int, Masks, Pictures], None] | None) -> None:
        """Show somebody masks and pictures (V,) of every frame read for the first time from now on; None: nobody."""
        self._show = see

    @property
    def warnings(self) -> tuple[str, ...]:  # type: ignore[override]
        """What the source says; see `describe` for what was seen."""
        return self._inner.warnings

    def read(self, frame: int) -> tuple[Mask | None, ...]:
        """The masks (height, width) of all views in one frame; None where a view has no image then."""
        masks = self._read(frame)
        if self._show is not None and frame not in self._shown:
            self._shown.add(frame)
            self._show(frame, masks, self.look(frame))
        return masks

    def look(self, frame: int) -> tuple[Image | None, ...]:
        """The pictures (height, width, 3) behind the masks; None where there is none."""
        return self._inner.look(self._start + frame)

    def _read(self, frame: int) -> tuple[Mask | None, ...]:
        if frame in self._kept:
            return tuple(
                None if bits is None else np.unpackbits(bits, axis=1, count=width).view(bool)
                for bits, (width, _) in zip(self._kept[frame], self.sizes, strict=True)
            )
        masks = self._inner.read(self._start + frame)
        if len(self._kept) < self._most_kept:
            self._kept[frame] = tuple(None if mask is None else np.packbits(mask, axis=1) for mask in masks)
        if frame not in self._counts.frames:
            self._counts.frames.add(frame)
            for count, mask in zip(self._counts.views, masks, strict=True):
                _look(count, mask, len(self._counts.frames) % _EVERY == 1)
        return masks

    def close(self) -> None:
        """Let go of open files."""
        self._inner.close()

    @property
    def is_blank(self) -> bool:
        """Whether no frame that was read shows anything in any view."""
        return all(count.seen == count.empty + count.full for count in self._counts.views)

    def describe(self) -> tuple[str, ...]:
        """Sentences about what was read so far."""
        said = []
        for name, count in zip(self.names, self._counts.views, strict=True):
            said += [f"view '{name}': {words}" for words in _describe(count)]
        return tuple(said)


def _look(count: _ViewCount, mask: Mask | None, closely: bool) -> None:
    if mask is None:
        count.missing += 1
        return
    count.seen += 1
    share = np.count_nonzero(mask) / mask.size
    if share <= _EMPTY:
        count.empty += 1
        return
    if share >= _FULL:
        count.full += 1
        return
    border = sum(int(np.count_nonzero(line)) for line in (mask[0], mask[-1], mask[:, 0], mask[:, -1]))
    count.cut += border > _EDGE * 4.0 * np.sqrt(share * mask.size)
    if closely:
        count.looked += 1
        count.several += _has_second_region(mask)


def _has_second_region(mask: Mask) -> bool:
    import cv2

    _, _, stats, _ = cv2.connectedComponentsWithStats(mask.view(np.uint8), connectivity=8)
    areas: NDArray[np.int32] = np.sort(stats[1:, cv2.CC_STAT_AREA])
    return len(areas) > 1 and bool(areas[-2] > _SECOND * areas[-1])


def _describe(count: _ViewCount) -> list[str]:
    total, said = max(count.seen, 1), []
    if count.missing:
        said.append(f"{count.missing} of {count.seen + count.missing} frames have no image")
    if count.empty:
        said.append(f"{count.empty} of {count.seen} silhouettes are empty; is the person in the image then?")
    if count.full:
        said.append(
            f"{count.full} of {count.seen} silhouettes fill the image; is the foreground white, and the plate right?"
        )
    if count.cut > _OFTEN * total:
        said.append(
            f"{count.cut} of {count.seen} silhouettes reach the border of the image; what is cut off is guessed"
        )
    if count.several > _OFTEN * max(count.looked, 1):
        said.append(
            "there is often a second region nearly as large as the first: several people, or a person in pieces; "
            "one person is tracked, and others pull at the limbs"
        )
    return said
