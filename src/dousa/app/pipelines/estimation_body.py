"""The body that is tracked or drawn, from a body file, a stature or a start pose."""

from __future__ import annotations

import os
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import NDArray

from dousa.app.requests.estimation import parse_start
from dousa.errors import BodyModelError, JointMappingError, MotionFileError, OptionError, SilhouetteError
from dousa.messages import Message

if TYPE_CHECKING:
    from collections.abc import Sequence

    from dousa.app.output import ProgressCallback
    from dousa.app.requests.estimation import EstimationRequest
    from dousa.arrays import Mask
    from dousa.estimation import BodyModel, Camera
    from dousa.formats.motion_files import ReadOptions


GivenBody: TypeAlias = "tuple[BodyModel, Message, tuple[Message, ...]]"
"""A body, what it was made from, and what a person should know."""


def choose_body(
    request: EstimationRequest, start: StartPose | None, known_stature: float | None, agrees: float = 0.07
) -> GivenBody:
    """Choose the body to be tracked: of ``--body`` or the tables, with the limbs of the start if ``bones`` says so.

    Parameters
    ----------
    request : its ``body``, ``stature``, ``sex`` and ``bones`` count.
    start : the joints of the start.
    known_stature : m, what the silhouettes' file says.
    agrees : share of the stature; a start further off is of another person, or of a skeleton with other joints.

    Returns
    -------
    The body, what it was made from in words, and what a person should know.

    Raises
    ------
    OptionError : bones of a start that is not given.
    DousaError : see `load_body`.
    """
    from dousa.estimation.body.skeleton_body import fit_body

    if request.bones == "start" and start is None:
        raise OptionError("estimate.bones_without_start")
    body, words, notes = load_body(
        request.body, request.stature, request.sex, known_stature=known_stature, options=request.options
    )
    if start is None or request.bones == "tables" or (request.bones == "auto" and request.body is not None):
        return body, words, notes
    try:
        fitted = fit_body(body, start.positions)
    except BodyModelError:
        if request.bones == "start":
            raise
        return body, Message("body.tables_start_unusable", body=words), notes
    if request.body is None and request.stature is None and known_stature is None:
        return fitted, Message("body.of_start", stature=fitted.stature), ()
    if request.bones == "auto" and abs(fitted.stature / body.stature - 1.0) > agrees:
        return body, Message("body.tables_start_differs", body=words, stature=fitted.stature), notes
    return fitted, Message("body.with_start", body=words), notes


def measure_body(
    sex: str, cameras: Sequence[Camera], masks: Sequence[Mask | None], progress: ProgressCallback
) -> GivenBody:
    """Measure the body whose stature is not given: several views of the first frame show it, one does not.

    Returns
    -------
    As `choose_body`.
    """
    from dousa.estimation.body.human import make_human
    from dousa.estimation.tracking.person_size import measure_stature

    try:
        stature = measure_stature(cameras, masks, make_body=lambda tried: make_human(tried, sex), progress=progress)
    except SilhouetteError:  # no silhouette in the first frame
        return _assume_body(sex)
    if stature is None:
        return _assume_body(sex)
    return make_human(stature, sex), Message("body.measured", stature=stature), ()


def _assume_body(sex: str) -> GivenBody:
    from dousa.estimation.body.human import USUAL_STATURE, make_human

    notes = (Message("body.stature_assumed", stature=USUAL_STATURE),)
    return make_human(sex=sex), Message("body.assumed", stature=USUAL_STATURE), notes


def load_body(
    file: Path | None, stature: float | None, sex: str, *, known_stature: float | None, options: ReadOptions
) -> GivenBody:
    """Load the body of a file, or make one of a stature.

    Parameters
    ----------
    file : a body file (TOML), or a motion file with the person's bones.
    stature : m.
    sex : for the proportions, where there is no file.
    known_stature : m, what the silhouettes' file says; used when neither is given.
    options : how a motion file is read.

    Returns
    -------
    The body, what it was made from in words, and what a person should know.

    Raises
    ------
    OptionError : both a file and a stature.
    DousaError : a file that is no body, a stature no person has.
    """
    if file is not None and stature is not None:
        raise OptionError("estimate.body_and_stature")
    if file is not None:
        body, notes = load_given_body(file, options)
        return body, Message("text.verbatim", text=file), notes
    from dousa.estimation.body.human import make_human

    chosen = stature if stature is not None else known_stature
    if chosen is not None:
        code = "body.stature_given" if stature is not None else "body.stature_of_file"
        return make_human(chosen, sex), Message(code, stature=chosen), ()
    return _assume_body(sex)


def load_given_body(file: Path, options: ReadOptions) -> tuple[BodyModel, tuple[Message, ...]]:
    """The body of a TOML file, or with the bones of a motion file.

    Raises
    ------
    DousaError : the file is no body.
    """
    from dousa.formats.motion_files import read_with
    from dousa.formats.registry import find_reader

    if find_reader(file) is None:
        from dousa.estimation.body.body_file import read_body

        return read_body(file), ()
    from dousa.estimation.body.skeleton_body import body_from_motion

    body = body_from_motion(read_with(file, options))
    return body, (Message("body.of_motion", path=file, stature=body.stature),)


@dataclass(frozen=True, slots=True, eq=False)
class StartPose:
    """Where the joints of a person are in one frame.

    Parameters
    ----------
    file, frame : its source.
    positions : canonical joint -> (3,) m in the world of the cameras.
    warnings : what a person should know.
    """

    file: Path
    frame: int
    positions: dict[str, NDArray[np.float64]]
    warnings: tuple[Message, ...] = ()


def read_start(text: str, options: ReadOptions) -> StartPose:
    """Read the joints of ``--start``.

    Parameters
    ----------
    text : ``FILE:FRAME``; a motion file, or silhouettes with their true joints.
    options : how the file is read.

    Raises
    ------
    DousaError : no such file or frame, a file whose joints cannot be identified.
    """
    path, frame = parse_start(text)
    if path.suffix.lower() == ".npz":
        from dousa.estimation.silhouettes.mask_npz import read_true_joints

        with suppress(SilhouetteError):  # the reader of motion files describes the problem
            true_joints = read_true_joints(path)
            if true_joints is not None:
                names, places = true_joints
                _check_frame(text, frame, len(places))
                return StartPose(path, frame, dict(zip(names, places[frame], strict=True)))
    return _read_motion(text, path, frame, options)


def _check_frame(text: str, frame: int, n_frames: int) -> None:
    if frame >= n_frames:
        raise OptionError("start.no_such_frame", text=text, last=n_frames - 1, frame=frame)


def _read_motion(text: str, path: Path, frame: int, options: ReadOptions, least: int = 8) -> StartPose:
    """The joints of a frame; those that the file lacks are left out where it has at least so many of its own."""
    from dousa.formats.motion_files import read_canonical
    from dousa.motion import CANONICAL_JOINTS

    try:
        motion, _ = read_canonical(os.fspath(path), options)
    except (MotionFileError, JointMappingError) as error:
        raise OptionError("start.unusable", text=text, problem=error.located) from error
    _check_frame(text, frame, motion.n_frames)
    hidden = () if motion.missing is None else np.flatnonzero(motion.missing[frame])
    places = dict(zip(CANONICAL_JOINTS, motion.positions[frame], strict=True))
    known = {name: place for joint, (name, place) in enumerate(places.items()) if joint not in hidden}
    # Joints that the file lacks are guesses by tables; the body model has its own.
    measured = {name: place for name, place in known.items() if name not in motion.mapping.derived}
    if len(measured) >= least:
        known = measured
    if len(known) < least:
        raise OptionError("start.too_few_joints", text=text, n=len(known), frame=frame)
    notes = tuple(Message("start.note", path=path, note=warning) for warning in motion.warnings)
    return StartPose(path, frame, known, notes)


def check_start(
    body: BodyModel,
    pose: NDArray[np.float64],
    cameras: Sequence[Camera],
    masks: Sequence[Mask | None],
    text: str,
    least: float = 0.2,
) -> Message | None:
    """Check that a given start fits the silhouettes.

    Parameters
    ----------
    body, pose : the start; (7 + A,).
    cameras, masks : of the first frame.
    text : ``--start`` as it was given.
    least : overlap below which it is doubted; 30 degrees off in every joint still have more.

    Returns
    -------
    A warning if it covers them badly.

    Raises
    ------
    OptionError : it does not touch the silhouette of any view.
    """
    from dousa.estimation.raster.rasteriser import draw_body

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
    if max(overlaps.values()) == 0.0:
        code = "start.outside" if len(outside) == len(overlaps) else "start.beside"
        raise OptionError(code, text=text, place=pose[:3])
    mean = sum(overlaps.values()) / len(overlaps)
    if mean >= least:
        return None
    views = [Message("start.overlap", view=name, overlap=value) for name, value in overlaps.items()]
    return Message("start.far_off", text=text, place=pose[:3], views=views)
