"""The places in takes that are most like a motion, and the probability that they show the same."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import sqlalchemy as sa
from numpy.typing import NDArray

from dousa.arrays import FloatArray, IndexArray
from dousa.library.results import MIRROR_SCORE, Place
from dousa.library.search.text_store import find_meanings
from dousa.library.store.features import StoredMotion, describe_clip, find_feature_set, load_motions
from dousa.library.store.forests import StoredForest, ask_trees
from dousa.messages import Message
from dousa.retrieval.features.posed_motion import count_placed, hide_joints
from dousa.retrieval.forest.likeness import merge_votes

if TYPE_CHECKING:
    from dousa.library.takes.scanning import TakesOnDisk
    from dousa.retrieval.takes.find import CutStretch, Found
    from dousa.retrieval.takes.windows import TakeWindows


@dataclass(frozen=True, slots=True, eq=False)
class ReadTake:
    """A take with its windows.

    Parameters
    ----------
    clip_id : number in the library; None for a file outside it.
    read : returns the windows; not all takes fit in memory.
    stored : forest of the windows: the library's, or one for the joints shared by take and query.
    motion : of a take outside the library.
    notes : notes on reading its file, if it was read now.
    """

    path: str
    clip_id: int | None
    read: Callable[[], TakeWindows]
    stored: StoredForest
    motion: StoredMotion | None = None
    notes: tuple[Message, ...] = ()


def find_places(
    motions: Sequence[StoredMotion],
    takes: Sequence[ReadTake],
    k: int,
    on_disk: tuple[StoredForest, TakesOnDisk] | None = None,
) -> tuple[list[tuple[Found, bool]], float]:
    """Find the best places for a query and, if given, its mirror image; also return the seconds of all takes.

    Takes that share the same joints with the query are searched together, those ``on_disk`` without reading all.
    """
    from dousa.retrieval.takes.find import TakeSearch, describe_query

    groups: dict[int, tuple[StoredForest, list[int]]] = {}
    for row, take in enumerate(takes):
        groups.setdefault(id(take.stored), (take.stored, []))[1].append(row)
    most = max((count_placed(stored.hidden) for stored, _ in groups.values()), default=1)
    found: list[tuple[Found, bool]] = []
    seconds = {}
    for stored, rows in groups.values():
        kind = find_feature_set(stored.feature_set)
        queries = [describe_query(stored.forest, kind, hide_joints(motion, kind.hidden)) for motion in motions]
        searches = [TakeSearch(query, k) for query in queries]
        far = on_disk[1] if on_disk is not None and on_disk[0] is stored else None
        wanted: dict[int, int] = {}
        for place, row in enumerate(rows):
            number = takes[row].clip_id
            if far is not None and number is not None and number in far:
                wanted[number] = place
                seconds[row] = far.duration(number)
                for search in searches:
                    search.include(str(row))
                continue
            windows = takes[row].read()
            seconds[row] = windows.duration
            for search in searches:
                search.look(str(row), windows)  # the row, as two files may have one name
        if far is not None:
            far.search(searches, wanted)
        # The score counts only for the share of the joints that is compared.
        share = count_placed(kind.hidden) / most
        for mirrored, search in enumerate(searches):
            places = search.finish(partial(_look_again, takes, rows, far))
            found += [(one if share == 1.0 else replace(one, score=one.score * share), mirrored > 0) for one in places]
    return found, sum(seconds[row] for row in range(len(takes)))


def _look_again(
    takes: Sequence[ReadTake], rows: Sequence[int], far: TakesOnDisk | None, place: int
) -> TakeWindows | CutStretch:
    """Return the windows of the take at one of the rows, or its cutter if it is on disk."""
    take = takes[rows[place]]
    if far is not None and take.clip_id is not None and take.clip_id in far:
        return far.cutter(take.clip_id)
    return take.read()


def rank_places(
    found: list[tuple[Found, bool]], takes: Sequence[ReadTake], k: int, *, shared: float = 0.3
) -> list[Place]:
    """Rank places of the query and of its mirror image, the best first, each once.

    Places whose intersection over union is ``shared`` are one place; less leaves out more of them.
    """
    from dousa.retrieval.takes.find import overlap

    found.sort(key=lambda one: (one[1] * MIRROR_SCORE - one[0].score, int(one[0].take), one[0].start))
    kept: list[tuple[Found, bool]] = []
    for one, mirrored in found:
        same = (
            other.take == one.take and overlap((one.start, one.stop), (other.start, other.stop)) >= shared
            for other, _ in kept
        )
        if not any(same):
            kept.append((one, mirrored))
    places = []
    for rank, (one, mirrored) in enumerate(kept[:k], 1):
        take, measures = takes[int(one.take)], (one.score, one.distance, one.shared_leaves, one.tempo)
        places.append(Place(take.path, take.clip_id, one.start, one.stop, *measures, mirrored, rank))
    return places


def judge_places(
    connection: sa.Connection,
    stored: StoredForest,
    query: StoredMotion,
    takes: Sequence[ReadTake],
    places: list[Place],
    *,
    threshold: float = 0.5,
) -> list[Place]:
    """Rank places by the probability that they show the same as the query, each judged as a clip.

    They probably show it from the threshold on; a higher one calls fewer of them similar.
    """
    from dousa.retrieval.takes.find import judge_place

    if stored.likeness is None or not places or any(take.stored is not stored for take in takes):
        return places  # likeness is learned for the library's forest only
    by_path = {(take.path, take.clip_id): take for take in takes}
    known = {take.clip_id: take.motion for take in takes if take.motion is not None}
    wanted = sorted({place.clip_id for place in places if place.clip_id is not None})
    known |= dict(zip(wanted, load_motions(connection, wanted), strict=True))
    named = find_meanings(stored.categories)
    meanings = np.unique([named[name] for name in stored.categories], return_inverse=True)[1]
    asked = [_describe_alike(stored, motion, meanings) for motion in (query, query.mirror())]
    judged: list[tuple[float, Place]] = []
    for place in places:
        whole = by_path[place.take, place.clip_id].motion or known[place.clip_id]
        first = min(round(place.start * whole.frame_rate), whole.n_frames - 1)
        last = max(round(place.end * whole.frame_rate), first + 1)
        part = StoredMotion(whole.positions[first:last], whole.frame_rate, whole.height)
        shares, means, direction = _describe_alike(stored, part, meanings)
        own = asked[place.mirrored]
        likeness = float(stored.likeness.judge(*own[1:], means[None], direction[None])[0])
        chance = judge_place(likeness, place.score, float(shares[own[0].argmax()]))
        judged.append((chance, replace(place, alike=chance >= threshold, probability=round(chance, 4))))
    judged.sort(key=lambda one: -one[0])
    return [replace(place, rank=rank) for rank, (_, place) in enumerate(judged, 1)]


def count_alike(stored: StoredForest, places: Sequence[Place]) -> int | None:
    judged = [place.alike for place in places if place.alike is not None]
    return None if stored.likeness is None or len(judged) < len(places) else sum(judged)


def _describe_alike(
    stored: StoredForest, motion: StoredMotion, meanings: IndexArray
) -> tuple[FloatArray, FloatArray, NDArray[np.float32]]:
    """Compute a motion's shares of the trees for each category and meaning, and its direction."""
    answers = ask_trees(stored, describe_clip(motion, stored.feature_set).features[None])
    assert answers.directions is not None
    shares = answers.shares()
    return shares[0], merge_votes(shares, meanings)[0], answers.directions[0]
