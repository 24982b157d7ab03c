"""How a download is named."""

from __future__ import annotations

from urllib.parse import quote

__all__ = ["attachment"]


def attachment(name: str) -> str:
    """The header Content-Disposition for a file: in ASCII for old programs, and as it is (RFC 6266)."""
    kept = "".join(
        character if character.isascii() and (character.isalnum() or character in "._- ") else "_"
        for character in name
    )
    return (
        f"attachment; filename=\"{kept}\"; filename*=UTF-8''{quote(name.encode('utf-8', 'replace'), safe='')}"
    )
