"""Keypoints of several films at common moments, without distortion, from the principal point.

Films have their own clocks and rates, perhaps uneven. A point is read at any time by a local quadratic fit under a
Gaussian window of some 25 ms, which yields its velocity too and removes the jitter of networks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dousa.arrays import BoolArray, FloatArray, spread_evenly
from dousa.estimation.calibration.bundle import Limb, Sightings
from dousa.estimation.cameras.camera import Camera
from dousa.estimation.keypoints.keypoints import ViewKeypoints

# Distinctive points: of a face with eleven points a nose and two ears.
_LEAST_VISIBILITY = 0.5  # points that are less sure are not used, see docs/estimation.md
_POINTS = (
    "nose", "left_ear", "right_ear", "left_shoulder", "right_shoulder", "left_elbow", "right_elbow", "left_wrist",
    "right_wrist", "left_index", "right_index", "left_hip", "right_hip", "left_knee", "right_knee", "left_ankle",
    "right_ankle", "left_heel", "right_heel", "left_foot_index", "right_foot_index", "left_big_toe", "right_big_toe",
    "neck", "head", "head_top",
)  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """One person in one film.

    Parameters
    ----------
    times : (T,) s, of the film's own clock, rising.
    points : (T, K, 2) px from the principal point, without distortion.
    weights : (T, K) 0 to 1; 0 where a point was not seen.
    focal : px, of the camera, known or a guess.
    """

    times: FloatArray
    points: FloatArray
    weights: FloatArray
    focal: float

    @property
    def interval(self) -> float:
        """Median distance (s) between two frames."""
        return float(np.median(np.diff(self.times))) if len(self.times) > 1 else 1.0

    @property
    def height(self) -> float:
        """Median extent (px) of the person in the image."""
        seen = np.where(self.weights[..., None] > 0, self.points, np.nan)
        seen = seen[(self.weights > 0).sum(axis=1) >= 4]
        if not len(seen):
            return 1.0
        return float(np.median((np.nanmax(seen, axis=1) - np.nanmin(seen, axis=1)).max(axis=1)))

    def read(
        self,
        moments: FloatArray,
        window: float = 0.025,
        *,
        reach: float = 3.0,
        least_frames: int = 3,
        least_visibility: float = _LEAST_VISIBILITY,
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Read points (M, K, 2) px, velocities (M, K, 2) px/s, and weights (M, K), 0 where undetermined.

        ``moments`` (M,) are s of the film's own clock; ``window`` (s, standard deviation) smooths, more where frames
        are far apart, and reaches ``reach`` times as far. A point needs ``least_frames`` there, in the mean as sure as
        ``least_visibility``.
        """
        window = max(window, 0.7 * self.interval)
        first = np.searchsorted(self.times, moments - reach * window)
        last = np.searchsorted(self.times, moments + reach * window, side="right")
        frames = first[:, None] + np.arange(max(1, int((last - first).max(initial=1))))
        inside, frames = frames < last[:, None], np.minimum(frames, len(self.times) - 1)
        late = (self.times[frames] - moments[:, None]) / window
        kernel = np.where(inside, np.exp(-0.5 * late**2), 0.0)
        weights = kernel[..., None] * self.weights[frames]
        powers = late[..., None] ** np.arange(5)
        sums = np.einsum("mwk,mwp->mkp", weights, powers)
        normal = sums[..., np.add.outer(np.arange(3), np.arange(3))]
        points = np.where(weights[..., None] > 0, self.points[frames], 0.0)
        right = np.einsum("mwk,mwp,mwkx->mkpx", weights, powers[..., :3], points, optimize=True)
        good = (weights > 0).sum(axis=1) >= least_frames
        good &= (weights * (late[..., None] <= 0)).sum(axis=1) > 0.05 * sums[..., 0]
        good &= (weights * (late[..., None] >= 0)).sum(axis=1) > 0.05 * sums[..., 0]
        normal[~good] = np.eye(3)
        found = np.linalg.solve(normal + 1e-9 * np.eye(3), right)
        sure = sums[..., 0] / np.maximum(kernel.sum(axis=1), 1e-9)[:, None]
        return found[..., 0, :], found[..., 1, :] / window, np.where(good & (sure >= least_visibility), sure, 0.0)


def name_views(views: Sequence[ViewKeypoints]) -> tuple[str, ...]:
    """Return the names (V,) of the films, view1, view2 ... without."""
    return tuple(view.source or f"view{place + 1}" for place, view in enumerate(views))


def choose_points(names: Sequence[str]) -> list[str]:
    """Return the names of distinctive points; all names if fewer than eight are known."""
    found = [name for name in _POINTS if name in names]
    return found if len(found) >= 8 else list(names)


def list_limbs(
    names: Sequence[str],
    *,
    long: float = 0.06,
    foot: float = 0.2,
    hand: float = 0.25,
    breadth: float = 0.12,
    head: float = 0.2,
) -> tuple[Limb, ...]:
    """Return the pairs of points of these names whose distance changes little.

    The numbers say by what share networks see it change: of long bones, foot, hand, breadths of the trunk, and head.
    """
    sided = {
        **{("shoulder", "elbow"): long, ("elbow", "wrist"): long, ("hip", "knee"): long, ("knee", "ankle"): long},
        **{("ankle", "heel"): foot, ("ankle", "foot_index"): foot, ("ankle", "big_toe"): foot},
        **{("wrist", "index"): hand},
    }
    across = {"shoulder": breadth, "hip": breadth, "ear": head}
    kinds = [([(f"left_{a}", f"left_{b}"), (f"right_{a}", f"right_{b}")], spread) for (a, b), spread in sided.items()]
    kinds += [([(f"left_{name}", f"right_{name}")], spread) for name, spread in across.items()]
    kinds.append(([("nose", "neck")], head))
    there = [([pair for pair in pairs if set(pair) <= set(names)], spread) for pairs, spread in kinds]
    return tuple(
        Limb(names.index(first), names.index(second), kind, spread)
        for kind, (pairs, spread) in enumerate(entry for entry in there if entry[0])
        for first, second in pairs
    )


def make_track(
    times: FloatArray,
    points: FloatArray,
    visibility: FloatArray,
    camera: Camera,
    least_visibility: float = _LEAST_VISIBILITY,
) -> Track:
    """Make a track from keypoints in an image.

    Parameters
    ----------
    times : (T,) s, rising.
    points : (T, K, 2) px, nan where not seen.
    visibility : (T, K) 0 to 1.
    camera : its matrix and distortion.
    least_visibility : points that are less sure are not used.
    """
    k = camera.matrix
    seen = (visibility >= least_visibility) & np.isfinite(points).all(axis=-1)
    image = np.where(seen[..., None], points, k[:2, 2])
    y = (image[..., 1] - k[1, 2]) / k[1, 1]
    x = (image[..., 0] - k[0, 2] - k[0, 1] * y) / k[0, 0]
    flat = camera.undistort(np.stack((x, y), axis=-1)) * k[0, 0]
    seen &= np.isfinite(flat).all(axis=-1)
    seen &= ~_find_jumps(np.where(seen[..., None], flat, np.nan))
    points, weights = np.where(seen[..., None], flat, 0.0), np.where(seen, visibility, 0.0)
    return Track(np.asarray(times, np.float64), points, weights, float(k[0, 0]))


def _find_jumps(points: FloatArray, jump: float = 0.4) -> BoolArray:
    """Return (T, K) True where a point (T, K, 2) is far from the median of the five frames about it.

    ``jump`` is a share of the middle distance of points from the person's middle: some 20 cm, farther than a hand moves
    in a frame.
    """
    if points.shape[1] < 4 or not np.isfinite(points).any():
        return np.zeros(points.shape[:2], bool)
    apart = np.linalg.norm(points - _median(points, axis=1)[:, None], axis=-1)
    around = np.concatenate((points[:1], points[:1], points, points[-1:], points[-1:]))
    five = np.stack([around[shift : shift + len(points)] for shift in range(5)])
    off = np.linalg.norm(points - _median(five, axis=0), axis=-1)
    return np.asarray(np.nan_to_num(off) > jump * np.nanmedian(apart))


def _median(values: FloatArray, axis: int) -> FloatArray:
    """Compute the median without nan; 0 without values."""
    nothing = np.isnan(values).all(axis=axis, keepdims=True)
    return np.asarray(np.nanmedian(np.where(nothing, 0.0, values), axis=axis))


def choose_moments(tracks: Sequence[Track], offsets: FloatArray, most: int, finest: float = 1.0 / 60.0) -> FloatArray:
    """Choose moments (M,) s of the common time inside at least two films, evenly spread, ``finest`` s apart or more."""
    starts = np.array([track.times[0] for track in tracks]) + offsets
    ends = np.array([track.times[-1] for track in tracks]) + offsets
    grid: FloatArray = np.arange(starts.min(), ends.max() + finest, finest)
    several = ((grid >= starts[:, None]) & (grid <= ends[:, None])).sum(axis=0) >= 2
    grid = grid[several]
    return np.asarray(grid[spread_evenly(len(grid), most)])


def read_sightings(
    tracks: Sequence[Track], offsets: FloatArray, moments: FloatArray, spread: float = 0.015
) -> Sightings:
    """Read the points of the films at common moments.

    Parameters
    ----------
    tracks : V films of one person, with the same points.
    offsets : (V,) s, added to each film's own time to get the common time.
    moments : (M,) s of the common time.
    spread : of a person's height in the picture, by which keypoints are off.
    """
    read = [track.read(moments - offset) for track, offset in zip(tracks, offsets, strict=True)]
    points, velocities, weights = (np.stack(every) for every in zip(*read, strict=True))
    spreads = np.array([spread * track.height for track in tracks])
    return Sightings(points, weights, spreads, velocities, np.array(offsets, np.float64))
