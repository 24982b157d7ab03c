"""Matching takes with labels: finds their tables, fits segments into takes, and refuses tables that do not fit.

A take without a table of its own gets that of another file with the same content.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import isfinite
from pathlib import Path, PurePath
from typing import Any, Self

from dousa.errors import DousaError, MotionFileError, OptionError
from dousa.formats.annotations import LABEL_SUFFIXES, LabelFile, LabelTier, is_label_file, read_label_file
from dousa.formats.annotations.label_file import choose_tier, leave_out_twice, to_annotation
from dousa.formats.annotations.tables import about_one_take
from dousa.formats.motion_files import FoundFile
from dousa.library.label_rules import check_labels
from dousa.library.results import TakeAnnotation
from dousa.messages import Message
from dousa.motion.annotation import Annotation, Stretch


@dataclass(frozen=True, slots=True)
class TakeLength:
    """The length of a take: duration in s, frame rate in Hz, number of frames; and its path, for messages."""

    path: str
    duration: float
    frame_rate: float
    n_frames: int

    @classmethod
    def of(cls, row: Any) -> Self:
        """Read it from a row of ``clips``."""
        return cls(row.path, row.duration, row.frame_rate, row.n_frames)

    def find_frames(self, segment: Stretch) -> tuple[int, int]:
        """Return the first frame of a segment, and the one after its last."""
        first, stop = round(segment.start * self.frame_rate), round(segment.stop * self.frame_rate)
        return max(first, 0), min(stop, self.n_frames)


def fit(take: TakeLength, segments: Iterable[Stretch], *, least_frames: int = 2) -> tuple[list[Stretch], list[Message]]:
    """Fit segments into a take, sorted by time and without repeats; return them and notes on the others.

    Segments of fewer than ``least_frames`` are left out, as one pose is no motion.
    """
    once, twice = leave_out_twice(sorted(segments, key=lambda one: (one.start, one.stop)))
    kept, cut, beyond, short = [], [], [], []
    for one in once:
        part = replace(one, start=max(one.start, 0.0), stop=min(one.stop, take.duration))
        first, last = take.find_frames(part)
        if last - first >= least_frames:
            kept.append(part)
            if one.stop - take.duration > 1.0 / take.frame_rate:
                cut.append(one)
        elif one.start >= take.duration or one.stop <= 0.0:
            beyond.append(one)
        else:
            short.append(one)
    # Segments cut to the same place count once, too.
    kept, same = leave_out_twice(kept)
    notes = [note for _, note in twice or same]
    if cut:
        end = {"start": cut[0].start, "stop": cut[0].stop, "category": cut[0].category}
        notes.append(Message("annotations.past_end", n=len(cut), duration=take.duration, **end))
    if beyond:
        end = {"start": beyond[0].start, "stop": beyond[0].stop, "category": beyond[0].category}
        notes.append(Message("annotations.beyond", n=len(beyond), duration=take.duration, **end))
    if short:
        notes.append(Message("annotations.too_short", n=len(short), start=short[0].start, category=short[0].category))
    return kept, notes


def check_fit(take: TakeLength, labels: Annotation, *, covered: float = 0.25) -> None:
    """Refuse a table of another take, which would remove the take's labels.

    MotionFileError, with table and line, if no label lies in the take, all are too short for it, or they count
    milliseconds or frames; OptionError for labels without a table. Where some lie in the take, times in another unit
    must cover the share ``covered`` of it; less refuses more tables.
    """
    if not labels.segments:
        return
    kept, _ = fit(take, labels.segments)
    unit = _guess_unit(take, labels.segments, 0.0 if not kept else covered)
    if kept and unit is None:
        return
    outside = [one for one in labels.segments if one.stop > take.duration or one.stop <= 0.0]
    first = min(outside or labels.segments, key=lambda one: (one.start, one.stop))
    values = {"start": first.start, "stop": first.stop, "category": first.category, "take": PurePath(take.path).name}
    if unit is None and not outside:
        raise _about(labels, first, Message("annotations.all_short", **values))
    remedy = unit or Message("annotations.other_take", n=len(labels.segments))
    raise _about(labels, first, Message("annotations.outside", duration=take.duration, remedy=remedy, **values))


def _about(labels: Annotation, segment: Stretch, problem: Message) -> DousaError:
    return MotionFileError(labels.source, problem, segment.line) if labels.source else OptionError(problem)


def _guess_unit(
    take: TakeLength, segments: Sequence[Stretch], covered: float, *, far: float = 3.0, slack: float = 1.05
) -> Message | None:
    """Guess the unit of times that are not seconds but cover a share of the take; None if they may be seconds.

    They are whole numbers up to ``far`` durations or more, that in their unit end before ``slack`` durations.
    """
    times = [time for one in segments for time in (one.start, one.stop)]
    last = max(times)
    if last < far * take.duration or any(time != int(time) for time in times):
        return None
    for scale, unit in (
        (take.frame_rate, Message("annotations.in_frames", rate=take.frame_rate)),
        (1000.0, Message("annotations.in_ms")),
    ):
        if covered * take.duration <= last / scale <= slack * take.duration:
            return unit
    return None


def check_times(start: float, stop: float, category: str | None) -> None:
    """Raise OptionError for invalid times: no numbers, or an end that is not after the beginning."""
    if not (_is_time(start) and _is_time(stop)):
        raise OptionError("label_files.no_time", found=f"{start}, {stop}")
    if stop <= start:
        raise OptionError("label_files.backwards", start=start, stop=stop, category=category or "")


def _is_time(value: object) -> bool:
    try:
        return isfinite(value)  # type: ignore[arg-type]
    except (TypeError, OverflowError):
        return False


def check_annotation(labels: Annotation) -> None:
    """Raise OptionError for invalid labels: times as in `check_times`, an empty or too long category."""
    for one in labels.segments:
        check_labels(one.category)
        check_times(one.start, one.stop, one.category)
    for start, stop in labels.unclear:
        check_times(start, stop, None)


_TABLES = (".csv", ".tsv")  # may also be a recording


@dataclass(frozen=True, slots=True)
class FoundLabels:
    """The label table of a take, its tiers of this take, and doubts about whether they are of this take."""

    file: LabelFile
    tiers: tuple[LabelTier, ...]
    notes: tuple[Message, ...] = ()


def find_labels(files: Sequence[FoundFile], rule: str, tier: str | None) -> dict[str, FoundLabels]:
    """Read all tables and return labels by the path of the take.

    OptionError for an invalid rule, no labels of any take, two tables of one take, no such tier. MotionFileError for a
    table that cannot be read, with its line.

    Parameters
    ----------
    files : the takes.
    rule : ``beside`` (a table beside each take), ``folder:DIR`` or ``csv:FILE``.
    tier : name of the tier, None for the first that has labels.
    """
    kind, _, rest = rule.partition(":")
    if (kind, rest) != ("beside", "") and not (kind in ("folder", "csv") and rest):
        raise OptionError("annotations.unknown_rule", text=rule)
    found: dict[str, FoundLabels] = {}
    called: dict[tuple[str, str], list[str]] = {}  # takes by table and name in it
    if kind == "csv":
        file = read_label_file(os.path.expanduser(rest))
        for one in files:
            name = file.name_of(one.path, one.root if one.root != one.path else None)
            if name is not None:
                found[str(one.path)] = FoundLabels(file, file.takes[name])
                called.setdefault((file.path, name), []).append(str(one.path))
        if files and not found:
            raise OptionError(
                "annotations.none_in_file", path=file.path, takes=list(file.takes), name=files[0].path.name
            )
    else:
        where = _Folders(Path(os.path.expanduser(rest)) if rest else None)
        for one in files:
            path = where.find(one.path)
            if path is not None:
                file = about_one_take(read_label_file(path))
                tiers = file.tiers_of(one.path)
                if tiers is not None:
                    found[str(one.path)] = FoundLabels(file, tiers)
                    if kind == "folder":
                        called.setdefault((file.path, path.name), []).append(str(one.path))
        if files and not found:
            stem = files[0].path.name.partition(".")[0]
            raise OptionError("annotations.none_beside", folder=rest or files[0].path.parent, stem=stem)
    for labels in found.values():
        choose_tier(labels.file, labels.tiers, tier)  # raises if missing
    _note_names(found, called)
    return found


def _note_names(found: dict[str, FoundLabels], called: Mapping[tuple[str, str], Sequence[str]]) -> None:
    """Add a note to takes in different folders that share one name in a table."""
    for (table, name), takes in called.items():
        if len({os.path.dirname(take) for take in takes}) > 1:  # one take in two formats is in one folder
            values = {"n": len(takes), "takes": takes[:4], "name": name or os.path.basename(table)}
            note = Message("annotations.one_name", path=table, **values)
            found.update({take: replace(found[take], notes=(note,)) for take in takes})


class _Folders:
    """Tables beside takes, or in one folder; names in any case."""

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder
        self._names: dict[Path, dict[str, str]] = {}

    def find(self, take: Path) -> Path | None:
        folder = self._folder or take.parent
        names = self._list(folder)
        stems = list(dict.fromkeys((take.name.partition(".")[0].lower(), take.stem.lower())))
        found = [folder / names[stem + suffix] for stem in stems for suffix in LABEL_SUFFIXES if stem + suffix in names]
        if not found:
            tables = [folder / names[stem + suffix] for stem in stems for suffix in _TABLES if stem + suffix in names]
            found = [path for path in tables if path != take and is_label_file(path)]
        found = list(dict.fromkeys(found))
        if len(found) > 1:
            raise OptionError("annotations.two_tables", take=take, found=[path.name for path in found])
        return found[0] if found else None

    def _list(self, folder: Path) -> dict[str, str]:
        if folder not in self._names:
            try:
                self._names[folder] = {name.lower(): name for name in sorted(os.listdir(folder))}
            except OSError as error:
                raise OptionError("annotations.no_folder", folder=folder, reason=error) from error
        return self._names[folder]


@dataclass(frozen=True, slots=True)
class ChosenLabels:
    """The labels chosen for a take, None to keep the present ones; notes about new labels, and permanent notes."""

    labels: Annotation | None
    notes: tuple[Message, ...] = ()
    always: tuple[Message, ...] = ()


def choose_labels(
    row: Any, own: FoundLabels | None, copies: Sequence[FoundLabels], stored: TakeAnnotation, tier: str | None
) -> ChosenLabels:
    """Choose the labels of a take, with a note if any are lost.

    Parameters
    ----------
    row : of the take: path, frame_rate, duration, n_frames.
    own : of its table, None if it has none.
    copies : of the tables of other files with the same content; one is used if ``own`` is None.
    stored, tier : its present labels, and the name of the tier.
    """
    labels: Annotation | None = None
    notes: tuple[Message, ...] = ()
    always: list[Message] = []
    if own is not None:
        labels, said = to_annotation(own.file, own.tiers, tier, row.frame_rate)
        notes = (*own.notes, *said)
    source = None if labels is None or labels.is_blank else labels.source
    if source is None and stored.is_complete and stored.segments and (own or _may_be_there(stored.source)):
        source = stored.source  # not replaced by a copy
    there = {(one.start, one.end, one.category) for one in stored.segments}
    kept = there if labels is None or labels.is_blank else _list_places(row, labels)
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
    """Return whether the table of labels may still exist; a table of the studio is known by name only."""
    return not os.path.isabs(source) or os.path.exists(source)


def _say_remedy(take: str, table: str) -> Message:
    if Path(take).name.partition(".")[0].lower() == Path(table).name.partition(".")[0].lower():
        return Message("annotations.copy_by_folder", take=take, folder=os.path.dirname(table) or ".")
    return Message("annotations.copy_otherwise")


_Places = set[tuple[float, float, str | None]]


def _list_places(row: Any, labels: Annotation) -> _Places:
    return {(one.start, one.stop, one.category) for one in fit(TakeLength.of(row), labels.segments)[0]}
