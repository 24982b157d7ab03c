"""The shells of the pages, in two languages, and the files they are made of; all of it is ours and on this machine."""

from __future__ import annotations

import hashlib
import json
import mimetypes
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING, Any

from fastapi import APIRouter, FastAPI, Request
from jinja2 import Environment, FunctionLoader, StrictUndefined, select_autoescape
from markupsafe import Markup
from starlette.responses import HTMLResponse, RedirectResponse, Response

import dousa
from dousa.app.player import format_player_data, read_player_script, read_player_style
from dousa.app.report import read_report_script, read_report_style
from dousa.app.studio.problems import RefusedError

if TYPE_CHECKING:
    from importlib.resources.abc import Traversable

__all__ = ["LANGUAGES", "PAGES", "read_words", "register"]

LANGUAGES = ("en", "ja")
PAGES = ("library", "search", "takes", "evaluate", "estimate")
"""Pages with a place in the head of every page; each has a template, words and a script of its name."""

_OTHER_PAGES = ("api",)
_HERE = "dousa.app.studio"
_FOREVER = {"cache-control": "private, max-age=31536000, immutable"}
_FONT = "japanese.ttf"


def register(app: FastAPI) -> None:
    """Hang the pages on the application."""
    router = APIRouter(include_in_schema=False)

    @router.get("/")
    def start() -> Response:
        return RedirectResponse("/library", 303)

    @router.get("/static/{version}/{name:path}")
    def static(version: str, name: str) -> Response:
        known = _load_static()
        if name not in known:
            raise RefusedError(404, f"no file {name[:100]!r} in this studio")
        content, kind = known[name]
        return Response(content, media_type=kind, headers=_FOREVER)

    for page in (*PAGES, *_OTHER_PAGES):
        router.add_api_route(f"/{page}", _make_page(page), methods=["GET"])
    app.include_router(router)


def _make_page(page: str) -> Any:
    def show(request: Request) -> Response:
        language = _choose_language(request)
        words = read_words(page)[language]
        theme = request.cookies.get("dousa_theme")
        text = (
            _environment()
            .get_template(f"{page}.html")
            .render(
                t=words,
                page=page,
                pages=PAGES,
                language=language,
                theme=theme if theme in ("light", "dark") else None,
                version=_version(),
                dousa_version=dousa.__version__,
                library=request.app.state.studio.settings.library.name,
                words_json=Markup(format_player_data(words)),
                **_more(page, request),
            )
        )
        return HTMLResponse(text, headers={"vary": "cookie, accept-language"})

    return show


def _more(page: str, request: Request) -> dict[str, Any]:
    """What only some pages show."""
    if page != "api":
        return {}
    from dousa.app.studio.guide import describe_interface

    return {
        "interface": describe_interface(request.app.openapi()),
        "address": str(request.base_url).rstrip("/"),
    }


def _choose_language(request: Request) -> str:
    chosen = request.query_params.get("lang") or request.cookies.get("dousa_lang")
    if chosen in LANGUAGES:
        return str(chosen)
    wanted = request.headers.get("accept-language", "").lower()
    return "ja" if wanted.startswith("ja") else "en"


@cache
def read_words(page: str) -> Mapping[str, Mapping[str, str]]:
    """All words that a page shows, by language and name."""
    found: dict[str, dict[str, str]] = {language: {} for language in LANGUAGES}
    for room in ("common", page):
        text = (files(_HERE) / "words" / f"{room}.json").read_text(encoding="utf-8")
        for name, pair in json.loads(text).items():
            for language, word in zip(LANGUAGES, pair, strict=True):
                found[language][name] = word
    return found


@cache
def _environment() -> Environment:
    folder = files(_HERE) / "templates"

    def load(name: str) -> str:
        return (folder / name).read_text(encoding="utf-8")

    return Environment(
        loader=FunctionLoader(load),
        autoescape=select_autoescape(default=True),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


@cache
def _load_static() -> Mapping[str, tuple[bytes, str]]:
    """Everything that may be asked for, by name: no request makes a path."""
    known = {
        "player.js": (read_player_script().encode(), "text/javascript"),
        "player.css": (read_player_style().encode(), "text/css"),
        "report.js": (read_report_script().encode(), "text/javascript"),
        "report.css": (read_report_style().encode(), "text/css"),
        _FONT: (_read_font(), "font/ttf"),
    }
    _collect(files(_HERE) / "static", "", known)
    return known


def _collect(folder: Traversable, prefix: str, known: dict[str, tuple[bytes, str]]) -> None:
    for item in folder.iterdir():
        if item.is_dir():
            _collect(item, f"{prefix}{item.name}/", known)
        elif not item.name.startswith("."):
            kind = mimetypes.guess_type(item.name)[0] or "application/octet-stream"
            known[prefix + item.name] = (item.read_bytes(), kind)


def _read_font() -> bytes:
    """A Japanese font for machines that have none; browsers fetch it only when such letters are shown."""
    from dousa.app.report import find_font

    path = find_font()
    return b"" if path is None else path.read_bytes()


@cache
def _version() -> str:
    """Part of the address of every file, so that browsers keep files for ever and still get new ones."""
    digest = hashlib.sha256()
    for name, (content, _) in sorted(_load_static().items()):
        digest.update(name.encode() + content)
    return digest.hexdigest()[:12]
