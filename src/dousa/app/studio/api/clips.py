"""Clips and takes of the library: the list with its facets, thumbnails, labels, removal."""

from __future__ import annotations

from fastapi import APIRouter

__all__ = ["router"]

router = APIRouter(tags=["library"])
