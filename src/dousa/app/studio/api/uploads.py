"""What this studio is; and files from elsewhere: one a request, the body is its bytes, zip archives are unpacked."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Query, Request

import dousa
from dousa.app.studio.content.motions import Address
from dousa.app.studio.content.studio import StudioNow
from dousa.app.studio.core.answers import Answer, RefusedError, describe_body, say
from dousa.app.studio.core.uploads import Taken, describe_files, motion_suffixes, receive

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
    came = await receive(request.stream(), name, batch, studio.workspace, studio.settings, studio.reader.run)
    return Answer(
        {
            "batch": came.batch,
            "files": [_to_json(came.batch, file) for file in came.files],
            "refused": [{"name": file, "reason": say(why.message), "code": why.code} for file, why in came.refused],
        },
        201,
    )


def _to_json(batch: str, file: Taken) -> dict[str, Any]:
    motion = str(Address(batch=batch, name=file.name)) if file.is_motion else None
    return {"name": file.name, "bytes": file.n_bytes, "motion": motion, "labels_of": file.labels_of}


@router.get("/uploads/{batch}", summary="The files of a batch")
def list_files(studio: StudioNow, batch: str) -> Answer:
    """Names and sizes."""
    folder = studio.workspace.batch_folder(batch)
    names = [path.relative_to(folder).as_posix() for path in studio.workspace.files(batch)]
    files = studio.reader.run(describe_files, folder, names)
    return Answer({"batch": batch, "files": [_to_json(batch, file) for file in files]})


@router.delete("/uploads/{batch}", status_code=200, summary="Take away a batch that is not in use")
def discard(studio: StudioNow, batch: str) -> Answer:
    """Files that the library or a job lives from stay."""
    studio.workspace.batch_folder(batch)
    studio.workspace.discard(batch)
    return Answer({"batch": batch})
