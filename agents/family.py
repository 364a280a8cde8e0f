"""What every parent does with its children, whatever its tier: ask, listen, divide.

The central controller and the supervisors differ only in where their target comes from. Both keep
a `Family`, which holds the parent's side of the paper's steps 2 to 4.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from math import fsum
from typing import Final

import msgspec
from msgspec.structs import replace

from agents.agent import Turn
from agents.control.allocation import allocate
from agents.control.neighbours import HelpOrder, help_order
from agents.control.request import request_kw as share_of_kw
from agents.control.request import residual_kw
from bus_schemas.bus import Delivery
from bus_schemas.messages import (
    Help,
    HelpGiven,
    Impp,
    Message,
    Request,
    Residual,
    Setpoint,
)
from bus_schemas.signals import HELP, IMPP, REQUEST, RESIDUAL, SETPOINT, Port


class Report(msgspec.Struct, frozen=True, gc=False):
    """What a child last said of itself.

    Attributes
    ----------
    impp_kw, residual_kw, stale_cycles
        What it said.
    silent_cycles
        For how many cycles nothing has come of it since.
    age_cycles
        How many cycles ago it said so: 0 where it has come, and is plausible, in this cycle. In
        lockstep too the report of a child whose words make no sense grows old.
    """

    impp_kw: float
    residual_kw: float
    stale_cycles: int
    silent_cycles: int
    age_cycles: int


NO_REPORT: Final = Report(0.0, 0.0, 0, 1 << 30, 1 << 30)
"""Of a child that never spoke: silent for longer than anything holds."""


@dataclass(frozen=True, slots=True)
class Neighbourhood:
    """The order of help among a parent's children from a time on.

    Attributes
    ----------
    from_time_ns
        Simulated time from which it holds.
    correlation
        Pearson correlation between the children's power, shape (n, n).
    """

    from_time_ns: int
    correlation: tuple[tuple[float, ...], ...]


class Family:
    """A parent's children.

    Parameters
    ----------
    node
        Path of the parent.
    children
        Paths of the children.
    capacities_kw
        Their AC ratings, shape (n,).
    neighbourhoods
        Correlation of the children, hour by hour, in the order of time. None at all: they are
        asked for help in their own order.
    hold_cycles
        For how many cycles a silent child's last report holds. Then it counts as zero, and its
        share is given to the others.
    lends
        Whether it always gives its children what they lack as well, since they act between its
        turns.
    """

    def __init__(
        self,
        node: str,
        children: tuple[str, ...],
        capacities_kw: tuple[float, ...],
        neighbourhoods: tuple[Neighbourhood, ...],
        hold_cycles: int,
        lends: bool = False,
    ) -> None:
        self.node = node
        self.children = children
        self.capacities_kw = capacities_kw
        self.rating_kw = fsum(capacities_kw)
        self.hold_cycles = hold_cycles
        self.lends = lends
        self._from_times_ns = [hood.from_time_ns for hood in neighbourhoods]
        self._orders = [help_order(hood.correlation) for hood in neighbourhoods]
        self._default_order = help_order([[0.0] * len(children)] * len(children))
        self._request_ports = tuple(REQUEST.of(child) for child in children)
        self._setpoint_ports = tuple(SETPOINT.of(child) for child in children)
        self._child_ports = tuple((IMPP.of(child), RESIDUAL.of(child)) for child in children)
        self._help_of: dict[Port[Message], Port[Message]] = {
            RESIDUAL.of(child): HELP.of(child) for child in children
        }
        self._own_ports = (IMPP.of(node), RESIDUAL.of(node), HELP.of(node))

    @property
    def report_ports(self) -> frozenset[Port[Message]]:
        """Ports on which the children report in each cycle."""
        return frozenset(port for pair in self._child_ports for port in pair)

    @property
    def help_ports(self) -> frozenset[Port[Message]]:
        """Ports on which the children call for help when they need it."""
        return frozenset(self._help_of.values())

    def follow_up(self, port: Port[Message], message: Message) -> Port[Message] | None:
        """Return the port of a child's call for help, which a negative residual announces."""
        if isinstance(message, Residual) and message.power_kw < 0.0:
            return self._help_of.get(port)
        return None

    def no_reports(self) -> tuple[Report, ...]:
        """Return the reports before the first cycle."""
        return (NO_REPORT,) * len(self.children)

    def requests(self, turn: Turn, power_kw: float) -> list[Delivery]:
        """Ask each child for its share by capacity (eq. 3)."""
        return [
            (port, Request(*turn.stamp, power_kw=self._share_kw(place, power_kw)))
            for place, port in enumerate(self._request_ports)
        ]

    def listen(self, turn: Turn, last: tuple[Report, ...], request_kw: float) -> tuple[Report, ...]:
        """Take up what the children report in this cycle.

        One whose IMPP does not come is silent. Its last report holds for a while. Then it has
        nothing, and so lacks all that is asked of it: its share of the node's request.
        """
        return tuple(
            self._report(turn, place, report, request_kw) for place, report in enumerate(last)
        )

    def _report(self, turn: Turn, place: int, last: Report, request_kw: float) -> Report:
        impp_port, residual_port = self._child_ports[place]
        impp, residual = turn.get(impp_port), turn.get(residual_port)
        if impp is not None:
            left_kw = self._left_kw(impp, residual, place, request_kw)
            if _plausible(impp.power_kw, left_kw, self.capacities_kw[place]):
                age_cycles = turn.cycle - impp.cycle
                return Report(impp.power_kw, left_kw, impp.stale_cycles, 0, age_cycles)
        silent_cycles, age_cycles = last.silent_cycles + 1, last.age_cycles + 1
        if silent_cycles > self.hold_cycles:
            lacks_kw = self._share_kw(place, request_kw)
            return Report(0.0, -lacks_kw, last.stale_cycles, silent_cycles, age_cycles)
        return replace(last, silent_cycles=silent_cycles, age_cycles=age_cycles)

    def _left_kw(
        self, impp: Impp, residual: Residual | None, place: int, request_kw: float
    ) -> float:
        """Return what a child has left of its IMPP (eq. 4), worked out if it did not say so.

        A residual of another cycle than the IMPP is of another IMPP. What is worked out refers to
        the request that holds now, as the node's own residual does: whatever the child had been
        told when it spoke, this is what it is to meet.
        """
        if residual is not None and residual.cycle == impp.cycle:
            return residual.power_kw
        return residual_kw(impp.power_kw, self._share_kw(place, request_kw))

    def _share_kw(self, place: int, power_kw: float) -> float:
        return share_of_kw(power_kw, self.capacities_kw[place], self.rating_kw)

    def report_up(self, turn: Turn, reports: tuple[Report, ...]) -> list[Delivery]:
        """Say of the node what its children say of themselves: the sums (eq. 2).

        A negative sum of residuals is what the children cannot settle among themselves: the node
        asks its own parent for help.
        """
        impp_port, residual_port, help_port = self._own_ports
        impp_kw = fsum(report.impp_kw for report in reports)
        left_kw = fsum(report.residual_kw for report in reports)
        stale_cycles = max(report.stale_cycles for report in reports)
        outputs: list[Delivery] = [
            (impp_port, Impp(*turn.stamp, power_kw=impp_kw, stale_cycles=stale_cycles)),
            (residual_port, Residual(*turn.stamp, power_kw=left_kw)),
        ]
        if left_kw < 0.0:
            outputs.append((help_port, Help(*turn.stamp, missing_kw=-left_kw)))
        return outputs

    def divide(self, turn: Turn, target_kw: float, reports: tuple[Report, ...]) -> list[Delivery]:
        """Give each child its setpoint out of the node's target (step 4).

        Where a report is of an earlier cycle nobody knows what there is now, or at the beginning
        anything at all: then too the children are lent what they seem to lack.
        """
        impp_kw = [report.impp_kw for report in reports]
        lends = self.lends or any(report.age_cycles for report in reports)
        powers_kw, shares_kw, donors, needy, given_kw, _ = allocate(
            target_kw,
            self.capacities_kw,
            impp_kw,
            0.0,
            self._order_at(turn.sim_time_ns),
            lends,
        )
        help_given: list[tuple[HelpGiven, ...]] = [()] * len(self.children)
        for donor, child, power_kw in zip(donors, needy, given_kw, strict=True):
            help_given[donor] += (HelpGiven(self.children[child], power_kw),)
        return [
            (
                port,
                Setpoint(*turn.stamp, power_kw=power_kw, share_kw=share_kw, help_given=given),
            )
            for port, power_kw, share_kw, given in zip(
                self._setpoint_ports, powers_kw, shares_kw, help_given, strict=True
            )
        ]

    def _order_at(self, sim_time_ns: int) -> HelpOrder:
        place = bisect_right(self._from_times_ns, sim_time_ns) - 1
        return self._orders[max(place, 0)] if self._orders else self._default_order


def _plausible(impp_kw: float, left_kw: float, capacity_kw: float) -> bool:
    # A child that claims a NaN, a negative or more than its rating counts as silent. The sum of
    # a cluster's IMPP may exceed the sum of its ratings by a rounding error. The residual is the
    # IMPP less a request between 0 and the rating.
    rating_kw = capacity_kw * (1.0 + 1e-9)
    return 0.0 <= impp_kw <= rating_kw and -rating_kw <= left_kw <= impp_kw
