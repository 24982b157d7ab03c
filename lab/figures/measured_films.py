"""Films with nothing prepared but a calibration (the Pose2Sim demo): keypoints to motion, beside plain triangulation.

Seventeen points of the reference: hips, knees, ankles, big toes, heels, shoulders, elbows, wrists and the nose. Of the
fit the joints are those of the body; toes, heels and nose its landmarks. Plain triangulation is linear, of all views
that are asked for, each point and frame for itself, and not smoothed; with one view it is the network's own places in
space, with the hips aligned. Image t is the reference's frame t - 1.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path

import numpy as np

from dousa.arrays import FloatArray
from dousa.estimation import Camera, ViewKeypoints, find_keypoints, fit_cameras, fit_keypoints, read_cameras
from dousa.estimation.body.kinematics import compute_points, point_names
from dousa.estimation.keypoints.pose_models import check_pose_model, get_pose_model
from dousa.estimation.multiview.keypoint_fit import KeypointFit
from dousa.estimation.multiview.landmarks import gather
from dousa.formats.registry import read_motion

LAG = -1
POINTS = {"nose": "Nose"} | {
    f"{side}_{ours}": side[0].upper() + theirs
    for side in ("left", "right")
    for ours, theirs in (("hip", "Hip"), ("knee", "Knee"), ("ankle", "Ankle"), ("toe", "BigToe"), ("heel", "Heel"),
                         ("shoulder", "Shoulder"), ("elbow", "Elbow"), ("wrist", "Wrist"))
}  # fmt: skip
"""Our landmark -> the reference's marker."""


def measure_films(folder: Path, models: Sequence[str], n_views: Sequence[int]) -> None:
    """Print a row for each model and choice of views."""
    videos = sorted((folder / "videos").glob("*.mp4"))
    calibrated = {camera.name: camera for camera in read_cameras(folder / "calibration" / "Calib.qca.txt")}
    raw = read_motion(folder / "Balancing_for_IK.trc")
    truth = np.stack([raw.positions[:, raw.names.index(name)] for name in POINTS.values()], axis=1)
    print(
        "| model | views | fit, mm | plain triangulation, mm | hips aligned, mm | lost | fit, frames/s |\n"
        + "| --- " * 7
        + "|"
    )
    for model in models:
        if check_pose_model(get_pose_model(model)) != "installed":
            print(f"{model} is not installed; run: dousa keypoints --install")
            continue
        begun = time.perf_counter()
        found = [find_keypoints(video, model) for video in videos]
        seconds = time.perf_counter() - begun
        cameras, _ = fit_cameras([calibrated[video.stem] for video in videos], [view.size for view in found])
        for count in n_views:
            rows = [measure_choice(model, choice, found, cameras, truth) for choice in
                    combinations(range(len(videos)), count)]  # fmt: skip
            if len(rows) > 1:
                means = np.mean(rows, axis=0)
                print(f"| {model} | mean of {len(rows)} choices of {count} | **{means[0]:.1f}** | {means[1]:.1f} | "
                      f"{means[2]:.1f} | {means[3]:.0f} | |")  # fmt: skip
        print(
            f"\nkeypoints of {model}: {seconds:.1f} s for {sum(view.n_frames for view in found)} pictures (0 s: kept)\n"
        )


def measure_choice(
    model: str, choice: Sequence[int], found: Sequence[ViewKeypoints], cameras: Sequence[Camera], truth: FloatArray
) -> tuple[float, float, float, float]:
    """Errors of the fit, of the baseline, of the fit with the hips in place (mm), and frames lost.

    The baseline is plain triangulation, or with one view the network's own posture.
    """
    tracks = [found[view].people[0] for view in choice]
    some = [cameras[view] for view in choice]
    fit = fit_keypoints(some, tracks, found[0].names, 60.0)
    places = list_points(fit)
    seen = gather(tracks, found[0].names, tracks[0].n_frames)
    rows = [seen.names.index(name) for name in POINTS]
    if len(choice) == 1:
        plain = compare((seen.world[0] @ some[0].rotation)[:, rows], truth)[1]
    else:
        plain = compare(triangulate_plainly(some, seen.points)[:, rows], truth)[0]
    error, posture = compare(places, truth)
    lost = float(fit.estimate.lost.sum())
    views = ", ".join(str(view + 1) for view in choice)
    print(f"| {model} | {views} | {error:.1f} | {plain:.1f} | {posture:.1f} | {lost:.0f} | "
          f"{fit.estimate.frames_per_second:.0f} |", flush=True)  # fmt: skip
    return error, plain, posture, lost


def list_points(fit: KeypointFit) -> FloatArray:
    """(T, 17, 3) m: joints of the body, and its landmarks where it has no such joint."""
    body = fit.estimate.body
    joints = dict(zip(point_names(body), np.moveaxis(compute_points(body, fit.estimate.poses), 1, 0), strict=True))
    own = dict(zip(fit.landmarks.names, np.moveaxis(fit.points, 1, 0), strict=True))
    return np.stack([own[name] if name.endswith(("toe", "heel", "nose")) else joints[name] for name in POINTS], axis=1)


def compare(places: FloatArray, truth: FloatArray) -> tuple[float, float]:
    """Mean distances in mm, as they are and with the middle of the hips in place."""
    frames = np.arange(len(places))
    inside = (frames + LAG >= 0) & (frames + LAG < len(truth))
    ours, theirs = places[inside], truth[frames[inside] + LAG]
    hips = [list(POINTS).index(name) for name in ("left_hip", "right_hip")]
    moved = ours - ours[:, hips].mean(axis=1, keepdims=True) + theirs[:, hips].mean(axis=1, keepdims=True)
    return tuple(1e3 * float(np.nanmean(np.linalg.norm(own - theirs, axis=2))) for own in (ours, moved))  # type: ignore[return-value]


def triangulate_plainly(cameras: Sequence[Camera], points: FloatArray) -> FloatArray:
    """(T, L, 3) by the direct linear transform."""
    rows = []
    for camera, own in zip(cameras, points, strict=True):
        matrix = camera.matrix
        flat = camera.undistort((own - matrix[:2, 2]) / np.diag(matrix)[:2])
        outer = np.column_stack((camera.rotation, camera.translation))
        rows += [flat[..., :1] * outer[2] - outer[0], flat[..., 1:] * outer[2] - outer[1]]
    ends = np.linalg.svd(np.stack(rows, axis=-2))[2][..., -1, :]
    return np.asarray(ends[..., :3] / ends[..., 3:])
