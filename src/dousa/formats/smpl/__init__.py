"""SMPL, SMPL-H, SMPL-X poses: AMASS npz and similar files; the mean body, or the user's own model file."""

from __future__ import annotations

from dousa.formats.smpl.reading import build_smpl, find_poses, read_smpl_npz
from dousa.formats.smpl.writing import write_amass

__all__ = ["build_smpl", "find_poses", "read_smpl_npz", "write_amass"]
