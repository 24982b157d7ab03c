"""The application: guard in front, the interface below /api, the pages, what pages are made of."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING, Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect

import dousa
from dousa.app.studio.answers import Answer
from dousa.app.studio.guard import Guard
from dousa.app.studio.problems import describe_disk, status_of
from dousa.app.studio.studio import Studio
from dousa.errors import DousaError

if TYPE_CHECKING:
    from dousa.app.studio.settings import Settings

__all__ = ["create_app"]

_DESCRIPTION = """Motion retrieval, evaluation and estimation over HTTP, on this machine only. Every request carries
`Authorization: Bearer TOKEN`, the token of the address that `dousa studio` prints. Problems are answered with a status
of 400 or above and `{"problem": "one sentence"}`."""


def create_app(settings: Settings) -> FastAPI:
    """The application of a studio.

    Raises
    ------
    LibraryError, OptionError : library or folder cannot be used.
    """
    from dousa.app.studio import pages
    from dousa.app.studio.api import ROUTERS

    studio = Studio(settings)

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        yield
        studio.close()

    app = FastAPI(
        title="dousa studio",
        version=dousa.__version__,
        description=_DESCRIPTION,
        docs_url=None,  # they would load scripts from elsewhere; the page /api-guide shows the same
        redoc_url=None,
        openapi_url="/api/openapi.json",
        lifespan=lifespan,
        default_response_class=Answer,
        responses={422: {"description": "cannot be used as it is", "content": _PROBLEM_CONTENT}},
    )
    app.state.studio = studio
    for router in ROUTERS:
        app.include_router(router, prefix="/api")
    pages.register(app)
    _answer_problems(app)
    app.add_middleware(Guard, settings=settings)
    return app


_PROBLEM_CONTENT: dict[str, Any] = {
    "application/json": {
        "schema": {"type": "object", "properties": {"problem": {"type": "string"}}, "required": ["problem"]}
    }
}


def _answer_problems(app: FastAPI) -> None:
    @app.exception_handler(DousaError)
    async def tell(request: Request, error: DousaError) -> Answer:
        return Answer({"problem": str(error)}, status_of(error))

    @app.exception_handler(OSError)
    async def tell_disk(request: Request, error: OSError) -> Answer:
        problem = describe_disk(error)
        if problem is None:
            raise error
        return Answer({"problem": problem}, 507)

    @app.exception_handler(ClientDisconnect)
    async def let_go(request: Request, error: ClientDisconnect) -> Answer:
        return Answer({"problem": "the request broke off before its end"}, 400)  # nobody reads it

    @app.exception_handler(RequestValidationError)
    async def explain(request: Request, error: RequestValidationError) -> Answer:
        parts = []
        for item in error.errors():
            where = ".".join(str(step) for step in item["loc"][1:]) or str(item["loc"][0])
            parts.append(f"{where}: {item['msg']}")
        return Answer({"problem": "; ".join(parts)[:2000]}, 422)

    @app.exception_handler(HTTPException)
    async def refuse(request: Request, error: HTTPException) -> Answer:
        return Answer({"problem": f"{error.detail}"}, error.status_code, error.headers)
