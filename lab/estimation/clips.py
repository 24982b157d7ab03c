"""Sequences of silhouettes whose true joints are known: their views, what is tried on them, and how near it comes."""

from __future__ import annotations

import itertools
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dousa.arrays import FloatArray
from dousa.errors import OptionError, SilhouetteError
from dousa.experiments.runner import check_choice, check_some
from dousa.experiments.table import Result
from dousa.motion import rotations as rot
from lab.estimation.metrics import Accuracy, ImageAccuracy, compare_in_images, compare_with_truth

if TYPE_CHECKING:
    from dousa.estimation.body.body import BodyModel
    from dousa.estimation.cameras.camera import Camera
    from dousa.estimation.silhouettes.silhouettes import Silhouettes

VARIANTS: tuple[str, ...] = ("clean", "noisy")
"""Ends of file names, after an underscore."""


@dataclass(frozen=True, slots=True, eq=False)
class BenchClip:
    """A sequence of silhouettes with the truth.

    Parameters
    ----------
    name : file name without ending and variant.
    variant : ``"clean"``, ``"noisy"``, or ``""`` where the name does not say.
    silhouettes : (V views, T frames).
    cameras : (V,).
    stature : m.
    joints : (K,) names of the true joints.
    truth : (T, K, 3) m.
    """

    name: str
    variant: str
    silhouettes: Silhouettes
    cameras: tuple[Camera, ...]
    stature: float
    joints: tuple[str, ...]
    truth: FloatArray

    def joints_at(self, frame: int) -> Mapping[str, FloatArray]:
        """Name -> (3,) m of one frame."""
        return dict(zip(self.joints, self.truth[frame], strict=True))


def find_clips(paths: Sequence[str | os.PathLike[str]], variants: Sequence[str] = VARIANTS) -> tuple[Path, ...]:
    """Files of sequences below some paths.

    Parameters
    ----------
    paths : npz files, and folders of them.
    variants : those that are wanted; files whose names do not tell theirs always are.

    Returns
    -------
    Each file once, in the order of the paths, those of a folder in the order of their names.

    Raises
    ------
    OptionError : an unknown variant, a path that is not there, or no file at all.
    """
    check_some("variants", variants, VARIANTS)
    files: dict[Path, None] = {}
    for path in map(Path, paths):
        if not path.exists():
            raise OptionError("trials.no_file", path=path)
        for file in sorted(path.glob("*.npz")) if path.is_dir() else [path]:
            if _split_name(file)[1] in ("", *variants):
                files[file] = None
    if not files:
        raise OptionError("trials.no_sequences", variants=variants, paths=paths)
    return tuple(files)


def _split_name(path: Path) -> tuple[str, str]:
    head, _, tail = path.stem.rpartition("_")
    return (head, tail) if tail in VARIANTS else (path.stem, "")


def read_clip(path: str | os.PathLike[str]) -> BenchClip:
    """Read a sequence with its cameras, stature and true joints.

    Parameters
    ----------
    path : an npz file, see `dousa.estimation.silhouettes.mask_npz`.

    Raises
    ------
    SilhouetteError : damaged, or without true joints or stature, or joints of another length than the masks.
    CalibrationError : no cameras, or cameras that cannot be.
    """
    from dousa.estimation.cameras.camera_files import read_cameras
    from dousa.estimation.silhouettes.mask_npz import read_silhouettes, read_stature, read_true_joints

    silhouettes = read_silhouettes(path)
    truth, stature = read_true_joints(path), read_stature(path)
    if truth is None or stature is None:
        lacking = "joint_names and joint_positions" if truth is None else "stature"
        raise SilhouetteError("trials.no_truth", path=path, lacking=lacking)
    joints, positions = truth
    if len(positions) != silhouettes.n_frames:
        raise SilhouetteError("trials.truth_frames", path=path, expected=silhouettes.n_frames, found=len(positions))
    cameras = read_cameras(path)
    if len(cameras) != silhouettes.n_views:
        raise SilhouetteError("trials.truth_cameras", path=path, views=silhouettes.n_views, found=len(cameras))
    name, variant = _split_name(Path(path))
    return BenchClip(name, variant, silhouettes, cameras, stature, joints, positions)


def choose_views(cameras: Sequence[Camera], count: int) -> tuple[int, ...]:
    """Which views stand for fewer of them, by where the cameras look and nothing else.

    Parameters
    ----------
    cameras : (V,).
    count : 1 to V.

    Returns
    -------
    The first view; then each time the one whose optical axis is most nearly square to those taken already.

    Raises
    ------
    OptionError : more views than there are, or none.
    """
    if not 1 <= count <= len(cameras):
        raise OptionError("trials.views", most=len(cameras), found=count)
    axes = np.stack([camera.rotation[2] for camera in cameras])
    chosen = [0]
    while len(chosen) < count:
        along = np.abs(axes @ axes[chosen].T).max(axis=1)
        along[chosen] = np.inf
        chosen.append(int(np.argmin(along)))
    return tuple(sorted(chosen))


def list_view_choices(cameras: Sequence[Camera], count: int, choice: str) -> tuple[tuple[int, ...], ...]:
    """The one choice of `choose_views`, or all combinations (``"all"``)."""
    chosen = choose_views(cameras, count)
    return tuple(itertools.combinations(range(len(cameras)), count)) if choice == "all" else (chosen,)


def take_part(silhouettes: Silhouettes, views: Sequence[int], frames: tuple[int, int] | None = None) -> Silhouettes:
    """Some views and frames of silhouettes, in memory.

    Parameters
    ----------
    silhouettes : any.
    views : indices.
    frames : first, and the one after the last; all by default.
    """
    from dousa.estimation.silhouettes.silhouettes import PackedSilhouettes

    first, stop = frames or (0, silhouettes.n_frames)
    if not 0 <= first < stop <= silhouettes.n_frames:
        raise OptionError("trials.frames", count=silhouettes.n_frames, first=first, stop=stop)
    sizes = [silhouettes.sizes[view] for view in views]
    packed = [np.zeros((stop - first, height, (width + 7) // 8), np.uint8) for width, height in sizes]
    missing = np.zeros((len(sizes), stop - first), bool)
    for frame in range(first, stop):
        masks = silhouettes.read(frame)
        for k, view in enumerate(views):
            mask = masks[view]
            if mask is None:
                missing[k, frame - first] = True
            else:
                packed[k][frame - first] = np.packbits(mask, axis=1)
    names = [silhouettes.names[view] for view in views]
    return PackedSilhouettes.from_packed(packed, sizes, silhouettes.frame_rate, names, missing)


def first_frame_body(clip: BenchClip, source: str, frame: int = 0) -> BodyModel:
    """The body that an experiment tracks.

    Parameters
    ----------
    clip : the sequence.
    source : ``"stature"``: tables alone; ``"start"``: also the bones that the first frame's joints show.
    frame : which is the first.
    """
    from dousa.estimation.body.human import make_human

    check_choice("body", source, ("stature", "start"))
    body = make_human(clip.stature)
    if source == "stature":
        return body
    from dousa.estimation.body.skeleton_body import fit_body

    return fit_body(body, clip.joints_at(frame))


def frozen_first_pose(first: ArrayLike, n_frames: int) -> FloatArray:
    """The first pose held.

    Parameters
    ----------
    first : (7 + A,) pose, see `BodyModel`.
    n_frames : T, 1 or more.

    Returns
    -------
    (T, 7 + A).
    """
    pose = np.asarray(first, np.float64)
    if pose.ndim != 1 or n_frames < 1:
        raise OptionError("trials.one_pose", shape=pose.shape, frames=n_frames)
    return np.tile(pose, (n_frames, 1))


def constant_velocity(
    first: ArrayLike, second: ArrayLike, n_frames: int, limits: ArrayLike | None = None
) -> FloatArray:
    """What two poses predict: every joint goes on turning, and the root moving, as it did between them.

    Parameters
    ----------
    first, second : (7 + A,) poses of two frames in succession; the tracker is told the first alone.
    n_frames : T, 1 or more, counted from the first.
    limits : (A, 2) rad that angles stop at; none by default.

    Returns
    -------
    (T, 7 + A).
    """
    one, other = np.asarray(first, np.float64), np.asarray(second, np.float64)
    if one.ndim != 1 or one.shape != other.shape or n_frames < 1:
        raise OptionError("trials.two_poses", one=one.shape, other=other.shape, frames=n_frames)
    steps = np.arange(n_frames)[:, None]
    poses = one + steps * (other - one)
    turn = rot.to_axis_angle(rot.multiply(rot.conjugate(one[3:7]), other[3:7]))
    poses[:, 3:7] = rot.multiply(one[3:7], rot.from_axis_angle(steps * turn))
    if limits is not None:
        low, high = np.asarray(limits, np.float64).T
        poses[:, 7:] = np.clip(poses[:, 7:], low, high)
    return poses


# How near poses come


@dataclass(frozen=True, slots=True, eq=False)
class Score(Result):
    """How near one method came.

    Parameters
    ----------
    accuracy : in space.
    image : in the views that were looked at.
    """

    accuracy: Accuracy
    image: ImageAccuracy

    def to_json(self) -> dict[str, Any]:
        """The numbers that sum it up."""
        return {**self.accuracy.to_json(), **self.image.to_json()}


def fit_first_poses(body: BodyModel, clip: BenchClip, frame: int = 0) -> tuple[FloatArray, FloatArray]:
    """The poses of a body that come nearest to the true joints of a frame and of the next."""
    from dousa.estimation.body.posing import fit_pose

    first, _ = fit_pose(body, clip.joints_at(frame))
    if frame + 1 >= len(clip.truth):
        return first, first
    second, _ = fit_pose(body, clip.joints_at(frame + 1), first)
    return first, second


def score_poses(
    clip: BenchClip,
    views: Sequence[int],
    body: BodyModel,
    poses: FloatArray,
    hidden: NDArray[np.bool_] | None = None,
) -> Score:
    """Compare poses of a body with the truth of a clip, in space and in some of its views."""
    from dousa.estimation.body.kinematics import compute_points, point_names

    names, points = point_names(body), compute_points(body, poses)
    rate = clip.silhouettes.frame_rate
    accuracy = compare_with_truth(names, points, clip.joints, clip.truth, frame_rate=rate, occluded=hidden)
    cameras = [clip.cameras[view] for view in views]
    image = compare_in_images(names, points, clip.joints, clip.truth, cameras, clip.stature)
    return Score(accuracy, image)


def mark_points(body: BodyModel, parts: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Flags of parts (T, P) as flags of joints and tips (T, P + K): a joint lies where the part above it ends."""
    above = np.maximum(body.parents, 0)
    return np.asarray(parts, bool)[:, np.concatenate((above, body.tip_parts))]


def score_baselines(
    clip: BenchClip, views: Sequence[int], body: BodyModel, first: FloatArray, second: FloatArray
) -> dict[str, Score]:
    """The first pose held (``"frozen"``), and what it and the second one predict (``"constant_velocity"``)."""
    n_frames = len(clip.truth)
    poses = {
        "frozen": frozen_first_pose(first, n_frames),
        "constant_velocity": constant_velocity(first, second, n_frames, body.angle_limits),
    }
    return {name: score_poses(clip, views, body, rows) for name, rows in poses.items()}
