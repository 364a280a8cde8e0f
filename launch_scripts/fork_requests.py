"""What the launcher asks of the fork server."""

from __future__ import annotations

from typing import TypeAlias

import msgspec


class Start(msgspec.Struct, frozen=True, tag=True):
    """Start the processes of these agents, those first that the others connect to.

    `plan` is a path, `logs` a folder. `again`: they join a run that is under
    way.
    """

    plan: str
    agents: tuple[str, ...]
    logs: str
    again: bool = False


class Signal(msgspec.Struct, frozen=True, tag=True):
    """Send a signal to the processes of these agents that have not ended."""

    agents: tuple[str, ...]
    number: int


Request: TypeAlias = Start | Signal
