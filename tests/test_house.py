"""The ratchet: sizes of the house that may fall, and rise only where a commit says why.

``python tests/test_house.py`` prints the table of today. Who makes a figure smaller writes it down here; who raises one
gives the reason in the commit's message.
"""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from submission import DOCUMENTS, JOBS

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "src" / "dousa"

# Lines and files of each room, stubs included.
ROOMS = {
    "app": (25_617, 117),
    "estimation": (16_589, 69),
    "evaluation": (12_104, 46),
    "experiments": (1_705, 8),
    "files": (1_155, 8),
    "formats": (13_292, 69),
    "library": (15_663, 56),
    "messages": (235, 3),
    "motion": (6_507, 34),
    "retrieval": (12_898, 47),
    "workers": (482, 6),
}
TOTALS = {
    "lines of tests": 62_284,
    "lines of JavaScript": 12_550,
    "constants": 1_061,
    "numeric constants without a source": 6,
    "functions over 60 lines": 14,
    "files over 650 lines": 0,
    "folders with more than 15 files": 0,
    "lines with words that a native reader stumbles over": 64,
    "hand-written runs of a mask": 3,
    "commands": 32,
    "options": 199,
}

_LONG_FUNCTION, _LONG_FILE, _LARGE_FOLDER = 60, 650, 15
_STIFF = re.compile(r"\b(?:told|anew|whoever|nobody|somebody|befall|alike)\b")
# What names an origin: a publication or its equation, a standard, what measured it, or that it is so by definition.
_SOURCE = re.compile(
    r"\bpaper\b|\beq(?:uation|s)?\b|\bsec(?:tion)?\.|\btable\b|\bfig\.|\bISO\b|\bRFC\b|\bIEEE\b|\bstandard\b"
    r"|\bspecification\b|\blab[./]|docs/|https?:|\b(?:19|20)\d\d\b|\bmeasured\b|\bdefinition\b|\bclause\b|\bunits?\b"
    r"|\bgeometry\b|\bSciPy\b|\bOpenCV\b|\bNumPy\b|\bSMPL\b|\bWinter\b|\bde Leva\b",
    re.IGNORECASE,
)


def list_files(room: str = "") -> list[Path]:
    """The modules and stubs of a room, or of the package."""
    return sorted(path for path in (SOURCE / room).rglob("*.py*") if path.suffix in (".py", ".pyi"))


def count_lines(paths: list[Path]) -> int:
    return sum(len(path.read_text(encoding="utf-8").splitlines()) for path in paths)


def list_constants(path: Path) -> Iterator[tuple[int, bool, str]]:
    """(line, whether its value holds a number, what is written about it) of each constant of a module."""
    text = path.read_text(encoding="utf-8")
    lines, body = text.splitlines(), ast.parse(text).body
    for node, following in zip(body, [*body[1:], None], strict=False):
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        named = [target.id for target in targets if isinstance(target, ast.Name)]
        if not any(re.fullmatch(r"_*[A-Z][A-Z0-9_]*", name) for name in named):
            continue
        first = node.lineno - 1
        while first > 0 and lines[first - 1].lstrip().startswith("#"):
            first -= 1
        about = " ".join(line.partition("#")[2] for line in lines[first : node.end_lineno])
        if isinstance(following, ast.Expr) and isinstance(following.value, ast.Constant):
            about += str(following.value.value)
        value = getattr(node, "value", None)
        numbers = [part for part in ast.walk(value) if isinstance(part, ast.Constant)] if value else []
        yield node.lineno, any(type(part.value) in (int, float) for part in numbers), about


def count_long_functions(paths: list[Path]) -> int:
    functions = (
        node
        for path in paths
        if path.suffix == ".py"
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
    )
    return sum((node.end_lineno or 0) - node.lineno + 1 > _LONG_FUNCTION for node in functions)


def count_commands() -> tuple[int, int]:
    """Commands, and options of all of them; ``--help`` does not count, nor what stands before the command."""
    from typer.main import get_command

    from dousa.app.cli.main import make_application

    commands = get_command(make_application()).commands.values()  # type: ignore[attr-defined]
    options = [part for command in commands for part in command.params if part.param_type_name == "option"]
    return len(commands), len(options)


def measure_rooms() -> dict[str, tuple[int, int]]:
    """Lines and files of each room, stubs included."""
    rooms = sorted(path.name for path in SOURCE.iterdir() if (path / "__init__.py").exists())
    return {room: (count_lines(files), len(files)) for room in rooms for files in [list_files(room)]}


def measure_totals() -> dict[str, int]:
    """The other figures of the table."""
    files = list_files()
    modules = [path for path in files if path.suffix == ".py"]
    constants = [constant for path in modules for constant in list_constants(path)]
    texts = [path.read_text(encoding="utf-8") for path in modules]
    folders = {path.parent for path in modules}
    commands, options = count_commands()
    return {
        "lines of tests": count_lines(sorted((ROOT / "tests").rglob("*.py"))),
        "lines of JavaScript": count_lines(sorted(SOURCE.rglob("*.js"))),
        "constants": len(constants),
        "numeric constants without a source": sum(number and not _SOURCE.search(said) for _, number, said in constants),
        "functions over 60 lines": count_long_functions(files),
        "files over 650 lines": sum(count_lines([path]) > _LONG_FILE for path in files),
        "folders with more than 15 files": sum(len(list(path.glob("*.py"))) > _LARGE_FOLDER for path in folders),
        "lines with words that a native reader stumbles over": sum(
            bool(_STIFF.search(line)) for text in texts for line in text.splitlines()
        ),
        "hand-written runs of a mask": sum(text.count("flatnonzero(np.diff(") for text in texts),
        "commands": commands,
        "options": options,
    }


def test_rooms_do_not_grow():
    measured = measure_rooms()
    assert set(measured) == set(ROOMS)
    grown = {room: size for room, size in measured.items() if size[0] > ROOMS[room][0] or size[1] > ROOMS[room][1]}
    assert not grown, "larger than the table says (lines, files)"


@pytest.mark.parametrize("what", TOTALS)
def test_figures_do_not_grow(what: str, totals: dict[str, int]):
    assert totals[what] <= TOTALS[what]


def test_every_name_of_submission_is_a_test():
    """A test that was renamed would be left to the night."""
    named = {Path("app") / file: names for file, names in JOBS.items()}
    named[Path("documents/test_document_commands.py")] = [name.partition("[")[0] for name in DOCUMENTS]
    for file, names in named.items():
        there = set(re.findall(r"^def (\w+)", (ROOT / "tests" / file).read_text(encoding="utf-8"), re.MULTILINE))
        assert set(names) <= there, file


@pytest.fixture(scope="module")
def totals() -> dict[str, int]:
    return measure_totals()


if __name__ == "__main__":
    rooms = measure_rooms()
    for room, (lines, files) in rooms.items():
        print(f'    "{room}": ({lines:_}, {files}),')
    print(f"all: {count_lines(list_files()):_} lines, {len(list_files())} files")
    for what, figure in measure_totals().items():
        print(f'    "{what}": {figure:_},')
