"""What the launcher asks of the fork server."""

from __future__ import annotations

from typing import TypeAlias

import msgspec


class Start(msgspec.Struct, frozen=True, tag=True):
    """Start the processes of these agents, those first that the others connect to.

    `plan` is a path, `logs` a folder. The plant waits `patience_s` for everybody. `again`: they
    join a run that is under way. `starts`: how many processes each of them had before.
    """

    plan: str
    agents: tuple[str, ...]
    logs: str
    patience_s: float
    again: bool = False
    starts: int = 0


class Expect(msgspec.Struct, frozen=True, tag=True):
    """Tell the recorder how many messages of the run were published in all."""

    messages: int


class Signal(msgspec.Struct, frozen=True, tag=True):
    """Send a signal to the processes of these agents that have not ended."""

    agents: tuple[str, ...]
    number: int


Request: TypeAlias = Start | Expect | Signal
