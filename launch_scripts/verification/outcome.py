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
from bus_schemas.tree import PLANT
from launch_scripts.verification.account import Account, Difference, Gap, Kind
from launch_scripts.verification.comparison import NOT_COMPARED, Comparison, Value
from launch_scripts.verification.verification import PROFILE_NAME, Verification
from recordings.moments import RunClock

_WIDTH: Final = 100
_MOST_INPUTS: Final = 40
_MOST_FIELDS: Final = 12
_HEAD: Final = frozenset(Message.__struct_fields__)

_KINDS: Final[dict[Kind, str]] = {
    "differs": "differ",
    "only recorded": "not sent any more",
    "only new": "not in the recording",
    "other order": "in another order",
    "recorded twice": "recorded twice",
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
                yield from self._finding(name, account, account.first)
        if found.differences or found.not_compared:
            yield ""
        for name, account in found.accounts.items():
            if account.gaps:
                yield f"{name}: {_gaps_text(account.gaps)}"
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
            "missed_inputs": found.missed_inputs,
            "late_used": found.late_used,
            "strays": found.strays,
            "external_strays": found.external_strays,
            "not_awaited": found.not_awaited,
            "plant_left_out": found.plant_left_out,
            "wall_s": self.wall_s,
            "agents": [_account_data(name, entry) for name, entry in found.accounts.items()],
            "external": [_account_data(name, entry) for name, entry in found.external.items()],
        }

    def _speed(self) -> float:
        simulated_s = self.verification.cycles * self.verification.plan.cycle_ns / 1e9
        return simulated_s / max(self.wall_s, 1e-9)

    def _remarks(self) -> Iterator[str]:
        found = self.verification
        if found.plant_left_out:
            yield f"plant: left out, no {PROFILE_NAME} lies beside the recording"
        if PLANT in found.plan.external and PLANT not in found.accounts:
            yield "plant: left out, it is external"
        for name, account in found.external.items():
            count = account.counts.total()
            first = f", the first in cycle {account.first.cycle}" if account.first else ""
            yield (
                f"{name}: external, not held to what Heliarch's own would say: "
                f"{account.compared:,} messages compared, {count:,} differences{first}"
            )
        if found.missed_inputs:
            late = f"; {found.late_used:,} late words are used again" if found.late_used else ""
            yield (
                f"{found.missed_inputs:,} inputs had not come by their deadlines: the agents do "
                f"without them again{late}"
            )
        if found.stop_cycle is None:
            yield "the run or its recording broke off: what was under way then is not missed"
        if found.strays:
            yield f"{found.strays:,} messages lie too far from their cycle to be compared"
        if found.not_awaited:
            yield (
                f"{found.not_awaited:,} messages come so long after those of their cycle that it "
                "was not kept for them: not compared"
            )
        for name, count in found.external_strays.items():
            yield (
                f"{name}: external, {count:,} messages lie too far from their cycle: nobody uses "
                "them, and they decide nothing"
            )

    def _finding(self, name: str, account: Account, first: Difference) -> Iterator[str]:
        clock = RunClock(self.verification.plan, self.verification.plan.cycles - 1)
        counts = ", ".join(f"{count:,} {_KINDS[kind]}" for kind, count in account.counts.items())
        yield f"{name}: {counts}; the first in cycle {first.cycle} ({clock.text(first.cycle)})"
        yield from _difference_lines(name, first)
        if account.failure is not None and account.failure is not first:
            moment = f"{account.failure.cycle} ({clock.text(account.failure.cycle)})"
            yield f"{name}: the failure in cycle {moment}"
            yield from _difference_lines(name, account.failure)

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


def _gaps_text(gaps: Sequence[Gap]) -> str:
    """Say which messages of an agent were not compared."""
    messages = f"{sum(gap.messages for gap in gaps):,} messages"
    first, last = gaps[0], gaps[-1]
    if len(gaps) == 1 and last.open:
        return f"from cycle {first.from_cycle} on not compared: {messages}"
    if last.open:
        return (
            f"from cycle {first.from_cycle} on in part, from cycle {last.from_cycle} on not "
            f"compared: {messages}"
        )
    spans = f" in {len(gaps):,} spans" if len(gaps) > 1 else ""
    return (
        f"from cycle {first.from_cycle} on not compared: {messages}{spans}, compared again after "
        f"cycle {last.to_cycle}"
    )


def _agents(count: int) -> str:
    return f"{count:,} agent" + "s" * (count != 1)


def _difference_lines(agent: str, difference: Difference) -> Iterator[str]:
    for line in _first_lines(difference):
        yield from _wrapped(line)
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
        "only recorded": f"recorded, not sent any more: {fields}",
        "only new": f"sent now, not in the recording: {fields}",
        "other order": f"sent in another order: {first.text}",
        "recorded twice": f"recorded twice, the second time {fields}",
        "input not recorded": "neither in the recording nor named as missing",
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
    if not named:
        yield "    none"
    if first.missing:
        yield f"    {in_words(first.missing, first.cycle)}"


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


def _account_data(name: str, account: Account) -> dict[str, Any]:
    first = account.first
    return {
        "agent": name,
        "recorded": account.recorded,
        "compared": account.compared,
        "not_compared": account.not_compared,
        "not_compared_from": account.not_compared_from,
        "gaps": [
            {
                "from_cycle": gap.from_cycle,
                "to_cycle": gap.to_cycle,
                "messages": gap.messages,
                "compared_again": not gap.open,
            }
            for gap in account.gaps
        ],
        "missed_inputs": account.missed_inputs,
        "late_used": account.late_used,
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
