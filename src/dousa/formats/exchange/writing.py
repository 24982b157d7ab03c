"""Writing of FBX: the user's Blender converts dousa's GLB."""

from __future__ import annotations

import os
import tempfile

from dousa.errors import MotionWriteError
from dousa.files.disk import atomic_write
from dousa.formats.exchange.programs import ProgramError, find_program, run_program
from dousa.formats.exchange.reading import blender_words
from dousa.formats.gltf.writing import write_glb
from dousa.messages import Message
from dousa.motion import Motion

_MAGIC = b"Kaydara FBX Binary"


def write_fbx(motion: Motion, path: str | os.PathLike[str]) -> None:
    """Write a motion as FBX through Blender: skeleton, animation, and the mesh of its character.

    Raises
    ------
    MotionWriteError : no Blender, or it fails; a joint without any pose; a disk error.
    """
    program = find_program("blender")
    if program is None:
        raise MotionWriteError(path, "exchange.no_blender")
    with tempfile.TemporaryDirectory(prefix="dousa-") as folder:
        source, result = os.path.join(folder, "motion.glb"), os.path.join(folder, "made.fbx")
        write_glb(motion, source)
        try:
            run_program(program, [*blender_words(), "write", source, result, repr(motion.frame_rate)], folder, result)
        except ProgramError as error:
            raise MotionWriteError(path, error.message) from error
        with open(result, "rb") as file:
            data = file.read()
    if not data.startswith(_MAGIC):
        raise MotionWriteError(path, Message("exchange.failed", program=program.title, reason="-"))
    with atomic_write(path) as file:
        file.write(data)
