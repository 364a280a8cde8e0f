"""The control graph as mosaik simulators, each a subprocess.

    python benchmarks/peer_mosaik.py CYCLES

Prints one JSON document; `peers.py` runs it. Mosaik resolves a loop either with weak connections
inside one time step (same-time loops of event-based simulators) or with time-shifted connections.
Same-time loops do not run this graph: in mosaik 3.6.0 a simulator that is stepping does not hold
back those that it may trigger (`advance_progress` in its scheduler), and the run stops with
"cannot progress backwards". So the simulators are time-based, a cycle has three time steps, and
only the connections that lead back are shifted by one step, as mosaik's tutorial on cyclic data
flows recommends:

    3k    plant, direct (estimate), supervisor (report), central
    3k+1  supervisor (solve)
    3k+2  direct (command), applied by the plant at 3k+3

These are the same six serial hops. Six time steps, all connections shifted, were somewhat slower,
and so were `lazy_stepping` and the cache, which are off. No progress bar, no execution graph.
"""

from __future__ import annotations

import json
import shlex
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, Final

import mosaik
import mosaik_api_v3
import peer_graph
from loguru import logger
from mosaik.starters import CmdStarter

from agents.process.machine import die_with_parent

STEPS: Final = 3
TIMES: Final = {"plant": (0,), "direct": (0, 2), "supervisor": (0, 1), "central": (0,)}
ENTITY: Final = "node"


class NodeSimulator(mosaik_api_v3.Simulator):  # type: ignore[misc]
    """One node of the graph, with one attribute for each signal."""

    def __init__(self, name: str, cycles: int, result: Path) -> None:
        self.node, self.cycles, self.result = peer_graph.node(name), cycles, result
        self.times = TIMES[peer_graph.kind(name)]
        self.said = {signal: 0.0 for stage in self.node.stages for signal in stage.says}
        heard = [signal for stage in self.node.stages for signal in stage.hears]
        model = {"public": True, "params": [], "attrs": [*heard, *self.said]}
        super().__init__({"api_version": "3.0", "type": "time-based", "models": {"Node": model}})

    def init(self, sid: str, time_resolution: float) -> dict[str, Any]:
        meta: dict[str, Any] = self.meta
        return meta

    def create(self, num: int, model: str) -> list[dict[str, str]]:
        return [{"eid": ENTITY, "type": model}]

    def step(self, now: int, inputs: dict[str, Any], max_advance: int) -> int:
        cycle, place = divmod(now, STEPS)
        number = self.times.index(place)
        stage = self.node.stages[number]
        if now == 0 and isinstance(self.node, peer_graph.Plant):
            values = self.node.begin()
        else:
            heard = inputs[ENTITY]
            values = stage.act([next(iter(heard[signal].values())) for signal in stage.hears])
        self.said.update(zip(stage.says, values, strict=True))
        if cycle == self.cycles and isinstance(self.node, peer_graph.Plant):
            self.result.write_text(json.dumps(self.node.delivered_kw))
        if number + 1 < len(self.times):
            return cycle * STEPS + self.times[number + 1]
        return (cycle + 1) * STEPS + self.times[0]

    def get_data(self, outputs: dict[str, list[str]]) -> dict[str, Any]:
        return {ENTITY: self.said}


def run(cycles: int, result: Path) -> dict[str, object]:
    """Run the graph; return when its cycles began and ended, and what the plant delivered."""
    command = shlex.join([sys.executable, __file__, str(cycles), str(result)])
    simulators = {
        name: CmdStarter(f"{command} {name} %(addr)s --log-level error", posix=True)
        for name in peer_graph.NAMES
    }
    with mosaik.World(simulators, cache=False) as world:
        entities = {name: world.start(name).Node() for name in peer_graph.NAMES}
        stages = [(name, stage) for name in entities for stage in peer_graph.node(name).stages]
        sayers = {signal: name for name, stage in stages for signal in stage.says}
        for name, stage in stages:
            for signal in stage.hears:
                back = signal.endswith(("/setpoint", "/command"))
                shift = {"time_shifted": 1, "initial_data": {signal: 1.0}} if back else {}
                world.connect(entities[sayers[signal]], entities[name], signal, **shift)
        began = time.monotonic()
        world.run(until=cycles * STEPS + 1, print_progress=False, lazy_stepping=False)
        ended = time.monotonic()
    delivered_kw = json.loads(result.read_text())
    return {"began": began, "ended": ended, "cycles": cycles, "delivered_kw": delivered_kw}


def main() -> None:
    cycles = int(sys.argv[1])
    if len(sys.argv) == 2:
        logger.disable("mosaik")
        with tempfile.TemporaryDirectory() as folder:
            print(json.dumps(run(cycles, Path(folder) / "delivered.json")))
    else:
        die_with_parent()
        result, name = Path(sys.argv[2]), sys.argv[3]
        del sys.argv[1:4]  # The rest is for mosaik.
        mosaik_api_v3.start_simulation(NodeSimulator(name, cycles, result))


if __name__ == "__main__":
    main()
