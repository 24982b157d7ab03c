"""The interface below /api, by topic; each module has a ``router``."""

from __future__ import annotations

from dousa.app.studio.api import (
    clips,
    companions,
    estimation,
    evaluation,
    exports,
    jobs,
    journal,
    live,
    masks,
    motions,
    search,
    share,
    takes,
    uploads,
)

__all__ = ["ROUTERS"]

_EVALUATING = (evaluation, companions, estimation, masks, live)
_MODULES = (uploads, clips, journal, search, motions, takes, *_EVALUATING, exports, share, jobs)
ROUTERS = (uploads.general, *(module.router for module in _MODULES))
