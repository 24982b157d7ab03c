"""Folders with a JSON file for each frame, as OpenPose writes them: together they are one motion."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence

from dousa.files.frame_names import natural_key

_HEAD_BYTES = 65_536
_POINTS = re.compile(rb'"pose_keypoints_3d"\s*:\s*\[\s*-?\d')
_PEOPLE = re.compile(rb'"people"\s*:\s*\[')
_LOOKED_AT = 5


def list_frame_files(folder: str | os.PathLike[str]) -> list[str]:
    """List the JSON files of a folder, in the order of their numbers."""
    names = [name for name in os.listdir(folder) if name.lower().endswith(".json") and not name.startswith(".")]
    return sorted(names, key=natural_key)


def is_frame_folder(folder: str | os.PathLike[str], names: Sequence[str] | None = None) -> bool:
    """Return whether a folder holds the 3D points of the frames of one take, a file for each.

    A few files are read, as the first may be without a person; ``names`` are those of its files, if known.
    """
    if names is not None and not any(name.lower().endswith(".json") for name in names):
        return False
    try:
        found = list_frame_files(folder)
        step = max(1, len(found) // _LOOKED_AT)
        return any(_has_points(os.path.join(folder, name)) for name in found[::step][: _LOOKED_AT + 1])
    except OSError:
        return False


def _has_points(path: str) -> bool:
    with open(path, "rb") as file:
        head = file.read(_HEAD_BYTES)
    return _PEOPLE.search(head) is not None and _POINTS.search(head) is not None
