"""Who may look from the network: by the address of this machine there, with a link, and only by GET.

The guard of the studio itself (`dousa.app.studio.core.guard`) knows one person, who may do everything. Here are many,
who may do nothing: no other method is let through, no body is read, and the owner's token is worth nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING
from urllib.parse import parse_qsl, quote

from dousa.app.studio.core.answers import Answer, RefusedError
from dousa.app.studio.core.guard import Door, check_names, read_cookies

if TYPE_CHECKING:
    from starlette.datastructures import Headers
    from starlette.types import ASGIApp, Receive, Scope

    from dousa.app.studio.core.share_links import ShareLink, ShareLinks

KEY = "key"
"""The name of the secret of a link in its address."""

LINK = "share_link"
"""Where the link by which somebody came stands in the state of a request."""


class SharedGuard(Door):
    """Who may look at what is shown on the network.

    Parameters
    ----------
    app : what answers requests that may come in.
    host : address and port at which the network sees the studio.
    links : which are let in.
    """

    def __init__(self, app: ASGIApp, host: str, links: ShareLinks) -> None:
        super().__init__(app)
        self._host, self._links = host, links
        self._cookie = f"__Host-dousa_share_{host.rpartition(':')[2]}"  # sent over https alone, set by nobody else

    async def judge(self, scope: Scope, headers: Headers, receive: Receive) -> Answer | Receive:
        """As `Door.judge`: by the name that is asked, the method, and the link."""
        check_names(scope["method"], headers, "https", {self._host})
        if scope["method"] not in ("GET", "HEAD"):
            raise RefusedError(405, "studio_share.only_reads")
        if headers.get("content-length", "0") != "0" or "transfer-encoding" in headers:
            raise RefusedError(413, "studio.large_request", most=0)
        asked = dict(parse_qsl(scope["query_string"].decode("latin-1")))
        if KEY in asked and not scope["path"].startswith("/api/"):
            return self._welcome(asked[KEY])
        scope.setdefault("state", {})[LINK] = self._find_link(headers)
        return receive

    def _find_link(self, headers: Headers) -> ShareLink:
        for token in read_cookies(headers.getlist("cookie"), self._cookie):
            link = self._links.find(token)
            if link is not None:
                return link
        raise RefusedError(401, "studio_share.no_key")

    def _welcome(self, token: str) -> Answer:
        """The secret goes from the address into a cookie; the page that is shown is the link's own."""
        link = self._links.find(token)
        if link is None:
            raise RefusedError(401, "studio_share.no_key")
        answer = Answer(None, 303)
        answer.headers["location"] = "/" if link.report is None else f"/report?job={quote(link.report)}"
        answer.set_cookie(self._cookie, link.token, httponly=True, secure=True, samesite="lax", path="/")
        return answer
