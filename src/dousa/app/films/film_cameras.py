"""From films to the cameras that took them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from dousa.app.films.film_sync import read_view_cameras
from dousa.app.films.film_views import name_films, open_keypoints, read_sounds
from dousa.errors import OptionError

if TYPE_CHECKING:
    from dousa.app.output import ProgressCallback
    from dousa.estimation import Calibration, Camera, Synchronisation, ViewKeypoints
    from dousa.estimation.keypoints.pose_models import LandmarkModel


@dataclass(frozen=True, slots=True)
class CalibrationRequest:
    """What is calibrated from what.

    Parameters
    ----------
    films : films, or files of keypoints.
    stature : m, of the person; None with a board.
    board : as `parse_board` takes it; None with a person.
    cameras : calibration whose focal lengths and distortion are known; None where none is.
    focal : px, of all cameras, where nothing else is known.
    offsets : file of time offsets; None where they are to be found.
    together : the films begin at one moment.
    model : by which keypoints are found in films; None for the most precise that is installed.
    """

    films: tuple[Path, ...]
    stature: float | None = None
    board: str | None = None
    cameras: Path | None = None
    focal: float | None = None
    offsets: Path | None = None
    together: bool = False
    model: LandmarkModel | None = None


def calibrate_films(
    request: CalibrationRequest, progress: ProgressCallback
) -> tuple[Calibration, Synchronisation | None]:
    """Find where the cameras of films stand.

    Returns
    -------
    The cameras, and the time offsets where they were found on the way.

    Raises
    ------
    DousaError : a source that cannot be read; options that contradict each other; cameras that cannot be found.
    """
    from dousa.estimation import calibrate_from_board, calibrate_from_person, parse_board

    if (request.stature is None) == (request.board is None):
        raise OptionError("calibration.person_or_board")
    if len(request.films) < 2:
        raise OptionError("calibration.one_view")
    if request.offsets is not None and request.together:
        raise OptionError("calibration.offsets_and_together")
    if request.board is not None:
        board = parse_board(request.board)
        views = _open_boards(request, progress)
    else:
        views = open_keypoints(request.films, request.model, progress)
    lenses = _find_lenses(request, views)
    offsets, found = _find_offsets(request, views, progress)
    focals = None if request.focal is None else [request.focal] * len(views)
    if request.board is not None:
        return calibrate_from_board(views, board, cameras=lenses, focals=focals, offsets=offsets), found
    assert request.stature is not None
    people = None if found is None else found.people
    made = calibrate_from_person(views, request.stature, cameras=lenses, focals=focals, offsets=offsets, people=people)
    return made, found


def _open_boards(request: CalibrationRequest, progress: ProgressCallback) -> tuple[ViewKeypoints, ...]:
    from dousa.estimation import find_board, parse_board

    board = parse_board(request.board or "")
    names = name_films(request.films)
    return tuple(
        replace(find_board(film, board, progress), source=name) for film, name in zip(request.films, names, strict=True)
    )


def _find_lenses(request: CalibrationRequest, views: Sequence[ViewKeypoints]) -> tuple[Camera, ...] | None:
    if request.cameras is None:
        return None
    if request.focal is not None:
        raise OptionError("calibration.focal_and_cameras")
    return read_view_cameras(request.cameras, views)


def _find_offsets(
    request: CalibrationRequest, views: Sequence[ViewKeypoints], progress: ProgressCallback
) -> tuple[Sequence[float], Synchronisation | None]:
    from dousa.estimation import read_offsets, sync

    if request.together:
        return [0.0] * len(views), None
    if request.offsets is not None:
        return read_offsets(request.offsets, [view.source for view in views]), None
    found = sync(views, sounds=read_sounds(request.films), progress=progress)
    return found.offsets.tolist(), found
