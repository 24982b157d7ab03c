"""Cameras from the films of a person who moves: nothing but keypoints, and a stature for the metres."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dousa.arrays import FloatArray
from dousa.errors import CalibrationError, OptionError
from dousa.estimation.calibration.bundle import CAMERA_UNKNOWNS, Fit, Freedom, Rig, Sightings, adjust
from dousa.estimation.calibration.rig_search import find_rig
from dousa.estimation.calibration.sightings import (
    USUAL_FOCAL,
    Track,
    choose_moments,
    choose_points,
    list_limbs,
    make_track,
    read_sightings,
)
from dousa.estimation.calibration.two_views import triangulate
from dousa.estimation.calibration.world_axes import find_world
from dousa.estimation.cameras.camera import Camera
from dousa.estimation.cameras.camera_sets import make_view
from dousa.estimation.keypoints.keypoints import ViewKeypoints
from dousa.messages import Message

_MOST_MOMENTS, _LEAST_MOMENTS = 120, 12
_STEPS = 60
_FOCAL_SPREAD = 0.15  # relative, of the cameras that film people
_LEAST_PARALLAX = np.radians(5.0)
_FITS = 3.0  # spreads, within which a point agrees
_LEAST_SHARE, _USUAL_SHARE = 0.75, 0.9  # of the points that agree
_LIKENESS = 5.0  # errors are shared by neighbouring points and frames, see `sync.timing`
_DOUBTFUL_TURN, _MOST_TURN = np.radians(8.0), np.radians(15.0)
_LEAST_MOTION = 0.04  # of the stature
_STATURES = (0.5, 2.6)  # m


@dataclass(frozen=True, slots=True, eq=False)
class CalibratedView:
    """How well one camera fits.

    Parameters
    ----------
    name : of the view.
    residual : px, middle distance of the points from where they are seen.
    share : of the points that are within three expected spreads.
    turn : rad, standard deviation of the camera's direction; 0 of the first, which the others are told by.
    n_points : how many were looked at.
    """

    name: str
    residual: float
    share: float
    turn: float
    n_points: int


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """Cameras from films.

    Parameters
    ----------
    cameras : (V,) in metres with Y up and the floor at 0.
    views : (V,) how well each fits.
    parallax : rad, middle angle between the lines of sight to a point.
    points : (T, K, 3) m, what was seen; nan where unknown.
    names : (K,) of the points; none for a board.
    warnings : what a person should know.
    """

    cameras: tuple[Camera, ...]
    views: tuple[CalibratedView, ...]
    parallax: float
    points: FloatArray
    names: tuple[str, ...]
    warnings: tuple[Message, ...] = ()


def calibrate_from_person(
    views: Sequence[ViewKeypoints],
    stature: float,
    *,
    cameras: Sequence[Camera] | None = None,
    focals: Sequence[float] | None = None,
    offsets: Sequence[float] | None = None,
    people: Sequence[int] | None = None,
) -> Calibration:
    """Find where cameras stand from the keypoints of one person who moves before them.

    Parameters
    ----------
    views : (V,) two films or more; the camera of each stands still.
    stature : m, of the person.
    cameras : (V,) whose focal length, principal point and distortion are known; where they stand does not count.
    focals : (V,) px, where nothing else is known. Without either, focal lengths are found too, near those of phones.
    offsets : (V,) s, added to the time of each film to get the common time; 0 by default. See `sync`.
    people : (V,) places of the person among those of each view; the first by default.

    Returns
    -------
    The cameras and how well they fit.

    Raises
    ------
    CalibrationError : a view without person, too few common moments, no parallax, films of different people or
        moments, a person who hardly moves.
    OptionError : fewer than two views, a stature no person has, another number of cameras, focals, offsets or people.
    """
    _check_numbers(views, stature, cameras=cameras, focals=focals, offsets=offsets, people=people)
    names = tuple(view.source or f"view{place + 1}" for place, view in enumerate(views))
    shared = [name for name in views[0].names if all(name in view.names for view in views)]
    if len(shared) < 8:
        raise CalibrationError("calibration.few_points", found=len(shared))
    points = [shared[place] for place in choose_points(shared)]
    lenses = tuple(cameras) if cameras is not None else guess_lenses(views, focals)
    chosen = people or (0,) * len(views)
    tracks = [
        _make_track(view, person, points, lens, name)
        for view, person, lens, name in zip(views, chosen, lenses, names, strict=True)
    ]
    late = np.zeros(len(views)) if offsets is None else np.array(offsets, np.float64)
    moments = choose_moments(tracks, late, _MOST_MOMENTS)
    if len(moments) < _LEAST_MOMENTS:
        raise CalibrationError("calibration.no_overlap", films=names)
    sightings = read_sightings(tracks, late, moments)
    fit = _fit(sightings, tracks, points, cameras is None and focals is None, names)
    return _finish(fit, sightings, lenses, points, names, stature, moments)


def _check_numbers(views: Sequence[ViewKeypoints], stature: float, **given: Sequence[object] | None) -> None:
    if len(views) < 2:
        raise OptionError("calibration.one_view")
    for what, some in given.items():
        if some is not None and len(some) != len(views):
            raise OptionError("sync.count", what=what, found=len(some), films=len(views))
    if not _STATURES[0] <= stature <= _STATURES[1]:
        raise OptionError("calibration.stature", found=stature, least=_STATURES[0], most=_STATURES[1])
    for focal in given["focals"] or ():
        if not (isinstance(focal, int | float) and 10.0 < focal < 1e6):
            raise OptionError("calibration.focal", found=str(focal))


def guess_lenses(views: Sequence[ViewKeypoints], focals: Sequence[float] | None = None) -> tuple[Camera, ...]:
    """Cameras of given or of usual focal lengths, with the principal point in the middle; where they stand is a guess.

    Parameters
    ----------
    views : of their pictures' sizes.
    focals : (V,) px; by default 0.85 times the longer side of the picture.
    """
    known = focals or [USUAL_FOCAL * max(view.size) for view in views]
    return tuple(
        make_view((0.0, 1.0, 3.0), (0.0, 1.0, 0.0), size=view.size, focal=focal)
        for view, focal in zip(views, known, strict=True)
    )


def _make_track(view: ViewKeypoints, person: int, points: Sequence[str], lens: Camera, name: str) -> Track:
    if not 0 <= person < view.n_people:
        raise CalibrationError("calibration.nobody", film=name)
    track, places = view.people[person], view.find(points)
    made = make_track(view.times, track.points[:, places], track.visibility[:, places], lens)
    if (made.weights > 0).any(axis=1).sum() < 3:
        raise CalibrationError("calibration.nobody", film=name)
    return made


def _fit(
    sightings: Sightings, tracks: Sequence[Track], points: Sequence[str], free: bool, names: tuple[str, ...]
) -> Fit:
    limbs = list_limbs(points)
    focals = np.array([track.focal for track in tracks])
    guess = find_rig(sightings, focals, limbs)
    if guess is None:
        raise CalibrationError("calibration.no_agreement", films=names, share=0.0, film=names[0])
    freedom = Freedom(focals=free, focal_spread=_FOCAL_SPREAD)
    return adjust(sightings, guess.rig, triangulate(sightings, guess.rig), limbs, freedom, _STEPS)


def _finish(
    fit: Fit,
    sightings: Sightings,
    lenses: Sequence[Camera],
    points: Sequence[str],
    names: tuple[str, ...],
    stature: float,
    moments: FloatArray,
) -> Calibration:
    views = rate_views(fit, sightings, names)
    parallax = measure_parallax(fit, sightings)
    share = float(np.mean([view.share for view in views]))
    if share < _LEAST_SHARE:
        worst = min(views, key=lambda view: view.share).name
        raise CalibrationError("calibration.no_agreement", films=names, share=100 * share, film=worst)
    if parallax < _LEAST_PARALLAX:
        raise CalibrationError("calibration.no_parallax", degrees=np.degrees(parallax))
    found = find_world(fit.rig, fit.points, points, stature, moments)
    if found is None:
        raise CalibrationError("calibration.no_limbs")
    rig, placed = found
    motion = float(np.nanmedian(np.linalg.norm(np.nanstd(_fill(placed), axis=0), axis=-1))) / stature
    turn = max(view.turn for view in views)
    if turn > _MOST_TURN:
        raise CalibrationError("calibration.unsure", degrees=np.degrees(turn), motion=100 * motion * stature)
    notes = [] if motion >= _LEAST_MOTION else [Message("calibration.hardly_moves", motion=100 * motion * stature)]
    least = min(views, key=lambda view: view.share)
    if least.share < _USUAL_SHARE:
        notes.append(Message("calibration.few_agree", share=100 * least.share, film=least.name))
    if turn > _DOUBTFUL_TURN:
        notes.append(Message("calibration.doubtful", degrees=np.degrees(turn)))
    cameras = tuple(_make_camera(lens, rig, place, names[place]) for place, lens in enumerate(lenses))
    return Calibration(cameras, views, parallax, placed, tuple(points), tuple(notes))


def _fill(points: FloatArray) -> FloatArray:
    """Points that are never known are of no use for a spread."""
    known = np.isfinite(points).any(axis=(0, 2))
    return points[:, known]


def _make_camera(lens: Camera, rig: Rig, place: int, name: str) -> Camera:
    matrix = np.array(lens.matrix)
    matrix[:2, :2] *= rig.focals[place] / lens.matrix[0, 0]
    return replace(lens, name=name, matrix=matrix, rotation=rig.rotations[place], translation=rig.translations[place])


def rate_views(fit: Fit, sightings: Sightings, names: Sequence[str]) -> tuple[CalibratedView, ...]:
    off = np.linalg.norm(fit.rig.project(np.nan_to_num(fit.points)) - sightings.points, axis=-1)
    counted = (sightings.weights > 0) & np.isfinite(fit.points[..., 0]) & np.isfinite(off)
    variances = np.diag(fit.covariance).reshape(-1, CAMERA_UNKNOWNS)[:, :3].max(axis=1)
    rated = []
    for view, name in enumerate(names):
        some = off[view][counted[view]]
        if not len(some):
            raise CalibrationError("calibration.nobody", film=name)
        share = float((some < _FITS * sightings.spreads[view]).mean())
        turn = _LIKENESS * float(np.sqrt(max(variances[view], 0.0)))
        rated.append(CalibratedView(name, float(np.median(some)), share, turn, len(some)))
    return tuple(rated)


def measure_parallax(fit: Fit, sightings: Sightings) -> float:
    """rad, the middle over the points of the widest angle between two lines of sight."""
    rays = fit.points[None] - fit.rig.positions[:, None, None]
    rays = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    widest = np.full(fit.points.shape[:2], np.nan)
    for one in range(len(rays)):
        for other in range(one):
            cosine = np.clip((rays[one] * rays[other]).sum(axis=-1), -1.0, 1.0)
            both = (sightings.weights[one] > 0) & (sightings.weights[other] > 0)
            angle = np.where(both, np.minimum(np.arccos(cosine), np.pi - np.arccos(cosine)), np.nan)
            widest = np.fmax(widest, angle)
    return float(np.nanmedian(widest)) if np.isfinite(widest).any() else 0.0
