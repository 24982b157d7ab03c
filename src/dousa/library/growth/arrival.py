"""What follows from new motions before the forest learns from them: what it says of them as it is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dousa.library import schema
from dousa.library.features import Description, describe_clip, lacks
from dousa.library.forests import StoredForest, TreeAnswers, ask_trees
from dousa.library.ingest import ClipRecord
from dousa.library.takes.kept_windows import describe_windows
from dousa.library.text.store import describe_relations


@dataclass(frozen=True, slots=True, eq=False)
class Arrival:
    """What is kept of new clips, segments and takes beside what was read.

    Parameters
    ----------
    stored : the forest that was asked; None in a library that is not trained.
    names : of the motions, with all that this depends on.
    described : place among the motions, and features and poses, of the clips that the forest is asked about.
    answers : what it says of these.
    windows : by place, of takes.
    relations : by place, as JSON.
    """

    stored: StoredForest | None
    names: tuple[Any, ...]
    described: Mapping[int, Description] = field(default_factory=dict)
    answers: TreeAnswers | None = None
    windows: Mapping[int, bytes] = field(default_factory=dict)
    relations: Sequence[list[list[Any]]] = ()


def describe_arrival(stored: StoredForest | None, fresh: Sequence[ClipRecord], known: Arrival | None = None) -> Arrival:
    """What follows from new motions, with the labels in their rows.

    Parameters
    ----------
    stored : the forest of the library, None before the training.
    known : what was found out before; returned where it holds.
    """
    names = tuple((record.path, record.row["content_hash"], record.row["kind"]) for record in fresh)
    if known is not None and known.names == names and known.stored is stored:
        return known
    relations = [describe_relations(record.motion) for record in fresh]
    if stored is None:
        return Arrival(None, names, relations=relations)
    # Bodies that lack joints that it asks about are told apart by forests of their own, when they are needed.
    whole = [place for place, record in enumerate(fresh) if not lacks(stored.feature_set, record.row["absent"])]
    described = {p: _describe(stored, fresh[p]) for p in whole if fresh[p].row["kind"] == schema.CLIP}
    answers = None
    if described:
        answers = ask_trees(stored, np.stack([description.features for description in described.values()]))
    windows = {
        place: describe_windows(stored, fresh[place].motion, None).to_bytes()
        for place in whole
        if fresh[place].row["kind"] == schema.TAKE
    }
    return Arrival(stored, names, described, answers, windows, relations)


def _describe(stored: StoredForest, record: ClipRecord) -> Description:
    """Features and poses of a clip; computed here only if the forest changed while the file was read."""
    known = record.description
    if known is not None and known.feature_set == stored.feature_set:
        return known
    return describe_clip(record.motion, stored.feature_set)
