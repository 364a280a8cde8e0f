"""Each kind of difference is found where it was planted: in a copy of a recording, or in the code.

The recordings are of a small plant under fast clouds, in lockstep; every agent says all it can.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace
from recorded_runs import AGENTS, cloudy_profile, plan_of, published, record

from agents.direct import DirectController
from agents.parent import Supervisor
from bus_schemas.bus import Delivery
from bus_schemas.messages import Command, Help, Message
from bus_schemas.signals import (
    COMMAND,
    HELP,
    IMPP,
    OFFER,
    SETPOINT,
    SIGNALS,
    TELEMETRY,
    Port,
    Signal,
)
from recordings.verify.comparison import Difference, FieldDifference
from recordings.verify.verification import Verification, verify

PLAN = plan_of(cycles=30)
PROFILE = cloudy_profile(PLAN)
PUBLISHED = published(PLAN, PROFILE)

Verify = Callable[..., Verification]


@pytest.fixture
def verified(tmp_path: Path) -> Verify:
    """Verify a recording of what was published."""

    def run(messages: list[Delivery], *nodes: str) -> Verification:
        return verify(record(tmp_path / "run", PLAN, messages, PROFILE), nodes)

    return run


def first_of(found: Verification, agent: str) -> Difference:
    first = found.agents[agent].first
    assert first is not None, f"{agent}: nothing found"
    return first


def place_of(port: Port[Message], cycle: int) -> int:
    """Place of the message of a port in a cycle."""
    found = [(other, message.cycle) for other, message in PUBLISHED]
    return found.index((port, cycle))


# In the recording ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "signal",
    [signal for signal in SIGNALS if signal.logged and signal.decided and signal is not OFFER],
    ids=lambda signal: signal.name,
)
def test_a_changed_field_of_any_signal_is_found(signal: Signal[Message], verified: Verify) -> None:
    places = [place for place, (port, _) in enumerate(PUBLISHED) if port.signal is signal]
    place = places[len(places) // 2]
    port, message = PUBLISHED[place]
    field = next(
        name
        for name in ("power_kw", "missing_kw", "dispatch_kw", "count", "correction_kw")
        if hasattr(message, name)
    )
    value = getattr(message, field)
    changed = port, replace(message, **{field: value + 1})
    found = verified([*PUBLISHED[:place], changed, *PUBLISHED[place + 1 :]])
    first = first_of(found, port.publisher)
    assert (first.kind, first.cycle, first.message) == ("differs", message.cycle, str(port))
    assert first.fields == (FieldDifference(field, value + 1, value),)
    assert found.agents[port.publisher].differences == {"differs": 1}


Change = Callable[[Port[Message], Message], list[Delivery]]


def gone(port: Port[Message], message: Message) -> list[Delivery]:
    return []


def twice(port: Port[Message], message: Message) -> list[Delivery]:
    return [(port, message)] * 2


def forged_after(port: Port[Message], message: Message) -> list[Delivery]:
    return [(port, message), (port, replace(message, power_kw=0.0, sequence=7))]


def forged_before(port: Port[Message], message: Message) -> list[Delivery]:
    return forged_after(port, message)[::-1]


def with_a_stray(port: Port[Message], message: Message) -> list[Delivery]:
    """Add a message of a cycle that the run does not have."""
    return [(port, message), (port, replace(message, cycle=4711))]


def with_help(port: Port[Message], message: Message) -> list[Delivery]:
    """Put a call for help before the message: no agent sends it again or acts on it."""
    call = Help(message.cycle, message.sim_time_ns, "c1/a", (), missing_kw=1.0)
    return [(HELP.of("c1/a"), call), (port, message)]


CYCLES_OF_HELP = {message.cycle for port, message in PUBLISHED if port is HELP.of("c1/a")}
WITHOUT_HELP = min(set(range(3, 30)) - CYCLES_OF_HELP)
COMMAND_LOST = {"plant": {"input not recorded": 1}, "c2/d": {"only new": 1}}
TELEMETRY_LOST = {"plant": {"only new": 1}, "c2/c": {"input not recorded": 1}}


@pytest.mark.parametrize(
    ("port", "cycle", "change", "differences"),
    [
        *((COMMAND.of("c2/d"), cycle, gone, COMMAND_LOST) for cycle in (0, 13, 29)),
        (TELEMETRY.of("c2/c"), 11, gone, TELEMETRY_LOST),
        (IMPP.of("c1/a"), WITHOUT_HELP, with_help, {"c1/a": {"only recorded": 1}}),
        *(
            (SETPOINT.of("c1/a"), 6, more, {"c1": {"sent twice": 1}})
            for more in (twice, forged_after)
        ),
        (SETPOINT.of("c1/a"), 6, forged_before, {"c1": {"sent twice": 1, "differs": 1}}),
        (IMPP.of("c1/a"), 7, with_a_stray, {}),
    ],
)
def test_each_planted_difference_is_found_in_its_cycle_and_no_other(
    port: Port[Message],
    cycle: int,
    change: Change,
    differences: dict[str, dict[str, int]],
    verified: Verify,
) -> None:
    place = place_of(port, cycle)
    found = verified([*PUBLISHED[:place], *change(*PUBLISHED[place]), *PUBLISHED[place + 1 :]])
    assert {name: one.differences for name, one in found.agents.items() if one.first} == differences
    assert all(first_of(found, name).cycle == cycle for name in differences)
    assert found.misplaced == (change is with_a_stray)
    assert not found.equal


# In the code --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("alpha", "error"), [(None, "ValidationError"), (np.float64(0.5), "TypeError")]
)
def test_a_value_that_cannot_be_sent_is_a_difference(
    alpha: object, error: str, verified: Verify, monkeypatch: pytest.MonkeyPatch
) -> None:
    right: Callable[..., Any] = DirectController.step

    def changed(message: Message) -> Message:
        is_chosen = isinstance(message, Command) and message.source == "c1/b"
        return replace(message, alpha=alpha) if is_chosen and message.cycle == 12 else message

    def wrong(*words: object) -> tuple[object, list[Delivery]]:
        state, outputs = right(*words)
        return state, [(port, changed(message)) for port, message in outputs]

    monkeypatch.setattr(DirectController, "step", wrong)
    found = verified(PUBLISHED)
    first = first_of(found, "c1/b")
    assert (first.kind, first.cycle, first.stage) == ("fails", 12, "actuate")
    assert first.text.startswith(error)
    assert set(first.inputs) >= {"c1/b/telemetry", "c1/b/setpoint"}
    assert found.differences == 1


@pytest.mark.parametrize(
    ("method", "error"),
    [("__init__", RuntimeError), ("stages", RuntimeError), ("step", SystemExit)],
)
def test_an_agent_that_fails_anywhere_is_a_difference_and_the_others_go_on(
    method: str, error: type[BaseException], verified: Verify, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(self: Supervisor, *words: object) -> None:
        raise error("by hand")

    monkeypatch.setattr(Supervisor, method, fail)
    found = verified(PUBLISHED)
    assert [name for name, result in found.agents.items() if result.first] == ["c1", "c2"]
    assert tuple(found.agents) == AGENTS
    for name in ("c1", "c2"):
        result, first = found.agents[name], first_of(found, name)
        assert (first.kind, first.cycle) == ("fails", 0)
        assert first.text == f"{error.__name__}: by hand"
        assert (result.compared, result.recorded > PLAN.timing.cycles) == (0, True)
    assert found.first is not None
