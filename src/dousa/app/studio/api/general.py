"""What this studio is."""

from __future__ import annotations

from fastapi import APIRouter

import dousa
from dousa.app.studio.answers import Answer
from dousa.app.studio.studio import StudioNow
from dousa.app.studio.uploads import MOTIONS

__all__ = ["router"]

router = APIRouter(tags=["general"])


@router.get("/info", summary="The library in numbers, and the limits of this studio")
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
            "motion_suffixes": sorted(MOTIONS),
        }
    )
