"""Contours of a person's masks as observations of a pose: each of their points lies on the outline of some part.

The outline of a part, the hull of its spheres, is that of the cones between pairs of them. A point's distance is that
to the nearest cone (iterated closest points: Besl and McKay, "A method for registration of 3-D shapes", 1992).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray, IndexArray, Mask
from dousa.estimation.body.body import BodyModel
from dousa.estimation.cameras.camera import Camera
from dousa.estimation.multiview.landmarks import Landmarks
from dousa.estimation.multiview.triangulation import pixels_per_metre, project_slope

CONTOUR_POINTS = 96
"""Points of a contour: one every 2 % of a stature or so."""


def trace_contour(
    mask: Mask | None, size: tuple[int, int], count: int = CONTOUR_POINTS, least: float = 0.1
) -> FloatArray:
    """Return ``count`` points (count, 2) of a mask's contours, px of a picture of ``size``; nan where there are none.

    Pieces below the share ``least`` of the largest one are specks; points at the edge of the picture are no outline.
    """
    from dousa.extras import cv2

    points = np.full((count, 2), np.nan)
    if mask is None or not mask.any():
        return points
    found, _ = cv2.findContours(np.ascontiguousarray(mask, np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    largest = max(len(line) for line in found)
    line = np.concatenate([own[:, 0] for own in found if len(own) >= least * largest]).astype(np.float64)
    height, width = mask.shape
    line = line[((line > 1) & (line < (width - 2, height - 2))).all(axis=1)]
    if len(line):
        chosen = line[np.unique(np.linspace(0, len(line) - 1, count).astype(int))]
        points[: len(chosen)] = (chosen + 0.5) * np.array([size[0] / width, size[1] / height]) - 0.5
    return points


@dataclass(frozen=True, slots=True, eq=False)
class Cones:
    """The spheres of a body, and the pairs of them that lie in one part.

    Parameters
    ----------
    centres : (S,) of the spheres.
    radii : (S,) m.
    pairs : (E, 2) of spheres.
    """

    centres: Landmarks
    radii: FloatArray
    pairs: IndexArray


def list_cones(body: BodyModel) -> Cones:
    """Return the cones of a body."""
    starts = body.sphere_starts
    owners = np.repeat(np.arange(body.n_parts), np.diff(starts))
    within = [range(first, stop) for first, stop in pairwise(starts)]
    pairs = [pair for own in within for pair in (combinations(own, 2) if len(own) > 1 else [(own[0], own[0])])]
    names = ("",) * len(owners)
    centres = Landmarks(names, owners, body.spheres[:, :3], np.ones(len(owners)), names)
    return Cones(centres, body.spheres[:, 3], np.array(pairs))


def contour_errors(
    camera: Camera, cones: Cones, points: NDArray[np.floating], places: FloatArray, slopes: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Compute how far (T, C) m points lie outside the body, nan where unknown, and their slopes (T, C, D).

    Parameters
    ----------
    camera : of the view.
    cones : of the body.
    points : (T, C, 2) px, of contours.
    places, slopes : (T, S, 3) m of the spheres, (T, S, 3, D).
    """
    scale = pixels_per_metre(camera, places)
    discs, radii = camera.project(places), cones.radii * scale
    one, other = cones.pairs.T
    way = (discs[:, other] - discs[:, one])[:, None]
    off = points[:, :, None] - discs[:, None, one]
    share = np.clip((off * way).sum(axis=-1) / np.maximum((way * way).sum(axis=-1), 1e-9), 0.0, 1.0)
    beyond = np.linalg.norm(off - share[..., None] * way, axis=-1)
    thick = radii[:, None, one] + share * (radii[:, other] - radii[:, one])[:, None]
    nearest = np.nan_to_num(beyond - thick, nan=np.inf).argmin(axis=-1)
    frame = np.arange(len(points))[:, None]
    rows = np.arange(points.shape[1])[None]
    part = share[frame, rows, nearest][..., None]
    first, last = one[nearest], other[nearest]
    at = (1.0 - part) * places[frame, first] + part * places[frame, last]
    middle = (1.0 - part[..., 0]) * cones.radii[first] + part[..., 0] * cones.radii[last]
    turn = (1.0 - part[..., None]) * slopes[frame, first] + part[..., None] * slopes[frame, last]
    unit = pixels_per_metre(camera, at)
    arm = points - camera.project(at)
    length = np.linalg.norm(arm, axis=-1)
    error = length / unit - middle
    normal = arm / np.maximum(length, 1e-9)[..., None]
    flow = np.einsum("tci,tcij->tcj", normal, project_slope(camera, at)) / unit[..., None]
    return error, -np.einsum("tcj,tcjd->tcd", flow, turn)
