"""What is asked of the interface, as a command and as Python to copy."""

from __future__ import annotations

from fastapi import APIRouter

from dousa.app.studio.api.motions import ExportRequest
from dousa.app.studio.api.search import SearchRequest, TextRequest
from dousa.app.studio.api.takes import LabelRequest
from dousa.app.studio.content import spelling
from dousa.app.studio.content.studio import StudioNow
from dousa.app.studio.core.answers import Answer

router = APIRouter(prefix="/spelling", tags=["search"])


@router.post("/search", summary="A search as a command and as Python")
def spell_search(studio: StudioNow, wanted: SearchRequest) -> Answer:
    """``command``, null where the command line cannot ask it: ``note`` says why; and ``python``."""
    return Answer(spelling.spell_search(studio, wanted.query, wanted.model_dump(exclude={"query"})).to_json())


@router.post("/search/text", summary="A search in words as a command and as Python")
def spell_text(studio: StudioNow, wanted: TextRequest) -> Answer:
    """As of a search."""
    return Answer(spelling.spell_text(studio, wanted.text, wanted.k, wanted.model_dump()).to_json())


@router.post("/label", summary="The labelling of a take as a command and as Python")
def spell_label(studio: StudioNow, wanted: LabelRequest) -> Answer:
    """As of a search."""
    return Answer(spelling.spell_label(studio, wanted.take, wanted.model_dump(exclude={"take"})).to_json())


@router.post("/export", summary="An export as a command and as Python")
def spell_export(studio: StudioNow, wanted: ExportRequest) -> Answer:
    """As of a search; it writes export.zip into the folder where it is run."""
    return Answer(spelling.spell_export(studio, wanted.clips, wanted.to, wanted.model_dump()).to_json())


@router.get("/evaluations/{job_id}", summary="An evaluation as a command and as Python")
def spell_evaluation(studio: StudioNow, job_id: str) -> Answer:
    """As of a search; with the figures and weights that it has now."""
    return Answer(spelling.spell_evaluation(studio, job_id).to_json())
