"""Answers of the commands: lines for people, JSON for programs, progress on standard error."""

from __future__ import annotations

import io
import json
import os
import re
import sys
import unicodedata
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from dousa.files.json_values import refuse_infinite, to_json_value
from dousa.messages import Message

if TYPE_CHECKING:
    from pathlib import Path

    from rich.console import Console
    from rich.progress import Task
    from rich.text import Text

    from dousa.errors import DousaError
    from dousa.formats.motion_files import Skipped

ProgressCallback = Callable[[int, int, Message | str], None]
"""Called with (done, total, what is being done)."""

_WHOLE_ROWS = 4000  # columns: a row of a table in a file or pipe is never broken, so that it can be searched
_UNSHOWN = ("Cc", "Cs", "Zl", "Zp")  # control characters, halves of characters, line and paragraph ends


# What JSON lets through of them; a terminal takes some for the beginning of a command.
_UNSAFE = re.compile("[\x7f-\x9f\u2028\u2029]")


def console(*, stderr: bool = False) -> Console:
    """A console as wide as the terminal, or wide enough for whole rows when the output goes to a file."""
    from rich.console import Console

    made = Console(stderr=stderr, emoji=False, highlight=False, soft_wrap=False)
    if not made.is_terminal:
        made.width = _WHOLE_ROWS
    return made


def survive_narrow_encodings() -> None:
    """Let characters that the terminal cannot show be spelled as their codes instead of ending the program.

    Where standard output or error was closed before the start (``>&-``), Python has no stream: an answer then ends
    in an error like that of a full disk, a note goes nowhere.
    """
    if sys.stdout is None:
        sys.stdout = open(os.devnull, encoding="utf-8")  # noqa: SIM115 - for reading, so that writing is refused
    if sys.stderr is None:
        sys.stderr = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115 - until the end of the program
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def print_json(answer: Any) -> None:
    """One JSON document on standard output; NaN, a number that is not known, becomes null. OptionError for infinity."""
    plain = to_json_value(answer, refuse_infinite)
    text = json.dumps(plain, ensure_ascii=False, indent=1, allow_nan=False)
    text = _UNSAFE.sub(lambda found: f"\\u{ord(found[0]):04x}", text)
    try:
        text.encode(sys.stdout.encoding or "utf-8")
    except UnicodeEncodeError:  # a terminal of few characters, or a file name that is not Unicode
        text = json.dumps(plain, indent=1, allow_nan=False)
    sys.stdout.write(text + "\n")


def print_answer(answer: Any, print_lines: Callable[[Console, Any], None], *, json: bool) -> None:
    """Print an answer as one JSON document, or by a function that prints it for people."""
    if json:
        print_json(answer)
    else:
        print_lines(console(), answer)


def say(message: Message | str) -> None:
    """One line of answer on standard output, which a terminal breaks where it is full."""
    console().print(one_line(str(message)), markup=False, soft_wrap=True)


def say_written(*paths: Path | None, json: bool = False) -> None:
    """Say which files were written, unless the answer is JSON."""
    for path in paths:
        if path is not None and not json:
            say(Message("targets.written", path=path))


def one_line(text: str) -> str:
    """The text with control characters, as file names may hold them, spelled as their codes."""
    return "".join(
        repr(character)[1:-1] if unicodedata.category(character) in _UNSHOWN else character for character in text
    )


def fail(message: Message | DousaError | str) -> None:
    """One line of error on standard error."""
    sys.stderr.write(f"dousa: {one_line(str(message))}\n")


def warn(message: Message | DousaError | str) -> None:
    """One line of warning on standard error."""
    sys.stderr.write(f"dousa: {one_line(str(Message('cli.note', text=message)))}\n")


def warn_skipped(skipped: Sequence[Skipped], most: int = 5) -> None:
    """One line each for the first files that were left out, and one for the number of the others."""
    for item in skipped[:most]:
        warn(Message("cli.left_out", path=item.path, reason=item.reason))
    if len(skipped) > most:
        warn(Message("cli.left_out_more", n=len(skipped) - most))


def make_folder(folder: Path) -> None:
    """Make a folder for output, and those above it; OptionError, which names the folder, if it cannot be."""
    from dousa.errors import OptionError

    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OptionError("output.no_folder", folder=folder, reason=error) from error


@contextmanager
def progress_bar() -> Iterator[ProgressCallback]:
    """A progress bar on standard error, shown only on a terminal; yields the callback that moves it."""
    if not sys.stderr.isatty():
        yield lambda done, total, what: None
        return
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    from dousa.kernels import under_way

    class Compiling(TextColumn):
        def render(self, task: Task) -> Text:
            self.text_format = str(Message("cli.compiling")) if under_way else ""
            return super().render(task)

    bar = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        Compiling(""),
        console=console(stderr=True),
        transient=True,
    )
    with bar:
        task = bar.add_task("", total=None)
        yield lambda done, total, what: bar.update(task, completed=done, total=total, description=str(what))
