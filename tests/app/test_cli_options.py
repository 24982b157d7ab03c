"""Options from request classes, spelled once; how files are read; and how many options there are."""

from __future__ import annotations

import inspect
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import pytest
import typer
from typer.main import get_command

from dousa.app.cli.main import COMMANDS, NEEDED, make_application
from dousa.app.cli.usage import mark_tags, split_tags, to_typer_command
from dousa.app.requests.estimation import EstimationRequest, Outputs
from dousa.app.requests.reading import PartReading, Reading
from dousa.errors import OptionError
from dousa.formats import ReadOptions


@dataclass(frozen=True)
class Size:
    """A request of two options."""

    width: Annotated[int, typer.Option("--width")] = 4
    height: Annotated[int, typer.Option("--height")] = 3
    unit: str = "cm"


def test_options_of_a_request_stand_in_its_place_and_arrive_in_one_value():
    got = []

    def draw(name: str, *, size: Size, json: bool = False) -> None:
        got.append((name, size, json))

    def measure(name: str, *, given: Annotated[dict[str, Any], Size]) -> None:
        got.append((name, given))

    command = to_typer_command(draw)
    parameters = inspect.signature(command).parameters
    assert list(parameters) == ["name", "width", "height", "json"]
    assert [parameters[name].default for name in ("width", "height")] == [4, 3]
    assert parameters["width"].annotation.__metadata__[0].default == "--width"  # as Typer keeps the name
    command(name="a", width=7, height=3, json=True)
    to_typer_command(measure)(name="b", width=7, height=3)
    assert got == [("a", Size(7, 3), True), ("b", {"width": 7, "height": 3})]


def test_an_option_that_is_there_twice_is_refused():
    def draw(*, size: Size, width: int) -> None:
        raise AssertionError

    with pytest.raises(ValueError, match="duplicate"):
        to_typer_command(draw)


def test_options_of_a_file_become_those_that_it_is_read_with(tmp_path):
    path = tmp_path / "joints.txt"
    path.write_text("left_knee = L_Kn\n", encoding="utf-8")
    reading = PartReading(["frame-rate=25", f"joint_map={path}", "any_skeleton", "skeleton=a.asf", "unit=cm", "up=z"])
    assert reading.load() == ReadOptions({"left_knee": ("L_Kn",)}, "cm", "z", Path("a.asf"), 25.0, True)
    assert reading.files == (Path("a.asf"), path)
    assert Reading().load() == ReadOptions() and Reading(["any_skeleton=no"]).load() == ReadOptions()
    assert PartReading(["frame_rate=25"], person="Ben").load() == ReadOptions(frame_rate=25.0, person="Ben")
    assert Reading(["animation=2", "frame_rate=60"]).load() == ReadOptions(frame_rate=60.0, animation="2")
    with pytest.raises(OptionError):
        Reading([f"joint_map={tmp_path / 'missing.txt'}"]).load()


@pytest.mark.parametrize(
    ("texts", "code"),
    [
        (["mood=glad"], "unknown_key"),
        (["unit"], "no_value"),
        (["unit=cm", "unit=m"], "twice"),
        (["frame_rate=fast"], "not_a_number"),
        (["any_skeleton=perhaps"], "not_a_switch"),
    ],
)
def test_mistakes_in_them_have_a_code_each(texts, code):
    with pytest.raises(OptionError) as caught:
        Reading(texts).load()
    assert caught.value.code == f"reading.{code}"


def test_outputs_are_told_apart_by_their_suffixes():
    motion, points, angles, film, sheet = map(Path, ("a.bvh", "a.trc", "a.csv", "a.mp4", "a.png"))
    for order in ((motion, points, film, sheet), (sheet, points, film, motion)):
        motions = tuple(path for path in order if path in (motion, points))
        assert Outputs.from_paths(order, angles) == Outputs(motions, angles, film, sheet)
    for twice in ((film, Path("b.avi")), (sheet, Path("b.svg"))):
        with pytest.raises(OptionError, match="of the same kind"):
            Outputs.from_paths(twice)
    assert EstimationRequest((motion,)).outputs.named == ()


def test_tags_are_no_options():
    words = ["lib", "12", "+fight", "-draft", "--tag", "x", "-h", "--", "-y"]
    assert split_tags(mark_tags(words)) == (["lib", "12", "--tag", "x", "-h", "--", "-y"], ["fight"], ["draft"])


def test_what_one_needs_first_stands_first_in_the_help():
    """The twelve commands of the main jobs; of a command with many options those that most need."""
    panels = list(COMMANDS)
    first = [name for panel in panels[:4] for names in COMMANDS[panel].values() for name in names.split()]
    assert len(first) == 12 and all(panel.startswith("More") for panel in panels[4:])
    for name, command in get_command(make_application()).commands.items():
        options = {part.name: part.rich_help_panel for part in command.params if part.param_type_name == "option"}
        shown = {option for option, panel in options.items() if panel != "More"}
        assert set(NEEDED.get(name, "").split()) <= shown, name
        assert len(shown) <= 9, name
