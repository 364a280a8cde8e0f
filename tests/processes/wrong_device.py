"""A direct controller with faults: `python wrong_device.py FAULT,FAULT... PLAN NODE`."""

from __future__ import annotations

import math
import sys
import time
from pathlib import Path
from typing import Any

import msgpack
import zenoh

EXAMPLES = Path(__file__).parents[2] / "examples"
sys.path.insert(0, str(EXAMPLES))

import direct_controller  # noqa: E402

FAULTS = set(sys.argv[1].split(",")) if __name__ == "__main__" else set[str]()

FIRST_WRONG = 3
SILENT = range(5, 25)
"""Cycles in which a silent device publishes nothing."""

FAULT_COUNTS = {"flood": 1_000}
"""Messages in each cycle."""

REPLACED = {
    "not a number": ("impp", "power_kw", math.nan),
    "beyond the rating": ("impp", "power_kw", 1e9),
    "no alpha": ("command", "alpha", 0.0),
}
"""Faults by which a field of a signal is absurd."""


class WrongDevice(direct_controller.DirectController):
    """The example, with faults."""

    def publish(self, signal: str, **fields: Any) -> None:
        if "arming" in FAULTS and self.cycle < 0:
            return
        if "silent" in FAULTS and self.cycle in SILENT:
            return
        fields |= self.stamps() | self.absurd(signal)
        if "residual" in FAULTS and signal == "residual":
            fields["power_kw"] = (fields["power_kw"] or 0.0) + 10.0
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

    def absurd(self, signal: str) -> dict[str, float]:
        return {
            field: value
            for fault, (of, field, value) in REPLACED.items()
            if fault in FAULTS and of == signal and self.cycle >= FIRST_WRONG
        }

    def stamps(self) -> dict[str, int]:
        """Return a wrong stamp; one that is early is of 60 ms before the message goes out."""
        now_ns = time.monotonic_ns()
        if "early" in FAULTS or ("jump" in FAULTS and self.cycle % 3 == 0):
            time.sleep(0.06)
            return {"publish_time_ns": now_ns}
        return {"publish_time_ns": now_ns + 80_000_000} if "ahead" in FAULTS else {}

    def inputs(self, *signals: str) -> list[dict[str, Any] | None]:
        if "expired" in FAULTS:
            self.plan["control"]["hold_cycles"] = 1_000
        return super().inputs(*signals)

    def is_usable(self, signal: str, message: dict[str, Any]) -> bool:
        return "limits" in FAULTS or super().is_usable(signal, message)

    def hear(self, signal: str, message: dict[str, Any]) -> None:
        if "replaced" in FAULTS:
            message["incarnation"] = 0
        super().hear(signal, message)

    def estimate(self) -> None:
        for fault in ("late", "late 1", "late 2"):
            if fault in FAULTS and (fault == "late" or self.cycle >= 5):
                cycles = float(fault.partition(" ")[2] or 0.5)
                time.sleep(cycles * 1e-9 * self.plan["timing"]["cycle_wall_ns"])
        super().estimate()
        if self.cycle >= FIRST_WRONG:
            for fault, (key, payload) in self.further_messages().items():
                for _ in range(FAULT_COUNTS.get(fault, 1) if fault in FAULTS else 0):
                    # None of them gets lost, however slow who hears it.
                    block = zenoh.CongestionControl.BLOCK
                    name = f"{self.plan['plant']}/{key}"
                    self.session.put(name, payload, congestion_control=block)

    def further_messages(self) -> dict[str, tuple[str, bytes]]:
        """Key and payload of what is sent beside the right messages, by fault."""
        own, pack = f"{self.node}/impp", msgpack.packb
        head = {"cycle": self.cycle, "sim_time_ns": 0, "source": self.node, "missing": []}
        good = head | {"publish_time_ns": 1, "sequence": 0, "power_kw": 1.0, "stale_cycles": 0}
        other = next(node for node, _ in self.plan["inverters"] if node != self.node)
        return {
            "garbage": (own, b"\xc1 garbage"),
            "a field less": (own, pack(head)),
            "text for a number": (own, pack(good | {"power_kw": "a lot"})),
            "cycle ahead": (own, pack(good | {"cycle": self.cycle + 500})),
            "contradiction": (own, pack(good)),
            "flood": (own, pack(good)),
            "name of another": (own, pack(good | {"source": "central"})),
            "key of another": (f"{other}/impp", pack(good)),
            "unknown key": (f"{self.parent}/nobody/impp", pack(good)),
        }

    def end(self, cycles: int) -> None:
        if "stop" in FAULTS:
            self.cycle = cycles
            super().estimate()
            time.sleep(0.1)  # Before the session closes.
        super().end(cycles)


def believes_all(signal: str, payload: bytes, source: str) -> dict[str, Any] | None:
    """Read a message without asking from whom it is."""
    for one in ("plant", "c1", "nobody"):
        if (message := READ(signal, payload, one)) is not None:
            return message
    return None


READ = direct_controller.read_message

if __name__ == "__main__":
    sys.argv = [sys.argv[0], "--plan", sys.argv[2], "--node", sys.argv[3]]
    if "wrong messages" in FAULTS:
        direct_controller.read_message = believes_all
    direct_controller.main(WrongDevice)
