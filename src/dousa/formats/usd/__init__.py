"""USD: skeletons and animations of UsdSkel, read by usd-core (``pip install 'dousa[usd]'``) in a process of its own."""

from __future__ import annotations

from dousa.formats.usd.reading import read_usd

__all__ = ["read_usd"]
