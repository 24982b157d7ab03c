"""Four videos of one man (the Pose2Sim demo): from video to motion, compared with the markerless reference.

The plates show the scene at another moment; the reference itself is good to some 3 cm. Tracked with one thread.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray, Image, Mask
from dousa.estimation import (
    BodyModel,
    Camera,
    PackedSilhouettes,
    estimate,
    fit_body,
    fit_cameras,
    fit_girths,
    fit_pose,
    fit_poses,
    make_human,
    open_silhouettes,
    read_cameras,
)
from dousa.estimation.body.kinematics import compute_points, point_names
from dousa.estimation.raster.rasteriser import draw_body
from dousa.estimation.silhouettes.images import fit_frame
from dousa.estimation.silhouettes.silhouettes import WrappedSilhouettes
from dousa.estimation.silhouettes.video import VideoFile
from dousa.estimation.tracking.settings import Estimate
from dousa.formats.registry import read_motion
from dousa.motion import CANONICAL_JOINTS, CanonicalMotion, canonicalise
from lab.estimation.clips import constant_velocity, frozen_first_pose
from lab.estimation.metrics import compare_in_images, compare_with_truth, compute_iou

LAGS = range(-4, 5)

Reference = dict[str, FloatArray]


def measure_video(folder: Path, start: str, views: Sequence[int], cache: Path | None, pictures: Path | None) -> None:
    """Print lag, errors, overlap and speed of one way to start."""
    videos = [folder / "videos" / f"cam{view:02d}.mp4" for view in views]
    everything = read_masks(folder, cache)
    videos = [folder / "videos" / f"{name}.mp4" for name in everything.names]
    calibrated = {camera.name: camera for camera in read_cameras(folder / "calibration" / "Calib.qca.txt")}
    every_camera, notes = fit_cameras([calibrated[name] for name in everything.names], everything.sizes)
    motion = canonicalise(read_motion(folder / "Balancing_for_IK.trc"))
    print(f"{everything.n_frames} frames of {everything.sizes}, reference {motion.n_frames} frames", *notes)
    read = [everything.read(frame) for frame in range(everything.n_frames)]
    every_mask = [np.stack(masks) for masks in zip(*read, strict=True)]  # type: ignore[arg-type]
    reference = align_reference(motion, every_mask, every_camera)
    videos, cameras, masks = ([some[view - 1] for view in views] for some in (videos, every_camera, every_mask))
    silhouettes = PackedSilhouettes(masks, everything.frame_rate, [video.stem for video in videos])
    body = make_human(motion.height)
    if start == "reference":
        body = fit_body(body, {name: places[0] for name, places in reference.items()})
    first, second = (fit_pose(body, {name: p[t] for name, p in reference.items()})[0] for t in (0, 1))
    found = estimate(silhouettes, cameras, body, first if start == "reference" else None, n_threads=1)
    print(f"start: {start}; stature {body.stature:.2f} m; {found.frames_per_second:.1f} frames/s, one thread; "
          f"lost {int(found.lost.sum())}; {'; '.join(found.warnings)}")  # fmt: skip
    n_frames = found.n_frames
    score("estimate", found.body, found.poses, reference, cameras, found)
    score("frozen", body, frozen_first_pose(first, n_frames), reference, cameras)
    held = constant_velocity(first, second, n_frames, body.angle_limits)
    score("constant velocity", body, held, reference, cameras)
    print_overlap(found, masks, cameras, reference)
    if pictures is not None:
        draw_pictures(found, silhouettes, cameras, videos, pictures / f"pose2sim_{start}_{len(views)}")


def read_masks(folder: Path, cache: Path | None) -> PackedSilhouettes:
    """Silhouettes of all views by background subtraction, or those that are kept."""
    videos = sorted((folder / "videos").glob("*.mp4"))
    kept = None if cache is None else cache / "pose2sim.npz"
    if kept is not None and kept.exists():
        with np.load(kept) as file:
            masks, rate = [file[f"arr_{k}"] for k in range(len(videos))], float(file["rate"])
    else:
        plates = [folder / "background" / f"{video.stem}.png" for video in videos]
        with open_silhouettes(videos, plates) as opened:
            frames = [opened.read(frame) for frame in range(opened.n_frames)]
            rate, notes = opened.frame_rate, opened.warnings
        print("reading:", *notes, sep="\n  ")
        masks = [np.stack(view) for view in zip(*frames, strict=True)]  # type: ignore[arg-type]
        if kept is not None:
            kept.parent.mkdir(parents=True, exist_ok=True)
            np.savez_compressed(kept, *masks, rate=rate)
    return PackedSilhouettes(masks, rate, [video.stem for video in videos])


def align_reference(
    motion: CanonicalMotion, masks: Sequence[NDArray[np.bool_]], cameras: Sequence[Camera]
) -> Reference:
    """The reference at the moments of the video: its frame t + lag where its body covers the silhouettes best.

    Joints that the reference lacks are left out. The lag is found without any estimate.
    """
    own = [name for name in CANONICAL_JOINTS if name not in motion.mapping.derived]
    places = {name: motion.positions[:, CANONICAL_JOINTS.index(name)] for name in own}
    body = fit_body(make_human(motion.height), places)
    poses = fit_poses(body, np.stack(list(places.values()), axis=1), own)[0]
    some = np.arange(8, len(poses) - 8, 12)
    body = fit_girths(body, poses[some], [view[some] for view in masks], cameras)
    overlaps = []
    for lag in LAGS:
        drawn = [draw_body(body, poses[some + lag], camera) for camera in cameras]
        overlaps.append(np.mean([compute_iou(d, view[some]) for d, view in zip(drawn, masks, strict=True)]))
    print("overlap of the reference by lag:", *(f"{k}: {v:.4f}" for k, v in zip(LAGS, overlaps, strict=True)))
    lag = LAGS[int(np.argmax(overlaps))]
    frames = np.arange(len(masks[0])) + lag
    inside = (frames >= 0) & (frames < motion.n_frames)
    kept = {name: np.where(inside[:, None], p[np.clip(frames, 0, motion.n_frames - 1)], np.nan)
            for name, p in places.items()}  # fmt: skip
    begin = max(lag, 0)
    for name, p in kept.items():  # The first frames are the start: never unknown.
        p[:2] = places[name][begin : begin + 2] if lag < 0 else p[:2]
    print(f"lag {lag}: image t is compared with reference frame t {lag:+d}")
    return kept


def score(
    what: str,
    body: BodyModel,
    poses: FloatArray,
    reference: Reference,
    cameras: Sequence[Camera],
    found: Estimate | None = None,
) -> None:
    """Print the errors of poses."""
    names, places = point_names(body), compute_points(body, poses)
    truth = np.stack(list(reference.values()), axis=1)
    space = compare_with_truth(names, places, tuple(reference), truth, frame_rate=60.0)
    image = compare_in_images(names, places, tuple(reference), truth, cameras, body.stature)
    print(f"{what:18s} {space.mean_mm:4.0f} mm, hips in place {space.root_mm:4.0f}, rigid {space.rigid_mm:4.0f}, limbs "
          f"{space.segment_deg:4.1f} deg, elbows and knees {space.angle_deg:4.1f} deg, worst frame "
          f"{1e3 * np.nanmax(space.frame_errors):4.0f} mm, last {1e3 * space.frame_errors[-5:].mean():4.0f}, image "
          f"{image.mean_percent:4.1f} %")  # fmt: skip
    if found is not None:
        print("  by joint, mm:", ", ".join(f"{name} {value:.0f}" for name, value in space.joint_mm.items()))


def print_overlap(
    found: Estimate, masks: Sequence[NDArray[np.bool_]], cameras: Sequence[Camera], reference: Reference
) -> None:
    """Overlap of the estimate and of the reference, drawn with the same body, by view."""
    places = np.stack(list(reference.values()), axis=1)
    poses = fit_poses(found.body, places, tuple(reference))[0]
    for camera, view in zip(cameras, masks, strict=True):
        ours, theirs = (compute_iou(draw_body(found.body, p, camera), view) for p in (found.poses, poses))
        print(f"  {camera.name}: IoU {ours.mean():.3f} (least {ours.min():.3f}), of the reference {theirs.mean():.3f}")


def draw_pictures(
    found: Estimate,
    silhouettes: PackedSilhouettes,
    cameras: Sequence[Camera],
    videos: Sequence[Path],
    target: Path,
) -> None:
    """An overlay video and a contact sheet."""
    from dousa.app.pictures.overlay import write_overlay
    from dousa.app.pictures.overlay_sheet import draw_overlay_sheet

    target.parent.mkdir(parents=True, exist_ok=True)
    with _OverVideos(silhouettes, videos) as shown:
        write_overlay(found, shown, cameras, target.with_suffix(".mp4"))
        draw_overlay_sheet(found, shown, cameras, target.with_suffix(".png"), n_frames=6)


class _OverVideos(WrappedSilhouettes):
    """Silhouettes that were kept, with the pictures of their videos, which have the same rate."""

    def __init__(self, inner: PackedSilhouettes, videos: Sequence[Path]) -> None:
        super().__init__(inner)
        self._files = [VideoFile(video) for video in videos]

    def read(self, frame: int) -> tuple[Mask | None, ...]:
        return self._inner.read(frame)

    def look(self, frame: int) -> tuple[Image | None, ...]:
        images = [file.read(min(frame, file.n_frames - 1)) for file in self._files]
        return tuple(
            None if image is None else image[fit_frame(file.size, size, image)]
            for file, size, image in zip(self._files, self.sizes, images, strict=True)
        )
