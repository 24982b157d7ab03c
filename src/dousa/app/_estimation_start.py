"""``--start FILE:FRAME``: the pose that tracking begins with, out of any motion file."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dousa.errors import JointMappingError, MotionFileError, OptionError, SilhouetteError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from dousa.estimation import BodyModel, Camera
    from dousa.estimation.silhouettes import Mask
    from dousa.library import ReadOptions

__all__ = ["StartPose", "check_start", "parse_start", "read_start"]

_FAR_OFF = 0.2  # overlap below which a given start is doubted: 30 degrees off in every joint still have more
_LEAST_JOINTS = 8  # of the file's own, so that the made ones may be left out


@dataclass(frozen=True, slots=True, eq=False)
class StartPose:
    """Where the joints of a person are in one frame.

    Parameters
    ----------
    file, frame : where that is said.
    positions : canonical joint -> (3,) m in the world of the cameras.
    warnings : what a person should know.
    """

    file: Path
    frame: int
    positions: dict[str, NDArray[np.float64]]
    warnings: tuple[str, ...] = ()


def parse_start(text: str) -> tuple[Path, int]:
    """``FILE:FRAME`` or ``FILE``, which means its frame 0; a file of exactly this name comes first.

    Raises
    ------
    OptionError : no such file, or nothing where the frame should be.
    """
    if os.path.isfile(text):
        return Path(text), 0
    found = re.fullmatch(r"(.+):(\d{1,9})", text, re.DOTALL)
    if found is not None and (os.path.isfile(found[1]) or len(found[1]) > 1):
        path, frame = Path(found[1]), int(found[2])
    else:
        path, frame = Path(text), 0
    if path.is_dir():
        raise OptionError(f"--start {text}: {path} is a folder; give the file of one motion")
    if not path.is_file():
        tail = re.fullmatch(r"(.+):([^:\\/]*)", text, re.DOTALL)
        if tail is not None and os.path.isfile(tail[1]):
            raise OptionError(
                f"--start {text}: expected the number of a frame after the colon, got '{tail[2]}'; frames count from 0"
            )
        raise OptionError(f"--start {text}: there is no file {path}; give FILE:FRAME, such as walk.bvh:0")
    return path, frame


def read_start(text: str, options: ReadOptions) -> StartPose:
    """The joints of ``--start``.

    Parameters
    ----------
    text : ``FILE:FRAME``; a motion file, or silhouettes with their true joints.
    options : how the file is read.

    Raises
    ------
    DousaError : no such file or frame, a file whose joints cannot be told.
    """
    path, frame = parse_start(text)
    true_joints = _read_true_joints(path)
    if true_joints is not None:
        names, places = true_joints
        _check_frame(text, frame, len(places))
        return StartPose(path, frame, dict(zip(names, places[frame], strict=True)))
    return _read_motion(text, path, frame, options)


def _read_true_joints(path: Path) -> tuple[tuple[str, ...], NDArray[np.float64]] | None:
    """What an npz of silhouettes says about the true joints; None for every other file."""
    if path.suffix.lower() != ".npz":
        return None
    from dousa.estimation.mask_npz import read_true_joints

    try:
        return read_true_joints(path)
    except SilhouetteError:
        return None  # the reader of motion files says what is wrong


def _check_frame(text: str, frame: int, n_frames: int) -> None:
    if frame >= n_frames:
        raise OptionError(
            f"--start {text}: the file has the frames 0 to {n_frames - 1}, there is no frame {frame}"
        )


def _read_motion(text: str, path: Path, frame: int, options: ReadOptions) -> StartPose:
    from dousa.library.ingest import read_canonical
    from dousa.motion import CANONICAL_JOINTS

    try:
        motion, _ = read_canonical(os.fspath(path), options)
    except (MotionFileError, JointMappingError) as error:
        raise OptionError(f"--start {text}: {error}") from error
    _check_frame(text, frame, motion.n_frames)
    unseen = (
        set()
        if motion.missing is None
        else {CANONICAL_JOINTS[joint] for joint in np.flatnonzero(motion.missing[frame])}
    )
    made = set(motion.mapping.derived)
    known = {
        name: place
        for name, place in zip(CANONICAL_JOINTS, motion.positions[frame], strict=True)
        if name not in unseen
    }
    # Joints that the file lacks are guesses by tables; the body model has its own.
    own = {name: place for name, place in known.items() if name not in made}
    if len(own) >= _LEAST_JOINTS:
        known = own
    if len(known) < _LEAST_JOINTS:
        raise OptionError(
            f"--start {text}: only {len(known)} joints are seen in frame {frame}; choose a frame where all are"
        )
    return StartPose(path, frame, known, tuple(f"{path}: {words}" for words in motion.warnings))


def check_start(
    body: BodyModel,
    pose: NDArray[np.float64],
    cameras: Sequence[Camera],
    masks: Sequence[Mask | None],
    text: str,
) -> str | None:
    """Whether a given start can be that of the silhouettes.

    Parameters
    ----------
    body, pose : the start; (7 + A,).
    cameras, masks : of the first frame.
    text : ``--start`` as it was given.

    Returns
    -------
    A sentence if it covers them badly.

    Raises
    ------
    OptionError : it does not touch the silhouette of any view.
    """
    from dousa.estimation.rasteriser import draw_body

    overlaps, outside = {}, []
    for camera, mask in zip(cameras, masks, strict=True):
        if mask is None or not mask.any():
            continue
        drawn = draw_body(body, pose[None], camera)[0]
        if not drawn.any():
            outside.append(camera.name)
        overlaps[camera.name] = float((drawn & mask).sum() / (drawn | mask).sum())
    if not overlaps:
        return None
    place = ", ".join(f"{number:.2f}" for number in pose[:3])
    if max(overlaps.values()) == 0.0:
        where = (
            "outside the image of every view" if len(outside) == len(overlaps) else "beside every silhouette"
        )
        raise OptionError(
            f"--start {text}: the body stands at ({place}) m, {where}; is the file in the world of the cameras "
            "(metres, Y up)? Leave --start out to have the start found"
        )
    mean = sum(overlaps.values()) / len(overlaps)
    if mean >= _FAR_OFF:
        return None
    views = ", ".join(f"{name} {value:.2f}" for name, value in overlaps.items())
    return (
        f"--start {text}: the body at ({place}) m hardly covers the first silhouettes (overlap {views}); is the file "
        "in the world of the cameras, and this its first frame?"
    )
