"""Motion files: one module per format; ``read_motion`` and ``write_motion`` choose by suffix."""

from dousa.files.frame_files import is_frame_folder
from dousa.formats.motion_files import FoundFile, ReadOptions, Skipped, find_motion_files, read_canonical
from dousa.formats.registry import (
    FORMATS,
    READERS,
    SUFFIXES,
    WRITERS,
    Format,
    read_character,
    read_motion,
    write_motion,
)

__all__ = [
    "FORMATS",
    "READERS",
    "SUFFIXES",
    "WRITERS",
    "Format",
    "FoundFile",
    "ReadOptions",
    "Skipped",
    "find_motion_files",
    "is_frame_folder",
    "read_canonical",
    "read_character",
    "read_motion",
    "write_motion",
]
