"""Estimate a motion from uploaded silhouettes or films, recorded frame by frame; rate how far it can be trusted."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator, Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dousa.app.pipelines.doubts import WatchedSilhouettes, parse_frames
from dousa.app.pipelines.estimation_views import choose_cameras, open_bare_views, open_views, read_known_stature
from dousa.app.pipelines.projects import complete_request
from dousa.app.studio.content.film_record import FILM_SIDE, encode_jpeg, encode_mask, shrink
from dousa.app.studio.content.footage import MASK, PICTURE, FootageWriter, SeenWriter
from dousa.app.studio.content.masks import CAMERAS, EXPORTED, MEASURES, SCENE, StoredMasks, export_masks
from dousa.app.studio.content.motions import Address
from dousa.app.studio.core.answers import RefusedError, shorten, to_message
from dousa.app.studio.core.workspace import safe_parts
from dousa.app.studio.jobs.lanes import Context
from dousa.app.studio.work.materials import Material, open_batch, pair_backgrounds, sort_materials, sort_project
from dousa.arrays import Image, Mask
from dousa.errors import CalibrationError, OptionError
from dousa.estimation.silhouettes.cleaning import measure_mask
from dousa.estimation.silhouettes.silhouettes import Silhouettes
from dousa.extras import require
from dousa.formats.registry import write_motion
from dousa.messages import Message

if TYPE_CHECKING:
    from dousa.app.pipelines.estimate import Estimation
    from dousa.app.requests.estimation import EstimationRequest, Outputs


def estimate(request: dict[str, Any], context: Context) -> dict[str, Any]:
    """Estimate; ``request`` as `dousa.app.studio.api.estimation.EstimateRequest`.

    The folder of the job then holds motion.bvh, joints.trc, angles.csv, on request overlay.mp4, and the cameras found
    for films. A stopped job continues where it was when it is resumed.
    """
    from dousa.app.requests.estimation import Outputs
    from dousa.app.studio.work.films import CAMERAS

    folder = context.folder
    outputs = Outputs(
        (folder / "motion.bvh", folder / "joints.trc"),
        angles=folder / "angles.csv",
        overlay=folder / "overlay.mp4" if request.get("overlay_video") else None,
    )
    with closing(FootageWriter(folder)) as footage:
        done = _estimate(request, make_request(request, context, outputs), context, footage)
    said = {"body": done.body, "start": done.start}
    answer = done.to_json()
    lost_share = len(answer["lost_frames"]) / max(answer["n_frames"], 1)
    said_of_it = [shorten(to_message(warning), context.home) for warning in done.warnings]
    trust, warnings, weights = rank_warnings(said_of_it, lost_share)
    return {
        **{key: value for key, value in answer.items() if key != "outputs"},
        **{key: shorten(to_message(value), context.home) for key, value in said.items()},
        "trust": trust,
        "warnings": warnings,
        "warning_weights": weights,
        "motion": "motion.bvh",
        "files": [path.name for path in done.outputs] + [one for one in (CAMERAS, EXPORTED) if (folder / one).exists()],
    }


def _estimate(
    request: dict[str, Any], asked: EstimationRequest, context: Context, footage: FootageWriter
) -> Estimation:
    from dousa.app.pipelines.estimate import estimate_files
    from dousa.app.studio.work.films import estimate_from_films, takes_films

    def tell(note: Message) -> None:
        context.tell(shorten(to_message(note), context.home))

    if request.get("masks"):
        asked, stored = _take_masks(request["masks"], asked, context)
        return estimate_files(asked, context.progress, tell, _PictureBringer(footage, stored))
    if takes_films(request, asked, tell):
        return estimate_from_films(request, asked, context, footage, tell)
    return estimate_files(asked, context.progress, tell, footage)


def _take_masks(job: str, asked: EstimationRequest, context: Context) -> tuple[EstimationRequest, StoredMasks]:
    """Replace the sources by a copy of the repaired silhouettes of a job, which later repairs do not change."""
    folder, path = context.home / "jobs" / job, context.folder / EXPORTED
    if not path.is_file():
        export_masks(folder, path, context.progress)
    stored = StoredMasks(folder)
    cameras = None if stored.has_cameras else asked.cameras
    asked = dataclasses.replace(asked, sources=(path,), backgrounds=(), cameras=cameras, mirrored=False)
    return dataclasses.replace(asked, background_method=None, kind=None, rate=None, frames=None), stored


class _PictureBringer:
    """Shows a watcher the pictures behind repaired silhouettes."""

    def __init__(self, watcher: FootageWriter, stored: StoredMasks) -> None:
        self._watcher, self._stored = watcher, stored
        self.begin, self.follow, self.end = watcher.begin, watcher.follow, watcher.end

    def see(self, frame: int, masks: Sequence[Mask | None], pictures: Sequence[Image | None]) -> None:
        self._watcher.see(frame, masks, self._stored.look(frame))


def write_example(request: dict[str, Any], context: Context) -> dict[str, Any]:
    """Write ``kick_seen.npz``, silhouettes of a synthetic person who kicks, into a batch; returns the stature in m."""
    from dousa.app.demo import write_performance

    truth = context.folder / f"{request['batch']}.bvh"
    try:
        stature = write_performance(truth, _batch_folder(request, context) / "kick_seen.npz")
    finally:
        truth.unlink(missing_ok=True)  # what the person really did stays hidden, as in life
    return {"batch": request["batch"], "stature_m": stature}


def _batch_folder(request: dict[str, Any], context: Context) -> Path:
    return context.home / "files" / str(request["batch"])


def list_materials(request: dict[str, Any], context: Context) -> tuple[Material, ...]:
    """List the files of the batch and their default roles."""
    folder = _batch_folder(request, context)
    files = [path for path in folder.rglob("*") if path.is_file() and not path.name.startswith(".")]
    names = [path.relative_to(folder).as_posix() for path in files]
    opened = open_batch(folder)
    return sort_materials(folder, names) if opened is None else sort_project(folder, names, *opened)


def make_request(request: dict[str, Any], context: Context, outputs: Outputs) -> EstimationRequest:
    """Complete a request by what its files contain, with real paths.

    Raises OptionError without silhouettes, RefusedError for a name that is not in the batch.
    """
    from dousa.app.requests.estimation import EstimationRequest

    roles: dict[str, list[str]] = {}
    if request.get("sources") is None:
        for item in list_materials(request, context):
            roles.setdefault(item.role, []).append(item.name)
    names = request.get("sources") or roles.get("source", [])
    if not names:
        raise OptionError("studio_estimation.no_sources")

    def place(name: str) -> Path:
        return _find(_batch_folder(request, context), name)

    def single(key: str, role: str) -> Path | None:
        name = request.get(key) or next(iter(roles.get(role, [])), None)
        return None if name is None else place(name)

    sources = [place(name) for name in names]
    backgrounds = [place(name) for name in request.get("backgrounds") or roles.get("background", [])]
    body = request.get("body") or {}
    start = _find_start(request, context)
    if start is None and roles.get("start"):
        start = f"{place(roles['start'][0])}:0"
    said = request.get("start") or {}
    body_name = body.get("file") or next(iter(roles.get("body", [])), None)
    named = dataclasses.asdict(outputs) | {
        "sources": sources,
        "backgrounds": pair_backgrounds(sources, backgrounds),
        "cameras": single("cameras", "cameras"),
        "body": None if body_name is None else place(body_name),
        "stature": body.get("stature_m"),
        "sex": body.get("sex"),
        "start": start,
        "person": None,  # of films, by tracks: see `dousa.app.studio.work.films`
        **{name: said.get(name) for name in ("joint_map", "unit", "up")},
    }
    asked = EstimationRequest.from_dict({**request, **named})
    opened = open_batch(_batch_folder(request, context))
    if opened is None or not set(sources) <= {*opened[1].films, *opened[1].keypoints}:
        return asked
    cameras = asked.cameras  # a calibration that was taken away stays away
    return dataclasses.replace(complete_request(asked, *opened, tuple(sources))[0], cameras=cameras)


def _find(folder: Path, name: str) -> Path:
    """Return a file or folder of a batch; ``"."`` is the batch itself."""
    path = folder if name == "." else folder.joinpath(*safe_parts(name))
    if not path.exists() or path.is_symlink():
        raise RefusedError(404, "studio_estimation.no_file", name=name)
    return path


def _find_start(request: dict[str, Any], context: Context) -> str | None:
    """Return ``FILE:FRAME`` of the start."""
    said = request.get("start")
    if said is None:
        return None
    address = Address.parse(said["motion"])
    if address.clip is not None:
        path = _write_clip(address.clip, context)
    elif address.batch:
        path = _find(context.home / "files" / address.batch, address.name)
    else:
        path = context.home / "jobs" / address.job / "motion.bvh"
        if not path.is_file():
            raise RefusedError(409, "studio_estimation.no_start", job=address.job)
    return f"{path}:{said.get('frame') or 0}"


def _write_clip(clip: int, context: Context) -> Path:
    path = context.folder / "start.trc"
    with context.open_library() as library:
        write_motion(library.trajectories(clip), path)
    return path


# The motion is wrong, or most likely so.
_WRONG = frozenset({"doubts.bad_overlap", "film_estimate.far_off", "film_estimate.disagree", "start.far_off"})
# It should be looked at before it is used.
_DOUBTFUL = frozenset(
    {
        *(f"doubts.{name}" for name in ("girth", "low_overlap", "odd_view", "one_view", "camera_inside", "full")),
        *(f"doubts.{name}" for name in ("second_region", "cut_off", "empty")),
        *(f"tracker.{name}" for name in ("start_doubtful", "restarted", "lost")),
        *(
            f"film_estimate.{name}"
            for name in ("absent", "exchanged", "lens_assumed", "lost", "not_synchronised", "off")
        ),
        *(f"film_estimate.{name}" for name in ("odd_stature", "one_view", "upright_assumed", "left_out")),
        *(f"calibration.{name}" for name in ("unsure", "doubtful", "few_agree", "hardly_moves")),
        *(f"sync.{name}" for name in ("ambiguous", "disagree")),
        *(f"background.{name}" for name in ("all_moves", "nothing_moves", "plate_moved", "unlike")),
        "body.stature_assumed",
        "film.several",
    }
)
GOOD, DOUBTFUL, WRONG = "good", "unsure", "bad"
_LEVELS = (GOOD, DOUBTFUL, WRONG)


def rank_warnings(warnings: Sequence[Message], lost_share: float) -> tuple[str, list[Message], list[str]]:
    """Sort warnings by their weight.

    Parameters
    ----------
    warnings : of the estimation.
    lost_share : share of lost frames, 0 to 1.

    Returns
    -------
    ``good``, ``unsure`` or ``bad`` for the whole; the warnings, the gravest first; the same word for each of them.
    """
    weighed = [(max(map(_weigh, _codes(one)), default=0), one) for one in warnings]
    weighed.sort(key=lambda pair: -pair[0])
    # share of frames beyond which there is hardly a motion
    worst = max([weight for weight, _ in weighed] + [2 if lost_share > 0.5 else 0])
    return _LEVELS[worst], [one for _, one in weighed], [_LEVELS[weight] for weight, _ in weighed]


def _weigh(code: str) -> int:
    return 2 if code in _WRONG else 1 if code in _DOUBTFUL else 0


def _codes(value: Any) -> Iterator[str]:
    if isinstance(value, Message):
        yield value.code
        for one in value.values.values():
            yield from _codes(one)
    elif isinstance(value, tuple | list):
        for one in value:
            yield from _codes(one)


def prepare_masks(request: dict[str, Any], context: Context) -> dict[str, Any]:
    """Write the silhouettes of an estimation's request into the folder of the job, see
    `dousa.app.studio.content.masks`."""
    from dousa.app.requests.estimation import Outputs

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
    """Write a camera for each view; returns whether they are known. Silhouettes can be repaired without."""
    from dousa.estimation.cameras.camera_files import write_cameras

    try:
        cameras, _ = choose_cameras(asked, views)
    except (CalibrationError, OptionError) as error:
        context.tell(shorten(error.located, context.home))
        return False
    write_cameras(context.folder / CAMERAS, cameras)
    return True


def _write_frames(views: Silhouettes, context: Context) -> Any:
    measures = np.full((2, views.n_views, views.n_frames), np.nan)
    with closing(SeenWriter(context.folder)) as seen:
        for frame in range(views.n_frames):
            masks = views.read(frame)
            pictures = views.look(frame) if seen.n_bytes < 1_000_000_000 else (None,) * views.n_views
            for view, (mask, picture) in enumerate(zip(masks, pictures, strict=True)):
                measures[:, view, frame] = measure_mask(mask)
                if mask is not None:
                    seen.write(frame, view, MASK, encode_mask(mask))
                if picture is not None:
                    seen.write(frame, view, PICTURE, encode_jpeg(shrink(picture, FILM_SIDE), 78))
            context.progress(frame + 1, views.n_frames, Message("studio_masks.preparing"))
    return measures
