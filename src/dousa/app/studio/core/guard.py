"""Let requests in only from this machine, to its own name, with the token, and of limited size; choose their language.

A page of another site in the same browser can reach 127.0.0.1. It is kept out three times: it does not know the token,
the cookie is not sent with its requests, and the browser names it in ``Origin`` and ``Sec-Fetch-Site``. A foreign name
that points to 127.0.0.1 (DNS rebinding) is kept out by the ``Host`` header.

The address of a page stays in the history of the browser and in the arguments of its process, which every user of the
machine can list. So the address that is opened has a code that is used once, not the token.
"""

from __future__ import annotations

import hmac
import html
import secrets
import threading
from collections import deque
from collections.abc import Collection, Iterable
from http.cookies import CookieError, SimpleCookie
from typing import TYPE_CHECKING
from urllib.parse import parse_qsl, quote, urlencode

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import HTMLResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from dousa.app.studio.core.answers import Answer, RefusedError, say, to_answer
from dousa.messages import LANGUAGES, get_language, use_language
from dousa.messages import Message as _Words

if TYPE_CHECKING:
    from dousa.app.studio.core.workspace import Settings

UPLOAD_PATH = "/api/uploads"
"""The one address whose requests may be large."""

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
    "permissions-policy": "camera=(self), microphone=(), geolocation=()",
}


class RequestGuard:
    """The ASGI application in front of another, which answers, refuses or passes on requests in their language.

    Parameters
    ----------
    app : answers requests that are passed on.
    asks_token : pages that are refused have a field for the token.
    """

    def __init__(self, app: ASGIApp, *, asks_token: bool = False) -> None:
        self._app = app
        self._asks_token = asks_token

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request or pass it on."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        if scope["type"] != "http":  # there are no web sockets here
            await send({"type": "websocket.close"})
            return
        headers = Headers(scope=scope)
        use_language(choose_language(scope, headers))
        guarded = with_headers(send)
        try:
            judged = await self.judge(scope, headers, receive)
        except RefusedError as error:
            await refuse(error, scope, receive, guarded, asks_token=self._asks_token)
            return
        if isinstance(judged, Answer):
            await judged(scope, receive, guarded)
        else:
            await self._app(scope, judged, guarded)

    async def judge(self, scope: Scope, headers: Headers, receive: Receive) -> Answer | Receive:
        """Return the answer, or how the application receives the body; RefusedError if the request is refused."""
        raise NotImplementedError


class Guard(RequestGuard):
    """The guard of the studio.

    Parameters
    ----------
    app : answers requests that are passed on.
    settings : token, names and limits.
    codes : let a browser in once.
    """

    def __init__(self, app: ASGIApp, settings: Settings, codes: Codes) -> None:
        super().__init__(app, asks_token=True)
        self._settings = settings
        self._codes = codes
        self._cookie = f"dousa_{settings.port}"  # cookies do not tell ports apart: each studio has its own

    async def judge(self, scope: Scope, headers: Headers, receive: Receive) -> Answer | Receive:
        """Check host, token, cookie or code, and the length of the body."""
        check_names(scope["method"], headers, "http", self._settings.hosts)
        asked = parse_qsl(scope["query_string"].decode("latin-1"), keep_blank_values=True)
        if scope["method"] == "GET" and not scope["path"].startswith("/api/"):
            given = dict(asked)
            if "token" in given or "code" in given:
                return self._welcome(scope["path"], asked, headers)
        if not self._knows_token(headers):
            raise RefusedError(401, "studio.no_token")
        most = self._limit(scope["path"])
        check_length(headers, most)
        return CountingReceive(receive, most)

    def _knows_token(self, headers: Headers) -> bool:
        kind, _, bearer = headers.get("authorization", "").partition(" ")
        candidates = [bearer.strip()] if kind.lower() == "bearer" else []
        candidates += read_cookies(headers.getlist("cookie"), self._cookie)
        return any(self._is_token(candidate) for candidate in candidates)

    def _is_token(self, text: str) -> bool:
        return hmac.compare_digest(text.encode("utf-8", "replace"), self._settings.token.encode())

    def _limit(self, path: str) -> int:
        # bytes; weights, cuts, labels and selections are small
        return self._settings.most_bytes if path.startswith(UPLOAD_PATH) else 2_000_000

    def _welcome(self, path: str, asked: list[tuple[str, str]], headers: Headers) -> Answer:
        """Move token or code from the address into a cookie.

        Browsers with a code are sent on, with a new code, to the name that only this studio has, as no other server of
        this machine gets cookies of that name.
        """
        given, alias = dict(asked), self._settings.alias
        rest = [(name, value) for name, value in asked if name not in ("token", "code")]
        answer = Answer(None, 303)
        place = _own_place(path)
        if "token" in given:
            if not self._is_token(given["token"].strip()):
                raise RefusedError(401, "studio.other_token")
            self._let_in(answer)
        elif self._codes.redeem(given["code"]):
            named = f"{alias}:{self._settings.port}"
            if alias and headers.get("host", "") != named:
                place = f"http://{named}{place}"
                rest.append(("code", self._codes.issue()))
            else:
                self._let_in(answer)
        elif not self._knows_token(headers):  # who is in already just goes on
            raise RefusedError(401, "studio.used_code")
        answer.headers["location"] = place + (f"?{urlencode(rest)}" if rest else "")
        return answer

    def _let_in(self, answer: Answer) -> None:
        answer.set_cookie(self._cookie, self._settings.token, httponly=True, samesite="lax", path="/")


def _own_place(path: str) -> str:
    """Quote a path of this studio: "//evil.example" and, to browsers, "/\\evil.example" are other machines."""
    # Browsers leave out tabs and line ends between the slashes, so they are quoted.
    return "/" + quote(path.lstrip("/\\"), errors="replace")


def check_names(method: str, headers: Headers, scheme: str, hosts: Collection[str]) -> None:
    """Check that a request is meant for this studio and does not come from a foreign page.

    Raises RefusedError for another host or origin, or one of these headers given twice.

    Parameters
    ----------
    method, headers : of the request.
    scheme : ``http`` or ``https``, of our pages.
    hosts : names of the studio, each with its port.
    """
    for name in ("host", "origin", "sec-fetch-site"):
        if len(headers.getlist(name)) > 1:  # which one counts, others may see differently
            raise RefusedError(400, "studio.several_headers", name=name.title())
    if headers.get("host", "") not in hosts:
        raise RefusedError(421, "studio.other_host", host=min(hosts), found=headers.get("host", ""))
    origin = headers.get("origin")
    if origin is not None and origin not in {f"{scheme}://{host}" for host in hosts}:
        raise RefusedError(403, "studio.other_origin", origin=origin)
    site = headers.get("sec-fetch-site", "none")
    if site not in ("none", "same-origin") and not (method == "GET" and headers.get("sec-fetch-mode") == "navigate"):
        raise RefusedError(403, "studio.other_site", site=site)


class CountingReceive:
    """Receives at most so many bytes; RefusedError for more."""

    def __init__(self, receive: Receive, most: int) -> None:
        self._receive, self._left, self._most = receive, most, most

    async def __call__(self) -> Message:
        message = await self._receive()
        if message["type"] == "http.request":
            self._left -= len(message.get("body", b""))
            if self._left < 0:
                raise _too_large(self._most)
        return message


def with_headers(send: Send) -> Send:
    """Add the headers that every answer has."""

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


def check_length(headers: Headers, most: int) -> None:
    """Raise RefusedError for a body that says that it is longer than ``most`` bytes, or says no number."""
    length = headers.get("content-length", "0")
    if not (length.isascii() and length.isdigit()):
        raise RefusedError(400, "studio.content_length", found=length)
    if len(length) > 18 or int(length) > most:
        raise _too_large(most)


def choose_language(scope: Scope, headers: Headers) -> str:
    """Choose the language: of a page by its address, else the last choice, else that of the browser; of the API by
    header."""
    if not scope["path"].startswith("/api/"):
        asked = dict(parse_qsl(scope["query_string"].decode("latin-1")))
        for chosen in (asked.get("lang"), *read_cookies(headers.getlist("cookie"), "dousa_lang")):
            if chosen in LANGUAGES:
                return chosen
    return headers.get("accept-language", "").lower()[:2]


def read_cookies(lines: Iterable[str], name: str) -> list[str]:
    """Return the values of a cookie in the lines of the header."""
    values = []
    for line in lines:
        try:
            cookie = SimpleCookie(line)
        except CookieError:
            continue
        if name in cookie:
            values.append(cookie[name].value)
    return values


async def refuse(error: RefusedError, scope: Scope, receive: Receive, send: Send, *, asks_token: bool = False) -> None:
    """Refuse a request: a page for browsers, with a field that adds the token to its address, and JSON for others."""
    # Further data of strangers is not read.
    headers = {"connection": "close"} if error.status in (401, 403, 421) else None
    if scope["method"] != "GET" or scope["path"].startswith(("/api/", "/static/")):
        await Answer(to_answer(error.message), error.status, headers)(scope, receive, send)
        return
    asked = parse_qsl(scope["query_string"].decode("latin-1"), keep_blank_values=True)
    kept = [(html.escape(name), html.escape(value)) for name, value in asked if name not in ("token", "code")]
    form = _FORM.format(
        action=html.escape(_own_place(scope["path"])),
        rest="".join(f'<input type="hidden" name="{name}" value="{value}">' for name, value in kept),
        field=html.escape(say(_Words("studio.token_field"))),
        go=html.escape(say(_Words("studio.token_go"))),
    )
    text = _CLOSED.format(
        language=get_language(), status=error.status, problem=html.escape(say(error.message)),
        form=form if error.status == 401 and asks_token else "",
    )  # fmt: skip
    await HTMLResponse(text, error.status, headers)(scope, receive, send)


_FORM = """<form action="{action}">{rest}<label style="display:block">{field}<br>
<input name="token" type="password" autocomplete="off" required autofocus
 style="font:inherit;width:100%;box-sizing:border-box;margin:.3rem 0 .8rem;padding:.4rem"></label>
<button style="font:inherit;padding:.4rem 1rem">{go}</button></form>"""
_CLOSED = """<!doctype html><html lang="{language}"><meta charset="utf-8"><title>dousa studio</title>
<meta name="viewport" content="width=device-width"><meta name="color-scheme" content="light dark">
<body style="font:16px/1.6 system-ui,sans-serif;max-width:40rem;margin:15vh auto;padding:0 1.5rem">
<h1 style="font-size:1.4rem">dousa studio <small>({status})</small></h1><p>{problem}</p>{form}</body></html>"""


class Codes:
    """Codes that let a browser in once; safe to be used from any thread."""

    def __init__(self) -> None:
        self._waiting: deque[str] = deque(maxlen=20)  # codes that wait; older ones are dropped
        self._lock = threading.Lock()

    def issue(self) -> str:
        """Make a new code."""
        code = secrets.token_urlsafe(24)
        with self._lock:
            self._waiting.append(code)
        return code

    def redeem(self, text: str) -> bool:
        """Use up a code; returns whether it was valid."""
        given = text.encode("utf-8", "replace")
        with self._lock:
            for code in self._waiting:
                if hmac.compare_digest(code.encode(), given):
                    self._waiting.remove(code)
                    return True
        return False
