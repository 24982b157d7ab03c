"""Tables of text of optical systems: OptiTrack Motive CSV, Qualisys TSV."""

from __future__ import annotations

from dousa.formats.optical.motive import read_motive, write_motive
from dousa.formats.optical.qualisys import read_qualisys

__all__ = ["read_motive", "read_qualisys", "write_motive"]
