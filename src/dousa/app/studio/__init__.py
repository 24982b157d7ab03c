"""The studio: one local web page for the whole of dousa, and the HTTP interface that the page itself uses.

The server renders the shells of the pages and answers ``/api``; everything that moves in a page is drawn by plain
scripts of ours in the browser, with the player of the report as the one viewer. Needs ``pip install dousa[studio]``.
"""

from __future__ import annotations

from typing import Any

import lazy_loader

from dousa.extras import require

_load, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    for package in ("fastapi", "uvicorn", "jinja2"):
        require(package, "studio")
    return _load(name)
