"""What the examples need of docs/wire.md: the plan, a Zenoh session, messages with their heads."""

from __future__ import annotations

import json
import queue
import time
from pathlib import Path
from typing import Any

import msgpack
import zenoh

PROTOCOL = 4  # Version of docs/wire.md that the examples were written from.


class Member:
    """An agent of a plan on the bus: its session, what has arrived, and the messages it sends.

    It listens if the plan has a port for it. `endpoints` take the place of the plan's ports of
    those that it talks to.
    """

    def __init__(
        self, plan: dict[str, Any], agent: str, talks_to: list[str], endpoints: list[str]
    ) -> None:
        self.plan, self.agent = plan, agent
        is_node = agent not in {"plant", "operator"}
        self.prefix = f"{plan['plant']}/{agent}" if is_node else plan["plant"]
        self.arrived: queue.SimpleQueue[zenoh.Sample] = queue.SimpleQueue()
        self.declared: list[object] = []  # It holds for as long as there is a name for it.
        self.cycle, self.incarnation, self.ready_ns = -(2**31), 0, 0  # No cycle has begun.
        self.missing: list[str] = []
        self.sequences: dict[str, int] = {}  # The next number on each key.
        self.session = zenoh.open(session_config(plan, agent, talks_to, endpoints))

    def join(self, *keys: str) -> None:
        """Hear some keys, then show that it is there."""
        for key in keys:
            self.declared.append(
                self.session.declare_subscriber(f"{self.plan['plant']}/{key}", self.arrived.put)
            )
        alive = f"{self.plan['plant']}/{self.agent}/alive"
        self.declared.append(self.session.liveliness().declare_token(alive))

    def watch(self, agent: str) -> None:
        """Hear when an agent appears or disappears."""
        alive, liveliness = f"{self.plan['plant']}/{agent}/alive", self.session.liveliness()
        watch = liveliness.declare_subscriber(alive, self.arrived.put, history=True)
        self.declared.append(watch)

    def publish(self, signal: str, **fields: object) -> None:
        """Send a message of this cycle."""
        sequence, timing = 0, self.plan["timing"]
        if self.cycle >= 0:
            sequence = self.sequences.get(signal, 0)
            self.sequences[signal] = sequence + 1
        message = {
            "cycle": self.cycle,
            "sim_time_ns": timing["start_time_ns"] + self.cycle * timing["cycle_ns"],
            "source": self.agent,
            "missing": self.missing,
            "ready_time_ns": self.ready_ns,
            "publish_time_ns": time.monotonic_ns(),
            "sequence": sequence,
            "incarnation": self.incarnation,
            **fields,
        }
        self.session.put(
            f"{self.prefix}/{signal}",
            msgpack.packb(message),
            encoding="application/msgpack",
            congestion_control=zenoh.CongestionControl.BLOCK,
        )


def read_plan(path: Path) -> dict[str, Any]:
    """Return the plan of a run, as soon as the launcher has written it."""
    while True:
        try:
            plan: dict[str, Any] = json.loads(path.read_text())
            break
        except (FileNotFoundError, json.JSONDecodeError):
            time.sleep(0.1)
    if plan["protocol"] != PROTOCOL:
        raise SystemExit(f"expected a plan of protocol {PROTOCOL}, got {plan['protocol']}")
    return plan


def session_config(
    plan: dict[str, Any], agent: str, talks_to: list[str], endpoints: list[str]
) -> zenoh.Config:
    """Zenoh as a peer that does not search: it connects to the agents it talks to."""
    access = plan["access"]
    ports, keys_folder, link = access["tcp_ports"], access["keys_folder"], "tcp"
    settings: dict[str, object] = {}
    if keys_folder:
        own, link = Path(keys_folder) / agent.replace("/", "."), "tls"
        settings["transport/link/tls"] = {
            "root_ca_certificate": str(Path(keys_folder) / "ca.pem"),
            "enable_mtls": True,
            **dict.fromkeys(("listen_certificate", "connect_certificate"), f"{own}.pem"),
            **dict.fromkeys(("listen_private_key", "connect_private_key"), f"{own}.key"),
        }
    where = {name: access["addresses"].get(name, access["address"]) for name in ports}
    settings |= {
        "mode": "peer",
        "namespace": access["namespace"] or plan["run_id"],
        # Without an entry Zenoh listens on a port of its own choice.
        "listen/endpoints": [f"{link}/{where[agent]}:{ports[agent]}"] if agent in ports else [],
        "connect/endpoints": endpoints
        or [f"{link}/{where[name]}:{ports[name]}" for name in talks_to if name in ports],
        "connect/timeout_ms": -1,
        "connect/exit_on_failure": False,
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
    }
    if not plan["timing"]["cycle_wall_ns"]:
        # In lockstep all agents wait for one that stands still; by default Zenoh closes its links.
        block = "transport/link/tx/queue/congestion_control/block"
        settings[f"{block}/wait_before_close"] = 60_000_000  # Microseconds.
        settings["transport/link/tx/lease"] = 60_000  # Milliseconds.
    config = zenoh.Config()
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    return config
