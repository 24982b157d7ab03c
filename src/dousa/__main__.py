"""``python -m dousa``: the command line, where ``dousa`` is not on the path."""

from __future__ import annotations

from dousa.app.cli import main

main()
