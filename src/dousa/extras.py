"""Packages that only some people need: each comes with an extra of dousa, and says so where it is missing.

==========  ===================================================================  =====================================
extra       what it is for                                                       what it brings
==========  ===================================================================  =====================================
film        estimation from silhouettes, films, overlays                         OpenCV
pictures    contact sheets, timelines; Japanese text in pictures and reports     matplotlib, fontTools, a Japanese font
studio      the page in the browser, with all of the above                       FastAPI, uvicorn, Jinja
==========  ===================================================================  =====================================

``from dousa.extras import cv2`` is ``import cv2`` with that message; it stands where OpenCV is used, so that nothing
else waits for it.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from dousa.errors import MissingExtraError

if TYPE_CHECKING:
    import cv2

__all__ = ["cv2", "require"]


def require(package: str, extra: str) -> Any:
    """A package of an extra.

    Parameters
    ----------
    package : as it is imported.
    extra : the extra of dousa that brings it.

    Raises
    ------
    MissingExtraError : it is not installed; the message has the command that installs it.
    """
    try:
        return importlib.import_module(package)
    except ModuleNotFoundError as error:
        if error.name != package.partition(".")[0]:
            raise  # it is there, but something that it needs is not
        raise MissingExtraError(package, extra) from error


def __getattr__(name: str) -> Any:
    if name == "cv2":
        return require("cv2", "film")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
