"""FBX and Collada through other programs: they convert a file to GLB, which dousa reads, or dousa's GLB to FBX.

Blender, which supports more of FBX, is tried before assimp. A program named by DOUSA_ASSIMP or DOUSA_BLENDER is tried
before one that is only found.
"""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import resources

from dousa.errors import MotionFileError, MotionWriteError
from dousa.files.disk import atomic_write, read_bytes
from dousa.formats.exchange.assimp_repair import collapse_helpers, read_unit
from dousa.formats.exchange.fbx_soundness import MAGIC, check_fbx
from dousa.formats.exchange.programs import Program, ProgramError, find_program, is_named, run_program
from dousa.formats.gltf.document import GltfDocument, load_document
from dousa.formats.gltf.reading import build_character, build_motion
from dousa.formats.gltf.writing import write_glb
from dousa.messages import Message
from dousa.motion import Motion

_SIGNS = {
    ".fbx": re.compile(rb"\AKaydara FBX Binary|FBXHeaderExtension|\A\s*; FBX"),
    ".dae": re.compile(rb"<COLLADA"),
}


@dataclass(frozen=True, slots=True, eq=False)
class _Converted:
    document: GltfDocument
    unit: float
    notes: tuple[Message, ...]


def read_exchange(
    path: str | os.PathLike[str],
    *,
    unit: float | str | None = None,
    up: str | None = None,
    animation: str | None = None,
) -> Motion:
    """Read an animation of an FBX or Collada file through Blender or assimp.

    Parameters
    ----------
    path : the file.
    unit : metres per unit; by default the declared one, unless the body would have no possible height.
    up : axis that points up; by default Y, into which the other program turns the file.
    animation : name or number; by default the longest.

    Raises
    ------
    MotionFileError : missing, damaged, no program that could read it, no skeleton or no such animation.
    """
    made = _convert(path)
    return build_motion(
        made.document, unit=unit, up=up, animation=animation, format_name=_format(path), declared_unit=made.unit,
        notes=made.notes,
    )  # fmt: skip


def read_exchange_character(
    path: str | os.PathLike[str], *, unit: float | str | None = None, up: str | None = None
) -> Motion:
    """Read one frame of a file at rest, as a character for other motions; it needs no animation."""
    made = _convert(path)
    return build_character(made.document, unit=unit, up=up, format_name=_format(path), declared_unit=made.unit)


def _format(path: str | os.PathLike[str]) -> str:
    return os.path.splitext(path)[1].lower()[1:]


def _convert(path: str | os.PathLike[str]) -> _Converted:
    """Convert a file by the first program that can read it."""
    data = read_bytes(path)
    suffix = f".{_format(path)}"
    if suffix in _SIGNS and not _SIGNS[suffix].search(data[:4096]):
        raise MotionFileError(path, "exchange.other_content", format=suffix[1:].upper())
    notes = check_fbx(path, data) if suffix == ".fbx" else ()
    problem: Message | None = None
    for program in _list_programs():
        try:
            return _run(path, program, data if program.name == "assimp" and suffix == ".fbx" else b"", notes)
        except ProgramError as error:
            problem = problem or error.message
        except MotionFileError as error:
            problem = problem or Message("exchange.unreadable", program=program.title, problem=error.message)
    if problem is None:
        raise MotionFileError(path, "exchange.no_program", suffix=suffix)
    raise MotionFileError(path, problem)


def _list_programs() -> Iterator[Program]:
    for name in sorted(("blender", "assimp"), key=lambda name: not is_named(name)):
        program = find_program(name)
        if program is not None:
            yield program


def _run(path: str | os.PathLike[str], program: Program, data: bytes, notes: tuple[Message, ...]) -> _Converted:
    with tempfile.TemporaryDirectory(prefix="dousa-") as folder:
        result = os.path.join(folder, "made.glb")
        source = os.path.abspath(path)
        if program.name == "assimp":
            run_program(program, ["export", source, result], folder, result)
        else:
            run_program(program, [*blender_words(), "read", source, result], folder, result)
        document = load_document(result)
    document.path = path
    if program.name == "assimp":
        collapse_helpers(document)
    through = Message("exchange.through", program=program.title)
    return _Converted(document, read_unit(data) if data else 1.0, (through, *notes))


def blender_words() -> list[str]:
    """Return Blender's options for our job: no window, no user settings."""
    job = str(resources.files("dousa.formats.exchange").joinpath("blender_job.py"))
    return ["--background", "--factory-startup", "--disable-autoexec", "--python-exit-code", "3", "--python", job, "--"]


def find_blender(path: str | os.PathLike[str]) -> Program:
    """Find Blender to write ``path``; MotionWriteError if it is not on this machine."""
    program = find_program("blender")
    if program is None:
        raise MotionWriteError(path, "exchange.no_blender")
    return program


def write_fbx(motion: Motion, path: str | os.PathLike[str]) -> None:
    """Write a motion as FBX through Blender: skeleton, animation, and the mesh of its character.

    Raises
    ------
    MotionWriteError : no Blender, or it fails; a joint without any pose; a disk error.
    """
    program = find_blender(path)
    with tempfile.TemporaryDirectory(prefix="dousa-") as folder:
        source, result = os.path.join(folder, "motion.glb"), os.path.join(folder, "made.fbx")
        write_glb(motion, source)
        try:
            run_program(program, [*blender_words(), "write", source, result, repr(motion.frame_rate)], folder, result)
        except ProgramError as error:
            raise MotionWriteError(path, error.message) from error
        with open(result, "rb") as file:
            data = file.read()
    if not data.startswith(MAGIC):
        raise MotionWriteError(path, Message("exchange.failed", program=program.title, reason="-"))
    with atomic_write(path) as file:
        file.write(data)
