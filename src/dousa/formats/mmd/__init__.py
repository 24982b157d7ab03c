"""MikuMikuDance: motions (.vmd), and models (.pmx, .pmd) for the places of their bones."""

from __future__ import annotations

from dousa.formats.mmd.models import find_model
from dousa.formats.mmd.reading import read_vmd
from dousa.formats.mmd.writing import write_vmd

__all__ = ["find_model", "read_vmd", "write_vmd"]
