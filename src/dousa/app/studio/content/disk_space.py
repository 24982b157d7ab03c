"""What a studio keeps on the disk, and what of it can go."""

from __future__ import annotations

import json
import os
import shutil
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dousa.app.studio.content.corrections import Corrections
from dousa.app.studio.core.answers import RefusedError
from dousa.app.studio.core.workspace import measure
from dousa.app.studio.jobs.board import ACTIVE

if TYPE_CHECKING:
    from dousa.app.studio.content.studio import Studio


def describe_space(studio: Studio) -> dict[str, Any]:
    """Bytes of library, uploads and jobs, what `free_space` would give back, and what is left of the disk.

    ``removed_bytes`` are those of removed clips that the library keeps for an undo; `Library.compact` forgets them.
    """
    root = studio.workspace.root
    library = studio.settings.library
    return {
        "library_bytes": sum(
            measure(path)
            for path in library.parent.glob(f"{library.name}*")
            if path.is_file() or path.name == f"{library.name}.fragments"
        ),
        "has_fragments": library.with_name(f"{library.name}.fragments").is_dir(),
        "uploads_bytes": measure(root / "files"),
        "jobs_bytes": measure(root / "jobs"),
        "removed_bytes": sum(entry.kept_bytes for entry in studio.library.journal()),
        "can_be_freed_bytes": sum(measure(path) for path in (*_list_exports(studio).values(), *_list_unused(studio))),
        "disk_free_bytes": shutil.disk_usage(root).free,
    }


def free_space(studio: Studio) -> dict[str, Any]:
    """Take away uploads that nothing uses, and forget finished exports: they can be made again."""
    before = describe_space(studio)["can_be_freed_bytes"]
    for folder in _list_unused(studio):
        shutil.rmtree(folder, ignore_errors=True)
    Corrections(studio.workspace.root).forget_missing({clip.id for clip in studio.listing.now().clips})
    for job in _list_exports(studio):
        with suppress(RefusedError):  # somebody else forgot it
            studio.jobs.remove(job)
    after = describe_space(studio)
    return {"freed_bytes": max(before - after["can_be_freed_bytes"], 0), **after}


def _list_exports(studio: Studio) -> dict[str, Path]:
    """Folders of exports that are over, by number."""
    over = (job for job in studio.jobs.all() if job.kind == "export" and job.state not in ACTIVE)
    return {job.id: studio.jobs.folder(job) for job in over}


def _list_unused(studio: Studio) -> list[Path]:
    """Batches that no job names and from which no clip comes, also none that an undo brings back."""
    asked = [json.dumps([job.request for job in studio.jobs.all()])]
    files = f"{studio.workspace.root / 'files'}{os.sep}"
    paths = [clip.path for clip in studio.listing.now().clips] + studio.library.removed_paths()
    asked += {path.removeprefix(files).partition(os.sep)[0] for path in paths if path.startswith(files)}
    return studio.workspace.list_unused(" ".join(asked))
