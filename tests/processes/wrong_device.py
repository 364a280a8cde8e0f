"""A direct controller with one fault: `python wrong_device.py FAULT PLAN NODE`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

EXAMPLES = Path(__file__).parents[2] / "examples"
sys.path.insert(0, str(EXAMPLES))

import direct_controller  # noqa: E402

FAULT = sys.argv[1]
"""The requirement that the device does not meet."""


class WrongDevice(direct_controller.DirectController):
    """The example, with one fault."""

    def publish(self, signal: str, **fields: float | None) -> None:
        match FAULT:
            case "decisions" if self.cycle > 2 and signal == "residual":
                fields["power_kw"] = (fields["power_kw"] or 0.0) + 1e-9
            case "arming" if self.cycle < 0:
                return
            case "head" if self.cycle == 3:
                self.sequences[signal] = 7
            case "bounds" if self.cycle == 3 and signal == "command":
                fields["alpha"] = 0.0
            case "links":
                super().publish(signal, **fields)
                self.sequences[signal] = max(self.cycle, 0)
        super().publish(signal, **fields)

    def inputs(self, *signals: str) -> list[dict[str, Any] | None]:
        if FAULT == "silent":
            self.plan["hold_cycles"] = 1_000
        return super().inputs(*signals)

    def is_usable(self, signal: str, message: dict[str, Any]) -> bool:
        return FAULT == "limits" or super().is_usable(signal, message)

    def hear(self, signal: str, message: dict[str, Any]) -> None:
        if FAULT == "replaced":
            message["incarnation"] = 0
        super().hear(signal, message)

    def leave(self) -> None:
        if FAULT != "links closed":
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
    if FAULT == "wrong messages":
        direct_controller.read_message = believes_all
    direct_controller.main()
