"""Who helped whom: how much each node lacked, when it was worst, and who produced power for it."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection
from dataclasses import dataclass

from agents.plan import RunPlan
from bus_schemas.messages import Message, Residual, Setpoint
from bus_schemas.signals import RESIDUAL, SETPOINT, Port
from bus_schemas.tree import ROOT
from recordings.read.run_clock import RunClock
from results.tables import Cell, Column, Table, key_column, word_column

_MOST_ROWS = 30
_MOST_HELPERS = 3


@dataclass
class Need:
    """The deficit of one node: its energy, and the largest deficit with its cycle."""

    lacking_kwh: float = 0.0
    worst_kw: float = 0.0
    worst_cycle: int = 0
    cycles: int = 0


class HelpBetween:
    """The help among the children of each parent, of some nodes, from the messages of a run.

    `needs` are by node, `given_kwh` by helper and needy node. A setpoint holds until its parent's
    next turn.
    """

    def __init__(self, plan: RunPlan, nodes: Collection[str]) -> None:
        self.nodes = tuple(node for node in plan.tree.nodes if node in nodes and node != ROOT)
        self.needs = defaultdict[str, Need](Need)
        self.given_kwh = defaultdict[tuple[str, str], float](float)
        hours = plan.timing.cycle_s / 3600.0
        self._hours: dict[Port[Message], float] = {
            signal.of(node): hours * plan.control.period(signal.of(node))
            for signal in (RESIDUAL, SETPOINT)
            for node in self.nodes
        }

    @property
    def ports(self) -> Collection[Port[Message]]:
        return self._hours.keys()

    def see(self, port: Port[Message], message: Message) -> None:
        hours = self._hours[port]
        match message:
            case Residual() if message.power_kw < 0.0:
                need = self.needs[port.node]
                need.lacking_kwh -= message.power_kw * hours
                need.cycles += 1
                if -message.power_kw > need.worst_kw:
                    need.worst_kw, need.worst_cycle = -message.power_kw, message.cycle
            case Setpoint():
                for line in message.help_given:
                    self.given_kwh[port.node, line.needy] += line.power_kw * hours

    def helpers(self, needy: str) -> list[tuple[str, float]]:
        """Return who helped a node and by how much energy [kWh], most first."""
        found = [(giver, kwh) for (giver, node), kwh in self.given_kwh.items() if node == needy]
        return sorted(found, key=lambda one: -one[1])

    @property
    def most_needy(self) -> list[str]:
        needy = [node for node, need in self.needs.items() if need.lacking_kwh > 0.0]
        return sorted(needy, key=lambda node: -self.needs[node].lacking_kwh)


def help_table(found: HelpBetween, clock: RunClock) -> Table:
    """Return the nodes that lacked power, the neediest first, with those who helped most."""
    ranked = found.most_needy
    rows: list[tuple[Cell, ...]] = []
    for node in ranked[:_MOST_ROWS]:
        need, helpers = found.needs[node], found.helpers(node)
        named = ", ".join(f"{giver} {kwh:,.1f}" for giver, kwh in helpers[:_MOST_HELPERS])
        more = f" and {len(helpers) - _MOST_HELPERS} more" if len(helpers) > _MOST_HELPERS else ""
        got_kwh = sum(kwh for _, kwh in helpers)
        worst = f"{need.worst_kw:,.0f} kW at {clock.text(need.worst_cycle)}"
        rows.append((node, need.lacking_kwh, need.cycles, worst, got_kwh, named + more or "nobody"))
    columns = (
        key_column("needy", "node"),
        Column("lacking", "kWh", 1),
        Column("cycles"),
        word_column("worst moment"),
        Column("help", "kWh", 1),
        word_column("from [kWh]", "helpers"),
    )
    notes = [
        "Lacking: its share of the dispatch less its IMPP. Help comes from siblings: for an "
        "inverter from its own cluster, for a cluster from other clusters. What its own cluster "
        "cannot give is part of what the cluster lacks. Help can exceed what was lacking: siblings "
        "also cover for a node that is not heard, and for what the central controller asks beyond "
        "the dispatch."
    ]
    if len(ranked) > _MOST_ROWS:
        notes.append(f"{len(ranked) - _MOST_ROWS:,} others lacked less.")
    return Table("Who helped whom", columns, rows, notes)
