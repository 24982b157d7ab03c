"""The commands of the documents: every page is read, every command has a place, and none is passed over."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGES = tuple(  # a translation (tutorial.ja.md) has the commands of its original: test_site.py
    path.relative_to(ROOT).as_posix()
    for path in sorted([*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md"), *(ROOT / "lab/notes").glob("*.md")])
    if path.suffixes == [".md"]
)

_PROGRAMS = ("dousa", "python", "python3", "make", "pip", "tracker")  # a block that begins so holds commands
_SHELLS = ("console", "sh", "bash", "shell")
_BLOCK = re.compile(r"^```([^\n]*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_SPAN = re.compile(r"`([^`]+)`")
_INLINE = re.compile(r"(?:dousa [a-z]|make [a-z]|pip [a-z]|python [\w/]+\.py|python -m lab\.[\w.]+)")


@dataclass(frozen=True, slots=True)
class Command:
    """A command of a page.

    Parameters
    ----------
    page, line : where it stands; the line of the file, from 1.
    text : one line, without comment and prompt. For a piece of Python the piece, with ``python`` set.
    place : ``block``, ``session`` (a block with prompts and answers), ``prose`` or ``python``.
    shown : the lines of the answer that the page shows below it.
    """

    page: str
    line: int
    text: str
    place: str
    shown: tuple[str, ...] = ()

    def __str__(self) -> str:
        return f"{Path(self.page).name}:{self.line}"


def read_page(page: str) -> str:
    """The text of a page."""
    return (ROOT / page).read_text(encoding="utf-8")


def collect(page: str) -> list[Command]:
    """All commands of a page in their order."""
    text = read_page(page)
    found = [*_from_blocks(page, text), *_from_prose(page, text)]
    return sorted(found, key=lambda command: command.line)


def unread_lines(page: str) -> list[str]:
    """Lines in blocks that call dousa but were not taken for a command, nor for an answer that is shown."""
    taken = {command.line for command in collect(page) if command.place != "prose"}
    text, left = read_page(page), []
    for block in _BLOCK.finditer(text):
        first = text.count("\n", 0, block.start(2)) + 1
        lines = block[2].splitlines()
        answers = any(line.startswith("$ ") for line in lines)
        for number, line in enumerate(lines, first):
            called = re.search(r"(?:^|[|;&$] ?)(?:dousa [a-z]|python \w+/|make [a-z])", line)
            if called and number not in taken and not (answers and not line.startswith("$ ")):
                left.append(f"{page}:{number}: {line}")
    return left


def _from_blocks(page: str, text: str) -> Iterator[Command]:
    for block in _BLOCK.finditer(text):
        first = text.count("\n", 0, block.start(2)) + 1
        lines = block[2].splitlines()
        if block[1] == "python":
            yield Command(page, first, block[2], "python")
        elif any(line.startswith("$ ") for line in lines):
            yield from _from_session(page, first, lines)
        elif block[1] in _SHELLS or (lines and not block[1] and lines[0].split(" ")[0] in _PROGRAMS):
            yield from _from_listing(page, first, lines)


def _from_listing(page: str, first: int, lines: list[str]) -> Iterator[Command]:
    """A command a line; a backslash joins a line to the next."""
    joined, start = "", first
    for number, line in enumerate(lines, first):
        start = start if joined else number
        joined += " " + _strip_comment(line)
        if joined.endswith("\\"):
            joined = joined[:-1]
            continue
        if joined.strip():
            yield Command(page, start, _tidy(joined), "block")
        joined = ""


def _from_session(page: str, first: int, lines: list[str]) -> Iterator[Command]:
    """Prompts and what is answered."""
    starts = [number for number, line in enumerate(lines) if line.startswith("$ ")]
    for start, stop in zip(starts, [*starts[1:], len(lines)], strict=True):
        yield Command(page, first + start, _tidy(lines[start][2:]), "session", tuple(lines[start + 1 : stop]))


def _from_prose(page: str, text: str) -> Iterator[Command]:
    prose = _BLOCK.sub(lambda block: re.sub(r"[^\n]", " ", block[0]), text)
    for span in _SPAN.finditer(prose):
        if _INLINE.match(span[1]):
            yield Command(page, prose.count("\n", 0, span.start()) + 1, _tidy(span[1]), "prose")


def _strip_comment(line: str) -> str:
    return re.sub(r"(?:^|\s+)# .*$", "", line).rstrip()


def _tidy(text: str) -> str:
    return re.sub(r"\s+", " ", _strip_comment(text)).strip()
