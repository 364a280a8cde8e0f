"""Direct controllers with faults: `python wrong_device.py FAULT,FAULT... PLAN NODE`.

The fault `everything` does one thing wrong after the other, beside answering rightly.
"""

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
"""The requirements that the device does not meet."""


SILENT = range(10, 30)
"""Cycles in which a silent device publishes nothing."""


class WrongDevice(direct_controller.DirectController):
    """The example, with faults."""

    def publish(self, signal: str, **fields: Any) -> None:
        if "arming" in FAULTS and self.cycle < 0:
            return
        if "silent" in FAULTS and self.cycle in SILENT:
            return
        fields |= self.stamps()
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

FIRST_WRONG = 5
FIRST_ABSURD = 20
"""From this cycle on its numbers are absurd instead of right."""

FLOOD = 10_000
ABSURD_KW = (math.nan, -5.0, 1e9, math.inf, -math.inf)


class MisbehavingDevice(direct_controller.DirectController):
    """The example, with a wrong of its own in each cycle."""

    def estimate(self) -> None:
        """Answer, and then do what must not be done."""
        super().estimate()
        place, wrongs = self.cycle - FIRST_WRONG, self.wrongs()
        for key, payload in wrongs[place] if 0 <= place < len(wrongs) else ():
            # None of them gets lost, however slow who hears it.
            block = zenoh.CongestionControl.BLOCK
            self.session.put(f"{self.plan['plant']}/{key}", payload, congestion_control=block)

    def wrongs(self) -> list[list[tuple[str, bytes]]]:
        """Keys and payloads, cycle by cycle."""
        own, pack, good = f"{self.node}/impp", msgpack.packb, self.impp(self.cycle)
        missing = {key: value for key, value in good.items() if key != "power_kw"}
        other_types = ([1, 2], 7, missing, good | {"power_kw": "a lot"}, good | {"more": 1})
        other_cycles = (0, self.cycle - 1, self.cycle + 500, 10**12, -7)
        other = next(node for node, _ in self.plan["inverters"] if node != self.node)
        return [
            [(own, payload) for payload in (b"\xc1 garbage", b"", bytes(range(256)) * 1000)],
            [(own, pack(wrong)) for wrong in other_types],
            [(own, pack(self.impp(cycle))) for cycle in other_cycles],
            [(own, pack(good))] * 10,
            [(own, pack(good | {"source": "central"})), (f"{other}/impp", pack(good))],
            [(f"{self.node.rpartition('/')[0]}/nobody/impp", b"")],
            [(own, pack(good))] * FLOOD,
        ]

    def publish(self, signal: str, **fields: Any) -> None:
        if self.cycle >= FIRST_ABSURD and signal in ("impp", "command"):
            fields["power_kw"] = ABSURD_KW[self.cycle % len(ABSURD_KW)]
        super().publish(signal, **fields)

    def impp(self, cycle: int) -> dict[str, Any]:
        """Return an IMPP message as it should be."""
        head = {"cycle": cycle, "sim_time_ns": 0, "source": self.node, "missing": []}
        return head | {"publish_time_ns": 1, "sequence": 0, "power_kw": 1.0, "stale_cycles": 0}


if __name__ == "__main__":
    sys.argv = [sys.argv[0], "--plan", sys.argv[2], "--node", sys.argv[3]]
    if "wrong messages" in FAULTS:
        direct_controller.read_message = believes_all
    direct_controller.main(MisbehavingDevice if "everything" in FAULTS else WrongDevice)
