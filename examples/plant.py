"""A plant that shares no code with Heliarch: inverters under a simple sky, over plain Zenoh.

It takes the place of the plant simulator in a run that was started with `--external plant`: it
arms the controllers, starts the run, ticks, and stops it. Written from docs/wire.md alone; needs
`pip install eclipse-zenoh msgpack`.

    heliarch launch oahu --external plant --pace 1 --duration 60 --out my-run
    python examples/plant.py --plan my-run/plan.json
"""

from __future__ import annotations

import argparse
import math
import queue
import time
from pathlib import Path
from typing import Any

import msgpack
from member import PROTOCOL, Member, read_plan

FIRST_ROUND = -1_000_000  # Arming rounds count upwards from here.
ROUND_S, LONGEST_ROUND_S = 0.3, 3.0  # How long a round may take: each one 0.1 s more, up to ...
LEAD_S = 0.2  # In real time: how long before cycle 0 everybody is told when it begins.
ADVANCE_AT = 0.9  # Share of the cycle by whose end the plant has its commands, or does without.


class Plant(Member):
    """Inverters that obey commands, and the operator who wants half of their rating."""

    def __init__(self, plan: dict[str, Any]) -> None:
        super().__init__(plan, "plant", ["recorder"], [])
        self.ratings_kw: dict[str, float] = dict(plan["inverters"])
        self.wall_s = plan["timing"]["cycle_wall_ns"] / 1e9  # 0 is lockstep.
        self.ready_round: int | None = None
        self.stand_still()

    def stand_still(self) -> None:
        """Go back to the initial state: no inverter is curtailed."""
        self.alpha = dict.fromkeys(self.ratings_kw, 1.0)
        self.limit_kw = dict(self.ratings_kw)
        self.power_kw = self.sky_kw(0)
        self.obeyed: dict[str, int] = {}  # Cycle of the last command of each inverter.

    def sky_kw(self, cycle: int) -> dict[str, float]:
        """Return what each inverter could give, while clouds go by from the first to the last."""
        time_s = max(cycle, 0) * self.plan["timing"]["cycle_ns"] / 1e9
        return {
            node: rating_kw * (0.6 + 0.4 * math.cos(time_s / 20.0 - place))
            for place, (node, rating_kw) in enumerate(self.ratings_kw.items())
        }

    def dispatch_kw(self) -> float:
        """Return the power that the operator wants from the plant."""
        return 0.5 * sum(self.ratings_kw.values())

    # One cycle -----------------------------------------------------------------------------------

    def run_cycle(self, cycle: int, until: float) -> bool:
        """Tick: dispatch and telemetry out, commands in, production out. Whether all answered."""
        self.cycle, self.missing, self.ready_ns = cycle, [], time.monotonic_ns()
        dispatch_kw, rating_kw = self.dispatch_kw(), sum(self.ratings_kw.values())
        self.publish(
            "dispatch",
            power_kw=dispatch_kw,
            plant_rating_kw=rating_kw,
            commitment_kw=dispatch_kw,
            regulation_kw=0.0,
        )
        self.publish("meter", power_kw=sum(self.power_kw.values()))
        for node in self.ratings_kw:
            self.publish(
                f"{node}/telemetry",
                power_kw=self.power_kw[node],
                alpha=self.alpha[node],
                limit_kw=self.limit_kw[node],
            )
        silent = self.await_commands(until)
        if silent and cycle < 0:
            return False  # A round that does not close leaves nothing behind.
        self.ready_ns = time.monotonic_ns()
        self.missing = [self.instead(node) for node in sorted(silent)]
        self.advance()
        return not silent

    def instead(self, node: str) -> str:
        """Return the entry of `missing` for an inverter that got no command in this cycle."""
        cycle = self.obeyed.get(node)
        is_old = cycle is None or self.cycle - cycle > self.plan["control"]["hold_cycles"]
        return f"{node}/command" if is_old else f"{node}/command@{cycle}"

    def await_commands(self, until: float) -> set[str]:
        """Obey commands as they come, until each inverter has that of this cycle.

        Returns the inverters that got none; they go on obeying their last one.
        """
        silent = set(self.ratings_kw)
        while silent and (message := self.next_message(until)) is not None:
            node = message["source"]
            alpha, limit_kw = message.get("alpha", math.nan), message.get("power_kw", math.nan)
            cycle, last = message["cycle"], self.obeyed.get(node, FIRST_ROUND)
            if node in silent and last < cycle <= self.cycle and 0.0 < alpha <= 1.0:
                self.alpha[node], self.obeyed[node] = alpha, cycle
                if self.plan["control"]["actuator"] == "limit" and limit_kw >= 0.0:
                    self.limit_kw[node] = min(limit_kw, self.ratings_kw[node])
                if cycle == self.cycle:
                    silent.discard(node)
        return silent

    def advance(self) -> None:
        """Let the interval of this cycle pass, and say what really happened in it."""
        sky_kw = self.sky_kw(self.cycle)
        fraction = self.plan["control"]["actuator"] == "fraction"
        for node, most_kw in sky_kw.items():
            share = self.alpha[node] if fraction else 1.0
            self.power_kw[node] = min(share * most_kw, self.limit_kw[node])
        self.publish(
            "production",
            dispatch_kw=self.dispatch_kw(),
            available_kw=sum(sky_kw.values()),
            delivered_kw=sum(self.power_kw.values()),
            inverter_mpp_kw=list(sky_kw.values()),
            inverter_power_kw=list(self.power_kw.values()),
        )

    # The run -------------------------------------------------------------------------------------

    def await_everybody(self) -> None:
        """Wait until each agent's liveliness token is seen."""
        nodes = {path for leaf in self.ratings_kw for path in branch(leaf)}
        name = self.plan["plant"]
        absent = {f"{name}/{agent}/alive" for agent in {"central", "recorder", *nodes}}
        while absent:
            for reply in self.session.liveliness().get(f"{name}/**/alive", timeout=1.0):
                if reply.ok is not None:
                    absent.discard(str(reply.ok.key_expr))
            time.sleep(0.05)

    def arm(self) -> int:
        """Send rounds through the loop until one closes and is recorded. Return how many."""
        for rounds in range(1, -FIRST_ROUND):
            self.stand_still()
            until = time.monotonic() + min(ROUND_S + 0.1 * (rounds - 1), LONGEST_ROUND_S)
            if self.run_cycle(FIRST_ROUND + rounds, until):
                while self.ready_round != self.cycle and self.next_message(until) is not None:
                    pass
                if self.ready_round == self.cycle:
                    return rounds
        raise SystemExit("the loop does not close")

    def run(self) -> None:
        """Start the run, tick through all its cycles, stop it."""
        self.stand_still()
        start_ns = time.monotonic_ns() + round(LEAD_S * 1e9 if self.wall_s else 0.0)
        self.say_run("start", 0, start_ns)
        for cycle in range(self.plan["timing"]["cycles"]):
            until = math.inf
            if self.wall_s:  # Ticks are absolute: a late one does not shift those after it.
                tick_at = start_ns / 1e9 + cycle * self.wall_s
                time.sleep(max(tick_at - time.monotonic(), 0.0))
                until = tick_at + ADVANCE_AT * self.wall_s
            if not self.run_cycle(cycle, until):
                print(f"cycle {cycle}: without {', '.join(self.missing)}", flush=True)
        self.say_run("stop", self.plan["timing"]["cycles"], start_ns)

    def say_run(self, state: str, cycle: int, start_ns: int) -> None:
        """Tell everybody that the run begins at a cycle, or ends before it."""
        self.cycle, self.missing, self.ready_ns = cycle, [], time.monotonic_ns()
        wall_ns = self.plan["timing"]["cycle_wall_ns"]
        times = {"start_time_ns": start_ns, "cycle_wall_ns": wall_ns}
        self.publish("run", state=state, protocol=PROTOCOL, **times)

    # The bus -------------------------------------------------------------------------------------

    def next_message(self, until: float) -> dict[str, Any] | None:
        """Return the next command or word of the recorder; None if none comes in time."""
        left_s = until - time.monotonic()
        try:
            sample = self.arrived.get(timeout=None if left_s == math.inf else max(left_s, 0.0))
        except queue.Empty:
            return None
        message: dict[str, Any] = msgpack.unpackb(sample.payload.to_bytes())
        if str(sample.key_expr) == f"{self.prefix}/ready":
            self.ready_round = message["cycle"]
        return message


def branch(leaf: str) -> list[str]:
    """Return the paths of an inverter and of the supervisors above it."""
    parts = leaf.split("/")
    return ["/".join(parts[:end]) for end in range(1, len(parts) + 1)]


def main() -> None:
    """Run the plant of a plan."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--plan", type=Path, required=True, help="plan.json of the run")
    plan = read_plan(parser.parse_args().plan)
    plant = Plant(plan)
    with plant.session:
        plant.join("**/command", "ready")
        plant.await_everybody()
        print(f"armed after {plant.arm()} rounds", flush=True)
        plant.run()
        print(f"{plan['timing']['cycles']} cycles are over", flush=True)


if __name__ == "__main__":
    main()
