"""A picture of where cameras stand: from above and from the side, with the person."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import numpy as np

from dousa.app.pictures.canvas import BLUE, FAINT, GREY, VERMILLION, new_figure, save_figure, write
from dousa.messages import Message

if TYPE_CHECKING:
    from dousa.arrays import FloatArray
    from dousa.estimation import Calibration

_WIDTH, _HEIGHT = 10.0, 5.2  # inches
_SIGHT = 0.8  # m, length of the sides of a field of view
_PLACES = 24  # moments of the person that are drawn


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
    figure = new_figure(_WIDTH, _HEIGHT)
    points = found.points[np.linspace(0, len(found.points) - 1, min(_PLACES, len(found.points))).round().astype(int)]
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
    """A camera, the sides of its picture as lines of sight, and its name."""
    corners = np.array(((0.0, (camera.height - 1) / 2), (camera.width - 1.0, (camera.height - 1) / 2)))
    if across[1] == 1:
        corners = np.array((((camera.width - 1) / 2, 0.0), ((camera.width - 1) / 2, camera.height - 1.0)))
    _, directions = camera.compute_rays(corners)
    place = camera.position[across] * along
    for direction in np.nan_to_num(directions):
        end = (camera.position + _SIGHT * direction)[across] * along
        axes.plot((place[0], end[0]), (place[1], end[1]), color=BLUE, linewidth=1.2)
    axes.plot(place[0], place[1], "o", color=VERMILLION, markersize=5)
    write(axes, float(place[0]) + 0.08, float(place[1]) + 0.08, camera.name[:24], 8.5)
