"""What jobs do: one function per kind of work, ``run(request, context) -> result``.

A function gets what was asked for as plain values that were checked when they came in, and returns plain values. It
calls ``context.progress`` often: that is where work in a thread is stopped. Larger results go into files of
``context.folder``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dousa.app.studio.studio import Studio
    from dousa.library import Library

__all__ = ["WORK", "Context"]


@dataclass(frozen=True, slots=True)
class Context:
    """What work is given.

    Parameters
    ----------
    library : file of the library.
    home : the studio's folder, see `dousa.app.studio.workspace.Workspace`.
    folder : where this job writes.
    progress : called with (done, total, what is being done); raises when the job was stopped.
    tell : called with what a person should know, a sentence.
    shared : the library that the studio has open, for work in a thread.
    studio : the studio itself, for work in a thread.
    """

    library: Path
    home: Path
    folder: Path
    progress: Callable[[int, int, str], None]
    tell: Callable[[str], None]
    shared: Library | None = None
    studio: Studio | None = None

    def open_library(self) -> Library:
        """The library: the studio's own, or one of this process."""
        from dousa.library import Library

        # The studio made it when it started: one that is not there was taken away, and no empty one takes its place.
        return Library.open(self.library) if self.shared is None else self.shared


class _Work(Mapping[str, Callable[[dict[str, Any], Context], dict[str, Any]]]):
    """Functions by the kind of work, each loaded when it is used."""

    _HOME = {  # noqa: RUF012 - a constant
        "add": "adding",
        "train": "training",
        "label": "labelling",
        "evaluate": "evaluating",
        "estimate": "estimating",
        "preview": "previewing",
        "example": "exampling",
    }

    def __getitem__(self, kind: str) -> Callable[[dict[str, Any], Context], dict[str, Any]]:
        module = import_module(f"{__name__}.{self._HOME[kind]}")
        run: Callable[[dict[str, Any], Context], dict[str, Any]] = module.run
        return run

    def __iter__(self) -> Any:
        return iter(self._HOME)

    def __len__(self) -> int:
        return len(self._HOME)


WORK = _Work()
"""The kinds of work."""
