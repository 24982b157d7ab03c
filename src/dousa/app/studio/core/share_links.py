"""Links by which others look at what a studio shows on the network: each has a secret of its own, and is taken back
alone."""

from __future__ import annotations

import hmac
import secrets
import threading
import time
from dataclasses import dataclass, field

from dousa.app.studio.core.answers import RefusedError

_MOST = 200


@dataclass(frozen=True, slots=True)
class ShareLink:
    """One link.

    Parameters
    ----------
    report : the job of the one evaluation that it shows; None for all of them and the library.
    number : names it, for who takes it back.
    token : the secret in its address.
    created_s : Unix time.
    """

    report: str | None
    number: str = field(default_factory=lambda: secrets.token_hex(4))
    token: str = field(default_factory=lambda: secrets.token_urlsafe(24), repr=False)
    created_s: float = field(default_factory=time.time)


class ShareLinks:
    """The links that hold now, safe to be used from any thread."""

    def __init__(self) -> None:
        self._links: list[ShareLink] = []
        self._lock = threading.Lock()

    def add(self, report: str | None) -> ShareLink:
        """The link to one evaluation, or to everything; the same one as long as it holds.

        Raises
        ------
        RefusedError : too many links.
        """
        with self._lock:
            for link in self._links:
                if link.report == report:
                    return link
            if len(self._links) >= _MOST:
                raise RefusedError(409, "studio_share.many_links", most=_MOST)
            self._links.append(ShareLink(report))
            return self._links[-1]

    def find(self, token: str) -> ShareLink | None:
        """The link with this secret; every one is compared, so that the time tells nothing."""
        given, found = token.encode("utf-8", "replace"), None
        with self._lock:
            for link in self._links:
                if hmac.compare_digest(link.token.encode(), given):
                    found = link
        return found

    def revoke(self, number: str) -> None:
        """Take a link back; who came by it gets nothing any more.

        Raises
        ------
        RefusedError : no such link.
        """
        with self._lock:
            kept = [link for link in self._links if link.number != number]
            if len(kept) == len(self._links):
                raise RefusedError(404, "studio_share.no_link", number=number[:20])
            self._links = kept

    def clear(self) -> None:
        """Take all back."""
        with self._lock:
            self._links = []

    def all(self) -> list[ShareLink]:
        """Those that hold, the oldest first."""
        with self._lock:
            return list(self._links)
