"""Keypoints of films of a made-up performer, whose cameras and times are known."""

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from dousa.estimation import Camera, PersonTrack, ViewKeypoints, make_view
from dousa.motion import CANONICAL_JOINTS, canonicalise
from dousa.motion.synthetic import draw_performer, make_motion

FloatArray = NDArray[np.float64]

_NAMES = {"head": "nose", **{f"{side}_hand": f"{side}_index" for side in ("left", "right")}}
_NAMES |= {f"{side}_toe": f"{side}_foot_index" for side in ("left", "right")}
_JOINTS = [name for name in CANONICAL_JOINTS if name not in ("pelvis", "spine", "neck")]
NAMES = tuple(_NAMES.get(name, name) for name in _JOINTS)
_RATE, _BLEND = 60.0, 20


class Performance:
    """A performer who does several things in turn, at any time.

    Parameters
    ----------
    categories : what is done, one after the other.
    seed : of the performer.
    wander : m, by which the person walks to and fro.
    """

    def __init__(self, categories: tuple[str, ...], seed: int = 1, wander: float = 0.4) -> None:
        performer = draw_performer(seed)
        self.stature = performer.stature
        places = [CANONICAL_JOINTS.index(name) for name in _JOINTS]
        motions = [make_motion(category, performer, seed=n, frame_rate=_RATE) for n, category in enumerate(categories)]
        parts = [canonicalise(motion).positions[:, places] for motion in motions]
        share = np.linspace(0.0, 1.0, _BLEND)[:, None, None]
        for number in range(1, len(parts)):  # each begins where the last one ended, and fades in
            last = parts[number - 1][-1]
            parts[number] -= (parts[number][0].mean(axis=0) - last.mean(axis=0)) * (1.0, 0.0, 1.0)
            parts[number][:_BLEND] = share * parts[number][:_BLEND] + (1.0 - share) * last
        positions = np.concatenate(parts)
        self.seconds = (len(positions) - 1) / _RATE
        times = np.arange(len(positions)) / _RATE
        positions[..., 0] += wander * np.sin(0.9 * times)[:, None]
        positions[..., 2] += wander * np.cos(0.7 * times)[:, None]
        self._curve = CubicSpline(times, positions)

    def at(self, times: FloatArray) -> FloatArray:
        """Places (T, K, 3) m of the points `NAMES`."""
        return np.asarray(self._curve(times))


def make_cameras(n_views: int, focal: float = 1500.0, seed: int = 3) -> tuple[Camera, ...]:
    """Cameras on one side of a room to all around it, at different heights."""
    rng = np.random.default_rng(seed)
    cameras = []
    for view in range(n_views):
        angle = np.radians(75.0 * view + rng.uniform(-10, 10))
        place = (4.5 * np.sin(angle), rng.uniform(0.9, 2.2), 4.5 * np.cos(angle))
        cameras.append(make_view(place, (0.0, 0.9, 0.0), size=(1920, 1080), focal=focal, name=f"film{view + 1}"))
    return tuple(cameras)


def film(
    performance: Performance,
    camera: Camera,
    begin: float,
    seconds: float,
    rate: float = 30.0,
    *,
    noise: float = 3.0,
    wrong: float = 0.02,
    unsteady: float = 0.0,
    seed: int = 0,
) -> ViewKeypoints:
    """What a network sees in a film.

    Parameters
    ----------
    begin : s of the performance at which the film begins.
    seconds, rate : s and Hz of the film.
    noise : px.
    wrong : share of points that are anywhere near the person.
    unsteady : share of the frame interval by which frames come late.
    """
    rng = np.random.default_rng([seed, len(camera.name), ord(camera.name[-1])])
    times = np.arange(int(seconds * rate)) / rate
    times[1:] += rng.uniform(0.0, unsteady, len(times) - 1) / rate
    points = camera.project(performance.at(begin + times))
    points += rng.normal(0.0, noise, points.shape)
    off = rng.random(points.shape[:2]) < wrong
    points[off] += rng.uniform(-150, 150, (int(off.sum()), 2))
    visibility = rng.uniform(0.7, 1.0, points.shape[:2])
    hidden = rng.random(points.shape[:2]) < 0.05
    visibility[hidden] = 0.1
    return ViewKeypoints(NAMES, (PersonTrack(points, visibility),), times, camera.size, camera.name)
