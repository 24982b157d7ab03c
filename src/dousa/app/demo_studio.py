"""The studio on what the demonstration made: its library, with the take and the dances as takes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from dousa.app.demo_evaluation import PUPIL, REFERENCE
from dousa.app.demo_takes import TAKE
from dousa.errors import OptionError

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["LIBRARY", "open_demo_studio", "prepare_studio"]

LIBRARY = "demo.dousa"
_TAKES = (TAKE, REFERENCE, PUPIL, "teacher_*.bvh")


def prepare_studio(output: Path) -> Path:
    """Put the recordings of the demonstration that are no clips into its library, as takes; the library.

    Raises
    ------
    OptionError : the demonstration was not run into this folder.
    """
    from dousa.library import Library

    path = output / LIBRARY
    if not path.is_file():
        raise OptionError(f"{path}: no demo library there; run dousa demo --output {output} first")
    takes = sorted(found for name in _TAKES for found in output.glob(name))
    with Library.open(path) as library:
        library.add(takes, kind="take")
    return path


def open_demo_studio(console: Console, output: Path, *, opens_browser: bool = True) -> None:
    """Open the studio on the demo library, until Ctrl-C.

    Raises
    ------
    OptionError : the demonstration was not run into this folder, or no port is free.
    MissingExtraError : the studio is not installed.
    """
    from dousa.app.studio import Settings, serve

    library = prepare_studio(output)
    seen = output / "seen.npz"
    if seen.is_file():
        console.print(f"silhouettes for the page Estimate: {seen}", markup=False, soft_wrap=True)
    serve(Settings(library), opens_browser=opens_browser)
