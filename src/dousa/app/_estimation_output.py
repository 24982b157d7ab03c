"""The files that ``dousa estimate`` writes: whether they can be written is known before the work begins."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dousa._files import atomic_write
from dousa.errors import MotionWriteError, OptionError

if TYPE_CHECKING:
    from dousa.app._output import ProgressCallback
    from dousa.app._video_pictures import VideoPictures
    from dousa.estimation import Camera, Silhouettes
    from dousa.estimation._types import Estimate
    from dousa.motion import Trajectories

__all__ = ["Outputs", "canonical_points", "check_file", "check_outputs", "write_angles", "write_outputs"]


@dataclass(frozen=True, slots=True)
class Outputs:
    """What to write.

    Parameters
    ----------
    motion : any motion file that dousa writes.
    trc : canonical joints as TRC.
    angles : joint angles as CSV.
    overlay : video of the outlines.
    sheet : contact sheet of the outlines.
    """

    motion: Path | None = None
    trc: Path | None = None
    angles: Path | None = None
    overlay: Path | None = None
    sheet: Path | None = None

    @property
    def named(self) -> tuple[tuple[str, Path], ...]:
        """(option, file) of those that are given, the motion first."""
        pairs = (
            ("--output", self.motion),
            ("--trc", self.trc),
            ("--angles", self.angles),
            ("--sheet", self.sheet),
            ("--overlay", self.overlay),
        )
        return tuple((option, path) for option, path in pairs if path is not None)

    @property
    def has_drawings(self) -> bool:
        """Whether the silhouettes are drawn."""
        return self.overlay is not None or self.sheet is not None

    @property
    def first(self) -> Path | None:
        """The file beside which the partial track lies."""
        return self.named[0][1] if self.named else None


_ENDINGS = {
    "--trc": (".trc",),
    "--angles": (".csv",),
    "--sheet": (".png", ".svg", ".pdf"),
    "--overlay": (".mp4", ".avi", ".mkv"),
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
    """
    from dousa.formats import WRITERS

    sources = {os.path.realpath(path): path for path in inputs}
    taken: dict[str, str] = {}
    for option, path in outputs.named:
        endings = _ENDINGS.get(option, tuple(WRITERS))
        if path.suffix.lower() not in endings:
            got = f"'{path.suffix}'" if path.suffix else "no suffix"
            raise OptionError(f"{option} {path}: expected a file ending in {', '.join(endings)}, got {got}")
        place = os.path.realpath(path)
        if place in sources:
            raise OptionError(f"{option} {path}: this file is read from; choose another name for the output")
        if place in taken:
            raise OptionError(f"{option} {path}: {taken[place]} goes to the same file; choose another name")
        taken[place] = option
        check_file(path)


def check_file(path: Path) -> None:
    """Whether a file can be made or replaced, without doing it.

    Raises
    ------
    MotionWriteError : it cannot.
    """
    place = Path(os.path.realpath(path))
    if place.is_dir():
        raise MotionWriteError(path, "expected the name of a file, this is a folder")
    if not place.parent.is_dir():
        raise MotionWriteError(path, "the folder does not exist; make it first")
    if not os.access(place.parent, os.W_OK | os.X_OK) or (place.exists() and not os.access(place, os.W_OK)):
        raise MotionWriteError(
            path, "no permission to write here; choose another folder or change the permissions"
        )
    if len(os.fsencode(place.name)) > 200:  # the hidden files beside it have longer names
        raise MotionWriteError(path, "the name is too long; choose a shorter one")


def write_outputs(
    outputs: Outputs,
    estimate: Estimate,
    views: Silhouettes,
    cameras: Sequence[Camera],
    open_pictures: Callable[[], VideoPictures | None],
    report: ProgressCallback,
) -> tuple[Path, ...]:
    """Write the files, those first that are most worth having if the disk is full.

    Parameters
    ----------
    outputs : what to write.
    estimate, views, cameras : what was found, from what.
    open_pictures : gives the pictures behind the silhouettes, if there are any; called for the drawings.
    report : called with (done, total, what is being done).

    Returns
    -------
    The files.

    Raises
    ------
    MotionWriteError : the disk refuses.
    """
    for number, (option, path) in enumerate(outputs.named):
        report(number, len(outputs.named), f"writing {path.name}")
        if option == "--angles":
            write_angles(estimate, path)
        elif option in ("--sheet", "--overlay"):
            _draw(option, path, estimate, views, cameras, open_pictures(), report)
        else:
            _write_motion(estimate, path)
    return tuple(path for _, path in outputs.named)


def _write_motion(estimate: Estimate, path: Path) -> None:
    from dousa.formats import write_motion

    points_only = path.suffix.lower() in (".trc", ".c3d")
    write_motion(canonical_points(estimate) if points_only else estimate.motion, path)


def _draw(
    option: str,
    path: Path,
    estimate: Estimate,
    views: Silhouettes,
    cameras: Sequence[Camera],
    pictures: VideoPictures | None,
    report: ProgressCallback,
) -> None:
    from dousa.app.overlay import draw_overlay_sheet, write_overlay

    try:
        if option == "--sheet":
            draw_overlay_sheet(estimate, views, cameras, path, images=pictures)
        else:
            write_overlay(estimate, views, cameras, path, images=pictures, progress=report)
    finally:
        if pictures is not None:
            pictures.close()


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
    """The angles of the body model as CSV: time, the root's place and quaternion, degrees, and whether it is lost.

    Raises
    ------
    MotionWriteError : the disk refuses.
    """
    root = estimate.body.joints[0]
    head = ["time_s", *(f"{root}_{axis}_m" for axis in "xyz"), *(f"{root}_q{axis}" for axis in "wxyz")]
    head += [f"{name}_deg" for name in estimate.body.angle_names]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*head, "lost"])
    for frame, (pose, lost) in enumerate(zip(estimate.poses, estimate.lost, strict=True)):
        writer.writerow(_row(frame / estimate.frame_rate, pose, bool(lost)))
    with atomic_write(path) as file:
        file.write(text.getvalue().encode())


def _row(time: float, pose: np.ndarray, lost: bool) -> Sequence[str]:
    angles = np.rad2deg(pose[7:])
    return [f"{time:.6f}", *(f"{x:.6f}" for x in pose[:7]), *(f"{x:.4f}" for x in angles), str(int(lost))]
