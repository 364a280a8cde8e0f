"""The keys of a plant: a certificate authority of its own, and a certificate for each agent.

The common name of a certificate is the agent that it is for, and its organization the plant.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from ipaddress import ip_address
from pathlib import Path
from typing import Final

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    load_pem_private_key,
)

from agents.plan import RunPlan
from agents.process.session import common_name
from bus_schemas.errors import InputError
from bus_schemas.whole_file import whole_file
from bus_schemas.zenoh_session import KeyFiles
from scenarios.elsewhere import read_address

_AUTHORITY_DAYS: Final = 3650
_BEFORE: Final = timedelta(hours=1)
"""Certificates hold from a little before now on: clocks of hosts differ."""


def make_keys(
    folder: Path, plant: str, agents: Iterable[str], days: float, addresses: Iterable[str]
) -> tuple[datetime, bool]:
    """Make a certificate for each agent, and the authority that signs them if there is none yet.

    Returns until when they hold, and whether the authority is new. Private keys by the authority
    there stay: a process that starts in between finds a pair that matches, and a device needs
    nothing but its new certificate.
    """
    hosts = (x509.IPAddress(read_address(address)) for address in ("127.0.0.1", *addresses))
    names = x509.SubjectAlternativeName(hosts)
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    # `git add .` must not publish them.
    (folder / ".gitignore").write_text("*\n", encoding="ascii")
    is_new = not any((folder / name).exists() for name in ("ca.key", "ca.pem"))
    if is_new:
        expires = datetime.now(UTC) + timedelta(days=_AUTHORITY_DAYS)
        own = _new_key(folder / "ca.key")
        _write_certificate(folder / "ca.pem", plant, plant[:64], own, expires)
    authority = _authority(folder, plant)
    issuer = authority, _read_key(folder / "ca.key")
    expires = min(datetime.now(UTC) + timedelta(days=days), authority.not_valid_after_utc)
    for agent in agents:
        files = KeyFiles.of(folder, agent)
        own = _new_key(files.key) if is_new or not files.key.exists() else _read_key(files.key)
        name = common_name(agent)
        _write_certificate(files.certificate, plant, name, own, expires, issuer, names)
    return expires, is_new


def check_keys(plan: RunPlan, agents: Sequence[str] = ()) -> None:
    """Refuse keys with which Zenoh would not open the links of a run; `agents`: those here."""
    folder = Path(plan.access.keys_folder)
    authority = _authority(folder, plan.plant)
    # Links close when a certificate expires. The duration of a lockstep run is unknown.
    ends = datetime.now(UTC) + timedelta(
        seconds=plan.timing.cycles * plan.timing.cycle_wall_ns / 1e9
    )
    for agent in agents or plan.agents:
        files = KeyFiles.of(folder, agent)
        # The key of an agent elsewhere may be there alone.
        if agents or agent not in plan.elsewhere or files.key.exists():
            address = plan.access.addresses.get(agent, plan.access.address)
            _check(files, agent, authority, address, ends)


def _check(
    files: KeyFiles, agent: str, authority: x509.Certificate, address: str, ends: datetime
) -> None:
    """Refuse a certificate with which Zenoh would not open a link, and would not say why."""
    found = _read_certificate(files.certificate)
    first, last = found.not_valid_before_utc, found.not_valid_after_utc
    names = found.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    for is_right, expected in (
        (_is_by(authority, found), f"by {files.authority}, got one of another plant"),
        (_name(found) == common_name(agent), f"for {agent}, got one for {_name(found)}"),
        (
            first <= datetime.now(UTC) and ends <= last,
            f"that is valid up to the end of the run, got {first:%Y-%m-%d %H:%M} to "
            f"{last:%Y-%m-%d %H:%M} UTC; `heliarch keys` renews it",
        ),
        (
            ip_address(address) in names.get_values_for_type(x509.IPAddress),
            f"for the address {address}; `heliarch keys --address {address}` makes it",
        ),
    ):
        if not is_right:
            raise InputError(f"{files.certificate}: expected a certificate {expected}")
    if _read_key(files.key).public_key() != found.public_key():
        raise InputError(f"{files.key}: expected the key of {files.certificate}, got another one")


def _is_by(authority: x509.Certificate, certificate: x509.Certificate) -> bool:
    try:
        certificate.verify_directly_issued_by(authority)
    except (ValueError, TypeError, InvalidSignature):
        return False
    return True


def _authority(folder: Path, plant: str) -> x509.Certificate:
    path = folder / "ca.pem"
    authority = _read_certificate(path)
    if _name(authority) != plant[:64]:
        expected = f"the certificate authority of {plant}, got that of {_name(authority)}"
        raise InputError(f"{path}: expected {expected}")
    return authority


def _name(certificate: x509.Certificate) -> str:
    found = certificate.subject.get_attributes_for_oid(x509.oid.NameOID.COMMON_NAME)
    return str(found[0].value) if found else ""


def _read_certificate(path: Path) -> x509.Certificate:
    content = _read(path)
    try:
        return x509.load_pem_x509_certificate(content)
    except ValueError:
        raise InputError(f"{path}: expected a certificate in PEM") from None


def _read_key(path: Path) -> ec.EllipticCurvePrivateKey:
    content, key = _read(path), None
    with suppress(ValueError, TypeError):
        key = load_pem_private_key(content, password=None)
    if not isinstance(key, ec.EllipticCurvePrivateKey) or path.stat().st_mode & 0o077:
        what = "a key that `heliarch keys` has made, and that its owner alone can read (mode 600)"
        raise InputError(f"{path}: expected {what}")
    return key


def _read(path: Path) -> bytes:
    if not path.exists():
        raise InputError(f"{path}: no such file; `heliarch keys` makes certificates and keys")
    return path.read_bytes()


def _new_key(path: Path) -> ec.EllipticCurvePrivateKey:
    key = ec.generate_private_key(ec.SECP256R1())
    with whole_file(path, mode=0o600) as file:
        file.write(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    return key


def _write_certificate(
    path: Path,
    plant: str,
    name: str,
    key: ec.EllipticCurvePrivateKey,
    expires: datetime,
    issuer: tuple[x509.Certificate, ec.EllipticCurvePrivateKey] | None = None,
    addresses: x509.SubjectAlternativeName | None = None,
) -> None:
    """Write a certificate; without an issuer that of an authority, signed by itself."""
    oid = x509.oid.NameOID
    words = (oid.ORGANIZATION_NAME, plant[:64]), (oid.COMMON_NAME, name)
    subject = x509.Name([x509.NameAttribute(*word) for word in words])
    builder = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(subject if issuer is None else issuer[0].subject)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(datetime.now(UTC) - _BEFORE)
        .not_valid_after(expires)
        .add_extension(x509.BasicConstraints(ca=issuer is None, path_length=None), critical=True)
    )
    if addresses is not None:
        builder = builder.add_extension(addresses, critical=False)
    certificate = builder.sign(key if issuer is None else issuer[1], hashes.SHA256())
    with whole_file(path) as file:
        file.write(certificate.public_bytes(Encoding.PEM))
