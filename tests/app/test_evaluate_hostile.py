"""``dousa evaluate`` against what a careless or hostile person gives it: endless files, closed streams, Ctrl-C."""

import importlib
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from dousa.errors import MotionFileError, OptionError
from dousa.evaluation import format_furi, read_furi, read_weights
from dousa.evaluation.figures.furi import Furi
from dousa.formats.registry import write_motion
from dousa.motion.synthetic.performers import draw_performer, make_motion
from patience import PATIENCE

cli = importlib.import_module("dousa.app.cli.main")  # the package gives the function of this name
_COMMAND = "from dousa.app.cli.main import main; main()"


@pytest.fixture(scope="module")
def motion(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("hostile") / "squat.bvh"
    write_motion(make_motion("squat", draw_performer(1)), path)
    return path


def test_an_endless_file_is_read_no_further_than_it_may_be_long():
    for read in (read_weights, lambda path: read_furi(path, 30.0, 100)):
        with pytest.raises((MotionFileError, OptionError), match="over 1 MB"):
            read("/dev/zero")


def test_a_pipe_is_as_good_as_a_file():
    for text, read in (("arms = 2\n", read_weights), ("1-20 a\n", lambda path: read_furi(path, 30.0, 100))):
        reader, writer = os.pipe()
        os.write(writer, text.encode())
        os.close(writer)
        try:
            assert read(f"/dev/fd/{reader}")
        finally:
            os.close(reader)


@pytest.mark.parametrize("text", ["arms = " + "9" * 400, "arms = " + "9" * 5000, "[" * 2000, "arms = 'x'" + "x" * 3000])
def test_absurd_weights_are_one_short_line(tmp_path, text):
    path = tmp_path / "weights"
    path.write_text(text)
    with pytest.raises(OptionError) as caught:
        read_weights(path)
    assert len(str(caught.value)) < len(str(path)) + 200 and "\n" not in str(caught.value)


def test_a_label_is_no_longer_than_a_line_of_the_page(tmp_path):
    path = tmp_path / "furi.txt"
    path.write_text("1-20 " + "x" * 100 + "\n")
    assert read_furi(path, 30.0, 100)[0].label == "x" * 100
    path.write_text("1-10 a\n11-20 " + "x" * 5000 + "\n")
    with pytest.raises(MotionFileError, match=r"furi.txt:2: expected a label of at most 100 letters, got 5000"):
        read_furi(path, 30.0, 100)
    with pytest.raises(OptionError, match="label"):
        format_furi([Furi(0, 10, "x" * 101)], 30.0)


def test_ctrl_c_in_a_compiled_loop_is_an_interruption(monkeypatch, capsys):
    def interrupted(standalone_mode):
        try:
            try:
                raise KeyboardInterrupt
            except KeyboardInterrupt as inner:
                raise SystemError("unpickle returned a result with an exception set") from inner
        except SystemError as error:
            raise SystemError("the loop returned a result with an exception set") from error

    monkeypatch.setattr(cli, "make_application", lambda words: interrupted)
    with pytest.raises(SystemExit) as stop:
        cli.main()
    assert stop.value.code == 130
    out = capsys.readouterr()
    assert out.out == "" and out.err.startswith("dousa: interrupted") and len(out.err.splitlines()) == 1


def test_other_system_errors_are_not_hidden(monkeypatch):
    def broken(standalone_mode):
        raise SystemError("a fault of the interpreter")

    monkeypatch.setattr(cli, "make_application", lambda words: broken)
    with pytest.raises(SystemError, match="a fault"):
        cli.main()


@pytest.mark.parametrize("words", [("--json",), pytest.param((), marks=pytest.mark.slow)])
def test_a_closed_standard_output_is_an_error_in_one_line(motion, words):
    done = _start(motion, *words, closed=1)
    assert done.returncode == 2
    assert done.stderr.startswith("dousa: the answer cannot be written") and len(done.stderr.splitlines()) == 1


def test_a_closed_standard_error_does_not_cost_the_answer(motion):
    done = _start(motion, "--json", closed=2)
    assert done.returncode == 0
    answer = json.loads(done.stdout, parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))
    assert answer["score"] == 100.0


def _start(motion: Path, *words: str, closed: int) -> subprocess.CompletedProcess[str]:
    """Evaluate a motion against itself in a process whose stream 1 or 2 is closed from the beginning."""
    words = ("evaluate", str(motion), "-p", str(motion), *words)
    command = ["sh", "-c", f'exec "$@" {closed}>&-', "sh", sys.executable, "-c", _COMMAND, *words]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=PATIENCE)
