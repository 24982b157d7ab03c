"""Groups of options: spelled once as a dataclass, in the signature one by one, and handed over in one object."""

from __future__ import annotations

import inspect
from dataclasses import dataclass
from typing import Annotated

import pytest
import typer

from dousa.app.cli.options.shared import FileOptions, MotionOptions, list_values
from dousa.app.cli.usage import to_typer_command
from dousa.errors import OptionError


@dataclass(frozen=True)
class Size:
    """A group of two."""

    width: Annotated[int, typer.Option("--width")] = 4
    height: Annotated[int, typer.Option("--height")] = 3


def test_options_of_a_group_stand_in_its_place_and_arrive_in_one_object():
    got = []

    def draw(name: str, *, size: Size, json: bool = False) -> None:
        got.append((name, size, json))

    command = to_typer_command(draw)
    parameters = inspect.signature(command).parameters
    assert list(parameters) == ["name", "width", "height", "json", "lang"]
    assert [parameters[name].default for name in ("width", "height")] == [4, 3]
    assert parameters["width"].annotation.__metadata__[0].default == "--width"  # as Typer keeps the name
    command(name="a", width=7, height=3, json=True, lang=None)
    assert got == [("a", Size(7, 3), True)]


def test_an_option_that_two_groups_have_is_refused():
    def draw(*, size: Size, width: int) -> None:
        raise AssertionError

    with pytest.raises(ValueError, match="duplicate"):
        to_typer_command(draw)


def test_options_of_a_file_become_those_that_it_is_read_with(tmp_path):
    path = tmp_path / "joints.txt"
    path.write_text("left_knee = L_Kn\n", encoding="utf-8")
    options = MotionOptions("cm", "z", None, 25.0, path).load()
    read = {"joint_map": {"left_knee": ("L_Kn",)}, "unit": "cm", "up": "z", "skeleton": None, "frame_rate": 25.0}
    read["any_skeleton"] = False
    assert list_values(options) == read
    assert FileOptions("cm").load().joint_map is None
    with pytest.raises(OptionError):
        MotionOptions(joint_map=tmp_path / "missing.txt").load()
