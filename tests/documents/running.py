"""Commands of the documents are run in this process, as they would be in a shell, with what they print kept."""

import contextlib
import glob
import io
import os
import runpy
import shlex
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import joblib

_SHELL_SIGNS = ("|", ">")


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a command did: its exit code and all it said."""

    code: int
    said: str

    def expect_success(self, what: object) -> None:
        """Fail with what was said unless the command went through."""
        assert self.code == 0, f"{what}: exit code {self.code}\n{self.said[-2000:]}"


def run_line(text: str, folder: Path) -> Outcome:
    """Run one line in a folder: ``dousa`` and ``python`` here, what has a pipe or a file for its output by the shell.

    Words with ``*`` and ``?`` become the files they match.
    """
    if any(sign in shlex.split(text) for sign in _SHELL_SIGNS):
        return run_program(["sh", "-c", text], folder)
    program, *words = shlex.split(text)
    words = [found for word in words for found in _match(word, folder)]
    if program == "dousa":
        from dousa.app.cli.main import main

        return _call(main, [program, *words], folder)
    assert (program, words[0]) == ("python", "-m"), f"no way to run {text}"
    module = words[1]
    sys.modules.pop(module, None)  # what another test has imported would be run a second time, with a warning
    return _call(lambda: runpy.run_module(module, run_name="__main__", alter_sys=True), words[1:], folder)


def run_python(code: str, folder: Path, names: dict[str, Any]) -> Outcome:
    """Run a piece of Python of a page in a folder; ``names`` are there already, and new ones are put there."""
    return _call(lambda: exec(compile(code, "<page>", "exec"), names), ["python"], folder)


def run_program(words: Sequence[str], folder: Path) -> Outcome:
    """Run a program of its own, with ``dousa`` and the folder's ``bin`` on the path."""
    paths = os.pathsep.join((str(folder / "bin"), str(Path(sys.executable).parent), os.environ["PATH"]))
    done = subprocess.run(
        words, cwd=folder, env=os.environ | {"PATH": paths}, capture_output=True, text=True, check=False
    )
    return Outcome(done.returncode, done.stdout + done.stderr)


def _match(word: str, folder: Path) -> list[str]:
    return sorted(glob.glob(word, root_dir=folder)) or [word]


def _call(act: Any, words: list[str], folder: Path) -> Outcome:
    code = 0
    with _standing_in(folder, words) as said:
        try:
            act()
        except SystemExit as stop:
            code = stop.code if isinstance(stop.code, int) else int(stop.code is not None)
    return Outcome(code, said.getvalue())


@contextlib.contextmanager
def _standing_in(folder: Path, words: list[str]) -> Iterator[io.StringIO]:
    """The folder and arguments of a program; on one core, since no worker pays for so little work."""
    said, kept = io.StringIO(), sys.argv
    sys.argv = words
    try:
        with (
            contextlib.chdir(folder),
            contextlib.redirect_stdout(said),
            contextlib.redirect_stderr(said),
            joblib.parallel_config(backend="sequential"),
        ):
            yield said
    finally:
        sys.argv = kept
