"""From films to their time offsets."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from dousa.app.films.film_views import open_keypoints, read_sounds
from dousa.errors import OptionError

if TYPE_CHECKING:
    from dousa.app.output import ProgressCallback
    from dousa.estimation import Camera, Synchronisation, ViewKeypoints
    from dousa.estimation.keypoints.pose_models import LandmarkModel


def sync_films(
    films: Sequence[Path],
    cameras: Path | None,
    listen: bool,
    model: LandmarkModel | None,
    progress: ProgressCallback,
) -> tuple[tuple[str, ...], Synchronisation]:
    """Find the time offsets of films.

    Parameters
    ----------
    films : films, or files of keypoints.
    cameras : a calibration; None where there is none.
    listen : to the sound of the films too.
    model : by which keypoints are found in films.
    progress : called with (done, total, what).

    Returns
    -------
    The names of the films, and their offsets.

    Raises
    ------
    DousaError : a source that cannot be read; nothing tells the time.
    """
    from dousa.estimation import sync

    if len(films) < 2:
        raise OptionError("sync.one_film")
    views = open_keypoints(films, model, progress)
    calibrated = None if cameras is None else read_view_cameras(cameras, views)
    sounds = read_sounds(films) if listen else None
    return tuple(view.source for view in views), sync(views, cameras=calibrated, sounds=sounds, progress=progress)


def read_view_cameras(path: Path, views: Sequence[ViewKeypoints]) -> tuple[Camera, ...]:
    """The camera of each view, of the size of its pictures.

    Raises
    ------
    CalibrationError : no calibration, or a view without camera.
    """
    from dousa.estimation import fit_cameras, match_cameras, read_cameras

    matched, _ = match_cameras(read_cameras(path), [view.source for view in views])
    return fit_cameras(matched, [view.size for view in views])[0]
