"""The control graph as HELICS federates, each a process with a core of its own.

    python benchmarks/peer_helics.py CYCLES

Prints one JSON document; `peers.py` runs it. HELICS gives a federate its values when it grants the
time that the federate requests. Each hop of a cycle is one unit of time: the plant acts at 6k,
direct controllers at 6k+1 and 6k+5, supervisors at 6k+2 and 6k+4, the central controller at 6k+3.
Each federate requests the times at which it acts and is `uninterruptible`, as the HELICS guide to
timing optimisation recommends. An output delay of 0.9 lets HELICS see that a value published now
cannot matter before the next hop, which helped; `single_thread_federate` is set because it is true.

The core is `ipc`: beside it, `zmq`, `tcp` and `tcp_ss` took five to ten times as long and `zmq_ss`
longer still. On a busy machine `ipc` itself varies by ten times from run to run. Federates that
request the largest time and wait to be interrupted by their inputs did not get to the end.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import signal
import sys
import time
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Final

import helics as h
import peer_graph

from agents.process.machine import die_with_parent

HOPS: Final = 6
TIMES: Final = {"plant": (6,), "direct": (1, 5), "supervisor": (2, 4), "central": (3,)}
OUTPUT_DELAY: Final = 0.9
START_LIMIT_S: Final = 30.0
CORE: Final = "ipc"


def broker(address: str, ready: Connection) -> None:
    die_with_parent()
    federates, where = len(peer_graph.NAMES), f"--local_interface={address}"
    options = f"--federates={federates} --name={address} --loglevel=error {where}"
    started = h.helicsCreateBroker(CORE, address, options)
    ready.send(bool(h.helicsBrokerIsConnected(started)))
    h.helicsBrokerWaitForDisconnect(started, -1)


def federate(name: str, cycles: int, address: str, out: Connection) -> None:
    die_with_parent()
    node = peer_graph.node(name)
    value_federate = _connect(name, address)
    says = {key for stage in node.stages for key in stage.says}
    hears = {key for stage in node.stages for key in stage.hears}
    double = h.HELICS_DATA_TYPE_DOUBLE
    publications = {
        key: h.helicsFederateRegisterGlobalPublication(value_federate, key, double, "")
        for key in says
    }
    inputs = {key: h.helicsFederateRegisterSubscription(value_federate, key, "") for key in hears}
    h.helicsFederateEnterExecutingMode(value_federate)
    began = time.monotonic()
    if isinstance(node, peer_graph.Plant):
        for key, value in zip(node.stages[0].says, node.begin(), strict=True):
            h.helicsPublicationPublishDouble(publications[key], value)
    times = TIMES[peer_graph.kind(name)]
    for cycle in range(cycles):
        for stage, due in zip(node.stages, times, strict=True):
            h.helicsFederateRequestTime(value_federate, cycle * HOPS + due)
            heard = [h.helicsInputGetDouble(inputs[key]) for key in stage.hears]
            for key, value in zip(stage.says, stage.act(heard), strict=True):
                h.helicsPublicationPublishDouble(publications[key], value)
    if isinstance(node, peer_graph.Plant):
        out.send((began, time.monotonic(), node.delivered_kw))
    h.helicsFederateDisconnect(value_federate)
    h.helicsCloseLibrary()


def _connect(name: str, address: str) -> Any:
    plain = name.replace("/", "-")  # The ipc core makes a file of this name.
    options = f"--federates=1 --loglevel=error --broker_address={address}"
    info = h.helicsCreateFederateInfo()
    h.helicsFederateInfoSetCoreName(info, f"{address}-{plain}")
    h.helicsFederateInfoSetCoreTypeFromString(info, CORE)
    h.helicsFederateInfoSetCoreInitString(info, options)
    h.helicsFederateInfoSetTimeProperty(info, h.HELICS_PROPERTY_TIME_PERIOD, 1.0)
    h.helicsFederateInfoSetTimeProperty(info, h.HELICS_PROPERTY_TIME_DELTA, 1.0)
    h.helicsFederateInfoSetTimeProperty(info, h.HELICS_PROPERTY_TIME_OUTPUT_DELAY, OUTPUT_DELAY)
    h.helicsFederateInfoSetFlagOption(info, h.HELICS_FLAG_UNINTERRUPTIBLE, True)
    h.helicsFederateInfoSetFlagOption(info, h.HELICS_FLAG_SINGLE_THREAD_FEDERATE, True)
    return h.helicsCreateValueFederate(plain, info)


def run(cycles: int) -> dict[str, object]:
    """Run the graph; return when its cycles began and ended, and what the plant delivered."""
    address = f"helics-{os.getpid()}"
    fork = multiprocessing.get_context("fork")
    result, out = fork.Pipe(duplex=False)
    ready, ready_out = fork.Pipe(duplex=False)
    # Nothing of HELICS is running yet in this process, so it may fork.
    processes = [fork.Process(target=broker, args=(address, ready_out), daemon=True)]
    processes[0].start()
    if not ready.poll(START_LIMIT_S) or not ready.recv():
        raise RuntimeError("the broker did not start")
    for name in peer_graph.NAMES:
        process = fork.Process(target=federate, args=(name, cycles, address, out), daemon=True)
        process.start()
        processes.append(process)
    out.close()
    try:
        began, ended, delivered_kw = result.recv()
        for process in processes:
            process.join(5.0)
    finally:
        for left in Path("/dev/shm").glob(f"{address.replace('-', '?')}*"):
            left.unlink()
    return {"began": began, "ended": ended, "cycles": cycles, "delivered_kw": delivered_kw}


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # Leave no shared memory behind.
    print(json.dumps(run(int(sys.argv[1]))))
