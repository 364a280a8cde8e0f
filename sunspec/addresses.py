"""Addresses of real inverters."""

from __future__ import annotations

from contextlib import suppress
from urllib.parse import urlsplit

from bus_schemas.errors import InputError


def parse_address(address: str, where: str) -> tuple[str, int, int]:
    """Return host, port and unit of an address such as `modbus://10.0.0.7:502/1`."""
    with suppress(ValueError):
        parts = urlsplit(address)
        unit = int(parts.path.strip("/") or 1)
        port = 502 if parts.port is None else parts.port
        if parts.scheme == "modbus" and parts.hostname and port and 1 <= unit <= 247:
            return parts.hostname, port, unit
    expected = "an address such as modbus://10.0.0.7:502/1 (host, port, unit 1 to 247)"
    raise InputError.of(where, f"expected {expected}, got {address}")
