"""Recordings made by hand, of four inverters that say in each cycle what real ones do."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from msgspec.structs import replace
from plans_by_hand import plan_at_noon
from plants_by_hand import dispatch, head, memory, meter, report, setpoint, telemetry

from agents.plan import RunPlan
from bus_schemas import messages, signals
from bus_schemas.bus import Delivery, Outbox
from bus_schemas.codec import encode
from bus_schemas.messages import Message
from bus_schemas.signals import Port
from bus_schemas.tree import PLANT, ROOT, parent_of
from recordings.read.mcap_file import Chunk
from recordings.read.reader import RunReader
from recordings.record.writer import ClockAnchor, RunWriter

PLAN = plan_at_noon(run_id="by-hand-2", plant="field", cycles=1000, period_cycles=(2, 1))
SCENARIO = 'name = "field"\ntitle = "Four inverters"\n'


def cycle_of_the_plant(cycle: int) -> Iterator[Delivery]:
    """All messages of one cycle. `c1/a` lacks 20 kW of its share, `c1/b` gives them."""
    for port, message in _cycle(cycle):
        yield port, replace(message, sim_time_ns=PLAN.timing.sim_time_ns(cycle))


def _cycle(cycle: int) -> Iterator[Delivery]:
    tree = PLAN.tree
    for leaf in tree.leaves:
        yield telemetry(leaf, cycle, 50.0 + cycle % 7, alpha=0.5)
    yield dispatch(cycle, 240.0, tree.rating_kw(ROOT), regulation_kw=10.0)
    yield meter(cycle, 238.0)
    for node in reversed(tree.nodes):
        spare_kw = {"c1/a": -20.0, "c1/b": 30.0}.get(node, 15.0)
        yield from report(node, cycle, 0.6 * tree.rating_kw(node) + spare_kw, spare_kw)
        if spare_kw < 0.0:
            yield signals.HELP.of(node), messages.Help(*head(cycle, node), missing_kw=-spare_kw)
    for node in tree.nodes[1:]:
        if cycle % 2 == 0 or parent_of(node) != ROOT:  # The central controller's turn.
            extra_kw = {"c1/a": -20.0, "c1/b": 20.0}.get(node, 0.0)
            share_kw = 0.6 * tree.rating_kw(node)
            given = (messages.HelpGiven("c1/a", 20.0),) if node == "c1/b" else ()
            yield setpoint(node, cycle, share_kw + extra_kw, share_kw, given)
    yield memory(cycle)
    for leaf in tree.leaves:
        command = messages.Command(*head(cycle, leaf), alpha=0.8, power_kw=60.0)
        yield signals.COMMAND.of(leaf), command
    production = messages.Production(
        *head(cycle, PLANT),
        dispatch_kw=240.0,
        available_kw=280.0,
        delivered_kw=239.0,
        inverter_mpp_kw=(40.0, 90.0, 75.0, 75.0),
        inverter_power_kw=(40.0, 80.0, 60.0, 59.0),
    )
    yield signals.PRODUCTION.of(ROOT), production


def whole_run(cycles: int) -> Iterator[Delivery]:
    """All messages of a run, with the plant's words that it begins and that it is over."""
    yield signals.RUN.of(ROOT), PLAN.run_message("start", 0, 1)
    for cycle in range(cycles):
        yield from cycle_of_the_plant(cycle)
    yield signals.RUN.of(ROOT), PLAN.run_message("stop", cycles, 1)


Logged = tuple[Port[Message], Message, int]
"""A message as it is written: with the monotonic time at which it was recorded."""


def write_messages(
    path: Path,
    deliveries: Iterable[Delivery | Logged],
    *,
    plan: RunPlan = PLAN,
    scenario: str = SCENARIO,
    driver: str = "simulate",
    anchor: ClockAnchor | None = None,
    messages_per_chunk: int = 200,
    close: bool = True,
) -> None:
    """Write messages as they are, recorded when they were published where no other time is given.

    A file that is not closed lacks its index: it ends after its last chunk.
    """
    writer = RunWriter(path, plan, scenario, driver, anchor)
    for number, entry in enumerate(deliveries, start=1):
        port, message = entry[:2]
        logged_ns = entry[2] if len(entry) == 3 else message.publish_time_ns
        writer.add(port, message, encode(message), logged_ns)
        if number % messages_per_chunk == 0:
            writer.flush()
    if close:
        writer.close()
    else:
        writer.flush()
        writer.abandon()


def numbered(
    deliveries: Iterable[Delivery], is_anew: Callable[[Delivery], bool] = lambda delivery: False
) -> Iterator[Delivery]:
    """Number messages as their senders do; those that another process sends, from 0 again."""
    outboxes = Outbox(), Outbox()
    for port, message in deliveries:
        outboxes[is_anew((port, message))].stamp(port, message, time.monotonic_ns())
        yield port, message


def write_run(
    path: Path,
    deliveries: Iterable[Delivery],
    *,
    plan: RunPlan = PLAN,
    messages_per_chunk: int = 200,
    is_kept: Callable[[Delivery], bool] = lambda delivery: True,
    close: bool = True,
) -> list[Delivery]:
    """Write those of the messages that are published in a run that reach the file; return them."""
    kept = [*filter(is_kept, numbered(deliveries))]
    write_messages(path, kept, plan=plan, messages_per_chunk=messages_per_chunk, close=close)
    return kept


def cut(recording: Path, to: Path | None = None, share: float = 0.5) -> None:
    """Cut a file in the middle of its messages; by default in its place."""
    content = recording.read_bytes()
    (to or recording).write_bytes(content[: round(share * len(content))])


def zero_chunk(recording: Path, number: int, to: Path | None = None) -> Chunk:
    """Zero a part of a chunk of a recording, by default in its place; return where it is."""
    with RunReader(recording) as run:
        chunk = run.outline.chunks[number]
    content = bytearray(recording.read_bytes())
    content[chunk.offset + 60 : chunk.offset + 120] = bytes(60)
    (to or recording).write_bytes(content)
    return chunk
