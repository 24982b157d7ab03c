"""Positions of joints in space as JSON from pose estimators of films: one file, or one for each frame."""

from __future__ import annotations

from dousa.formats.landmarks.reading import read_landmarks

__all__ = ["read_landmarks"]
