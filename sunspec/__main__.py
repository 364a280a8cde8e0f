"""The gateway's process beside a run, started by `GatewayProcess`."""

from __future__ import annotations

import logging
import os
import sys
from pathlib import Path

import msgspec

from agents.plan import RunPlan
from sunspec.process import log_in


def _tell(text: str) -> None:
    if text:
        logging.info(text)
    os.write(1, os.fsencode(" ".join(text.split())) + b"\n")


def main() -> None:
    """Connect to the inverters of a plan, then serve the run in a folder until the input ends."""
    plan = msgspec.json.decode(sys.stdin.buffer.readline(), type=RunPlan)
    try:
        from sunspec.client import DeviceError  # noqa: PLC0415 - the extra may not be installed
        from sunspec.gateway import Gateway  # noqa: PLC0415
    except ModuleNotFoundError as error:
        _tell(f"devices: {error.name} is not installed: pip install 'heliarch[modbus]'")
        return
    try:
        gateway = Gateway(plan, _tell)
    except DeviceError as error:
        _tell(str(error))
        return
    _tell("")
    if line := sys.stdin.buffer.readline():
        folder = Path(os.fsdecode(line.rstrip(b"\n")))
        with log_in(folder).open("ab") as log:
            os.dup2(log.fileno(), 2)
        logging.basicConfig(format="%(asctime)s %(levelname)s %(message)s", level=logging.INFO)
        logging.info("connected: %s", ", ".join(node for node, _ in plan.site.devices))
        gateway.serve(folder, sys.stdin.fileno())


if __name__ == "__main__":
    main()
