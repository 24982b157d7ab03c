"""Clips and takes of the library: the list with its facets, thumbnails, labels, removal."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Annotated, Literal

from fastapi import APIRouter, Depends, Query, Response
from pydantic import Field, model_validator

from dousa.app.studio.content.clips import ClipQuery, Snapshot, Sort
from dousa.app.studio.content.studio import Studio, StudioNow
from dousa.app.studio.core.answers import FILE, Answer, RefusedError, StrictModel

if TYPE_CHECKING:
    from dousa.library import Library

router = APIRouter(tags=["library"])

_Number = Annotated[int, Field(ge=1, le=2**31 - 1)]
ONE_LINE = r"^[^\x00-\x1f\x7f]*[^\s\x00-\x1f\x7f][^\x00-\x1f\x7f]*$"  # not only of spaces
"""The form of a label: one line."""
_Label = Annotated[str, Field(min_length=1, max_length=200, pattern=ONE_LINE)]
_Names = Annotated[list[Annotated[str, Query(max_length=1000)]], Query(max_length=500)]
_Seconds = Annotated[float | None, Query(ge=0, le=1e7, allow_inf_nan=False)]


class Clips(StrictModel):
    """Some clips or takes."""

    clips: Annotated[list[_Number], Field(min_length=1, max_length=200_000)]


class Pictured(StrictModel):
    """Clips whose figures are wanted at once."""

    clips: Annotated[list[_Number], Field(max_length=500)]


class Relabelling(Clips):
    """Clips and their new labels."""

    category: _Label | None = Field(None, description="null takes the label away; left out, it stays")
    performer: _Label | None = Field(None, description="likewise")

    @model_validator(mode="after")
    def _says_something(self) -> Relabelling:
        if not self.labels:
            raise ValueError(RefusedError(422, "studio.no_labels"))
        return self

    @property
    def labels(self) -> dict[str, str | None]:
        """The labels that change."""
        given = {name: getattr(self, name) for name in ("category", "performer") if name in self.model_fields_set}
        return {name: value.strip() if value else None for name, value in given.items()}


class Tagging(Clips):
    """Clips and the tags that they get and lose."""

    add: list[_Label] = Field([], max_length=100)
    remove: list[_Label] = Field([], max_length=100)


def _read_asked(
    text: Annotated[
        str, Query(max_length=300, description="of names and labels, also misspelt, or words for what is done")
    ] = "",
    category: Annotated[
        _Names | None, Query(description="any of these; an empty one: clips without a label; kick/: all below it")
    ] = None,
    performer: Annotated[_Names | None, Query(description="likewise")] = None,
    kind: Literal["clip", "take"] | None = None,
    min_s: _Seconds = None,
    max_s: _Seconds = None,
    batch: Annotated[str | None, Query(pattern="^[0-9a-f]{16}$", description="of an upload")] = None,
    sort: Sort = "path",
    *,
    studio: StudioNow,
    tag: Annotated[_Names | None, Query(description="likewise")] = None,
    saved: Annotated[
        str | None, Query(max_length=200, description="name of a search or selection that is kept")
    ] = None,
    wide: Annotated[
        bool, Query(description="include clips that do what the text says even if others are called so")
    ] = False,
) -> ClipQuery:
    labels: dict[str, Sequence[str]] = {"category": category or (), "performer": performer or (), "tag": tag or ()}
    labels["kind"] = () if kind is None else (kind,)
    among = None if saved is None else _find_saved(studio, saved)
    return ClipQuery(text, labels, min_s, max_s, batch, sort, among, wide)


def _find_saved(studio: Studio, name: str) -> frozenset[int]:
    """The clips of a selection that is kept, or those that a search finds now, its words read as in the list."""
    searches = studio.library.searches
    kept = searches.get(name)
    if kept.is_selection:
        return frozenset(searches.find(name))
    own = dict(kept.asked)
    labels: dict[str, Sequence[str]] = {}
    for label in ("category", "performer", "tag", "kind"):
        value = own.get(label) or ()
        labels[label] = (value,) if isinstance(value, str) else tuple(value)
    snapshot = studio.listing.now()
    asked = ClipQuery(str(own.get("text") or ""), labels, own.get("min_s"), own.get("max_s"))
    return frozenset(snapshot.ids[snapshot.find(asked, studio.meanings.match).rows].tolist())


_AskedNow = Annotated[ClipQuery, Depends(_read_asked)]
_Offset = Annotated[int, Query(ge=0, le=10**9)]


@router.get("/clips", summary="Clips and takes, filtered, a part at a time, with facets")
def list_clips(
    studio: StudioNow, asked: _AskedNow, offset: _Offset = 0, limit: Annotated[int, Query(ge=0, le=500)] = 60
) -> Answer:
    """Facets count what would fit if that facet were left open; ``""`` in them stands for no label.

    Takes have no category, and are not counted as clips that lack one.

    ``reading`` says how ``text`` was understood: what misspelt words were ``taken_for``, how many ``more`` clips do
    what it says, and whether that is still ``pending``.
    """
    snapshot = studio.listing.now()
    found = snapshot.find(asked, studio.meanings.match)
    reading = found.reading
    return Answer(
        {
            "total": len(found.rows),
            "offset": offset,
            "items": [snapshot.describe(row) for row in found.rows[offset : offset + limit]],
            "facets": found.facets,
            "reading": {"taken_for": reading.taken_for, "more": reading.more, "pending": reading.pending},
            "revision": snapshot.revision,
            "library": snapshot.summarise(),
        }
    )


@router.get("/clips/ids", summary="The numbers of clips and takes, filtered")
def list_ids(
    studio: StudioNow,
    asked: _AskedNow,
    offset: _Offset = 0,
    limit: Annotated[int, Query(ge=1, le=200_000)] = 200_000,
) -> Answer:
    """As GET /clips, numbers only: to choose many at once."""
    snapshot = studio.listing.now()
    rows = snapshot.find(asked, studio.meanings.match).rows
    chosen = rows[offset : offset + limit]
    return Answer(
        {
            "total": len(rows),
            "offset": offset,
            "ids": snapshot.ids[chosen].tolist(),
            "revision": snapshot.revision,
        }
    )


@router.get("/map", summary="Where the clips lie on the map")
def get_map(studio: StudioNow) -> Answer:
    """Clips that lie near to each other have poses in common; ``category`` counts in ``categories``, ``""``: no label.

    POST /jobs/map makes it. ``n_new`` clips came since or have changed, ``n_left_out`` lack joints.
    """
    return Answer(studio.map.describe())


@router.post("/clips/thumbnails", summary="Small moving figures of clips", **FILE)
def get_thumbnails(studio: StudioNow, wanted: Pictured) -> Response:
    """1,456 bytes for each number, in their order; zeros for a clip that is not there."""
    content = studio.figures.get(studio.library, wanted.clips)
    return Response(content, media_type="application/octet-stream")


@router.get("/clips/{clip_id}", summary="One clip or take")
def get_clip(studio: StudioNow, clip_id: int) -> Answer:
    """As in the list."""
    snapshot = studio.listing.now()
    _check_there(snapshot, [clip_id])
    return Answer(snapshot.describe(snapshot.row_of(clip_id)))


@router.post("/clips/relabel", summary="Give clips another category or performer")
def relabel(studio: StudioNow, wanted: Relabelling) -> Answer:
    """The forest learns of it in the next training. Clips that are gone meanwhile are left out.

    ``change`` is the number that POST /journal/undo takes; null where nothing changed.
    """
    return _change(studio, wanted.clips, "changed", lambda library, there: library.relabel(there, **wanted.labels))


@router.post("/clips/tag", summary="Give tags to clips, or take tags away")
def tag(studio: StudioNow, wanted: Tagging) -> Answer:
    """``favourite`` is the star. Clips that are gone meanwhile are left out; ``change`` as in POST /clips/relabel."""
    return _change(
        studio, wanted.clips, "changed", lambda library, there: library.tag(there, add=wanted.add, remove=wanted.remove)
    )


@router.post("/clips/remove", summary="Take clips out of the library")
def remove(studio: StudioNow, wanted: Clips) -> Answer:
    """Their files stay, and POST /journal/undo with ``change`` brings them back. Clips that are gone are left out."""
    return _change(studio, wanted.clips, "removed", lambda library, there: library.remove(there))


def _change(studio: Studio, clips: list[int], word: str, act: Callable[[Library, list[int]], list[str]]) -> Answer:
    """Change those clips that are still there; how many that were, under a word, and what an undo takes."""
    there = _check_there(studio.listing.now(), clips)
    library = studio.library
    changed = act(library, there)
    return Answer({word: len(changed), "missing": len(set(clips)) - len(there), "change": library.last_change})


def _check_there(snapshot: Snapshot, clip_ids: list[int]) -> list[int]:
    """Those that the library holds; RefusedError if it holds none of them."""
    there = sorted({clip_id for clip_id in clip_ids if clip_id in snapshot})
    if not there:
        raise RefusedError(404, "studio_motions.no_clip", clip=clip_ids[0])
    return there


journal_router = APIRouter(tags=["library"])

_KeptName = Annotated[str, Field(min_length=1, max_length=200, pattern=ONE_LINE)]
_KeptNames = Annotated[list[Annotated[str, Field(max_length=1000)]], Field(max_length=500)]


class Step(StrictModel):
    """Which change."""

    number: Annotated[int, Field(ge=1, le=2**62)] | None = Field(None, description="null for the last one")


class Asked(StrictModel):
    """What a search looks for, or which clips were chosen."""

    text: str | None = Field(None, max_length=300)
    category: _KeptNames | None = None
    performer: _KeptNames | None = None
    tag: _KeptNames | None = None
    kind: Literal["clip", "take"] | None = None
    min_s: float | None = Field(None, ge=0, le=1e7)
    max_s: float | None = Field(None, ge=0, le=1e7)
    clips: Annotated[list[Annotated[int, Field(ge=1, le=2**31 - 1)]], Field(max_length=200_000)] | None = None


class Saving(StrictModel):
    """A search, and its name."""

    name: _KeptName
    asked: Asked


@journal_router.get("/journal", summary="The changes of the library that can be undone or done again")
def list_changes(studio: StudioNow, limit: Annotated[int, Query(ge=1, le=1000)] = 100) -> Answer:
    """The last first; ``kept_bytes`` are those of removed clips."""
    entries = studio.library.journal()
    kept = sum(entry.kept_bytes for entry in entries)
    return Answer({"changes": [entry.to_json() for entry in entries[:limit]], "kept_bytes": kept})


@journal_router.post("/journal/undo", summary="Undo a change of the library")
def undo(studio: StudioNow, wanted: Step) -> Answer:
    """Refused with 409 where the same clips were changed since; nothing is changed then."""
    return Answer(studio.library.undo(wanted.number, n_jobs=1).to_json())


@journal_router.post("/journal/redo", summary="Do a change again that was undone")
def redo(studio: StudioNow, wanted: Step) -> Answer:
    """As POST /journal/undo."""
    return Answer(studio.library.redo(wanted.number, n_jobs=1).to_json())


@journal_router.get("/searches", summary="Searches and selections that are kept")
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


@journal_router.post("/searches", summary="Keep a search or a selection under a name")
def save_search(studio: StudioNow, wanted: Saving) -> Answer:
    """Another one of the same name gives way."""
    asked = {name: value for name, value in wanted.asked.model_dump().items() if value not in (None, [], "")}
    if not asked:
        raise RefusedError(422, "studio.empty_search")
    return Answer(studio.library.searches.save(wanted.name, asked).to_json())


@journal_router.post("/searches/forget", summary="Forget a search or a selection that is kept")
def forget_search(studio: StudioNow, wanted: Annotated[str, Query(alias="name", max_length=200)]) -> Answer:
    """Its clips stay."""
    studio.library.searches.remove(wanted)
    return Answer({"name": wanted})
