"""The interface below /api, by topic; each module has a ``router``."""

from __future__ import annotations

from dousa.app.studio.api import (
    clips,
    estimation,
    evaluation,
    general,
    jobs,
    motions,
    search,
    takes,
    uploads,
)

__all__ = ["ROUTERS"]

ROUTERS = tuple(
    module.router
    for module in (general, uploads, clips, search, motions, takes, evaluation, estimation, jobs)
)
