"""Share reports and library on the local network: the address, the links, and a certificate that the studio signs.

Each link has its own secret and can be revoked alone. No authority vouches for an address at home, so browsers warn at
the first visit. The connection is encrypted nevertheless, and the fingerprint can be compared. The certificate is kept,
so that a phone which trusts it warns again only if another machine answers.
"""

from __future__ import annotations

import hmac
import os
import secrets
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from ipaddress import AddressValueError, IPv4Address
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dousa.app.studio.core.answers import RefusedError
from dousa.app.studio.core.workspace import open_private
from dousa.errors import OptionError
from dousa.extras import require

if TYPE_CHECKING:
    from cryptography.x509 import Certificate as _Signed


KEY = "key"
"""The name of the secret of a link in its address."""


@dataclass(frozen=True, slots=True)
class ShareLink:
    """One link.

    Parameters
    ----------
    report : job of the one evaluation that it shows; None for all and the library, unless it has an inbox.
    inbox : batch of the films and motions that come by it, which is then all that it shows; None if it takes none.
    number : names the link when it is revoked.
    token : the secret in its address.
    created_s : Unix time.
    """

    report: str | None = None
    inbox: str | None = None
    number: str = field(default_factory=lambda: secrets.token_hex(4))
    token: str = field(default_factory=lambda: secrets.token_urlsafe(24), repr=False)
    created_s: float = field(default_factory=time.time)

    @property
    def shows_everything(self) -> bool:
        """Whether it shows all evaluations and the library."""
        return self.report is None and self.inbox is None

    def shows(self, report: str) -> bool:
        """Whether it shows an evaluation."""
        return self.shows_everything or self.report == report

    @property
    def page(self) -> str:
        """The page that it leads to."""
        return "/film" if self.inbox else "/" if self.report is None else f"/report?job={self.report}"


class ShareLinks:
    """The valid links; safe to be used from any thread."""

    def __init__(self) -> None:
        self._links: list[ShareLink] = []
        self._lock = threading.Lock()

    def add(self, report: str | None, inbox: str | None = None, *, most_links: int = 200) -> ShareLink:
        """Return the link to one evaluation, to everything or into an inbox, made if missing.

        Raises RefusedError if there are too many.
        """
        with self._lock:
            for link in self._links:
                if (link.report, link.inbox) == (report, inbox):
                    return link
            if len(self._links) >= most_links:
                raise RefusedError(409, "studio_share.many_links", most=most_links)
            self._links.append(ShareLink(report, inbox))
            return self._links[-1]

    def find(self, token: str) -> ShareLink | None:
        """Find the link with a secret; all are compared, so that the time reveals nothing."""
        given, found = token.encode("utf-8", "replace"), None
        with self._lock:
            for link in self._links:
                if hmac.compare_digest(link.token.encode(), given):
                    found = link
        return found

    def revoke(self, number: str) -> None:
        """Revoke a link; RefusedError if there is none of this number."""
        with self._lock:
            kept = [link for link in self._links if link.number != number]
            if len(kept) == len(self._links):
                raise RefusedError(404, "studio_share.no_link", number=number[:20])
            self._links = kept

    def clear(self) -> None:
        """Revoke all links."""
        with self._lock:
            self._links = []

    def all(self) -> list[ShareLink]:
        """List the valid links, the oldest first."""
        with self._lock:
            return list(self._links)


@dataclass(frozen=True, slots=True)
class SharedServer:
    """A running server for the network: its address without a slash at the end, its fingerprint, and how to stop it."""

    address: str
    fingerprint: str
    stop: Callable[[], None]


class Sharing:
    """Starts and stops a server for the network; links are valid until it stops.

    Parameters
    ----------
    start : starts the server for some links.
    takes_films : links can let others film and upload into an inbox.
    """

    def __init__(self, start: Callable[[ShareLinks], SharedServer], *, takes_films: bool = False) -> None:
        self.links = ShareLinks()
        self.takes_films = takes_films
        self._start = start
        self._server: SharedServer | None = None
        self._lock = threading.Lock()

    @property
    def server(self) -> SharedServer | None:
        """The server; None if nothing is shared."""
        return self._server

    def begin(self) -> SharedServer:
        """Start to share; OptionError if the address cannot be used, MissingExtraError without the extra ``share``."""
        with self._lock:
            if self._server is None:
                self.links.clear()
                self._server = self._start(self.links)
            return self._server

    def end(self) -> None:
        """Stop to share and revoke all links."""
        with self._lock:
            self.links.clear()
            server, self._server = self._server, None
        if server is not None:
            server.stop()

    def address_of(self, link: ShareLink) -> str:
        """Return the address of a link; RefusedError if nothing is shared."""
        if self._server is None:
            raise RefusedError(409, "studio_share.ended")
        return f"{self._server.address}/?{KEY}={link.token}"


def draw_code(text: str) -> str:
    """Draw a text as a QR code, a data URL of an SVG; MissingExtraError without the extra ``share``."""
    return str(_make_code(text).svg_data_uri(scale=4, border=4, dark="#000", light="#fff"))


def print_code(text: str) -> str:
    """Draw a text as a QR code of half blocks for a terminal."""
    import io

    out = io.StringIO()
    _make_code(text).terminal(out, compact=True, border=2)
    return out.getvalue()


def _make_code(text: str) -> Any:
    return require("segno", "share").make(text, error="m", micro=False)


def check_address(text: str) -> IPv4Address:
    """Parse an address such as 192.168.1.20; OptionError if it is none, or reachable from the internet."""
    try:
        address = IPv4Address(text)
    except AddressValueError:
        raise OptionError("studio_share.no_address", found=text) from None
    if address.is_unspecified or address.is_multicast:
        raise OptionError("studio_share.no_address", found=text)
    if address.is_global:
        raise OptionError("studio_share.public_address", found=text)
    return address


_CERTIFICATE = "share.pem"


@dataclass(frozen=True, slots=True)
class Certificate:
    """A file with a key and its certificate, and the SHA-256 fingerprint as browsers show it."""

    path: Path
    fingerprint: str


def provide_certificate(home: Path, address: IPv4Address) -> Certificate:
    """Return the certificate for an address from the folder of a studio, made if missing or expired.

    Raises MissingExtraError without the extra ``share``, OSError if the folder cannot be written.
    """
    require("cryptography", "share")
    path = home / _CERTIFICATE
    signed = _read_certificate(path, address)
    if signed is None:
        signed = _make_certificate(path, address)
    return Certificate(path, _fingerprint(signed))


def _read_certificate(path: Path, address: IPv4Address) -> _Signed | None:
    from cryptography import x509
    from cryptography.hazmat.primitives.serialization import load_pem_private_key

    with suppress(OSError, ValueError, TypeError, x509.ExtensionNotFound):
        content = path.read_bytes()
        signed = x509.load_pem_x509_certificate(content)
        names = signed.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        holds = signed.not_valid_after_utc - datetime.now(UTC) > timedelta(days=7)
        key = load_pem_private_key(content, None)
        if holds and key.public_key() == signed.public_key() and address in names.get_values_for_type(x509.IPAddress):
            os.chmod(path, 0o600)
            return signed
    return None


def _make_certificate(path: Path, address: IPv4Address) -> _Signed:
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec
    from cryptography.x509.oid import ExtendedKeyUsageOID

    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, f"dousa studio {address}")])
    now = datetime.now(UTC)
    plan: Any = x509.CertificateBuilder().subject_name(name).issuer_name(name).public_key(key.public_key())
    plan = plan.serial_number(x509.random_serial_number())
    # phones accept none that are valid for more than 398 days
    plan = plan.not_valid_before(now - timedelta(days=1)).not_valid_after(now + timedelta(days=365))
    plan = plan.add_extension(x509.SubjectAlternativeName([x509.IPAddress(address)]), critical=False)
    plan = plan.add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
    plan = plan.add_extension(x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH]), critical=False)
    signed: _Signed = plan.sign(key, hashes.SHA256())
    secret = key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    temporary = path.with_name(f".{path.name}")
    with open_private(temporary) as file:
        file.truncate(0)
        file.write(secret + signed.public_bytes(serialization.Encoding.PEM))
    os.replace(temporary, path)
    return signed


def _fingerprint(signed: _Signed) -> str:
    from cryptography.hazmat.primitives import hashes

    return ":".join(f"{value:02X}" for value in signed.fingerprint(hashes.SHA256()))
