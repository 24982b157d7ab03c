"""How the commands speak: tables for people, JSON for programs, progress on standard error."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["ProgressCallback", "console", "fail", "print_json", "progress_bar", "warn"]

ProgressCallback = Callable[[int, int, str], None]
"""Called with (done, total, what is being done)."""


def console(*, stderr: bool = False) -> Console:
    """A console as wide as the terminal, or wide enough for whole rows when the output goes to a file."""
    from rich.console import Console

    made = Console(stderr=stderr, highlight=False, soft_wrap=False)
    if not made.is_terminal:
        made.width = max(made.width, 140)
    return made


def print_json(answer: Any) -> None:
    """One JSON document on standard output; numbers that are not finite become null."""
    sys.stdout.write(json.dumps(_plain(answer), ensure_ascii=False, indent=1, allow_nan=False) + "\n")


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if hasattr(value, "tolist"):  # numpy scalars and arrays
        return _plain(value.tolist())
    if isinstance(value, float) and value - value != 0:
        return None
    return value


def fail(message: str) -> None:
    """One line of error on standard error."""
    sys.stderr.write(f"dousa: {message}\n")


def warn(message: str) -> None:
    """One line of warning on standard error."""
    sys.stderr.write(f"dousa: note: {message}\n")


@contextmanager
def progress_bar() -> Iterator[ProgressCallback]:
    """A progress bar on standard error, shown only on a terminal; yields the callback that moves it."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    bar = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=console(stderr=True),
        transient=True,
        disable=not sys.stderr.isatty(),
    )
    with bar:
        task = bar.add_task("", total=None)
        yield lambda done, total, what: bar.update(task, completed=done, total=total, description=what)
