"""``python -m dousa``."""

from __future__ import annotations

import subprocess
import sys

import dousa
from patience import PATIENCE


def run(*arguments):
    command = [sys.executable, "-m", "dousa", *arguments]
    return subprocess.run(command, check=False, capture_output=True, text=True, timeout=PATIENCE)


def test_the_package_is_the_command_line():
    said = run("--version")
    assert (said.returncode, said.stdout) == (0, f"dousa {dousa.__version__}\n")
    failed = run("info", "none.bvh")
    assert failed.returncode == 2
    assert "none.bvh" in failed.stderr and "Traceback" not in failed.stderr
