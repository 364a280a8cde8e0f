"""A direct controller with faults: `python wrong_device.py FAULT,FAULT... PLAN NODE`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

EXAMPLES = Path(__file__).parents[2] / "examples"
sys.path.insert(0, str(EXAMPLES))

import direct_controller  # noqa: E402

FAULTS = set(sys.argv[1].split(","))
"""The requirements that the device does not meet."""


class WrongDevice(direct_controller.DirectController):
    """The example, with faults."""

    def publish(self, signal: str, **fields: float | None) -> None:
        if "arming" in FAULTS and self.cycle < 0:
            return
        if self.cycle == 3:
            if "decisions" in FAULTS and signal == "residual":
                fields["power_kw"] = (fields["power_kw"] or 0.0) + 1e-9
            if "head" in FAULTS:
                self.sequences[signal] = 7
            if "bounds" in FAULTS and signal == "command":
                fields["alpha"] = 0.0
        if "links" in FAULTS:
            super().publish(signal, **fields)
            self.sequences[signal] = max(self.cycle, 0)
        super().publish(signal, **fields)

    def inputs(self, *signals: str) -> list[dict[str, Any] | None]:
        if "silent" in FAULTS:
            self.plan["hold_cycles"] = 1_000
        return super().inputs(*signals)

    def is_usable(self, signal: str, message: dict[str, Any]) -> bool:
        return "limits" in FAULTS or super().is_usable(signal, message)

    def hear(self, signal: str, message: dict[str, Any]) -> None:
        if "replaced" in FAULTS:
            message["incarnation"] = 0
        super().hear(signal, message)

    def leave(self) -> None:
        if "links closed" not in FAULTS:
            super().leave()


def believes_all(signal: str, payload: bytes, source: str) -> dict[str, Any] | None:
    """Read a message without asking from whom it is."""
    for one in ("plant", "c1", "nobody"):
        if (message := READ(signal, payload, one)) is not None:
            return message
    return None


READ = direct_controller.read_message

if __name__ == "__main__":
    sys.argv = [sys.argv[0], "--plan", sys.argv[2], "--node", sys.argv[3]]
    direct_controller.DirectController = WrongDevice  # type: ignore[misc]
    if "wrong messages" in FAULTS:
        direct_controller.read_message = believes_all
    direct_controller.main()
