"""Biovision BVH: a tree of joints with Euler angles, one line of channel values a frame."""

from __future__ import annotations

from dousa.formats.bvh.reading import BvhLayout, read_bvh
from dousa.formats.bvh.writing import write_bvh

__all__ = ["BvhLayout", "read_bvh", "write_bvh"]
