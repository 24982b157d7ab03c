"""Searching: what is this, what is like it, where in takes does it happen."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

from fastapi import APIRouter
from pydantic import Field

from dousa.app.requests import library
from dousa.app.requests.models import derive_model, pick_fields
from dousa.app.studio.content.motions import Address, MotionRef
from dousa.app.studio.content.studio import Studio, StudioNow
from dousa.app.studio.core.answers import Answer, StrictModel, name_error, to_answer
from dousa.errors import DousaError, InvalidMotionError, NotTrainedError

if TYPE_CHECKING:
    from dousa.library import SearchResult, TextResult

router = APIRouter(tags=["search"])


class SearchRequest(derive_model(library.SearchRequest)):  # type: ignore[misc]
    """What is searched for, and how."""

    query: MotionRef
    k: int = Field(default=10, ge=1, le=200, description="how many clips")
    ranking: library.Ranking | None = Field(default=None, description="what clips are ordered by")
    inside_takes: bool = Field(default=False, description="look into takes too")


class TextRequest(StrictModel):
    """Words, English or Japanese, that describe motions."""

    text: str = Field(min_length=1, max_length=500)
    k: int = Field(default=24, ge=1, le=1000, description="how many clips and takes at most")
    category: str | None = Field(default=None, max_length=1000, description="only of this category")
    performer: str | None = Field(default=None, max_length=1000, description="only of this performer")
    kind: Literal["clip", "take"] | None = None


class ClassifyRequest(derive_model(library.ClassifyRequest)):  # type: ignore[misc]
    """Motions to name."""

    motions: list[MotionRef] = Field(min_length=1, max_length=100)


@router.post("/search", summary="The clips most like a motion")
def search(studio: StudioNow, wanted: SearchRequest) -> Answer:
    """What the motion is taken for, and the most similar clips, the most similar first.

    ``category`` is null where the motion is of no category that the library knows, or too doubtful; ``guess`` is the
    nearest one, and ``perhaps`` says whether it may be that.
    """
    with studio.searching.enter(), studio.learning.follow() as progress:
        found = studio.library.search(
            studio.motions.query(wanted.query),
            **pick_fields(wanted, library.SearchRequest),
            progress=progress,
        )
        answer = _name_hits(found)
        if wanted.inside_takes:
            answer["places"] = _find_places(studio, wanted)
    return Answer(answer)


@router.get("/search/learning", summary="What a search learns before it answers")
def learning(studio: StudioNow) -> Answer:
    """``learning`` with ``done``, ``total`` and ``what``: the first search with a body that lacks a part learns
    a forest for it; null if none does.
    """
    step = studio.learning.now()
    return Answer({"learning": None if step is None else dict(zip(("done", "total", "what"), step, strict=True))})


@router.post("/search/text", summary="The clips and takes that words describe")
def search_text(studio: StudioNow, wanted: TextRequest) -> Answer:
    """Those whose category, name or movement fits the words, the best first; none where nothing fits.

    ``near_words`` are words of the library that are near, if nothing fits.
    """
    with studio.searching.enter():
        found = studio.library.search_text(
            wanted.text, wanted.k, category=wanted.category, performer=wanted.performer, kind=wanted.kind
        )
    return Answer(_name_hits(found))


def _name_hits(result: SearchResult | TextResult) -> dict[str, Any]:
    answer = result.to_json()
    for hit in answer["results"]:
        hit["motion"] = str(Address(clip=hit["clip_id"]))
    return answer


def _find_places(studio: Studio, wanted: SearchRequest) -> list[dict[str, Any]]:
    """Places in takes like the query; none where there are no takes, or the query is too short to be found."""
    stored = studio.library
    if not stored.stats().n_takes:
        return []
    try:
        found = stored.find(studio.motions.query(wanted.query), k=20, mirror=bool(wanted.mirror))
    except InvalidMotionError:
        return []
    return [{**place.to_json(), "motion": str(Address(clip=place.clip_id))} for place in found.results]


@router.post("/classify", summary="What motions are")
def classify(studio: StudioNow, wanted: ClassifyRequest) -> Answer:
    """One answer for each motion; one that cannot be used has a ``problem``."""
    with studio.searching.enter():
        answers = [_classify(studio, ref, wanted) for ref in wanted.motions]
    return Answer({"answers": answers})


def _classify(studio: Studio, ref: MotionRef, wanted: ClassifyRequest) -> dict[str, Any]:
    try:
        result = studio.library.search(
            studio.motions.query(ref),
            1,
            ranking="histogram",  # the quickest: only the verdict is looked at
            **pick_fields(wanted, library.ClassifyRequest),
        )
    except NotTrainedError:
        raise
    except DousaError as error:
        problem = to_answer(name_error(error, studio.workspace.root))
        return {"motion": ref.motion, "category": None, "guess": None, "perhaps": False, "histogram": {}, **problem}
    answer = result.to_json()
    return {
        "motion": ref.motion,
        **{name: answer[name] for name in answer if name not in ("results", "ranking")},
    }
