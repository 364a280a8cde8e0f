"""Which recorded messages go out, and on which keys."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from agents.plan import RunPlan
from bus_schemas.errors import InputError
from bus_schemas.messages import Message
from bus_schemas.signals import CLOCK, SIGNALS, Port
from bus_schemas.tree import ROOT
from recordings.read.selection import find_signals


@dataclass(frozen=True, slots=True)
class Selection:
    """What of a recording goes out. Keys are without the namespace.

    Attributes
    ----------
    key_of
        For each port that goes out the key that it goes out on.
    clock_key
        Where simulated time is announced, None: nowhere.
    """

    key_of: Mapping[Port[Message], str]
    clock_key: str | None


def select(
    plan: RunPlan,
    signals: str | None = None,
    exclude: str | None = None,
) -> Selection:
    """Choose from the recorded signals.

    Parameters
    ----------
    plan
        Of the run.
    signals, exclude
        Names of signals with commas between: only these, and all but these. `clock`, which is
        never recorded, can be excluded too.

    Raises
    ------
    InputError
        An unknown signal, or nothing is left.
    """
    excluded = _names(exclude)
    without_clock = CLOCK.name in excluded
    left_out = find_signals(name for name in excluded if name != CLOCK.name)
    kept = find_signals(_names(signals)) or tuple(signal for signal in SIGNALS if signal.logged)
    chosen = [
        port for port in plan.keys.ports if port.signal in kept and port.signal not in left_out
    ]
    if not chosen:
        raise InputError("--signals, --exclude: nothing is left to replay")
    key_of = {port: plan.keys.key(port) for port in chosen}
    return Selection(key_of, None if without_clock else plan.keys.key(CLOCK.of(ROOT)))


def _names(text: str | None) -> list[str]:
    return [] if text is None else [name.strip() for name in text.split(",")]
