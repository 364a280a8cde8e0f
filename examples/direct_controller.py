"""A direct controller that shares no code with Heliarch: the paper's rule over plain Zenoh.

It takes the place of one inverter's controller in a run that was started with `--external`.
Written from docs/wire.md alone; needs `pip install eclipse-zenoh msgpack`.

    heliarch launch oahu --external c2/inv07 --base-port 7500 --pace 1 --out my-run
    python examples/direct_controller.py --plan my-run/plan.json --node c2/inv07
"""

from __future__ import annotations

import argparse
import math
import queue
import time
from pathlib import Path
from typing import Any

import msgpack
import zenoh
from member import Member, read_plan

METER_TOLERANCE = 0.05  # Share of the rating by which a meter may read above it, or below 0.
SAME = 1e-6  # Share by which the rating in a dispatch may differ from the plan's.
HIDDEN_ALPHA_MIN = 0.001  # The lowest alpha where a limit hides the maximum.
ROUNDING = 1e-9
BEFORE_ALL = -(2**31)  # No cycle has begun: each message takes it further.
EARLIER = 0.98  # It closes a stage by so much of its time: its cycle begins with a message.
NUMBERS = {  # What it needs of each message beside cycle and source.
    "telemetry": ("power_kw", "alpha"),
    "dispatch": ("power_kw", "plant_rating_kw"),
    "setpoint": ("power_kw",),
    "run": (),
}


class DirectController(Member):
    """Telemetry and dispatch in, IMPP and residual out; then setpoint in, command out."""

    def __init__(self, plan: dict[str, Any], node: str, endpoints: list[str]) -> None:
        self.node, self.parent = node, node.rpartition("/")[0] or "central"
        super().__init__(plan, node, ["recorder", "plant", self.parent], endpoints)
        self.rating_kw: float = dict(plan["inverters"]).get(node, 0.0)
        self.plant_rating_kw: float = sum(dict(plan["inverters"]).values())
        self.parent_period: int = plan["control"]["period_cycles"][node.count("/")]
        self.alpha_min: float = plan["control"]["alpha_min"]
        if (plan["control"]["scheme"], plan["control"]["actuator"]) == ("predictive", "limit"):
            self.alpha_min = HIDDEN_ALPHA_MIN
        self.deadlines_s = deadlines_s(plan, node)
        self.forget()

    def forget(self) -> None:
        """Go back to the initial state: each arming round begins with it, and each process."""
        self.sequences = {}
        self.incarnation = 0  # The cycle in which it joined.
        self.processes: dict[str, int] = {}  # Newest incarnation of the publisher of each input.
        self.impp_kw, self.stale_cycles = 0.0, 0
        self.measured_cycle: int | None = None
        self.heard: dict[str, int] = {}  # Newest cycle of each input, usable or not.
        self.newest: dict[str, dict[str, Any]] = {}  # Newest usable message of each input.
        self.missing = []
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

    def run(self) -> None:
        """Hear the others until the plant stops the run."""
        self.watch("plant")
        self.join(f"{self.node}/telemetry", f"{self.node}/setpoint", "dispatch", "run")
        print(f"{self.node}: waiting for the plant", flush=True)
        while True:
            try:
                sample = self.arrived.get(timeout=self.seconds_left())
            except queue.Empty:
                self.advance(time_is_up=True)
                continue
            signal = str(sample.key_expr).rpartition("/")[2]
            if signal == "alive":
                if sample.kind == zenoh.SampleKind.DELETE:
                    self.leave()
                continue
            source = self.parent if signal == "setpoint" else "plant"
            message = read_message(signal, sample.payload.to_bytes(), source)
            if message is not None and signal != "run":
                self.hear(signal, message)
            elif message is not None and message.get("state") == "stop":
                self.end(message["cycle"])
                return

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
        """Take up what was measured, and report."""
        telemetry, dispatch = self.inputs("telemetry", "dispatch")
        last = -1 if self.measured_cycle is None else self.measured_cycle
        if telemetry is not None and 0 <= telemetry["cycle"] <= last:
            telemetry = None  # The estimate rests on it already.
        self.measure(telemetry)
        self.report(dispatch)

    def report(self, dispatch: dict[str, Any] | None) -> None:
        """Say what the inverter could give (eq. 1), and how far that is from its share."""
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
            alpha = min(max(target_kw / self.impp_kw, self.alpha_min), 1.0)
        power_kw = alpha * self.impp_kw if alpha < 1.0 else self.rating_kw
        if lost:
            power_kw = target_kw
        # Where to an inverter goes that hears no more of us.
        self.publish("command", alpha=alpha, power_kw=power_kw, revert_kw=share_kw)


def deadlines_s(plan: dict[str, Any], node: str) -> dict[str, float]:
    """Return by when after the tick each stage closes [s]."""
    tiers = 1 + max(path.count("/") for path, _ in plan["inverters"])
    part_s = 0.9 * plan["timing"]["cycle_wall_ns"] / (3 * tiers + 2) / 1e9
    places = {"estimate": 1, "actuate": tiers + node.count("/") + 2}
    return {stage: (tiers + place) * part_s for stage, place in places.items()}


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


def main(kind: type[DirectController] = DirectController) -> None:
    """Join the run of a plan, and control the inverter until the plant says that it is over."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--plan", type=Path, required=True, help="plan.json of the run")
    parser.add_argument("--node", required=True, help="the inverter, for instance c2/inv07")
    parser.add_argument(
        "--connect", action="append", default=[], help="instead of the plan's ports"
    )
    options = parser.parse_args()
    controller = kind(read_plan(options.plan), options.node, options.connect)
    with controller.session:
        controller.run()


if __name__ == "__main__":
    main()
