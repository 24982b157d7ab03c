"""Labels of long recordings, and what people correct in them."""

from __future__ import annotations

import csv
import io
from pathlib import PurePath
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query
from pydantic import BaseModel, ConfigDict, Field
from starlette.responses import Response

from dousa.app.studio.content.motions import MotionName, MotionRef, Seconds
from dousa.app.studio.content.studio import Studio, StudioNow
from dousa.app.studio.core.answers import Answer, RefusedError, attachment
from dousa.app.studio.jobs.board import Job

router = APIRouter(tags=["takes"])

_Share = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]
_Motion = Annotated[MotionName, Query()]


class LabelRequest(BaseModel):
    """Which take, and from when on something is said."""

    model_config = ConfigDict(extra="forbid")

    take: MotionRef
    threshold: _Share | None = Field(
        default=None, description="confidence from which a category is said; learned if left out"
    )


class CorrectRequest(BaseModel):
    """A part of a take and what it shows."""

    model_config = ConfigDict(extra="forbid")

    motion: MotionName
    start_s: Seconds
    end_s: Seconds
    category: str = Field(min_length=1, max_length=200)


@router.post("/jobs/label", status_code=202, summary="Label a take from beginning to end")
def label(studio: StudioNow, wanted: LabelRequest) -> Answer:
    """A job; its result has the stretches of the take, with a category or unknown, and how sure each is.

    The first time after a training what takes are labelled with is learned, which takes seconds.
    """
    if not wanted.take.is_whole:
        raise RefusedError(422, "studio_takes.whole_take")
    named = studio.motions.get(wanted.take)
    return Answer(studio.jobs.submit("label", wanted.model_dump(), named.name).to_json(), 202)


@router.get("/takes/labels", summary="The labels of a take, with what was corrected")
def get_labels(studio: StudioNow, motion: _Motion) -> Answer:
    """``labels`` is null before the take was labelled; ``is_current``: the library has not changed since."""
    return Answer(_describe(studio, MotionRef(motion=motion)))


def _describe(studio: Studio, ref: MotionRef) -> dict[str, Any]:
    from dousa.app.studio.content.corrections import lay_over, list_corrections

    corrections = list_corrections(studio, ref)
    job = _last_label(studio, ref)
    labels = None if job is None else job.result
    segments = [] if labels is None else lay_over(labels["segments"], corrections)
    return {
        "motion": ref.motion,
        "name": studio.motions.path(ref).name,
        "job": None if job is None else job.id,
        "labels": None if labels is None else {**labels, "segments": segments},
        "corrections": [one.to_json() for one in corrections],
        "is_current": labels is not None and labels["revision"] == studio.library.stats().revision,
    }


def _last_label(studio: Studio, ref: MotionRef) -> Job | None:
    """The last time that a take was labelled."""
    for job in studio.jobs.all():
        if job.kind == "label" and job.state == "done" and job.request["take"]["motion"] == ref.motion:
            return job
    return None


@router.get("/takes/export", summary="Download the labels of a take", response_class=Response)
def export(studio: StudioNow, motion: _Motion, format: Literal["csv", "json"] = "csv") -> Response:
    """Labels with corrections: a table with a row for each stretch, or JSON."""
    answer = _describe(studio, MotionRef(motion=motion))
    if answer["labels"] is None:
        raise RefusedError(409, "studio_takes.not_labelled")
    headers = {"content-disposition": attachment(f"{PurePath(answer['name']).stem}_labels.{format}")}
    if format == "json":
        kept = {name: answer["labels"][name] for name in ("duration_s", "threshold", "segments")}
        return Answer({"take": answer["name"], **kept}, headers=headers)
    text = io.StringIO()
    writer = csv.writer(text)
    writer.writerow(("start_s", "end_s", "category", "confidence", "corrected"))
    for one in answer["labels"]["segments"]:
        corrected = "" if one["corrected"] is None else "yes"
        writer.writerow(
            (
                f"{one['start_s']:.3f}",
                f"{one['end_s']:.3f}",
                one["category"] or "",
                f"{one['confidence']:.4f}",
                corrected,
            )
        )
    return Response(text.getvalue().encode("utf-8", "replace"), media_type="text/csv", headers=headers)


@router.post("/takes/correct", status_code=201, summary="Say what a part of a take shows; it is learned")
def correct(studio: StudioNow, wanted: CorrectRequest) -> Answer:
    """The part becomes a clip of the library, the forest grows at once, and takes are labelled with it from now on.

    A correction of mostly the same part of this take is replaced. Label the take again to see what has changed.
    """
    from dousa.app.studio.content.corrections import learn_correction

    ref = MotionRef(motion=wanted.motion, start_s=wanted.start_s, end_s=wanted.end_s)
    return Answer(learn_correction(studio, ref, wanted.category), 201)


@router.delete("/takes/corrections/{number}", summary="Take a correction back")
def undo(studio: StudioNow, number: str) -> Answer:
    """Its clip leaves the library; what the forest learned from it stays until the next training."""
    from dousa.app.studio.content.corrections import forget_correction

    return Answer({"removed": forget_correction(studio, number).to_json()})
