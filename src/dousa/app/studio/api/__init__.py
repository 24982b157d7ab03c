"""The interface below /api, by topic; each module has a ``router``."""

from __future__ import annotations

from dousa.app.studio.api import clips, estimation, evaluation, exports, jobs, journal, motions, search, takes, uploads

__all__ = ["ROUTERS"]

_MODULES = (uploads, clips, journal, search, motions, takes, evaluation, estimation, exports, jobs)
ROUTERS = (uploads.general, *(module.router for module in _MODULES))
