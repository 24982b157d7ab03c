"""USD: skeletons and animations of UsdSkel, read by usd-core (``pip install 'dousa[usd]'``) in its own process."""

from __future__ import annotations

from dousa.formats.usd.reading import read_usd

__all__ = ["read_usd"]
