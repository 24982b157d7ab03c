"""Silhouettes of the Kinect (UTD-MHAD), one view: tracked, compared with its skeletons, and retrieved.

The images are mirrored: left and right are exchanged before anything else, and the camera is that of the exchanged
images. They lag the skeletons by two frames. Tracked with one thread.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray
from dousa.estimation import (
    BodyModel,
    Camera,
    PackedSilhouettes,
    estimate,
    fit_body,
    fit_pose,
    fit_poses,
    make_human,
)
from dousa.estimation.body.kinematics import compute_points, point_names
from dousa.estimation.raster.rasteriser import draw_body
from dousa.experiments.recognition import run_experiment
from dousa.formats.registry import read_motion
from dousa.motion import CANONICAL_JOINTS, Trajectories, canonicalise
from dousa.retrieval import LabelledClip
from lab.estimation.clips import constant_velocity, frozen_first_pose
from lab.estimation.metrics import compare_in_images, compare_with_truth, compute_iou

LAG = 2  # frames: image i belongs to skeleton frame i - LAG
RATE = 30.0
CAMERA = Camera(
    "kinect",
    320,
    240,
    np.array([[285.63, 0.0, 159.0], [0.0, 285.63, 120.0], [0.0, 0.0, 1.0]]),
    np.diag([-1.0, -1.0, 1.0]),
    np.zeros(3),
)
HANDS = ("left_wrist", "right_wrist", "left_hand", "right_hand")
FEET = ("left_ankle", "right_ankle", "left_toe", "right_toe")
METHODS = ("estimate", "frozen", "constant velocity")


@dataclass(frozen=True)
class Clip:
    """One recording: files, what is done in it and by whom."""

    masks: Path
    skeleton: Path
    action: str
    subject: str
    trial: str

    @property
    def name(self) -> str:
        """As the files are called."""
        return self.masks.stem

    def read(self) -> tuple[PackedSilhouettes, FloatArray, float]:
        """Silhouettes, the Kinect's joints (T, 20, 3) m of the same moments, and the person's height."""
        with np.load(self.masks) as file:
            width = int(file["width"])
            masks = np.unpackbits(file["mask_packed"], axis=2, count=width).astype(bool)
        motion = canonicalise(read_motion(self.skeleton))
        n_frames = min(len(masks) - LAG, motion.n_frames)
        masks = masks[LAG : LAG + n_frames, :, ::-1]
        return PackedSilhouettes([masks], RATE), motion.positions[:n_frames], motion.height


@dataclass(frozen=True)
class Track:
    """What was estimated of a clip, and what it is compared with.

    Points are (T, 20, 3) m in the order of `CANONICAL_JOINTS`, by method.
    """

    points: dict[str, FloatArray]
    iou: FloatArray
    kinect_iou: FloatArray
    lost: NDArray[np.bool_]
    speed: float
    stature: float


@dataclass(frozen=True)
class Row:
    """Errors of a clip by method: in the image in percent of the stature (all joints, hands, feet), and in space in mm
    (raw, with the hips in place, along the camera's axis, across it)."""

    clip: Clip
    image: dict[str, float]
    hands: dict[str, float]
    feet: dict[str, float]
    space: dict[str, float]
    root: dict[str, float]
    depth: dict[str, float]
    across: dict[str, float]
    track: Track


def list_clips(folder: Path, subjects: Sequence[str], trials: Sequence[str], actions: str | None = None) -> list[Clip]:
    """The recordings of which there are silhouettes."""
    clips = []
    for masks in sorted((folder / "silhouette").glob("*/*.npz")):
        found = re.fullmatch(r"a\d+_s(\d+)_t(\d+)", masks.stem)
        action = masks.parent.name
        if found is None or found[1] not in subjects or found[2] not in trials:
            continue
        if actions is None or action in actions.split(","):
            skeleton = folder / "skeleton" / action / f"{masks.stem}.c3d"
            clips.append(Clip(masks, skeleton, action, found[1], found[2]))
    return clips


def track_clip(clip: Clip, start: str, cache: Path | None) -> Track:
    """Track one clip, or take what is kept of it."""
    kept = None if cache is None else cache / f"{start}_{clip.name}.npz"
    if kept is not None and kept.exists():
        with np.load(kept) as file:
            points = {method: file[method] for method in METHODS}
            return Track(
                points,
                file["iou"],
                file["kinect_iou"],
                file["lost"],
                float(file["speed"]),
                float(file["stature"]),
            )
    track = make_track(clip, start)
    if kept is not None:
        kept.parent.mkdir(parents=True, exist_ok=True)
        np.savez(
            kept,
            iou=track.iou,
            kinect_iou=track.kinect_iou,
            lost=track.lost,
            speed=track.speed,
            stature=track.stature,
            **track.points,
        )
    return track


def make_track(clip: Clip, start: str) -> Track:
    """``kinect``: bones and first pose from the first skeleton; ``auto``: the stature alone is told."""
    silhouettes, truth, height = clip.read()
    body = fit_body(make_human(height), truth[0])
    if start == "auto":
        body = make_human(body.stature)
    first, second = (fit_pose(body, truth[frame])[0] for frame in (0, 1))
    n_frames = len(truth)
    found = estimate(silhouettes, [CAMERA], body, first if start == "kinect" else None, n_threads=1)
    points = {
        "estimate": order_points(found.body, found.poses),
        "frozen": order_points(body, frozen_first_pose(first, n_frames)),
        "constant velocity": order_points(body, constant_velocity(first, second, n_frames, body.angle_limits)),
    }
    masks = np.stack([silhouettes.read(frame)[0] for frame in range(n_frames)])
    of_kinect = draw_body(found.body, fit_poses(found.body, truth)[0], CAMERA)
    return Track(
        points,
        compute_iou(draw_body(found.body, found.poses, CAMERA), masks),
        compute_iou(of_kinect, masks),
        found.lost,
        found.frames_per_second,
        body.stature,
    )


def order_points(body: BodyModel, poses: FloatArray) -> FloatArray:
    """(T, 20, 3) in the order of `CANONICAL_JOINTS`."""
    names = point_names(body)
    return compute_points(body, poses)[:, [names.index(name) for name in CANONICAL_JOINTS]]


def score_clip(clip: Clip, start: str, cache: Path | None) -> Row:
    """Track and compare."""
    track = track_clip(clip, start, cache)
    truth = clip.read()[1]
    row = Row(clip, {}, {}, {}, {}, {}, {}, {}, track)
    some = [[CANONICAL_JOINTS.index(name) for name in group] for group in (HANDS, FEET)]
    for method, points in track.points.items():
        image = compare_in_images(CANONICAL_JOINTS, points, CANONICAL_JOINTS, truth, [CAMERA], track.stature)
        space = compare_with_truth(CANONICAL_JOINTS, points, CANONICAL_JOINTS, truth, frame_rate=RATE)
        off = points - truth
        row.image[method] = image.mean_percent
        row.hands[method], row.feet[method] = (100 * float(np.nanmean(image.shares[0][:, k])) for k in some)
        row.space[method], row.root[method] = space.mean_mm, space.root_mm
        row.depth[method] = 1e3 * float(np.nanmean(np.abs(off[..., 2])))
        row.across[method] = 1e3 * float(np.nanmean(np.linalg.norm(off[..., :2], axis=-1)))
    return row


def measure_kinect(clips: Sequence[Clip], start: str, cache: Path | None, show_rows: bool) -> None:
    """Print the tables: all clips, and action by action."""
    rows = []
    for clip in clips:
        row = score_clip(clip, start, cache)
        rows.append(row)
        if show_rows:
            print(f"{clip.name} {clip.action:24s} {_cells(row)}", flush=True)
    print(f"{len(rows)} clips, {sum(len(row.track.iou) for row in rows)} frames, start: {start}")
    _print_means(rows)
    _print_actions(rows)


def _print_means(rows: Sequence[Row]) -> None:
    print(f"{'':18s}  image: all, hands, feet, % of stature   space: raw, hips in place, depth, across, mm")
    for method in METHODS:
        cells = (_mean(rows, name, method) for name in ("image", "hands", "feet"))
        more = (_mean(rows, name, method) for name in ("space", "root", "depth", "across"))
        print(f"{method:18s}", *(f"{cell:7.1f}" for cell in cells), "   ", *(f"{cell:6.0f}" for cell in more))
    better = sum(row.image["estimate"] < row.image["frozen"] for row in rows)
    hands = sum(row.hands["estimate"] < row.hands["frozen"] for row in rows)
    print(f"nearer in the image than the frozen pose: {better} of {len(rows)} clips; of hands {hands}")
    print(
        f"IoU {_over(rows, 'iou'):.3f}, of the Kinect's own poses drawn with the same body "
        f"{_over(rows, 'kinect_iou'):.3f}; lost frames {100 * _over(rows, 'lost'):.1f} %; "
        f"median {np.median([row.track.speed for row in rows]):.0f} frames/s, one thread"
    )
    offsets = [
        (CAMERA.project(row.track.points["estimate"]) - CAMERA.project(row.clip.read()[1])).mean(axis=(0, 1))
        for row in rows
    ]
    across, down = np.mean(offsets, axis=0)
    print(f"the estimate lies {across:+.1f} px to the right of the Kinect's joints, {down:+.1f} px below")
    for subject in sorted({row.clip.subject for row in rows}):
        own = [row for row in rows if row.clip.subject == subject]
        print(
            f"subject {subject}: {len(own)} clips, image {_mean(own, 'image', 'estimate'):.1f}, "
            f"frozen {_mean(own, 'image', 'frozen'):.1f} %"
        )


def _print_actions(rows: Sequence[Row]) -> None:
    """Best gain first."""
    print("action                    n  image %: est., frozen, const.  hands %: est., frozen  mm: est., frozen  IoU")
    actions = {
        action: [row for row in rows if row.clip.action == action] for action in {row.clip.action for row in rows}
    }
    for action, own in sorted(actions.items(), key=lambda pair: _gain(pair[1])):
        mean = np.mean([row.track.iou.mean() for row in own])
        print(
            f"{action:24s} {len(own):2d}",
            *(f"{_mean(own, 'image', method):7.1f}" for method in METHODS),
            "   ",
            *(f"{_mean(own, 'hands', method):6.1f}" for method in METHODS[:2]),
            "   ",
            *(f"{_mean(own, 'space', method):6.0f}" for method in METHODS[:2]),
            f"   {mean:.2f}",
        )


def _gain(rows: Sequence[Row]) -> float:
    return _mean(rows, "image", "estimate") / _mean(rows, "image", "frozen")


def _mean(rows: Sequence[Row], name: str, method: str) -> float:
    """Mean over clips, each counting the same."""
    return float(np.mean([getattr(row, name)[method] for row in rows]))


def _over(rows: Sequence[Row], name: str) -> float:
    return float(np.nanmean(np.concatenate([getattr(row.track, name) for row in rows])))


def _cells(row: Row) -> str:
    return (
        f"image {row.image['estimate']:5.1f} frozen {row.image['frozen']:5.1f}  hands {row.hands['estimate']:5.1f} "
        f"frozen {row.hands['frozen']:5.1f}  space {row.space['estimate']:4.0f} depth {row.depth['estimate']:4.0f}  "
        f"IoU {np.nanmean(row.track.iou):.2f} Kinect {np.nanmean(row.track.kinect_iou):.2f} "
        f"lost {row.track.lost.mean():.2f}"
    )


def measure_retrieval(folder: Path, clips: Sequence[Clip], start: str, cache: Path | None) -> None:
    """Print how well actions are told from motions that were estimated, subject by subject.

    ``Kinect`` trains on all skeletons of the other subjects, ``same clips`` on those that have an estimate too.
    ``flat``: skeletons and estimates with all joints at the depth of the pelvis. ``frozen``: the first pose held.
    """
    skeletons = [_label(clip, canonicalise(read_motion(clip.skeleton)).positions) for clip in _list_skeletons(folder)]
    tracks = [track_clip(clip, start, cache) for clip in clips]
    tested = {
        "Kinect": [_label(clip, clip.read()[1]) for clip in clips],
        "estimated": [_label(clip, track.points["estimate"]) for clip, track in zip(clips, tracks, strict=True)],
        "frozen": [_label(clip, track.points["frozen"]) for clip, track in zip(clips, tracks, strict=True)],
    }
    tested["flat"] = [_flattened(clip) for clip in tested["estimated"]]
    sources = {
        "Kinect": skeletons,
        "estimated": tested["estimated"],
        "flat": [_flattened(clip) for clip in skeletons],
    }
    subjects = sorted({clip.subject for clip in clips})
    print(f"{len(clips)} clips, start: {start}; chance {1 / len({clip.action for clip in clips}):.3f}")
    print(f"trained on, tested on, features, system: accuracy of subject {', '.join(subjects)}, and the mean")
    pairs = [("Kinect", "Kinect"), ("Kinect", "estimated"), ("Kinect", "frozen"), ("flat", "flat")]
    if len(subjects) > 1:
        sources["same clips"] = tested["Kinect"]
        pairs += [("same clips", "Kinect"), ("estimated", "estimated")]
    for features in ("paper", "extended"):
        for training, what in pairs:
            _print_accuracy(training, what, sources[training], tested[what], subjects, features)


def _print_accuracy(
    training: str,
    what: str,
    source: Sequence[LabelledClip],
    tested: Sequence[LabelledClip],
    subjects: Sequence[str],
    features: str,
) -> None:
    systems = ("forest", "motion_templates") if features == "paper" else ("forest",)
    scores = []
    for subject in subjects:
        result = run_experiment(
            [clip for clip in source if clip.performer != subject],
            test_clips=[clip for clip in tested if clip.performer == subject],
            systems=systems,
            repeats=5,
            feature_set=features,
            n_jobs=1,
        )
        scores.append([result.systems[system].scores.accuracy for system in systems])
    for column, system in zip(np.array(scores).T, systems, strict=True):
        cells = " ".join(f"{value:.2f}" for value in column)
        print(f"{training:10s} {what:10s} {features:9s} {system:17s} {cells}   {column.mean():.3f}", flush=True)


def _list_skeletons(folder: Path) -> list[Clip]:
    clips = []
    for path in sorted((folder / "skeleton").glob("*/*.c3d")):
        _, subject, trial = path.stem.split("_")
        clips.append(Clip(path, path, path.parent.name, subject[1:], trial[1:]))
    return clips


def _label(clip: Clip, points: FloatArray) -> LabelledClip:
    motion = canonicalise(Trajectories(CANONICAL_JOINTS, points, RATE))
    return LabelledClip(clip.name, clip.action, clip.subject, motion.positions, RATE, motion.height)


def _flattened(clip: LabelledClip) -> LabelledClip:
    """All joints at the depth of the pelvis: what one view can tell."""
    flat = clip.positions.copy()
    flat[..., 2] = clip.positions[:, :1, 2]
    return replace(clip, positions=flat)
