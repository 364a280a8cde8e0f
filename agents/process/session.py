"""How an agent of a plan joins the bus: its links, its identity, and what it accepts.

Every agent enforces its own rules on each of its links. Peers do not relay, so the agent at the
other end has published whatever comes over a link.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TypeAlias

from agents.plan import RunPlan
from bus_schemas.errors import InputError
from bus_schemas.tree import RECORDER
from bus_schemas.wiring import Links
from bus_schemas.zenoh_session import (
    LONGEST_LEASE_S,
    SOCKET,
    SUBSCRIBER_BATCH_BYTES,
    KeyFiles,
    SessionSettings,
)

_LARGEST_BYTES = 65_536
_BYTES_PER_INVERTER = 64
"""A message is not larger than this: the plant's `production` has two numbers for each inverter,
and `missing` names a few inputs of each child."""

_LEASE_S = 8.0
_OPEN_S = 3.0
_PER_PROCESS_S = 0.05
"""See `link_times`. A process that is frozen for less than a lease keeps its links, and an agent
that was cut off is heard 5 s after its link has healed. Among 1,000 inverters a short lease costs a
processor, and plant and recorder open 1,000 links one after the other. In lockstep a link that
closes loses messages that others wait for: both times are 60 s."""

_WAIT_S = (0.02, 0.5)
_WAIT_SHARE = 0.1
"""In real time: how long a message may wait for room in the queue of a link, at least and at most,
and as a share of the cycle. 1,000 inverters of a group get theirs at once, while other groups take
the processors: with 20 ms, `ten-thousand` lost telemetry at one cycle a second."""

_LONGEST_COMMON_NAME = 64
"""Characters, by RFC 5280."""

Subjects: TypeAlias = dict[str, dict[str, list[str]]]
"""By agent, how Zenoh recognises it at the other end of a link. The empty name stands for any
program: the recorder accepts all messages, so that it can name the senders of forbidden ones."""


def session_settings(plan: RunPlan, agent: str) -> SessionSettings:
    """Return how a process of the plan joins the bus.

    With keys, a certificate names the agent at the other end of a link. Without, processes of ours
    link on sockets that no other user can reach. A device cannot, so an agent that talks to one has
    a second session for it, on TCP, in which any program may say what the device may. A replay has
    neither keys nor sockets: any program may join.
    """
    links, access = plan.links, plan.access
    if access.keys_folder:
        keys = KeyFiles.of(Path(access.keys_folder), agent)
        subjects: Subjects = {
            peer: {"cert_common_names": [common_name(peer)]} for peer in links.peers(agent)
        }
        return _settings(plan, agent, links, access.endpoint, subjects, keys.config())
    if not access.sockets:
        return _settings(plan, agent, links, access.endpoint)
    external = {*access.external}
    own = Links(tuple(pair for pair in links.pairs if external.isdisjoint(pair)))
    to_devices = Links(tuple(pair for pair in links.pairs if not external.isdisjoint(pair)))
    devices = to_devices.peers(agent)
    any_program: Subjects = {peer: {} for peer in ("", *devices)}
    second = _settings(plan, agent, to_devices, access.endpoint, any_program)
    if agent in access.external:
        return second
    check_sockets(Path(access.sockets))
    names = {name: str(number) for number, name in enumerate(plan.processes)}
    settings = _settings(plan, agent, own, lambda name: f"{SOCKET}/{access.sockets}/{names[name]}")
    return replace(settings, devices=second) if devices else settings


def check_sockets(folder: Path) -> None:
    """Make a folder of sockets if it is not there; refuse one that another user can enter."""
    folder.mkdir(mode=0o700, exist_ok=True)
    found = folder.stat()
    if found.st_uid != os.getuid() or found.st_mode & 0o077:
        raise InputError(f"{folder}: expected a folder that its user alone can enter")


def link_times(plan: RunPlan) -> tuple[float, float]:
    """Return how long nothing may come over a link, and how long it may take to open [s]."""
    if plan.timing.lockstep:
        return (LONGEST_LEASE_S, LONGEST_LEASE_S)
    among_many_s = _PER_PROCESS_S * len(plan.processes)
    return (max(_LEASE_S, among_many_s), max(_OPEN_S, among_many_s))


def _settings(
    plan: RunPlan,
    agent: str,
    links: Links,
    endpoint_of: Callable[[str], str],
    subjects: Subjects | None = None,
    further: dict[str, object] | None = None,
) -> SessionSettings:
    listen, connect = links.endpoints(agent, endpoint_of)
    largest_bytes = _LARGEST_BYTES + _BYTES_PER_INVERTER * len(plan.inverters)
    further = {"transport/link/rx/max_message_size": largest_bytes, **(further or {})}
    lease_s, open_s = link_times(plan)
    shortest_s, longest_s = _WAIT_S
    wait_s = min(max(shortest_s, _WAIT_SHARE * plan.timing.cycle_wall_ns / 1e9), longest_s)
    if plan.access.external:  # zenoh-pico closes a link that is idle for 10 s.
        further["transport/link/tx/keep_alive"] = max(4, round(lease_s / 5.0))
    if agent == RECORDER:
        further["transport/link/tx/batch_size"] = SUBSCRIBER_BATCH_BYTES
    if subjects is not None:
        further["access_control"] = _access_rules(plan, agent, links, subjects)
    return SessionSettings(
        plan.bus_namespace,
        listen,
        connect,
        plan.timing.lockstep,
        lease_s,
        open_s,
        wait_s,
        further=further,
        peers=links.peers(agent),
    )


def _access_rules(plan: RunPlan, agent: str, links: Links, subjects: Subjects) -> dict[str, object]:
    """Return an agent's access rules, as in Zenoh's configuration; all else is refused."""
    wiring = plan.wiring
    rules: list[dict[str, object]] = []
    policies: list[dict[str, object]] = []

    def add(
        rule: str, flows: list[str], messages: list[str], keys: list[str], permission: str = "allow"
    ) -> str:
        key_exprs = [f"{plan.bus_namespace}/{key}" for key in keys]
        one = {"id": rule, "permission": permission, "flows": flows, "messages": messages}
        rules.append({**one, "key_exprs": key_exprs})
        return rule

    def between(publisher: str, listener: str) -> list[str]:
        bundles = [
            wiring.key(bundle)
            for bundle in wiring.bundles
            if bundle.source == publisher and listener in {RECORDER, *bundle.sinks}
        ]
        return [*wiring.key_exprs(wiring.carried.get((publisher, listener), ())), *bundles]

    listens = ["declare_subscriber", "declare_liveliness_subscriber", "liveliness_query"]
    # In lockstep a process that replaces another queries what it has missed.
    listens += ["declare_queryable", "query"]
    of_all = [
        add("subscriptions", ["ingress", "egress"], listens, [f"{wiring.plant}/**"]),
        add("own token", ["egress"], ["liveliness_token"], [wiring.alive_key(agent)]),
    ]
    for peer in links.peers(agent):
        own = [add(f"token of {peer}", ["ingress"], ["liveliness_token"], [wiring.alive_key(peer)])]
        if heard := between(peer, agent):
            own.append(add(f"from {peer}", ["ingress"], ["put", "reply"], heard))
        if published := between(agent, peer):
            own.append(add(f"to {peer}", ["egress"], ["put", "reply"], published))
        policies.append({"rules": [*of_all, *own], "subjects": [peer]})
    known = {peer: subjects[peer] for peer in links.peers(agent)}
    if agent == RECORDER and "" in subjects:
        known["any program"] = subjects[""]
        from_any = add("from any program", ["ingress"], ["put"], ["**"])
        # Peers do relay for clients, so a client could send in the recorder's name.
        own_keys = [wiring.key(port) for port in wiring.ports if port.publisher == agent]
        not_own = add("not in its name", ["ingress"], ["put"], own_keys, "deny")
        policies.append({"rules": [*of_all, from_any, not_own], "subjects": ["any program"]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": [{"id": name, **subject} for name, subject in known.items()],
        "policies": policies,
    }


def common_name(agent: str) -> str:
    if len(agent) <= _LONGEST_COMMON_NAME:
        return agent
    return hashlib.blake2b(agent.encode(), digest_size=32).hexdigest()
