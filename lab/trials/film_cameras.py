"""Films without preparation: time offsets and cameras from the person, on Pose2Sim's four films.

    python -m lab.trials.film_cameras [--folder FOLDER] [--model heavy] [--only times|cameras] [--trials N] [--seed N]

Needs the models (``dousa keypoints --install``); without them it says so and ends. Prints

- times: every trial cuts the films at known frames, and makes one of them 25 frames/s as a converter does (the nearest
  frame at each moment). Error of the offsets (ms): the plain way, whole frames by the cross-correlation of the mean
  speed, and ours, with all four films and with each pair;
- cameras: of each pair and of all four, with the calibrated lenses and with none. Error of the plain way (OpenCV's
  essential matrix by RANSAC, further cameras by its PnP, no refinement) and ours: the largest error of a direction
  between two cameras (degrees), and the mean distance (mm) of the joints from those of the calibrated cameras after
  similarity alignment; for ours also the direction of up (degrees).

The films were taken by a system that triggers its cameras together; that they are together to a millisecond is not
known.
"""

from __future__ import annotations

import argparse
import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np

from dousa.arrays import FloatArray
from dousa.errors import CalibrationError, KeypointError
from dousa.estimation import (
    Camera,
    PersonTrack,
    ViewKeypoints,
    calibrate_from_person,
    find_keypoints,
    fit_cameras,
    match_cameras,
    read_cameras,
    sync,
)
from dousa.estimation.calibration.bundle import Freedom, Rig, Sightings, adjust
from dousa.estimation.calibration.rig_search import triangulate
from dousa.estimation.calibration.sightings import choose_moments, list_limbs, make_track, read_sightings
from dousa.estimation.sync.synchronise import rig_of
from lab.places import SHARED_DATA

_SHARED = SHARED_DATA / "pose2sim"
_STATURE, _RATE, _LEAST = 1.72, 60.0, 20
_SETS = [(0, 1, 2, 3), *itertools.combinations(range(4), 2)]


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", type=Path, default=_SHARED)
    parser.add_argument("--model", choices=("lite", "full", "heavy"), default="heavy")
    parser.add_argument("--only", choices=("times", "cameras"))
    parser.add_argument("--trials", type=int, default=3)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    films = sorted((given.folder / "videos").glob("*.mp4"))
    try:
        views = [replace(find_keypoints(film, given.model), source=film.stem) for film in films]
    except KeypointError as error:
        raise SystemExit(str(error)) from error
    matched, _ = match_cameras(
        read_cameras(given.folder / "calibration" / "Calib.qca.txt"), [view.source for view in views]
    )
    cameras, _ = fit_cameras(matched, [view.size for view in views])
    if given.only != "cameras":
        measure_times(views, given.trials, given.seed)
    if given.only != "times":
        measure_cameras(views, cameras)


def measure_times(views: list[ViewKeypoints], trials: int, seed: int) -> None:
    """Print the errors of offsets by films that are compared."""
    rng = np.random.default_rng(seed)
    print("times: error of offsets, ms: mean, largest; share within 10 ms")
    for chosen in _SETS:
        plain, ours = [], []
        for trial in range(trials):
            length = int(rng.integers(70, 95))
            begins = rng.integers(0, views[0].n_frames - length + 1, len(chosen))
            slow = trial % len(chosen)
            cut = [
                cut_film(views[view], begin, length, 25.0 if place == slow else _RATE)
                for place, (view, begin) in enumerate(zip(chosen, begins, strict=True))
            ]
            true = (begins - begins[0]) / _RATE
            plain.append([compare_plainly(cut[0], other) for other in cut[1:]] - true[1:])
            try:
                ours.append(sync(cut).offsets[1:] - true[1:])
            except CalibrationError as error:
                print("  refused:", error)
        names = " ".join(views[view].source for view in chosen)
        print(f"  {names:24s}", *(f"{what} {describe(errors)}" for what, errors in (("plain", plain), ("ours", ours))))


def describe(errors: list[FloatArray]) -> str:
    """Errors (s) in words."""
    if not errors:
        return "none"
    off = 1e3 * np.abs(np.concatenate(errors))
    return f"{off.mean():6.1f} {off.max():6.1f} {100 * (off <= 10).mean():4.0f} %"


def cut_film(view: ViewKeypoints, begin: int, length: int, rate: float) -> ViewKeypoints:
    """Some frames of a film, at another rate as a converter makes it."""
    times = np.arange(int((length - 1) / _RATE * rate) + 1) / rate
    frames = begin + np.round(times * _RATE).astype(int)
    people = tuple(PersonTrack(person.points[frames], person.visibility[frames]) for person in view.people)
    return ViewKeypoints(view.names, people, times, view.size, view.source)


def compare_plainly(first: ViewKeypoints, second: ViewKeypoints) -> float:
    """The offset (s) by whole frames: the greatest correlation of the mean speed of all points."""
    speeds = []
    for view in (first, second):
        grid = np.arange(0.0, view.times[-1], 1 / _RATE)
        flat = np.nan_to_num(view.people[0].points.reshape(view.n_frames, -1))
        points = np.stack([np.interp(grid, view.times, column) for column in flat.T], axis=1).reshape(len(grid), -1, 2)
        speeds.append(np.linalg.norm(np.diff(points, axis=0), axis=-1).mean(axis=1))
    found = []
    for lag in range(-len(speeds[1]) + _LEAST, len(speeds[0]) - _LEAST):
        one = speeds[0][max(0, lag) :]
        other = speeds[1][max(0, -lag) :][: len(one)]
        found.append((float(np.corrcoef(one[: len(other)], other)[0, 1]), lag))
    return max(found)[1] / _RATE


def measure_cameras(views: list[ViewKeypoints], cameras: tuple[Camera, ...]) -> None:
    """Print the errors of cameras by films and by what is known of the lenses."""
    print("cameras: largest error between two, degrees; joints, mm; up, degrees")
    for chosen in _SETS:
        some, true = [views[view] for view in chosen], [cameras[view] for view in chosen]
        names = " ".join(view.source for view in some)
        sightings, points = look(some, true)
        limbs = list_limbs(points)
        rig = rig_of(true)
        places = adjust(sightings, rig, triangulate(sightings, rig), limbs, Freedom(poses=False)).points
        plain = place_plainly(sightings, rig.focals)
        print(f"  {names:24s} plain, lenses known {rate(plain, triangulate(sightings, plain), rig, places)}")
        for what, lenses in (("lenses known", true), ("nothing known", None)):
            try:
                found = calibrate_from_person(some, _STATURE, cameras=lenses)
            except CalibrationError as error:
                print(f"  {names:24s} ours, {what}: refused: {error}")
                continue
            rotation = align(found.points, places)[1]
            tilt = np.degrees(np.arccos(np.clip(rotation[1, 1], -1, 1)))
            errors = rate(rig_of(found.cameras), found.points, rig, places)
            print(f"  {names:24s} ours, {what:13s} {errors}, up {tilt:4.1f}")


def look(views: list[ViewKeypoints], cameras: list[Camera]) -> tuple[Sightings, tuple[str, ...]]:
    """What calibrated cameras saw, at the moments of `calibrate_from_person`."""
    from dousa.estimation.calibration.sightings import choose_points

    points = tuple(choose_points(views[0].names))
    tracks = [
        make_track(
            view.times, view.people[0].points[:, view.find(points)], view.people[0].visibility[:, view.find(points)],
            camera,
        )
        for view, camera in zip(views, cameras, strict=True)
    ]  # fmt: skip
    offsets = np.zeros(len(views))
    return read_sightings(tracks, offsets, choose_moments(tracks, offsets, 120)), points


def place_plainly(sightings: Sightings, focals: FloatArray) -> Rig:
    """The first two cameras by OpenCV's essential matrix, the others by its PnP; nothing is refined."""
    import cv2

    count = len(focals)
    rotations, translations = np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3))
    both = (sightings.weights[0] > 0) & (sightings.weights[1] > 0)
    flat = [sightings.points[view][both] / focals[view] for view in (0, 1)]
    essential, inliers = cv2.findEssentialMat(flat[0], flat[1], np.eye(3), cv2.RANSAC, 0.999, 10.0 / focals[0])
    _, rotation, move, _ = cv2.recoverPose(essential[:3], flat[0], flat[1], np.eye(3), mask=inliers)
    rotations[1], translations[1] = rotation, move.ravel()
    for view in range(2, count):
        rig = Rig(rotations, translations, focals, np.zeros(count))
        points = triangulate(sightings, rig, range(view))
        seen = np.isfinite(points[..., 0]) & (sightings.weights[view] > 0)
        image = sightings.points[view][seen] / focals[view]
        _, turn, place, _ = cv2.solvePnPRansac(
            points[seen], image, np.eye(3), None, reprojectionError=20 / focals[view]
        )
        rotations[view], translations[view] = cv2.Rodrigues(turn)[0], place.ravel()
    return Rig(rotations, translations, focals, np.zeros(count))


def rate(rig: Rig, points: FloatArray, true: Rig, places: FloatArray) -> str:
    """The errors in words."""
    worst = max(
        turn_between(rig.rotations[a] @ rig.rotations[b].T, true.rotations[a] @ true.rotations[b].T)
        for a, b in itertools.combinations(range(len(rig.rotations)), 2)
    )
    scale, rotation, offset = align(points, places)
    off = np.linalg.norm(scale * points @ rotation.T + offset - places, axis=-1)
    return f"{worst:5.1f} degrees, joints {1e3 * np.nanmean(off):6.1f} mm"


def turn_between(first: FloatArray, second: FloatArray) -> float:
    """Degrees between two rotations."""
    return float(np.degrees(np.arccos(np.clip((np.trace(first @ second.T) - 1) / 2, -1, 1))))


def align(points: FloatArray, places: FloatArray) -> tuple[float, FloatArray, FloatArray]:
    """Scale, rotation and offset that bring points nearest to others (Umeyama 1991)."""
    known = np.isfinite(points[..., 0]) & np.isfinite(places[..., 0])
    a, b = points[known], places[known]
    middle_a, middle_b = a.mean(axis=0), b.mean(axis=0)
    left, sizes, right = np.linalg.svd((b - middle_b).T @ (a - middle_a))
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    rotation = left @ np.diag(sign) @ right
    scale = float((sizes * sign).sum() / ((a - middle_a) ** 2).sum())
    return scale, rotation, middle_b - scale * rotation @ middle_a


if __name__ == "__main__":
    main()
