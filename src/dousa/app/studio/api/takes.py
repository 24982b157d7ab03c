"""Labels of long recordings, and what people correct in them."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import replace
from pathlib import PurePath
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query
from pydantic import Field
from starlette.responses import Response

from dousa.app.requests import library
from dousa.app.requests.models import derive_model
from dousa.app.studio.content.corrections import (
    find_take,
    forget_correction,
    lay_over,
    learn_correction,
    list_corrections,
)
from dousa.app.studio.content.motions import MotionName, MotionRef, Seconds
from dousa.app.studio.content.studio import Studio, StudioNow
from dousa.app.studio.core.answers import Answer, RefusedError, StrictModel, attachment, say
from dousa.app.studio.jobs.board import Job
from dousa.formats.annotations import read_label_file
from dousa.formats.annotations.label_file import to_annotation
from dousa.formats.annotations.tables import about_one_take
from dousa.messages import Message
from dousa.motion.annotation import Stretch

router = APIRouter(tags=["takes"])

_Number = Annotated[str, Field(max_length=100)]
_Motion = Annotated[MotionName, Query()]


class LabelRequest(derive_model(library.LabelRequest)):  # type: ignore[misc]
    """A take, and the confidence that its labels need."""

    take: MotionRef


class CorrectRequest(StrictModel):
    """A part of a take and what it shows."""

    motion: MotionName
    start_s: Seconds
    end_s: Seconds
    category: str = Field(min_length=1, max_length=200)
    split_s: Seconds | None = Field(default=None, description="makes two parts of it, which are called the same")
    replaces: list[_Number] = Field(default=[], max_length=100, description="corrections that go with this")
    instead_of: str | None = Field(
        default=None, max_length=200, description="of several labels at one time the category of the one that goes"
    )


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
    """``labels`` is null before the take was labelled; ``is_current``: the library has not changed since.

    ``given`` are the labels of a table, null for a take without one.
    """
    return Answer(_describe(studio, MotionRef(motion=motion)))


@router.get("/takes/strips", summary="The labels of several takes in short")
def get_strips(studio: StudioNow, motion: Annotated[list[MotionName], Query(min_length=1, max_length=100)]) -> Answer:
    """For each take: ``given``, whether they come from a table, and ``segments``, null before it was labelled."""
    return Answer({"takes": {name: _summarise(studio, MotionRef(motion=name)) for name in motion}})


def _summarise(studio: Studio, ref: MotionRef) -> dict[str, Any]:
    answer = _describe(studio, ref)
    labels = answer["given"] or answer["labels"]
    if labels is None:
        return {"given": False, "segments": None}
    kept = [one for one in labels["segments"] if one["category"] or one.get("unknown")]
    segments = [
        {
            **{name: one[name] for name in ("start_s", "end_s", "category")},
            "unknown": one["category"] is None,
            "perhaps": one.get("perhaps", False),
            "guess": one.get("guess"),
        }
        for one in kept
    ]
    return {"given": answer["given"] is not None, "segments": segments}


def _describe(studio: Studio, ref: MotionRef) -> dict[str, Any]:
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
        "given": _describe_given(studio, ref),
        "is_current": labels is not None and labels["revision"] == studio.library.stats().revision,
    }


def _describe_given(studio: Studio, ref: MotionRef) -> dict[str, Any] | None:
    take = find_take(studio, ref)
    known = [] if take is None else studio.library.annotations.read([take])
    if not known or not known[0].is_complete:
        return None
    stretches = [
        {"start_s": round(one.start, 3), "end_s": round(one.stop, 3), "category": one.category, "counted": one.counted}
        for one in known[0].rows  # both of two labels at one time
    ]
    return {"source": PurePath(known[0].source).name, "tier": known[0].tier, "segments": stretches}


def _last_label(studio: Studio, ref: MotionRef) -> Job | None:
    """The last time that a take was labelled."""
    for job in studio.jobs.all():
        if job.kind == "label" and job.state == "done" and job.request["take"]["motion"] == ref.motion:
            return job
    return None


class AnnotateRequest(StrictModel):
    """A take of the library and an uploaded table of labels."""

    motion: MotionName
    batch: str = Field(pattern="^[0-9a-f]{16}$", description="of the upload")
    name: str = Field(min_length=1, max_length=1000, description="of the file in it")
    tier: str | None = Field(default=None, max_length=200, description="the first that has labels if left out")


@router.post("/takes/annotate", status_code=201, summary="Give a take the labels of a table")
def annotate(studio: StudioNow, wanted: AnnotateRequest) -> Answer:
    """The table (CSV, ELAN, Praat, BORIS) takes the place of the labels that the take has; each segment is a clip.

    An empty table takes them all away. One of which nothing lies in the take is refused.
    """
    take = find_take(studio, MotionRef(motion=wanted.motion))
    if take is None:
        raise RefusedError(409, "studio_takes.not_a_take")
    info = studio.library.clips([take])[0]
    path = studio.workspace.find(wanted.batch, wanted.name)
    file = replace(about_one_take(studio.reader.run(read_label_file, path)), path=path.name)
    tiers = file.tiers_of(info.path)
    if tiers is None:
        raise RefusedError(422, "studio_takes.other_takes", name=PurePath(info.path).name, takes=list(file.takes)[:12])
    annotation, notes = to_annotation(file, tiers, wanted.tier, info.frame_rate)
    changes = studio.library.annotations.write(take, annotation, n_jobs=1)
    if annotation.is_blank:
        notes = [*notes, Message("annotations.blank", table=path.name)]
    now = studio.library.annotations.read([take])
    answer = {
        "given": _describe_given(studio, MotionRef(motion=wanted.motion)),
        "n_segments": len(now[0].segments) if now else 0,
        "new_categories": list(changes.new_categories),
        "notes": [say(note) for note in (*notes, *(note for _, note in changes.warnings))],
    }
    return Answer(answer, 201)


_LabelFormat = Literal["csv", "json", "eaf"]


@router.get("/takes/export", summary="Download the labels of a take", response_class=Response)
def export(
    studio: StudioNow,
    motion: _Motion,
    format: _LabelFormat = "csv",
    given: Annotated[bool, Query(description="the labels of a table instead of the recognised ones")] = False,
) -> Response:
    """Labels with corrections: a table with a row for each stretch, JSON, or a document of ELAN.

    Tables and documents are called as labels beside a take are, and can be read again. A document has no place for
    what is perhaps something: it is left out there, and so read as nothing.
    """
    answer = _describe(studio, MotionRef(motion=motion))
    labels = answer["given"] if given else answer["labels"]
    if labels is None:
        raise RefusedError(409, "studio_takes.not_labelled")
    suffix = f".{format}" if format == "eaf" else f".labels.{format}"  # what is found beside the take
    headers = {"content-disposition": attachment(f"{PurePath(answer['name']).stem}{suffix}")}
    segments = labels["segments"]
    if format == "json":
        kept = {name: labels[name] for name in ("duration_s", "threshold", "source", "segments") if name in labels}
        return Answer({"take": answer["name"], **kept}, headers=headers)
    if format == "eaf":
        from dousa.formats.annotations.elan import format_eaf

        content = format_eaf([_to_stretch(one) for one in segments], media=answer["name"])
        return Response(content, media_type="application/xml", headers=headers)
    return Response(_format_csv(segments).encode("utf-8", "replace"), media_type="text/csv", headers=headers)


def _format_csv(segments: Sequence[dict[str, Any]]) -> str:
    """Given labels as they are read again; recognised ones with how sure they are, and what was corrected.

    A doubtful guess is no label and has its own column.
    """
    if any("counted" in one for one in segments):
        from dousa.formats.annotations.tables import format_labels_csv

        return format_labels_csv(_to_stretch(one) for one in segments)
    text = io.StringIO()
    writer = csv.writer(text)
    writer.writerow(("start_s", "end_s", "category", "confidence", "corrected", "perhaps"))
    for one in segments:
        by_hand, doubtful = "" if one["corrected"] is None else "yes", one.get("guess") or ""
        sure = f"{one['confidence']:.4f}", by_hand, doubtful
        writer.writerow((f"{one['start_s']:.3f}", f"{one['end_s']:.3f}", one["category"] or "", *sure))
    return text.getvalue()


def _to_stretch(one: dict[str, Any]) -> Stretch:
    return Stretch(one["start_s"], one["end_s"], one["category"], one.get("counted", True))


@router.post("/takes/correct", status_code=201, summary="Say what a part of a take shows; it is learned")
def correct(studio: StudioNow, wanted: CorrectRequest) -> Answer:
    """The part becomes a clip of the library, the forest grows at once, and takes are labelled with it from now on.

    A correction of mostly the same part of this take is replaced; of several only that of ``instead_of``. All of it is
    one ``change`` of the journal, by whose number POST /journal/undo takes it back. Label the take again to see what
    has changed.
    """
    ref = MotionRef(motion=wanted.motion, start_s=wanted.start_s, end_s=wanted.end_s)
    return Answer(
        learn_correction(studio, ref, wanted.category, wanted.split_s, wanted.replaces, wanted.instead_of), 201
    )


@router.delete("/takes/corrections/{number}", summary="Take a correction back")
def undo(studio: StudioNow, number: str) -> Answer:
    """Its clip leaves the library; what the forest learned from it stays until the next training."""
    removed, change = forget_correction(studio, number)
    return Answer({"removed": removed.to_json(), "change": change})
