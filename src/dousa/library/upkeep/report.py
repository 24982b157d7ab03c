"""What a check of a library found, and what became of it: plain values."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from dousa.messages import Message


@dataclass(frozen=True, slots=True)
class Damage:
    """Something that is damaged.

    Parameters
    ----------
    what : names the part.
    clip_id, path : of the clip or take; None where the library as a whole is meant.
    remedy : what was done, can be done, or has to be done by hand.
    repaired : whether it is whole again.
    """

    what: Message
    clip_id: int | None
    path: str | None
    remedy: Message
    repaired: bool

    def to_json(self) -> dict[str, Any]:
        """Plain values, messages in the language in use."""
        return {
            "what": str(self.what),
            "clip_id": self.clip_id,
            "path": self.path,
            "remedy": str(self.remedy),
            "repaired": self.repaired,
        }


@dataclass(frozen=True, slots=True)
class CheckReport:
    """The answer of ``Library.check``.

    Parameters
    ----------
    library : its path or URL.
    n_clips : clips and takes.
    n_rows : rows that were compared with their checksums.
    n_sealed : rows of an older dousa that had none, and got them now.
    n_unsealed : those that have none still, as the library cannot be written.
    damage : what is damaged, or was.
    seconds : that it took.
    """

    library: str
    n_clips: int
    n_rows: int
    n_sealed: int
    n_unsealed: int
    damage: tuple[Damage, ...]
    seconds: float

    @property
    def is_sound(self) -> bool:
        """Whether nothing is damaged, any more."""
        return all(one.repaired for one in self.damage)

    def to_messages(self) -> Iterator[Message]:
        """A line for each thing that is or was damaged, then one of the whole."""
        for one in self.damage:
            where = {"what": one.what, "remedy": one.remedy}
            if one.clip_id is None:
                yield Message("library_check.part", **where)
            else:
                yield Message("library_check.of_clip", path=one.path, number=one.clip_id, **where)
        if self.n_sealed:
            yield Message("library_check.sealed", n=self.n_sealed)
        if self.n_unsealed:
            yield Message("library_check.unsealed", n=self.n_unsealed)
        counts = {"clips": self.n_clips, "rows": self.n_rows, "seconds": self.seconds}
        left = sum(not one.repaired for one in self.damage)
        yield (
            Message("library_check.damaged", left=left, **counts) if left else Message("library_check.sound", **counts)
        )

    def to_json(self) -> dict[str, Any]:
        """Plain values, messages in the language in use."""
        return {
            "library": self.library,
            "sound": self.is_sound,
            "n_clips": self.n_clips,
            "n_rows": self.n_rows,
            "n_sealed": self.n_sealed,
            "n_unsealed": self.n_unsealed,
            "damage": [one.to_json() for one in self.damage],
            "seconds": round(self.seconds, 3),
        }
