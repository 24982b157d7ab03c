"""Labelling a take, with all that was ever corrected."""

from __future__ import annotations

import json
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any

from dousa.app.studio.problems import RefusedError
from dousa.app.studio.work import Context

if TYPE_CHECKING:
    from dousa.motion import CanonicalMotion

__all__ = ["run"]


def run(request: dict[str, Any], context: Context) -> dict[str, Any]:
    """Label; ``request``: take (a motion by name), threshold."""
    from dousa.app.studio.corrections import Corrections

    take = request["take"]
    corrections = Corrections(context.home).all()
    library = context.open_library()
    context.progress(0, 1, PurePath(str(take["motion"])).name)
    revision = library.stats().revision
    answer = library.label(
        _find(take, context),
        threshold=request.get("threshold"),
        examples=[one.clip_id for one in corrections],
        progress=context.progress,
    ).to_json()
    return {**answer, "take": take["motion"], "n_examples": len(corrections), "revision": revision}


def _find(take: dict[str, Any], context: Context) -> int | CanonicalMotion:
    """What the library is asked about: the number of a take, or the motion of a file."""
    from dousa.library import ReadOptions
    from dousa.library.ingest import read_canonical

    kind, _, rest = str(take["motion"]).partition(":")
    if kind == "clip":
        return int(rest)
    path = _path(kind, rest, context.home)
    options = ReadOptions(take.get("joint_map"), take.get("unit"), take.get("up"), None)
    return read_canonical(str(path), options)[0]


def _path(kind: str, rest: str, home: Path) -> Path:
    from dousa.app.studio.workspace import Workspace

    workspace = Workspace(home)
    if kind == "file":
        batch, _, name = rest.partition("/")
        return workspace.find(batch, name)
    folder = workspace.job_folder(rest)
    try:
        result = json.loads((folder / "job.json").read_bytes())["result"]
        return folder / PurePath(str(result["motion"])).name
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise RefusedError(409, "there is no motion yet; wait for the estimation") from error
