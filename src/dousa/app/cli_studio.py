"""The command that opens the studio."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

__all__ = ["register", "studio"]


def register(app: typer.Typer) -> None:
    """Hang this module's command on the application."""
    app.command(rich_help_panel="Studio")(studio)


def studio(
    library: Annotated[
        Path, typer.Argument(metavar="[LIB]", help="The motion library; made if it is not there.")
    ] = Path("motions.dousa"),
    port: Annotated[
        int,
        typer.Option("--port", min=0, max=65535, help="Where to listen; the next free one if it is taken."),
    ] = 8765,
    home: Annotated[
        Path | None,
        typer.Option(
            "--home", metavar="DIR", help="Folder for uploads and results. Default: NAME.studio beside LIB."
        ),
    ] = None,
    max_upload: Annotated[
        int,
        typer.Option("--max-upload", min=1, max=100_000, metavar="MB", help="Largest file that is taken."),
    ] = 500,
    no_browser: Annotated[
        bool, typer.Option("--no-browser", help="Only print the address; do not open a browser.")
    ] = False,
) -> None:
    """Open the studio: library, search, takes, evaluation and estimation in the browser of this machine.

    The page and its interface for programs listen on 127.0.0.1 only, behind a token that is part of the printed
    address. Needs: pip install 'dousa[studio]'

    Example: dousa studio moves.dousa
    """
    from dousa.app.studio import Settings, serve

    settings = Settings(library, port=port, home=home, most_bytes=max_upload * 1_000_000)
    serve(settings, opens_browser=not no_browser)
