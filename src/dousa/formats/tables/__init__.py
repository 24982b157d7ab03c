"""Tables of text: TRC, Motive's and Qualisys' by their headers, and points of any program by their titles."""

from __future__ import annotations

from dousa.formats.tables.motive import write_motive
from dousa.formats.tables.reading import is_table, read_table
from dousa.formats.tables.trc import read_trc, write_trc

__all__ = ["is_table", "read_table", "read_trc", "write_motive", "write_trc"]
