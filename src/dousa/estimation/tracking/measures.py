"""The stature and the girths of a person from silhouettes in calibrated views."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from dousa.arrays import FloatArray, IndexArray, Mask
from dousa.errors import BodyModelError, SilhouetteError
from dousa.estimation.body.body import BodyModel, widen
from dousa.estimation.body.human import make_human
from dousa.estimation.cameras.camera import Camera
from dousa.estimation.raster.rasteriser import draw_body
from dousa.estimation.tracking.outlines import lines_meet, measure_outline, shrink_views
from dousa.estimation.tracking.search_setup import SearchSetup
from dousa.estimation.tracking.settings import TrackerSettings
from dousa.estimation.tracking.start import StartSearch, find_start
from dousa.messages import Message

USUAL_STATURE = 1.72
"""m, assumed if unknown."""

_STATURES = np.round(np.arange(1.40, 2.051, 0.05), 2)
_EXTENT = 130.0  # px
_SWEEPS = (0.5, 0.5, 0.25)


@dataclass(frozen=True, slots=True, eq=False)
class Scale:
    """The stature of a person.

    Parameters
    ----------
    stature : m.
    measured : whether it follows from the silhouettes; else it is `USUAL_STATURE`.
    body : of that stature.
    pose : (7 + A,) of the body in the frame.
    iou : overlap of body and silhouettes.
    """

    stature: float
    measured: bool
    body: BodyModel
    pose: FloatArray
    iou: float


def fit_scale(
    cameras: Sequence[Camera],
    masks: Sequence[Mask | None],
    *,
    make_body: Callable[[float], BodyModel] = make_human,
    progress: Callable[[int, int, Message], None] | None = None,
) -> Scale:
    """Find stature (1.40 to 2.05 m) and pose together from one frame, best one in which the person stands.

    With one view, or views from about one side, the stature is undetermined: it is then `USUAL_STATURE` and
    ``measured`` is false.

    Parameters
    ----------
    cameras : (V,) calibrated views.
    masks : (V,) of one frame; None where a view has no image.
    make_body : returns the body of a stature (m).
    progress : called with steps done, steps in all and the current step.

    Raises
    ------
    SilhouetteError : no person is seen in any view.
    """
    outlines = [measure_outline(mask) for mask in masks]
    extents = [found.extent for found in outlines if found is not None]
    if not extents:
        raise SilhouetteError("tracker.nobody")
    tell = progress or (lambda done, total, what: None)
    views, small = shrink_views(cameras, masks, min(1.0, _EXTENT / max(extents)))
    tell(0, 1 + len(_STATURES), Message("tracker.first_pose"))
    body = make_body(USUAL_STATURE)
    setup = SearchSetup(body, views, TrackerSettings(), 30.0, 1.0)
    found = find_start(setup, setup.pack(small), small)[0]
    if not lines_meet(cameras, outlines):
        return Scale(USUAL_STATURE, False, body, found.pose, found.iou)
    scores: dict[float, float] = {}
    poses: dict[float, FloatArray] = {}
    # Outwards from the usual stature, each pose beginning with that of the stature beside it.
    for way in (_STATURES[_STATURES >= USUAL_STATURE], _STATURES[_STATURES < USUAL_STATURE][::-1]):
        pose, before = found.pose, USUAL_STATURE
        for stature in way:
            tell(1 + len(scores), 1 + len(_STATURES), Message("tracker.stature"))
            body = make_body(float(stature))
            scores[stature], pose, _ = _try_stature(body, pose, stature / before, views, small)
            poses[stature], before = pose, stature
    return _choose(scores, poses, make_body, views, small)


def _try_stature(
    body: BodyModel,
    pose: FloatArray,
    growth: float,
    cameras: Sequence[Camera],
    masks: Sequence[Mask | None],
) -> tuple[float, FloatArray, StartSearch]:
    """Return score, pose and search of a body ``growth`` times as tall as that of the given pose."""
    setup = SearchSetup(body, cameras, TrackerSettings(), 30.0, 1.0)
    search = StartSearch(setup, setup.pack(masks), [measure_outline(mask) for mask in masks])
    begun = pose.copy()
    begun[1] += 0.5 * (growth - 1.0) * body.stature  # feet stay about where they were
    return (*search.refine(begun, _SWEEPS), search)


def _choose(
    scores: dict[float, float],
    poses: dict[float, FloatArray],
    make_body: Callable[[float], BodyModel],
    cameras: Sequence[Camera],
    masks: Sequence[Mask | None],
) -> Scale:
    """Return the top of the parabola through the best stature and its neighbours."""
    order = sorted(scores)
    best = max(order, key=lambda stature: scores[stature])
    place = order.index(best)
    stature = float(best)
    if 0 < place < len(order) - 1:
        low, middle, high = (scores[order[place + k]] for k in (-1, 0, 1))
        bend = low - 2.0 * middle + high
        if bend < 0:
            stature += 0.5 * (low - high) / bend * float(order[place + 1] - order[place])
    body = make_body(stature)
    _, pose, search = _try_stature(body, poses[best], stature / best, cameras, masks)
    return Scale(stature, True, body, pose, search.measure_overlap(pose))


_LEAST, _GREATEST = 0.6, 1.8  # of the body's own girth: naked child to winter coat
_APART = 1.25  # a part may be so much thicker or thinner than the whole
_STEPS = (0.16, 0.08, 0.04, 0.02)
_WORTH = 5e-4  # of the silhouette: a change that gains fewer pixels is not made


def fit_girths(body: BodyModel, poses: ArrayLike, masks: Sequence[Mask], cameras: Sequence[Camera]) -> BodyModel:
    """Fit the girths of a body to silhouettes of known poses.

    First the whole body, then part by part, left and right together; lengths stay, see `fit_body`.

    Parameters
    ----------
    body : any tree of parts.
    poses : (T, 7 + A) or (7 + A,), one frame or a few, best with the limbs off the trunk.
    masks : (V,) one (T, height, width) or (height, width) for each camera, true on the body.
    cameras : (V,).

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

    shares = np.ones(body.n_parts)
    shares = _search(mismatch, shares, [np.arange(body.n_parts)], (_LEAST, _GREATEST), _WORTH * area)
    middle = shares[0]
    bounds = max(_LEAST, middle / _APART), min(_GREATEST, middle * _APART)
    return widen(body, _search(mismatch, shares, _groups(body), bounds, _WORTH * area))


def _check_masks(masks: Sequence[Mask], cameras: Sequence[Camera], n_frames: int) -> list[Mask]:
    if len(masks) != len(cameras) or not len(cameras):
        raise SilhouetteError("tracker.girths_views", expected=len(cameras), found=len(masks))
    views = []
    for mask, camera in zip(masks, cameras, strict=True):
        view = np.asarray(mask, np.bool_)
        view = view[None] if view.ndim == 2 else view
        if view.shape != (n_frames, camera.height, camera.width):
            raise SilhouetteError(
                "tracker.girths_shape",
                view=camera.name,
                expected=str((n_frames, camera.height, camera.width)),
                found=str(view.shape),
            )
        views.append(view)
    return views


def _groups(body: BodyModel) -> list[IndexArray]:
    """Group left and right parts, which share a girth."""
    plain = [name.removeprefix("left_").removeprefix("right_") for name in body.names]
    return [np.flatnonzero([name == one for name in plain]) for one in dict.fromkeys(plain)]


def _search(
    mismatch: Callable[[FloatArray], int],
    shares: FloatArray,
    groups: Sequence[IndexArray],
    bounds: tuple[float, float],
    worth: float,
) -> FloatArray:
    """Minimise the mismatch over shares (P,) of groups of parts by coordinate descent with shrinking steps."""
    best = mismatch(shares)
    for step in _STEPS:
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
