"""The routers of the interface below /api, in the order in which the page on the interface lists them."""

from __future__ import annotations

from dousa.app.studio.api import clips, estimation, evaluation, jobs, live, motions, search, share, spelling, takes
from dousa.app.studio.api.uploads import general, router

ROUTERS = (
    *(general, router, clips.router, clips.journal_router, search.router, spelling.router, motions.router),
    *(takes.router, evaluation.router, evaluation.companions_router, estimation.router, estimation.masks_router),
    *(live.router, motions.export_router, share.router, jobs.router),
)
