"""Measure what a studio keeps on the disk, and delete what nothing needs."""

from __future__ import annotations

import json
import os
import shutil
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dousa.app.studio.content.companions import COMPANIONS
from dousa.app.studio.core.answers import RefusedError
from dousa.app.studio.core.workspace import measure
from dousa.app.studio.jobs.board import ACTIVE

if TYPE_CHECKING:
    from dousa.app.studio.content.studio import Studio


_DAY = 86_400.0  # s, by definition


def describe_space(studio: Studio, *, old_days: int = 30) -> dict[str, Any]:
    """Measure library, uploads and jobs, what `free_space` would free, and what is left of the disk, in bytes.

    ``removed_bytes`` are those of removed clips that the library keeps for an undo until `Library.compact`.
    ``old_bytes`` are those of uploads of deleted jobs that were not used for ``old_days``, which are offered to be
    taken away; with fewer what somebody comes back for after a holiday would be.
    """
    root = studio.workspace.root
    library = studio.settings.library.resolve()
    mentioned = _list_mentioned(studio)
    unused = studio.workspace.list_unused(mentioned)
    outlived = _list_old(studio, mentioned, old_days)
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
        "can_be_freed_bytes": sum(measure(path) for path in (*_list_exports(studio).values(), *unused)),
        "old_bytes": sum(measure(path) for path in outlived),
        "oldest_days": int(max(outlived.values(), default=0.0) / _DAY),
        "disk_free_bytes": shutil.disk_usage(root).free,
    }


def free_space(studio: Studio, older_days: int | None = None) -> dict[str, Any]:
    """Delete unused uploads and finished exports, which can be made again.

    Parameters
    ----------
    older_days : also uploads of deleted jobs that were not used for so many days.
    """
    before = describe_space(studio)
    mentioned = _list_mentioned(studio)
    old = [] if older_days is None else list(_list_old(studio, mentioned, older_days))
    size = before["can_be_freed_bytes"] + sum(measure(folder) for folder in old)
    for folder in (*studio.workspace.list_unused(mentioned), *old):
        shutil.rmtree(folder, ignore_errors=True)
    for job in _list_exports(studio):
        with suppress(RefusedError):  # removed meanwhile
            studio.jobs.remove(job)
    after = describe_space(studio)
    left = after["can_be_freed_bytes"] + sum(measure(folder) for folder in old)
    return {"freed_bytes": max(size - left, 0), **after}


def _list_exports(studio: Studio) -> dict[str, Path]:
    """List the folders of finished exports by number."""
    over = (job for job in studio.jobs.all() if job.kind == "export" and job.state not in ACTIVE)
    return {job.id: studio.jobs.folder(job) for job in over}


def _list_old(studio: Studio, mentioned: str, days: int) -> dict[Path, float]:
    found = studio.workspace.list_outlived(mentioned)
    return {folder: age for folder, age in found.items() if age > days * _DAY}


def _list_mentioned(studio: Studio) -> str:
    """Join the names of all batches that a job names or from which a clip comes, including clips that an undo brings
    back."""
    asked = [json.dumps([job.request for job in studio.jobs.all()])]
    for path in (studio.workspace.root / "jobs").glob(f"*/{COMPANIONS}"):
        with suppress(OSError):  # removed meanwhile
            asked.append(path.read_text())
    files = f"{studio.workspace.root / 'files'}{os.sep}"
    paths = [clip.path for clip in studio.listing.now().clips] + studio.library.removed_paths()
    asked += {path.removeprefix(files).partition(os.sep)[0] for path in paths if path.startswith(files)}
    return " ".join(asked)
