"""The newest cycle of a run for Prometheus: what dashboards and alarms are made from."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily
from prometheus_client.metrics_core import Metric
from prometheus_client.registry import Collector

from agents.cycle import kind_of
from live_page.follower import RunFollower
from live_page.plant_state import PlantState

CONTENT_TYPE: Final = "text/plain; version=0.0.4; charset=utf-8"

_POWERS: Final = ("dispatch", "available", "delivered", "without_help")


def metrics_text(follower: RunFollower, state: PlantState) -> bytes:
    """Return the metrics of the newest cycle that the recording holds."""
    registry = CollectorRegistry()
    registry.register(_OfRun(follower, state))
    return generate_latest(registry)


@dataclass(eq=False)
class _OfRun(Collector):
    _follower: RunFollower
    _state: PlantState

    def collect(self) -> Iterator[Metric]:
        follower, cycle = self._follower, self._follower.cycles - 1
        running = follower.state == "running"
        yield _gauge("heliarch_running", "1 while the run goes on.", {(): float(running)})
        cycles = CounterMetricFamily("heliarch_cycles", "Cycles that the plant completed.")
        cycles.add_metric((), follower.cycles)
        yield cycles
        if cycle >= 0:
            yield from self._of_plant(cycle)
            yield from self._of_agents(self._state.frame(cycle)["agents"])

    def _of_plant(self, cycle: int) -> Iterator[Metric]:
        columns = self._follower.powers(range(cycle, cycle + 1), 1)
        kw = {name: values[-1] for name, values in columns.items()}
        powers = {(name,): 1e3 * kw[name] for name in _POWERS}
        yield _gauge("heliarch_plant_power_watts", "Power of the plant.", powers, "kind")
        short = max(kw["dispatch"] - kw["delivered"], 0.0)
        parts = {
            ("unavoidable",): 1e3 * kw["unavoidable"],
            ("control",): 1e3 * max(short - kw["unavoidable"], 0.0),
        }
        yield _gauge("heliarch_shortfall_watts", "Power that the plant lacked.", parts, "cause")

    def _of_agents(self, rows: Mapping[str, list[Any]]) -> Iterator[Metric]:
        names, tree = self._follower.states.agents, self._follower.plan.tree
        states = Counter((kind,) for kind in rows["kind"])
        yield _gauge("heliarch_agents", "Agents by state.", states, "state")
        loops: dict[tuple[str], float] = {}
        for agent, loop_ms in zip(names, rows["loop_ms"], strict=True):
            tier = (kind_of(agent, tree),)
            loops[tier] = max(loops.get(tier, 0.0), (loop_ms or 0.0) / 1e3)
        text = "Longest time from the last input of an agent to its message, by tier."
        yield _gauge("heliarch_decision_seconds", text, loops, "tier")
        for name, text, column in (
            ("heliarch_missed_inputs", "Inputs that an agent missed so far.", "missed_inputs"),
            ("heliarch_restarts", "How often an agent was started again.", "restarts"),
        ):
            counter = CounterMetricFamily(name, text, labels=("agent",))
            for agent, count in zip(names, rows[column], strict=True):
                counter.add_metric((agent,), count)
            yield counter


def _gauge(name: str, text: str, values: Mapping[Any, float], *labels: str) -> GaugeMetricFamily:
    gauge = GaugeMetricFamily(name, text, labels=labels)
    for label_values, value in values.items():
        gauge.add_metric(label_values, value)
    return gauge
