"""Which labels a take gets: those of its table, or of the table of another file of the same content."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dousa.formats.annotations.label_file import to_annotation
from dousa.library.annotations.fitting import TakeLength, fit
from dousa.library.annotations.places import FoundLabels
from dousa.library.results import TakeAnnotation
from dousa.messages import Message
from dousa.motion.annotation import Annotation


@dataclass(frozen=True, slots=True)
class ChosenLabels:
    """What becomes of the labels of a take.

    Parameters
    ----------
    labels : that it gets; None where it keeps what it has.
    notes : about them, to be said if they are new.
    always : notes that are said in any case.
    """

    labels: Annotation | None
    notes: tuple[Message, ...] = ()
    always: tuple[Message, ...] = ()


def choose_labels(
    row: Any, own: FoundLabels | None, copies: Sequence[FoundLabels], stored: TakeAnnotation, tier: str | None
) -> ChosenLabels:
    """The labels of a take, so that none are lost without a word.

    Parameters
    ----------
    row : of the take: path, frame_rate, duration, n_frames.
    own : of its table, None where it has none.
    copies : of the tables of other files that hold the same; one of them counts where the take has no table of its own.
    stored : what is written down of it.
    tier : that is wanted.
    """
    labels: Annotation | None = None
    notes: tuple[Message, ...] = ()
    always: list[Message] = []
    if own is not None:
        labels, said = to_annotation(own.file, own.tiers, tier, row.frame_rate)
        notes = (*own.notes, *said)
    source = None if labels is None or labels.is_blank else labels.source
    if source is None and stored.is_complete and stored.segments and (own or _may_be_there(stored.source)):
        source = stored.source  # which a copy does not replace
    kept = _list_places(row, labels) if labels is not None and not labels.is_blank else _list_stored(stored)
    for copy in copies:
        other, said = to_annotation(copy.file, copy.tiers, tier, row.frame_rate)
        if other.is_blank or (source is not None and _list_places(row, other) == kept):
            continue
        if source is None or (labels is None and source == other.source):
            labels, notes, source = other, (*copy.notes, *said), other.source
            kept = _list_places(row, other)
        else:
            remedy = _say_remedy(row.path, other.source)
            values = {"table": other.source, "take": row.path, "source": source, "remedy": remedy}
            always.append(Message("annotations.copy_unread", **values))
    if labels is None and not copies:
        always.append(Message("annotations.no_table"))
    if labels is not None and labels.is_blank:
        always += notes
        if stored.segments:
            always.append(Message("annotations.blank_kept", table=labels.source, n=len(stored.segments)))
            return ChosenLabels(None, always=tuple(always))
        always.append(Message("annotations.blank", table=labels.source))
    return ChosenLabels(labels, notes, tuple(always))


def _may_be_there(source: str) -> bool:
    """Whether a table is there that labels came from, or may be: one of the studio is known by its name alone."""
    return not os.path.isabs(source) or os.path.exists(source)


def _say_remedy(take: str, table: str) -> Message:
    if Path(take).name.partition(".")[0].lower() == Path(table).name.partition(".")[0].lower():
        return Message("annotations.copy_by_folder", take=take, folder=os.path.dirname(table) or ".")
    return Message("annotations.copy_otherwise")


_Places = set[tuple[float, float, str | None]]


def _list_places(row: Any, labels: Annotation) -> _Places:
    return {(one.start, one.stop, one.category) for one in fit(TakeLength.of(row), labels.segments)[0]}


def _list_stored(stored: TakeAnnotation) -> _Places:
    return {(one.start, one.end, one.category) for one in stored.segments}
