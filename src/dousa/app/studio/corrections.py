"""What people corrected in takes: each correction is a clip of the library, and remembered here for its take."""

from __future__ import annotations

import json
import secrets
import threading
import time
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

__all__ = ["Correction", "Corrections", "lay_over"]

_FILE = "corrections.json"
_LOCK = threading.Lock()  # one for all studios of a process: they seldom write
_LEAST = 0.02  # s of a stretch that is worth telling


@dataclass(frozen=True, slots=True)
class Correction:
    """A part of a take that somebody named.

    Parameters
    ----------
    motion : name of the take, such as ``clip:7``.
    start_s, end_s : s.
    category : what it shows.
    clip_id : number of the clip of the library that was made of the part.
    batch : of the clip's file.
    id : 16 hexadecimal digits.
    made_s : Unix time.
    """

    motion: str
    start_s: float
    end_s: float
    category: str
    clip_id: int
    batch: str
    id: str = field(default_factory=lambda: secrets.token_hex(8))
    made_s: float = field(default_factory=time.time)

    def to_json(self) -> dict[str, Any]:
        """The correction as a plain dictionary."""
        return asdict(self)


class Corrections:
    """All corrections of a studio, in one small file.

    Parameters
    ----------
    root : the studio's folder.
    """

    def __init__(self, root: Path) -> None:
        self._path = root / _FILE

    def all(self) -> list[Correction]:
        """Every correction, the oldest first; none where the file is damaged."""
        try:
            rows = json.loads(self._path.read_bytes())
            return [Correction(**row) for row in rows]
        except (OSError, ValueError, TypeError):
            return []

    def of(self, names: Iterable[str]) -> list[Correction]:
        """Those of one take, which may have several names, in the order of time."""
        wanted = set(names)
        return sorted((one for one in self.all() if one.motion in wanted), key=lambda one: one.start_s)

    def add(self, correction: Correction) -> None:
        """Remember one."""
        with _LOCK:
            self._write([*self.all(), correction])

    def remove(self, number: str) -> Correction | None:
        """Forget one; None if there is none of this number."""
        with _LOCK:
            known = self.all()
            found = next((one for one in known if one.id == number), None)
            if found is not None:
                self._write([one for one in known if one.id != number])
        return found

    def _write(self, corrections: Sequence[Correction]) -> None:
        from dousa._files import atomic_write

        with atomic_write(self._path) as file:
            file.write(json.dumps([one.to_json() for one in corrections], ensure_ascii=True).encode())


def lay_over(segments: Sequence[dict[str, Any]], corrections: Sequence[Correction]) -> list[dict[str, Any]]:
    """Stretches of a timeline with the corrected ones in their places.

    Parameters
    ----------
    segments : as ``Timeline.to_json`` has them, one after another.
    corrections : of this take; where two overlap, the later made is seen.

    Returns
    -------
    Stretches in the order of time, each with ``corrected``: the number of the correction, None for the labeller's.
    """
    stretches = [{**one, "corrected": None} for one in segments]
    for own in sorted(corrections, key=lambda one: one.made_s):
        stretches = [part for one in stretches for part in _around(one, own.start_s, own.end_s)]
        stretches.append(
            {
                "start_s": own.start_s,
                "end_s": own.end_s,
                "category": own.category,
                "unknown": False,
                "confidence": 1.0,
                "corrected": own.id,
            }
        )
    return sorted(stretches, key=lambda one: (one["start_s"], one["end_s"]))


def _around(stretch: dict[str, Any], start: float, end: float) -> list[dict[str, Any]]:
    """What is left of a stretch outside of a part."""
    left = {**stretch, "end_s": min(stretch["end_s"], start)}
    right = {**stretch, "start_s": max(stretch["start_s"], end)}
    return [one for one in (left, right) if one["end_s"] - one["start_s"] > _LEAST]
