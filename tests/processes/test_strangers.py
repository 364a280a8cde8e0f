"""Messages that do not belong on the bus are dropped, counted and named; they stop nobody."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import zenoh
from running import Heliarch, assert_none_left, small_plant
from test_launch import summary_of

from agents.plan import RunPlan, load_plan
from bus_schemas.codec import encode
from bus_schemas.messages import Impp
from bus_schemas.zenoh_bus import SessionSettings

pytestmark = pytest.mark.processes

CHILD = "c1/inv01"


@contextmanager
def stranger_at(plan: RunPlan, agent: str) -> Iterator[zenoh.Session]:
    """A session that is linked with an agent of the run, and is none itself."""
    endpoint = f"tcp/127.0.0.1:{plan.tcp_ports[agent]}"
    with zenoh.open(SessionSettings(plan.run_id, [], [endpoint]).config()) as session:
        yield session


def impp(cycle: int, source: str) -> bytes:
    """An IMPP message as it would be on the wire."""
    return encode(Impp(cycle, 0, source, (), power_kw=1e9, stale_cycles=0))


def test_strange_messages_are_named_counted_and_harmless(
    heliarch: Callable[..., Heliarch], tmp_path: Path
) -> None:
    run = heliarch("launch", small_plant(tmp_path / "plant"), "--pace", "20")
    run.until_running()
    plan = load_plan(run.folder / "plan.json")
    strange = (b"\xc1 garbage", impp(0, "c9/inv99"), impp(0, CHILD), impp(10**9, CHILD))
    log = run.folder / "logs" / "c1.log"

    def named() -> bool:
        """Send until all are named: the first ones may go before the link is up."""
        for payload in strange:
            session.put(f"small/{CHILD}/impp", payload)
        return all(text in log.read_text() for text in ("c9/inv99", "cycle 0 ", "cycle 1000000000"))

    with stranger_at(plan, "c1") as session:
        run.until(named, "complaints")
    run.process.send_signal(signal.SIGINT)
    assert run.wait() == 130, run.error_text()
    summary = summary_of(run.folder)
    account = next(process for process in summary.processes if process.agent == "c1")
    assert {"undecodable", "foreign", "late", "other_cycle"} <= set(account.dropped)
    assert {process.agent for process in summary.processes if process.dropped} == {"c1"}
    assert_none_left(run.folder)
