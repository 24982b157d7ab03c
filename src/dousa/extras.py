"""Optional packages, each in an extra of dousa that is named in the error if it is missing.

==========  ===================================================================  =====================================
extra       what it is for                                                       what it brings
==========  ===================================================================  =====================================
film        estimation from silhouettes, films, overlays; keypoints of films     OpenCV, PyAV, LiteRT
pictures    contact sheets, timelines; Japanese text in pictures and reports     matplotlib, fontTools, a Japanese font
music       the beats of a piece of music                                        librosa
usd         skeletons of USD files                                               usd-core
map         a map of all clips of a library                                      scikit-learn
frames      answers as data frames                                               pandas (or polars)
studio      the page in the browser, with film, pictures and map                 FastAPI, uvicorn, Jinja
share       a link to the studio for others on the local network                 segno, cryptography
words       English words of a search that no table has, by their meaning        WordLlama
postgres    libraries in a PostgreSQL database                                   psycopg
s3          fragments of a library in object storage                             s3fs
cluster     adding, training and experiments on the workers of a cluster         Dask distributed
==========  ===================================================================  =====================================

``from dousa.extras import cv2`` is ``import cv2`` with that message, at the first use of the package: at the top of a
module it costs nothing.
"""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dousa.errors import MissingExtraError

if TYPE_CHECKING:
    import cv2

__all__ = ["FONT_PACKAGE", "cv2", "find_font", "require"]

FONT_PACKAGE, _FONT_FILE = "matplotlib-fontja", "ipaexg.ttf"


def require(package: str, extra: str) -> Any:
    """Import a package, such as ``cv2``, of an extra of dousa.

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


def find_font() -> Path | None:
    """Find the file of the Japanese font of the extra ``pictures``, None if it is not installed.

    Its package is not imported, as that would change the settings of matplotlib.
    """
    from importlib import metadata

    try:
        files = metadata.files(FONT_PACKAGE) or ()
    except metadata.PackageNotFoundError:
        return None
    for file in files:
        if file.name == _FONT_FILE:
            path = Path(str(file.locate()))
            return path if path.is_file() else None
    return None


class _Package:
    """A package of an extra, imported when something of it is used."""

    def __init__(self, package: str, extra: str) -> None:
        self._package, self._extra = package, extra

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):  # what copies, unpickles or inspects any object asks for
            raise AttributeError(name)
        # Imported, and not looked up: a thread may ask while another imports it, and then waits.
        return getattr(require(self._package, self._extra), name)


if not TYPE_CHECKING:
    cv2 = _Package("cv2", "film")
