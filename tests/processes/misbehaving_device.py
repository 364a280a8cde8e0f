"""A device that does everything wrong, one thing after the other, beside answering rightly.

`python misbehaving_device.py PLAN NODE` takes the place of a direct controller. It is the example
controller with bad manners: from `FIRST_WRONG` on each cycle has a wrong of its own, and from
`FIRST_ABSURD` on its numbers are absurd instead of right.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import Any

import msgpack
import zenoh

EXAMPLES = Path(__file__).parents[2] / "examples"
sys.path.insert(0, str(EXAMPLES))

import direct_controller  # noqa: E402

FIRST_WRONG = 5
FIRST_ABSURD = 20
FLOOD = 10_000
ABSURD_KW = (math.nan, -5.0, 1e9, math.inf, -math.inf)


class MisbehavingDevice(direct_controller.DirectController):
    """The example, with wrongs."""

    def estimate(self) -> None:
        """Answer, and then do what must not be done."""
        super().estimate()
        wrongs = (
            self.send_garbage,
            self.send_other_types,
            self.send_other_cycles,
            self.repeat_itself,
            self.pretend_to_be_others,
            self.speak_for_nobody,
            self.flood,
        )
        place = self.cycle - FIRST_WRONG
        if 0 <= place < len(wrongs):
            wrongs[place]()

    def send_garbage(self) -> None:
        """Bytes that are no msgpack, and none at all."""
        for payload in (b"\xc1 garbage", b"", bytes(range(256)) * 1000):
            self.put("impp", payload)

    def send_other_types(self) -> None:
        """Valid msgpack of another type, and with other fields."""
        good = self.impp(self.cycle)
        missing = {key: value for key, value in good.items() if key != "power_kw"}
        for wrong in ([1, 2], 7, missing, good | {"power_kw": "a lot"}, good | {"more": 1}):
            self.put("impp", msgpack.packb(wrong))

    def send_other_cycles(self) -> None:
        """Of the past and of a far future."""
        for cycle in (0, self.cycle - 1, self.cycle + 500, 10**12, -7):
            self.put("impp", msgpack.packb(self.impp(cycle)))

    def repeat_itself(self) -> None:
        """Ten times as many messages as there should be."""
        for _ in range(10):
            self.put("impp", msgpack.packb(self.impp(self.cycle)))

    def pretend_to_be_others(self) -> None:
        """Another's name on the own key, and the own name on another's key."""
        self.put("impp", msgpack.packb(self.impp(self.cycle) | {"source": "central"}))
        other = next(node for node, _ in self.plan["inverters"] if node != self.node)
        self.put_at(f"{other}/impp", msgpack.packb(self.impp(self.cycle)))

    def speak_for_nobody(self) -> None:
        """A node that the run does not have."""
        cluster = self.node.rpartition("/")[0]
        self.put_at(f"{cluster}/nobody/impp", b"")

    def flood(self) -> None:
        """Far more than anybody can look at."""
        payload = msgpack.packb(self.impp(self.cycle))
        for _ in range(FLOOD):
            self.put("impp", payload)

    def publish(self, signal: str, **fields: float | None) -> None:
        """Send a message, with absurd numbers in the end."""
        if self.cycle >= FIRST_ABSURD and signal in ("impp", "command"):
            fields["power_kw"] = ABSURD_KW[self.cycle % len(ABSURD_KW)]
        super().publish(signal, **fields)

    def impp(self, cycle: int) -> dict[str, Any]:
        """Return an IMPP message as it should be."""
        return {
            "cycle": cycle,
            "sim_time_ns": 0,
            "source": self.node,
            "missing": [],
            "publish_time_ns": 1,
            "sequence": 0,
            "power_kw": 1.0,
            "stale_cycles": 0,
        }

    def put(self, signal: str, payload: bytes) -> None:
        """Send bytes on a key of its own."""
        self.put_at(f"{self.node}/{signal}", payload)

    def put_at(self, key: str, payload: bytes) -> None:
        """Send bytes on any key of the plant. None of them gets lost, however slow who hears it."""
        self.session.put(
            f"{self.plan['plant']}/{key}",
            payload,
            congestion_control=zenoh.CongestionControl.BLOCK,
        )


if __name__ == "__main__":
    direct_controller.DirectController = MisbehavingDevice  # type: ignore[misc]
    sys.argv = [sys.argv[0], "--plan", sys.argv[1], "--node", sys.argv[2]]
    direct_controller.main()
