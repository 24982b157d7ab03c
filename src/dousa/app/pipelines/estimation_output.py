"""The files that ``dousa estimate`` writes: whether they can be written is known before the work begins."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dousa.app.targets import ANGLES, check_targets
from dousa.errors import JointMappingError, MotionWriteError, OptionError
from dousa.extras import require
from dousa.messages import Message

if TYPE_CHECKING:
    from dousa.app.output import ProgressCallback
    from dousa.app.requests.estimation import Outputs
    from dousa.estimation import Camera, Silhouettes
    from dousa.estimation.tracking.settings import Estimate
    from dousa.motion import Trajectories


_ENDINGS = {
    "angles": (".csv",),
    "sheet": (".png", ".svg", ".pdf"),
    "overlay": (".mp4", ".avi", ".mkv"),
}


def check_outputs(outputs: Outputs, inputs: Iterable[Path]) -> None:
    """Whether all files can be written, without writing: to be known before the long work.

    Parameters
    ----------
    outputs : what to write.
    inputs : files that must not be written over.

    Raises
    ------
    OptionError : an ending that says nothing, two outputs in one file, an output that is an input.
    MotionWriteError : a folder that is missing or must not be written to.
    MissingExtraError : the package that draws is not installed.
    """
    if outputs.sheet is not None:
        require("matplotlib", "pictures")
    from dousa.formats.registry import WRITERS

    sources = {os.path.realpath(path): path for path in inputs}
    taken: dict[str, str] = {}
    for kind, path in outputs.named:
        option = "--angles" if kind == "angles" else "--output"
        endings = _ENDINGS.get(kind, tuple(WRITERS))
        if path.suffix.lower() not in endings:
            raise OptionError(
                "outputs.suffix" if path.suffix else "outputs.no_suffix",
                option=option,
                path=path,
                expected=endings,
                found=path.suffix,
            )
        place = os.path.realpath(path)
        if place in sources:
            raise OptionError("outputs.is_input", option=option, path=path)
        if place in taken:
            raise OptionError("outputs.same_file", option=option, path=path, other=taken[place])
        taken[place] = option
        check_file(path)
        check_targets({option: path}, (), ANGLES if kind == "angles" else None)


def check_file(path: Path) -> None:
    """Whether a file can be made or replaced, without doing it.

    Raises
    ------
    MotionWriteError : it cannot.
    """
    place = Path(os.path.realpath(path))
    if place.is_dir():
        raise MotionWriteError(path, "outputs.folder")
    if not place.parent.is_dir():
        raise MotionWriteError(path, "outputs.no_such_folder")
    if not os.access(place.parent, os.W_OK | os.X_OK) or (place.exists() and not os.access(place, os.W_OK)):
        raise MotionWriteError(path, "outputs.no_permission")
    if len(os.fsencode(place.name)) > 200:  # the hidden files beside it have longer names
        raise MotionWriteError(path, "outputs.long_name")


def write_outputs(
    outputs: Outputs,
    estimate: Estimate,
    views: Silhouettes,
    cameras: Sequence[Camera],
    report: ProgressCallback,
) -> tuple[Path, ...]:
    """Write the files, those first that are most worth having if the disk is full.

    Parameters
    ----------
    outputs : what to write.
    estimate, views, cameras : what was found, from what.
    report : called with (done, total, what is being done).

    Returns
    -------
    The files.

    Raises
    ------
    MotionWriteError : the disk refuses.
    """
    for number, (kind, path) in enumerate(outputs.named):
        report(number, len(outputs.named), Message("progress.writing_file", name=path.name))
        if kind == "angles":
            write_angles(estimate, path)
        elif kind in ("sheet", "overlay"):
            _draw(kind, path, estimate, views, cameras, report)
        else:
            _write_motion(estimate, path)
    return tuple(path for _, path in outputs.named)


def _write_motion(estimate: Estimate, path: Path) -> None:
    from dousa.formats.registry import write_motion

    points_only = path.suffix.lower() in (".trc", ".c3d")
    write_motion(canonical_points(estimate) if points_only else estimate.motion, path)


def _draw(
    kind: str,
    path: Path,
    estimate: Estimate,
    views: Silhouettes,
    cameras: Sequence[Camera],
    report: ProgressCallback,
) -> None:
    from dousa.app.pictures.overlay import write_overlay
    from dousa.app.pictures.overlay_sheet import draw_overlay_sheet

    if kind == "sheet":
        draw_overlay_sheet(estimate, views, cameras, path)
    else:
        write_overlay(estimate, views, cameras, path, progress=report)


def canonical_points(estimate: Estimate) -> Trajectories:
    """The estimate's joints under canonical names, in their order; all joints of a body that is no person."""
    from dousa.motion import CANONICAL_JOINTS, CANONICAL_PARENTS, Trajectories

    points = estimate.points
    if not set(CANONICAL_JOINTS) <= set(points.names):
        return points
    return Trajectories(
        CANONICAL_JOINTS, points.select(CANONICAL_JOINTS), points.frame_rate, np.array(CANONICAL_PARENTS)
    )


def write_angles(estimate: Estimate, path: Path) -> None:
    """Write joint angles as CSV: time, OpenSim's coordinates in degrees and metres, and whether the frame is lost.

    A body that is no person has the angles of its own joints.

    Raises
    ------
    MotionWriteError : the disk refuses.
    """
    from dousa.formats.opensim import compute_coordinates, write_angle_table

    try:
        columns = compute_coordinates(estimate.motion)
    except JointMappingError:
        degrees = np.rad2deg(estimate.poses[:, 7:]).T
        columns = dict(zip((f"{name}_deg" for name in estimate.body.angle_names), degrees, strict=True))
    write_angle_table({**columns, "lost": np.asarray(estimate.lost)}, estimate.frame_rate, path)
