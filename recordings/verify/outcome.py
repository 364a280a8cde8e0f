"""What a verification came to: as lines to be read, and as JSON."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any, Final

import msgspec

from bus_schemas.bus import Delivery
from bus_schemas.messages import Message
from bus_schemas.missing import in_words
from recordings.read.moments import RunClock
from recordings.verify.account import Account, Difference, Kind
from recordings.verify.comparison import NOT_COMPARED, Comparison, Value
from recordings.verify.verification import Verification

_WIDTH: Final = 100
_MOST_INPUTS: Final = 40
_MOST_FIELDS: Final = 12
_HEAD: Final = frozenset(Message.__struct_fields__)

_KINDS: Final[dict[Kind, str]] = {
    "differs": "differ",
    "only recorded": "not sent any more",
    "only new": "not in the recording",
    "two messages in one cycle": "after two messages in one cycle",
    "recorded twice": "recorded twice",
    "not recorded": "not recorded",
    "input not recorded": "input not in the recording",
    "fails": "failure",
}


@dataclass(frozen=True, slots=True)
class Outcome:
    """A verification, what counted as equal in it, and how long it took [s]."""

    verification: Verification
    comparison: Comparison
    wall_s: float

    def lines(self) -> Iterator[str]:
        """Yield what there is to say, in lines of at most 100 columns (paths excepted)."""
        found = self.verification
        clock = RunClock(found.plan, found.plan.cycles - 1)
        yield f"{found.recording}"
        yield (
            f"{found.cycles:,} cycles, {_agents(len(found.accounts))} re-run, "
            f"{found.compared:,} of {found.recorded:,} messages compared, "
            f"{found.not_decided:,} no decisions"
        )
        yield f"{self.wall_s:.1f} s, {self._speed():,.0f} x the run's simulated time"
        yield from self._remarks()
        for name, account in found.accounts.items():
            if account.first is not None:
                yield ""
                yield from finding_lines(name, account, clock)
        if found.differences or found.not_compared:
            yield ""
        for name, account in found.accounts.items():
            if account.not_compared:
                yield (
                    f"{name}: from cycle {account.not_compared_from} on not compared: "
                    f"{account.not_compared:,} messages"
                )
        yield self._verdict()

    def as_data(self) -> dict[str, Any]:
        """Return the outcome as plain data for JSON."""
        found = self.verification
        return {
            "recording": str(found.recording),
            "run_id": found.plan.run_id,
            "equal": found.equal,
            "tolerance": self.comparison.tolerance,
            "ignored": sorted(self.comparison.ignored),
            "lockstep": found.plan.lockstep,
            "whole": found.whole,
            "stop_cycle": found.stop_cycle,
            "cycles": found.cycles,
            "recorded": found.recorded,
            "not_decided": found.not_decided,
            "compared": found.compared,
            "not_compared": found.not_compared,
            "undecided": found.undecided,
            "differences": found.differences,
            "first_agent": found.first[0] if found.first is not None else None,
            "missing_inputs": found.missing_inputs,
            "old_inputs": found.old_inputs,
            "strays": found.strays,
            "too_late": found.too_late,
            "left_out": found.left_out,
            "wall_s": self.wall_s,
            "agents": [account_data(name, entry) for name, entry in found.accounts.items()],
        }

    def _speed(self) -> float:
        simulated_s = self.verification.cycles * self.verification.plan.cycle_ns / 1e9
        return simulated_s / max(self.wall_s, 1e-9)

    def _remarks(self) -> Iterator[str]:
        found = self.verification
        for name, why in found.left_out.items():
            yield f"{name}: left out, {why}"
        if found.missing_inputs:
            old = f"; {found.old_inputs:,} older ones are used again" if found.old_inputs else ""
            yield (
                f"{found.missing_inputs:,} inputs had not come by their deadlines: the agents do "
                f"without them again{old}"
            )
        if found.stop_cycle is None:
            yield "the run or its recording broke off: what was under way then is not missed"
        if found.strays:
            yield f"{found.strays:,} messages belong to no cycle of the run"
        if found.too_late:
            yield (
                f"{found.too_late:,} messages come so long after those of their cycle that it "
                "was not kept for them: not compared"
            )

    def _verdict(self) -> str:
        found = self.verification
        if found.differences or found.strays:
            return self._verdict_on_differences()
        rest = f"{found.not_compared:,} messages not compared"
        if found.undecided:
            return f"UNDECIDED: no difference in what was compared; {rest}"
        if found.not_compared:
            return f"no difference up to where the run or its recording broke off; {rest}"
        return self._verdict_on_equality()

    def _verdict_on_equality(self) -> str:
        comparison = self.comparison
        if not comparison.ignored and not comparison.tolerance:
            return f"equal bit for bit; left out: {', '.join(NOT_COMPARED)}"
        within = f" within {comparison.tolerance:g}" if comparison.tolerance else ""
        return f"equal{within} except for {', '.join([*sorted(comparison.ignored), *NOT_COMPARED])}"

    def _verdict_on_differences(self) -> str:
        found = self.verification
        count = sum(account.first is not None for account in found.accounts.values())
        if not count:
            return f"NOT equal: {found.strays:,} messages of no cycle, otherwise no difference"
        text = f"NOT equal: {found.differences:,} differences of {_agents(count)}"
        if found.first is None:
            return text
        name, first = found.first
        return f"{text}, the first: {first.port or first.text}, by {name} in cycle {first.cycle}"


def as_json(outcomes: Sequence[Outcome]) -> bytes:
    """Return the outcomes of one or several runs as a JSON document."""
    document = {
        "equal": all(outcome.verification.equal for outcome in outcomes),
        "runs": [outcome.as_data() for outcome in outcomes],
    }
    return msgspec.json.format(msgspec.json.encode(_finite(document)), indent=1)


def _finite(value: Value) -> Value:
    """Return plain data with the floats that JSON has no number for as text: nan, inf, -inf."""
    if isinstance(value, float):
        return value if isfinite(value) else str(value)
    if isinstance(value, dict):
        return {name: _finite(entry) for name, entry in value.items()}
    return list(map(_finite, value)) if isinstance(value, list | tuple) else value


def finding_lines(name: str, account: Account, clock: RunClock) -> Iterator[str]:
    """Yield what there is to say of an agent with differences."""
    first, failure = account.first, account.failure
    if first is None:
        return
    counts = ", ".join(f"{count:,} {_KINDS[kind]}" for kind, count in account.counts.items())
    yield f"{name}: {counts}; the first in cycle {first.cycle} ({clock.text(first.cycle)})"
    yield from _difference_lines(name, first)
    if failure is not None and failure is not first:
        yield f"{name}: the failure in cycle {failure.cycle} ({clock.text(failure.cycle)})"
        yield from _difference_lines(name, failure)


def _agents(count: int) -> str:
    return f"{count:,} agent" + "s" * (count != 1)


def _difference_lines(agent: str, difference: Difference) -> Iterator[str]:
    for line in _first_lines(difference):
        yield from _wrapped(line)
    if difference.inputs or difference.missing:
        yield f"  inputs of {agent} in cycle {difference.cycle}"
        for line in _input_lines(difference):
            yield from _wrapped(line)


def _first_lines(first: Difference) -> Iterator[str]:
    stage = f" (stage {first.stage})" if first.stage else ""
    yield f"  {first.port or 'the agent'}{stage}: {_what(first)}"
    width = max((len(entry.field) for entry in first.fields), default=0)
    for entry in first.fields[:_MOST_FIELDS]:
        yield f"    {entry.field:{width}}  recorded  {_value(entry.recorded)}"
        yield f"    {'':{width}}  new       {_value(entry.new)}"
    if len(first.fields) > _MOST_FIELDS:
        yield f"    and {len(first.fields) - _MOST_FIELDS} more fields, all of them in --json"


def _what(first: Difference) -> str:
    fields = _fields(first.message) if first.message is not None else ""
    texts: dict[Kind, str] = {
        "differs": "differs",
        "two messages in one cycle": "differs, and an input has two messages in one cycle",
        "only recorded": f"recorded, not sent any more: {fields}",
        "only new": f"sent now, not in the recording: {fields}",
        "recorded twice": f"recorded twice, the second time {fields}",
        "not recorded": "the recording lacks messages before this one, its number shows it",
        "input not recorded": "was used, and is not in the recording",
        "fails": first.text,
    }
    return texts[first.kind]


def _input_lines(first: Difference) -> Iterator[str]:
    named = sorted((str(port), message) for port, message in first.inputs)
    width = max((len(key) for key, _ in named), default=0)
    for key, message in named[:_MOST_INPUTS]:
        yield f"    {key:{width}}  {_fields(message)}"
    if len(named) > _MOST_INPUTS:
        yield f"    and {len(named) - _MOST_INPUTS} more, all of them in --json"
    if first.missing:
        yield f"    {in_words(first.missing)}"


def _own_fields(message: Message) -> dict[str, Any]:
    """Return the fields of a message's own kind: its head says nothing new."""
    data: dict[str, Any] = msgspec.to_builtins(message)
    return {name: value for name, value in data.items() if name not in _HEAD}


def _fields(message: Message) -> str:
    return "  ".join(f"{name} {_value(value)}" for name, value in _own_fields(message).items())


def _value(value: Value) -> str:
    """Return a value with all its digits, lists without their brackets."""
    if not isinstance(value, list | tuple):
        return str(value)
    entries = (" ".join(map(str, entry)) if isinstance(entry, list) else entry for entry in value)
    return ", ".join(map(str, entries)) or "none"


def _wrapped(line: str) -> list[str]:
    """Break a line at its blanks; what follows is indented further than what it belongs to."""
    indent = " " * (len(line) - len(line.lstrip()) + 8)
    return textwrap.wrap(
        line, _WIDTH, subsequent_indent=indent, drop_whitespace=True, break_on_hyphens=False
    )


def account_data(name: str, account: Account) -> dict[str, Any]:
    """Return the comparison of one agent as plain data for JSON."""
    first = account.first
    return {
        "agent": name,
        "recorded": account.recorded,
        "compared": account.compared,
        "not_compared": account.not_compared,
        "not_compared_from": account.not_compared_from,
        "missing_inputs": account.missing_inputs,
        "old_inputs": account.old_inputs,
        "differences": dict(account.counts),
        "first": None if first is None else _difference_data(first),
        "failure": None if account.failure is None else _difference_data(account.failure),
    }


def _difference_data(first: Difference) -> dict[str, Any]:
    return {
        "kind": first.kind,
        "cycle": first.cycle,
        "stage": first.stage,
        "message": None if first.port is None else str(first.port),
        "fields": [
            {"field": entry.field, "recorded": entry.recorded, "new": entry.new}
            for entry in first.fields
        ],
        "content": None if first.message is None else msgspec.to_builtins(first.message),
        "inputs": dict(map(_input_data, first.inputs)),
        "missing": first.missing,
        "text": first.text,
    }


def _input_data(delivery: Delivery) -> tuple[str, Any]:
    port, message = delivery
    return str(port), msgspec.to_builtins(message)
