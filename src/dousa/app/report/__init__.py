"""The report of an assessment: one HTML page that opens anywhere, offline, and two CSV files; and its parts by name,
for a page that shows them live."""

from __future__ import annotations

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
