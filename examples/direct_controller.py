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

PROTOCOL = 2  # Version of docs/wire.md that it was written from.
METER_TOLERANCE = (
    0.05  # Share of the rating by which a meter may read above the rating, or below 0.
)
SAME = 1e-6  # Share by which the rating in a dispatch may differ from the plan's.
ROUNDING = 1e-9
BEFORE_ALL = -(2**31)  # No cycle has begun: each message takes it further.
EARLIER = 0.98  # It closes a stage by so much of its time: its cycle begins with a message.
NUMBERS = {  # What it needs of each message beside cycle and source.
    "telemetry": ("power_kw", "alpha"),
    "dispatch": ("power_kw", "plant_rating_kw"),
    "setpoint": ("power_kw",),
    "run": (),
}


class DirectController:
    """Telemetry and dispatch in, IMPP and residual out; then setpoint in, command out."""

    def __init__(self, plan: dict[str, Any], node: str, session: zenoh.Session) -> None:
        self.plan, self.node, self.session = plan, node, session
        self.rating_kw: float = dict(plan["inverters"])[node]
        self.plant_rating_kw: float = sum(dict(plan["inverters"]).values())
        self.parent_period: int = plan["control"]["period_cycles"][node.count("/")]
        self.parent = node.rpartition("/")[0] or "central"
        self.prefix = f"{plan['plant']}/{node}"
        self.deadlines_s = deadlines_s(plan, node)
        self.cycle = BEFORE_ALL
        self.forget()

    def forget(self) -> None:
        """Go back to the initial state: each arming round begins with it, and each process."""
        self.sequences: dict[str, int] = {}  # The next number on each key.
        self.incarnation = 0  # The cycle in which it joined.
        self.processes: dict[str, int] = {}  # Newest incarnation of the publisher of each input.
        self.impp_kw, self.stale_cycles = 0.0, 0
        self.measured_cycle: int | None = None
        self.heard: dict[str, int] = {}  # Newest cycle of each input, usable or not.
        self.newest: dict[str, dict[str, Any]] = {}  # Newest usable message of each input.
        self.missing: list[str] = []
        self.stage = ""

    # What comes in -------------------------------------------------------------------------------

    def hear(self, signal: str, message: dict[str, Any]) -> None:
        """Take in one message, and answer if it was the last that a stage awaited."""
        cycle, incarnation = message["cycle"], message.get("incarnation", 0)
        if cycle >= self.plan["timing"]["cycles"]:
            return
        if signal == "setpoint" and cycle > self.cycle:
            return  # Only the plant begins a cycle.
        if signal == "setpoint" and cycle >= 0 and cycle % self.parent_period:
            return  # It is not the parent's turn.
        if incarnation < self.processes.get(signal, 0):
            return  # It is of a process that has been replaced.
        if cycle <= self.heard.get(signal, BEFORE_ALL):
            return  # It comes a second time, or after a newer one.
        if cycle > self.cycle:
            self.enter(cycle)
        self.heard[signal] = cycle
        if self.is_usable(signal, message):
            self.newest[signal], self.processes[signal] = message, incarnation
        self.advance()

    def is_usable(self, signal: str, message: dict[str, Any]) -> bool:
        """Whether its number can be right. Telemetry is judged where the maximum is estimated."""
        power_kw: float = message["power_kw"]
        if signal == "setpoint":
            highest_kw: float = self.rating_kw * (1.0 + ROUNDING)
            return 0.0 <= power_kw <= highest_kw
        if signal == "dispatch":
            off_kw: float = abs(message["plant_rating_kw"] - self.plant_rating_kw)
            return math.isfinite(power_kw) and off_kw <= SAME * self.plant_rating_kw
        return True

    def enter(self, cycle: int) -> None:
        """Begin a cycle. In arming rounds, whose numbers are negative, nothing is remembered."""
        if cycle < 0 or self.cycle < 0:
            self.forget()
            self.incarnation = max(cycle, 0)
        self.cycle, self.stage = cycle, "estimate"
        self.entered_at = time.monotonic()

    def leave(self) -> None:
        """Forget a run whose plant has gone without a stop: the next one may begin."""
        self.cycle = BEFORE_ALL
        self.forget()

    def end(self, cycles: int) -> None:
        """Say how it went: the plant has stopped the run after so many cycles."""
        commands = self.sequences.get("command", 0)
        print(f"{self.node}: commands in {commands} of {cycles} cycles, then the plant stopped")

    # Stages --------------------------------------------------------------------------------------

    def advance(self, *, time_is_up: bool = False) -> None:
        """Close the open stage if its inputs are there or its time is up; then the next one."""
        if self.stage == "estimate" and (time_is_up or self.has("telemetry", "dispatch")):
            self.stage = "actuate"
            self.estimate()
            time_is_up = False
        if self.stage == "actuate":
            parent_acts = self.cycle < 0 or self.cycle % self.parent_period == 0
            if time_is_up or not parent_acts or self.has("setpoint"):
                self.stage = ""
                self.actuate()

    def has(self, *signals: str) -> bool:
        """Whether the message of this cycle has come on each of these inputs."""
        return all(self.heard.get(signal) == self.cycle for signal in signals)

    def seconds_left(self) -> float | None:
        """How long the open stage may wait; None: until its inputs are there.

        So it is in lockstep, in arming rounds, and between command and telemetry.
        """
        if not self.plan["timing"]["cycle_wall_ns"] or self.cycle < 0 or not self.stage:
            return None
        close_at = self.entered_at + EARLIER * self.deadlines_s[self.stage]
        return max(close_at - time.monotonic(), 0.0)

    def inputs(self, *signals: str) -> list[dict[str, Any] | None]:
        """Return the newest message of each input, None if it has expired. Say so in `missing`."""
        self.missing, self.ready_ns = [], time.monotonic_ns()
        found = []
        for signal in signals:
            key = signal if signal == "dispatch" else f"{self.node}/{signal}"
            period = self.parent_period if signal == "setpoint" else 1
            message = self.newest.get(signal)
            if message is not None:
                age = self.cycle - message["cycle"] - period + 1  # Up to 0: no newer one was due.
                if age > self.plan["control"]["hold_cycles"]:
                    message = None
                elif age > 0:
                    self.missing.append(f"{key}@{message['cycle']}")
            if message is None:
                self.missing.append(key)
            found.append(message)
        return found

    def estimate(self) -> None:
        """Say what the inverter could give (eq. 1), and how far that is from its share."""
        telemetry, dispatch = self.inputs("telemetry", "dispatch")
        last = -1 if self.measured_cycle is None else self.measured_cycle
        if telemetry is not None and 0 <= telemetry["cycle"] <= last:
            telemetry = None  # The estimate rests on it already.
        self.measure(telemetry)
        impp_kw = 0.0 if self.is_lost(dispatch) else self.impp_kw
        residual_kw = impp_kw - (self.share_kw(dispatch) or 0.0)
        self.publish("impp", power_kw=impp_kw, stale_cycles=self.stale_cycles)
        self.publish("residual", power_kw=residual_kw)
        if residual_kw < 0.0:
            self.publish("help", missing_kw=-residual_kw)

    def measure(self, telemetry: dict[str, Any] | None) -> None:
        """Estimate the maximum from a measurement; without a usable one the last estimate holds."""
        self.stale_cycles += 1
        if telemetry is None:
            return
        self.measured_cycle = telemetry["cycle"]
        power_kw, alpha = telemetry["power_kw"], telemetry["alpha"]
        lowest_kw = -METER_TOLERANCE * self.rating_kw
        highest_kw = self.rating_kw * (1.0 + METER_TOLERANCE)
        if lowest_kw <= power_kw <= highest_kw and 0.0 < alpha <= 1.0:  # Not so if one is NaN.
            maximum_kw = max(power_kw, 0.0) / alpha
            available_kw = telemetry.get("available_kw")  # Some inverters state it.
            if alpha < 1.0 and available_kw is not None and 0.0 <= available_kw <= highest_kw:
                maximum_kw = available_kw
            self.impp_kw, self.stale_cycles = min(maximum_kw, self.rating_kw), 0

    def is_lost(self, dispatch: dict[str, Any] | None) -> bool:
        """Whether the plant is heard, but for too long nothing usable of the inverter."""
        hold_cycles: int = self.plan["control"]["hold_cycles"]
        return dispatch is not None and self.stale_cycles > hold_cycles

    def share_kw(self, dispatch: dict[str, Any] | None) -> float | None:
        """Return the inverter's share of the dispatch by rating (eq. 3); None if none is heard."""
        if dispatch is None:
            return None
        plant_rating_kw: float = dispatch["plant_rating_kw"]
        power_kw: float = min(max(dispatch["power_kw"], 0.0), plant_rating_kw)
        return power_kw * (self.rating_kw / plant_rating_kw)

    def actuate(self) -> None:
        """Command the setpoint; without one the inverter's own share of the dispatch (eq. 6).

        Without either nothing is sent: the inverter decides for itself. Nor is anything before the
        first telemetry, since that would wipe a limit which the inverter has.
        """
        if self.measured_cycle is None:
            return
        setpoint, dispatch = self.inputs("setpoint", "dispatch")
        share_kw = self.share_kw(dispatch)
        lost = self.is_lost(dispatch)
        target_kw = share_kw if setpoint is None or lost else setpoint["power_kw"]
        if target_kw is None:
            return
        alpha = 1.0
        if target_kw < self.impp_kw * (1.0 - ROUNDING):
            alpha = min(max(target_kw / self.impp_kw, self.plan["control"]["alpha_min"]), 1.0)
        power_kw = alpha * self.impp_kw if alpha < 1.0 else self.rating_kw
        if lost:
            power_kw = target_kw
        # Where to an inverter goes that hears no more of us.
        revert_kw = share_kw if self.plan["site"].get("revert") is not None else None
        self.publish("command", alpha=alpha, power_kw=power_kw, revert_kw=revert_kw)

    # The bus -------------------------------------------------------------------------------------

    def publish(self, signal: str, **fields: float | None) -> None:
        """Send a message of this cycle."""
        sequence = 0
        if self.cycle >= 0:
            sequence = self.sequences.get(signal, 0)
            self.sequences[signal] = sequence + 1
        message = {
            "cycle": self.cycle,
            "sim_time_ns": self.plan["timing"]["start_time_ns"]
            + self.cycle * self.plan["timing"]["cycle_ns"],
            "source": self.node,
            "missing": self.missing,
            "ready_time_ns": self.ready_ns,
            "publish_time_ns": time.monotonic_ns(),
            "sequence": sequence,
            "incarnation": self.incarnation,
            **fields,
        }
        self.session.put(
            f"{self.prefix}/{signal}",
            msgpack.packb(message),
            encoding="application/msgpack",
            congestion_control=zenoh.CongestionControl.BLOCK,
        )


def deadlines_s(plan: dict[str, Any], node: str) -> dict[str, float]:
    """Return by when after the tick each stage closes [s]."""
    tiers = 1 + max(path.count("/") for path, _ in plan["inverters"])
    if stated_ns := plan["timing"]["tier_deadlines_ns"]:
        return {"estimate": stated_ns[0] * 3 / (tiers + 3) / 1e9, "actuate": stated_ns[-1] / 1e9}
    part_s = 0.9 * plan["timing"]["cycle_wall_ns"] / (2 * tiers + 4) / 1e9
    return {"estimate": 3 * part_s, "actuate": (tiers + node.count("/") + 4) * part_s}


def read_plan(path: Path) -> dict[str, Any]:
    """Return the plan of a run, as soon as the launcher has written it."""
    while True:
        try:
            plan: dict[str, Any] = json.loads(path.read_text())
            return plan
        except (FileNotFoundError, json.JSONDecodeError):
            time.sleep(0.1)


def read_message(signal: str, payload: bytes, source: str) -> dict[str, Any] | None:
    """Return a message; None if it is none of this signal, or from somebody else."""
    try:
        message = msgpack.unpackb(payload)
    except ValueError:
        return None
    if not isinstance(message, dict) or message.get("source") != source:
        return None
    if not isinstance(message.get("cycle"), int):
        return None
    right = all(isinstance(message.get(name), int | float) for name in NUMBERS[signal])
    return message if right else None


def session_config(plan: dict[str, Any], node: str, endpoints: list[str]) -> zenoh.Config:
    """Zenoh as a peer that neither searches nor listens: it connects to the agents it talks to."""
    ports, keys_folder = plan["access"]["tcp_ports"], plan["access"].get("keys_folder")
    if not endpoints:
        parent = node.rpartition("/")[0] or "central"
        talks_to = ["recorder", "plant", parent]
        if f"{parent}+standby" in ports:  # From one of the two it hears setpoints.
            talks_to.append(f"{parent}+standby")
        link, addresses = "tls" if keys_folder else "tcp", plan["access"].get("addresses", {})
        endpoints = [
            f"{link}/{addresses.get(agent, plan['access']['address'])}:{ports[agent]}"
            for agent in talks_to
        ]
    config = zenoh.Config()
    settings: dict[str, object] = {
        "mode": "peer",
        "namespace": plan["access"]["namespace"] or plan["run_id"],
        "listen/endpoints": [],  # Without it Zenoh listens on a port of its own choice.
        "connect/endpoints": endpoints,
        "connect/timeout_ms": -1,
        "connect/exit_on_failure": False,
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
    }
    if not plan["timing"]["cycle_wall_ns"]:
        # In lockstep all agents wait for one that stands still; by default Zenoh closes its links.
        block = "transport/link/tx/queue/congestion_control/block"
        settings[f"{block}/wait_before_close"] = 60_000_000  # Microseconds.
        settings["transport/link/tx/lease"] = 60_000  # Milliseconds.
    if keys_folder:
        own = Path(keys_folder) / node.replace("/", ".")
        settings["transport/link/tls"] = {
            "root_ca_certificate": str(Path(keys_folder) / "ca.pem"),
            "enable_mtls": True,
            "connect_certificate": f"{own}.pem",
            "connect_private_key": f"{own}.key",
        }
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    return config


def main(kind: type[DirectController] = DirectController) -> None:
    """Join the run of a plan, and control the inverter until the plant says that it is over."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--plan", type=Path, required=True, help="plan.json of the run")
    parser.add_argument("--node", required=True, help="the inverter, for instance c2/inv07")
    parser.add_argument(
        "--connect", action="append", default=[], help="instead of the plan's ports"
    )
    options = parser.parse_args()
    plan = read_plan(options.plan)
    if plan["protocol"] != PROTOCOL:
        parser.error(f"expected a plan of protocol {PROTOCOL}, got {plan['protocol']}")
    arrived: queue.SimpleQueue[zenoh.Sample] = queue.SimpleQueue()
    with zenoh.open(session_config(plan, options.node, options.connect)) as session:
        controller = kind(plan, options.node, session)
        # What is declared holds for as long as there is a name for it.
        subscribers = [
            session.declare_subscriber(key, arrived.put)
            for key in (
                f"{controller.prefix}/telemetry",
                f"{controller.prefix}/setpoint",
                f"{plan['plant']}/dispatch",
                f"{plan['plant']}/run",
            )
        ]
        plant_alive = f"{plan['plant']}/plant/alive"
        subscribers.append(
            session.liveliness().declare_subscriber(plant_alive, arrived.put, history=True)
        )
        token = session.liveliness().declare_token(f"{controller.prefix}/alive")
        print(f"{options.node}: waiting for the plant", flush=True)
        while True:
            try:
                sample = arrived.get(timeout=controller.seconds_left())
            except queue.Empty:
                controller.advance(time_is_up=True)
                continue
            signal = str(sample.key_expr).rpartition("/")[2]
            if signal == "alive":
                if sample.kind == zenoh.SampleKind.DELETE:
                    controller.leave()
                continue
            source = controller.parent if signal == "setpoint" else "plant"
            message = read_message(signal, sample.payload.to_bytes(), source)
            if message is None:
                continue
            if signal != "run":
                controller.hear(signal, message)
            elif message.get("state") == "stop":
                controller.end(message["cycle"])
                break
        del subscribers, token


if __name__ == "__main__":
    main()
