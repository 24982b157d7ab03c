"""The views of ``dousa estimate``: silhouettes, and a camera for each."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from dousa.app._watched_silhouettes import MirroredSilhouettes
from dousa.errors import CalibrationError, OptionError

if TYPE_CHECKING:
    from dousa.app._output import ProgressCallback
    from dousa.app.estimating import Request
    from dousa.estimation import Camera, Silhouettes

__all__ = ["choose_cameras", "open_views", "read_known_stature"]


_NO_CAMERAS = "--cameras FILE is missing: where did the cameras stand, and what lenses had they?"


def open_views(request: Request, report: ProgressCallback) -> Silhouettes:
    """Open the sources; backgrounds of videos are learnt, which takes a while.

    Raises
    ------
    DousaError : sources that cannot be read, or whose cameras nobody tells.
    """
    from dousa.estimation.silhouette_files import open_silhouettes

    if request.cameras is None and not _is_npz(request.sources) and all(map(Path.exists, request.sources)):
        raise OptionError(_NO_CAMERAS)
    opened: Silhouettes = open_silhouettes(
        request.sources,
        backgrounds=request.backgrounds,
        method=request.background_method,  # type: ignore[arg-type]
        kind=request.kind,  # type: ignore[arg-type]
        frame_rate=request.rate,
        sizes=_find_sizes(request),
        progress=report,
    )
    return MirroredSilhouettes(opened) if request.mirrored else opened


def _find_sizes(request: Request) -> list[tuple[int, int]] | None:
    """Sizes for the masks of videos: the proportions of the cameras', which may differ from those of the files."""
    from dousa.estimation.camera_files import read_cameras
    from dousa.estimation.camera_sets import match_cameras
    from dousa.estimation.video import LONGEST_SIDE, reduce_size

    if request.cameras is None or not all(
        path.is_file() and path.suffix.lower() != ".npz" for path in request.sources
    ):
        return None
    cameras, _ = match_cameras(read_cameras(request.cameras), [path.stem for path in request.sources])
    return [reduce_size((camera.width, camera.height), LONGEST_SIDE) for camera in cameras]


def _is_npz(sources: Sequence[Path]) -> bool:
    return all(path.suffix.lower() == ".npz" for path in sources)


def read_known_stature(sources: Sequence[Path]) -> float | None:
    """What the files of the silhouettes say about the person."""
    from dousa.estimation.mask_npz import read_stature

    for path in sources:
        if path.suffix.lower() == ".npz":
            stature = read_stature(path)
            if stature is not None:
                return stature
    return None


def choose_cameras(request: Request, views: Silhouettes) -> tuple[tuple[Camera, ...], list[str]]:
    """A camera for each view, of the size of its images."""
    from dousa.estimation.camera_files import read_cameras
    from dousa.estimation.camera_sets import fit_cameras, match_cameras

    if request.cameras is not None:
        found = read_cameras(request.cameras)
        if len(found) < views.n_views:
            raise CalibrationError(
                f"{request.cameras}: {len(found)} cameras for {views.n_views} views "
                f"({', '.join(views.names)}); each view needs its own"
            )
        matched, notes = match_cameras(found, views.names)
    elif _is_npz(request.sources):
        matched, notes = _read_own_cameras(request.sources, views.n_views), ()
    else:
        raise OptionError(_NO_CAMERAS)
    cameras, more = fit_cameras(matched, views.sizes)
    return cameras, [*notes, *more]


def _read_own_cameras(sources: Sequence[Path], n_views: int) -> tuple[Camera, ...]:
    """The cameras in the npz files of the silhouettes."""
    from dousa.estimation.camera_files import read_cameras

    try:
        cameras = tuple(camera for path in sources for camera in read_cameras(path))
    except CalibrationError as error:
        raise CalibrationError(f"{error}; give --cameras FILE") from error
    if len(cameras) != n_views:
        raise CalibrationError(
            f"{sources[0]}: {len(cameras)} cameras for {n_views} views; give --cameras FILE"
        )
    return cameras
