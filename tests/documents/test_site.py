"""The documentation site: every page is in its navigation, examples have what a page needs, links get absolute.

The whole site is built by ``make docs``, which runs the examples and checks links and anchors.
"""

import ast
import importlib
import importlib.util
import re
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import yaml

from documents.commands import PAGES, ROOT, collect, read_page

EXAMPLES = sorted((ROOT / "docs" / "examples").glob("*.py"))
SETTINGS = yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))
PUBLIC = {
    "dousa",
    "dousa.estimation",
    "dousa.evaluation",
    "dousa.experiments",
    "dousa.formats",
    "dousa.library",
    "dousa.motion",
    "dousa.motion.synthetic",
    "dousa.retrieval",
}


def load(path: str) -> ModuleType:
    """A module that is in no package."""
    spec = importlib.util.spec_from_file_location(f"site_{Path(path).stem}", ROOT / path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def list_pages(nav: Any) -> Iterator[str]:
    """Every page that the navigation names."""
    if isinstance(nav, str):
        yield nav
    else:
        for entry in nav.values() if isinstance(nav, dict) else nav:
            yield from list_pages(entry)


NAV = list(list_pages(SETTINGS["nav"]))


# Navigation


def test_every_page_is_in_the_navigation():
    written = {path.name for path in (ROOT / "docs").glob("*.md")}
    root = {"index.md", "contributing.md", "changelog.md"}
    packages = load("docs/hooks/reference.py").PACKAGES
    reference = {f"reference/{package.removeprefix('dousa.')}.md" for package in packages}
    assert set(NAV) == written | root | reference | {"gallery/index.md"}
    assert len(NAV) == len(set(NAV))


def test_broken_links_fail_the_build():
    links = SETTINGS["validation"]["links"]
    assert SETTINGS["strict"] is True
    assert {links[name] for name in ("not_found", "anchors", "unrecognized_links", "absolute_links")} == {"warn"}


def test_hooks_and_styles_are_there():
    named = [*SETTINGS["hooks"], *(f"docs/{name}" for name in SETTINGS["extra_css"])]
    named += [f"docs/{name}" for name in SETTINGS["extra"]["polyfills"]]
    assert [name for name in named if not (ROOT / name).exists()] == []


@pytest.mark.parametrize("package", sorted(PUBLIC))
def test_the_reference_has_every_public_name(package: str):
    reference = load("docs/hooks/reference.py")
    assert set(reference.PACKAGES) == PUBLIC
    page = reference.write_page(package)
    for name in importlib.import_module(package).__all__:
        assert name.startswith("__") or f"\n::: {package}.{name}\n" in page


# Examples


def test_the_examples_are_numbered():
    assert [path.name[:3] for path in EXAMPLES] == [f"{number:02}_" for number in range(1, len(EXAMPLES) + 1)]
    assert len(EXAMPLES) >= 8


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_has_a_title_a_text_and_a_picture(path: Path):
    example = load("docs/hooks/examples.py").read_example(path)
    assert 0 < len(example.title) <= 60 and not example.title.endswith(".")
    assert example.text
    assert 10 <= len(example.code.splitlines()) <= 45
    assert len(re.findall(r"\.savefig\(\"\w+\.png\"|-o \w+\.png", example.code)) == 1
    compile(path.read_text(encoding="utf-8"), path.name, "exec")


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_imports_public_names(path: Path):
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("dousa"):
            assert node.module in PUBLIC
            names = importlib.import_module(node.module).__all__
            assert {alias.name for alias in node.names} <= set(names)
        if isinstance(node, ast.Import):
            assert {alias.name for alias in node.names} <= PUBLIC | {
                "matplotlib.pyplot", "numpy", "subprocess", "textwrap",
            }  # fmt: skip


def test_an_example_that_fails_is_an_error(tmp_path: Path):
    examples = load("docs/hooks/examples.py")
    for code, problem in (("1 / 0", "ZeroDivisionError"), ("print('no picture')", "found 0")):
        path = tmp_path / "01_wrong.py"
        path.write_text(f'"""Wrong."""\n\n{code}\n', encoding="utf-8")
        with pytest.raises(examples.ExampleError, match=problem):
            examples.run_example(examples.read_example(path))
    path.write_text("1\n", encoding="utf-8")
    with pytest.raises(examples.ExampleError, match="docstring"):
        examples.read_example(path)


def test_an_example_is_run_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    examples = load("docs/hooks/examples.py")
    monkeypatch.setattr(examples, "CACHE", tmp_path / "kept")
    path = tmp_path / "01_count.py"
    count = tmp_path / "count"
    path.write_text(
        f'"""Count."""\nfrom pathlib import Path\nopen({str(count)!r}, "a").write("x")\n'
        'Path("a.png").write_bytes(b"png")\nprint("done")\n',
        encoding="utf-8",
    )
    example = examples.read_example(path)
    first, second = (examples.run_examples([example])[0] for _ in range(2))
    assert first == second == examples.Outcome("done\n", b"png")
    assert count.read_text() == "x"
    path.write_text(path.read_text(encoding="utf-8") + "# changed\n", encoding="utf-8")
    examples.run_examples([examples.read_example(path)])
    assert count.read_text() == "xx"
    assert len(list((tmp_path / "kept").iterdir())) == 2


# Nothing from elsewhere


@pytest.mark.parametrize(
    "page",
    [
        '<script src="https://example.org/a.js"></script>',
        "<script async src=//example.org/a.js></script>",
        '<link href="https://example.org/a.css" rel="stylesheet">',
        '<img alt="" src="http://example.org/a.png">',
        "@import url(https://example.org/font.css);",
    ],
)
def test_what_is_loaded_from_elsewhere_is_found(tmp_path: Path, page: str):
    (tmp_path / "a.html").write_text(page, encoding="utf-8")
    assert len(load("docs/hooks/offline.py").find_remote_assets(tmp_path)) >= 1


def test_what_is_only_linked_is_no_asset(tmp_path: Path):
    page = '<a href="https://example.org">there</a><img src="a.png"><link rel="stylesheet" href="../a.css">'
    (tmp_path / "a.html").write_text(page, encoding="utf-8")
    assert load("docs/hooks/offline.py").find_remote_assets(tmp_path) == []


# Translation


def test_the_japanese_tutorial_has_the_commands_of_the_english_one():
    tool = load("lab/figures/translated_tutorial.py")
    english, japanese = read_page("docs/tutorial.md"), read_page("docs/tutorial.ja.md")
    assert tool.paste_blocks(english, japanese) == japanese, "run python -m lab.figures.translated_tutorial"
    assert "docs/tutorial.ja.md" not in PAGES


def test_the_japanese_tutorial_is_whole():
    english, japanese = read_page("docs/tutorial.md"), read_page("docs/tutorial.ja.md")
    for part in (r"^#+ ", r"\*\*[^*\n]+\*\*", r"^!\[.*\]\(.*\)$", r"^\|", r"^- "):
        counts = [len(re.findall(part, page, re.MULTILINE)) for page in (english, japanese)]
        assert counts[0] == counts[1], part
    in_prose = {command.text for command in collect("docs/tutorial.md") if command.place == "prose"}
    for command in in_prose:
        assert f"`{command}`" in re.sub(r"\s+", " ", japanese), command


# The package page


def test_links_of_the_package_page_are_absolute(monkeypatch: pytest.MonkeyPatch):
    interface = ModuleType("hatchling.metadata.plugin.interface")  # there only while the package is built
    interface.MetadataHookInterface = object  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, interface.__name__, interface)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    home = project["urls"]["Source"]
    text = load("hatch_build.py").make_links_absolute(read_page("README.md"), home)
    targets = re.findall(r"(!?)\[[^\]]*\]\(([^)\s]+)\)", text)
    assert [target for _, target in targets if not target.startswith(("https://", "#"))] == []
    pictures = [target for picture, target in targets if picture]
    assert pictures
    for target in pictures:
        assert (ROOT / target.removeprefix(f"{home}/raw/main/")).exists()
