"""Each kind of difference is found where it was planted: in a copy of a recording, or in the code.

The recordings are of a small plant under fast clouds, in lockstep; every agent says all it can.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace
from recorded_runs import AGENTS, cloudy_profile, of_publisher, plan_of, published, record

from agents.direct import DirectController
from agents.parent import Parent, Supervisor
from bus_schemas.bus import Delivery
from bus_schemas.messages import Help, Impp, Message, Setpoint
from bus_schemas.signals import COMMAND, HELP, IMPP, SETPOINT, SIGNALS, TELEMETRY, Port, Signal
from bus_schemas.tree import PLANT
from recordings.verify.comparison import Comparison, FieldDifference
from recordings.verify.findings import Difference
from recordings.verify.recorded_cycles import RecordedCycles
from recordings.verify.verification import Verification, verify

PLAN = plan_of(cycles=30)
PROFILE = cloudy_profile(PLAN)
PUBLISHED = published(PLAN, PROFILE)

Verify = Callable[..., Verification]


@pytest.fixture
def verified(tmp_path: Path) -> Verify:
    """Verify a recording of what was published."""

    def run(messages: list[Delivery], *nodes: str) -> Verification:
        return verify(record(tmp_path / "run", PLAN, messages, PROFILE), nodes, Comparison())

    return run


def first_of(found: Verification, agent: str) -> Difference:
    first = found.agents[agent].first
    assert first is not None, f"{agent}: nothing found"
    return first


def place_of(port: Port[Message], cycle: int) -> int:
    """Place of the message of a port in a cycle."""
    found = [(other, message.cycle) for other, message in PUBLISHED]
    return found.index((port, cycle))


def test_a_recording_of_the_same_code_is_equal(verified: Verify) -> None:
    found = verified(PUBLISHED)
    assert found.equal
    assert tuple(found.agents) == AGENTS
    assert found.total("compared") == len(PUBLISHED) - 2, "all but the plant's start and stop"
    for name, findings in found.agents.items():
        assert findings.compared == len(of_publisher(PUBLISHED, name)) > PLAN.cycles


# In the recording ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "signal",
    [signal for signal in SIGNALS if signal.logged and signal.decided],
    ids=lambda signal: signal.name,
)
def test_a_changed_field_of_any_signal_is_found(signal: Signal[Message], verified: Verify) -> None:
    places = [place for place, (port, _) in enumerate(PUBLISHED) if port.signal is signal]
    place = places[len(places) // 2]
    port, message = PUBLISHED[place]
    field = next(
        name for name in ("power_kw", "missing_kw", "desired_kw", "count") if hasattr(message, name)
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


@pytest.mark.parametrize(
    ("port", "cycle", "change", "kinds"),
    [
        *(
            (COMMAND.of("c2/d"), cycle, gone, {"plant": "input not recorded", "c2/d": "only new"})
            for cycle in (0, 13, 29)
        ),
        (IMPP.of("c1/a"), WITHOUT_HELP, with_help, {"c1/a": "only recorded"}),
        (SETPOINT.of("c1/a"), 6, twice, {"c1": "recorded twice"}),
        *(
            (SETPOINT.of("c1/a"), 6, forged, {"c1": "two senders", "c1/a": "input of two senders"})
            for forged in (forged_after, forged_before)
        ),
        (IMPP.of("c1/a"), 7, with_a_stray, {}),
    ],
)
def test_what_was_planted_is_found_in_its_cycle_and_nothing_else(
    port: Port[Message], cycle: int, change: Change, kinds: dict[str, str], verified: Verify
) -> None:
    place = place_of(port, cycle)
    found = verified([*PUBLISHED[:place], *change(*PUBLISHED[place]), *PUBLISHED[place + 1 :]])
    differences = {name: one.differences for name, one in found.agents.items() if one.first}
    assert differences == {name: {kind: 1} for name, kind in kinds.items()}
    assert all(first_of(found, name).cycle == cycle for name in kinds)
    assert found.misplaced == (change is with_a_stray)
    assert not found.equal


def test_nothing_is_compared_after_a_remembered_input_is_lost(verified: Verify) -> None:
    place = place_of(TELEMETRY.of("c2/c"), 11)
    found = verified([*PUBLISHED[:place], *PUBLISHED[place + 1 :]])
    assert first_of(found, PLANT).kind == "only new"
    lack = first_of(found, "c2/c")
    assert (lack.kind, lack.cycle, lack.message) == ("input not recorded", 11, "c2/c/telemetry")
    assert found.differences == 2, "what follows from a state that nobody knows is not compared"
    findings = found.agents["c2/c"]
    assert findings.not_compared_from == 11
    assert findings.compared == sum(
        message.cycle < 11 for _, message in of_publisher(PUBLISHED, "c2/c")
    )
    assert findings.compared + findings.not_compared == findings.recorded


# In the code --------------------------------------------------------------------------------------


def test_a_wrong_allocation_is_found(verified: Verify, monkeypatch: pytest.MonkeyPatch) -> None:
    right = Parent.setpoints

    def halve_help(self: Parent, *words: object) -> list[Delivery]:
        outputs = right(self, *words)  # type: ignore[arg-type]
        for _, message in outputs:
            assert isinstance(message, Setpoint)
            message.power_kw -= sum(given.power_kw for given in message.help_given) / 2.0
        return outputs

    monkeypatch.setattr(Parent, "setpoints", halve_help)
    found = verified(PUBLISHED)
    parents = {name for name, findings in found.agents.items() if findings.first}
    assert parents == {"central", "c1", "c2"}, "its children did as they were told"
    for parent in parents:
        helped = [
            message.cycle
            for _, message in of_publisher(PUBLISHED, parent)
            if isinstance(message, Setpoint) and message.help_given
        ]
        first = first_of(found, parent)
        assert first.cycle == helped[0]
        assert [entry.field for entry in first.fields] == ["power_kw"]


@pytest.mark.parametrize(
    ("alpha", "error"), [(None, "ValidationError"), (np.float64(0.5), "TypeError")]
)
def test_a_value_that_cannot_be_sent_is_a_finding(
    alpha: object, error: str, verified: Verify, monkeypatch: pytest.MonkeyPatch
) -> None:
    right = DirectController._actuate

    def actuate(self: DirectController, state: object, turn: object) -> object:
        outputs = right(self, state, turn)  # type: ignore[arg-type]
        if self.name != "c1/b" or turn.cycle != 12:  # type: ignore[attr-defined]
            return outputs
        return [(port, replace(message, alpha=alpha)) for port, message in outputs]

    monkeypatch.setattr(DirectController, "_actuate", actuate)
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
def test_an_agent_that_fails_anywhere_is_a_finding_and_the_others_go_on(
    method: str, error: type[BaseException], verified: Verify, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(self: Supervisor, *words: object) -> None:
        raise error("by hand")

    monkeypatch.setattr(Supervisor, method, fail)
    found = verified(PUBLISHED)
    assert [name for name, findings in found.agents.items() if findings.first] == ["c1", "c2"]
    assert tuple(found.agents) == AGENTS
    for name in ("c1", "c2"):
        findings = found.agents[name]
        first = first_of(found, name)
        assert (first.kind, first.cycle) == ("fails", 0)
        assert first.text == f"{error.__name__}: by hand"
        assert findings.not_compared == findings.recorded > PLAN.cycles
    assert found.first is not None


def test_a_long_recording_is_not_kept_in_memory() -> None:
    plan = plan_of(cycles=100_000)
    port = IMPP.of("c1/a")
    messages = (
        (port, Impp(cycle, 0, "c1/a", (), power_kw=1.0, stale_cycles=0)) for cycle in range(100_000)
    )
    recorded = RecordedCycles(messages, plan, plan.cycles)
    assert next(iter(recorded))[0] == 0
    assert recorded.read < 60_000
