"""What a table of labels holds: tiers of spans, for one take or for several."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import isfinite
from pathlib import Path

from dousa.errors import MotionFileError, OptionError
from dousa.messages import Message
from dousa.motion.annotation import Annotation, Stretch

_TOUCHING = 1e-3  # s that neighbours may overlap by
_LATEST = 1e7  # s


@dataclass(frozen=True, slots=True)
class LabelSpan:
    """One label.

    Parameters
    ----------
    start, stop : s, or frames in a file that counts them.
    category : not empty.
    line : of the file, for messages; None where it has none.
    """

    start: float
    stop: float
    category: str
    line: int | None = None


@dataclass(frozen=True, slots=True)
class LabelTier:
    """Labels of one kind, or of one person.

    Parameters
    ----------
    name : empty where the file has no names for them.
    spans : in the order of time.
    unclear : (start, stop) of parts of which nobody can say what they are.
    n_points : labels of a moment, which have no length and are not among the spans.
    warnings : doubts that came up.
    """

    name: str
    spans: tuple[LabelSpan, ...]
    unclear: tuple[tuple[float, float], ...] = ()
    n_points: int = 0
    warnings: tuple[Message, ...] = ()


@dataclass(frozen=True, slots=True)
class LabelFile:
    """All tiers of a file.

    Parameters
    ----------
    path : of the file.
    takes : tiers by take: its name as the file writes it, empty where the file is about one take.
    by_name : whether takes are called by the bare names of their files, in any spelling of numbers.
    counts_frames : whether times are frames of the take rather than seconds.
    """

    path: str
    takes: Mapping[str, tuple[LabelTier, ...]]
    by_name: bool = True
    counts_frames: bool = False

    def tiers_of(
        self, take: str | os.PathLike[str], root: str | os.PathLike[str] | None = None
    ) -> tuple[LabelTier, ...] | None:
        """Tiers of a take, None where the file has none of it.

        Parameters
        ----------
        take : its path.
        root : the folder that was named, which paths of the file may be relative to.
        """
        if "" in self.takes:
            return self.takes[""]
        path = os.path.abspath(take)
        bases = [os.path.dirname(os.path.abspath(self.path)), *([os.path.abspath(root)] if root else [])]
        for name, tiers in self.takes.items():
            relative = os.path.normpath(name.replace("\\", "/"))
            if any(os.path.normpath(os.path.join(base, relative)) == path for base in bases):
                return tiers
        if not self.by_name:
            return None
        for key in (_bare, _plain):
            for name, tiers in self.takes.items():
                if key(name) == key(path):
                    return tiers
        return None


def _bare(path: str) -> str:
    """The name of a file without folder and suffix."""
    return Path(path.replace("\\", "/")).name.partition(".")[0]


def _plain(path: str) -> str:
    """The same, numbers without zeros in front, words apart by underscores: ``86 01`` is ``86_1``."""
    return "_".join(word.lstrip("0") or "0" for word in re.split(r"[\s_]+", _bare(path).lower()))


def choose_tier(file: LabelFile, tiers: Sequence[LabelTier], wanted: str | None) -> tuple[LabelTier, list[Message]]:
    """The tier of this name, by default the first that has labels; and what to say about that.

    Raises
    ------
    OptionError : there is no such tier.
    """
    if wanted is not None:
        found = [tier for tier in tiers if tier.name == wanted]
        if not found:
            names = [tier.name for tier in tiers if tier.name]
            code = "label_files.no_tier" if names else "label_files.no_tiers"
            raise OptionError(code, path=file.path, tier=wanted, found=names)
        return found[0], []
    full = [tier for tier in tiers if tier.spans]
    chosen = full[0] if full else (tiers[0] if tiers else LabelTier("", ()))
    if len(full) < 2:
        return chosen, []
    others = [tier.name for tier in full[1:]]
    return chosen, [Message("label_files.tier_chosen", tier=chosen.name, others=others)]


def to_annotation(
    file: LabelFile, tiers: Sequence[LabelTier], tier: str | None = None, frame_rate: float | None = None
) -> tuple[Annotation, list[Message]]:
    """What a file says of a take, in seconds, and doubts.

    Parameters
    ----------
    tiers : of the take.
    tier : name of the one to take; the first that has labels by default.
    frame_rate : Hz, of the take; needed where the file counts frames.

    Raises
    ------
    OptionError : there is no such tier, or no frame rate.
    """
    chosen, notes = choose_tier(file, tiers, tier)
    notes = [*chosen.warnings, *notes]
    if file.counts_frames and not frame_rate:
        raise OptionError("label_files.no_rate", path=file.path)
    scale = 1.0 / frame_rate if file.counts_frames and frame_rate else 1.0
    if chosen.n_points:
        notes.append(Message("label_files.points", path=file.path, n=chosen.n_points))
    notes += _find_overlaps(file.path, chosen.spans)
    segments = tuple(Stretch(one.start * scale, one.stop * scale, one.category) for one in chosen.spans)
    unclear = tuple((start * scale, stop * scale) for start, stop in chosen.unclear)
    return Annotation(segments, unclear, file.path, chosen.name), notes


def _find_overlaps(path: str, spans: Sequence[LabelSpan]) -> list[Message]:
    ordered = sorted(spans, key=lambda one: (one.start, one.stop))
    both = []
    last: LabelSpan | None = None
    for one in ordered:
        if last is not None and one.start < last.stop - _TOUCHING:
            both.append((last, one))
        if last is None or one.stop > last.stop:
            last = one
    if not both:
        return []
    first, second = both[0]
    values = {"start": second.start, "stop": second.stop, "category": second.category, "other": first.category}
    note = Message("label_files.overlap", n=len(both), other_start=first.start, other_stop=first.stop, **values)
    line = second.line if second.line is not None else first.line
    where = Message("text.in_file", path=path, problem=note)
    return [where if line is None else Message("text.in_line", path=path, line=line, problem=note)]


def clean_category(text: str) -> str:
    """A label in one line without space around it; empty if it says nothing."""
    return " ".join(text.split())


def make_span(path: str, start: float, stop: float, category: str, line: int | None) -> LabelSpan:
    """A label of some length.

    Raises
    ------
    MotionFileError : it ends before it begins, or lies nowhere in a recording.
    """
    if not (isfinite(start) and isfinite(stop) and abs(start) < _LATEST and abs(stop) < _LATEST):
        raise MotionFileError(path, "label_files.no_time", line, found=f"{start:g}, {stop:g}")
    if stop <= start:
        raise MotionFileError(path, "label_files.backwards", line, start=start, stop=stop, category=category)
    if start < 0:
        raise MotionFileError(path, "label_files.negative", line, start=start, category=category)
    return LabelSpan(start, stop, category, line)


def parse_number(path: str, text: str, column: str, line: int) -> float:
    """A number of a cell, with a point or, where that is unmistakable, a comma.

    Raises
    ------
    MotionFileError : no number.
    """
    try:
        return float(text.strip().replace(",", "."))
    except ValueError:
        raise MotionFileError(path, "label_files.no_number", line, column=column, found=text.strip()[:40]) from None


def decode_text(path: str, data: bytes, encoding: str = "utf-8-sig") -> str:
    """The text of a file in UTF-8, or in UTF-16 if it says so.

    Raises
    ------
    MotionFileError : bytes that are no text, or zero bytes.
    """
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        encoding = "utf-16"
    try:
        text = data.decode(encoding)
    except UnicodeDecodeError as error:
        line = data[: error.start].count(b"\n") + 1 if encoding != "utf-16" else None
        raise MotionFileError(path, "label_files.not_utf8", line) from error
    if "\0" in text:
        raise MotionFileError(path, "label_files.zero_bytes", text[: text.index("\0")].count("\n") + 1)
    return text


def sort_spans(tier: LabelTier) -> LabelTier:
    """The tier with its spans in the order of time."""
    return replace(tier, spans=tuple(sorted(tier.spans, key=lambda one: (one.start, one.stop))))
