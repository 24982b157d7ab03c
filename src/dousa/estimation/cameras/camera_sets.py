"""Sets of cameras: made for demos, matched to the names of videos, and fitted to their sizes."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from dousa.errors import CalibrationError, OptionError
from dousa.estimation.cameras.camera import Camera, format_size
from dousa.messages import Message

_FOCAL_PER_SIDE = 1.25  # of the shorter side: a person with raised hands fits at 3.5 m
_STRETCH = 0.02  # widths and heights may be scaled apart so much before a person is told


def make_view(
    position: ArrayLike,
    target: ArrayLike,
    *,
    size: tuple[int, int] = (320, 240),
    focal: float | None = None,
    name: str = "view1",
) -> Camera:
    """A camera that stands upright and looks at a point.

    Parameters
    ----------
    position : (3,) m, where it stands; Y is up.
    target : (3,) m, what it looks at, in the middle of the image.
    size : px, width and height.
    focal : px; by default 1.25 times the shorter side.
    name : of the view.

    Returns
    -------
    A pinhole camera without distortion. Looking straight up or down, the world's +X is to the right.

    Raises
    ------
    CalibrationError : the camera stands on its target.
    """
    place, aim = np.asarray(position, np.float64), np.asarray(target, np.float64)
    distance = float(np.linalg.norm(aim - place)) if place.shape == aim.shape == (3,) else np.nan
    if not (np.isfinite(distance) and distance > 0):
        raise CalibrationError("camera.on_target", camera=name, position=str(place.tolist()), target=str(aim.tolist()))
    forward = (aim - place) / distance
    right = np.cross(forward, (0.0, 1.0, 0.0))
    length = float(np.linalg.norm(right))
    right = right / length if length > 1e-9 else np.array([1.0, 0.0, 0.0])
    rotation = np.stack((right, np.cross(forward, right), forward))
    width, height = size
    focal = _FOCAL_PER_SIDE * min(size) if focal is None else focal
    matrix = [[focal, 0.0, (width - 1) / 2], [0.0, focal, (height - 1) / 2], [0.0, 0.0, 1.0]]
    return Camera(name, width, height, np.array(matrix), rotation, -rotation @ place)


def make_ring(
    n_views: int = 4,
    *,
    target: ArrayLike = (0.0, 0.9, 0.0),
    distance: float = 3.5,
    height: float = 1.4,
    size: tuple[int, int] = (320, 240),
    focal: float | None = None,
    first_angle: float = 0.0,
) -> tuple[Camera, ...]:
    """Cameras around a person, the first in front.

    They stand at equal angles, except that an even number takes the places of a ring with one camera more and leaves
    the last out: two cameras that face each other see the same outline mirrored, and tell hardly more than one.

    Parameters
    ----------
    n_views : number of cameras, 1 to 100.
    target : (3,) m, what they look at.
    distance : m, from the target, over the floor.
    height : m, of the cameras over the floor.
    size : px, width and height.
    focal : px; by default 1.25 times the shorter side.
    first_angle : rad, where the first camera stands, from +Z (the front) towards +X (the person's left).

    Returns
    -------
    Cameras ``"view1"``, ``"view2"`` and so on.

    Raises
    ------
    OptionError : no or too many views.
    CalibrationError : a distance of zero below or above the target.
    """
    if not 1 <= n_views <= 100:
        raise OptionError("camera.ring", found=n_views)
    places = n_views + 1 - n_views % 2
    middle = np.asarray(target, np.float64)
    cameras = []
    for view in range(n_views):
        angle = first_angle + 2.0 * np.pi * view / places
        position = (middle[0] + distance * np.sin(angle), height, middle[2] + distance * np.cos(angle))
        cameras.append(make_view(position, middle, size=size, focal=focal, name=f"view{view + 1}"))
    return tuple(cameras)


def fit_cameras(
    cameras: Sequence[Camera], sizes: Sequence[tuple[int, int]]
) -> tuple[tuple[Camera, ...], tuple[Message, ...]]:
    """Cameras for images of other sizes than those they were calibrated with.

    Parameters
    ----------
    cameras : V cameras.
    sizes : (V,) width and height of the actual images, px.

    Returns
    -------
    The cameras stretched to these sizes, and a note for each whose image changes its shape by more than 2 %:
    such an image was probably cropped or turned, which no scale makes good.

    Raises
    ------
    CalibrationError : another number of sizes than of cameras.
    """
    if len(cameras) != len(sizes):
        raise CalibrationError("camera.count", cameras=len(cameras), views=len(sizes))
    fitted, notes = [], []
    for camera, (width, height) in zip(cameras, sizes, strict=True):
        if camera.size == (width, height):
            fitted.append(camera)
            continue
        fitted.append(camera.resized(width, height))
        stretch = (width / camera.width) / (height / camera.height)
        if max(stretch, 1.0 / stretch) > 1.0 + _STRETCH:
            turned = (width > height) != (camera.width > camera.height) and camera.width != camera.height
            names = {"camera": camera.name, "size": format_size(camera.size)}
            names["other"] = format_size((width, height))
            notes.append(Message("camera.turned" if turned else "camera.cropped", **names))
    return tuple(fitted), tuple(notes)


def check_cameras(cameras: Sequence[Camera], names: Sequence[str], sizes: Sequence[tuple[int, int]]) -> None:
    """CalibrationError unless there is one camera for each view, of the size (px) of its masks."""
    if len(cameras) != len(names):
        raise CalibrationError("camera.count", cameras=len(cameras), views=len(names))
    for camera, name, size in zip(cameras, names, sizes, strict=True):
        if camera.size != tuple(size):
            own = format_size(camera.size)
            raise CalibrationError("camera.size", view=name, size=format_size(size), other=own)


def match_cameras(cameras: Sequence[Camera], names: Sequence[str]) -> tuple[tuple[Camera, ...], tuple[Message, ...]]:
    """The camera of each view, by name.

    Upper and lower case, spaces, dashes and leading zeros do not count; where that finds none, a camera is taken whose
    name holds the view's or is held by it (``int_cam01_img`` for ``cam01``). If no view finds any and there are as many
    cameras as views, they are taken in order, and a note says so.

    Parameters
    ----------
    cameras : of the calibration.
    names : (V,) of the views, such as the names of the videos without suffix.

    Returns
    -------
    (V,) cameras, each with its own name, and what a person should know.

    Raises
    ------
    CalibrationError : a view without camera or with several, two views with one camera.
    """
    has = [camera.name for camera in cameras]
    if len(has) == len(names) and not any(_find(has, name) for name in names):
        if len(names) == 1:
            return tuple(cameras), ()
        pairs = tuple(f"{name} = {camera}" for name, camera in zip(names, has, strict=True))
        return tuple(cameras), (Message("camera.by_order", pairs=pairs),)
    return tuple(cameras[index] for index in find_views(has, names)), ()


def find_views(cameras: Sequence[str], names: Sequence[str]) -> list[int]:
    """Index of the camera of each view, from the names of both; CalibrationError where that is not one camera."""
    picked = []
    for name in names:
        found = _find(cameras, name)
        if len(found) != 1:
            several = tuple(cameras[index] for index in found)
            raise (
                CalibrationError("camera.several_for_view", view=name, found=several, cameras=cameras)
                if found
                else CalibrationError("camera.none_for_view", view=name, cameras=cameras)
            )
        picked.append(found[0])
    if len(set(picked)) != len(picked):
        raise CalibrationError("camera.shared", views=names, cameras=cameras)
    return picked


def _plain(name: str) -> str:
    return re.sub(r"0+(?=\d)", "", re.sub(r"[\W_]+", "", name.casefold()))


def _find(cameras: Sequence[str], name: str) -> list[int]:
    """Indices of the cameras that answer to a name, by the strictest rule that finds any."""

    def holds(outer: str, inner: str) -> bool:
        # not cam1 in cam12
        pattern = rf"(?<!\d){re.escape(inner)}(?!\d)" if inner[:1].isdigit() else rf"{re.escape(inner)}(?!\d)"
        return bool(inner) and re.search(pattern, outer) is not None

    plain = _plain(name)
    plains = [_plain(camera) for camera in cameras]
    rules = (
        [camera == name for camera in cameras],
        [other == plain for other in plains],
        [holds(other, plain) or holds(plain, other) for other in plains],
    )
    for rule in rules:
        if any(rule):
            return [index for index, fits in enumerate(rule) if fits]
    return []


def check_names(names: Sequence[str]) -> None:
    """CalibrationError if two cameras have one name."""
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise CalibrationError("camera.same_name", camera=name)
        seen.add(name)
