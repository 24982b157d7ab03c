"""CONTRIBUTING.md: every file, function and table that its recipes name is there, where they say."""

import re
from functools import cache
from pathlib import Path

import pytest

from documents.commands import ROOT, read_page

SOURCE = ROOT / "src" / "dousa"
PAGE = read_page("CONTRIBUTING.md")
SECTIONS = dict(re.findall(r"^## (.+)\n((?:(?!^## ).*\n)*)", PAGE, re.MULTILINE))
_SUFFIXES = ("py", "md", "css", "html", "js")
_ELSEWHERE = {"joblib.parallel_config", "NAME", ".venv", "float()", "FILE", "RULE", "DATA"}


def list_spans(text: str) -> list[str]:
    """What stands in backquotes, on one line each."""
    return [re.sub(r"\s+", " ", span) for span in re.findall(r"`([^`]+)`", text)]


@cache
def read_everything() -> str:
    folders = (ROOT / "src", ROOT / "tests", ROOT / "lab")
    files = [path for folder in folders for path in folder.rglob("*") if path.suffix[1:] in _SUFFIXES]
    own = Path(__file__).resolve()
    texts = [path.read_text(encoding="utf-8") for path in files if path.resolve() != own]
    return "\n".join([*texts, (ROOT / "pyproject.toml").read_text(encoding="utf-8")])


def is_path(span: str) -> bool:
    return re.fullmatch(r"[\w/.]+\.(?:py|md|css|html|js)|(?:[\w.]+/)+[\w.]*", span) is not None


def exists(name: str) -> bool:
    """A path from the root, from the package, from app or the tests; or the name of one file, wherever it is."""
    homes = (ROOT, SOURCE, SOURCE / "app", ROOT / "tests")
    if any((home / name).exists() for home in homes):
        return True
    return "/" not in name and any(True for home in (ROOT / "src", ROOT / "tests") for _ in home.rglob(name))


def test_the_two_recipes_are_there():
    assert {"Add a format", "Add a feature, or a channel"} <= set(SECTIONS)


@pytest.mark.parametrize("section", SECTIONS)
def test_named_files_are_there(section: str):
    for span in list_spans(SECTIONS[section]):
        if is_path(span) and "NAME" not in span and not span.startswith("../"):
            assert exists(span), f"'{section}' names {span}"


@pytest.mark.parametrize("section", SECTIONS)
def test_named_functions_and_tables_are_there(section: str):
    for span in list_spans(SECTIONS[section]):
        if is_path(span) or span in _ELSEWHERE or "NAME" in span:
            continue
        called = re.fullmatch(r"([A-Za-z_][\w.]*)(?:\(.*\))?", span)
        if called:
            for part in called[1].split("."):
                found = re.search(rf"\b{re.escape(part)}\b", read_everything())
                assert found or (SOURCE / part).exists(), f"'{section}' names {span}"


@pytest.mark.parametrize(
    ("name", "file"),
    [
        (name, file)
        for text in SECTIONS.values()
        for name, file in re.findall(r"`(\w+)`\s+(?:of|in)\s+`([\w/.]+\.(?:py|css|html|js))`", text)
        + [(n, f) for n, f in re.findall(r"`(\w+)`\s+\(`([\w/.]+\.py)`\)", text)]
    ],
)
def test_names_stand_in_the_file_that_is_told(name: str, file: str):
    homes = [home / file for home in (ROOT, SOURCE, SOURCE / "app") if (home / file).exists()]
    homes = homes or list((ROOT / "src").rglob(Path(file).name))
    assert any(re.search(rf"\b{name}\b", path.read_text(encoding="utf-8")) for path in homes), f"{name}: {file}"
