"""What a studio is told when it starts."""

from __future__ import annotations

import secrets
from dataclasses import dataclass, field
from pathlib import Path

from dousa.errors import OptionError

__all__ = ["Settings"]

MEGABYTE = 1_000_000


@dataclass(frozen=True, slots=True)
class Settings:
    """A studio and its limits.

    Parameters
    ----------
    library : file of the motion library; made when the first motions are added.
    host, port : where it listens.
    token : the secret in its address; who does not know it gets nothing.
    home : folder for uploads, jobs and their results; ``NAME.studio`` beside the library by default.
    most_bytes : of one uploaded file.
    most_unpacked_bytes : of all files of one zip archive, and of one batch of uploads.
    most_files : of one batch of uploads.

    Raises
    ------
    OptionError : a port outside 0 to 65535, an empty token.
    """

    library: Path
    host: str = "127.0.0.1"
    port: int = 8765
    token: str = field(default_factory=lambda: secrets.token_urlsafe(24))
    home: Path | None = None
    most_bytes: int = 500 * MEGABYTE
    most_unpacked_bytes: int = 4_000 * MEGABYTE
    most_files: int = 20_000

    def __post_init__(self) -> None:
        if not 0 <= self.port <= 65535:
            raise OptionError(f"--port: expected 0 to 65535, got {self.port}")
        if not self.token:
            raise OptionError("the token of a studio must not be empty")

    @property
    def folder(self) -> Path:
        """The folder for everything that the studio writes besides the library."""
        home = self.home or self.library.with_name(f"{self.library.stem}.studio")
        return home.absolute()  # what is read and added is named by whole paths

    @property
    def hosts(self) -> frozenset[str]:
        """What a browser on this machine calls the studio; any other name is somebody else's."""
        return frozenset(f"{name}:{self.port}" for name in {self.host, "127.0.0.1", "localhost", "[::1]"})

    @property
    def address(self) -> str:
        """The address to open, with the token."""
        return f"http://{self.host}:{self.port}/?token={self.token}"
