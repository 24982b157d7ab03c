"""Sequences of silhouettes whose true joints are known, and which of their views an experiment looks at."""

from __future__ import annotations

import itertools
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dousa.errors import OptionError, SilhouetteError

if TYPE_CHECKING:
    from dousa.estimation.body import BodyModel
    from dousa.estimation.camera import Camera
    from dousa.estimation.silhouettes import Silhouettes

__all__ = [
    "VARIANTS",
    "BenchClip",
    "choose_views",
    "find_clips",
    "first_frame_body",
    "list_view_choices",
    "read_clip",
    "take_part",
]

FloatArray = NDArray[np.float64]

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


def find_clips(
    paths: Sequence[str | os.PathLike[str]], variants: Sequence[str] = VARIANTS
) -> tuple[Path, ...]:
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
    if unknown := sorted(set(variants) - set(VARIANTS)):
        raise OptionError(f"variants: expected {' or '.join(VARIANTS)}, got {', '.join(unknown)}")
    files: dict[Path, None] = {}
    for path in map(Path, paths):
        if not path.exists():
            raise OptionError(f"{path}: no such file or folder; check the name")
        for file in sorted(path.glob("*.npz")) if path.is_dir() else [path]:
            if _split_name(file)[1] in ("", *variants):
                files[file] = None
    if not files:
        raise OptionError(
            f"found no sequences (.npz) of {' or '.join(variants)} in {', '.join(map(str, paths))}"
        )
    return tuple(files)


def _split_name(path: Path) -> tuple[str, str]:
    head, _, tail = path.stem.rpartition("_")
    return (head, tail) if tail in VARIANTS else (path.stem, "")


def read_clip(path: str | os.PathLike[str]) -> BenchClip:
    """Read a sequence with its cameras, stature and true joints.

    Parameters
    ----------
    path : an npz file, see `dousa.estimation.mask_npz`.

    Raises
    ------
    SilhouetteError : damaged, or without true joints or stature, or joints of another length than the masks.
    CalibrationError : no cameras, or cameras that cannot be.
    """
    from dousa.estimation.camera_files import read_cameras
    from dousa.estimation.mask_npz import read_silhouettes, read_stature, read_true_joints

    silhouettes = read_silhouettes(path)
    truth, stature = read_true_joints(path), read_stature(path)
    if truth is None or stature is None:
        lacking = "joint_names and joint_positions" if truth is None else "stature"
        raise SilhouetteError(
            f"{os.fspath(path)}: an experiment needs the truth: {lacking} are not in the file"
        )
    joints, positions = truth
    if len(positions) != silhouettes.n_frames:
        raise SilhouetteError(
            f"{os.fspath(path)}: expected true joints of {silhouettes.n_frames} frames, got {len(positions)}"
        )
    cameras = read_cameras(path)
    if len(cameras) != silhouettes.n_views:
        raise SilhouetteError(
            f"{os.fspath(path)}: expected a camera for each of {silhouettes.n_views} views, got {len(cameras)}"
        )
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
        raise OptionError(f"views: expected 1 to {len(cameras)}, got {count}")
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


def take_part(
    silhouettes: Silhouettes, views: Sequence[int], frames: tuple[int, int] | None = None
) -> Silhouettes:
    """Some views and frames of silhouettes, in memory.

    Parameters
    ----------
    silhouettes : any.
    views : indices.
    frames : first, and the one after the last; all by default.
    """
    from dousa.estimation.silhouettes import PackedSilhouettes

    first, stop = frames or (0, silhouettes.n_frames)
    if not 0 <= first < stop <= silhouettes.n_frames:
        raise OptionError(f"frames: expected some of 0 to {silhouettes.n_frames}, got {first} to {stop}")
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
    from dousa.estimation.human import make_human

    body = make_human(clip.stature)
    if source == "stature":
        return body
    if source != "start":
        raise OptionError(f"body: expected stature or start, got '{source}'")
    from dousa.estimation._body_from_skeleton import fit_body

    return fit_body(body, clip.joints_at(frame))
