"""The health of a run in words: what its recording says, and what only its launcher knew."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Final

from agents.faults import Fault
from bus_schemas.errors import listed
from bus_schemas.faults import UNHEARD, Blackout, Disturbance
from bus_schemas.tree import RECORDER
from recordings.inspect.overview import Overview
from recordings.read.run_clock import RunClock
from results.run_document import Outcome
from scenarios.fault_rules import fault_text

_NAMED: Final = 5
"""How many of each kind the text names; the others are counted."""


def health_lines(
    overview: Overview, clock: RunClock, outcome: Outcome
) -> Iterator[tuple[str, str]]:
    document = outcome.document
    faults = clock.plan.faults.rules
    if not faults:
        yield "faults", "none injected"
    for fault in faults:
        yield "fault", f"{fault_text(fault)}{_nothing_done(fault, overview, clock)}"
    yield "missing", _missing(overview, outcome)
    if overview.repeated:
        yield "repeated", f"{overview.repeated:,} messages came again"
    yield "dropped", _dropped(outcome)
    yield "inputs", _missed_text(overview, clock)
    for span in overview.states[:_NAMED]:
        yield "states", span.text(clock)
    if others := len(overview.states[_NAMED:]):
        yield "states", f"and {others:,} more"
    # Messages show which agents restarted; the recorder publishes none.
    if recorder := document.restarts.get(RECORDER) if document else None:
        yield "states", f"{RECORDER}: restarted ({recorder:,})"
    elif not overview.states:
        yield "states", "no agent was absent, cut off or given up"
    for name, cycle in document.given_up.items() if document else ():
        yield "given up", f"{name} {clock.span_text(cycle, cycle)}"
    yield "run", outcome.text


def _missing(overview: Overview, outcome: Outcome) -> str:
    """Say what was lost: sequence numbers do not show what the recording lacks at its end."""
    seen, document = overview.messages_lost, outcome.document
    if document is None or document.lost <= seen:
        return f"{seen:,} messages not recorded{_named(overview.lost)}"
    return f"{document.lost:,} messages not recorded, {seen:,} of them before the recording's end"


def _nothing_done(fault: Fault, overview: Overview, clock: RunClock) -> str:
    """Say why a fault did nothing; empty if it acted."""
    if isinstance(fault, Disturbance | Blackout) and fault.signal in UNHEARD:
        return f": changed nothing, no agent acts on {fault.signal}"
    first = int(fault.begin_s * 1e9 / clock.plan.timing.cycle_ns)
    return f": never acted, it begins in cycle {first:,}" if first > overview.last_cycle else ""


def _dropped(outcome: Outcome) -> str:
    if (document := outcome.document) is None:
        return f"not recorded: {outcome.undocumented}"
    dropped, skipped = document.dropped, document.skipped_cycles
    wrong = [f"{w.count:,} {w.cause} on {w.key}" for w in document.wrong]
    parts = [f"{sum(dropped.values()):,} messages that agents could not use{_named(dropped)}"]
    parts += [f"{skipped:,} cycles skipped"] if skipped else []
    parts += [f"wrong: {listed(wrong, _NAMED)}"] if wrong else []
    return "; ".join(parts)


def counts_text(counts: dict[str, int]) -> str:
    return ", ".join(f"{count:,} {name}" for name, count in counts.items())


def _named(counts: Mapping[str, int]) -> str:
    """List the first counts with their names, after a colon; empty if there are none."""
    named = listed([f"{name} {count:,}" for name, count in counts.items()], _NAMED)
    return f": {named}" if named else ""


def _missed_text(overview: Overview, clock: RunClock) -> str:
    misses = overview.misses
    if not misses:
        return "none missed at a deadline"
    first = min(one.first_cycle for one in misses)
    last = max(one.last_cycle for one in misses)
    worst = _named({one.agent: one.inputs for one in misses})
    used = f"{overview.missing_inputs:,} missed and {overview.old_inputs:,} older ones used"
    return f"{used} {clock.span_text(first, last)}, most at{worst}"
