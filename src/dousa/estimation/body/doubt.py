"""How far off each joint of an estimated pose may be: one learned sum for every cue.

The expected error of a joint is the root of a sum of squares, each a sign of doubt times its weight. The weights are 0
or more, so that no sign ever makes a pose surer, and were learned on made people whose joints are known
(``lab/training/train_doubt.py``); see docs/estimation.md.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

from dousa.arrays import BoolArray, FloatArray
from dousa.estimation.body.body import BodyModel
from dousa.estimation.body.human import USUAL_STATURE
from dousa.estimation.body.kinematics import compute_points

LOST_ERROR = 0.15
"""m, by definition the mean error of the joints of a frame that is lost (of a person of usual stature)."""

Cue = Literal["silhouettes", "keypoints"]

SIGNS = ("always", "width", "bend", "step", "misfit", "hidden", "swap", "depth")
"""Of the doubt in a joint; see `list_signs`."""

# Learned by python -m lab.training.train_doubt, by cue and for one view or more.
WEIGHTS: dict[tuple[Cue, int], tuple[float, ...]] = {
    ("silhouettes", 1): (0.109, 2.509, 0.0, 3.154, 0.673, 0.220, 0.0, 0.511),
    ("silhouettes", 2): (0.017, 0.823, 0.490, 0.298, 0.144, 0.060, 0.968, 0.058),
    ("keypoints", 1): (0.0, 0.594, 2.817, 0.0, 1.292, 0.142, 0.0, 0.247),
    ("keypoints", 2): (0.018, 0.260, 0.0, 0.0, 0.613, 0.028, 0.088, 0.0),
}
SAID: dict[tuple[Cue, int], float] = {
    ("silhouettes", 1): LOST_ERROR,
    ("silhouettes", 2): 0.068,
    ("keypoints", 2): 0.105,
}
"""m, expected mean error from which a frame is lost: that of 5 % of the good frames of lab.training.train_doubt."""

SAID_MISFIT = 0.026
"""m, root mean square of the misfit from which a frame of one view's keypoints is lost, where no other sign tells the
frames of people left out, measured by lab.training.train_doubt: 5 % of the good frames exceed it in at most a tenth of
the draws of as many films."""


class Doubt(NamedTuple):
    """The expected errors (T, N) m of joints and tips, and the frames (T,) that are probably lost or unseen."""

    errors: FloatArray
    lost: BoolArray


class Evidence(NamedTuple):
    """What a cue says of T poses of N joints and tips.

    Parameters
    ----------
    seen : (T,) frames in which there is anything.
    width : (T, N) m, how far each can move while the observations fit nearly as well.
    misfit : (T, N) share of the part outside the silhouettes, or m^2 by which keypoints nearby are off per degree of
        freedom.
    hidden : (T, N) share that no view shows.
    swap : (T, N) how far it goes with limbs exchanged (m), or the share of views whose sides were exchanged.
    """

    seen: BoolArray
    width: FloatArray
    misfit: FloatArray
    hidden: FloatArray
    swap: FloatArray


def list_signs(
    body: BodyModel, poses: FloatArray, rate: float, forward: FloatArray, found: Evidence, *, window: float = 0.13
) -> FloatArray:
    """Compute the signs of doubt (T, N, S), those of `SIGNS`, in m of a person of usual stature, or shares.

    Width, bend (off the middle between the frames before and after), step (in a 30th of a second), misfit and hidden
    are means over ``window`` s to either side; depth is how far a joint lies from the root along ``forward``, the
    first view's axis.
    """
    points, scale = compute_points(body, poses), body.stature / USUAL_STATURE
    bend, step = np.zeros(points.shape[:2]), np.zeros(points.shape[:2])
    apart = max(1, round(rate / 30.0))
    if len(points) > 2 * apart:
        middle = points[2 * apart :] - 2.0 * points[apart:-apart] + points[: -2 * apart]
        bend[apart:-apart] = np.linalg.norm(middle, axis=-1)
    step[1:] = np.linalg.norm(np.diff(points, axis=0), axis=-1) * rate / 30.0
    width, bend, step, misfit, hidden = (
        _average(values, found.seen, round(window * rate))
        for values in (found.width, bend, step, found.misfit, found.hidden)
    )
    depth = np.abs((points - points[:, :1]) @ forward)
    lengths = [sign / scale for sign in (width, bend, step)]
    return np.stack(
        (np.ones_like(depth), *lengths, np.sqrt(misfit), hidden, found.swap / scale, depth / scale), axis=-1
    )


def judge(signs: FloatArray, seen: BoolArray, cue: Cue, n_views: int, stature: float) -> Doubt:
    """Compute the doubt from signs (T, N, S) of so many views whose lines of sight meet."""
    kind = (cue, min(max(n_views, 1), 2))
    expected = np.sqrt((np.array(WEIGHTS[kind]) * signs) ** 2 @ np.ones(len(SIGNS)))
    off = expected.mean(axis=1) > SAID[kind] if kind in SAID else find_misfit(signs) > SAID_MISFIT
    return Doubt(np.asarray(expected * stature / USUAL_STATURE), np.asarray(off | ~seen))


def find_misfit(signs: FloatArray) -> FloatArray:
    """Compute the root mean square (T,) of the misfit in signs (T, N, S), the plainest doubt."""
    return np.asarray(np.sqrt((signs[..., SIGNS.index("misfit")] ** 2).mean(axis=1)))


def _average(values: FloatArray, known: BoolArray, reach: int) -> FloatArray:
    """Average (T, n) over the known frames within ``reach``; as it is where there is none."""
    window = np.ones(2 * reach + 1)
    count = np.convolve(known, window)[reach : reach + len(known)]
    sums = [np.convolve(np.where(known, column, 0.0), window)[reach : reach + len(known)] for column in values.T]
    means = np.stack(sums, axis=1) / np.maximum(count, 1.0)[:, None]
    return np.where((known & (count > 0))[:, None], means, values)
