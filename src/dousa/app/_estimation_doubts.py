"""What the overlap of model and silhouettes says about calibration, body and start."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from dousa.estimation import BodyModel, Camera
    from dousa.estimation._types import Estimate

__all__ = ["describe_doubts"]

_BAD_OVERLAP = 0.5  # mean of all frames
_DOUBTFUL_OVERLAP = (
    0.7  # real people tracked right lie above 0.72, wrong lenses and exchanged cameras at 0.62 to 0.69
)
_ODD_VIEW = 0.25  # below the mean of the others
_TOUCHING = 0.05  # m: nearer to a camera nothing is drawn
_MOST_POSES = 200
_THIN, _THICK = 0.8, 1.4  # girth fitted over girth of the model; real people in clothes have 0.9 to 1.2


def describe_doubts(
    estimate: Estimate, body: BodyModel, names: Sequence[str], cameras: Sequence[Camera]
) -> list[str]:
    """What the result says about calibration, body and start; ``body`` is the one before its girths were fitted."""
    return [
        *_weigh_overlaps(estimate, names),
        *_weigh_girths(estimate.body, body),
        *_cameras_inside(estimate, cameras),
    ]


def _weigh_girths(fitted: BodyModel, body: BodyModel) -> list[str]:
    """A wrong stature shows in a person who is far thicker or thinner than people are."""
    if fitted.spheres.shape != body.spheres.shape:
        return []
    share = float(np.median(fitted.spheres[:, 3] / body.spheres[:, 3]))
    if _THIN <= share <= _THICK:
        return []
    return [f"the silhouettes are {share:.1f} times as thick as the body says: is the stature right?"]


def _weigh_overlaps(estimate: Estimate, names: Sequence[str]) -> list[str]:
    seen = [view for view in range(len(names)) if np.isfinite(estimate.iou[:, view]).any()]
    means = {names[view]: float(np.nanmean(estimate.iou[:, view])) for view in seen}
    said = []
    if len(means) == 1:
        said.append(
            "one view does not tell how far away anything is: trust the picture of this motion, not its depth"
        )
    mean = float(np.mean(list(means.values()))) if means else 1.0
    if mean < _BAD_OVERLAP:
        said.append(
            f"model and silhouettes overlap by {mean:.0%} only: do not trust this motion; is "
            "the calibration of these views (order, size, metres), is the stature right?"
        )
        return said
    if mean < _DOUBTFUL_OVERLAP:
        said.append(
            f"model and silhouettes overlap by {mean:.0%}, less than usual: look at --sheet or --overlay before you "
            "trust this motion; are cameras exchanged, or lenses, stature or start wrong?"
        )
    for name, value in means.items():
        others = float(np.mean([other for key, other in means.items() if key != name] or [value]))
        if value < others - _ODD_VIEW:
            said.append(
                f"view '{name}' overlaps by {value:.0%} only, the others by {others:.0%}: is its calibration "
                "right, and is it of the same moments?"
            )
    return said


def _cameras_inside(estimate: Estimate, cameras: Sequence[Camera]) -> list[str]:
    from dousa.estimation.kinematics import place_parts

    body = estimate.body
    poses = estimate.poses[:: max(1, len(estimate.poses) // _MOST_POSES)]
    rotations, positions = place_parts(body, poses)
    inside = set()
    for part in range(body.n_parts):
        balls = _fill(body.spheres[body.sphere_starts[part] : body.sphere_starts[part + 1]])
        for number, camera in enumerate(cameras):
            if camera.kind == "pinhole":
                local = np.einsum("tji,tj->ti", rotations[:, part], camera.position - positions[:, part])
                off = np.linalg.norm(local[:, None] - balls[:, :3], axis=2) - balls[:, 3]
                if off.min() < _TOUCHING:
                    inside.add(number)
    return [
        f"camera '{cameras[number].name}' stands inside the body or touches it: is the calibration in the "
        "unit it says, and is the person where the cameras look?"
        for number in sorted(inside)
    ]


def _fill(spheres: NDArray[np.float64]) -> NDArray[np.float64]:
    """The spheres of a part and some between each two of them, which fill most of its solid."""
    first, second = np.triu_indices(len(spheres))
    return np.concatenate(
        [(1.0 - share) * spheres[first] + share * spheres[second] for share in (0.0, 0.25, 0.5, 0.75, 1.0)]
    )
