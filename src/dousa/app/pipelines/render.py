"""From a motion file to silhouettes on the disk: ``dousa render`` without its options."""

from __future__ import annotations

import os
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dousa.app.pipelines.doubts import parse_frames
from dousa.app.pipelines.estimation_body import GivenBody, load_body, load_given_body
from dousa.app.pipelines.estimation_output import check_file
from dousa.app.targets import SILHOUETTES, check_targets
from dousa.arrays import FloatArray
from dousa.errors import OptionError
from dousa.messages import Message

if TYPE_CHECKING:
    from collections.abc import Sequence

    from dousa.app.output import ProgressCallback
    from dousa.app.requests.estimation import RenderRequest
    from dousa.estimation import BodyModel, Camera
    from dousa.motion import CanonicalMotion


def render_file(request: RenderRequest, progress: ProgressCallback | None = None) -> dict[str, Any]:
    """Render a motion file into an npz of silhouettes with cameras, stature and the true joints.

    Parameters
    ----------
    request : what is to be rendered.
    progress : called with (views done, views, what is being done).

    Returns
    -------
    What ``dousa render --json`` prints.

    Raises
    ------
    DousaError : what can be put right by the person who reads it.
    """
    from dousa.estimation.silhouettes.mask_npz import write_silhouettes

    report = progress or (lambda done, total, what: None)
    _check_output(request)
    report(0, 1, Message("progress.reading"))
    motion = _read_motion(request)
    body, body_words, notes = _choose_body(request, motion)
    report(0, 1, Message("progress.posing"))
    names, points, poses = _pose_body(body, motion)
    cameras, more = _choose_cameras(request, points)
    masks = _draw(request, body, poses, cameras, report)
    unseen = [camera.name for camera, view in zip(cameras, masks, strict=True) if not view.any()]
    if len(unseen) == len(cameras):
        raise OptionError("render.unseen", path=request.motion)
    more += [Message("render.unseen_in_view", view=name) for name in unseen]
    report(len(cameras), len(cameras), Message("progress.writing"))
    write_silhouettes(request.output, masks, cameras, request.rate, stature=body.stature, truth=(names, points))
    return {
        "path": str(request.output),
        "n_frames": len(poses),
        "frame_rate": request.rate,
        "views": [camera.name for camera in cameras],
        "sizes": [[camera.width, camera.height] for camera in cameras],
        "body": str(body_words),
        "stature_m": body.stature,
        "noise": request.noise,
        "warnings": [str(warning) for warning in (*motion.warnings, *notes, *more)],
    }


def _check_output(request: RenderRequest) -> None:
    if request.output.suffix.lower() != ".npz":
        raise OptionError("render.not_npz", path=request.output)
    inputs = [path for path in (request.motion, request.cameras, request.body) if path is not None]
    if os.path.realpath(request.output) in {os.path.realpath(path) for path in inputs}:
        raise OptionError("outputs.is_input", option="--output", path=request.output)
    check_file(request.output)
    check_targets({"--output": request.output}, (), SILHOUETTES)


def _read_motion(request: RenderRequest) -> CanonicalMotion:
    from dousa.formats.motion_files import read_with
    from dousa.motion import canonicalise, resample

    options = request.options
    sampled = resample(read_with(request.motion, options), request.rate)  # type: ignore[type-var]  # one kind or the other, not both
    motion = canonicalise(sampled, options.joint_map, whole=True)
    first, last = parse_frames(
        request.frames, motion.n_frames, Message("frames.motion", path=request.motion, rate=request.rate)
    )
    return replace(motion, positions=motion.positions[first:last], missing=None)


def _choose_body(request: RenderRequest, motion: CanonicalMotion) -> GivenBody:
    if request.body is None and request.stature is None:
        from dousa.estimation.body.skeleton_body import body_from_motion

        body = body_from_motion(motion, request.sex)
        return body, Message("body.bones_of", path=request.motion), ()
    if request.body is not None and request.stature is None:
        body, notes = load_given_body(request.body, request.options)
        return body, Message("text.verbatim", text=request.body), notes
    return load_body(request.body, request.stature, request.sex, known_stature=None, options=request.options)


def _pose_body(body: BodyModel, motion: CanonicalMotion) -> tuple[tuple[str, ...], FloatArray, FloatArray]:
    """The body following the joints: names and places (T, P + K, 3) of its own joints, poses (T, 7 + A)."""
    from dousa.estimation.body.kinematics import compute_points, point_names
    from dousa.estimation.body.posing import fit_poses
    from dousa.motion import CANONICAL_JOINTS

    poses, _ = fit_poses(body, motion.positions)
    names, points = point_names(body), compute_points(body, poses)
    if set(CANONICAL_JOINTS) <= set(names):
        points = points[:, [names.index(name) for name in CANONICAL_JOINTS]]
        names = CANONICAL_JOINTS
    return names, points, poses


def _choose_cameras(request: RenderRequest, points: FloatArray) -> tuple[tuple[Camera, ...], list[Message]]:
    if request.cameras is None:
        return ring_around(points, request.n_ring, request.size or (320, 240)), []
    from dousa.estimation.cameras.camera import fit_cameras
    from dousa.estimation.cameras.camera_files import read_cameras

    cameras = read_cameras(request.cameras)
    if request.size is None:
        return tuple(cameras), []
    fitted, notes = fit_cameras(cameras, [request.size] * len(cameras))
    return fitted, list(notes)


def ring_around(
    points: FloatArray, n_views: int, size: tuple[int, int], margin: float = 0.12, nearest: float = 3.0
) -> tuple[Camera, ...]:
    """A ring of cameras that see a body wherever it goes.

    Parameters
    ----------
    points : (T, K, 3) m, its joints.
    n_views : number of cameras.
    size : px, width and height.
    margin : m, of the body round its joints.
    nearest : m, of a camera.
    """
    from dousa.estimation.cameras.camera import make_ring

    low, high = points.min(axis=(0, 1)) - margin, points.max(axis=(0, 1)) + margin
    middle = (low + high) / 2.0
    radius = float(np.hypot(*(high - low)[[0, 2]])) / 2.0
    # Half the image at a distance of 1 m; the focal length of `make_ring` is 1.25 shorter sides.
    width, height = (side / (2.0 * 1.25 * min(size)) for side in size)
    distance = max(nearest, radius + float(high[1] - low[1]) / 2.0 / height, radius + radius / width)
    return make_ring(n_views, target=middle, distance=distance, height=float(middle[1] + 0.4), size=size)


def _draw(
    request: RenderRequest,
    body: BodyModel,
    poses: FloatArray,
    cameras: Sequence[Camera],
    report: ProgressCallback,
) -> list[NDArray[np.bool_]]:
    from dousa.estimation.raster.rasteriser import draw_body
    from dousa.estimation.raster.rendering import spoil

    masks = []
    for number, camera in enumerate(cameras):
        report(number, len(cameras), Message("progress.rendering"))
        seen = draw_body(body, poses, camera)
        if request.noise == "noisy":
            seen = spoil(seen, np.random.default_rng([request.seed, number]))
        masks.append(seen)
    return masks
