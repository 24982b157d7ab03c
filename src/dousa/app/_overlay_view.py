"""One view of one frame: image or silhouette, its outline, the model's parts and its skeleton.

Left and right differ by colour, by line (right is dashed) and by a letter at hands and feet.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dousa.app._overlay_paint import (
    CENTRE,
    DARK,
    HALF_DARK,
    LEFT,
    PALE,
    RIGHT,
    WHITE,
    Colour,
    Image,
    draw_dashed,
    draw_dashed_outlines,
    draw_line,
    draw_outlines,
    find_outlines,
    hatch,
    measure_text,
    write_text,
)

if TYPE_CHECKING:
    from dousa.estimation.body import BodyModel
    from dousa.estimation.camera import Camera

__all__ = ["SIDE_COLOURS", "ViewPainter", "side_of"]

Mask = NDArray[np.bool_]
FloatArray = NDArray[np.float64]

SIDE_COLOURS: dict[str, Colour] = {"left": LEFT, "right": RIGHT, "": CENTRE}

_WALL = 246  # grey of a background that is not known
_SILHOUETTE = 204
_FILL = 0.42  # share of the limb's colour over what is below
_VIDEO_SHARE = 0.8  # of the image's contrast, so that lines stand out


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
        from dousa.estimation.kinematics import point_names

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
        box = _box_of(labels >= 0)
        if box is not None:
            self._fill_parts(canvas[box], labels[box], hidden)
        if mask is not None:
            outlines = find_outlines(self._fit(mask))
            draw_outlines(canvas, outlines, WHITE, 4)
            draw_outlines(canvas, outlines, DARK, 2)
        if box is not None:
            self._outline_parts(
                canvas, labels[box], order, np.array([box[1].start, box[0].start], np.float64)
            )
        self._draw_skeleton(canvas, pose)
        return canvas

    def _paint_base(self, mask: Mask | None, image: Image | None) -> Image:
        import cv2

        size = (self._camera.width, self._camera.height)
        if image is not None:
            colours = np.repeat(image[..., None], 3, axis=2) if image.ndim == 2 else image
            fitted = cv2.resize(np.ascontiguousarray(colours), size, interpolation=cv2.INTER_AREA)
            return np.asarray(cv2.convertScaleAbs(fitted, alpha=_VIDEO_SHARE, beta=20), np.uint8)
        canvas = np.full((size[1], size[0], 3), _WALL, np.uint8)
        if mask is None:
            hatch(canvas, PALE)
            write_text(
                canvas,
                "no image",
                ((size[0] - measure_text("no image", 18)) // 2, size[1] - 12),
                HALF_DARK,
                18,
            )
        else:
            canvas[self._fit(mask)] = _SILHOUETTE
        return canvas

    def _fit(self, mask: Mask) -> Mask:
        """The silhouette at the picture's size, its edge smooth."""
        import cv2

        size = (self._camera.width, self._camera.height)
        fitted = cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_LINEAR)
        return np.asarray(fitted > 0.5)

    def _label_parts(self, pose: FloatArray) -> tuple[NDArray[np.int16], list[int]]:
        """Which part is seen in each pixel (-1 for none), and the parts from far to near."""
        from dousa.estimation.kinematics import place_parts
        from dousa.estimation.rasteriser import draw_parts

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

    def _fill_parts(self, canvas: Image, labels: NDArray[np.int16], hidden: Mask) -> None:
        import cv2

        colours = np.array([SIDE_COLOURS[side_of(name)] for name in self._body.names], np.uint8)
        filled = np.append(~hidden, False)[labels]  # label -1 is the last entry
        blend = cv2.addWeighted(np.ascontiguousarray(canvas), 1.0 - _FILL, colours[labels], _FILL, 0.0)
        np.copyto(canvas, blend, where=filled[..., None])

    def _outline_parts(
        self, canvas: Image, labels: NDArray[np.int16], order: list[int], corner: FloatArray
    ) -> None:
        for part in order:
            side = side_of(self._body.names[part])
            outlines = [outline + corner for outline in find_outlines(labels == part)]
            draw = draw_dashed_outlines if side == "right" else draw_outlines
            draw(canvas, outlines, SIDE_COLOURS[side])

    def _draw_skeleton(self, canvas: Image, pose: FloatArray) -> None:
        from dousa.estimation.kinematics import compute_points

        world = compute_points(self._body, pose)
        points = self._camera.project(world)
        if self._camera.kind == "pinhole":
            points[self._camera.compute_depths(world) < 0.05] = np.nan
        for start, end in self._bones:
            bone = points[[start, end]]
            if not np.isfinite(bone).all():
                continue
            side = side_of(self._body.names[start])
            draw_line(canvas, bone, WHITE, 3)
            (draw_dashed if side == "right" else draw_line)(canvas, bone, SIDE_COLOURS[side], 2)
        for name, point in zip(self._names, points, strict=True):
            if np.isfinite(point).all():
                _mark_joint(canvas, point, side_of(name))
        for name, point in zip(self._body.tips, points[self._body.n_parts :], strict=True):
            if side_of(name) and np.isfinite(point).all():
                _write_side(canvas, point, side_of(name))


def _box_of(mask: Mask) -> tuple[slice, slice] | None:
    """Rows and columns of what is set; None if nothing is."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not len(rows):
        return None
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)


def _mark_joint(canvas: Image, point: FloatArray, side: str) -> None:
    """A round mark on the left and in the middle, a square one on the right."""
    square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], np.float64)
    turns = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    shape = square if side == "right" else np.stack((np.cos(turns), np.sin(turns)), axis=1) * 1.2
    draw_outlines(canvas, [point + 2.6 * shape], WHITE, 3)
    draw_outlines(canvas, [point + 1.6 * shape], SIDE_COLOURS[side], 2)


def _write_side(canvas: Image, point: FloatArray, side: str) -> None:
    height, width = canvas.shape[:2]
    column, row = int(point[0]) + 7, int(point[1]) + 13
    if not (0 <= column < width and 0 <= row < height + 13):
        return
    letter = side[0].upper()
    for right, down in ((-1, 0), (1, 0), (0, -1), (0, 1)):
        write_text(canvas, letter, (column + right, row + down), WHITE, 13, bold=True)
    write_text(canvas, letter, (column, row), SIDE_COLOURS[side], 13, bold=True)
