"""Who may say and hear what: Zenoh's access rules, derived from the table of signals.

Every agent enforces its own rules on each of its links. As each pair of agents has a link of its
own and peers do not relay, the other end of a link is the publisher of what comes over it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import TypeAlias

from bus_schemas.keys import KeyTable
from bus_schemas.links import Links
from bus_schemas.signals import Wiring
from bus_schemas.tree import RECORDER, agent_of

Subject: TypeAlias = dict[str, list[str]]
"""How Zenoh recognises the other end of a link. Empty: anybody."""

_LONGEST_COMMON_NAME = 64
"""Characters, by RFC 5280."""


def access_rules(
    agent: str,
    namespace: str,
    keys: KeyTable,
    wiring: Wiring,
    links: Links,
    subjects: Mapping[str, Subject],
) -> dict[str, object]:
    """Return an agent's rules as Zenoh's configuration wants them: what is not allowed is refused.

    agent, namespace, keys, wiring, links: The agent, and who says what to whom in its run.
    subjects: By agent, how the others recognise it. An entry for the empty name stands for anybody:
        of them the recorder hears all, so that it can name who says what they may not.
    """
    rules: list[dict[str, object]] = []
    policies: list[dict[str, object]] = []

    def add(
        rule: str, flows: list[str], messages: list[str], keys: list[str], permission: str = "allow"
    ) -> str:
        key_exprs = [f"{namespace}/{key}" for key in keys]
        one = {"id": rule, "permission": permission, "flows": flows, "messages": messages}
        rules.append({**one, "key_exprs": key_exprs})
        return rule

    def between(publisher: str, listener: str) -> list[str]:
        """Keys of what one process may say to another: the recorder hears everything."""
        return [
            keys.key(port)
            for port in wiring.published.get(agent_of(publisher), ())
            if listener == RECORDER or listener in wiring.processes[port]
        ]

    listens = ["declare_subscriber", "declare_liveliness_subscriber", "liveliness_query"]
    # In lockstep a process that replaces another asks for what it has missed.
    listens += ["declare_queryable", "query"]
    of_all = [
        add("subscriptions", ["ingress", "egress"], listens, [f"{keys.plant}/**"]),
        add("own token", ["egress"], ["liveliness_token"], [keys.alive_key(agent)]),
    ]
    known: dict[str, Subject] = {}
    for peer in links.peers(agent):
        known[peer] = subjects[peer]
        own = [add(f"token of {peer}", ["ingress"], ["liveliness_token"], [keys.alive_key(peer)])]
        if heard := between(peer, agent):
            own.append(add(f"from {peer}", ["ingress"], ["put", "reply"], heard))
        if told := between(agent, peer):
            own.append(add(f"to {peer}", ["egress"], ["put", "reply"], told))
        policies.append({"rules": [*of_all, *own], "subjects": [peer]})
    if agent == RECORDER and "" in subjects:
        known["anybody"] = subjects[""]
        from_anybody = add("from anybody", ["ingress"], ["put"], ["**"])
        # What a client says, peers pass on to whoever may hear it from them.
        own_keys = [keys.key(port) for port in wiring.published[agent]]
        not_own = add("not in its name", ["ingress"], ["put"], own_keys, "deny")
        policies.append({"rules": [*of_all, from_anybody, not_own], "subjects": ["anybody"]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": [{"id": name, **subject} for name, subject in known.items()],
        "policies": policies,
    }


def session_id(secret: str, agent: str) -> str:
    """Return the Zenoh id of an agent's session in a run with this secret.

    Whoever links with the agent learns it.
    """
    return f"a{_digest(secret, f'id of {agent}')}"  # Zenoh accepts no leading zero.


def password(secret: str, agent: str) -> str:
    """Return what an agent proves itself with, in a run with this secret, where it connects to."""
    return _digest(secret, f"password of {agent}")


def _digest(secret: str, text: str) -> str:
    return hashlib.blake2b(text.encode(), key=secret.encode(), digest_size=15).hexdigest()


def common_name(agent: str) -> str:
    """Return the name that an agent's certificate is for."""
    if len(agent) <= _LONGEST_COMMON_NAME:
        return agent
    return hashlib.blake2b(agent.encode(), digest_size=32).hexdigest()
