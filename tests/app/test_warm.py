"""Compiling ahead: ``dousa warm``."""

import os
import signal
import subprocess
import sys
import time

import pytest

from dousa.app.warm import PARTS, warm
from dousa.errors import OptionError
from patience import PATIENCE


def test_what_was_compiled_once_is_ready_afterwards():
    told = []
    warm(["evaluation"])
    (found,) = warm(["evaluation"], progress=lambda done, total, what: told.append((done, total)))
    assert found.problem is None
    assert found.compiled == 0
    assert told == [(n, len(PARTS["evaluation"])) for n in range(1, len(PARTS["evaluation"]) + 1)]


def test_an_unknown_part_is_refused_by_name():
    with pytest.raises(OptionError, match="library, estimation or evaluation, got 'dance'"):
        warm(["dance"])


@pytest.mark.nightly
@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_it_can_be_interrupted(tmp_path):
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache"), "TMPDIR": str(tmp_path)}
    process = subprocess.Popen(
        [sys.executable, "-m", "dousa", "warm"], stderr=subprocess.PIPE, text=True, env=environment
    )
    while not any((tmp_path / "cache").rglob("*.nbc")):
        time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    assert process.communicate(timeout=PATIENCE)[1].startswith("dousa: interrupted; finished work is kept")
    assert process.returncode == 130
