"""Adding uploaded files to the library."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from dousa.app.studio.work import Context

if TYPE_CHECKING:
    from dousa.library import Library

__all__ = ["run"]

_MOST_DRAWN = 2_000  # clips whose figures are made ahead; a longer list gets its own when it is looked at


def run(request: dict[str, Any], context: Context) -> dict[str, Any]:
    """Add a batch; ``request``: batch, kind, category_from, performer_from, unit, up, joint_map."""
    folder = context.home / "files" / str(request["batch"])
    with context.open_library() as library:
        before = {clip.id for clip in library.clips()}
        report = library.add(
            [folder],
            kind=request["kind"],
            category_from=_inside(request.get("category_from"), folder),
            performer_from=_inside(request.get("performer_from"), folder),
            joint_map=request.get("joint_map"),
            unit=request.get("unit"),
            up=request.get("up"),
            progress=lambda done, total, path: context.progress(done, total, Path(path).name),
        )
        if report.added or report.replaced:
            _draw_ahead(library, before, context)
        answer = report.to_json()
    return _without_folder(answer, f"{folder}/")


def _inside(rule: str | None, folder: Path) -> str | None:
    """A rule whose table, if it names one, is a file of the batch: no other file of this machine is read."""
    from dousa.app.studio.workspace import safe_parts

    kind, _, name = (rule or "").partition(":")
    return f"csv:{folder.joinpath(*safe_parts(name))}" if kind == "csv" and name else rule


def _draw_ahead(library: Library, before: set[int], context: Context) -> None:
    """Make the small figures of what is new, so that the page shows them at once."""
    from dousa.app.studio.shelf.thumbnails import Thumbnails

    fresh = [clip.id for clip in library.clips() if clip.id not in before][:_MOST_DRAWN]
    Thumbnails.of(context.home).make_ahead(library, fresh)


def _without_folder(value: Any, folder: str) -> Any:
    """Reports name files as they were dropped; where the studio keeps them concerns nobody."""
    if isinstance(value, dict):
        return {key: _without_folder(item, folder) for key, item in value.items()}
    if isinstance(value, list):
        return [_without_folder(item, folder) for item in value]
    return value.replace(folder, "") if isinstance(value, str) else value
