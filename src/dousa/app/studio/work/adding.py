"""Adding uploaded files to the library."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from dousa.app.studio.work import Context

__all__ = ["run"]


def run(request: dict[str, Any], context: Context) -> dict[str, Any]:
    """Add a batch; ``request``: batch, kind, category_from, performer_from, unit, up, joint_map."""
    folder = context.home / "files" / str(request["batch"])
    with context.open_library() as library:
        report = library.add(
            [folder],
            kind=request["kind"],
            category_from=request.get("category_from"),
            performer_from=request.get("performer_from"),
            joint_map=request.get("joint_map"),
            unit=request.get("unit"),
            up=request.get("up"),
            progress=lambda done, total, path: context.progress(done, total, Path(path).name),
        )
        answer = report.to_json()
    return _without_folder(answer, f"{folder}/")


def _without_folder(value: Any, folder: str) -> Any:
    """Reports name files as they were dropped; where the studio keeps them concerns nobody."""
    if isinstance(value, dict):
        return {key: _without_folder(item, folder) for key, item in value.items()}
    if isinstance(value, list):
        return [_without_folder(item, folder) for item in value]
    return value.replace(folder, "") if isinstance(value, str) else value
