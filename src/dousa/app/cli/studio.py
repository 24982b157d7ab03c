"""The command that opens the studio."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dousa.errors import OptionError

if TYPE_CHECKING:
    from rich.console import Console


def studio(
    library: Annotated[
        Path, typer.Argument(metavar="[LIB]", help="The motion library; created if it does not exist.")
    ] = Path("motions.dousa"),
    port: Annotated[
        int,
        typer.Option("--port", min=0, max=65535, help="Port to listen on; the next free one if it is in use."),
    ] = 8765,
    home: Annotated[
        Path | None,
        typer.Option("--home", metavar="DIR", help="Folder for uploads and results. Default: NAME.studio next to LIB."),
    ] = None,
    watch: Annotated[
        Path | None,
        typer.Option("--watch", metavar="DIR", help="Add what appears in this folder, while the studio runs."),
    ] = None,
    share: Annotated[
        bool,
        typer.Option("--share", help="Let others on the local network look at reports and library, by a link."),
    ] = False,
    share_on: Annotated[
        str | None,
        typer.Option(
            "--share-on", metavar="ADDRESS", help="Share at this address of this machine, if it has several networks."
        ),
    ] = None,
    share_films: Annotated[
        bool,
        typer.Option(
            "--share-films", help="With --share: links that you make for it let others film or upload, into an inbox."
        ),
    ] = False,
    vmc: Annotated[
        str, typer.Option("--vmc", metavar="HOST:PORT", help="Send what the page Live sees to an avatar (VMC).")
    ] = "",
    no_browser: Annotated[
        bool, typer.Option("--no-browser", help="Only print the address; do not open a browser.")
    ] = False,
) -> None:
    """Open the studio: library, search, takes, evaluation and estimation in the browser of this machine.

    The page and its interface for programs listen on 127.0.0.1 only, behind the printed address and token. If a studio
    of this library runs already, that one is opened. Needs: pip install 'dousa\\[studio]'

    With --share others on the same network open a link, on a phone by its QR code: they see all reports and the clips
    of the library, over https, and can change nothing. With --share-films you can also make links at which one films
    with a phone, or uploads, and sees nothing else. Needs: pip install 'dousa\\[share]'

    Example: dousa studio moves.dousa

    Example: dousa studio moves.dousa --watch recordings

    Example: dousa studio moves.dousa --share
    """
    from dousa.app.studio import Settings, find_share_address, serve

    shared = find_share_address(share_on) if share or share_films or share_on is not None else None
    settings = Settings(library, port=port, home=home, vmc=vmc)
    serve(settings, opens_browser=not no_browser, watched=watch, shared=shared, takes_films=share_films)


def prepare_studio(output: Path) -> Path:
    """Add the uncut recordings of the demonstration to its library, as takes, and return its path.

    Raises
    ------
    OptionError : the demonstration was not run into this folder.
    """
    from dousa.app.demo import LIBRARY
    from dousa.library import Library

    path = output / LIBRARY
    if not path.is_file():
        raise OptionError("demo.no_library", path=path, output=output)
    names = ("take.bvh", "dance_reference.bvh", "dance_pupil.bvh", "teacher_*.bvh")
    takes = sorted(found for name in names for found in output.glob(name))
    with Library.open(path) as library:
        library.add(takes, kind="take")
    return path


def open_demo_studio(console: Console, output: Path) -> None:
    """Open the studio on the demo library, until Ctrl-C.

    Raises
    ------
    OptionError : the demonstration was not run into this folder, or no port is free.
    MissingExtraError : the studio is not installed.
    """
    from dousa.app.studio import Settings, serve

    library = prepare_studio(output)
    seen = output / "seen.npz"
    if seen.is_file():
        console.print(f"silhouettes for the page Estimate: {seen}", markup=False, soft_wrap=True)
    serve(Settings(library))
