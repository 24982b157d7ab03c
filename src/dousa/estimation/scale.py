"""How tall the person is, from the silhouettes of one frame in several calibrated views."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dousa.errors import SilhouetteError
from dousa.estimation._placing import lines_meet, measure_outline, shrink_views
from dousa.estimation._start_search import StartSearch
from dousa.estimation._types import TrackerSettings
from dousa.estimation._working import Workshop
from dousa.estimation.body import BodyModel
from dousa.estimation.camera import Camera
from dousa.estimation.human import make_human
from dousa.estimation.silhouettes import Mask
from dousa.estimation.start import find_start

__all__ = ["USUAL_STATURE", "Scale", "fit_scale"]

FloatArray = NDArray[np.float64]

USUAL_STATURE = 1.72
"""m, assumed where nothing tells."""

_STATURES = np.round(np.arange(1.40, 2.051, 0.05), 2)
_EXTENT = 130.0  # px
_SWEEPS = (0.5, 0.5, 0.25)


@dataclass(frozen=True, slots=True, eq=False)
class Scale:
    """How tall a person is.

    Parameters
    ----------
    stature : m.
    told : whether the silhouettes tell it; else it is the usual one.
    body : of that stature.
    pose : (7 + A,) of the body in the frame.
    iou : overlap of body and silhouettes.
    """

    stature: float
    told: bool
    body: BodyModel
    pose: FloatArray
    iou: float


def fit_scale(
    cameras: Sequence[Camera],
    masks: Sequence[Mask | None],
    *,
    make_body: Callable[[float], BodyModel] = make_human,
    progress: Callable[[int, int, str], None] | None = None,
) -> Scale:
    """Find stature and pose together from one frame, best one in which the person stands.

    Parameters
    ----------
    cameras : (V,) calibrated views.
    masks : (V,) of one frame; None where a view has no image.
    make_body : gives the body of a stature (m).
    progress : called with steps done, steps in all and what is being done.

    Returns
    -------
    The stature of 1.40 to 2.05 m whose body covers the silhouettes best, its pose refined for each. One view, or
    several from about one side, do not tell it (a tall person far away looks like a short one nearby): then it is
    `USUAL_STATURE` and ``told`` is false.

    Raises
    ------
    SilhouetteError : nobody is seen in any view.
    """
    outlines = [measure_outline(mask) for mask in masks]
    extents = [found.extent for found in outlines if found is not None]
    if not extents:
        raise SilhouetteError("scale: expected somebody in at least one view of the frame, got empty masks")
    tell = progress or (lambda done, total, what: None)
    views, small = shrink_views(cameras, masks, min(1.0, _EXTENT / max(extents)))
    tell(0, 1 + len(_STATURES), "looking for the first pose")
    body = make_body(USUAL_STATURE)
    shop = Workshop(body, views, TrackerSettings(), 30.0, 1.0)
    found = find_start(shop, shop.pack(small), small)[0]
    if not lines_meet(cameras, outlines):
        return Scale(USUAL_STATURE, False, body, found.pose, found.iou)
    scores: dict[float, float] = {}
    poses: dict[float, FloatArray] = {}
    # Outwards from the usual stature, each pose beginning with that of the stature beside it.
    for way in (_STATURES[_STATURES >= USUAL_STATURE], _STATURES[_STATURES < USUAL_STATURE][::-1]):
        pose, before = found.pose, USUAL_STATURE
        for stature in way:
            tell(1 + len(scores), 1 + len(_STATURES), "fitting the stature")
            scores[stature], pose = _try_stature(
                make_body(float(stature)), pose, stature / before, views, small
            )
            poses[stature], before = pose, stature
    return _choose(scores, poses, make_body, views, small)


def _try_stature(
    body: BodyModel,
    pose: FloatArray,
    growth: float,
    cameras: Sequence[Camera],
    masks: Sequence[Mask | None],
) -> tuple[float, FloatArray]:
    """Score and pose of a body that is ``growth`` times as tall as the one whose pose it begins with."""
    shop = Workshop(body, cameras, TrackerSettings(), 30.0, 1.0)
    search = StartSearch(shop, shop.pack(masks), [measure_outline(mask) for mask in masks])
    begun = pose.copy()
    begun[1] += 0.5 * (growth - 1.0) * body.stature  # feet stay about where they were
    return search.refine(begun, _SWEEPS)


def _choose(
    scores: dict[float, float],
    poses: dict[float, FloatArray],
    make_body: Callable[[float], BodyModel],
    cameras: Sequence[Camera],
    masks: Sequence[Mask | None],
) -> Scale:
    """The top of the parabola through the best stature and its neighbours."""
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
    _, pose = _try_stature(body, poses[best], stature / best, cameras, masks)
    shop = Workshop(body, cameras, TrackerSettings(), 30.0, 1.0)
    search = StartSearch(shop, shop.pack(masks), [measure_outline(mask) for mask in masks])
    return Scale(stature, True, body, pose, search.measure_overlap(pose))
