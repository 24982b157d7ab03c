"""Estimating a motion from uploaded silhouettes or videos, with every frame shown to those who watch."""

from __future__ import annotations

from contextlib import closing
from typing import Any

from dousa.app.studio.work import Context
from dousa.app.studio.work._estimation_request import make_request, plain_words, said_plainly

__all__ = ["run"]


def run(request: dict[str, Any], context: Context) -> dict[str, Any]:
    """Estimate; ``request`` as `dousa.app.studio.api.estimation.EstimateRequest`, see there.

    The folder of the job then holds motion.bvh, joints.trc and angles.csv, and overlay.mp4 if that was wanted. Stopped
    work goes on where it was when the job is taken up again.
    """
    from dousa.app._estimation_output import Outputs
    from dousa.app.estimating import estimate_files
    from dousa.app.studio.footage.recording import FootageWriter

    folder = context.folder
    outputs = Outputs(
        motion=folder / "motion.bvh",
        trc=folder / "joints.trc",
        angles=folder / "angles.csv",
        overlay=folder / "overlay.mp4" if request.get("overlay_video") else None,
    )
    with said_plainly(request, context), closing(FootageWriter(folder)) as footage:
        done = estimate_files(
            make_request(request, context, outputs),
            context.progress,
            lambda text: context.tell(plain_words(text, request, context)),
            footage,
        )
    answer = done.to_json()
    return {
        **{key: _plainly(value, request, context) for key, value in answer.items() if key != "outputs"},
        "motion": "motion.bvh",
        "files": [path.name for path in done.outputs],
    }


def _plainly(value: Any, request: dict[str, Any], context: Context) -> Any:
    if isinstance(value, list):
        return [_plainly(item, request, context) for item in value]
    return plain_words(value, request, context) if isinstance(value, str) else value
