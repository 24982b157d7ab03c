"""What a studio shows on the network: whether it does, at which address, by which links."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from ipaddress import AddressValueError, IPv4Address
from typing import Any

from dousa.app.studio.core.answers import RefusedError
from dousa.app.studio.core.share_links import ShareLink, ShareLinks
from dousa.app.studio.core.shared_guard import KEY
from dousa.errors import OptionError
from dousa.extras import require


@dataclass(frozen=True, slots=True)
class Door:
    """A server that others on the network reach.

    Parameters
    ----------
    address : without a slash at its end.
    fingerprint : of its certificate.
    shut : ends it.
    """

    address: str
    fingerprint: str
    shut: Callable[[], None]


class Sharing:
    """What is shown on the network; closed until it is opened, and again when that is ended.

    Parameters
    ----------
    open_door : starts the server for some links.

    Every opening has links of its own: those of an earlier one open nothing any more.
    """

    def __init__(self, open_door: Callable[[ShareLinks], Door]) -> None:
        self.links = ShareLinks()
        self._open_door = open_door
        self._door: Door | None = None
        self._lock = threading.Lock()

    @property
    def door(self) -> Door | None:
        """The server; None where nothing is shown."""
        return self._door

    def begin(self) -> Door:
        """Show it; where it is shown already, nothing changes.

        Raises
        ------
        OptionError : the address cannot be used.
        MissingExtraError : the extra ``share`` is not installed.
        """
        with self._lock:
            if self._door is None:
                self.links.clear()
                self._door = self._open_door(self.links)
            return self._door

    def end(self) -> None:
        """Show nothing any more; every link is taken back."""
        with self._lock:
            self.links.clear()
            door, self._door = self._door, None
        if door is not None:
            door.shut()

    def address_of(self, link: ShareLink) -> str:
        """What is opened on a phone.

        Raises
        ------
        RefusedError : nothing is shown now.
        """
        if self._door is None:
            raise RefusedError(409, "studio_share.ended")
        return f"{self._door.address}/?{KEY}={link.token}"


def draw_code(text: str) -> str:
    """A text as a QR code: an SVG as the source of a picture, dark on white with its quiet zone.

    Raises
    ------
    MissingExtraError : the extra ``share`` is not installed.
    """
    return str(_make_code(text).svg_data_uri(scale=4, border=4, dark="#000", light="#fff"))


def print_code(text: str) -> str:
    """The same in half blocks for a terminal, in its own two colours."""
    import io

    out = io.StringIO()
    _make_code(text).terminal(out, compact=True, border=2)
    return out.getvalue()


def _make_code(text: str) -> Any:
    return require("segno", "share").make(text, error="m", micro=False)


def check_address(text: str) -> IPv4Address:
    """An address of this machine in a network of its own.

    Parameters
    ----------
    text : such as 192.168.1.20.

    Raises
    ------
    OptionError : it is none, or the whole internet could come.
    """
    try:
        address = IPv4Address(text)
    except AddressValueError:
        raise OptionError("studio_share.no_address", found=text) from None
    if address.is_unspecified or address.is_multicast:
        raise OptionError("studio_share.no_address", found=text)
    if address.is_global:
        raise OptionError("studio_share.public_address", found=text)
    return address
