"""The studio: one local web page for the whole of dousa, and the HTTP interface that the page itself uses.

The server renders the shells of the pages and answers ``/api``; everything that moves in a page is drawn by plain
scripts of ours in the browser, with the player of the report as the one viewer. Needs ``pip install dousa[studio]``.
"""

from __future__ import annotations

from dousa._lazy import load_when_used

_HOME = {"Settings": "settings", "create_app": "server", "serve": "serving"}

__all__ = sorted(_HOME)  # noqa: PLE0605

__getattr__ = load_when_used(__name__, {name: f"{__name__}.{module}" for name, module in _HOME.items()})
