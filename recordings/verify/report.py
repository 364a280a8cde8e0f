"""The result of a verification as text, and as plain data for JSON."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Final

import msgspec

from bus_schemas.messages import Message
from bus_schemas.missing import in_words
from recordings.read.run_clock import RunClock
from recordings.verify.comparison import NOT_COMPARED, Comparison, Value
from recordings.verify.findings import KINDS, Difference, Findings
from recordings.verify.verification import Verification

_HEAD: Final = frozenset(Message.__struct_fields__)


def verification_lines(found: Verification, comparison: Comparison, wall_s: float) -> Iterator[str]:
    """Yield the result line by line."""
    speed = found.cycles * found.plan.cycle_ns / 1e9 / max(wall_s, 1e-9)
    yield (
        f"{found.cycles:,} cycles, {len(found.agents)} agents run again, "
        f"{found.total('compared'):,} of {found.recorded:,} messages compared"
    )
    yield f"{wall_s:.1f} s, {speed:,.0f} x simulated time"
    yield from _remarks(found)
    yield from finding_lines(found.agents, RunClock(found.plan, found.plan.cycles - 1))
    if found.first is not None:
        yield ""
    yield _verdict(found, comparison)


def finding_lines(found: Mapping[str, Findings], clock: RunClock) -> Iterator[str]:
    """Yield what was found of each agent: its differences by kind, and the first of them."""
    for agent, findings in found.items():
        first, failure = findings.first, findings.failure
        if first is None:
            continue
        counts = ", ".join(f"{kind} ({count:,})" for kind, count in findings.differences.items())
        yield ""
        yield f"{agent}: {counts}, {clock.span_text(first.cycle, findings.last_cycle)}"
        yield from _difference_lines(agent, first)
        if failure is not None and failure is not first:
            yield f"  fails in cycle {failure.cycle:,}: {failure.text}"
        if findings.not_compared:
            begin = findings.not_compared_from
            yield f"{agent}: {findings.not_compared:,} messages not compared, from cycle {begin} on"


def verification_data(found: Verification, wall_s: float) -> dict[str, Any]:
    """Return the result as plain data."""
    names = (
        *("equal", "stop_cycle", "cycles", "recorded", "not_decided", "differences", "misplaced"),
        *("cut_off", "unrecorded_cycles", "left_out"),
    )
    return {
        "recording": str(found.recording),
        "run_id": found.plan.run_id,
        **{name: getattr(found, name) for name in names},
        **{name: found.total(name) for name in ("compared", "not_compared")},
        "first_agent": found.first[0] if found.first is not None else None,
        "wall_s": wall_s,
        "agents": finding_data(found.agents),
    }


def finding_data(found: Mapping[str, Findings]) -> list[dict[str, Any]]:
    """Return the findings of agents as plain data."""
    return [{"agent": name, **msgspec.to_builtins(findings)} for name, findings in found.items()]


def _remarks(found: Verification) -> Iterator[str]:
    for name, why in found.left_out.items():
        yield f"{name}: left out, {why}"
    if found.stop_cycle is None:
        yield (
            f"the run or its recording broke off: {found.cut_off:,} messages of incomplete cycles "
            "left out"
        )
    if found.unrecorded_cycles is not None:
        yield f"the recorder was started again: {found.unrecorded_cycles:,} cycles not recorded"
    later = sum(one.not_compared for one in found.agents.values() if one.first is None)
    if later:
        yield (
            f"{later:,} messages not compared: they follow from messages that the recorder did not "
            "hear, as it was restarted or their sender was killed"
        )
    if found.misplaced:
        yield f"{found.misplaced:,} messages belong to no cycle of the run, or come long after it"


def _verdict(found: Verification, comparison: Comparison) -> str:
    if found.first is not None:
        name, first = found.first
        return (
            f"NOT equal: {found.differences:,} differences, the first: {name} in cycle "
            f"{first.cycle}, {first.message or first.text} ({first.kind})"
        )
    if not found.equal:
        return "NOT equal"
    left_out = ", ".join([*sorted(comparison.ignored), *NOT_COMPARED])
    within = f"within {comparison.tolerance:g}" if comparison.tolerance else "bit for bit"
    return f"equal {within}; left out: {left_out}"


def _difference_lines(agent: str, difference: Difference) -> Iterator[str]:
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
