"""The documents say what the code does: commands exist, links lead somewhere, the table of features is the real one."""

import importlib.util
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md"), *(ROOT / "lab/notes").glob("*.md")])


def load_figures():
    spec = importlib.util.spec_from_file_location("make_figures", ROOT / "lab/figures/make_figures.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_table_of_features_is_the_real_one():
    assert (ROOT / "docs/features.md").read_text(encoding="utf-8") == load_figures().describe_features()


@pytest.mark.parametrize("page", PAGES, ids=lambda page: f"{page.parent.name}/{page.name}")
def test_links_and_pictures_are_there(page):
    for target in re.findall(r"\]\(([^)#]+)\)", page.read_text(encoding="utf-8")):
        if "://" not in target:
            assert (page.parent / target).exists(), f"{page.name} links to {target}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: f"{page.parent.name}/{page.name}")
def test_commands_and_options_exist(page):
    """Every ``dousa COMMAND --option`` of the documents is one that the command line knows."""
    from typer.main import get_command

    from dousa.app.cli.main import app

    commands = get_command(app).commands
    text = re.sub(r"\\\n\s*", " ", page.read_text(encoding="utf-8"))
    for line in re.findall(r"(?:^|`|\$ )dousa (?:-[\w-]+ [^\s`]+ )*([a-z]+[^`\n]*)", text, re.MULTILINE):
        name, *words = line.split()
        assert name in commands, f"{page.name}: no command '{name}'"
        known = {option for parameter in commands[name].params for option in parameter.opts}
        for word in words:
            if word.startswith("--") and word != "--help":
                assert word.split("=")[0] in known, f"{page.name}: dousa {name} has no {word}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: f"{page.parent.name}/{page.name}")
def test_named_files_exist(page):
    """Paths such as ``lab/benchmarks/forest.py`` in the documents are real."""
    for name in re.findall(r"`((?:lab|docs|tests|src)/[\w/.]+\.\w+)`", page.read_text(encoding="utf-8")):
        if "NAME" not in name:
            assert (ROOT / name).exists(), f"{page.name} names {name}"
    modules = [path.as_posix() for path in (ROOT / "src").rglob("*.py")]
    for name in re.findall(
        r"`([a-z_]+/[a-z_/]+\.py)`", page.read_text(encoding="utf-8")
    ):  # below a room of the package
        is_there = any(path.endswith(f"/{name}") for path in modules) or (ROOT / name).exists()
        assert is_there, f"{page.name} names {name}"
