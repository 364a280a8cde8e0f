"""The control graph that mosaik runs: 22 nodes, the paper's rule, and the result it must give.

One plant, 17 direct controllers in clusters of 6, 6 and 5, three supervisors and one central
controller, as in the scenario `oahu`. A cycle has six serial hops: plant, direct, supervisor,
central, supervisor, direct, plant. It has 95 messages, one number each. A run of Heliarch has the
same ones with a header, and those that are for the recording alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Final

CLUSTERS: Final = {
    f"c{number}": [f"c{number}/i{child}" for child in range(size)]
    for number, size in enumerate((6, 6, 5), start=1)
}
LEAVES: Final = [leaf for children in CLUSTERS.values() for leaf in children]
NAMES: Final = ["plant", *LEAVES, *CLUSTERS, "central"]
PLANT_KW: Final = 8000.0
RATING_KW: Final = PLANT_KW / len(LEAVES)
ALPHA_MIN: Final = 0.05

Values = Sequence[float]


@dataclass(frozen=True)
class Stage:
    """Once all signals it hears have come, a node computes the signals it says."""

    hears: tuple[str, ...]
    says: tuple[str, ...]
    act: Callable[[Values], Values]


@dataclass
class Plant:
    """17 inverters whose available power differs from cycle to cycle."""

    delivered_kw: list[float] = field(default_factory=list)

    def begin(self) -> Values:
        """Return what the plant says in cycle 0, when no command has come yet."""
        return self._say([self._available_kw(leaf, 0) for leaf in range(len(LEAVES))])

    def act(self, alphas: Values) -> Values:
        """Apply the commands of this cycle; return what the plant says in the next one."""
        cycle = len(self.delivered_kw)
        powers = [alpha * self._available_kw(leaf, cycle) for leaf, alpha in enumerate(alphas)]
        self.delivered_kw.append(sum(powers))
        return self._say(powers)

    def _available_kw(self, leaf: int, cycle: int) -> float:
        return RATING_KW * (0.4 + 0.06 * ((7 * leaf + 3 * cycle) % 11))

    def _say(self, powers: Values) -> Values:
        return [4000.0 + 200.0 * (len(self.delivered_kw) % 7), *powers]

    @property
    def stages(self) -> list[Stage]:
        commands = tuple(f"{leaf}/command" for leaf in LEAVES)
        return [Stage(commands, ("dispatch", *(f"{leaf}/telemetry" for leaf in LEAVES)), self.act)]


class Direct:
    """The controller of one inverter."""

    def __init__(self, name: str) -> None:
        self.alpha, self.impp = 1.0, 0.0
        self.stages = [
            Stage((f"{name}/telemetry", "dispatch"), _report(name), self.estimate),
            Stage((f"{name}/setpoint",), (f"{name}/command",), self.command),
        ]

    def estimate(self, heard: Values) -> Values:
        power, dispatch = heard
        self.impp = min(power / self.alpha, RATING_KW)
        return self.impp, self.impp - dispatch * RATING_KW / PLANT_KW

    def command(self, heard: Values) -> Values:
        (setpoint,) = heard
        self.alpha = max(min(setpoint / self.impp, 1.0), ALPHA_MIN)
        return (self.alpha,)


class Supervisor:
    """The controller of one cluster."""

    def __init__(self, name: str) -> None:
        children = CLUSTERS[name]
        self.impp: Values = ()
        self.stages = [
            Stage(_reports(children), _report(name), self.report),
            Stage((f"{name}/setpoint",), _setpoints(children), self.solve),
        ]

    def report(self, heard: Values) -> Values:
        self.impp = heard[::2]
        return sum(self.impp), sum(heard[1::2])

    def solve(self, heard: Values) -> Values:
        return _shares(heard[0], [1.0] * len(self.impp), self.impp)


class Central:
    """The controller of the plant."""

    def __init__(self) -> None:
        hears = (*_reports(list(CLUSTERS)), "dispatch")
        self.stages = [Stage(hears, _setpoints(list(CLUSTERS)), self.solve)]

    def solve(self, heard: Values) -> Values:
        *reports, dispatch = heard
        return _shares(dispatch, [len(each) for each in CLUSTERS.values()], reports[::2])


def _report(name: str) -> tuple[str, str]:
    return f"{name}/impp", f"{name}/residual"


def _reports(names: Sequence[str]) -> tuple[str, ...]:
    return tuple(signal for name in names for signal in _report(name))


def _setpoints(names: Sequence[str]) -> tuple[str, ...]:
    return tuple(f"{name}/setpoint" for name in names)


def _shares(target: float, weights: Values, impp: Values) -> list[float]:
    """Share a target by weight; what a child cannot give comes from those with headroom."""
    whole = sum(weights)
    shares = [
        min(target * weight / whole, most) for weight, most in zip(weights, impp, strict=True)
    ]
    missing = target - sum(shares)
    for index, most in enumerate(impp):
        more = min(missing, most - shares[index])
        shares[index] += more
        missing -= more
    return shares


Node = Plant | Direct | Supervisor | Central


def node(name: str) -> Node:
    if name == "plant":
        return Plant()
    if name == "central":
        return Central()
    return Supervisor(name) if name in CLUSTERS else Direct(name)


def expected_kw(cycles: int) -> list[float]:
    """Return the power delivered in each cycle, computed in this process in the right order."""
    plant = Plant()
    nodes = {name: node(name) for name in NAMES if name != "plant"}
    upwards = [nodes[name].stages[0] for name in [*LEAVES, *CLUSTERS, "central"]]
    downwards = [nodes[name].stages[1] for name in [*CLUSTERS, *LEAVES]]
    values: dict[str, float] = {}
    (applied,) = plant.stages
    values.update(zip(applied.says, plant.begin(), strict=True))
    for _ in range(cycles):
        for stage in [*upwards, *downwards, applied]:
            said = stage.act([values[signal] for signal in stage.hears])
            values.update(zip(stage.says, said, strict=True))
    return plant.delivered_kw


def kind(name: str) -> str:
    if name in ("plant", "central"):
        return name
    return "supervisor" if name in CLUSTERS else "direct"
