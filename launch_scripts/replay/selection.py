"""Which recorded messages go out, and on which keys."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from agents.plan import RunPlan
from bus_schemas.errors import InputError
from bus_schemas.messages import Message
from bus_schemas.signals import CLOCK, SIGNALS, Port
from bus_schemas.tree import ROOT
from recordings.selection import find_signals

_KEY: Final = re.compile(r"[A-Za-z0-9_-]+(/[A-Za-z0-9_-]+)*")


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
    remaps: Sequence[str] = (),
) -> Selection:
    """Choose from the recorded signals.

    Parameters
    ----------
    plan
        Of the run.
    signals, exclude
        Names of signals with commas between: only these, and all but these. `clock`, which is
        never recorded, can be excluded too.
    remaps
        `old=new`, each a key or the leading parts of keys. The longest that fits is taken.

    Raises
    ------
    InputError
        An unknown signal, a remap of a key that does not go out, or of two keys onto one; or
        nothing is left.
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
    clock = CLOCK.of(ROOT)
    keys = {port: plan.keys.key(port) for port in (*chosen, clock)}
    sent = _remapped(keys, [_remap(text) for text in remaps])
    clock_key = sent.pop(clock)
    return Selection(sent, None if without_clock else clock_key)


def _names(text: str | None) -> list[str]:
    return [] if text is None else [name.strip() for name in text.split(",")]


def _remap(text: str) -> tuple[str, str]:
    old, _, new = text.partition("=")
    if not (_KEY.fullmatch(old) and _KEY.fullmatch(new)):
        raise InputError(
            f"--remap {text}: accepted is OLD=NEW, two keys or leading parts of keys, such as "
            "oahu/c1=oahu/c9"
        )
    return old, new


def _remapped(
    keys: Mapping[Port[Message], str], remaps: Sequence[tuple[str, str]]
) -> dict[Port[Message], str]:
    sent = dict(keys)
    for old, new in sorted(remaps, key=lambda remap: len(remap[0])):  # the longest one last
        fitting = [port for port, key in keys.items() if f"{key}/".startswith(f"{old}/")]
        if not fitting:
            raise InputError(f"--remap {old}={new}: no key that is replayed begins with {old}")
        for port in fitting:
            sent[port] = new + keys[port].removeprefix(old)
    origin: dict[str, str] = {}
    for port, target in sent.items():
        if target in origin:
            raise InputError(
                f"--remap: {origin[target]} and {keys[port]} would both become {target}"
            )
        origin[target] = keys[port]
    return sent
