"""The documents say what the code does: commands exist, links lead somewhere, the table of features is the real one."""

import importlib.util
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md"), *(ROOT / "lab/notes").glob("*.md")])


def load_figures():
    spec = importlib.util.spec_from_file_location("make_figures", ROOT / "lab/figures/make_figures.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_table_of_features_is_the_real_one():
    assert (ROOT / "docs/features.md").read_text(encoding="utf-8") == load_figures().describe_features()


def test_links_and_pictures_are_there():
    for page in PAGES:
        for target in re.findall(r"\]\(([^)#]+)\)", page.read_text(encoding="utf-8")):
            assert "://" in target or (page.parent / target).exists(), f"{page.name} links to {target}"


def test_commands_and_options_exist():
    """Every ``dousa COMMAND --option`` of the documents is one that the command line knows."""
    from typer.main import get_command

    from dousa.app.cli.main import make_application

    commands = get_command(make_application()).commands
    lines = [
        (page, line)
        for page in PAGES
        for line in re.findall(
            r"(?:^|`|\$ )dousa (?:-[\w-]+ [^\s`]+ )*([a-z]+[^`\n]*)",
            re.sub(r"\\\n\s*", " ", page.read_text(encoding="utf-8")),
            re.MULTILINE,
        )
    ]
    for page, line in lines:
        name, *words = line.split()
        assert name in commands, f"{page.name}: no command '{name}'"
        known = {option for parameter in commands[name].params for option in parameter.opts}
        for word in words:
            if word.startswith("--") and word != "--help":
                assert word.split("=")[0] in known, f"{page.name}: dousa {name} has no {word}"


def test_named_files_exist():
    """Paths such as ``lab/benchmarks/forest.py`` in the documents are real; some are below a room of the package."""
    modules = [path.as_posix() for path in (ROOT / "src").rglob("*.py")]
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        for name in re.findall(r"`((?:lab|docs|tests|src)/[\w/.]+\.\w+)`", text):
            assert "NAME" in name or (ROOT / name).exists(), f"{page.name} names {name}"
        for name in re.findall(r"`([a-z_]+/[a-z_/]+\.py)`", text):
            is_there = any(path.endswith(f"/{name}") for path in modules) or (ROOT / name).exists()
            assert is_there, f"{page.name} names {name}"
