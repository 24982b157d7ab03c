"""What this studio is; and files from elsewhere: one a request, the body is its bytes, zip archives are unpacked."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request

import dousa
from dousa.app.studio.content.motions import Address
from dousa.app.studio.content.studio import StudioNow
from dousa.app.studio.core.answers import Answer, RefusedError, describe_body, say
from dousa.app.studio.core.uploads import motion_suffixes, receive
from dousa.formats.annotations import LABEL_SUFFIXES, is_label_file
from dousa.formats.registry import is_motion_file

general = APIRouter(tags=["general"])
router = APIRouter(tags=["uploads"])


@general.get("/info", summary="The library in numbers, and the limits of this studio")
def get_info(studio: StudioNow) -> Answer:
    """Version, library, categories with their numbers of clips, whether it is trained, limits."""
    settings = studio.settings
    return Answer(
        {
            "version": dousa.__version__,
            "library": {"name": settings.library.name, **studio.library.stats().to_json()},
            "limits": {
                "file_bytes": settings.most_bytes,
                "batch_bytes": settings.most_unpacked_bytes,
                "batch_files": settings.most_files,
            },
            "motion_suffixes": sorted(motion_suffixes()),
        }
    )


@router.post(
    "/uploads", status_code=201, summary="Upload a file", openapi_extra=describe_body("application/octet-stream")
)
async def upload(
    request: Request,
    studio: StudioNow,
    name: Annotated[str, Query(max_length=1000, description="relative path, such as kick/anna_1.bvh")],
    batch: Annotated[
        str | None, Query(pattern="^[0-9a-f]{16}$", description="of an earlier upload, to put files together")
    ] = None,
) -> Answer:
    """Keep a file, or the files of a zip archive, in a batch.

    Of each file ``motion`` is its name as a motion, and ``labels_of``, of a table of labels, the name without a suffix
    of the take that it belongs to; null of others.

    Files that belong together (AMC with ASF; masks of one view; a folder for the library) go into one batch: give the
    ``batch`` of the first answer with the others.
    """
    if request.headers.get("content-type", "").startswith("multipart/"):
        raise RefusedError(415, "studio_files.form")
    came = await receive(request.stream(), name, batch, studio.workspace, studio.settings)
    folder = studio.workspace.batch_folder(came.batch)
    return Answer(
        {
            "batch": came.batch,
            "files": [_describe(came.batch, folder, file, size) for file, size in came.files],
            "refused": [{"name": file, "reason": say(reason), "code": reason.code} for file, reason in came.refused],
        },
        201,
    )


def _describe(batch: str, folder: Path, name: str, size: int) -> dict[str, Any]:
    is_motion = is_motion_file(folder / name)
    return {
        "name": name,
        "bytes": size,
        "motion": str(Address(batch=batch, name=name)) if is_motion else None,
        "labels_of": None if is_motion else _name_take(folder, name),
    }


def _name_take(folder: Path, table: str) -> str | None:
    """The name of a take, without its suffix, whose labels are in a table beside it; None of what is no such table."""
    suffix = next((one for one in (*LABEL_SUFFIXES, ".csv", ".tsv") if table.lower().endswith(one)), None)
    return None if suffix is None or not is_label_file(folder / table) else table[: -len(suffix)]


@router.get("/uploads/{batch}", summary="The files of a batch")
def list_files(studio: StudioNow, batch: str) -> Answer:
    """Names and sizes."""
    folder = studio.workspace.batch_folder(batch)
    files = [
        _describe(batch, folder, path.relative_to(folder).as_posix(), path.stat().st_size)
        for path in studio.workspace.files(batch)
    ]
    return Answer({"batch": batch, "files": files})


@router.delete("/uploads/{batch}", status_code=200, summary="Take away a batch that is not in use")
def discard(studio: StudioNow, batch: str) -> Answer:
    """Files that the library or a job lives from stay."""
    studio.workspace.batch_folder(batch)
    studio.workspace.discard(batch)
    return Answer({"batch": batch})
