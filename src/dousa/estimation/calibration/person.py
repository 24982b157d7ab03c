"""Calibration of cameras from keypoints of a moving person of known stature.

Scale: ankle to knee to hip to shoulder is 0.775 of a person's stature, nearly independent of posture and of where
networks put hips (Winter, Biomechanics and Motor Control of Human Movement: 0.779; on films of a man of 1.72 m:
0.768). Up: the centre of mass is above the feet that carry it, most cameras stand upright (their rows are level), and
resting feet are on one plane. The first camera looks from +Z.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dousa.arrays import FloatArray
from dousa.errors import CalibrationError, OptionError
from dousa.estimation.calibration.bundle import LIKENESS, Fit, Freedom, Rig, Sightings, adjust
from dousa.estimation.calibration.rig_search import find_rig, triangulate
from dousa.estimation.calibration.sightings import (
    Track,
    choose_moments,
    choose_points,
    list_limbs,
    make_track,
    name_views,
    read_sightings,
)
from dousa.estimation.cameras.camera import Camera, make_view
from dousa.estimation.keypoints.keypoints import ViewKeypoints
from dousa.messages import Message

_CHAIN, _ARM = 0.775, 0.325  # shares of stature: ankle to knee to hip to shoulder, shoulder to elbow to wrist
_ROLL, _LEAN = np.radians(4.0), np.radians(3.0)  # how far cameras are tilted sideways, and people off their balance
# Shares of the body's mass between two points (Winter), arms and head by the trunk's ends.
_MASSES = {("hip", "shoulder"): 0.6, ("hip", "knee"): 0.2, ("knee", "ankle"): 0.093, ("shoulder", "elbow"): 0.06,
           ("elbow", "wrist"): 0.047}  # fmt: skip
_FOOT_POINTS = ("heel", "foot_index", "big_toe", "ankle")


def measure_stature(points: FloatArray, names: Sequence[str]) -> float | None:
    """Measure the stature in the unit of points (T, K, 3), nan where unknown; None without the limbs."""
    trunk = np.linalg.norm(find_middle(points, names, "hip") - find_middle(points, names, "shoulder"), axis=-1)
    leg = _length(points, names, "ankle", "knee") + _length(points, names, "knee", "hip")
    arm = _length(points, names, "shoulder", "elbow") + _length(points, names, "elbow", "wrist")
    if np.isfinite(leg) and np.isfinite(trunk).any():
        return (leg + float(np.nanmedian(trunk))) / _CHAIN
    return arm / _ARM if np.isfinite(arm) else None


def _length(points: FloatArray, names: Sequence[str], first: str, second: str) -> float:
    """Return the median length of a limb, averaged over both sides; nan if unknown."""
    sides = [(f"{side}_{first}", f"{side}_{second}") for side in ("left", "right")]
    there = [(names.index(a), names.index(b)) for a, b in sides if a in names and b in names]
    lengths = [np.linalg.norm(points[:, a] - points[:, b], axis=-1) for a, b in there]
    found = [float(np.nanmedian(some)) for some in lengths if np.isfinite(some).any()]
    return float(np.mean(found)) if found else np.nan


def find_middle(points: FloatArray, names: Sequence[str], name: str) -> FloatArray:
    """Return (T, 3) the middle between the left and the right point; nan where one is unknown."""
    pair = [f"{side}_{name}" for side in ("left", "right")]
    if not all(one in names for one in pair):
        return np.full((len(points), 3), np.nan)
    return np.asarray(points[:, [names.index(one) for one in pair]].mean(axis=1), np.float64)


def find_world(
    rig: Rig, points: FloatArray, names: Sequence[str], stature: float, moments: FloatArray
) -> tuple[Rig, FloatArray] | None:
    """Return the rig and the points in metres, Y up, the floor at 0, the person about the origin.

    Returns None without a limb for the scale.

    Parameters
    ----------
    rig : in an arbitrary unit and axes.
    points : (T, K, 3) in them, nan where unknown.
    names : (K,) of the points.
    stature : m.
    moments : (T,) s.
    """
    measured = measure_stature(points, names)
    if measured is None or not measured > 0:
        return None
    scale = stature / measured
    points = points * scale
    rig = replace(rig, translations=rig.translations * scale)
    up = _find_up(rig, points, names, moments)
    middle = find_middle(points, names, "hip")
    middle = points.reshape(-1, 3) if not np.isfinite(middle).any() else middle
    centre = np.nanmedian(middle, axis=0)
    axes = rig.face(centre, up)  # from the old world to the new
    floor = _find_floor((points - centre) @ axes.T, names, stature)
    shift = -axes @ centre - np.array([0.0, floor, 0.0])
    return rig.move(axes, shift), points @ axes.T + shift


def _find_up(
    rig: Rig,
    points: FloatArray,
    names: Sequence[str],
    moments: FloatArray,
    *,
    foot_spread: float = 0.03,
    n_feet: float = 10.0,
) -> FloatArray:
    """Find the up vector from centres of mass above carrying feet, level image rows and resting feet.

    Feet are off the floor by ``foot_spread`` m, and ``n_feet`` of them are independent.
    """
    level, cameras = rig.rotations[:, 0], -rig.rotations[:, 1].mean(axis=0)
    along = find_middle(points, names, "shoulder") - find_middle(points, names, "ankle")
    along = along[np.isfinite(along).all(axis=-1)]
    up = along.sum(axis=0) if len(along) else cameras
    up = up / max(float(np.linalg.norm(up)), 1e-9)
    for _ in range(6):
        carried = _find_load(points, names, moments, up)
        lean = up if carried is None else carried
        form = (np.eye(3) - np.outer(lean, lean)) / _LEAN**2
        weights = 1.0 / (1.0 + (level @ up / _ROLL) ** 2)  # a tripod may be tilted
        form += np.einsum("v,vi,vj->ij", weights, level, level) / _ROLL**2
        feet = _find_resting(points, names, moments, up)
        if len(feet) >= n_feet:
            form += n_feet * np.cov(feet.T) / foot_spread**2
        up = np.linalg.eigh(form)[1][:, 0]
        up = up if up @ lean > 0 else -up
    return np.asarray(up, np.float64)


def _find_load(
    points: FloatArray,
    names: Sequence[str],
    moments: FloatArray,
    up: FloatArray,
    *,
    slow: float = 0.5,
    lifted: float = 0.08,
) -> FloatArray | None:
    """Return the unit vector from the carrying feet to the centre of mass, over all moments; None if unknown.

    A foot carries that moves by less than ``slow`` m/s and is less than ``lifted`` m above the other.
    """
    mass, total = np.zeros((len(points), 3)), 0.0
    for (first, second), share in _MASSES.items():
        mass += share * (find_middle(points, names, first) + find_middle(points, names, second)) / 2.0
        total += share
    of_sides = [[f"{side}_{kind}" for kind in _FOOT_POINTS] for side in ("left", "right")]
    feet = [[names.index(name) for name in some if name in names] for some in of_sides]
    if len(points) < 3 or not all(feet):
        return None
    both = np.stack([points[:, foot].mean(axis=1) for foot in feet])
    speeds = np.linalg.norm(np.gradient(both, moments, axis=1), axis=-1)
    heights = both @ up
    carries = (speeds < slow) & (heights < np.nanmin(heights, axis=0, initial=np.inf) + lifted)
    count = carries.sum(axis=0)
    place = np.where(carries[..., None], both, 0.0).sum(axis=0) / np.maximum(count, 1)[:, None]
    way = (mass / total - place)[count > 0]
    way = way[np.isfinite(way).all(axis=-1)]
    if len(way) < 3:
        return None
    mean = np.median(way, axis=0)
    return np.asarray(mean / np.linalg.norm(mean))


def _find_resting(
    points: FloatArray,
    names: Sequence[str],
    moments: FloatArray,
    up: FloatArray,
    *,
    low: float = 0.15,
    resting: float = 0.25,
    near_floor: float = 0.12,
) -> FloatArray:
    """Return (N, 3) resting feet near the floor, each less the median height of its kind.

    A foot rests that moves by less than ``resting`` m/s within ``near_floor`` m of the quantile ``low`` of its heights.
    """
    kept = []
    for name in (f"{side}_{kind}" for kind in _FOOT_POINTS for side in ("left", "right")):
        if name not in names or len(points) < 3:
            continue
        track = points[:, names.index(name)]
        heights = track @ up
        if not np.isfinite(heights).any():
            continue
        speeds = np.linalg.norm(np.gradient(track, moments, axis=0), axis=-1)
        is_near = np.abs(heights - np.nanquantile(heights, low)) < near_floor
        rest = track[(np.nan_to_num(speeds, nan=np.inf) < resting) & is_near]
        if len(rest) >= 3:
            kept.append(rest - up * np.median(rest @ up))
    return np.concatenate(kept) if kept else np.zeros((0, 3))


def _find_floor(
    points: FloatArray,
    names: Sequence[str],
    stature: float,
    low: float = 0.075,
    shares: Sequence[float] = (0.025, 0.005, 0.005, 0.06),
) -> float:
    """Return the height of the floor among points with Y up.

    The quantile ``low`` of the heights of a point of the foot is that of one on the floor, which lies ``shares`` of the
    stature above it.
    """
    found = []
    for kind, share in zip(_FOOT_POINTS, shares, strict=True):
        both = [names.index(f"{side}_{kind}") for side in ("left", "right") if f"{side}_{kind}" in names]
        heights = points[:, both, 1]
        if np.isfinite(heights).any():
            found.append(float(np.nanquantile(heights, low)) - share * stature)
    return float(np.median(found)) if found else float(np.nanmin(points[..., 1]))


@dataclass(frozen=True, slots=True, eq=False)
class CalibratedView:
    """The quality of one camera.

    Parameters
    ----------
    name : of the view.
    residual : px, median reprojection error.
    share : of the points that are within three expected spreads.
    turn : rad, standard deviation of the camera's direction relative to the first, whose is 0.
    n_points : number of points used.
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
    views : (V,) quality of each.
    parallax : rad, median angle between the lines of sight to a point.
    points : (T, K, 3) m, the points seen; nan where unknown.
    names : (K,) of the points; none for a board.
    warnings : notes for the user.
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
    most_moments: int = 120,
    least_moments: int = 12,
) -> Calibration:
    """Calibrate cameras from the keypoints of one person who moves before them.

    Parameters
    ----------
    views : (V,) two films or more; the camera of each stands still.
    stature : m, of the person.
    cameras : (V,) with known focal length, principal point and distortion; their poses are ignored.
    focals : (V,) px, if nothing else is known. Without either, focal lengths are found too, near those of phones.
    offsets : (V,) s, added to the time of each film to get the common time; 0 by default. See `sync`.
    people : (V,) places of the person among those of each view; the first by default.
    most_moments, least_moments : common moments that are used, and needed.

    Raises
    ------
    CalibrationError : a view without person, too few common moments, no parallax, films of different people or
        moments, a person who hardly moves.
    OptionError : fewer than two views, a stature no person has, another number of cameras, focals, offsets or people.
    """
    _check_numbers(views, stature, cameras=cameras, focals=focals, offsets=offsets, people=people)
    names = name_views(views)
    shared = [name for name in views[0].names if all(name in view.names for view in views)]
    if len(shared) < 8:
        raise CalibrationError("calibration.few_points", found=len(shared))
    points = choose_points(shared)
    lenses = tuple(cameras) if cameras is not None else guess_lenses(views, focals)
    chosen = people or (0,) * len(views)
    tracks = [
        _make_track(view, person, points, lens, name)
        for view, person, lens, name in zip(views, chosen, lenses, names, strict=True)
    ]
    late = np.zeros(len(views)) if offsets is None else np.array(offsets, np.float64)
    moments = choose_moments(tracks, late, most_moments)
    if len(moments) < least_moments:
        raise CalibrationError("calibration.no_overlap", films=names)
    sightings = read_sightings(tracks, late, moments)
    fit = _fit(sightings, tracks, points, cameras is None and focals is None, names)
    return _finish(fit, sightings, lenses, points, names, stature, moments)


def _check_numbers(
    views: Sequence[ViewKeypoints],
    stature: float,
    least: float = 0.5,
    most: float = 2.6,
    **given: Sequence[object] | None,
) -> None:
    """Check for two views, a stature between ``least`` and ``most`` m, and as many of all else as of views."""
    if len(views) < 2:
        raise OptionError("calibration.one_view")
    for what, some in given.items():
        if some is not None and len(some) != len(views):
            raise OptionError("sync.count", what=what, found=len(some), films=len(views))
    if not least <= stature <= most:
        raise OptionError("calibration.stature", found=stature, least=least, most=most)
    for focal in given["focals"] or ():
        if not (isinstance(focal, int | float) and 10.0 < focal < 1e6):
            raise OptionError("calibration.focal", found=str(focal))


def guess_lenses(
    views: Sequence[ViewKeypoints], focals: Sequence[float] | None = None, usual: float = 0.85
) -> tuple[Camera, ...]:
    """Return cameras of given or usual focal lengths, with the principal point in the middle and an arbitrary pose.

    Parameters
    ----------
    views : for the image sizes.
    focals : (V,) px; by default ``usual`` times the longer side of the image.
    usual : of phones and of most other cameras that film people.
    """
    known = [usual * max(view.size) for view in views] if focals is None else focals
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
    sightings: Sightings,
    tracks: Sequence[Track],
    points: Sequence[str],
    free: bool,
    names: tuple[str, ...],
    *,
    focal_spread: float = 0.15,
    steps: int = 60,
) -> Fit:
    """Fit cameras and points in at most ``steps``; focal lengths deviate by ``focal_spread`` (relative)."""
    limbs = list_limbs(points)
    guess = find_rig(sightings, np.array([track.focal for track in tracks]), limbs)
    if guess is None:
        raise CalibrationError("calibration.no_agreement", films=names, share=0.0, film=names[0])
    freedom = Freedom(focals=free, focal_spread=focal_spread)
    return adjust(sightings, guess.rig, triangulate(sightings, guess.rig), limbs, freedom, steps)


def _finish(
    fit: Fit,
    sightings: Sightings,
    lenses: Sequence[Camera],
    points: Sequence[str],
    names: tuple[str, ...],
    stature: float,
    moments: FloatArray,
    *,
    least_share: float = 0.75,
    usual_share: float = 0.9,
    least_parallax: float = 5.0,
    doubtful_turn: float = 8.0,
    most_turn: float = 15.0,
    least_motion: float = 0.04,
) -> Calibration:
    """Place the fitted cameras in the world, and refuse or doubt a fit that the films do not determine.

    Shares are of the points that agree; parallax, and turns by which a camera may be off, are in degrees; a person who
    moves by less than ``least_motion`` of the stature hardly does.
    """
    views = rate_views(fit, sightings, names)
    parallax = measure_parallax(fit, sightings)
    share = float(np.mean([view.share for view in views]))
    least = min(views, key=lambda view: view.share)
    if share < least_share:
        raise CalibrationError("calibration.no_agreement", films=names, share=100 * share, film=least.name)
    if parallax < np.radians(least_parallax):
        raise CalibrationError("calibration.no_parallax", degrees=np.degrees(parallax))
    found = find_world(fit.rig, fit.points, points, stature, moments)
    if found is None:
        raise CalibrationError("calibration.no_limbs")
    rig, placed = found
    known = placed[:, np.isfinite(placed).any(axis=(0, 2))]
    motion = float(np.nanmedian(np.linalg.norm(np.nanstd(known, axis=0), axis=-1))) / stature
    turn = max(view.turn for view in views)
    if turn > np.radians(most_turn):
        raise CalibrationError("calibration.unsure", degrees=np.degrees(turn), motion=100 * motion * stature)
    notes = [] if motion >= least_motion else [Message("calibration.hardly_moves", motion=100 * motion * stature)]
    if least.share < usual_share:
        notes.append(Message("calibration.few_agree", share=100 * least.share, film=least.name))
    if turn > np.radians(doubtful_turn):
        notes.append(Message("calibration.doubtful", degrees=np.degrees(turn)))
    return Calibration(place_lenses(lenses, rig, names), views, parallax, placed, tuple(points), tuple(notes))


def place_lenses(lenses: Sequence[Camera], rig: Rig, names: Sequence[str]) -> tuple[Camera, ...]:
    """Return the cameras (V,) of these lenses with the focal lengths and poses of a rig."""
    placed = []
    for lens, name, focal, rotation, translation in zip(
        lenses, names, rig.focals, rig.rotations, rig.translations, strict=True
    ):
        matrix = np.array(lens.matrix)
        matrix[:2, :2] *= focal / lens.matrix[0, 0]
        placed.append(replace(lens, name=name, matrix=matrix, rotation=rotation, translation=translation))
    return tuple(placed)


def rate_views(fit: Fit, sightings: Sightings, names: Sequence[str], fits: float = 3.0) -> tuple[CalibratedView, ...]:
    """Rate the views of a fit; a point agrees that is off by less than ``fits`` spreads."""
    off = np.linalg.norm(fit.rig.project(np.nan_to_num(fit.points)) - sightings.points, axis=-1)
    counted = (sightings.weights > 0) & np.isfinite(fit.points[..., 0]) & np.isfinite(off)
    turns = LIKENESS * np.sqrt(fit.variances[:, :3].max(axis=1))
    rated = []
    for view, name in enumerate(names):
        some = off[view][counted[view]]
        if not len(some):
            raise CalibrationError("calibration.nobody", film=name)
        share = float((some < fits * sightings.spreads[view]).mean())
        rated.append(CalibratedView(name, float(np.median(some)), share, float(turns[view]), len(some)))
    return tuple(rated)


def measure_parallax(fit: Fit, sightings: Sightings) -> float:
    """Compute the median (rad) over the points of the widest angle between two lines of sight."""
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
