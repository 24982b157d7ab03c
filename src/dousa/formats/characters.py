"""Characters: files with a skeleton for other motions."""

from __future__ import annotations

import os

from dousa.errors import OptionError
from dousa.formats.registry import find_reader, read_motion
from dousa.motion import Motion


def read_character(path: str | os.PathLike[str], *, unit: float | str | None = None, up: str | None = None) -> Motion:
    """Read the skeleton of a file, as a motion or as a single pose.

    Parameters
    ----------
    path : any file of joint rotations; a glTF, GLB, VRM or FBX needs no animation.
    unit, up : if not in the file.

    Raises
    ------
    MotionFileError : the file cannot be read.
    OptionError : it holds positions, and no skeleton.
    """
    line = find_reader(path)
    if line is not None and line.module == "dousa.formats.gltf":
        from dousa.formats.gltf import read_gltf_character

        return read_gltf_character(path, unit=unit, up=up)
    if line is not None and line.module == "dousa.formats.exchange":
        from dousa.formats.exchange import read_exchange_character

        return read_exchange_character(path, unit=unit, up=up)
    character = read_motion(path, unit=unit, up=up)
    if not isinstance(character, Motion):
        raise OptionError("retarget.no_skeleton", path=path)
    return character
