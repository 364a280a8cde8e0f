"""The keys of a plant: a certificate authority of its own, and a certificate for each agent.

The common name of a certificate is the agent that it is for, and its organization the plant.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
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
    ignored = folder / ".gitignore"
    if not ignored.exists():  # `git add .` must not publish them.
        ignored.write_text("*\n", encoding="ascii")
    there = [name for name in ("ca.key", "ca.pem") if (folder / name).exists()]
    if len(there) == 1:
        raise InputError(
            f"{folder}: expected both ca.key and ca.pem, got {there[0]} alone; bring the other one "
            "back, or name a new folder with --out"
        )
    if not there:
        expires = datetime.now(UTC) + timedelta(days=_AUTHORITY_DAYS)
        own = _new_key(folder / "ca.key")
        _write(folder / "ca.pem", _certificate(plant, plant[:64], own, expires))
    authority = _authority(folder, plant)
    issuer = authority, _read_key(folder / "ca.key")
    expires = min(datetime.now(UTC) + timedelta(days=days), authority.not_valid_after_utc)
    for agent in agents:
        files = KeyFiles.of(folder, agent)
        is_new = not there or not files.key.exists()
        own = _new_key(files.key) if is_new else _read_key(files.key)
        certificate = _certificate(plant, common_name(agent), own, expires, issuer, names)
        _write(files.certificate, certificate)
    return expires, not there


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
    path = files.certificate
    certificate = _read(path)
    try:
        certificate.verify_directly_issued_by(authority)
    except (ValueError, TypeError, InvalidSignature):
        raise InputError(
            f"{path}: expected a certificate by {files.authority}, got one of another plant"
        ) from None
    if _name(certificate) != common_name(agent):
        raise InputError(f"{path}: expected a certificate for {agent}, got {_name(certificate)}")
    is_valid = certificate.not_valid_before_utc <= datetime.now(UTC)
    if not is_valid or ends > certificate.not_valid_after_utc:
        raise InputError(
            f"{path}: expected a certificate that is valid up to the end of the run, got one from "
            f"{certificate.not_valid_before_utc:%Y-%m-%d %H:%M} to "
            f"{certificate.not_valid_after_utc:%Y-%m-%d %H:%M} UTC; `heliarch keys` renews it"
        )
    names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    if ip_address(address) not in names.get_values_for_type(x509.IPAddress):
        raise InputError(
            f"{path}: expected a certificate for the address {address}; `heliarch keys --address "
            f"{address}` makes one"
        )
    if _read_key(files.key).public_key() != certificate.public_key():
        raise InputError(f"{files.key}: expected the key of {path}, got another one")


def _read(path: Path) -> x509.Certificate:
    try:
        return x509.load_pem_x509_certificate(path.read_bytes())
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; `heliarch keys` makes it") from None
    except ValueError:
        raise InputError(f"{path}: expected a certificate in PEM") from None


def _authority(folder: Path, plant: str) -> x509.Certificate:
    """Read the certificate of a plant's authority."""
    path = folder / "ca.pem"
    authority = _read(path)
    if _name(authority) != plant[:64]:
        raise InputError(
            f"{path}: expected the certificate authority of {plant}, got that of {_name(authority)}"
        )
    return authority


def _name(certificate: x509.Certificate) -> str:
    found = certificate.subject.get_attributes_for_oid(x509.oid.NameOID.COMMON_NAME)
    return str(found[0].value) if found else ""


def _read_key(path: Path) -> ec.EllipticCurvePrivateKey:
    if not path.exists():
        raise InputError(f"{path}: no such file, expected a private key")
    if path.stat().st_mode & 0o077:
        raise InputError(f"{path}: expected a key that its owner alone can read (mode 600)")
    try:
        key = load_pem_private_key(path.read_bytes(), password=None)
    except ValueError:
        key = None
    if not isinstance(key, ec.EllipticCurvePrivateKey):
        raise InputError(f"{path}: expected a key that `heliarch keys` has made")
    return key


def _new_key(path: Path) -> ec.EllipticCurvePrivateKey:
    key = ec.generate_private_key(ec.SECP256R1())
    with whole_file(path, mode=0o600) as file:
        file.write(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    return key


def _certificate(
    plant: str,
    name: str,
    key: ec.EllipticCurvePrivateKey,
    expires: datetime,
    issuer: tuple[x509.Certificate, ec.EllipticCurvePrivateKey] | None = None,
    addresses: x509.SubjectAlternativeName | None = None,
) -> x509.Certificate:
    """Return a certificate; without an issuer that of an authority, signed by itself."""
    subject = x509.Name(
        [
            x509.NameAttribute(x509.oid.NameOID.ORGANIZATION_NAME, plant[:64]),
            x509.NameAttribute(x509.oid.NameOID.COMMON_NAME, name),
        ]
    )
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
    return builder.sign(key if issuer is None else issuer[1], hashes.SHA256())


def _write(path: Path, certificate: x509.Certificate) -> None:
    with whole_file(path) as file:
        file.write(certificate.public_bytes(Encoding.PEM))
