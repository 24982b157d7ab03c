"""Messages, words of the pages and the help of commands keep to the glossary: docs/glossary.md."""

import json
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

import dousa
from dousa.messages import LANGUAGES
from dousa.messages.tables import load_table

SOURCE = Path(dousa.__file__).parent
GLOSSARY = (SOURCE.parents[1] / "docs" / "glossary.md").read_text(encoding="utf-8")
AVOIDED = re.findall(r"~~(.+?)~~", GLOSSARY)
# Names of options, of arrays in messages for programmers, and a paper's title.
ALLOWED = re.compile(
    r"--furi|\bfuri_|histogramは '|histogram '|(?:histogram|ヒストグラム)s? ?[(（]"
    r"|(?:finite |有限の)(?:histogram|ヒストグラム)|舞踊動作の定量的"
)
PLAIN = re.compile(r"(?:する|(?<![ま|で])した|ない|である|いる|ある|なる|れる|よい|できる)。")


@cache
def list_texts() -> list[str]:
    """Every text in the program for people, in all languages, and every help."""
    return [ALLOWED.sub("", text) for text in [*_read_tables(), *_read_help()]]


def _read_tables() -> Iterator[str]:
    for language in LANGUAGES:
        yield from load_table(language).values()
    for page in (SOURCE / "app" / "studio" / "words").glob("*.json"):
        for words in json.loads(page.read_text(encoding="utf-8")).values():
            yield from words


def _read_help() -> Iterator[str]:
    from typer.main import get_command

    from dousa.app.cli.main import make_application

    for command in get_command(make_application()).commands.values():  # type: ignore[attr-defined]
        yield from (command.help, *(getattr(part, "help", None) or "" for part in command.params))


@pytest.mark.parametrize("avoided", [*AVOIDED, "clips get their"])
def test_words_that_the_glossary_strikes_out_are_not_used(avoided: str):
    word = re.compile(rf"(?<![a-z視地]){re.escape(avoided)}(?!ー)", re.IGNORECASE)
    assert [text for text in list_texts() if word.search(text)] == []


def test_japanese_sentences_are_polite():
    assert [text for text in list_texts() if PLAIN.search(text)] == []


def test_each_word_is_explained_once():
    words = re.findall(r"^\| ([a-z ]+?) \| (\S+) \|", GLOSSARY, re.MULTILINE)[1:]
    assert len(words) > 20
    for column in zip(*words, strict=True):
        assert len(set(column)) == len(column)
