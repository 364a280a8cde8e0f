"""A direct controller that shares no code with Heliarch: the paper's rule over plain Zenoh.

It takes the place of one inverter's controller in a run that was started with `--external`.
Written from docs/wire.md alone; needs `pip install eclipse-zenoh msgpack`.

    heliarch launch oahu --external c2/inv07 --base-port 7500 --pace 1 --out my-run
    python examples/direct_controller.py --plan my-run/plan.json --node c2/inv07
"""

from __future__ import annotations

import argparse
import json
import math
import queue
import time
from pathlib import Path
from typing import Any

import msgpack
import zenoh

METER_TOLERANCE = 0.05  # A meter may read so much above the rating before that is absurd.
BEFORE_ALL = -(2**31)  # No cycle has begun: each message takes it further.
REQUEST_BY = 0.3  # Share of a cycle after its telemetry by which a request must be there.
SETPOINT_BY = 0.75  # The same of a setpoint.


class DirectController:
    """Telemetry and request in, IMPP and residual out; then setpoint in, command out."""

    def __init__(self, plan: dict[str, Any], node: str, session: zenoh.Session) -> None:
        self.plan, self.node, self.session = plan, node, session
        self.rating_kw = dict(plan["inverters"])[node]
        self.prefix = f"{plan['plant']}/{node}"
        self.sequences: dict[str, int] = {}  # The next number on each key.
        self.cycle = BEFORE_ALL
        self.forget()

    @property
    def commands(self) -> int:
        """In how many cycles of the run it has given a command."""
        return self.sequences.get("command", 0)

    def forget(self) -> None:
        """Go back to the initial state: each arming round begins with it."""
        self.impp_kw, self.stale_cycles = 0.0, 0
        self.request_kw, self.setpoint_kw = 0.0, self.rating_kw
        self.inputs: dict[str, dict[str, Any]] = {}
        self.missing: list[str] = []
        self.estimated = self.actuated = True

    def hear(self, signal: str, message: dict[str, Any]) -> None:
        """Take in one message, and answer if it was the last that a step needed."""
        cycle = message["cycle"]
        if cycle > self.cycle:
            self.enter(cycle)
        if cycle < self.cycle or signal in self.inputs:
            return  # Of a cycle that is over, or a second time.
        self.inputs[signal] = message
        if signal == "telemetry":
            self.measured_at = time.monotonic()
        self.advance()

    def advance(self, *, time_is_up: bool = False) -> None:
        """Take the steps whose inputs are there; the next one without, if its time is up."""
        measured = "telemetry" in self.inputs
        if not self.estimated and measured and self.need_not_wait("request", time_is_up):
            self.estimate()
            time_is_up = False
        if self.estimated and not self.actuated and self.need_not_wait("setpoint", time_is_up):
            self.actuate()

    def need_not_wait(self, signal: str, time_is_up: bool) -> bool:
        """Whether the parent has said it, or says nothing in this cycle, or is too late."""
        if signal in self.inputs or not self.parent_acts():
            return True
        if time_is_up:
            self.missing.append(f"{self.node}/{signal}")
        return time_is_up

    def enter(self, cycle: int) -> None:
        """Begin a cycle. In arming rounds, whose numbers are negative, nothing is remembered."""
        if cycle < 0 or self.cycle < 0:
            self.forget()
        self.cycle, self.inputs, self.missing = cycle, {}, []
        self.estimated = self.actuated = False

    def parent_acts(self) -> bool:
        """Whether the supervisor gives a request and a setpoint in this cycle."""
        depth_of_parent = self.node.count("/")
        return self.cycle < 0 or self.cycle % self.plan["period_cycles"][depth_of_parent] == 0

    def seconds_left(self) -> float | None:
        """How long to wait for the parent before going on without; if for ever, None.

        So it is in lockstep, in arming rounds, and between command and telemetry.
        """
        cycle_s: float = self.plan["cycle_wall_ns"] / 1e9
        if not cycle_s or self.cycle < 0 or self.actuated or "telemetry" not in self.inputs:
            return None
        share = SETPOINT_BY if self.estimated else REQUEST_BY
        return max(self.measured_at + share * cycle_s - time.monotonic(), 0.0)

    def estimate(self) -> None:
        """Say what the inverter could give (eq. 1), and what it has more or less than asked for."""
        self.estimated = True
        power_kw, alpha = self.inputs["telemetry"]["power_kw"], self.inputs["telemetry"]["alpha"]
        if 0.0 <= power_kw <= self.rating_kw * (1.0 + METER_TOLERANCE) and 0.0 < alpha <= 1.0:
            self.impp_kw, self.stale_cycles = min(power_kw / alpha, self.rating_kw), 0
        else:  # Absurd, also if it is NaN: the last estimate holds, and grows old.
            self.stale_cycles += 1
        self.request_kw = self.usable("request", self.request_kw)
        residual_kw = self.impp_kw - self.request_kw
        self.publish("impp", power_kw=self.impp_kw, stale_cycles=self.stale_cycles)
        self.publish("residual", power_kw=residual_kw)
        if residual_kw < 0.0:
            self.publish("help", missing_kw=-residual_kw)

    def actuate(self) -> None:
        """Turn the setpoint into the share of its maximum that the inverter may give (eq. 6)."""
        self.actuated = True
        self.setpoint_kw = self.usable("setpoint", self.setpoint_kw)
        alpha = 1.0
        if self.setpoint_kw < self.impp_kw * (1.0 - 1e-9):
            alpha = min(max(self.setpoint_kw / self.impp_kw, self.plan["alpha_min"]), 1.0)
        power_kw = alpha * self.impp_kw if alpha < 1.0 else self.rating_kw
        self.publish("command", alpha=alpha, power_kw=power_kw)

    def usable(self, signal: str, last_kw: float) -> float:
        """Return the power that the parent names; the last one if it says nothing or nonsense."""
        power_kw: float = self.inputs.get(signal, {}).get("power_kw", math.nan)
        return power_kw if 0.0 <= power_kw <= self.rating_kw * (1.0 + 1e-9) else last_kw

    def publish(self, signal: str, **fields: float) -> None:
        """Send a message of this cycle."""
        sequence = 0
        if self.cycle >= 0:
            sequence = self.sequences.get(signal, 0)
            self.sequences[signal] = sequence + 1
        message = {
            "cycle": self.cycle,
            "sim_time_ns": self.plan["start_time_ns"] + self.cycle * self.plan["cycle_ns"],
            "source": self.node,
            "missing": self.missing,
            "publish_time_ns": time.monotonic_ns(),
            "sequence": sequence,
            **fields,
        }
        self.session.put(
            f"{self.prefix}/{signal}",
            msgpack.packb(message),
            encoding="application/msgpack",
            congestion_control=zenoh.CongestionControl.BLOCK,
        )


def read_plan(path: Path) -> dict[str, Any]:
    """Return the plan of a run, as soon as the launcher has written it."""
    while True:
        try:
            plan: dict[str, Any] = json.loads(path.read_text())
            return plan
        except (FileNotFoundError, json.JSONDecodeError):
            time.sleep(0.1)


def session_config(plan: dict[str, Any], node: str, endpoints: list[str]) -> zenoh.Config:
    """Zenoh as a peer that neither searches nor listens: it connects to the agents it talks to."""
    if not endpoints:
        talks_to = ("recorder", "plant", node.rpartition("/")[0] or "central")
        endpoints = [f"tcp/127.0.0.1:{plan['tcp_ports'][agent]}" for agent in talks_to]
    config = zenoh.Config()
    for key, value in {
        "mode": "peer",
        "namespace": plan["namespace"] or plan["run_id"],
        "listen/endpoints": [],  # Without it Zenoh listens on a port of its own choice.
        "connect/endpoints": endpoints,
        "connect/timeout_ms": -1,
        "connect/exit_on_failure": False,
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
    }.items():
        config.insert_json5(key, json.dumps(value))
    return config


def main() -> None:
    """Join the run of a plan, and control the inverter until the plant says that it is over."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--plan", type=Path, required=True, help="plan.json of the run")
    parser.add_argument("--node", required=True, help="the inverter, for instance c2/inv07")
    parser.add_argument(
        "--connect", action="append", default=[], help="instead of the plan's ports"
    )
    options = parser.parse_args()
    plan = read_plan(options.plan)
    arrived: queue.SimpleQueue[zenoh.Sample] = queue.SimpleQueue()
    with zenoh.open(session_config(plan, options.node, options.connect)) as session:
        controller = DirectController(plan, options.node, session)
        # What is declared holds for as long as there is a name for it.
        subscribers = [
            session.declare_subscriber(key, arrived.put)
            for key in (
                *(f"{controller.prefix}/{name}" for name in ("telemetry", "request", "setpoint")),
                f"{plan['plant']}/run",
            )
        ]
        token = session.liveliness().declare_token(f"{controller.prefix}/alive")
        print(f"{options.node}: waiting for the plant", flush=True)
        while True:
            try:
                sample = arrived.get(timeout=controller.seconds_left())
            except queue.Empty:
                controller.advance(time_is_up=True)
                continue
            message = msgpack.unpackb(sample.payload.to_bytes())
            signal = str(sample.key_expr).rpartition("/")[2]
            if signal != "run":
                controller.hear(signal, message)
            elif message["state"] == "stop":
                break
        print(
            f"{options.node}: commands in {controller.commands} of {message['cycle']} cycles, then "
            "the plant stopped",
            flush=True,
        )
        del subscribers, token


if __name__ == "__main__":
    main()
