"""Opening libraries for the commands, and what several of them are told in the same way."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Annotated

import typer

from dousa.errors import LibraryVersionError

if TYPE_CHECKING:
    from dousa.library import Library

__all__ = ["Explain", "Mirror", "Query", "Threshold", "clip_or_path", "open_library", "open_to_read"]

Query = Annotated[
    str, typer.Argument(metavar="QUERY", help="A motion file, or the number of a clip (see dousa list).")
]
Mirror = Annotated[bool, typer.Option("--mirror", help="Look at the mirror image of the motion too.")]
Explain = Annotated[bool, typer.Option("--explain", help="Say why, in words with seconds.")]

Threshold = Annotated[
    float | None,
    typer.Option(
        "--threshold",
        min=0,
        max=1,
        help="Probability of being known below which a motion is unknown; 0: never.",
        show_default="0.5",
    ),
]


def open_library(library: str, *, create: bool = False) -> Library:
    """A library that can be changed."""
    from dousa.library import Library

    return Library.open(library, create=create)


def open_to_read(library: str) -> Library:
    """A library that will only be asked; one that an older dousa made is brought up to date first."""
    from dousa.library import Library

    try:
        return Library.open(library, read_only=True)
    except LibraryVersionError:
        Library.open(library).close()
        return Library.open(library, read_only=True)


def clip_or_path(text: str) -> int | str:
    """The number of a clip, unless a file is called so."""
    is_number = text.isascii() and text.isdigit() and len(text) < 1000  # Python reads no more than some 4,000
    return int(text) if is_number and not os.path.exists(text) else text
