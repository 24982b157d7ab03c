"""A short example to estimate: a synthetic person kicks, and cameras see nothing but silhouettes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from dousa.app.studio.work import Context

__all__ = ["run"]


def run(request: dict[str, Any], context: Context) -> dict[str, Any]:
    """Write ``kick_seen.npz`` into the batch ``request["batch"]``; says the person's stature in m."""
    from dousa.app.demo_estimation import write_performance

    folder = context.home / "files" / str(request["batch"])
    truth = context.folder / f"{request['batch']}.bvh"
    try:
        stature = write_performance(Path(truth), folder / "kick_seen.npz")
    finally:
        truth.unlink(missing_ok=True)  # what the person really did stays hidden, as in life
    return {"batch": request["batch"], "stature_m": stature}
