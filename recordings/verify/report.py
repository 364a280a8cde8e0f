"""The result of a verification as text, and as plain data for JSON."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Final

import msgspec

from bus_schemas.messages import Message, in_words
from recordings.read.run_clock import RunClock
from recordings.verify.agent_result import KINDS, AgentResult, Difference
from recordings.verify.equality import NOT_COMPARED, Equality, Value
from recordings.verify.verification import Verification

_HEAD: Final = frozenset(Message.__struct_fields__)


def verification_lines(
    verification: Verification, equality: Equality, wall_s: float
) -> Iterator[str]:
    """Yield the result line by line."""
    plan, agents = verification.plan, verification.agents
    speed = verification.cycles * plan.timing.cycle_ns / 1e9 / max(wall_s, 1e-9)
    yield (
        f"{verification.cycles:,} cycles, {len(agents)} agents run again, "
        f"{verification.total('compared'):,} of {verification.messages.recorded:,} messages "
        "compared"
    )
    yield f"{wall_s:.1f} s, {speed:,.0f} x simulated time"
    yield from _remarks(verification)
    yield from difference_lines(agents, RunClock(plan, plan.timing.cycles - 1))
    if verification.first is not None:
        yield ""
    yield _verdict(verification, equality)


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
        if result.not_compared:
            begin = result.not_compared_from
            yield f"{agent}: {result.not_compared:,} messages not compared, from cycle {begin} on"


def verification_data(verification: Verification, wall_s: float) -> dict[str, Any]:
    """Return the result as plain data."""
    names = ("equal", "stop_cycle", "cycles", "differences", "unrecorded_cycles", "left_out")
    first = verification.first
    return {
        "recording": str(verification.recording),
        "run_id": verification.plan.run_id,
        **{name: getattr(verification, name) for name in names},
        **msgspec.to_builtins(verification.messages),
        **{name: verification.total(name) for name in ("compared", "not_compared")},
        "first_agent": None if first is None else first[0],
        "wall_s": wall_s,
        "agents": agents_data(verification.agents),
    }


def agents_data(agents: Mapping[str, AgentResult]) -> list[dict[str, Any]]:
    """Return the results of agents as plain data."""
    return [{"agent": name, **msgspec.to_builtins(result)} for name, result in agents.items()]


def _remarks(verification: Verification) -> Iterator[str]:
    for name, why in verification.left_out.items():
        yield f"{name}: left out, {why}"
    if verification.stop_cycle is None:
        yield (
            f"the run or its recording broke off: {verification.messages.cut_off:,} messages of "
            "incomplete cycles left out"
        )
    if verification.unrecorded_cycles is not None:
        yield (
            "the recorder was started again, or the file is damaged: "
            f"{verification.unrecorded_cycles:,} cycles not recorded"
        )
    later = sum(one.not_compared for one in verification.agents.values() if one.first is None)
    if later:
        yield (
            f"{later:,} messages not compared: they follow from messages that are not in the "
            "recording"
        )
    if misplaced := verification.messages.misplaced:
        yield f"{misplaced:,} messages belong to no cycle of the run, or come long after it"


def _verdict(verification: Verification, equality: Equality) -> str:
    if verification.first is not None:
        name, first = verification.first
        return (
            f"NOT equal: {verification.differences:,} differences, the first: {name} in cycle "
            f"{first.cycle}, {first.message or first.text} ({first.kind})"
        )
    if not verification.equal:
        return "NOT equal"
    left_out = ", ".join([*sorted(equality.ignored), *NOT_COMPARED])
    within = f"within {equality.tolerance:g}" if equality.tolerance else "bit for bit"
    return f"equal {within}; left out: {left_out}"


def _lines_of(agent: str, difference: Difference) -> Iterator[str]:
    stage = f" (stage {difference.stage})" if difference.stage else ""
    message, content = difference.content, difference.text
    if message is not None and difference.kind != "differs":
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
    """Return the fields of a message without its head."""
    data: dict[str, Any] = msgspec.to_builtins(message)
    return "  ".join(f"{name} {_value(value)}" for name, value in data.items() if name not in _HEAD)


def _value(value: Value) -> str:
    """Return a value with all its digits, lists without their brackets."""
    if not isinstance(value, list | tuple):
        return str(value)
    entries = (" ".join(map(str, entry)) if isinstance(entry, list) else entry for entry in value)
    return ", ".join(map(str, entries)) or "none"
