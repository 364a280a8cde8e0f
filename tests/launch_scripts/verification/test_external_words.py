"""What external agents say, and agents that are too far behind, accuse no honest controller."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest
from msgspec.structs import replace
from troubled_runs import TroubledRun, cloudy_profile, plan_of, record

from agents.plan import RunPlan, Scheme
from bus_schemas.bus import Delivery
from bus_schemas.messages import Help, Impp, Message, Residual, Setpoint
from bus_schemas.signals import HELP, IMPP, RESIDUAL, SETPOINT, Port
from launch_scripts.verification.comparison import Comparison
from launch_scripts.verification.outcome import Outcome
from launch_scripts.verification.recorded_cycles import CycleWalk
from launch_scripts.verification.verification import Verification, verify

DEVICE = "c1/a"
PLAN = replace(plan_of(cycles=25, cycle_wall_ns=50_000_000), external=(DEVICE,))


class DeviceRun(TroubledRun):
    """A run with a device that says more than it should.

    Parameters
    ----------
    plan, seed, lost, late, latest
        See `TroubledRun`.
    more
        What it says besides a right word of its own, ahead of it.
    """

    def __init__(
        self,
        plan: RunPlan,
        seed: int,
        more: Callable[[Port[Message], Message], list[Delivery]],
        lost: float,
        late: float,
        latest: int = 1,
    ) -> None:
        profile = cloudy_profile(plan, seed)
        super().__init__(plan, profile, seed, lost=lost, late=late, latest=latest)
        self._more = more

    def _publish(self, outputs: list[Delivery]) -> None:
        said: list[Delivery] = []
        for port, message in outputs:
            if port.publisher == DEVICE:
                said += self._more(port, message)
            said.append((port, message))
        super()._publish(said)


def ahead(port: Port[Message], message: Message, cycles: int, every: int = 3) -> list[Delivery]:
    """The same words of a later cycle, with other numbers."""
    cycle = message.cycle + cycles
    if message.cycle % every or cycle >= PLAN.cycles:
        return []
    if isinstance(message, Impp):
        return [(port, replace(message, cycle=cycle, power_kw=message.power_kw / 3.0))]
    if isinstance(message, Residual):
        return [(port, replace(message, cycle=cycle, power_kw=1.25))]
    return []


def verified(folder: Path, run: TroubledRun, said: list[Delivery]) -> Verification:
    return verify(record(folder, run.plan, said, run.profile), (), Comparison())


def hold_few(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let few messages be held back for an agent that lags behind."""
    walk = partial(CycleWalk, most_held=200)
    monkeypatch.setattr("launch_scripts.verification.verification.CycleWalk", walk)


def findings(found: Verification) -> dict[str, tuple[object, ...]]:
    """The first difference of each agent that has one."""
    return {
        name: (entry.first.kind, entry.first.cycle, str(entry.first.port))
        for name, entry in found.accounts.items()
        if entry.first
    }


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("cycles", [1, 2, 5])
@pytest.mark.parametrize(("lost", "late", "latest"), [(0.0, 0.0, 1), (0.03, 0.3, 4)])
def test_a_controller_that_used_the_second_word_of_a_device_is_not_accused(
    lost: float, late: float, latest: int, cycles: int, seed: int, tmp_path: Path
) -> None:
    run = DeviceRun(PLAN, seed, partial(ahead, cycles=cycles), lost, late, latest)
    said = run.run()
    assert sum(sequencer.drops.total() for sequencer in run.sequencers.values()) > 5
    found = verified(tmp_path / "run", run, said)
    assert findings(found) == {}
    assert found.equal
    assert found.not_compared == 0
    # What it made of that word is compared, and not just left out.
    place, (port, message) = next(
        (place, (port, message))
        for place, (port, message) in enumerate(said)
        if port is SETPOINT.of("c1/b") and message.cycle == 3 + cycles
    )
    assert isinstance(message, Setpoint)
    changed = (port, replace(message, power_kw=message.power_kw + 0.5))
    changed_found = verified(tmp_path / "run", run, [*said[:place], changed, *said[place + 1 :]])
    assert findings(changed_found)["c1"] == ("differs", 3 + cycles, "c1/b/setpoint")


def test_a_device_that_announces_a_need_too_early_accuses_nobody(tmp_path: Path) -> None:
    def needy(port: Port[Message], message: Message) -> list[Delivery]:
        if not isinstance(message, Residual) or message.cycle % 4 or message.cycle > 15:
            return []
        head = (message.cycle + 5, 0, DEVICE, ())
        return [
            (RESIDUAL.of(DEVICE), Residual(*head, power_kw=-9.0)),
            (HELP.of(DEVICE), Help(*head, missing_kw=9.0)),
        ]

    run = DeviceRun(PLAN, 1, needy, lost=0.0, late=0.0)
    found = verified(tmp_path / "run", run, run.run())
    assert findings(found) == {}
    assert found.equal


def test_strays_of_a_device_are_named_and_decide_nothing(tmp_path: Path) -> None:
    run = TroubledRun(PLAN, cloudy_profile(PLAN), 1)
    said = run.run()
    word = Impp(0, 0, DEVICE, (), power_kw=5.0, stale_cycles=0)
    strays = [(IMPP.of(DEVICE), replace(word, cycle=cycle)) for cycle in (0, 1, 9999)]
    found = verified(tmp_path / "run", run, [*said[:-1], *strays, said[-1]])
    assert found.equal
    assert (found.strays, found.external_strays) == (0, {DEVICE: 3})
    outcome = Outcome(found, Comparison(), 1.0)
    assert any(
        line.startswith(f"{DEVICE}: external, 3 messages lie too far") for line in outcome.lines()
    )
    assert outcome.as_data()["external_strays"] == {DEVICE: 3}
    ours = TroubledRun(replace(PLAN, external=()), cloudy_profile(PLAN), 1)
    found = verified(tmp_path / "ours", ours, [*said[:-1], *strays, said[-1]])
    assert (found.equal, found.strays) == (False, 3)
    *_, verdict = Outcome(found, Comparison(), 1.0).lines()
    assert verdict == "NOT equal: 3 messages of no cycle, otherwise no difference"


@pytest.mark.parametrize("entry", ["skipped@" + "9" * 200, "skipped@12", "@", "@@1", "skipped"])
def test_a_missing_that_makes_no_sense_stops_no_verification(entry: str, tmp_path: Path) -> None:
    run = TroubledRun(PLAN, cloudy_profile(PLAN), 1)
    said = [
        (port, replace(message, missing=(entry,)) if port.publisher == DEVICE else message)
        for port, message in run.run()
    ]
    assert verified(tmp_path / "run", run, said).equal


@pytest.mark.parametrize("late", [0.0, 0.3])
@pytest.mark.parametrize("agent", ["c1", "c1/a", "central"])
@pytest.mark.parametrize("scheme", ["paper", "predictive"])
def test_an_agent_that_was_too_far_behind_to_be_waited_for_is_not_accused(
    scheme: Scheme,
    agent: str,
    late: float,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    hold_few(monkeypatch)
    plan = plan_of(cycles=60, cycle_wall_ns=50_000_000, scheme=scheme)
    profile = cloudy_profile(plan)
    run = TroubledRun(
        plan, profile, 1, lost=0.0, late=late, latest=3, frozen=(agent, range(20, 50))
    )
    said = run.run()
    found = verified(tmp_path / "run", run, said)
    assert findings(found) == {}
    assert found.strays == 0
    assert found.compared + found.not_compared == len(said) - 2
    # Controllers below the central one have no memory that outlasts what they hear anew.
    assert found.undecided == (agent == "central" or bool(found.not_compared))
    assert found.equal != found.undecided
    # It is found all the same what is wrong where nothing is in doubt.
    place = next(
        place
        for place, (port, message) in enumerate(said)
        if port.signal is SETPOINT and message.cycle == 12
    )
    port, message = said[place]
    said[place] = (port, replace(message, power_kw=1.25))
    assert verified(tmp_path / "run", run, said).differences


def test_an_agent_that_never_came_back_is_found_however_long_the_run_went_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    hold_few(monkeypatch)
    plan = plan_of(cycles=60, cycle_wall_ns=50_000_000)
    run = TroubledRun(plan, cloudy_profile(plan), 2, frozen=("c2", range(20, 99)))
    found = verified(tmp_path / "run", run, run.run())
    assert list(findings(found)) == ["c2"]
    assert findings(found)["c2"][:2] == ("only new", 20)
