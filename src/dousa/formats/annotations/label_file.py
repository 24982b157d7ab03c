"""Content of a table of labels: tiers of spans, for one take or for several."""

from __future__ import annotations

import os
import re
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from math import isfinite
from pathlib import Path

from dousa.errors import MotionFileError, OptionError
from dousa.messages import LANGUAGES, Message
from dousa.motion.annotation import Annotation, Stretch

MOST_BYTES = 1000
"""Of a label in UTF-8: indexes of PostgreSQL take a third of a page (https://www.postgresql.org/docs/current/btree.html)."""


@dataclass(frozen=True, slots=True)
class LabelTier:
    """Labels of one kind, or of one person.

    Parameters
    ----------
    name : empty where the file has none.
    spans : in the order of time, each with a category; s, or frames in a file that counts them.
    unclear : (start, stop) of unclear parts.
    n_points : labels of a moment, which have no length and are not among the spans.
    n_rest : labels without a category (nothing happens), which are not among the spans.
    warnings : doubts about the file.
    """

    name: str
    spans: tuple[Stretch, ...]
    unclear: tuple[tuple[float, float], ...] = ()
    n_points: int = 0
    warnings: tuple[Message, ...] = ()
    n_rest: int = 0

    @property
    def is_blank(self) -> bool:
        """Whether the tier is empty: without even a label for nothing."""
        return not (self.spans or self.unclear or self.n_rest)


@dataclass(frozen=True, slots=True)
class LabelFile:
    """All tiers of a file.

    Parameters
    ----------
    path : of the file.
    takes : tiers by take: its name as the file writes it, empty where the file is about one take.
    by_name : whether takes are named by the bare names of their files, in any spelling of numbers.
    counts_frames : whether times are frames of the take rather than seconds.
    """

    path: str
    takes: Mapping[str, tuple[LabelTier, ...]]
    by_name: bool = True
    counts_frames: bool = False

    def tiers_of(
        self, take: str | os.PathLike[str], root: str | os.PathLike[str] | None = None
    ) -> tuple[LabelTier, ...] | None:
        """Return the tiers of a take by its path, None without any; paths of the file may be relative to ``root``."""
        name = self.name_of(take, root)
        return None if name is None else self.takes[name]

    def name_of(self, take: str | os.PathLike[str], root: str | os.PathLike[str] | None = None) -> str | None:
        """Return the name of a take in the file, None where it has none; parameters as of ``tiers_of``."""
        if "" in self.takes:
            return ""
        path = os.path.abspath(take)
        bases = [os.path.dirname(os.path.abspath(self.path)), *([os.path.abspath(root)] if root else [])]
        for name in self.takes:
            relative = os.path.normpath(name.replace("\\", "/"))
            if any(os.path.normpath(os.path.join(base, relative)) == path for base in bases):
                return name
        if not self.by_name:
            return None
        for key in (_bare, _plain):
            for name in self.takes:
                if key(name) == key(path):
                    return name
        return None


def _bare(path: str) -> str:
    return Path(path.replace("\\", "/")).name.partition(".")[0]


def _plain(path: str) -> str:
    """The same without leading zeros of numbers, words joined by underscores: ``86 01`` is ``86_1``."""
    return "_".join(word.lstrip("0") or "0" for word in re.split(r"[\s_]+", _bare(path).lower()))


def choose_tier(file: LabelFile, tiers: Sequence[LabelTier], wanted: str | None) -> tuple[LabelTier, list[Message]]:
    """Choose the tier of this name, by default the first that has labels, with notes; OptionError if there is none."""
    if wanted is not None:
        found = [tier for tier in tiers if tier.name == wanted]
        if not found:
            names = [tier.name for tier in tiers if tier.name]
            code = "label_files.no_tier" if names else "label_files.no_tiers"
            raise OptionError(code, path=file.path, tier=wanted, found=names)
        return found[0], []
    full = [tier for tier in tiers if tier.spans]
    some = full or [tier for tier in tiers if not tier.is_blank] or list(tiers)
    chosen = some[0] if some else LabelTier("", ())
    if len(full) < 2:
        return chosen, []
    others = [tier.name for tier in full[1:]]
    return chosen, [Message("label_files.tier_chosen", tier=chosen.name, others=others)]


def to_annotation(
    file: LabelFile, tiers: Sequence[LabelTier], tier: str | None = None, frame_rate: float | None = None
) -> tuple[Annotation, list[Message]]:
    """Convert the labels of a take to seconds, with doubts.

    Parameters
    ----------
    tiers : of the take.
    tier : name of the tier; the first that has labels by default.
    frame_rate : Hz, of the take; needed where the file counts frames.

    Raises
    ------
    OptionError : no such tier, or no frame rate.
    """
    chosen, notes = choose_tier(file, tiers, tier)
    notes = [*chosen.warnings, *notes]
    if file.counts_frames and not frame_rate:
        raise OptionError("label_files.no_rate", path=file.path)
    scale = 1.0 / frame_rate if file.counts_frames and frame_rate else 1.0
    if chosen.n_points:
        notes.append(Message("label_files.points", path=file.path, n=chosen.n_points))
    scaled = [replace(one, start=one.start * scale, stop=one.stop * scale) for one in chosen.spans]
    segments, twice = leave_out_twice(scaled)
    notes += [_say_where(file.path, one.line, note) for one, note in twice]
    notes += _find_overlaps(file.path, segments)
    unclear = tuple((start * scale, stop * scale) for start, stop in chosen.unclear)
    return Annotation(tuple(segments), unclear, file.path, chosen.name, chosen.is_blank), notes


def leave_out_twice(segments: Sequence[Stretch]) -> tuple[list[Stretch], list[tuple[Stretch, Message]]]:
    """Drop repeated segments: equal times to the millisecond and category.

    Returns
    -------
    The segments in their order, and the first that was left out with a note about all of them, if there are any.
    """
    once: dict[tuple[float, float, str | None], Stretch] = {}
    again = []
    for one in segments:
        if once.setdefault((round(one.start, 3), round(one.stop, 3), one.category), one) is not one:
            again.append(one)
    if not again:
        return list(segments), []
    first = again[0]
    values = {"start": first.start, "stop": first.stop, "category": first.category}
    return list(once.values()), [(first, Message("label_files.twice", n=len(again), **values))]


def _say_where(path: str, line: int | None, note: Message) -> Message:
    if line is None:
        return Message("text.in_file", path=path, problem=note)
    return Message("text.in_line", path=path, line=line, problem=note)


def _find_overlaps(path: str, spans: Sequence[Stretch], touching: float = 1e-3) -> list[Message]:
    """Note spans that overlap their neighbours by more than ``touching`` s."""
    ordered = sorted(spans, key=lambda one: (one.start, one.stop))
    both = []
    last: Stretch | None = None
    for one in ordered:
        if last is not None and one.start < last.stop - touching:
            both.append((last, one))
        if last is None or one.stop > last.stop:
            last = one
    if not both:
        return []
    first, second = both[0]
    values = {"start": second.start, "stop": second.stop, "category": second.category, "other": first.category}
    note = Message("label_files.overlap", n=len(both), other_start=first.start, other_stop=first.stop, **values)
    line = second.line if second.line is not None else first.line
    return [_say_where(path, line, note)]


def clean_category(text: str) -> str:
    """Return a label in one line without space around it, possibly empty."""
    return " ".join(text.split())


def is_unknown(category: str) -> bool:
    """Return whether a label is one of dousa's words for an unknown category."""
    return _fold(category) in _list_unknown()


@cache
def _list_unknown() -> frozenset[str]:
    words = [Message("label_files.unknown_words").render(language).split("|") for language in LANGUAGES]
    return frozenset(_fold(word) for some in words for word in some)


def _fold(word: str) -> str:
    return unicodedata.normalize("NFKC", word).casefold()


def check_category(path: str, category: str, line: int | None) -> None:
    """Raise MotionFileError for a label that not every database can store."""
    n_bytes = len(category.encode(errors="surrogatepass"))
    if n_bytes > MOST_BYTES:
        raise MotionFileError(
            path, "label_files.long_category", line, category=category[:40], found=n_bytes, most=MOST_BYTES
        )


def make_span(path: str, start: float, stop: float, category: str, line: int | None) -> Stretch:
    """Make a label of some length; MotionFileError for invalid times or a category that is too long."""
    check_category(path, category, line)
    if not (isfinite(start) and isfinite(stop) and max(abs(start), abs(stop)) < 1e7):
        raise MotionFileError(path, "label_files.no_time", line, found=f"{start:g}, {stop:g}")
    if stop <= start:
        raise MotionFileError(path, "label_files.backwards", line, start=start, stop=stop, category=category)
    if start < 0:
        raise MotionFileError(path, "label_files.negative", line, start=start, category=category)
    return Stretch(start, stop, category, line=line)


def parse_number(path: str, text: str, column: str, line: int) -> float:
    """Parse the number of a cell, with a point or an unmistakable decimal comma; MotionFileError if it is none."""
    try:
        return float(text.strip().replace(",", "."))
    except ValueError:
        raise MotionFileError(path, "label_files.no_number", line, column=column, found=text.strip()[:40]) from None


def decode_text(path: str, data: bytes, encoding: str = "utf-8-sig") -> str:
    """Decode a file in UTF-8, or in UTF-16 by its mark; MotionFileError if it is no text or has zero bytes."""
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


def finish_tier(path: str, tier: LabelTier) -> LabelTier:
    """Sort the spans by time and drop categories that mean "unknown", with a note."""
    spans = sorted(tier.spans, key=lambda one: (one.start, one.stop))
    unknown = [one for one in spans if is_unknown(one.category or "")]
    if not unknown:
        return replace(tier, spans=tuple(spans))
    note = Message("label_files.unknown", n=len(unknown), category=unknown[0].category)
    warnings = (*tier.warnings, _say_where(path, unknown[0].line, note))
    named = tuple(one for one in spans if not is_unknown(one.category or ""))
    return replace(tier, spans=named, warnings=warnings, n_rest=tier.n_rest + len(unknown))
