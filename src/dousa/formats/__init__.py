"""Motion files: one module per format, ``read_motion`` and ``write_motion`` choose by suffix."""

from dousa.formats._registry import FORMATS, READERS, SUFFIXES, WRITERS, Format, read_motion, write_motion

__all__ = ["FORMATS", "READERS", "SUFFIXES", "WRITERS", "Format", "read_motion", "write_motion"]
