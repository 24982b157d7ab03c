"""Every command of the documents is run: pages from top to bottom, long measurements on little data.

`rules.py` says how each command is tried; `material.py` lists the files that stand for a reader's own.
"""

import re
import shlex
import shutil
import subprocess
import tomllib
from pathlib import Path
from typing import Any

import pytest

from documents.commands import PAGES, ROOT, Command, collect, read_page, unread_lines
from documents.material import DONE_BEFORE, RECORDED, make_material, make_readme_libraries
from documents.rules import BENCHMARKS, PROGRAMS, How, check_options, choose_rule, fill_in, is_mention, make_small
from documents.running import Outcome, run_line, run_program, run_python
from documents.small_data import link_data, make_small_data

DATA = ROOT.parent / "shared" / "data"
COMMANDS = tuple(command for page in PAGES for command in collect(page))
TUTORIAL = "docs/tutorial.md"


def find_commands(how: How) -> list[Command]:
    return [command for command in COMMANDS if choose_rule(command) is how]


def need_data() -> None:
    if not DATA.exists():
        pytest.skip("no recordings at ../shared/data")


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A working folder beside a small ../shared/data."""
    need_data()
    home = tmp_path_factory.mktemp("small")
    make_small_data(DATA, home / "shared" / "data")
    (home / "work").mkdir()
    return home / "work"


@pytest.fixture(scope="module")
def material(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files in the place of the reader's own."""
    folder = tmp_path_factory.mktemp("material")
    make_material(folder, DATA)
    return folder


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the recordings, of films the beginning; none where there are none."""
    folder = tmp_path_factory.mktemp("shared")
    if DATA.exists():
        link_data(DATA, folder / "data")
    return folder


@pytest.fixture
def empty(tmp_path: Path, shared: Path) -> Path:
    """A working folder as the project's is seen from its commands: with docs and lab, beside ../shared/data."""
    (tmp_path / "work").mkdir()
    (tmp_path / "work/docs").symlink_to(ROOT / "docs")
    (tmp_path / "work/lab").symlink_to(ROOT / "lab")
    (tmp_path / "shared").symlink_to(shared)
    return tmp_path / "work"


@pytest.fixture
def work(empty: Path, material: Path) -> Path:
    """The same with files in the place of the reader's own."""
    shutil.copytree(material, empty, symlinks=True, dirs_exist_ok=True)
    return empty


# Nothing is left out


@pytest.mark.parametrize("page", PAGES)
def test_every_command_has_a_rule(page: str):
    assert not unread_lines(page)
    lost = [f"{command}: {command.text}" for command in collect(page) if choose_rule(command) is None]
    assert not lost, "write a row in tests/documents/rules.py, or a command that one fits"


def test_every_program_of_the_lab_is_run():
    words = [command.text.split() for command in find_commands(How.SMALL)]
    from_pages = {word[2].removeprefix("lab.") for word in words if word[:2] == ["python", "-m"]}
    assert set(PROGRAMS) == set(BENCHMARKS) | (from_pages & set(PROGRAMS))


# Pages that a reader follows


def list_steps(page: str, places: tuple[str, ...]) -> list[Command]:
    return [c for c in collect(page) if c.place in places and choose_rule(c) is How.FOLLOWED]


def follow(steps: list[Command], folder: Path) -> int:
    """Do a page in its order; returns how many steps were passed over because there are no recordings."""
    names: dict[str, Any] = {"__name__": "page"}
    passed_over = 0
    for step in steps:
        if needs_recordings(step) and not DATA.exists():
            passed_over += 1
            continue
        for text in prepare(step):
            take_step(text, folder, names).expect_success(f"before {step}: {text}")
        outcome = take_step(fill_in(step.text), folder, names)
        outcome.expect_success(f"{step}: {step.text}")
        compare_answer(step, outcome.said, folder)
    return passed_over


def needs_recordings(step: Command) -> bool:
    """Whether a command names recordings, or what the tutorial has made of them before."""
    names = (*RECORDED, "../shared/data", "people.dousa", "wave.bvh")
    return any(re.search(rf"(?<![\w.]){re.escape(name)}\b", step.text) for name in names)


def prepare(step: Command) -> tuple[str, ...]:
    found = [lines for (page, begin), lines in DONE_BEFORE.items() if page == step.page and step.text.startswith(begin)]
    return found[0] if found else ()


def take_step(text: str, folder: Path, names: dict[str, Any]) -> Outcome:
    if text.startswith("dousa demo"):  # a program of its own, as for whoever begins
        return run_program(shlex.split(text), folder)
    if re.match(r"(?:dousa|tracker|printf) ", text):
        return run_line(text, folder)
    return run_python(text, folder, names)


def compare_answer(step: Command, said: str, folder: Path) -> None:
    """Every line that the page shows is in the answer, whatever its numbers; ``...`` stands for anything."""
    answers = [mask(line, folder) for line in said.splitlines()]
    answers += [line.partition(": ")[2] for line in answers]  # where the page leaves out the name of the file
    for shown in step.shown:
        begin = mask(shown, folder).partition("...")[0].strip()
        assert any(line.startswith(begin) for line in answers), f"{step} shows\n{shown}\nbut the answer is\n{said}"


def mask(line: str, folder: Path) -> str:
    """A line without numbers, without what depends on them (votes and bars), and with short paths."""
    short = line.replace(f"{folder.resolve()}/", "").replace(f"{folder}/", "")
    short = re.sub(r"\d+(?:\.\d+)?", "0", short)
    short = re.sub(r"\(([^)]*0%[^)]*)\)?.*", "", short)
    return re.sub(r"[\s─━┃│┏┓┗┛┡┩└┘┳┴╇╈┬┻]+", " ", short).strip()


def finish(passed_over: int) -> None:
    if passed_over:
        pytest.skip(f"all but {passed_over} commands: no recordings at ../shared/data")


FOLLOWED = [page for page in PAGES if page != TUTORIAL and list_steps(page, ("block", "prose", "python"))]


@pytest.mark.parametrize("page", FOLLOWED)
def test_pages_can_be_followed(page: str, work: Path):
    places = ("block", "prose", "python") if page == "README.md" else ("block", "prose", "python", "session")
    finish(follow(list_steps(page, places), work))


def test_the_answers_of_the_readme(tmp_path: Path):
    """Its answers are about real recordings, which its commands are not."""
    need_data()
    for text in make_readme_libraries(tmp_path, DATA):
        run_line(text, tmp_path).expect_success(text)
    follow(list_steps("README.md", ("session",)), tmp_path)


@pytest.mark.skipif(TUTORIAL not in PAGES, reason="there is no tutorial")
def test_the_demo_and_the_tutorial(empty: Path):
    """The tutorial begins with the demonstration; what other pages name of its files must be there too."""
    steps = list_steps(TUTORIAL, ("block", "python", "session"))
    assert steps[0].text == "dousa demo -o demo-output"
    follow([step for step in steps if not needs_recordings(step)], empty)
    for page in PAGES:
        for name in re.findall(r"demo-output/[\w./*-]*[\w*]", read_page(page)):
            assert list(empty.glob(name)), f"{page} names {name}"


@pytest.mark.skipif(TUTORIAL not in PAGES, reason="there is no tutorial")
def test_the_tutorial_on_recordings(empty: Path):
    """Its other half, which makes all that it needs."""
    need_data()
    follow([step for step in list_steps(TUTORIAL, ("block", "python", "session")) if needs_recordings(step)], empty)


# Measurements that take minutes and more


@pytest.mark.parametrize("command", find_commands(How.SMALL), ids=str)
def test_measurements_run_on_little_data(command: Command, small: Path):
    text = make_small(command.text)
    run_line(text, small).expect_success(f"{command}: {text}")


@pytest.mark.filterwarnings("default")  # the peers are not ours
@pytest.mark.parametrize("name", BENCHMARKS)
def test_benchmarks_run_on_little_data(name: str, small: Path):
    text = f"python -m lab.{name} {BENCHMARKS[name]}"
    run_line(text, small).expect_success(text)


# Commands that are not run


@pytest.mark.parametrize("text", sorted({command.text for command in find_commands(How.WRITES)}))
def test_what_would_write_into_the_package_is_only_asked_for_its_options(text: str, tmp_path: Path):
    words = shlex.split(text.removeprefix("python -m "))
    asked = run_line(f"python -m {words[0]} --help", tmp_path)
    asked.expect_success(text)
    for option in (word.partition("=")[0] for word in words if word.startswith("--")):
        assert re.search(rf"{option}\b", asked.said), f"{words[0]} has no {option}"


def test_no_command_that_is_run_writes_into_the_package():
    assert find_commands(How.WRITES), "docs/evaluation.md says what writes the numbers of the grade"
    run = [make_small(command.text) for command in find_commands(How.SMALL)]
    run += [command.text for how in (How.FOLLOWED, How.BENCHMARK) for command in find_commands(how)]
    assert not [text for text in (*run, *BENCHMARKS.values()) if "--write" in text]
    for text in ("python -m lab.training.train_judge FOLDER --write", "python -m lab.training.calibrate_grade --write"):
        assert choose_rule(Command("any.md", 1, text, "block")) is How.WRITES


@pytest.mark.parametrize("command", find_commands(How.MENTIONED) + find_commands(How.SERVED), ids=str)
def test_what_is_mentioned_exists(command: Command):
    check_options(command.text)


@pytest.mark.parametrize("text", sorted({command.text for command in find_commands(How.DRY)}))
def test_targets_of_make_exist(text: str):
    told = subprocess.run(
        ["make", "--no-print-directory", "-n", text.split()[1]], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert told.returncode == 0, told.stderr
    for name in re.findall(r"\b(?:lab|docs)/[a-z]\w*\.py", told.stdout):
        assert (ROOT / name).exists(), f"{text} runs {name}"
    if text == "make demo":
        assert re.search(r"dousa demo$", told.stdout.strip())


@pytest.mark.parametrize("command", find_commands(How.INSTALLED), ids=str)
def test_what_is_installed_is_this_project(command: Command):
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    words = [word for word in shlex.split(command.text)[2:] if not word.startswith("-")]
    for word in words:
        name, extras = re.fullmatch(r"(\.|\w+)(?:\[([\w,]+)\])?", word).groups()
        assert name in (".", project["name"])
        assert set((extras or "").split(",")) - {""} <= set(project["optional-dependencies"])


def test_what_is_asked_of_a_studio_is_of_one_page():
    assert {command.page for command in find_commands(How.ASKED)} <= {"docs/studio.md"}
    assert '"studio.md"' in (ROOT / "tests/app/studio/test_studio_serving.py").read_text(encoding="utf-8")


def test_a_mention_lacks_what_a_command_needs():
    assert is_mention("dousa train") and is_mention("dousa experiment ... --takes")
    assert is_mention("dousa estimate --body FILE")
    assert not is_mention("dousa train moves.dousa") and not is_mention("make test")
