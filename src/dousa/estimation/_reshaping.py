"""Another body of the same tree: joints moved, and the solids stretched along."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dousa.estimation.body import BodyModel

__all__ = ["reshape", "widen"]

FloatArray = NDArray[np.float64]

_SHORT = 0.02  # statures: a bone with less than this along an axis does not stretch the solid along it


def reshape(
    body: BodyModel, offsets: FloatArray, tip_offsets: FloatArray, girths: FloatArray | None = None
) -> BodyModel:
    """Move the joints and tips of a body and let its solids follow.

    Each part is stretched along its three axes, both ways apart, as the points that hang on it (the joints of its
    children, its tips) move away from or towards its own joint. Radii stay, unless a girth says otherwise.

    Parameters
    ----------
    body : the body to start from.
    offsets : (P, 3) m, where the joints shall be in their parents' axes.
    tip_offsets : (K, 3) m, where the tips shall be in their parts' axes.
    girths : (S,) what the spheres' radii and their distances from the part's Y axis grow by; ones by default.

    Returns
    -------
    The new body, of the same stature.
    """
    spheres = body.spheres.copy()
    for part in range(body.n_parts):
        children, tips = body.parents == part, body.tip_parts == part
        before = np.concatenate((body.offsets[children], body.tip_offsets[tips], np.zeros((1, 3))))
        after = np.concatenate((offsets[children], tip_offsets[tips], np.zeros((1, 3))))
        own = slice(body.sphere_starts[part], body.sphere_starts[part + 1])
        centres = spheres[own, :3]
        up = _stretch(before.max(axis=0), after.max(axis=0), body.stature)
        down = _stretch(-before.min(axis=0), -after.min(axis=0), body.stature)
        spheres[own, :3] = centres * np.where(centres > 0, up, down)
    if girths is not None:
        spheres[:, [0, 2, 3]] *= girths[:, None]
    return replace(body, offsets=offsets, tip_offsets=tip_offsets, spheres=spheres)


def _stretch(before: FloatArray, after: FloatArray, stature: float) -> FloatArray:
    long = before > _SHORT * stature
    return np.where(long & (after > 0), after / np.where(long, before, 1.0), 1.0)


def widen(body: BodyModel, shares: ArrayLike) -> BodyModel:
    """Make the solids of a body thicker or thinner, its joints and tips stay.

    Parameters
    ----------
    body : any tree of parts.
    shares : (P,) or a number, what each part's girth grows by. Parts that no other part hangs on (head, hands, feet)
        grow in length too.

    Returns
    -------
    The new body.
    """
    grown = np.broadcast_to(np.asarray(shares, np.float64), body.n_parts)
    owner = np.repeat(np.arange(body.n_parts), np.diff(body.sphere_starts))
    scale = np.repeat(grown[owner, None], 4, axis=1)
    ends = ~np.isin(np.arange(body.n_parts), body.parents)
    scale[~ends[owner], 1] = 1.0
    return replace(body, spheres=body.spheres * scale)
