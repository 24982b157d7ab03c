"""From films to their time offsets and to the cameras that took them."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dousa.app.pictures.canvas import BLUE, FAINT, GREY, VERMILLION, new_figure, save_figure, write
from dousa.app.pipelines.estimation_views import read_view_cameras
from dousa.app.pipelines.film_scene import name_films, open_keypoints, read_sounds
from dousa.errors import OptionError
from dousa.messages import Message

if TYPE_CHECKING:
    from dousa.app.output import ProgressCallback
    from dousa.app.requests.estimation import CalibrationRequest
    from dousa.arrays import FloatArray
    from dousa.estimation import Calibration, Camera, Synchronisation, ViewKeypoints


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
    if request.board is not None:
        board = parse_board(request.board)
        views = _open_boards(request, progress)
    else:
        views = open_keypoints(request.films, None, progress)
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
    return read_view_cameras(request.cameras, [view.source for view in views], [view.size for view in views])[0]


def _find_offsets(
    request: CalibrationRequest, views: Sequence[ViewKeypoints], progress: ProgressCallback
) -> tuple[Sequence[float], Synchronisation | None]:
    from dousa.estimation import read_offsets, sync

    if request.offsets == "none":
        return [0.0] * len(views), None
    if request.offsets != "auto":
        return read_offsets(request.offsets, [view.source for view in views]), None
    found = sync(views, sounds=read_sounds(request.films), progress=progress)
    return found.offsets.tolist(), found


def sync_films(
    films: Sequence[Path],
    cameras: Path | None,
    progress: ProgressCallback,
) -> tuple[tuple[str, ...], Synchronisation]:
    """Find the time offsets of films.

    Parameters
    ----------
    films : films, or files of keypoints.
    cameras : a calibration; None where there is none.
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
    views = open_keypoints(films, None, progress)
    names, calibrated = tuple(view.source for view in views), None
    if cameras is not None:
        calibrated = read_view_cameras(cameras, names, [view.size for view in views])[0]
    return names, sync(views, cameras=calibrated, sounds=read_sounds(films), progress=progress)


def draw_cameras(found: Calibration, path: str | os.PathLike[str]) -> None:
    """Draw where cameras stand, in the language in use.

    Parameters
    ----------
    found : of `calibrate_from_person` or `calibrate_from_board`.
    path : .png, .svg or .pdf.

    Raises
    ------
    OptionError : another suffix.
    MotionWriteError : the picture cannot be written.
    """
    figure = new_figure(10.0, 5.2)  # inches
    n_moments = min(24, len(found.points))
    points = found.points[np.linspace(0, len(found.points) - 1, n_moments).round().astype(int)]
    for number, (code, across, along) in enumerate(
        (("camera_picture.above", (0, 2), (1.0, -1.0)), ("camera_picture.side", (0, 1), (1.0, 1.0)))
    ):
        axes = figure.add_axes((0.06 + 0.49 * number, 0.1, 0.43, 0.78))
        write(axes, 0.0, 1.03, str(Message(code)), 10.0, transform=axes.transAxes)
        axes.tick_params(labelsize=8, colors=GREY)
        axes.grid(color=FAINT, linewidth=0.6)
        flat = points.reshape(-1, 3)[:, across] * along
        axes.plot(flat[:, 0], flat[:, 1], ".", color=GREY, markersize=2.0)
        for camera in found.cameras:
            _draw_camera(axes, camera, list(across), np.array(along))
        axes.set_aspect("equal", adjustable="datalim")
        axes.margins(0.12)
    save_figure(figure, path)


def _draw_camera(axes: Any, camera: Any, across: list[int], along: FloatArray) -> None:
    corners = np.array(((0.0, (camera.height - 1) / 2), (camera.width - 1.0, (camera.height - 1) / 2)))
    if across[1] == 1:
        corners = np.array((((camera.width - 1) / 2, 0.0), ((camera.width - 1) / 2, camera.height - 1.0)))
    _, directions = camera.compute_rays(corners)
    place = camera.position[across] * along
    for direction in np.nan_to_num(directions):
        end = (camera.position + 0.8 * direction)[across] * along
        axes.plot((place[0], end[0]), (place[1], end[1]), color=BLUE, linewidth=1.2)
    axes.plot(place[0], place[1], "o", color=VERMILLION, markersize=5)
    write(axes, float(place[0]) + 0.08, float(place[1]) + 0.08, camera.name[:24], 8.5)
