"""Estimating a motion from uploaded silhouettes or films, with every frame shown to those who watch."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dousa.app.studio.content.motions import Address
from dousa.app.studio.core.answers import RefusedError
from dousa.app.studio.core.words import shorten, to_message
from dousa.app.studio.core.workspace import safe_parts
from dousa.app.studio.jobs.lanes import Context
from dousa.app.studio.work.materials import Material, pair_backgrounds, sort_materials
from dousa.app.studio.work.trust import rank_warnings
from dousa.errors import OptionError
from dousa.messages import Message

if TYPE_CHECKING:
    from dousa.app.pipelines.estimate import Estimation
    from dousa.app.pipelines.estimation_request import EstimationRequest, Outputs
    from dousa.app.studio.content.footage import FootageWriter
    from dousa.app.studio.content.masks import StoredMasks
    from dousa.arrays import Image, Mask


def estimate(request: dict[str, Any], context: Context) -> dict[str, Any]:
    """Estimate; ``request`` as `dousa.app.studio.api.estimation.EstimateRequest`, see there.

    The folder of the job then holds motion.bvh, joints.trc and angles.csv, overlay.mp4 if that was wanted, and the
    cameras that films were found to have. Stopped work goes on where it was when the job is resumed.
    """
    from dousa.app.pipelines.estimation_request import Outputs
    from dousa.app.studio.content.footage import FootageWriter
    from dousa.app.studio.content.masks import EXPORTED
    from dousa.app.studio.work.films import CAMERAS

    folder = context.folder
    outputs = Outputs(
        motion=folder / "motion.bvh",
        trc=folder / "joints.trc",
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
    from dousa.app.studio.work.films import can_do_without, estimate_from_films, takes_films

    def tell(note: Message) -> None:
        context.tell(shorten(to_message(note), context.home))

    if request.get("masks"):
        asked, stored = _take_masks(request["masks"], asked, context)
        return estimate_files(asked, context.progress, tell, _PictureBringer(footage, stored))
    if takes_films(request, asked):
        if request.get("cues") is not None or not can_do_without(asked):
            return estimate_from_films(request, asked, context, footage)
        tell(Message("film_estimate.models"))
    return estimate_files(asked, context.progress, tell, footage)


def _take_masks(job: str, asked: EstimationRequest, context: Context) -> tuple[EstimationRequest, StoredMasks]:
    """The request with the repaired silhouettes of a job, and these as they were found.

    They are written into the folder of this job: what is repaired later does not change its result.
    """
    from dousa.app.studio.content.masks import EXPORTED, StoredMasks, export_masks

    folder, path = context.home / "jobs" / job, context.folder / EXPORTED
    if not path.is_file():
        export_masks(folder, path, context.progress)
    stored = StoredMasks(folder)
    cameras = None if stored.has_cameras else asked.cameras
    asked = dataclasses.replace(asked, sources=(path,), backgrounds=(), cameras=cameras, mirrored=False)
    return dataclasses.replace(asked, background_method=None, kind=None, rate=None, frames=None), stored


class _PictureBringer:
    """Shows a watcher the pictures that lie behind repaired silhouettes."""

    def __init__(self, watcher: FootageWriter, stored: StoredMasks) -> None:
        self._watcher, self._stored = watcher, stored
        self.begin, self.follow, self.end = watcher.begin, watcher.follow, watcher.end

    def see(self, frame: int, masks: Sequence[Mask | None], pictures: Sequence[Image | None]) -> None:
        self._watcher.see(frame, masks, self._stored.look(frame))


def write_example(request: dict[str, Any], context: Context) -> dict[str, Any]:
    """A synthetic person kicks, and cameras see nothing but silhouettes.

    Writes ``kick_seen.npz`` into the batch ``request["batch"]``; says the person's stature in m.
    """
    from dousa.app.demo.estimation import write_performance

    truth = context.folder / f"{request['batch']}.bvh"
    try:
        stature = write_performance(truth, _batch_folder(request, context) / "kick_seen.npz")
    finally:
        truth.unlink(missing_ok=True)  # what the person really did stays hidden, as in life
    return {"batch": request["batch"], "stature_m": stature}


def _batch_folder(request: dict[str, Any], context: Context) -> Path:
    """Where the files of a request are."""
    return context.home / "files" / str(request["batch"])


def list_materials(request: dict[str, Any], context: Context) -> tuple[Material, ...]:
    """Every file of the batch and what it is for, if nobody says otherwise."""
    folder = _batch_folder(request, context)
    files = [path for path in folder.rglob("*") if path.is_file() and not path.name.startswith(".")]
    return sort_materials(folder, [path.relative_to(folder).as_posix() for path in files])


def make_request(request: dict[str, Any], context: Context, outputs: Outputs) -> EstimationRequest:
    """The request with real paths; what was not said is found in the files.

    Raises
    ------
    OptionError : no silhouettes.
    RefusedError : a name that is not in the batch.
    """
    from dousa.app.pipelines.estimation_request import EstimationRequest

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
    return EstimationRequest.from_dict({**request, **named})


def _find(folder: Path, name: str) -> Path:
    """A file or folder of a batch; ``"."`` is all of it."""
    path = folder if name == "." else folder.joinpath(*safe_parts(name))
    if not path.exists() or path.is_symlink():
        raise RefusedError(404, "studio_estimation.no_file", name=name)
    return path


def _find_start(request: dict[str, Any], context: Context) -> str | None:
    """``FILE:FRAME`` of the motion that was named."""
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
    """The joints of a clip as a file, as the library has them: where it came from may be gone."""
    from dousa.formats.registry import write_motion

    path = context.folder / "start.trc"
    with context.open_library() as library:
        write_motion(library.trajectories(clip), path)
    return path
