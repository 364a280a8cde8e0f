"""The view of a run under way; the terminal's panel is in `heliarch.cli.live_view`."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Protocol, TypeAlias

from agents.plan import RunPlan
from agents.process.events import Status


class View(Protocol):
    """Where a run shows itself."""

    def say(self, text: str) -> None:
        """Show a line that stays."""

    def show(self, status: Status) -> None:
        """Show where the run stands."""


ViewFor: TypeAlias = Callable[[RunPlan], AbstractContextManager[View]]
"""Opens the view of a run."""
