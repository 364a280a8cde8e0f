"""The gateway's process beside a run, started by `GatewayProcess`."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import msgspec

from agents.plan import RunPlan
from sunspec.process import Connected, Event, Refused


def _tell(event: Event) -> None:
    os.write(1, msgspec.json.encode(event) + b"\n")


def main() -> None:
    """Connect to the inverters of a plan, then serve the run in a folder until the input ends."""
    plan = msgspec.json.decode(sys.stdin.buffer.readline(), type=RunPlan)
    try:
        from sunspec.client import DeviceError  # noqa: PLC0415 - the extra may not be installed
        from sunspec.gateway import Gateway  # noqa: PLC0415
    except ModuleNotFoundError as error:
        _tell(Refused(f"devices: {error.name} is not installed: pip install 'heliarch[modbus]'"))
        return
    try:
        gateway = Gateway(plan, _tell)
    except DeviceError as error:
        _tell(Refused(str(error)))
        return
    _tell(Connected())
    if folder := sys.stdin.buffer.readline():
        gateway.serve(Path(os.fsdecode(folder.rstrip(b"\n"))), sys.stdin.fileno())


if __name__ == "__main__":
    main()
