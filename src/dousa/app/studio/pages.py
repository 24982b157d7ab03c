"""The shells of the pages in two languages, and the files they load, all from this machine."""

from __future__ import annotations

import hashlib
import json
import mimetypes
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from importlib.resources.abc import Traversable
from typing import Any

from fastapi import APIRouter, FastAPI, Request
from jinja2 import Environment, FunctionLoader, StrictUndefined, select_autoescape
from markupsafe import Markup
from starlette.responses import HTMLResponse, RedirectResponse, Response
from starlette.routing import NoMatchFound

import dousa
from dousa.app.player.data import format_player_data, read_player_script, read_player_style, read_script_part
from dousa.app.report.page import read_report_script, read_report_style
from dousa.app.studio.core.answers import Answer, RefusedError
from dousa.extras import find_font
from dousa.messages import LANGUAGES, get_language

PAGES = ("library", "search", "takes", "evaluate", "estimate", "live")
"""Pages with a place in the head of every page; each has a template, words and a script of its name."""

_OTHER_PAGES = ("api",)
_MISSING = "missing"
_NO_PAGES = ("/api/", "/static/")  # below these programs ask, which are answered in JSON
_HERE = "dousa.app.studio"
_FOREVER = {"cache-control": "private, max-age=31536000, immutable"}
_FONT = "japanese.ttf"


def register(app: FastAPI) -> None:
    """Register the pages."""
    router = APIRouter(include_in_schema=False)

    @router.get("/")
    def start() -> Response:
        return RedirectResponse("/library", 303)

    @router.post("/code")
    def issue_code(request: Request) -> Answer:
        """What opens the pages once; asked for by a second start, which shows this studio instead."""
        return Answer({"code": request.app.state.codes.issue()})

    router.add_api_route("/static/{version}/{name:path}", _give_static, methods=["GET"])
    for page in (*PAGES, *_OTHER_PAGES):
        router.add_api_route(f"/{page}", _make_page(page), methods=["GET"])
    app.include_router(router)


def register_shared(app: FastAPI) -> None:
    """Register the three pages that others on the network see."""
    router = APIRouter(include_in_schema=False)
    router.add_api_route("/static/{version}/{name:path}", _give_static, methods=["GET"])
    for address in ("/", "/report", "/film"):
        router.add_api_route(address, _make_page("shared"), methods=["GET"])
    app.include_router(router)


def make_addresses(app: FastAPI) -> None:
    """Make all addresses of an application now: the first request would otherwise do it, beside threads that switch
    warnings of the whole process on and off, and wait for it."""
    with suppress(NoMatchFound):
        app.url_path_for("")  # looks through all of them


def show_missing(request: Request) -> Response | None:
    """Return the page for an unknown address, with a way back; None for requests of programs."""
    if request.method not in ("GET", "HEAD") or request.url.path.startswith(_NO_PAGES):
        return None
    answer: Response = _make_page(_MISSING)(request)
    answer.status_code = 404
    return answer


def _give_static(version: str, name: str) -> Response:
    known = _load_static()
    if name not in known:
        raise RefusedError(404, "studio.no_static", name=name[:100])
    content, kind = known[name]
    return Response(content, media_type=kind, headers=_FOREVER)


def _make_page(page: str) -> Any:
    def show(request: Request) -> Response:
        language = get_language()
        words = read_words(page)[language]
        theme = request.cookies.get("dousa_theme")
        sharing = request.app.state.studio.sharing
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
                shares=sharing is not None,
                shares_now=sharing is not None and sharing.server is not None,
                words_json=Markup(format_player_data(words)),
                **_more(page, request),
            )
        )
        return HTMLResponse(text, headers={"vary": "cookie, accept-language"})

    return show


def _more(page: str, request: Request) -> dict[str, Any]:
    """Return the values of the templates of single pages."""
    if page == _MISSING:
        return {"asked": request.url.path[:200]}
    if page != "api":
        return {}

    return {
        "interface": describe_interface(request.app.openapi()),
        "address": str(request.base_url).rstrip("/"),
    }


@cache
def read_words(page: str) -> Mapping[str, Mapping[str, str]]:
    """Read all words of a page, by language and name."""
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
    """Load all files by name; no request makes a path."""
    known = {
        "player.js": (read_player_script().encode(), "text/javascript"),
        "core/theme.js": (
            f"{read_script_part('theme.js')}export {{ onTheme, watchHands }};\n".encode(),
            "text/javascript",
        ),
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
    """Read a Japanese font for machines that have none; browsers fetch it only when it is needed."""
    path = find_font()
    return b"" if path is None else path.read_bytes()


@cache
def _version() -> str:
    """Return a part of the address of files that changes with them, so that browsers can cache them forever."""
    digest = hashlib.sha256()
    for name, (content, _) in sorted(_load_static().items()):
        digest.update(name.encode() + content)
    return digest.hexdigest()[:12]


@dataclass(frozen=True, slots=True)
class Operation:
    """One address of the interface.

    Parameters
    ----------
    tag, method, path, summary, description : of OpenAPI.
    fields : (name, type, whether required, description) of query and body.
    """

    tag: str
    method: str
    path: str
    summary: str
    description: str
    fields: tuple[tuple[str, str, bool, str], ...]


def describe_interface(openapi: Mapping[str, Any]) -> dict[str, list[Operation]]:
    """List all operations of an OpenAPI description by topic."""
    schemas = openapi.get("components", {}).get("schemas", {})
    found: dict[str, list[Operation]] = {}
    for path, methods in openapi["paths"].items():
        for method, said in methods.items():
            operation = _describe(path, method.upper(), said, schemas)
            found.setdefault(operation.tag, []).append(operation)
    return found


def _describe(path: str, method: str, said: Mapping[str, Any], schemas: Mapping[str, Any]) -> Operation:
    fields = [
        (one["name"], _type(one["schema"]), bool(one.get("required")), _words(one, one["schema"]))
        for one in said.get("parameters", ())
    ]
    content = said.get("requestBody", {}).get("content", {})
    body = content.get("application/json", {}).get("schema", {})
    schema = schemas[body["$ref"].rpartition("/")[2]] if "$ref" in body else body
    needed = schema.get("required", ())
    fields += [(name, _type(one), name in needed, _words(one)) for name, one in schema.get("properties", {}).items()]
    return Operation(
        tag=(said.get("tags") or ["general"])[0],
        method=method,
        path=path,
        summary=said.get("summary", ""),
        description=said.get("description", ""),
        fields=tuple(fields),
    )


def _type(schema: Mapping[str, Any]) -> str:
    if "$ref" in schema:
        return str(schema["$ref"].rpartition("/")[2])
    if "enum" in schema or "const" in schema:
        return " | ".join(str(value) for value in schema.get("enum", [schema.get("const")]))
    if "anyOf" in schema:
        return " | ".join(_type(one) for one in schema["anyOf"])
    if schema.get("type") == "array":
        return f"list of {_type(schema.get('items', {}))}"
    return str(schema.get("type", "any"))


def _words(*places: Mapping[str, Any]) -> str:
    return next((str(place["description"]) for place in places if place.get("description")), "")
