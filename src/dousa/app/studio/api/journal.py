"""Changes of the library that are undone and done again, and searches that are kept under a name."""

from __future__ import annotations

from typing import Annotated, Literal

from fastapi import APIRouter, Query
from pydantic import BaseModel, ConfigDict, Field

from dousa.app.studio.api.clips import ONE_LINE
from dousa.app.studio.content.studio import StudioNow
from dousa.app.studio.core.answers import Answer, RefusedError

router = APIRouter(tags=["library"])

_Name = Annotated[str, Field(min_length=1, max_length=200, pattern=ONE_LINE)]
_Names = Annotated[list[Annotated[str, Field(max_length=1000)]], Field(max_length=500)]


class Step(BaseModel):
    """Which change."""

    model_config = ConfigDict(extra="forbid")

    number: Annotated[int, Field(ge=1, le=2**62)] | None = Field(None, description="null for the last one")


class Asked(BaseModel):
    """What a search looks for, or which clips were chosen."""

    model_config = ConfigDict(extra="forbid")

    text: str | None = Field(None, max_length=300)
    category: _Names | None = None
    performer: _Names | None = None
    tag: _Names | None = None
    kind: Literal["clip", "take"] | None = None
    min_s: float | None = Field(None, ge=0, le=1e7)
    max_s: float | None = Field(None, ge=0, le=1e7)
    clips: Annotated[list[Annotated[int, Field(ge=1, le=2**31 - 1)]], Field(max_length=200_000)] | None = None


class Saving(BaseModel):
    """A search, and its name."""

    model_config = ConfigDict(extra="forbid")

    name: _Name
    asked: Asked


@router.get("/journal", summary="The changes of the library that can be undone or done again")
def list_changes(studio: StudioNow, limit: Annotated[int, Query(ge=1, le=1000)] = 100) -> Answer:
    """The last first; ``kept_bytes`` are those of removed clips."""
    entries = studio.library.journal()
    kept = sum(entry.kept_bytes for entry in entries)
    return Answer({"changes": [entry.to_json() for entry in entries[:limit]], "kept_bytes": kept})


@router.post("/journal/undo", summary="Undo a change of the library")
def undo(studio: StudioNow, wanted: Step) -> Answer:
    """Refused with 409 where the same clips were changed since; nothing is changed then."""
    return Answer(studio.library.undo(wanted.number, n_jobs=1).to_json())


@router.post("/journal/redo", summary="Do a change again that was undone")
def redo(studio: StudioNow, wanted: Step) -> Answer:
    """As POST /journal/undo."""
    return Answer(studio.library.redo(wanted.number, n_jobs=1).to_json())


@router.get("/searches", summary="Searches and selections that are kept")
def list_searches(studio: StudioNow) -> Answer:
    """By name. ``n_clips`` is the size of a selection, null for a search."""
    rows = [
        {
            "name": one.name,
            "asked": {name: value for name, value in one.asked.items() if name != "clips"},
            "n_clips": len(one.asked["clips"]) if one.is_selection else None,
        }
        for one in studio.library.searches.all()
    ]
    return Answer({"searches": rows})


@router.post("/searches", summary="Keep a search or a selection under a name")
def save_search(studio: StudioNow, wanted: Saving) -> Answer:
    """Another one of the same name gives way."""
    asked = {name: value for name, value in wanted.asked.model_dump().items() if value not in (None, [], "")}
    if not asked:
        raise RefusedError(422, "studio.empty_search")
    return Answer(studio.library.searches.save(wanted.name, asked).to_json())


@router.post("/searches/forget", summary="Forget a search or a selection that is kept")
def forget_search(studio: StudioNow, wanted: Annotated[str, Query(alias="name", max_length=200)]) -> Answer:
    """Its clips stay."""
    studio.library.searches.remove(wanted)
    return Answer({"name": wanted})
