"""Who may come in: only this machine, under its own name, with the token; and no request without end. Here the language
of a request is chosen as well.

A page of somebody else in the same browser can reach 127.0.0.1. It is kept out three times: it does not know the
token, the cookie is not sent with its requests, and the browser names it in ``Origin`` and ``Sec-Fetch-Site``.
A name that somebody else points at 127.0.0.1 (DNS rebinding) is kept out by the ``Host`` header.
"""

from __future__ import annotations

import hmac
import html
from collections.abc import Iterable
from http.cookies import CookieError, SimpleCookie
from typing import TYPE_CHECKING
from urllib.parse import parse_qsl, quote, urlencode

from starlette.datastructures import Headers, MutableHeaders

from dousa.app.studio.core.answers import Answer, RefusedError, to_answer
from dousa.app.studio.core.words import say
from dousa.messages import LANGUAGES, get_language, use_language

if TYPE_CHECKING:
    from starlette.types import ASGIApp, Message, Receive, Scope, Send

    from dousa.app.studio.core.workspace import Settings

UPLOAD_PATH = "/api/uploads"
"""The one address whose requests may be large."""

_MOST_BODY = 2_000_000  # bytes; weights, cuts, labels and selections are small

# Scripts come from us and nothing is evaluated. Styles may stand in elements: the bars of the report have widths.
_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; "
    "media-src 'self' blob:; font-src 'self' data:; connect-src 'self'; manifest-src 'self'; "
    "base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
)
_HEADERS = {
    "content-security-policy": _POLICY,
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "permissions-policy": "camera=(), microphone=(), geolocation=()",
}


class Guard:
    """The ASGI application in front of the studio's.

    Parameters
    ----------
    app : what answers requests that may come in.
    settings : token, names and limits.
    """

    def __init__(self, app: ASGIApp, settings: Settings) -> None:
        self._app = app
        self._settings = settings
        self._cookie = f"dousa_{settings.port}"  # cookies do not tell ports apart: each studio has its own

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, or let it through."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        if scope["type"] != "http":  # there are no web sockets here
            await send({"type": "websocket.close"})
            return
        headers = Headers(scope=scope)
        use_language(_choose_language(scope, headers))
        guarded = _with_headers(send)
        try:
            self._check_names(scope["method"], headers)
            asked = parse_qsl(scope["query_string"].decode("latin-1"), keep_blank_values=True)
            if scope["method"] == "GET" and "token" in dict(asked) and not scope["path"].startswith("/api/"):
                await self._welcome(asked, scope, receive, guarded)
                return
            self._check_token(headers)
            most = self._limit(scope["path"])
            _check_length(headers, most)
        except RefusedError as error:
            await _refuse(error, scope, receive, guarded)
            return
        counting = _Counting(receive, most)
        await self._app(scope, counting, guarded)

    def _check_names(self, method: str, headers: Headers) -> None:
        hosts = self._settings.hosts
        for name in ("host", "origin", "sec-fetch-site"):
            if len(headers.getlist(name)) > 1:  # which one counts, others may see differently
                raise RefusedError(400, "studio.several_headers", name=name.title())
        if headers.get("host", "") not in hosts:
            raise RefusedError(421, "studio.other_host", host=min(hosts), found=headers.get("host", ""))
        origin = headers.get("origin")
        if origin is not None and origin.removeprefix("http://") not in hosts:
            raise RefusedError(403, "studio.other_origin", origin=origin)
        site = headers.get("sec-fetch-site", "none")
        if site not in ("none", "same-origin") and not (
            method == "GET" and headers.get("sec-fetch-mode") == "navigate"
        ):
            raise RefusedError(403, "studio.other_site", site=site)

    def _check_token(self, headers: Headers) -> None:
        kind, _, bearer = headers.get("authorization", "").partition(" ")
        candidates = [bearer.strip()] if kind.lower() == "bearer" else []
        candidates += _cookies(headers.getlist("cookie"), self._cookie)
        if not any(self._is_token(candidate) for candidate in candidates):
            raise RefusedError(401, "studio.no_token")

    def _is_token(self, text: str) -> bool:
        return hmac.compare_digest(text.encode("utf-8", "replace"), self._settings.token.encode())

    def _limit(self, path: str) -> int:
        return self._settings.most_bytes if path.startswith(UPLOAD_PATH) else _MOST_BODY

    async def _welcome(self, asked: list[tuple[str, str]], scope: Scope, receive: Receive, send: Send) -> None:
        """The token goes from the address into a cookie, so that it is in no history and no screenshot."""
        if not self._is_token(dict(asked)["token"]):
            raise RefusedError(401, "studio.other_token")
        rest = urlencode([(name, value) for name, value in asked if name != "token"])
        answer = Answer(None, 303)
        # "//evil.example" would be another machine, and browsers leave out tabs and line ends between the slashes.
        path = "/" + quote(scope["path"].lstrip("/\\"), errors="replace")
        answer.headers["location"] = path + (f"?{rest}" if rest else "")
        answer.set_cookie(self._cookie, self._settings.token, httponly=True, samesite="lax", path="/")
        await answer(scope, receive, send)


class _Counting:
    """Receives no more than so many bytes."""

    def __init__(self, receive: Receive, most: int) -> None:
        self._receive, self._left, self._most = receive, most, most

    async def __call__(self) -> Message:
        message = await self._receive()
        if message["type"] == "http.request":
            self._left -= len(message.get("body", b""))
            if self._left < 0:
                raise _too_large(self._most)
        return message


def _with_headers(send: Send) -> Send:
    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            for name, value in _HEADERS.items():
                headers.setdefault(name, value)
            headers.setdefault("cache-control", "no-store")
        await send(message)

    return sending


def _too_large(most: int) -> RefusedError:
    return RefusedError(413, "studio.large_request", most=most / 1e6)


def _check_length(headers: Headers, most: int) -> None:
    length = headers.get("content-length", "0")
    if not (length.isascii() and length.isdigit()):
        raise RefusedError(400, "studio.content_length", found=length)
    if len(length) > 18 or int(length) > most:
        raise _too_large(most)


def _choose_language(scope: Scope, headers: Headers) -> str:
    """A page by its address, else as it was chosen last, else as the browser asks; the interface as it is asked."""
    if not scope["path"].startswith("/api/"):
        asked = dict(parse_qsl(scope["query_string"].decode("latin-1")))
        for chosen in (asked.get("lang"), *_cookies(headers.getlist("cookie"), "dousa_lang")):
            if chosen in LANGUAGES:
                return chosen
    return headers.get("accept-language", "").lower()[:2]


def _cookies(lines: Iterable[str], name: str) -> list[str]:
    values = []
    for line in lines:
        try:
            cookie = SimpleCookie(line)
        except CookieError:
            continue
        if name in cookie:
            values.append(cookie[name].value)
    return values


async def _refuse(error: RefusedError, scope: Scope, receive: Receive, send: Send) -> None:
    # What a stranger goes on to send is not waited for.
    headers = {"connection": "close"} if error.status in (401, 403, 421) else None
    if scope["method"] == "GET" and not scope["path"].startswith(("/api/", "/static/")):
        from starlette.responses import HTMLResponse

        page = HTMLResponse(
            _CLOSED.format(language=get_language(), status=error.status, problem=html.escape(say(error.message))),
            error.status,
            headers,
        )
        await page(scope, receive, send)
        return
    await Answer(to_answer(error.message), error.status, headers)(scope, receive, send)


_CLOSED = """<!doctype html><html lang="{language}"><meta charset="utf-8"><title>dousa studio</title>
<meta name="viewport" content="width=device-width"><meta name="color-scheme" content="light dark">
<body style="font:16px/1.6 system-ui,sans-serif;max-width:40rem;margin:15vh auto;padding:0 1.5rem">
<h1 style="font-size:1.4rem">dousa studio <small>({status})</small></h1><p>{problem}</p></body></html>"""
