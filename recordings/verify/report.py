"""The result of a verification as text, and as plain data for JSON."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping
from math import floor
from typing import Any, Final

import msgspec

from bus_schemas.errors import listed
from bus_schemas.messages import Message, in_words
from recordings.read.frames import HEAD_FIELDS
from recordings.read.run_clock import RunClock
from recordings.verify.comparison import (
    KINDS,
    LOSSES,
    NOT_COMPARED,
    AgentResult,
    Difference,
    Equality,
    Value,
)
from recordings.verify.verification import Verification

REPETITION: Final = (
    "this code on the recorded inputs: this proves repetition, not that decisions are right"
)
MOST_GAPS: Final = 10
"""Lines on spans that cannot be compared."""


def verification_lines(
    verification: Verification, equality: Equality, wall_s: float
) -> Iterator[str]:
    """Yield the result line by line; the last one is the verdict."""
    plan, agents = verification.plan, verification.agents
    speed = verification.cycles * plan.timing.cycle_ns / 1e9 / max(wall_s, 1e-9)
    yield (
        f"{verification.cycles:,} cycles, {len(agents)} agents run again in {wall_s:.1f} s, "
        f"{speed:,.0f} x simulated time"
    )
    for name, why in verification.left_out.items():
        yield f"{name}: left out, {why}"
    if verification.stop_cycle is None:
        yield "the run or its recording broke off: the last cycle of each agent may be incomplete"
    yield from _gap_lines(agents)
    if count := verification.misplaced:
        yield f"{count:,} messages belong to no cycle of the run, or come long after it"
    yield from difference_lines(agents, RunClock(plan, plan.timing.cycles - 1))
    if verification.same_code is False:
        yield "the recording was made by other code than this: the sources differ"
    yield REPETITION
    yield _verdict(verification, equality)


def _gap_lines(agents: Mapping[str, AgentResult]) -> Iterator[str]:
    """Yield the agents that cannot be compared in some cycles, together where these are equal."""
    found = defaultdict[tuple[int, int | None], list[tuple[str, str]]](list)
    for agent, result in agents.items():
        for gap in result.gaps:
            found[gap.since, gap.until].append((agent, gap.why))
    if len(found) > MOST_GAPS:
        yield f"not comparable in {len(found):,} spans, the first {MOST_GAPS}:"
    for since, until in sorted(found, key=lambda span: span[0])[:MOST_GAPS]:
        (_, why), *others = found[since, until]
        names = listed([agent for agent, _ in found[since, until]], 3)
        span = f"from cycle {since:,} on"
        if until is not None:
            span = (
                f"in cycles {since:,} to {until - 1:,}"
                if until > since + 1
                else f"in cycle {since:,}"
            )
        yield f"{names}: not comparable {span}: {why}{' for the first of them' if others else ''}"


def difference_lines(agents: Mapping[str, AgentResult], clock: RunClock) -> Iterator[str]:
    """Yield the differences of each agent by kind, and the first of them."""
    for agent, result in agents.items():
        first, failure = result.first, result.failure
        if first is None:
            continue
        counts = ", ".join(f"{kind} ({count:,})" for kind, count in result.differences.items())
        yield ""
        yield f"{agent}: {counts}, {clock.span_text(first.cycle, result.last_cycle)}"
        yield from _lines_of(agent, first)
        if failure is not None and failure is not first:
            yield f"  fails in cycle {failure.cycle:,}: {failure.text}"


def verification_data(verification: Verification, wall_s: float) -> dict[str, Any]:
    names = (
        "equal",
        "asked",
        "share",
        "stop_cycle",
        "cycles",
        "differences",
        "misplaced",
        "left_out",
        "same_code",
    )
    first = verification.first
    return {
        "recording": str(verification.recording),
        "run_id": verification.plan.run_id,
        **{name: getattr(verification, name) for name in names},
        "compared": verification.total("compared"),
        "first_agent": None if first is None else first[0],
        "wall_s": wall_s,
        "agents": agents_data(verification.agents),
    }


def agents_data(agents: Mapping[str, AgentResult]) -> list[dict[str, Any]]:
    return [{"agent": name, **msgspec.to_builtins(result)} for name, result in agents.items()]


def _verdict(verification: Verification, equality: Equality) -> str:
    of = f"{verification.total('compared'):,} of {verification.asked:,} messages compared"
    if verification.first is not None:
        name, first = verification.first
        kinds = {kind for result in verification.agents.values() for kind in result.differences}
        what = f"NOT equal: {verification.differences:,} differences"
        if kinds <= LOSSES:
            what = "NOT whole: no agent decides otherwise, but messages are not recorded"
        return (
            f"{what}, the first: {name} in cycle {first.cycle}, "
            f"{first.message or first.text} ({first.kind}); {of}"
        )
    if verification.differs:
        return f"NOT equal: {of}"
    within = f"within {equality.tolerance:g}" if equality.tolerance else "bit for bit"
    if not verification.equal:
        percent = floor(1000.0 * verification.share) / 10.0
        within = f"as far as compared ({percent:g} %), {within}"
    return f"equal {within}: {of}; left out: {', '.join(NOT_COMPARED)}"


def _lines_of(agent: str, difference: Difference) -> Iterator[str]:
    stage = f" (stage {difference.stage})" if difference.stage else ""
    message, content = difference.content, difference.text
    if message is not None and difference.kind not in {"differs", "refused"}:
        content = _content(message)
    what = KINDS[difference.kind] + (f": {content}" if content else "")
    yield f"  {difference.message or 'the agent'}{stage}: {what}"
    width = max((len(entry.field) for entry in difference.fields), default=0)
    for entry in difference.fields:
        yield f"    {entry.field:{width}}  recorded  {_value(entry.recorded)}"
        yield f"    {'':{width}}  new       {_value(entry.new)}"
    if difference.inputs:
        yield f"  inputs of {agent} in cycle {difference.cycle}"
    width = max(map(len, difference.inputs), default=0)
    for key, used in sorted(difference.inputs.items()):
        yield f"    {key:{width}}  {_content(used)}"
    if message is not None and message.missing:
        yield f"    {in_words(message.missing)}"


def _content(message: Message) -> str:
    data: dict[str, Any] = msgspec.to_builtins(message)
    return "  ".join(
        f"{name} {_value(value)}" for name, value in data.items() if name not in HEAD_FIELDS
    )


def _value(value: Value) -> str:
    """Return a value with all its digits, lists without their brackets."""
    if not isinstance(value, list | tuple):
        return str(value)
    entries = (" ".join(map(str, entry)) if isinstance(entry, list) else entry for entry in value)
    return ", ".join(map(str, entries)) or "none"
