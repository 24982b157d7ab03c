"""Programs of the lab run in this process."""

from __future__ import annotations

import runpy
import sys
from collections.abc import Callable

import pytest


@pytest.fixture
def program(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str, str]]:
    """Runs ``python -m lab.NAME WORDS...``: (exit code, standard output, standard error)."""

    def run(name: str, *words: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", [name, *map(str, words)])
        code: object = 0
        try:
            runpy.run_module(f"lab.{name}", run_name="__main__", alter_sys=True)
        except SystemExit as stop:
            code = stop.code or 0
        out, err = capsys.readouterr()
        return int(str(code)), out, err

    return run
