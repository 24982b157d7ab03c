"""Silhouettes of a film or a file written down frame by frame, so that they can be looked through and repaired."""

from __future__ import annotations

import json
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from dousa.app.studio.content.footage import MASK, PICTURE, SEEN
from dousa.app.studio.content.masks import CAMERAS, MEASURES, SCENE
from dousa.app.studio.core.words import shorten, to_message
from dousa.app.studio.jobs.lanes import Context
from dousa.app.studio.work.estimation import make_request
from dousa.errors import CalibrationError, OptionError
from dousa.messages import Message

if TYPE_CHECKING:
    from dousa.app.pipelines.estimation_request import EstimationRequest
    from dousa.arrays import Image, Mask
    from dousa.estimation.silhouettes.silhouettes import Silhouettes

_LONGEST_PICTURE = 720  # px
_QUALITY = 78
_MOST_PICTURE_BYTES = 1_000_000_000


def prepare_masks(request: dict[str, Any], context: Context) -> dict[str, Any]:
    """Write the silhouettes of a request for an estimation into the folder of the job; see there for the files.

    Returns
    -------
    ``n_frames``, ``views`` and ``notes``.
    """
    from dousa.app.pipelines.doubts import WatchedSilhouettes, parse_frames
    from dousa.app.pipelines.estimation_request import Outputs
    from dousa.app.pipelines.estimation_views import open_bare_views, open_views, read_known_stature
    from dousa.extras import require

    require("cv2", "film")
    asked = make_request(request, context, Outputs())
    context.progress(0, 1, Message("progress.opening"))
    can_tell = asked.cameras is not None or all(path.suffix.lower() == ".npz" for path in asked.sources)
    with (open_views if can_tell else open_bare_views)(asked, context.progress) as opened:
        views = WatchedSilhouettes(opened, *parse_frames(asked.frames, opened.n_frames, Message("frames.recording")))
        has_cameras = can_tell and _write_cameras(asked, views, context)
        measures = _write_frames(views, context)
        notes = [shorten(to_message(note), context.home) for note in (*views.warnings, *views.describe())]
    for note in notes:
        context.tell(note)
    np.save(context.folder / MEASURES, measures)
    scene = {
        "names": views.names,
        "sizes": views.sizes,
        "frame_rate": views.frame_rate,
        "n_frames": views.n_frames,
        "stature": read_known_stature(asked.sources),
        "cameras": has_cameras,
    }
    (context.folder / SCENE).write_text(json.dumps(scene), encoding="utf-8")
    return {"n_frames": views.n_frames, "views": list(views.names)}


def _write_cameras(asked: EstimationRequest, views: Silhouettes, context: Context) -> bool:
    """Whether there is a camera for each view; silhouettes can be repaired without."""
    from dousa.app.pipelines.estimation_views import choose_cameras
    from dousa.estimation.cameras.camera_files import write_cameras

    try:
        cameras, _ = choose_cameras(asked, views)
    except (CalibrationError, OptionError) as error:
        context.tell(shorten(error.located, context.home))
        return False
    write_cameras(context.folder / CAMERAS, cameras)
    return True


def _write_frames(views: Silhouettes, context: Context) -> Any:
    """Write every frame; (2, V, T) measures of the masks."""
    from dousa.estimation.silhouettes.mask_doubts import measure_mask

    measures = np.full((2, views.n_views, views.n_frames), np.nan)
    with open(context.folder / "seen.bin", "wb") as seen, open(context.folder / "seen.idx", "wb") as index:
        for frame in range(views.n_frames):
            masks = views.read(frame)
            pictures = views.look(frame) if seen.tell() < _MOST_PICTURE_BYTES else (None,) * views.n_views
            for view, (mask, picture) in enumerate(zip(masks, pictures, strict=True)):
                measured = measure_mask(mask)
                measures[:, view, frame] = measured.area, measured.second
                if mask is not None:
                    _put(seen, index, (frame, view, MASK), _pack_mask(mask))
                if picture is not None:
                    _put(seen, index, (frame, view, PICTURE), _pack_picture(picture))
            context.progress(frame + 1, views.n_frames, Message("studio_masks.preparing"))
    return measures


def _put(seen: IO[bytes], index: IO[bytes], where: tuple[int, int, int], content: bytes) -> None:
    index.write(np.array([(*where, seen.tell(), len(content))], SEEN).tobytes())
    seen.write(content)


def _pack_mask(mask: Mask) -> bytes:
    from dousa.extras import cv2

    image = np.ascontiguousarray(mask, bool).view(np.uint8) * np.uint8(255)
    return bytes(cv2.imencode(".png", image, [cv2.IMWRITE_PNG_BILEVEL, 1])[1].tobytes())


def _pack_picture(picture: Image) -> bytes:
    from dousa.extras import cv2

    height, width = picture.shape[:2]
    factor = min(1.0, _LONGEST_PICTURE / max(height, width))
    size = max(1, round(width * factor)), max(1, round(height * factor))
    small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    return bytes(cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1].tobytes())
