"""A motion or an assessment that plays in a notebook, or in a page of its own; nothing is loaded from a network."""

from __future__ import annotations

import html
import os
from dataclasses import dataclass
from typing import Any

from dousa.app.player.data import (
    encode_motion,
    encode_player_data,
    format_player_data,
    read_player_script,
    read_player_style,
)
from dousa.evaluation import Assessment
from dousa.files.disk import atomic_write
from dousa.formats.motion_files import ReadOptions, read_canonical
from dousa.messages import get_language
from dousa.motion import CanonicalMotion, canonicalise


@dataclass(frozen=True, slots=True)
class PlayedFigure:
    """A page that plays figures; a notebook shows it, and `save` writes it."""

    page: str
    height: int = 520  # pixels, of the cell: by definition of the player's own page

    def _repr_html_(self) -> str:
        style = f"width:100%;height:{self.height}px;border:0"
        return f'<iframe srcdoc="{html.escape(self.page)}" style="{style}"></iframe>'

    def __repr__(self) -> str:
        return f"PlayedFigure({len(self.page) // 1000} kB; shown by notebooks, or save it as a page)"

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the page, which needs no other file; MotionWriteError where the disk refuses."""
        with atomic_write(path) as file:
            file.write(self.page.encode())


def plot(what: Any, name: str = "") -> PlayedFigure:
    """Play a motion, or an assessment with both performers, in a notebook.

    Parameters
    ----------
    what : a motion file, a `Motion`, `Trajectories` or `CanonicalMotion`, or an `Assessment`.
    name : shown over the figure.

    Raises
    ------
    MotionFileError, JointMappingError : a file that cannot be read, or joints that are not those of a person.

    >>> dousa.plot("wave.bvh").save("wave.html")
    """
    language = get_language()
    if isinstance(what, Assessment):
        data = encode_player_data(what, language)
    else:
        if isinstance(what, str | os.PathLike):
            name, what = name or os.path.basename(what), read_canonical(os.fspath(what), ReadOptions())[0]
        motion = what if isinstance(what, CanonicalMotion) else canonicalise(what)
        data = encode_motion(motion, name, language=language)
    return PlayedFigure(
        f"<!doctype html><meta charset=utf-8><title>{html.escape(name)}</title><style>{read_player_style()}</style>"
        f"<div id=player></div><script>{read_player_script()}\n"
        f'dousa.createPlayer(document.getElementById("player"), {format_player_data(data)});</script>'
    )
