"""The stature and the girths of a person from silhouettes in calibrated views."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from dousa.arrays import FloatArray, IndexArray, Mask
from dousa.errors import BodyModelError, SilhouetteError
from dousa.estimation.body.body import BodyModel, widen
from dousa.estimation.body.human import USUAL_STATURE, make_human
from dousa.estimation.cameras.camera import Camera
from dousa.estimation.raster.rasteriser import draw_body
from dousa.estimation.tracking.outlines import lines_meet, measure_outline, shrink_views
from dousa.estimation.tracking.search_setup import SearchSetup
from dousa.estimation.tracking.settings import TrackerSettings
from dousa.estimation.tracking.start import StartSearch, find_start
from dousa.messages import Message, Progress


def measure_stature(
    cameras: Sequence[Camera],
    masks: Sequence[Mask | None],
    *,
    make_body: Callable[[float], BodyModel] = make_human,
    progress: Progress | None = None,
    usual: float = USUAL_STATURE,
    statures: Sequence[float] = tuple(np.arange(140, 206, 5) / 100),
    extent: float = 130.0,
    sweeps: Sequence[float] = (0.5, 0.5, 0.25),
) -> float | None:
    """Measure a person's stature (m) together with the pose from one frame, best one in which the person stands.

    Returns None with one view, or views from about one side, which leave it open.

    Parameters
    ----------
    cameras : (V,) calibrated views.
    masks : (V,) of one frame; None where a view has no image.
    make_body : returns the body of a stature (m).
    progress : called with steps done, steps in all and the current step.
    usual : m, stature of the first pose.
    statures : m, evenly spaced, that are tried; between them the top of a parabola is taken.
    extent : px, to which the longest side of the silhouettes is shrunk: more is slower.
    sweeps : shares of dR in which the pose of each stature is searched.

    Raises
    ------
    SilhouetteError : no person is seen in any view.
    """
    outlines = [measure_outline(mask) for mask in masks]
    extents = [found.extent for found in outlines if found is not None]
    if not extents:
        raise SilhouetteError("tracker.nobody")
    if not lines_meet(cameras, outlines):
        return None
    tell = progress or (lambda done, total, what: None)
    views, small = shrink_views(cameras, masks, min(1.0, extent / max(extents)))
    outlines = [measure_outline(mask) for mask in small]
    tell(0, 1 + len(statures), Message("tracker.first_pose"))
    setup = SearchSetup(make_body(usual), views, TrackerSettings(), 30.0, 1.0)
    first = find_start(setup, setup.pack(small), small)[0].pose
    scores: dict[float, float] = {}
    # Outwards from the usual stature, each pose beginning with that of the stature beside it.
    for way in ([one for one in statures if one >= usual], [one for one in statures if one < usual][::-1]):
        pose, before = first, usual
        for stature in way:
            tell(1 + len(scores), 1 + len(statures), Message("tracker.stature"))
            setup = SearchSetup(make_body(float(stature)), views, TrackerSettings(), 30.0, 1.0)
            begun = pose.copy()
            begun[1] += 0.5 * (stature / before - 1.0) * setup.body.stature  # feet stay about where they were
            scores[stature], pose = StartSearch(setup, setup.pack(small)).refine(begun, sweeps)
            before = stature
    return _find_top(scores)


def _find_top(scores: dict[float, float]) -> float:
    """Return the top of the parabola through the best stature and its neighbours."""
    order = sorted(scores)
    best = max(order, key=lambda stature: scores[stature])
    place = order.index(best)
    if 0 < place < len(order) - 1:
        low, middle, high = (scores[order[place + k]] for k in (-1, 0, 1))
        bend = low - 2.0 * middle + high
        if bend < 0:
            return float(best) + 0.5 * (low - high) / bend * float(order[place + 1] - order[place])
    return float(best)


def fit_girths(
    body: BodyModel,
    poses: ArrayLike,
    masks: Sequence[Mask],
    cameras: Sequence[Camera],
    *,
    limits: tuple[float, float] = (0.6, 1.8),
    apart: float = 1.25,
    worth: float = 5e-4,
) -> BodyModel:
    """Fit the girths of a body to silhouettes of known poses.

    First the whole body, then part by part, left and right together; lengths stay, see `fit_body`.

    Parameters
    ----------
    body : any tree of parts.
    poses : (T, 7 + A) or (7 + A,), one frame or a few, best with the limbs off the trunk.
    masks : (V,) one (T, height, width) or (height, width) for each camera, true on the body.
    cameras : (V,).
    limits : of the new girths over the old: from a naked child to a winter coat.
    apart : how much thicker or thinner than the whole a part may become.
    worth : share of the silhouettes; a change that gains fewer pixels is not made.

    Raises
    ------
    SilhouetteError : masks that are not as many as the cameras or not of their size, or empty.
    BodyModelError : poses of another body.
    """
    rows = np.atleast_2d(np.asarray(poses, np.float64))
    if rows.shape[1] != 7 + body.n_angles:
        raise BodyModelError("pose.rows", expected=7 + body.n_angles, found=str(rows.shape))
    views = _check_masks(masks, cameras, len(rows))
    area = sum(int(view.sum()) for view in views)
    if not area:
        raise SilhouetteError("tracker.girths_nobody")

    def mismatch(shares: FloatArray) -> int:
        tried = widen(body, shares)
        drawn = (draw_body(tried, rows, camera) for camera in cameras)
        return sum(int((mask ^ view).sum()) for mask, view in zip(drawn, views, strict=True))

    shares, every = np.ones(body.n_parts), np.arange(body.n_parts)
    shares = _search(mismatch, shares, [every], limits, worth * area)
    bounds = max(limits[0], shares[0] / apart), min(limits[1], shares[0] * apart)
    plain = np.array([name.removeprefix("left_").removeprefix("right_") for name in body.names])
    groups = [np.flatnonzero(plain == name) for name in dict.fromkeys(plain)]
    return widen(body, _search(mismatch, shares, groups, bounds, worth * area))


def _check_masks(masks: Sequence[Mask], cameras: Sequence[Camera], n_frames: int) -> list[Mask]:
    if len(masks) != len(cameras) or not len(cameras):
        raise SilhouetteError("tracker.girths_views", expected=len(cameras), found=len(masks))
    views = []
    for mask, camera in zip(masks, cameras, strict=True):
        view, shape = np.asarray(mask, np.bool_), (n_frames, camera.height, camera.width)
        view = view[None] if view.ndim == 2 else view
        if view.shape != shape:
            found = str(view.shape)
            raise SilhouetteError("tracker.girths_shape", view=camera.name, expected=str(shape), found=found)
        views.append(view)
    return views


def _search(
    mismatch: Callable[[FloatArray], int],
    shares: FloatArray,
    groups: Sequence[IndexArray],
    bounds: tuple[float, float],
    worth: float,
    steps: Sequence[float] = (0.16, 0.08, 0.04, 0.02),
) -> FloatArray:
    """Minimise the mismatch over shares (P,) of groups of parts by coordinate descent with shrinking steps."""
    best = mismatch(shares)
    for step in steps:
        for group in groups:
            for way in (1.0 + step, 1.0 / (1.0 + step)):
                while True:
                    tried = shares.copy()
                    tried[group] = np.clip(tried[group] * way, *bounds)
                    found = mismatch(tried)
                    if found >= best - worth:
                        break
                    shares, best = tried, found
    return shares
