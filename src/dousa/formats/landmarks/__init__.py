"""Places of joints in space as JSON, as pose estimators of films write them: one file, or one for each frame."""

from __future__ import annotations

from dousa.formats.landmarks.reading import read_landmarks

__all__ = ["read_landmarks"]
