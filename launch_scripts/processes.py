"""The processes of a run, as a flat list: what is started, and how."""

from __future__ import annotations

import os
import sys
from collections.abc import Collection
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from bus_schemas.tree import CENTRAL, PLANT, RECORDER, ControlTree

ZENOH_RUNTIME: Final = (
    "(rx: (handover: app), acc: (handover: app), tx: (handover: app), net: (handover: app), "
    "app: (worker_threads: 1))"
)
"""One worker thread for all of Zenoh's work: see docs/decisions/0003-zenoh-tuning.md."""


PLANT_PATIENCE_S: Final = 30.0
"""How long the plant waits for processes to appear."""

_PYTHON: Final = (sys.executable, "-P")
"""Without the current folder on the path: a user's `signal.py` there is none of ours."""


@dataclass(frozen=True, slots=True)
class ProcessSpec:
    """One process of a run.

    Attributes
    ----------
    agent
        Name of the agent that it runs.
    kind
        `recorder`, `plant`, `central`, `supervisor` or `direct`.
    command
        Program and arguments.
    """

    agent: str
    kind: str
    command: tuple[str, ...]

    @property
    def log_name(self) -> str:
        """Name of its log file."""
        return f"{self.agent.replace('/', '.')}.log"


def processes(
    tree: ControlTree, plan: Path, external: Collection[str] = (), patience_s: float = 0.0
) -> tuple[ProcessSpec, ...]:
    """List the processes of a run, those first that the others connect to.

    Parameters
    ----------
    tree, plan
        Control tree of the run, and where its plan lies.
    external
        Agents that are no processes of this run.
    patience_s
        How much longer than for processes the plant waits for them [s].
    """
    specs = tuple(_process(agent, tree, plan) for agent in tree.agents() if agent not in external)
    if not patience_s:
        return specs
    words = ("--patience", str(PLANT_PATIENCE_S + patience_s))
    return tuple(
        replace(spec, command=(*spec.command, *words)) if spec.agent == PLANT else spec
        for spec in specs
    )


def environment() -> dict[str, str]:
    """Return the environment of the processes."""
    return {**os.environ, "ZENOH_RUNTIME": ZENOH_RUNTIME, "PYTHONUNBUFFERED": "1"}


def _process(agent: str, tree: ControlTree, plan: Path) -> ProcessSpec:
    common = ("--plan", str(plan), "--attached")
    if agent == RECORDER:
        return ProcessSpec(agent, "recorder", (*_PYTHON, "-m", "recordings", *common))
    if agent == PLANT:
        return ProcessSpec(agent, "plant", (*_PYTHON, "-m", "sim_plant", *common))
    kind = "central" if agent == CENTRAL else "direct" if tree.is_leaf(agent) else "supervisor"
    command = (*_PYTHON, "-m", "agents", kind, "--node", agent, *common)
    return ProcessSpec(agent, kind, command)
