"""Look at silhouettes, cameras and body before an estimation; takes seconds and stores nothing."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dousa.app.pipelines.doubts import WatchedSilhouettes, parse_frames
from dousa.app.pipelines.estimation_views import choose_cameras, open_bare_views, open_views, read_known_stature
from dousa.app.studio.content.film_record import to_picture_address
from dousa.app.studio.core.answers import name_error, shorten, to_message
from dousa.app.studio.jobs.lanes import Context
from dousa.app.studio.work.estimation import list_materials, make_request
from dousa.arrays import Mask
from dousa.errors import CalibrationError, DousaError, OptionError, SilhouetteError
from dousa.estimation.silhouettes.silhouettes import Silhouettes
from dousa.messages import Message

if TYPE_CHECKING:
    from dousa.app.requests.estimation import EstimationRequest
    from dousa.estimation import Camera


def preview(request: dict[str, Any], context: Context) -> dict[str, Any]:
    """Preview a request for an estimation.

    Returns
    -------
    ``files``: the role of each file; ``views``: name, size, camera, a picture of the first silhouette; ``n_frames``,
        ``frame_rate``, ``first_frame``, ``body``, ``start``, ``notes``; ``missing``: the problem, or None; ``films``:
        whether people will be searched for in films without preparation.
    """
    answer: dict[str, Any] = {
        "files": [asdict(item) for item in list_materials(request, context)],
        "views": [],
        "n_frames": 0,
        "frame_rate": None,
        "first_frame": None,
        "body": None,
        "start": None,
        "notes": [],
        "missing": None,
        "films": False,
    }
    try:
        _look(request, context, answer)
    except DousaError as error:
        answer["missing"] = answer["missing"] or name_error(error, context.home)
    answer["notes"] = [shorten(to_message(note), context.home) for note in dict.fromkeys(answer["notes"])]
    return answer


def _look(request: dict[str, Any], context: Context, answer: dict[str, Any]) -> None:
    from dousa.app.requests.estimation import Outputs
    from dousa.app.studio.work.films import look_at_films, takes_films

    asked = make_request(request, context, Outputs())
    if takes_films(request, asked, answer["notes"].append):
        answer["films"] = True
        look_at_films(asked, context, answer)
        return
    with _open(asked, context, answer) as views:
        first, last = parse_frames(asked.frames, views.n_frames, Message("frames.recording"))
        answer.update(n_frames=last - first, frame_rate=views.frame_rate)
        answer["views"] = [
            {"name": name, "width": size[0], "height": size[1], "camera": None, "picture": None}
            for name, size in zip(views.names, views.sizes, strict=True)
        ]
        answer["notes"] += views.warnings
        try:
            cameras = None if answer["missing"] else _match(asked, views, answer)
        finally:  # the silhouettes show also where the cameras do not fit
            _show_first(views, first, last, answer)
        if cameras is not None:
            _check_person(asked, context, answer)


def _open(asked: EstimationRequest, context: Context, answer: dict[str, Any]) -> Silhouettes:
    """Open the silhouettes; without a calibration they can be shown but not used."""
    bare = asked.cameras is None and any(path.suffix.lower() != ".npz" for path in asked.sources)
    try:
        if not bare:
            return open_views(asked, context.progress)
        answer["missing"] = Message("estimate.no_cameras")
    except (CalibrationError, OptionError) as error:
        answer["missing"] = name_error(error, context.home)
    return open_bare_views(asked, context.progress)


def _match(asked: EstimationRequest, views: Silhouettes, answer: dict[str, Any]) -> tuple[Camera, ...]:
    try:
        cameras, notes = choose_cameras(asked, views)
    except CalibrationError as error:
        if error.code == "estimate.own_cameras_unusable":
            raise OptionError("estimate.no_cameras") from error
        raise
    answer["notes"] += notes
    for view, camera in zip(answer["views"], cameras, strict=True):
        view["camera"] = camera.name
    if len(cameras) == 1:
        answer["notes"].append(Message("studio_estimation.one_view"))
    return cameras


def _show_first(views: Silhouettes, first: int, last: int, answer: dict[str, Any]) -> None:
    from dousa.estimation.tracking.start import find_first

    part = WatchedSilhouettes(views, first, last)
    try:
        frame, _ = find_first(part)
    except SilhouetteError as error:
        answer["missing"] = answer["missing"] or error.message
        frame = 0
    answer["first_frame"] = first + frame
    for view, mask, image in zip(answer["views"], part.read(frame), part.look(frame), strict=True):
        if mask is not None:
            view["picture"] = _draw(mask, image)
            view["share"] = float(mask.mean())
    answer["notes"] += part.describe()


def _draw(mask: Mask, image: NDArray[np.uint8] | None, *, longest_px: int = 320) -> str:
    # longest_px: of a picture
    from dousa.app.pictures.overlay_view import BGR_OF_SIDE, WHITE, draw_lines, find_outlines
    from dousa.extras import cv2

    factor = longest_px / max(mask.shape)
    size = max(1, round(mask.shape[1] * factor)), max(1, round(mask.shape[0] * factor))
    filled = cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.5
    if image is None:
        canvas = np.full((*filled.shape, 3), 246, np.uint8)
        canvas[filled] = (90, 84, 78)
    else:
        canvas = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
        canvas[~filled] = canvas[~filled] // 2 + 100
    outlines = find_outlines(filled)
    if image is not None:
        draw_lines(canvas, outlines, WHITE, 3, closed=True)
    draw_lines(canvas, outlines, BGR_OF_SIDE["left"], 1 if image is None else 2, closed=True)
    return to_picture_address(canvas, longest_px)


def _check_person(asked: EstimationRequest, context: Context, answer: dict[str, Any]) -> None:
    from dousa.app.pipelines.estimation_body import load_body, read_start

    said = None if asked.start is None else read_start(asked.start, asked.options)
    known = read_known_stature(asked.sources)
    if asked.body is None and asked.stature is None and known is None:
        answer["body"] = Message(
            "studio_estimation.stature_of_start" if said is not None else "studio_estimation.stature_of_silhouettes"
        )
        if said is None and len(answer["views"]) == 1:
            answer["notes"].append(Message("studio_estimation.one_view_stature"))
    else:
        _, words, notes = load_body(asked.body, asked.stature, asked.sex, known_stature=known, options=asked.options)
        answer["body"] = shorten(to_message(words), context.home)
        answer["notes"] += notes
    if said is not None:
        answer["start"] = Message("studio_estimation.start", file=said.file.name, frame=said.frame)
        answer["notes"] += said.warnings
