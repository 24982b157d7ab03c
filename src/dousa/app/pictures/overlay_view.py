"""One view of an overlay: the silhouette or its picture, its outline, the model's parts and its skeleton.

Left and right differ by colour, by line (right is dashed) and by a letter at hands and feet. Colours are blue, green,
red as OpenCV has them.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dousa.app.pictures.canvas import FAINT, GREY, INK, SIDE_COLOURS
from dousa.arrays import FloatArray, Image, Mask
from dousa.errors import OptionError

if TYPE_CHECKING:
    from dousa.estimation.body.body import BodyModel
    from dousa.estimation.cameras.camera import Camera
    from dousa.estimation.silhouettes.silhouettes import Silhouettes
    from dousa.estimation.tracking.settings import Estimate

Colour = tuple[int, int, int]
Points = NDArray[np.float64]


def to_bgr(code: str) -> Colour:
    """The colour of a code such as #0072B2."""
    red, green, blue = (int(code[k : k + 2], 16) for k in (1, 3, 5))
    return blue, green, red


BGR_OF_SIDE = {side: to_bgr(code) for side, code in SIDE_COLOURS.items()}
DARK, HALF_DARK, PALE, WHITE, ALARM = to_bgr(INK), to_bgr(GREY), to_bgr(FAINT), (255, 255, 255), to_bgr("#B22222")

_FRACTION_BITS = 4  # bits after the binary point of coordinates for OpenCV
_FAR = 20_000.0  # px, outside any picture; with the fraction it fits the 32 bits of OpenCV
_DASH, _GAP = 8, 7  # px


def check_views(estimate: Estimate, silhouettes: Silhouettes, cameras: Sequence[Camera]) -> None:
    """OptionError where cameras, silhouettes and estimate are of different numbers of views."""
    if not len(cameras) == silhouettes.n_views == estimate.iou.shape[1]:
        raise OptionError(
            "pictures.views_differ",
            cameras=len(cameras),
            silhouettes=silhouettes.n_views,
            estimate=estimate.iou.shape[1],
        )


def to_rgb(image: Image) -> Image:
    """For matplotlib, which has red first."""
    return np.ascontiguousarray(image[..., ::-1])


def draw_lines(
    canvas: Image,
    lines: Sequence[Points],
    colour: Colour,
    width: int = 1,
    *,
    closed: bool = False,
    dashed: bool = False,
) -> None:
    """Draw lines through points (N, 2) column, row px that need not be whole; ``closed`` ones end where they begin."""
    from dousa.extras import cv2

    if dashed:
        whole = [np.concatenate((line, line[:1])) for line in lines] if closed else lines
        drawn, closed = [dash for line in whole for dash in _break_up(line)], False
    else:
        drawn = [_fixed(line) for line in lines]
    if drawn:
        cv2.polylines(canvas, drawn, closed, colour, width, cv2.LINE_AA, _FRACTION_BITS)


def _break_up(points: Points, longest: float = 10_000.0) -> list[NDArray[np.int32]]:
    """The dashes of a line, their points a pixel apart; a line that is longer (px) leaves the picture and is whole."""
    limited = np.clip(points, -_FAR, _FAR)
    lengths = np.linalg.norm(np.diff(limited, axis=0), axis=1)
    run = np.concatenate(([0.0], np.cumsum(lengths)))
    if not 1.0 <= run[-1] <= longest:
        return [_fixed(points)]
    at = np.arange(0.0, run[-1] + 1.0)
    even = _fixed(np.stack([np.interp(at, run, limited[:, axis]) for axis in (0, 1)], axis=1))
    return [even[start : start + _DASH] for start in range(0, len(even) - 1, _DASH + _GAP)]


def _fixed(points: Points) -> NDArray[np.int32]:
    limited = np.minimum(np.maximum(points, -_FAR), _FAR)
    fixed: NDArray[np.int32] = np.rint(limited * 2**_FRACTION_BITS).astype(np.int32)
    return fixed.reshape(-1, 1, 2)


def find_outlines(mask: NDArray[np.bool_]) -> list[Points]:
    """The borders (N, 2) of every piece and hole of a mask."""
    from dousa.extras import cv2

    box = find_box(mask)
    if box is None:
        return []
    cut = np.ascontiguousarray(mask[box]).view(np.uint8)
    found, _ = cv2.findContours(cut, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    corner = np.array([box[1].start, box[0].start], np.float64)
    return [outline[:, 0] + corner for outline in found]


def hatch(canvas: Image, colour: Colour, spacing: int = 14) -> None:
    """Strike a picture through with slanted lines, in place."""
    height, width = canvas.shape[:2]
    starts = range(-height, width, spacing)
    draw_lines(canvas, [np.array([[start, height], [start + height, 0]], np.float64) for start in starts], colour)


@lru_cache(maxsize=1)
def _font() -> Any:
    """OpenCV 5 has a font for every script; older ones draw Latin letters only."""
    from dousa.extras import cv2

    return cv2.FontFace("sans") if hasattr(cv2, "FontFace") else None


def write_text(
    canvas: Image, text: str, place: tuple[int, int], colour: Colour = DARK, size: int = 15, *, bold: bool = False
) -> None:
    """Write one line; ``place`` is the left end of its base line, ``size`` its height in px."""
    from dousa.extras import cv2

    font = _font()
    if font is not None:
        cv2.putText(canvas, text, place, colour, font, size, 700 if bold else 400)
        return
    plain = text.encode("ascii", "replace").decode()
    scale = size / 30.0
    cv2.putText(canvas, plain, place, cv2.FONT_HERSHEY_SIMPLEX, scale, colour, 2 if bold else 1, cv2.LINE_AA)


def measure_text(text: str, size: int = 15, *, bold: bool = False) -> int:
    """Width (px) of a line."""
    from dousa.extras import cv2

    font = _font()
    if font is not None:
        return int(cv2.getTextSize((4000, 100), text, (0, 50), font, size, 700 if bold else 400)[2])
    plain = text.encode("ascii", "replace").decode()
    return int(cv2.getTextSize(plain, cv2.FONT_HERSHEY_SIMPLEX, size / 30.0, 2 if bold else 1)[0][0])


def side_of(name: str) -> str:
    """``"left"``, ``"right"`` or nothing, by the beginning of a name."""
    return next((side for side in ("left", "right") if name.startswith(side)), "")


class ViewPainter:
    """Paints what one camera sees.

    Parameters
    ----------
    body : with P parts and A joint angles.
    camera : the view.
    width, height : px, size of the pictures to paint.
    """

    def __init__(self, body: BodyModel, camera: Camera, width: int, height: int) -> None:
        from dousa.estimation.body.kinematics import point_names

        self._body = body
        self._camera = camera.resized(width, height)
        self._names = point_names(body)
        owners = np.concatenate((body.parents, body.tip_parts))
        self._bones = [(int(owner), end) for end, owner in enumerate(owners) if owner >= 0]

    def paint(self, pose: FloatArray, mask: Mask | None, image: Image | None, hidden: Mask) -> Image:
        """One picture.

        Parameters
        ----------
        pose : (7 + A,).
        mask : the silhouette (H, W); None where the view has no image.
        image : (H, W, 3) or (H, W) of the video, if there is one.
        hidden : (P,) parts that only inertia places: their solids stay empty.
        """
        canvas = self._paint_base(mask, image)
        labels, order = self._label_parts(pose)
        box = find_box(labels >= 0)
        if box is not None:
            self._fill_parts(canvas[box], labels[box], hidden)
        if mask is not None:
            outlines = find_outlines(self._fit(mask))
            draw_lines(canvas, outlines, WHITE, 4, closed=True)
            draw_lines(canvas, outlines, DARK, 2, closed=True)
        if box is not None:
            self._outline_parts(canvas, labels[box], order, np.array([box[1].start, box[0].start], np.float64))
        self._draw_skeleton(canvas, pose)
        return canvas

    def _paint_base(self, mask: Mask | None, image: Image | None) -> Image:
        from dousa.extras import cv2

        size = (self._camera.width, self._camera.height)
        if image is not None:
            colours = np.repeat(image[..., None], 3, axis=2) if image.ndim == 2 else image
            fitted = cv2.resize(np.ascontiguousarray(colours), size, interpolation=cv2.INTER_AREA)
            return np.asarray(cv2.convertScaleAbs(fitted, alpha=0.8, beta=20), np.uint8)  # paler than its lines
        canvas = np.full((size[1], size[0], 3), 246, np.uint8)  # a light grey where the background is not known
        if mask is None:
            hatch(canvas, PALE)
            place = (size[0] - measure_text("no image", 18)) // 2, size[1] - 12
            write_text(canvas, "no image", place, HALF_DARK, 18)
        else:
            canvas[self._fit(mask)] = 204
        return canvas

    def _fit(self, mask: Mask) -> Mask:
        from dousa.extras import cv2

        size = (self._camera.width, self._camera.height)
        fitted = cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_LINEAR)
        return np.asarray(fitted > 0.5)

    def _label_parts(self, pose: FloatArray) -> tuple[NDArray[np.int16], list[int]]:
        """Which part is seen in each pixel (-1 for none), and the parts from far to near."""
        from dousa.estimation.body.kinematics import place_parts
        from dousa.estimation.raster.rasteriser import draw_parts

        body = self._body
        rotations, positions = place_parts(body, pose)
        owner = np.repeat(np.arange(body.n_parts), np.diff(body.sphere_starts))
        centres = positions[owner] + np.einsum("sij,sj->si", rotations[owner], body.spheres[:, :3])
        depths = self._camera.compute_depths(centres)
        mean = np.bincount(owner, depths) / np.bincount(owner)
        labels = np.full((self._camera.height, self._camera.width), -1, np.int16)
        masks = draw_parts(body, pose, self._camera)[0]
        order = [int(part) for part in np.argsort(-mean, kind="stable")]
        for part in order:
            labels[masks[part]] = part
        return labels, order

    def _fill_parts(self, canvas: Image, labels: NDArray[np.int16], hidden: Mask, share: float = 0.42) -> None:
        """Colour the parts that are not hidden; the colour of the limb has this share over what is below."""
        from dousa.extras import cv2

        colours = np.array([BGR_OF_SIDE[side_of(name)] for name in self._body.names], np.uint8)
        filled = np.append(~hidden, False)[labels]  # label -1 is the last entry
        blend = cv2.addWeighted(np.ascontiguousarray(canvas), 1.0 - share, colours[labels], share, 0.0)
        np.copyto(canvas, blend, where=filled[..., None])

    def _outline_parts(self, canvas: Image, labels: NDArray[np.int16], order: list[int], corner: FloatArray) -> None:
        for part in order:
            side = side_of(self._body.names[part])
            outlines = [outline + corner for outline in find_outlines(labels == part)]
            draw_lines(canvas, outlines, BGR_OF_SIDE[side], closed=True, dashed=side == "right")

    def _draw_skeleton(self, canvas: Image, pose: FloatArray) -> None:
        from dousa.estimation.body.kinematics import compute_points

        world = compute_points(self._body, pose)
        points = self._camera.project(world)
        if self._camera.kind == "pinhole":
            points[self._camera.compute_depths(world) < 0.05] = np.nan
        for start, end in self._bones:
            bone = points[[start, end]]
            if not np.isfinite(bone).all():
                continue
            side = side_of(self._body.names[start])
            draw_lines(canvas, [bone], WHITE, 3)
            draw_lines(canvas, [bone], BGR_OF_SIDE[side], 2, dashed=side == "right")
        for name, point in zip(self._names, points, strict=True):
            if np.isfinite(point).all():
                _mark_joint(canvas, point, side_of(name))
        for name, point in zip(self._body.tips, points[self._body.n_parts :], strict=True):
            if side_of(name) and np.isfinite(point).all():
                _write_side(canvas, point, side_of(name))


def find_box(mask: Mask) -> tuple[slice, slice] | None:
    """Rows and columns of what a mask (height, width) shows; None if it is empty."""
    from dousa.extras import cv2

    left, top, width, height = cv2.boundingRect(np.ascontiguousarray(mask).view(np.uint8))
    return (slice(top, top + height), slice(left, left + width)) if width else None


def _mark_joint(canvas: Image, point: FloatArray, side: str) -> None:
    square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], np.float64)
    turns = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    shape = square if side == "right" else np.stack((np.cos(turns), np.sin(turns)), axis=1) * 1.2
    draw_lines(canvas, [point + 2.6 * shape], WHITE, 3, closed=True)
    draw_lines(canvas, [point + 1.6 * shape], BGR_OF_SIDE[side], 2, closed=True)


def _write_side(canvas: Image, point: FloatArray, side: str) -> None:
    height, width = canvas.shape[:2]
    column, row = int(point[0]) + 7, int(point[1]) + 13
    if not (0 <= column < width and 0 <= row < height + 13):
        return
    letter = side[0].upper()
    for right, down in ((-1, 0), (1, 0), (0, -1), (0, 1)):
        write_text(canvas, letter, (column + right, row + down), WHITE, 13, bold=True)
    write_text(canvas, letter, (column, row), BGR_OF_SIDE[side], 13, bold=True)
