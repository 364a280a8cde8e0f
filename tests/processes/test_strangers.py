"""Messages that do not belong on the bus are dropped, counted and named; they stop nobody."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import msgspec
import pytest
import zenoh
from running import Heliarch, assert_none_left

from agents.plan import RunPlan, load_plan
from bus_schemas.codec import encode
from bus_schemas.messages import Impp
from bus_schemas.zenoh_bus import SessionSettings

pytestmark = pytest.mark.processes

Start = Callable[..., Heliarch]


@contextmanager
def stranger_at(plan: RunPlan, agent: str) -> Iterator[zenoh.Session]:
    """A session that is linked with an agent of the run, and is none itself."""
    endpoint = f"tcp/127.0.0.1:{plan.tcp_ports[agent]}"
    with zenoh.open(SessionSettings(plan.run_id, [], [endpoint]).config()) as session:
        yield session


def impp(cycle: int, source: str) -> bytes:
    """An IMPP message as it would be on the wire."""
    return encode(Impp(cycle, 0, source, (), power_kw=1e9, stale_cycles=0))


def test_strange_messages_are_named_counted_and_harmless(heliarch: Start) -> None:
    run = heliarch("launch", "oahu", "--duration", "5h")
    run.until_running()
    plan = load_plan(run.folder / "plan.json")
    child = plan.tree.children("c1")[0]
    strange = {
        f"oahu/{child}/impp": {
            b"\xc1 garbage": "does not decode",
            impp(0, "c9/inv99"): "is from 'c9/inv99'",
            impp(0, child): "is of cycle 0, this is",
            impp(10**9, child): "is of cycle 1000000000, this is",
        },
        "oahu/c1/inv99/impp": {impp(0, "c1/inv99"): "is of a node or signal that this run"},
    }
    log = run.folder / "logs" / "c1.log"
    with stranger_at(plan, "c1") as session:
        for key, payloads in strange.items():
            for payload, complaint in payloads.items():
                run.until(said(session, key, payload, log.read_text, complaint), complaint)
    run.process.send_signal(signal.SIGINT)
    assert run.wait() == 130, run.error_text()
    dropped = msgspec.json.decode((run.folder / "summary.json").read_bytes())["dropped"]
    assert set(dropped) == {"undecodable", "foreign", "late", "other_cycle", "unknown"}
    assert_none_left(run.folder)


def said(
    session: zenoh.Session, key: str, payload: bytes, log: Callable[[], str], complaint: str
) -> Callable[[], bool]:
    """Send until the log complains: the first sends may go before the link is up."""

    def attempt() -> bool:
        session.put(key, payload)
        return complaint in log()

    return attempt
