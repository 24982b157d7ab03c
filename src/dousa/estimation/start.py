"""The pose in one frame from its silhouettes alone: where tracking begins, and begins again when it was lost.

The paper is given its first pose. Here templates in all headings are laid onto the silhouettes, the best are refined by
the tracker's own sweeps without inertia, each limb is tried as it is in every template, and the poses that cast
nearly the same silhouettes with left and right exchanged are tried as well.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dousa.errors import SilhouetteError
from dousa.estimation._placing import measure_outline, shrink_views
from dousa.estimation._start_search import StartSearch
from dousa.estimation._working import Frame, Workshop
from dousa.estimation.silhouettes import Mask

__all__ = ["Start", "find_start"]

FloatArray = NDArray[np.float64]
Progress = Callable[[int, int, str], None]

_ROUGH_EXTENT = 90.0  # px, longest side of the silhouettes in all but the last step
_FOLLOWED = 5  # poses that are tracked through later frames
_FOLLOWING = (1.0, 0.5)  # dR of the sweeps with which they are


@dataclass(frozen=True, slots=True, eq=False)
class Start:
    """A pose found in one frame.

    Parameters
    ----------
    pose : (7 + A,), see `BodyModel`.
    score : log score; comparable only between starts of one call.
    iou : mean overlap of body and silhouette over the views that see somebody, intersection over union.
    """

    pose: FloatArray
    score: float
    iou: float


def find_start(
    workshop: Workshop,
    frame: Frame,
    masks: Sequence[Mask | None],
    *,
    n_best: int = 1,
    near: FloatArray | None = None,
    later: Sequence[Frame] = (),
    progress: Progress | None = None,
) -> list[Start]:
    """Find the pose in one frame from its silhouettes alone.

    Parameters
    ----------
    workshop : the body before its cameras. Of the settings only the floor and the stiffness count here.
    frame : the silhouettes as the workshop packs them.
    masks : (V,) the same as masks; None where a view has no image.
    n_best : how many different poses are wanted.
    near : (7 + A,) pose that the body had some time ago, one more template.
    later : following frames: the best poses are tracked through them and their mean scores decide.
    progress : called with steps done, steps in all and what is being done.

    Returns
    -------
    At most ``n_best`` different poses, best first.

    Raises
    ------
    SilhouetteError : nobody is seen in any view.

    Notes
    -----
    With one view the answer is a guess: how far away, which way a limb leans, and of a body seen from the side which
    leg is the left one, hardly show; feet that point forward and knees that bend one way are all that tells front from
    back. The first call compiles the search kernels (cached on disk) and makes the templates of the body.
    """
    tell = progress or (lambda done, total, what: None)
    outlines = [measure_outline(mask) for mask in masks]
    extents = [found.extent for found in outlines if found is not None]
    if not extents or not frame.seen.any():
        raise SilhouetteError("start: expected somebody in at least one view of the frame, got empty masks")
    cameras, small = shrink_views(workshop.cameras, masks, min(1.0, _ROUGH_EXTENT / max(extents)))
    rough = Workshop(workshop.body, cameras, workshop.settings, 30.0, 1.0)
    coarse = StartSearch(rough, rough.pack(small), [measure_outline(mask) for mask in small])
    found = coarse.run(near, tell)
    fine = StartSearch(workshop, frame, outlines)
    found = fine.finish(found, max(n_best, _FOLLOWED) if later else n_best)
    if later:
        found = [(_follow(workshop, pose, score, later), pose) for score, pose in found]
        found.sort(key=lambda pair: -pair[0])
    return [Start(pose, score, fine.measure_overlap(pose)) for score, pose in found[:n_best]]


def _follow(workshop: Workshop, pose: FloatArray, score: float, later: Sequence[Frame]) -> float:
    """Mean score of a pose tracked through later frames, each searched for about the one before."""
    scratch, pose = workshop.make_scratch(), pose.copy()
    scores = [score]
    for frame in later:
        shift = np.zeros(workshop.n_axes)
        for factor in _FOLLOWING:
            workshop.sweep(pose, shift, factor, frame, scratch)
        pose[3:7] /= np.linalg.norm(pose[3:7])
        scores.append(workshop.score(pose, shift, frame, scratch))
    return float(np.mean(scores))
