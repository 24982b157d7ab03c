"""The fit of a motion to keypoints of one person in calibrated views.

Sides are corrected, points triangulated without outlying views, stature and bones found from the whole film, then the
most likely trajectory of the body. With one view, stature and the network's own places in space replace the missing
depth.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import BoolArray, FloatArray, IndexArray
from dousa.errors import BodyModelError, KeypointError, SilhouetteError
from dousa.estimation.body.body import BodyModel
from dousa.estimation.body.doubt import judge, list_signs
from dousa.estimation.body.human import LENGTHS, SEX_FACTORS, USUAL_STATURE, make_human
from dousa.estimation.body.kinematics import compute_points, point_names
from dousa.estimation.body.posing import fit_poses, standing_state
from dousa.estimation.cameras.camera import Camera
from dousa.estimation.keypoints.keypoints import PersonTrack
from dousa.estimation.multiview.body_fit import BodyParameters, FittedBody, fit_body_parameters, fit_trajectory
from dousa.estimation.multiview.contours import CONTOUR_POINTS, trace_contour
from dousa.estimation.multiview.keypoint_doubt import DISTANCE_SPREAD, VISIBLE, find_evidence, measure_errors
from dousa.estimation.multiview.landmarks import (
    BREADTHS,
    JOINTS,
    SHIFTS,
    Landmarks,
    SeenLandmarks,
    gather,
    lie_beside_joints,
    place_landmarks,
)
from dousa.estimation.multiview.people import repair_sides
from dousa.estimation.multiview.pose_residuals import Terms, place_points, point_slopes
from dousa.estimation.multiview.triangulation import triangulate
from dousa.estimation.silhouettes.silhouettes import Silhouettes
from dousa.estimation.tracking.person_size import fit_girths
from dousa.estimation.tracking.settings import Estimate
from dousa.messages import Message, Progress
from dousa.motion import rotations as rot
from dousa.motion.resampling import fill_gaps

_MEASURES = ("upper_arm", "forearm", "thigh", "shank", "trunk", "shoulder_breadth", "hip_breadth", "head", "foot")
_STATURE_SIGMA, _GIVEN_SIGMA, _MEASURE_SIGMA = 0.03, 0.01, 0.06  # of logarithms
# Share of a length, one sigma, by which people differ from the body beyond the spread of the fit, measured on people of
# lab.trials.degrees --people tuned.
_BUILD_SIGMA = 0.015
# Joints that no length of a limb places, by the part that they turn: statures by which made people have them farther to
# the left, up and ahead than the body of the tables, measured on people of lab.trials.degrees --people tuned.
_MOVED = {"hip": ("thigh", (0.0, 0.038, 0.0025)), "shoulder": ("upper_arm", (0.0, 0.0075, 0.035))}
_BONES = (("hip", "knee", "thigh"), ("knee", "ankle", "shank"), ("shoulder", "elbow", "upper_arm"),
          ("elbow", "wrist", "forearm"))  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class KeypointFit:
    """A motion from keypoints.

    Parameters
    ----------
    estimate : the motion and its expected error.
    landmarks : on its body.
    seen : (V, T, L) the fitted landmarks, sides corrected.
    exchanged : (V, T, G) where left and right were exchanged.
    errors : (V, T, L) px, reprojection errors; nan where a point is not seen.
    signs : (T, P + K, S) of doubt, see `dousa.estimation.body.doubt`.
    """

    estimate: Estimate
    landmarks: Landmarks
    seen: SeenLandmarks
    exchanged: BoolArray
    errors: FloatArray
    signs: FloatArray

    @property
    def points(self) -> FloatArray:
        """Places (T, L, 3) m of the landmarks on the body."""
        return place_points(self.estimate.body, self.estimate.poses, self.landmarks)


@dataclass(frozen=True, slots=True, eq=False)
class PartialFit:
    """What an interrupted fit has done.

    Parameters
    ----------
    stage : 0 while keypoints alone are fitted, 1 with contours too.
    before : (T, 7 + A) poses of the stage before; without one (0, 7 + A).
    poses, covariance : (N, 7 + A), and (N, P + K, 3, 3) m^2 of the joints, of the first frames in this stage.
    """

    stage: int
    before: FloatArray
    poses: FloatArray
    covariance: FloatArray


Checkpoint = Callable[[Callable[[], PartialFit]], None]
"""Takes what makes a `PartialFit`, and may leave it."""


def fit_keypoints(
    cameras: Sequence[Camera],
    tracks: Sequence[PersonTrack | None],
    names: Sequence[str],
    frame_rate: float,
    *,
    body: BodyModel | None = None,
    stature: float | None = None,
    sex: str = "average",
    silhouettes: Silhouettes | None = None,
    progress: Progress | None = None,
    window: int = 600,
    margin: int = 60,
    resume: PartialFit | None = None,
    on_checkpoint: Checkpoint | None = None,
) -> KeypointFit:
    """Fit a body to one person's keypoints.

    Frames are ``lost`` that are probably off by more than 150 mm (of one view in posture), or show too few points.

    Parameters
    ----------
    cameras : (V,) calibrated, one at least, for images of the keypoints' size.
    tracks : (V,) of the person, of T frames at the same moments; None where a view does not show the person.
    names : (K,) of the keypoints, such as `MEDIAPIPE_NAMES`.
    frame_rate : Hz.
    body : with known lengths; by default they are found.
    stature : m; by default from several views, or 1.72 with one view.
    sex : of the proportions, without a body.
    silhouettes : (V views, T frames) of the person at the same moments, of whole pictures at any size; their contours
        are fitted too, and the girths of the body.
    progress : called with steps done, steps in all and the current step.
    window, margin : frames that are fitted at once, and shared with the next: fewer take less memory.
    resume : what a run with the same arguments had done.
    on_checkpoint : called after each window with what makes a `PartialFit`.

    Raises
    ------
    KeypointError : no frame shows enough of the person, or the names are not those of a body's points.
    """
    begun = perf_counter()
    tell = progress or (lambda done, total, what: None)
    n_frames = max((track.n_frames for track in tracks if track is not None), default=0)
    _check_tracks(cameras, tracks, n_frames)
    tell(0, 4, Message("multiview.triangulating"))
    seen, exchanged = repair_sides(cameras, gather(tracks, names, n_frames))
    shown = [view for view in range(len(cameras)) if seen.seen[view].any()]
    places = _first_places(cameras, seen, shown)
    tell(1, 4, Message("multiview.body"))
    given = body or _usual_body(stature or _guess_stature(places, seen.names, len(shown)), sex)
    poses, determined = _first_poses(given, places, seen.names, frame_rate)
    one = len(shown) == 1  # weight and ease were chosen on the films of lab/trials/made_people.py
    terms = Terms(cameras, seen, frame_rate, *((1.0, 4.0) if one else ()))
    own, landmarks, lengths = _find_body(given, body is None, stature, sex, poses, determined, terms)
    tell(2, 4, Message("multiview.fitting"))
    windows = _Windows(window, margin, tell, resume, on_checkpoint or (lambda make: None))
    own, fitted = _fit_motion(windows, own, poses, landmarks, terms, silhouettes)
    sigma = _STATURE_SIGMA if body is None and stature is None else 0.0
    return _answer((own, landmarks, lengths), fitted, terms, exchanged, begun, sigma)


def _check_tracks(cameras: Sequence[Camera], tracks: Sequence[PersonTrack | None], n_frames: int) -> None:
    if len(tracks) != len(cameras) or any(track is not None and track.n_frames != n_frames for track in tracks):
        raise KeypointError("multiview.views", cameras=len(cameras), tracks=len(tracks))
    if n_frames == 0:
        raise KeypointError("multiview.nobody")


def _first_places(cameras: Sequence[Camera], seen: SeenLandmarks, shown: Sequence[int]) -> FloatArray:
    """Return first places (T, L, 3) m, nan where unknown."""
    if not shown:
        raise KeypointError("multiview.nobody")
    if len(shown) > 1:
        some = list(shown)
        return triangulate([cameras[v] for v in some], seen.points[some], seen.visibility[some]).points
    view = shown[0]
    return place_world(cameras[view], seen.points[view], seen.visibility[view], seen.world[view])


def place_world(camera: Camera, points: FloatArray, visibility: FloatArray, world: FloatArray) -> FloatArray:
    """Move the network's own places in space to their image points, by linear least squares."""
    if not np.isfinite(world).any():
        raise KeypointError("multiview.one_view")
    _, ways = camera.compute_rays(np.nan_to_num(points))
    ways = ways @ camera.rotation.T  # the camera's axes
    good = np.isfinite(points[..., 0]) & np.isfinite(world).all(axis=-1)
    weight = np.where(good, visibility, 0.0)
    ways, world = np.where(good[..., None], ways, 0.0), np.where(good[..., None], world, 0.0)
    across = np.eye(3) - ways[..., :, None] * ways[..., None, :]  # what lies off the ray
    square = np.einsum("tl,tlij->tij", weight, across) + 1e-9 * np.eye(3)
    rest = -np.einsum("tl,tlij,tlj->ti", weight, across, world)
    move = np.linalg.solve(square, rest[..., None])[..., 0]
    placed = np.where(good[..., None], world + move[:, None], np.nan)
    placed[move[:, 2] <= 0] = np.nan
    return np.asarray((placed - camera.translation) @ camera.rotation)


def _guess_stature(places: FloatArray, names: tuple[str, ...], n_views: int, usual: float = USUAL_STATURE) -> float:
    """Estimate the stature from median limb lengths and the tables; ``usual`` m where that is impossible."""
    if n_views < 2:
        return usual
    ratios = []
    for one, other, measure in _BONES:
        for side in ("left_", "right_"):
            if side + one in names and side + other in names:
                ways = places[:, names.index(side + one)] - places[:, names.index(side + other)]
                length = np.nanmedian(np.linalg.norm(ways, axis=1)) if np.isfinite(ways).any() else np.nan
                ratios.append(length / LENGTHS[measure])
    determined = [ratio for ratio in ratios if np.isfinite(ratio)]
    return float(np.clip(np.median(determined), 0.5, 2.3)) if determined else usual


def _first_poses(
    body: BodyModel, places: FloatArray, names: tuple[str, ...], frame_rate: float, every: float = 0.1
) -> tuple[FloatArray, BoolArray]:
    """Return first poses (T, 7 + A), fitted ``every`` s, and (T,) whether the frame determines the pose."""
    known = set(point_names(body))
    rows = [row for row, name in enumerate(names) if name in known and not name.endswith("neck")]
    determined = np.isfinite(places[:, rows, 0])
    filled = places.copy()
    several = [row for row in rows if np.isfinite(places[:, row, 0]).sum() > 1]
    filled[:, several] = fill_gaps(places[:, several])
    some = np.unique(np.append(np.arange(0, len(places), max(1, round(every * frame_rate))), len(places) - 1))
    try:
        poses, _ = fit_poses(body, filled[some][:, rows], [names[row] for row in rows])
    except BodyModelError as error:
        raise KeypointError("multiview.nobody") from error
    return _fill_between(poses, some, len(places)), np.asarray(determined.mean(axis=1) > 0.6)


def _fill_between(poses: FloatArray, frames: IndexArray, n_frames: int) -> FloatArray:
    """Interpolate poses (T, 7 + A) linearly between those at ``frames``."""
    poses = poses.copy()
    for t in range(1, len(poses)):
        if poses[t, 3:7] @ poses[t - 1, 3:7] < 0:
            poses[t, 3:7] *= -1.0
    filled = np.stack([np.interp(np.arange(n_frames), frames, column) for column in poses.T], axis=1)
    filled[:, 3:7] = rot.normalise(filled[:, 3:7])
    return filled


def _find_body(
    given: BodyModel,
    free: bool,
    stature: float | None,
    sex: str,
    poses: FloatArray,
    determined: BoolArray,
    terms: Terms,
    count: int = 60,
    rate: float = 40.0,
) -> tuple[BodyModel, Landmarks, dict[str, tuple[float, float]]]:
    """Return the body, its landmarks, and its lengths and their spread, from ``count`` frames of the whole film.

    As a network's errors are much the same all over a film, these count as if they followed each other at ``rate`` Hz.
    """
    chosen = np.flatnonzero(determined)
    if not len(chosen):
        chosen = np.arange(len(poses))
    chosen = chosen[np.unique(np.linspace(0, len(chosen) - 1, count).astype(int))]
    names = terms.seen.names
    exact = free and not lie_beside_joints(names)
    groups = tuple(group for group in SHIFTS if group in place_landmarks(given, names).groups
                   and not (exact and group in JOINTS))  # fmt: skip
    n_views = terms.seen.n_views
    usual, n_sizes = given.stature, 1 + len(_MEASURES)

    def measure(values: FloatArray) -> dict[str, float]:
        sizes = dict(zip(_MEASURES, np.exp(values[1:n_sizes]).tolist(), strict=True))
        return _usual_measures(usual * float(np.exp(values[0])), sex, sizes)

    def build(values: FloatArray) -> BodyModel:
        if not free:
            return given
        body = make_human(usual * float(np.exp(values[0])), sex, measure(values))
        return _move_joints(body, values[n_sizes:].reshape(-1, 3)) if exact else body

    first = _GIVEN_SIGMA if stature is not None or n_views == 1 else _STATURE_SIGMA
    moves = [SHIFTS[group] for group in _MOVED for _ in range(3)] if exact else []
    sigmas = np.array([first, *[_MEASURE_SIGMA] * len(_MEASURES), *moves]) if free else np.zeros(0)
    few = replace(terms.cut(chosen), frame_rate=rate)
    parameters = BodyParameters(build, lambda own: place_landmarks(own, names), sigmas, groups)
    fitted = fit_body_parameters(parameters, poses[chosen], few)
    if exact and n_views > 1:
        fitted = replace(fitted, landmarks=_find_precision(fitted, few))
    if not free:
        return fitted.body, fitted.landmarks, {}

    def state(values: FloatArray) -> dict[str, float]:
        own, landmarks = parameters.make(values)
        return {"stature": _stand(own, landmarks), **measure(values), **(_measure_joints(own) if exact else {})}

    lengths = _find_spreads(state, fitted)
    lengths = {
        name: (value, float(np.hypot(spread, _BUILD_SIGMA * value))) for name, (value, spread) in lengths.items()
    }
    if n_views > 1 and stature is None:
        return replace(fitted.body, stature=lengths["stature"][0]), fitted.landmarks, lengths
    sigma = _STATURE_SIGMA if stature is None else 0.0  # one view does not show how large anything is
    lengths["stature"] = (usual, 0.0)
    lengths = {name: (value, float(np.hypot(spread, sigma * value))) for name, (value, spread) in lengths.items()}
    return fitted.body, fitted.landmarks, lengths


def _find_precision(fitted: FittedBody, terms: Terms, most: float = 3.0) -> Landmarks:
    """Return the landmarks with the spread of this film, at most ``most`` times smaller than that of networks.

    The expected median of errors is that of two coordinates, less what fitted poses take of them.
    """
    landmarks = fitted.landmarks
    _, off = measure_errors(fitted.body, fitted.poses, landmarks, terms.seen, terms.cameras)
    off, known = off / landmarks.spread, np.isfinite(off) & (terms.seen.visibility > VISIBLE)
    count = 2.0 * known.sum() / len(fitted.poses)
    share = max(1.0 - (6 + fitted.body.n_angles) / max(count, 1.0), 0.25)
    size = float(np.median(off[known])) / np.sqrt(2.0 * np.log(2.0) * share) if known.any() else 1.0
    return replace(landmarks, spread=landmarks.spread * np.clip(size, 1.0 / most, 1.0))


def _move_joints(body: BodyModel, moves: FloatArray | None = None) -> BodyModel:
    """Move the joints of `_MOVED` to where people have them, and by (2, 3) m more, mirrored on the right."""
    offsets = body.offsets.copy()
    for (part, usual), move in zip(_MOVED.values(), np.zeros((2, 3)) if moves is None else moves, strict=True):
        for side, mirror in (("left_", 1.0), ("right_", -1.0)):
            offsets[body.names.index(side + part)] += (body.stature * np.array(usual) + move) * (mirror, 1.0, 1.0)
    return replace(body, offsets=offsets)


def _measure_joints(body: BodyModel) -> dict[str, float]:
    """Return the measures in m that `_move_joints` changes."""
    at = dict(zip(body.names, body.offsets, strict=True))
    hip = at["left_thigh"]
    trunk = at["trunk"][1] + at["head"][1] - hip[1]
    return {"trunk": trunk, "hip_breadth": 2.0 * hip[0], "shoulder_breadth": 2.0 * at["left_upper_arm"][0]}


def _find_spreads(
    measure: Callable[[FloatArray], dict[str, float]], fitted: FittedBody, step: float = 1e-4
) -> dict[str, tuple[float, float]]:
    """Return measures of a fitted body, each with its spread; slopes are differences over ``step`` of a parameter."""
    here = measure(fitted.values)
    moved = [measure(fitted.values + step * row) for row in np.eye(len(fitted.values))]
    slopes = {name: np.array([other[name] - value for other in moved]) / step for name, value in here.items()}
    return {name: (value, float(np.sqrt(slopes[name] @ fitted.covariance @ slopes[name])))
            for name, value in here.items()}  # fmt: skip


def _stand(body: BodyModel, landmarks: Landmarks) -> float:
    """Return the stature of a body by how high its head is when it stands; without a point there, its shoulders.

    Arms and breadths say little of a stature; what stands on the floor adds up to it, hair and shoes left out.
    """
    highest = "head" if "head" in landmarks.groups else "shoulder"
    rows = [row for row, group in enumerate(landmarks.groups) if group == highest]
    if not rows:
        return body.stature
    usual = make_human(body.stature)
    if not lie_beside_joints(landmarks.names):
        usual = _move_joints(usual)
    plain = place_landmarks(usual, landmarks.names)
    heights = [place_points(own, standing_state(own)[None], some)[0, rows, 1].mean()
               for own, some in ((body, landmarks), (usual, plain))]  # fmt: skip
    return body.stature * float(heights[0] / heights[1])


def fit_some_girths(
    body: BodyModel, poses: FloatArray, silhouettes: Silhouettes, cameras: Sequence[Camera], count: int = 12
) -> BodyModel:
    """Return the body with its girths fitted; as it is where no view shows a person.

    Of ``count`` frames those count that the same views show, of all such choices the one with the most masks.
    """
    frames = np.unique(np.linspace(0, len(poses) - 1, count).astype(int))
    read = [silhouettes.read(int(frame)) for frame in frames]
    seen = np.array([[mask is not None and bool(mask.any()) for mask in masks] for masks in read])
    views = max(seen, key=lambda row: row.sum() * seen[:, row].all(axis=1).sum())
    kept, shown = np.flatnonzero(seen[:, views].all(axis=1)), np.flatnonzero(views).tolist()
    frames, read = frames[kept], [read[row] for row in kept]
    small = [cameras[view].resized(*silhouettes.sizes[view]) for view in shown]
    stacked = [np.stack([masks[view] for masks in read]) for view in shown]  # type: ignore[misc]
    try:
        return fit_girths(body, poses[frames], stacked, small) if shown else body
    except SilhouetteError:  # masks without a person
        return body


def _trace_contours(silhouettes: Silhouettes, cameras: Sequence[Camera]) -> NDArray[np.float32]:
    """Return points (V, T, C, 2) of the contours, px of the cameras' pictures."""
    contours = np.full((silhouettes.n_views, silhouettes.n_frames, CONTOUR_POINTS, 2), np.nan, np.float32)
    for frame in range(silhouettes.n_frames):
        for view, (mask, camera) in enumerate(zip(silhouettes.read(frame), cameras, strict=True)):
            contours[view, frame] = trace_contour(mask, camera.size)
    return contours  # 1e-4 px is enough, and half the memory of a long film


def _usual_body(stature: float, sex: str) -> BodyModel:
    """Return the body of the tables with anatomical breadths."""
    return make_human(stature, sex, _usual_measures(stature, sex, dict.fromkeys(BREADTHS, 1.0)))


def _usual_measures(stature: float, sex: str, sizes: Mapping[str, float]) -> dict[str, float]:
    """Return the measures (m) of the tables with anatomical breadths, those of ``sizes`` scaled by them."""
    factors, shares = SEX_FACTORS[sex], LENGTHS | BREADTHS
    return {name: stature * shares[name] * factors.get(name, 1.0) * size for name, size in sizes.items()}


@dataclass(frozen=True, slots=True)
class _Windows:
    """The fit of a film by windows, to limit memory; the arguments are those of `fit_keypoints`."""

    window: int
    margin: int
    tell: Progress
    resume: PartialFit | None
    save: Checkpoint

    def fit(
        self, stage: int, body: BodyModel, start: FloatArray, landmarks: Landmarks, terms: Terms
    ) -> tuple[FloatArray, FloatArray]:
        """Return poses (T, 7 + A) and covariance (T, P + K, 3, 3) m^2 of the joints."""
        n_frames, done = len(start), self.resume if self.resume is not None and self.resume.stage == stage else None
        poses, covariance = ([], []) if done is None else ([done.poses], [done.covariance])
        before = start if stage else start[:0]
        edges = [*range(0, max(n_frames - self.window // 2, 1), self.window), n_frames]
        for begin, end in pairwise(edges):
            if done is not None and end <= len(done.poses):
                continue
            self.tell(begin, n_frames, Message("multiview.fitting"))
            first, last = max(0, begin - self.margin), min(n_frames, end + self.margin)
            whole = slice(first, last)
            fitted, doubt = fit_trajectory(body, start[whole], landmarks, terms.cut(whole))
            kept = slice(begin - first, end - first)
            poses.append(fitted[kept])
            covariance.append(_joint_covariance(body, poses[-1], doubt[kept]))
            self.save(lambda: PartialFit(stage, before, np.concatenate(poses), np.concatenate(covariance)))
        return np.concatenate(poses), np.concatenate(covariance)


def _fit_motion(
    windows: _Windows,
    body: BodyModel,
    poses: FloatArray,
    landmarks: Landmarks,
    terms: Terms,
    silhouettes: Silhouettes | None,
) -> tuple[BodyModel, tuple[FloatArray, FloatArray]]:
    """Return the body, with its girths where there are silhouettes, and its poses and covariance."""
    if windows.resume is not None and windows.resume.stage > 0:
        poses = windows.resume.before
    else:
        fitted = windows.fit(0, body, poses, landmarks, terms)
        poses = fitted[0]
    if silhouettes is not None:
        body = fit_some_girths(body, poses, silhouettes, terms.cameras)
        terms = replace(terms, contours=_trace_contours(silhouettes, terms.cameras))
        fitted = windows.fit(1, body, poses, landmarks, terms)
    return body, fitted


def _answer(
    found: tuple[BodyModel, Landmarks, dict[str, tuple[float, float]]],
    fitted: tuple[FloatArray, FloatArray],
    terms: Terms,
    exchanged: BoolArray,
    begun: float,
    stature_sigma: float,
) -> KeypointFit:
    """Return the result of a fit, with its doubt."""
    (body, landmarks, lengths), (poses, covariance) = found, fitted
    limits, cameras = body.angle_limits, terms.cameras
    poses = np.column_stack((poses[:, :7], np.clip(poses[:, 7:], limits[:, 0], limits[:, 1])))
    errors, off = measure_errors(body, poses, landmarks, terms.seen, cameras)
    evidence = find_evidence(body, covariance, landmarks, terms.seen, off, exchanged)
    signs = list_signs(body, poses, terms.frame_rate, cameras[0].rotation[2], evidence)
    n_views = int(terms.seen.seen.any(axis=(1, 2)).sum())
    doubt = judge(signs, evidence.seen, "keypoints", n_views, body.stature)
    uncertainty, depth = doubt.errors, None
    if n_views < 2:
        away = np.linalg.norm(compute_points(body, poses) - cameras[0].position, axis=-1)
        spread = float(np.hypot(DISTANCE_SPREAD, stature_sigma)) * away
        uncertainty, depth = np.hypot(uncertainty, spread), spread.mean(axis=1)
    estimate = Estimate(
        body,
        poses,
        terms.frame_rate,
        np.full((len(poses), len(cameras)), np.nan),
        uncertainty,
        _find_hidden(body, landmarks, terms.seen),
        doubt.lost,
        (),
        len(poses) / max(perf_counter() - begun, 1e-9),
        lengths,
        depth,
    )
    return KeypointFit(estimate, landmarks, terms.seen, exchanged, errors, signs)


def _joint_covariance(body: BodyModel, poses: FloatArray, covariance: FloatArray) -> FloatArray:
    """Compute the covariance (T, P + K, 3, 3) m^2 of joints and tips."""
    parts = np.concatenate((np.arange(body.n_parts), body.tip_parts))
    places = np.concatenate((np.zeros((body.n_parts, 3)), body.tip_offsets))
    points = Landmarks(point_names(body), parts, places, np.ones(len(parts)), ("",) * len(parts))
    _, slopes = point_slopes(body, poses, points)
    return np.asarray(np.einsum("tkid,tde,tkje->tkij", slopes, covariance, slopes, optimize=True))


def _find_hidden(body: BodyModel, landmarks: Landmarks, seen: SeenLandmarks) -> BoolArray:
    """Find (T, P) parts without any visible point of their own or of the part beyond."""
    shown = np.asarray((seen.visibility > VISIBLE).any(axis=0))
    hidden = np.ones((shown.shape[0], body.n_parts), bool)
    for row, part in enumerate(landmarks.parts):
        for owner in (int(part), int(body.parents[part])):
            if owner >= 0:
                hidden[:, owner] &= ~shown[:, row]
    return hidden
