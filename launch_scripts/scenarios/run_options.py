"""Options of a run: which part of a scenario runs, what differs from the scenario, and how.

None: as in the scenario. `add_command` reads the docstrings.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from agents.settings import Actuator, Scheme


@dataclass(frozen=True)
class TimeOptions:
    """Which part of a scenario is run.

    --from TIME (start): Local time of the first cycle: 12:30, or 2010-04-01T12:30.
    --duration TIME: Simulated time, in place of --to: seconds, or 90s, 15m, 1h30m.
    --to TIME (end): Local time at which the last cycle ends.
    """

    start: str | None = None
    duration: str | None = None
    end: str | None = None


@dataclass(frozen=True)
class PlantOptions:
    """What is different from the scenario.

    --actuator: Whether a command is a fraction of the maximum or a power limit.
    --fault RULE (faults): Make links imperfect: source=c1/*,delay=50ms (fields: source,
        listener, signal, delay, jitter, distribution, loss, duplicate, reorder, reorder-by,
        silent=60s..90s, at=60s..90s). Or cut links, freeze or kill controllers:
        partition=c1|c2,at=5s..9s, freeze=c2,at=5s..9s, kill=c2,at=5s. May be given several times.
    """

    seed: int | None = None
    scheme: Scheme | None = None
    actuator: Actuator | None = None
    # In a terminal of 80 columns, longer unbroken text in its description would be cut.
    faults: list[str] | None = None


@dataclass(frozen=True, kw_only=True)
class ProcessOptions:
    """External agents, real inverters, keys, and how the processes use the machine.

    --external AGENT: Do not start this agent; wait for your own device: c2/inv07, c2, central or
        plant. May be given several times.
    --device NODE=ADDRESS (devices): Use a real inverter, over Modbus TCP:
        NODE=modbus://10.0.0.7/1. May be given several times.
    --external-timeout SECONDS (external_timeout_s): How long to wait for external agents and other
        hosts. Once all are there, they have 30 s to answer the arming rounds.
    --base-port PORT: Listen on this port and those after it, with the plant's name as namespace, so
        that a device is configured once.
    --secure: Encrypt every link, and admit agents only by the certificates of `heliarch keys`.
    --keys DIR: Folder of the keys; default keys/PLANT.
    --address ADDRESS: Address at which the agents listen, for devices and controllers on other
        hosts; needs --secure.
    --on ADDRESS=AGENTS: Leave these controllers to `heliarch node` on the host with this address:
        10.0.0.2=c2/*,c3/inv12. May be given several times.
    --cpus CPUS: Run the processes on these processors: 0-1, or plant=0 for one kind (recorder,
        plant, central, supervisor, direct). May be given several times.
    --priority PRIORITY: In real time: run plant and controllers under SCHED_FIFO with this
        priority, 1 to 99, if the machine permits it.
    """

    external: list[str] | None = None
    devices: list[str] | None = None
    external_timeout_s: float = 60.0
    base_port: int | None = None
    secure: bool | None = None
    keys: Path | None = None
    address: str = "127.0.0.1"
    on: list[str] | None = None
    cpus: list[str] | None = None
    priority: int | None = None


@dataclass(frozen=True)
class RunOptions(ProcessOptions, PlantOptions, TimeOptions):
    """What is asked for, beside a scenario, of any run.

    `timing` sets its own length of the cycle.
    """

    pace: str | float | None = None
    cycle_s: float | None = None
