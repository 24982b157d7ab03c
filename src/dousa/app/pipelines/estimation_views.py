"""The views of ``dousa estimate``: silhouettes and a camera for each, and the watcher of the work."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from dousa.app.pipelines.doubts import MirroredSilhouettes
from dousa.errors import CalibrationError, OptionError
from dousa.estimation.silhouettes.silhouettes import Silhouettes
from dousa.messages import Message

if TYPE_CHECKING:
    from dousa.app.output import ProgressCallback
    from dousa.app.requests.estimation import EstimationRequest
    from dousa.arrays import Image, Mask
    from dousa.estimation import Camera, Silhouettes
    from dousa.estimation.tracking.settings import Estimate, TrackedFrame


def open_views(request: EstimationRequest, report: ProgressCallback) -> Silhouettes:
    """Open the sources; backgrounds of videos are learnt, which takes a while.

    Raises
    ------
    DousaError : sources that cannot be read, or without cameras.
    """
    if request.cameras is None and not _is_npz(request.sources) and all(map(Path.exists, request.sources)):
        raise OptionError("estimate.no_cameras")
    return open_bare_views(request, report, _find_sizes(request))


def open_bare_views(
    request: EstimationRequest, report: ProgressCallback, sizes: list[tuple[int, int]] | None = None
) -> Silhouettes:
    """Open the sources without their cameras, only to be looked at.

    Parameters
    ----------
    request : its sources and how they are understood.
    report : called with (done, total, what).
    sizes : width and height of the masks of videos, px; None for their own.
    """
    from dousa.estimation.silhouettes.silhouette_files import open_silhouettes

    opened: Silhouettes = open_silhouettes(
        request.sources,
        backgrounds=request.backgrounds,
        method=request.background_method,
        kind=request.kind,
        frame_rate=request.rate,
        sizes=sizes,
        progress=report,
    )
    return MirroredSilhouettes(opened) if request.mirrored else opened


def _find_sizes(request: EstimationRequest) -> list[tuple[int, int]] | None:
    """Sizes for the masks of videos: the proportions of the cameras', which may differ from those of the files."""
    from dousa.estimation.cameras.camera import match_cameras
    from dousa.estimation.cameras.camera_files import read_cameras
    from dousa.estimation.silhouettes.video import reduce_size

    if request.cameras is None or not all(path.is_file() and path.suffix.lower() != ".npz" for path in request.sources):
        return None
    cameras, _ = match_cameras(read_cameras(request.cameras), [path.stem for path in request.sources])
    return [reduce_size((camera.width, camera.height)) for camera in cameras]


def _is_npz(sources: Sequence[Path]) -> bool:
    return all(path.suffix.lower() == ".npz" for path in sources)


def read_known_stature(sources: Sequence[Path]) -> float | None:
    """Read the stature that the files of the silhouettes hold."""
    from dousa.estimation.silhouettes.mask_npz import read_stature

    for path in sources:
        if path.suffix.lower() == ".npz":
            stature = read_stature(path)
            if stature is not None:
                return stature
    return None


def choose_cameras(request: EstimationRequest, views: Silhouettes) -> tuple[tuple[Camera, ...], list[Message]]:
    """Choose a camera for each view, of the size of its images."""
    from dousa.estimation.cameras.camera import fit_cameras

    if request.cameras is not None:
        return read_view_cameras(request.cameras, views.names, views.sizes)
    if not _is_npz(request.sources):
        raise OptionError("estimate.no_cameras")
    cameras, notes = fit_cameras(_read_own_cameras(request.sources, views.n_views), views.sizes)
    return cameras, list(notes)


def read_view_cameras(
    path: Path, names: Sequence[str], sizes: Sequence[tuple[int, int]]
) -> tuple[tuple[Camera, ...], list[Message]]:
    """Read a calibration: the camera of each view, of the size of its pictures, and what a person should know.

    Raises
    ------
    CalibrationError : no calibration, or a view without camera.
    """
    from dousa.estimation.cameras.camera import fit_cameras, match_cameras
    from dousa.estimation.cameras.camera_files import read_cameras

    found = read_cameras(path)
    check_count(path, found, names)
    matched, notes = match_cameras(found, names)
    # once more with the sizes, for a camera whose file has none
    cameras, more = fit_cameras(read_cameras(path, [camera.name for camera in matched], sizes=sizes), sizes)
    return cameras, [*notes, *more]


def check_count(path: Path, found: Sequence[Camera], names: Sequence[str]) -> None:
    """Raise CalibrationError unless a calibration has a camera for each view."""
    if len(found) < len(names):
        raise CalibrationError("estimate.too_few_cameras", path=path, found=len(found), views=tuple(names))


def _read_own_cameras(sources: Sequence[Path], n_views: int) -> tuple[Camera, ...]:
    from dousa.estimation.cameras.camera_files import read_cameras

    try:
        cameras = tuple(camera for path in sources for camera in read_cameras(path))
    except CalibrationError as error:
        raise CalibrationError("estimate.own_cameras_unusable", problem=error.located) from error
    if len(cameras) != n_views:
        raise CalibrationError("estimate.own_cameras_count", path=sources[0], found=len(cameras), expected=n_views)
    return cameras


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """What is tracked.

    Parameters
    ----------
    names : (V,) of the views.
    cameras : (V,) of the size of the masks.
    frame_rate : Hz.
    n_frames : T.
    resumed : frames that an earlier run had looked at.
    """

    names: tuple[str, ...]
    cameras: Sequence[Camera]
    frame_rate: float
    n_frames: int
    resumed: int


class Watcher(Protocol):
    """Follows the work: its methods are called in this order."""

    def begin(self, scene: Scene) -> None:
        """Tracking is about to begin, or to go on."""

    def see(self, frame: int, masks: Sequence[Mask | None], pictures: Sequence[Image | None]) -> None:
        """Masks and pictures (V,) of a frame were read for the first time in this run."""

    def follow(self, tracked: TrackedFrame) -> None:
        """A frame has a pose, or its pose is settled."""

    def end(self, estimate: Estimate) -> None:
        """All frames are settled and smoothed."""
