"""A certificate that the studio signs itself, for the one address at which it is seen on the network.

No authority vouches for an address at home, so browsers warn at the first visit. What is sent is encrypted all the
same; who compares the fingerprint also knows whom they talk to. The certificate is kept, so that a phone that was told
to trust it warns again only if somebody else answers.
"""

from __future__ import annotations

import os
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from ipaddress import IPv4Address
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dousa.app.studio.core.home_lock import open_private
from dousa.extras import require

if TYPE_CHECKING:
    from cryptography.x509 import Certificate as _Signed

_FILE = "share.pem"
_DAYS, _SPARE_DAYS = 365, 7  # phones take none that hold longer than 398 days


@dataclass(frozen=True, slots=True)
class Certificate:
    """A key with its certificate.

    Parameters
    ----------
    path : file of both; this user alone can read it.
    fingerprint : SHA-256 of the certificate, as browsers show it.
    """

    path: Path
    fingerprint: str


def provide_certificate(home: Path, address: IPv4Address) -> Certificate:
    """The certificate of a studio for an address: the one it has, or a new one.

    Parameters
    ----------
    home : folder of the studio.
    address : of this machine.

    Raises
    ------
    MissingExtraError : the extra ``share`` is not installed.
    OSError : the folder cannot be written.
    """
    require("cryptography", "share")
    path = home / _FILE
    signed = _read(path, address)
    if signed is None:
        signed = _make(path, address)
    return Certificate(path, _fingerprint(signed))


def _read(path: Path, address: IPv4Address) -> _Signed | None:
    """The certificate that is kept, if it is of this address and holds for some time."""
    from cryptography import x509
    from cryptography.hazmat.primitives.serialization import load_pem_private_key

    with suppress(OSError, ValueError, TypeError, x509.ExtensionNotFound):
        content = path.read_bytes()
        signed = x509.load_pem_x509_certificate(content)
        names = signed.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        holds = signed.not_valid_after_utc - datetime.now(UTC) > timedelta(days=_SPARE_DAYS)
        key = load_pem_private_key(content, None)
        if holds and key.public_key() == signed.public_key() and address in names.get_values_for_type(x509.IPAddress):
            os.chmod(path, 0o600)
            return signed
    return None


def _make(path: Path, address: IPv4Address) -> _Signed:
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec
    from cryptography.x509.oid import ExtendedKeyUsageOID

    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, f"dousa studio {address}")])
    now = datetime.now(UTC)
    plan: Any = x509.CertificateBuilder().subject_name(name).issuer_name(name).public_key(key.public_key())
    plan = plan.serial_number(x509.random_serial_number())
    plan = plan.not_valid_before(now - timedelta(days=1)).not_valid_after(now + timedelta(days=_DAYS))
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
