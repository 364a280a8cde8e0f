"""Bugs that a campaign must find: each replaces one function of the product by a wrong one.

The wrong function is given the right one, so a bug goes on where the code around it is rewritten.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np
import pytest
from msgspec.structs import replace

from agents.plan import changed

Function: TypeAlias = Callable[..., Any]


class Bug(NamedTuple):
    """A function, `module:name`, and what makes the wrong one of it."""

    where: str
    wrong: Callable[[Function], Function]


@contextmanager
def planted(bug: Bug) -> Iterator[None]:
    """Replace a function in its class, or wherever a module has taken it up by name."""
    module_name, _, path = bug.where.partition(":")
    *owners, name = path.split(".")
    module = import_module(module_name)
    owner = getattr(module, owners[0]) if owners else module
    right = getattr(owner, name)
    wrong = bug.wrong(right)
    with pytest.MonkeyPatch.context() as patch:
        if owners:
            patch.setattr(owner, name, wrong)
        else:
            for other in [*sys.modules.values()]:
                if getattr(other, name, None) is right:
                    patch.setattr(other, name, wrong)
        yield


def _with(**fixed: Any) -> Callable[[Function], Function]:
    """Return a bug that ignores some arguments: the function is called with other ones."""

    def wrong(right: Function) -> Function:
        names = right.__code__.co_varnames[: right.__code__.co_argcount]

        def replaced(*given: Any, **named: Any) -> Any:
            values = {**dict(zip(names, given, strict=False)), **named}
            for field, value in fixed.items():
                values[field] = value(values) if callable(value) else value
            return right(**values)

        return replaced

    return wrong


def _then(change: Callable[..., Any]) -> Callable[[Function], Function]:
    """Return a bug that changes what a function returns: `change(result, *arguments)`."""

    def wrong(right: Function) -> Function:
        def replaced(*given: Any, **named: Any) -> Any:
            return change(right(*given, **named), *given, *named.values())

        return replaced

    return wrong


def _always(value: Any) -> Callable[[Function], Function]:
    return lambda right: lambda *given, **named: value


def _moved(result: Any, *_: Any) -> Any:
    power_kw, *others = result
    moved_kw = 0.02 * power_kw[0]
    return [power_kw[0] - moved_kw, power_kw[1] + moved_kw, *power_kw[2:]], *others


def _own_clock(right: Function) -> Function:
    """Return an `obey` for which every command renews, however old it is."""

    def obey(self: Any, state: Any, commands: Any, cycle: int) -> Any:
        heard = [*commands]
        new = right(self, state, heard, cycle)
        renewed = [
            cycle if one is not None else old for one, old in zip(heard, new.renewed, strict=True)
        ]
        return replace_state(new, renewed=np.array(renewed))

    return obey


def replace_state(state: Any, **fields: Any) -> Any:
    return type(state)(**{name: getattr(state, name) for name in state.__slots__} | fields)


def _obey_as_if(passed: Callable[[Any, int], int]) -> Callable[[Function], Function]:
    """Return an `obey` that goes on from another cycle than the plant's last one."""

    def wrong(right: Function) -> Function:
        def obey(self: Any, state: Any, commands: Any, cycle: int) -> Any:
            return right(self, replace_state(state, cycle=passed(state, cycle)), commands, cycle)

        return obey

    return wrong


def _never_reverts(right: Function) -> Function:
    def obey(self: Any, state: Any, commands: Any, cycle: int) -> Any:
        renewed = np.full_like(state.renewed, max(cycle - 1, 0))
        return right(self, replace_state(state, renewed=renewed), commands, cycle)

    return obey


def _hears_all(right: Function) -> Function:
    """Return a `take` that does not know that a process has been replaced."""

    def take(self: Any, one: Any, message: Any, cycle: int) -> bool:
        one.incarnation = 0
        return bool(right(self, one, message, cycle))

    return take


def _holds_longer(more: int) -> Callable[[Function], Function]:
    def wrong(right: Function) -> Function:
        def make(self: Any, plan: Any, *others: Any) -> None:
            hold = plan.control.hold_cycles + more
            right(self, changed(plan, control={"hold_cycles": hold}), *others)

        return make

    return wrong


def _faster_order(right: Function) -> Function:
    def following(self: Any, last: Any, given: Any, scheduled: Any) -> Any:
        new = right(self, last, given, scheduled)
        if new.order_ramp_kw_per_min and new.order_cycle < new.cycle:
            new.power_kw += (new.power_kw - last.power_kw) * 0.5
        return new

    return following


def _without_ramp_back(right: Function) -> Function:
    def following(self: Any, last: Any, given: Any, scheduled: Any) -> Any:
        new = right(self, last, given, scheduled)
        if new.order_power_kw is None and new.order_cycle:
            new.power_kw = scheduled.power_kw
        return new

    return following


def _silent_counts_nothing(right: Function) -> Function:
    def reports(self: Any, turn: Any, *others: Any) -> Any:
        return [
            one._replace(impp_kw=0.0) if one.is_expired else one
            for one in right(self, turn, *others)
        ]

    return reports


BUGS: Final[dict[str, Bug]] = {
    # Control
    "the most correlated sibling helps first": Bug(
        "agents.control.allocation:help_order", _then(lambda orders, _: [o[::-1] for o in orders])
    ),
    "a child gives what its sibling should": Bug(
        "agents.control.allocation:allocate", _then(_moved)
    ),
    "the correction has no bound": Bug(
        "agents.control.correction:corrected",
        _with(law=lambda v: v["law"]._replace(rating_kw=100.0 * v["law"].rating_kw)),
    ),
    "a new central process begins anew": Bug(
        "agents.parent:CentralController.step",
        lambda right: (
            lambda self, state, turn: right(
                self, replace(state, meter_cycle=max(state.meter_cycle, 1)), turn
            )
        ),
    ),
    "the correction does not know the delay": Bug(
        "agents.control.correction:shown_turns", _always(1)
    ),
    "a hidden maximum is not probed": Bug(
        "agents.control.forecast:forecast_impp",
        _then(
            lambda new, reading, _, __, last: (
                new if new.is_seen else new._replace(power_kw=max(reading.limit_kw, last.power_kw))
            )
        ),
    ),
    "an inverter that is asked for all is free": Bug(
        "agents.control.forecast:held_kw",
        lambda right: lambda setpoint_kw, rating_kw, known: rating_kw,
    ),
    "a lost inverter is lost a cycle late": Bug(
        "agents.control.impp:is_lost", _with(hold_cycles=lambda v: v["hold_cycles"] + 1)
    ),
    "losses do not grow with the power": Bug(
        "agents.control.grid:net_kw", _with(law=lambda v: v["law"]._replace(loss_per_kw=0.0))
    ),
    "an offer is made a cycle late": Bug(
        "agents.control.offers:is_due",
        _with(cycle=lambda v: v["cycle"] - 1 if v["cycle"] > 0 else v["cycle"]),
    ),
    "a silent child counts nothing": Bug("agents.parent:Parent.reports", _silent_counts_nothing),
    # Inverters
    "an inverter ramps by the cycle": Bug(
        "sim_plant.inverters:Inverters.obey", _obey_as_if(lambda state, cycle: state.cycle - 4)
    ),
    "an inverter never reverts": Bug("sim_plant.inverters:Inverters.obey", _never_reverts),
    "an old command renews the revert timer": Bug("sim_plant.inverters:Inverters.obey", _own_clock),
    "a tripped inverter goes on": Bug(
        "agents.faults:trips", _then(lambda tripped, *_: [False] * len(tripped))
    ),
    # Orders
    "an order is followed too fast": Bug("sim_plant.orders:Orders.next", _faster_order),
    "the way back to the schedule has no ramp": Bug(
        "sim_plant.orders:Orders.next", _without_ramp_back
    ),
    "an order comes a cycle late": Bug(
        "agents.plan:PlannedOrder.cycle", _then(lambda cycle, *_: cycle + 1)
    ),
    # Processes
    "a new process joins two cycles late": Bug(
        "agents.loop:Loop.begin",
        _with(cycle=lambda v: v["cycle"] + 2 if v.get("cycle") else 0),
    ),
    "a replaced process is heard": Bug("agents.inputs:Inputs.take", _hears_all),
    "inputs are held a cycle longer": Bug("agents.inputs:Inputs.__init__", _holds_longer(1)),
    "who thaws goes through each cycle": Bug("agents.loop:Loop.catch_up", _always(False)),
}
