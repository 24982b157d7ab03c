"""Doubts about calibration, body and start, from the overlap of model and silhouettes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import Image, Mask
from dousa.errors import OptionError
from dousa.estimation.silhouettes.silhouettes import Silhouettes, WrappedSilhouettes
from dousa.messages import Message

if TYPE_CHECKING:
    from dousa.estimation import BodyModel, Camera
    from dousa.estimation.tracking.settings import Estimate


def describe_doubts(
    estimate: Estimate, body: BodyModel, names: Sequence[str], cameras: Sequence[Camera]
) -> list[Message]:
    """Describe doubts about calibration, body and start; ``body`` is the one before its girths were fitted."""
    return [
        *_weigh_overlaps(estimate, names),
        *_weigh_girths(estimate.body, body),
        *_cameras_inside(estimate, cameras),
    ]


def _weigh_girths(fitted: BodyModel, body: BodyModel, thin: float = 0.8, thick: float = 1.4) -> list[Message]:
    """A wrong stature shows in a person who is far thicker or thinner than people are.

    ``thin`` and ``thick`` are girths as shares of the model's; those of real people in clothes are 0.9 to 1.2.
    """
    if fitted.spheres.shape != body.spheres.shape:
        return []
    share = float(np.median(fitted.spheres[:, 3] / body.spheres[:, 3]))
    if thin <= share <= thick:
        return []
    return [Message("doubts.girth", share=share)]


def _weigh_overlaps(
    estimate: Estimate, names: Sequence[str], bad: float = 0.5, doubtful: float = 0.7, odd: float = 0.25
) -> list[Message]:
    """Doubt overlaps.

    Parameters
    ----------
    bad, doubtful : mean of all frames; real people tracked right lie above 0.72, wrong lenses and exchanged cameras at
        0.62 to 0.69.
    odd : how far a view is below the mean of the others.
    """
    seen = [view for view in range(len(names)) if np.isfinite(estimate.iou[:, view]).any()]
    means = {names[view]: float(np.nanmean(estimate.iou[:, view])) for view in seen}
    doubts = []
    if len(means) == 1:
        doubts.append(Message("doubts.one_view"))
    mean = float(np.mean(list(means.values()))) if means else 1.0
    if mean < bad:
        return [*doubts, Message("doubts.bad_overlap", overlap=mean)]
    if mean < doubtful:
        doubts.append(Message("doubts.low_overlap", overlap=mean))
    for name, value in means.items():
        others = float(np.mean([other for key, other in means.items() if key != name] or [value]))
        if value < others - odd:
            doubts.append(Message("doubts.odd_view", view=name, overlap=value, others=others))
    return doubts


def _cameras_inside(estimate: Estimate, cameras: Sequence[Camera]) -> list[Message]:
    from dousa.estimation.body.kinematics import place_parts

    body = estimate.body
    poses = estimate.poses[:: max(1, len(estimate.poses) // 200)]
    rotations, positions = place_parts(body, poses)
    inside = set()
    for part in range(body.n_parts):
        balls = _fill(body.spheres[body.sphere_starts[part] : body.sphere_starts[part + 1]])
        for number, camera in enumerate(cameras):
            if camera.kind == "pinhole":
                local = np.einsum("tji,tj->ti", rotations[:, part], camera.position - positions[:, part])
                off = np.linalg.norm(local[:, None] - balls[:, :3], axis=2) - balls[:, 3]
                if off.min() < 0.05:
                    inside.add(number)
    return [Message("doubts.camera_inside", camera=cameras[number].name) for number in sorted(inside)]


def _fill(spheres: NDArray[np.float64]) -> NDArray[np.float64]:
    """The spheres of a part and some between each two of them, which fill most of its solid."""
    first, second = np.triu_indices(len(spheres))
    return np.concatenate(
        [(1.0 - share) * spheres[first] + share * spheres[second] for share in (0.0, 0.25, 0.5, 0.75, 1.0)]
    )


Masks = Sequence[Mask | None]
Pictures = Sequence[Image | None]


def parse_frames(text: str | None, n_frames: int, what: Message) -> tuple[int, int]:
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
        raise OptionError("frames.not_a_range", found=text) from None
    start, stop, _ = slice(first, last).indices(n_frames)
    if start >= stop:
        raise OptionError("frames.none_left", found=text, what=what, last=n_frames - 1)
    return start, stop


class MirroredSilhouettes(WrappedSilhouettes):
    """Silhouettes with left and right of every image exchanged."""

    def read(self, frame: int) -> tuple[Mask | None, ...]:
        """The masks (height, width) of all views in one frame; None where a view has no image then."""
        return tuple(None if mask is None else np.ascontiguousarray(mask[:, ::-1]) for mask in self._inner.read(frame))

    def look(self, frame: int) -> tuple[Image | None, ...]:
        """The pictures (height, width, 3) behind the masks; None where there is none."""
        pictures = self._inner.look(frame)
        return tuple(None if picture is None else np.ascontiguousarray(picture[:, ::-1]) for picture in pictures)


class WatchedSilhouettes(WrappedSilhouettes):
    """Some frames of silhouettes; counts while reading what spoils an estimate; see `describe`.

    Parameters
    ----------
    inner : where the masks come from.
    start, stop : the frames of it, from start to before stop.
    most_kept : bytes of masks that are kept, one bit a pixel, so that drawings need not find them again.
    """

    def __init__(self, inner: Silhouettes, start: int, stop: int, most_kept: int = 0) -> None:
        super().__init__(inner)
        self.n_frames, self._start = stop - start, start
        self._counts: list[Counter[str]] = [Counter() for _ in inner.names]
        self._counted: set[int] = set()
        self._kept: dict[int, tuple[NDArray[np.uint8] | None, ...]] = {}
        each = sum(((width + 7) // 8) * height for width, height in inner.sizes)
        self._most_kept = most_kept // each
        self._show: Callable[[int, Masks, Pictures], None] | None = None
        self._shown: set[int] = set()

    def show(self, see: Callable[[int, Masks, Pictures], None] | None) -> None:
        """Call a function with masks and pictures (V,) of each frame when it is first read; None ends that."""
        self._show = see

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
        if frame not in self._counted:
            self._counted.add(frame)
            closely = len(self._counted) % 7 == 1  # to look for regions costs more than the rest
            for count, mask in zip(self._counts, masks, strict=True):
                _look(count, mask, closely)
        return masks

    @property
    def is_blank(self) -> bool:
        """Whether no frame that was read shows anything in any view."""
        return all(count["seen"] == count["empty"] + count["full"] for count in self._counts)

    def describe(self) -> tuple[Message, ...]:
        """Describe problems of the frames read so far."""
        return tuple(
            Message("doubts.view", view=name, problem=problem)
            for name, count in zip(self.names, self._counts, strict=True)
            for problem in _describe(count)
        )


def _look(
    count: Counter[str], mask: Mask | None, closely: bool, empty: float = 2e-4, full: float = 0.9, edge: float = 0.02
) -> None:
    """Count what is wrong with a mask.

    Parameters
    ----------
    count : of the view, is changed.
    mask : (height, width).
    closely : whether another region is looked for.
    empty : share of the image below which a silhouette is a few specks.
    full : share of the image that no person fills and is still seen whole.
    edge : of the outline's pixels that lie on the border of the image.
    """
    if mask is None:
        count["missing"] += 1
        return
    count["seen"] += 1
    share = np.count_nonzero(mask) / mask.size
    if share <= empty or share >= full:
        count["empty" if share <= empty else "full"] += 1
        return
    border = sum(int(np.count_nonzero(line)) for line in (mask[0], mask[-1], mask[:, 0], mask[:, -1]))
    count["cut"] += int(border > edge * 4.0 * np.sqrt(share * mask.size))
    if closely:
        count["looked"] += 1
        count["several"] += _has_second_region(mask)


def _has_second_region(mask: Mask, least: float = 0.3) -> bool:
    """Whether another region has this share of the largest one: another person, or a part cut off."""
    from dousa.extras import cv2

    _, _, stats, _ = cv2.connectedComponentsWithStats(mask.view(np.uint8), connectivity=8)
    areas: NDArray[np.int32] = np.sort(stats[1:, cv2.CC_STAT_AREA])
    return len(areas) > 1 and bool(areas[-2] > least * areas[-1])


def _describe(count: Counter[str], often: float = 0.2) -> list[Message]:
    """Describe what is wrong with a view: its edge or a second region in this share of the frames."""
    seen, problems = count["seen"], []
    if count["missing"]:
        problems.append(Message("doubts.no_image", count=count["missing"], total=seen + count["missing"]))
    if count["empty"]:
        problems.append(Message("doubts.empty", count=count["empty"], total=seen))
    if count["full"]:
        problems.append(Message("doubts.full", count=count["full"], total=seen))
    if count["cut"] > often * max(seen, 1):
        problems.append(Message("doubts.cut_off", count=count["cut"], total=seen))
    if count["several"] > often * max(count["looked"], 1):
        problems.append(Message("doubts.second_region"))
    return problems
