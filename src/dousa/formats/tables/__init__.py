"""Tables of text with a header: points of any program by their columns; Motive's and Qualisys' by their headers."""

from __future__ import annotations

from dousa.formats.optical import write_motive
from dousa.formats.tables.reading import is_table, read_table

__all__ = ["is_table", "read_table", "write_motive"]
