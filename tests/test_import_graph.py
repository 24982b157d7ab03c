"""Imports run as the diagrams of docs/architecture.md say, in no circle, and `import dousa` loads nothing heavy."""

import ast
import functools
import itertools
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import dousa
from dousa.motion.synthetic.performers import draw_performer, make_motion

SOURCE = Path(dousa.__file__).parent
PAGE = Path(__file__).resolve().parents[1] / "docs" / "architecture.md"
MOST_FILES = 15  # in a folder: more are two rooms that nobody separated
MOST_PRIVATE = 60

Way = tuple[str, str]


def read_diagrams() -> dict[str, list[list[str]]]:
    """Per folder the lines of its diagram, from what knows nobody to what nobody knows.

    A diagram is a block whose first line names the folder below ``src/dousa`` (``.`` is the package itself); names in
    one place of a line, separated by commas, do not know each other; one alone in a line knows nobody of the folder.
    """
    found = {}
    for block in re.findall(r"^```\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL):
        folder, *lines = block.splitlines()
        if "<-" in block and "<-" not in folder:
            places = [re.split(r" +<-+ +", line.strip()) for line in lines if line.strip()]
            found[folder.strip().rstrip("/:")] = places
    return found


def list_ways(lines: list[list[str]]) -> set[Way]:
    """(who, what it may import): all that stands to its left in a line, and what these may import."""
    ways = {
        (one, other)
        for line in lines
        for left, right in itertools.combinations(line, 2)
        for one in right.split(", ")
        for other in left.split(", ")
    }
    while more := {(one, last) for one, other in ways for here, last in ways if here == other} - ways:
        ways |= more
    return ways


def list_modules() -> dict[str, Path]:
    """The modules of dousa by their full names."""
    modules = {}
    for path in SOURCE.rglob("*.py"):
        parts = ("dousa", *path.relative_to(SOURCE).with_suffix("").parts)
        modules[".".join(parts).removesuffix(".__init__")] = path
    return modules


MODULES = list_modules()
DIAGRAMS = read_diagrams()


def list_imports(path: Path) -> Iterator[str]:
    """Modules of dousa that a file imports, for types alone too."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0 and node.module, f"{path}: imports are written in full"
            for name in node.names:
                whole = f"{node.module}.{name.name}"
                yield whole if whole in MODULES else node.module
        elif isinstance(node, ast.Import):
            yield from (name.name for name in node.names)


@functools.cache
def all_imports() -> dict[str, list[str]]:
    """Modules of dousa that each imports. Read when a test asks: whoever collects the tests need not wait for it."""
    return {
        name: sorted({there for there in list_imports(path) if there in MODULES and there != name})
        for name, path in MODULES.items()
    }


def find_ways(folder: str) -> dict[Way, str]:
    """Imports between the parts of a folder, files and sub-folders, each with a file that does it."""
    home = SOURCE / folder
    ways: dict[Way, str] = {}
    for name, there in ((name, there) for name, all_there in all_imports().items() for there in all_there):
        here_path, there_path = MODULES[name], MODULES[there]
        if home not in here_path.parents or home not in there_path.parents:
            continue
        parts = [path.relative_to(home).parts[0].removesuffix(".py") for path in (here_path, there_path)]
        if parts[0] != parts[1] and "__init__" not in parts:
            ways.setdefault((parts[0], parts[1]), name)
    return ways


@pytest.mark.parametrize("folder", DIAGRAMS)
def test_imports_run_one_way(folder: str):
    may = list_ways(DIAGRAMS[folder])
    assert not {(there, here) for here, there in may} & may, "the diagram itself has a circle"
    for (here, there), name in find_ways(folder).items():
        assert (here, there) in may, f"{name} imports {there}; the diagram of {folder} has no such way"


@pytest.mark.parametrize("folder", DIAGRAMS)
def test_the_diagram_is_of_this_house(folder: str):
    home = SOURCE / folder
    named = {name for line in DIAGRAMS[folder] for place in line for name in place.split(", ")}
    there = {path.name for path in home.iterdir() if (path / "__init__.py").exists()}
    there |= {path.stem for path in home.glob("*.py")}
    assert named <= there, "the diagram names what is not there"
    folders = {path.name for path in home.iterdir() if (path / "__init__.py").exists()}
    assert folders <= named, "a folder is missing in the diagram"
    ways = set(find_ways(folder))
    for line in DIAGRAMS[folder]:
        for left, right in itertools.pairwise(line):
            pairs = set(itertools.product(right.split(", "), left.split(", ")))
            assert pairs & ways, f"{left} <- {right}: no import goes this way"


def test_every_folder_with_rooms_inside_has_a_diagram():
    with_rooms = {path.parent.parent for path in SOURCE.rglob("__init__.py")} - {SOURCE.parent}
    assert {path.relative_to(SOURCE).as_posix() for path in with_rooms} == set(DIAGRAMS)


def test_the_package_does_not_know_the_lab():
    for name, path in MODULES.items():
        assert not [there for there in list_imports(path) if there.split(".")[0] == "lab"], f"{name} imports the lab"


def test_no_circle_between_files():
    """Files are taken away whose imports are all gone; those of a circle are left."""
    left = {name: set(there) for name, there in all_imports().items()}
    while free := [name for name, there in left.items() if not there & left.keys()]:
        for name in free:
            del left[name]
    assert not left, f"in a circle, or behind one: {sorted(left)}"


def test_folders_are_small_and_private_files_are_few():
    for folder in {path.parent for path in MODULES.values()}:
        assert len(list(folder.glob("*.py"))) <= MOST_FILES, f"{folder}: more than {MOST_FILES} files"
    private = [name for name in MODULES if name.rpartition(".")[2].startswith("_")]
    assert len(private) <= MOST_PRIVATE


def test_private_files_are_used_by_their_own_folder_alone():
    for name, all_there in all_imports().items():
        for there in all_there:
            if there.rpartition(".")[2].startswith("_"):
                assert MODULES[there].parent in MODULES[name].parents, f"{name} imports {there}"


@pytest.mark.parametrize("statement", ["import dousa", "import dousa.app.cli"])
def test_start_up_is_light(statement: str):
    heavy = "numpy numba scipy sklearn sqlalchemy matplotlib joblib ezc3d fastapi uvicorn jinja2 cv2 yaml".split()
    code = f"import sys; {statement}; print([m for m in {heavy} if m in sys.modules])"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"


def test_info_loads_neither_a_compiler_nor_a_database(tmp_path: Path):
    heavy = "numba scipy sklearn sqlalchemy matplotlib joblib yaml".split()
    dousa.write_motion(make_motion("walk", draw_performer(0)), tmp_path / "walk.bvh")
    code = f"import sys; from dousa.app.cli.main import main; main(); print([m for m in {heavy} if m in sys.modules])"
    given = [sys.executable, "-c", code, "info", str(tmp_path / "walk.bvh")]
    out = subprocess.run(given, capture_output=True, text=True, check=True)
    assert out.stdout.splitlines()[-1] == "[]"


def test_every_public_name_can_be_loaded():
    for name in dousa.__all__:
        assert getattr(dousa, name) is not None
    with pytest.raises(AttributeError):
        dousa.no_such_name  # noqa: B018
