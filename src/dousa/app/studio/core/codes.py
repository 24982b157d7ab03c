"""Codes that let a browser in once.

An address stays in the history of the browser, and in the arguments of its process, which every user of the machine
can list. So the address that is opened has no token: it has a code that is worth nothing after its first use.
"""

from __future__ import annotations

import hmac
import secrets
import threading
from collections import deque

_MOST = 20  # codes that wait; older ones are dropped


class Codes:
    """Codes that were given out and not used, safe to be used from any thread."""

    def __init__(self) -> None:
        self._waiting: deque[str] = deque(maxlen=_MOST)
        self._lock = threading.Lock()

    def issue(self) -> str:
        """A new code."""
        code = secrets.token_urlsafe(24)
        with self._lock:
            self._waiting.append(code)
        return code

    def redeem(self, text: str) -> bool:
        """Use a code up; whether it was one that waited."""
        given = text.encode("utf-8", "replace")
        with self._lock:
            for code in self._waiting:
                if hmac.compare_digest(code.encode(), given):
                    self._waiting.remove(code)
                    return True
        return False
