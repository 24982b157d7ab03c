"""A studio in a process of its own, for the benchmarks that ask one from outside."""

from __future__ import annotations

import re
import subprocess
import sys
import threading
from pathlib import Path

__all__ = ["start_studio"]


def start_studio(library: Path, *words: str, folder: Path | None = None) -> tuple[subprocess.Popen[str], int, str]:
    """Start ``dousa studio`` without a browser; its process, port and token.

    Parameters
    ----------
    library : file of the library.
    words : further options.
    folder : to start it in.
    """
    command = [sys.executable, "-m", "dousa.app.cli.main", "studio", str(library), "--no-browser", *words]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, cwd=folder)
    assert process.stderr is not None
    port = 0
    for line in process.stderr:
        if found := re.search(r":(\d+)/\?code=", line):
            port = int(found[1])
        if found := re.search(r"browsers: (\S+)\)", line):
            threading.Thread(target=process.stderr.read, daemon=True).start()
            return process, port, found[1]
    raise SystemExit("the studio did not start")
