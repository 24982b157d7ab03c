"""Judging a performance; what the page changes later is asked of what this leaves ready."""

from __future__ import annotations

from typing import Any

from dousa.app.studio.work import Context

__all__ = ["run"]


def run(request: dict[str, Any], context: Context) -> dict[str, Any]:
    """Evaluate; ``request`` is that of `dousa.app.studio.evaluations.EvaluationRequest`."""
    from dousa.app.studio.evaluations import EvaluationRequest, describe, make_ready

    studio = context.studio
    assert studio is not None  # this work runs in a thread
    wanted = EvaluationRequest.model_validate(request)
    ready = make_ready(wanted, studio.motions.get, context.progress)
    assessment = ready.assess(wanted, wanted.language)
    studio.evaluations.put(context.folder.name, ready)
    return describe(ready, assessment, wanted)
