"""What the studio was asked to estimate, as `dousa.app.estimating` wants it; and messages without paths and options."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dousa.app.studio.footage.materials import Material, pair_backgrounds, sort_materials
from dousa.app.studio.problems import RefusedError
from dousa.app.studio.work import Context
from dousa.app.studio.workspace import safe_parts
from dousa.errors import DousaError, OptionError

if TYPE_CHECKING:
    from dousa.app._estimation_output import Outputs
    from dousa.app.estimating import Request
    from dousa.estimation._types import TrackerSettings

__all__ = ["batch_folder", "list_materials", "make_request", "plain_words", "said_plainly"]

_OPTIONS = (
    ("--cameras FILE", "a calibration file"),
    ("--sheet or --overlay", "the overlay"),
    ("--stature M", "the stature"),
    ("--no-stature", "no stature"),
    ("no --stature and no --body", "no stature and no body file"),
    ("--mirror-left-right", "mirror images"),
    ("--bones start", "limbs of the start"),
)
_SETTINGS = ("reading", "evidence", "smoothing", "beam")


def batch_folder(request: dict[str, Any], context: Context) -> Path:
    """Where the files of a request are."""
    return context.home / "files" / str(request["batch"])


def list_materials(request: dict[str, Any], context: Context) -> tuple[Material, ...]:
    """Every file of the batch and what it is for, if nobody says otherwise."""
    folder = batch_folder(request, context)
    files = [path for path in folder.rglob("*") if path.is_file() and not path.name.startswith(".")]
    return sort_materials(folder, [path.relative_to(folder).as_posix() for path in files])


def make_request(request: dict[str, Any], context: Context, outputs: Outputs) -> Request:
    """The request with real paths; what was not said is told by the files.

    Raises
    ------
    OptionError : no silhouettes.
    RefusedError : a name that is not in the batch.
    """
    from dousa.app.estimating import Request
    from dousa.library import ReadOptions

    roles: dict[str, list[str]] = {}
    if request.get("sources") is None:
        for item in list_materials(request, context):
            roles.setdefault(item.role, []).append(item.name)
    names = request.get("sources") or roles.get("source", [])
    if not names:
        raise OptionError(
            "the silhouettes are missing: give an npz file of silhouettes, or for each camera a folder of masks or "
            "a video"
        )

    def place(name: str) -> Path:
        return _find(batch_folder(request, context), name)

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
    return Request(
        sources=tuple(sources),
        settings=_make_settings(request),
        outputs=outputs,
        cameras=single("cameras", "cameras"),
        backgrounds=tuple(pair_backgrounds(sources, backgrounds)),
        background_method=request.get("background_method"),
        kind=request.get("kind"),
        rate=request.get("rate"),
        frames=request.get("frames"),
        mirrored=bool(request.get("mirrored")),
        body=None if body_name is None else place(body_name),
        stature=body.get("stature_m"),
        sex=body.get("sex") or "average",
        start=start,
        bones=request.get("bones") or "auto",
        options=ReadOptions(said.get("joint_map"), said.get("unit"), said.get("up"), None),
    )


def _find(folder: Path, name: str) -> Path:
    """A file or folder of a batch; ``"."`` is all of it."""
    path = folder if name == "." else folder.joinpath(*safe_parts(name))
    if not path.exists() or path.is_symlink():
        raise RefusedError(404, f"no file or folder {name!r} in this batch; upload it again")
    return path


def _find_start(request: dict[str, Any], context: Context) -> str | None:
    """``FILE:FRAME`` of the motion that was named."""
    said = request.get("start")
    if said is None:
        return None
    kind, _, rest = str(said["motion"]).partition(":")
    if kind == "file":
        batch, _, name = rest.partition("/")
        path = _find(context.home / "files" / batch, name)
    elif kind == "job":
        path = context.home / "jobs" / rest / "motion.bvh"
        if not path.is_file():
            raise RefusedError(409, f"job {rest} has no motion; choose another start")
    else:
        path = _write_clip(int(rest), context)
    return f"{path}:{said.get('frame') or 0}"


def _write_clip(clip: int, context: Context) -> Path:
    """The joints of a clip as a file, as the library has them: where it came from may be gone."""
    from dousa.formats import write_motion

    path = context.folder / "start.trc"
    with context.open_library() as library:
        write_motion(library.trajectories(clip), path)
    return path


def _make_settings(request: dict[str, Any]) -> TrackerSettings:
    from dousa.estimation._types import PAPER, TrackerSettings

    preset = PAPER if request.get("method") == "paper" else TrackerSettings()
    said = {name: request[name] for name in _SETTINGS if request.get(name) is not None}
    return dataclasses.replace(preset, **said)


@contextmanager
def said_plainly(request: dict[str, Any], context: Context) -> Iterator[None]:
    """Problems named as the page names things."""
    try:
        yield
    except DousaError as error:
        raise RefusedError(422, plain_words(str(error), request, context)) from error


def plain_words(text: str, request: dict[str, Any], context: Context) -> str:
    """A message without the studio's folders and without the options of the command line."""
    text = re.sub(re.escape(str(context.home)) + r"/(files|jobs)/[0-9a-f]{16}/", "", text)
    for folder in (batch_folder(request, context), context.folder, context.home / "files"):
        text = text.replace(f"{folder}/", "").replace(str(folder), "these files")
    for option, words in _OPTIONS:
        text = text.replace(option, words)
    return re.sub(r"--([a-z][a-z-]+)", lambda found: found[1].replace("-", " "), text)
