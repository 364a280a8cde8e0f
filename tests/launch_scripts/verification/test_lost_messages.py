"""A recording that lost messages hides nothing: what cannot be compared is counted.

Where the loss makes no difference any more the comparison goes on, and finds a planted fault.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from zlib import crc32

import pytest
from msgspec.structs import replace
from troubled_runs import (
    THREE_TIERS,
    TWO_TIERS,
    TroubledRun,
    cloudy_profile,
    lockstep_run,
    plan_of,
    record,
)
from typer.testing import CliRunner

from agents.agent import Turn
from agents.plan import RunPlan
from agents.supervisor import Supervisor
from bus_schemas.bus import Delivery
from bus_schemas.messages import Setpoint
from bus_schemas.signals import COMMAND, RUN, TELEMETRY
from launch_scripts.cli import app
from launch_scripts.verification.account import Account
from launch_scripts.verification.comparison import Comparison
from launch_scripts.verification.verification import Verification, verify

WRONG_AGENTS = ("c1", "c2")
WRONG_FROM = 24
CYCLES = 40
CYCLE_WALL_NS = 50_000_000


def paper_plan(
    ratings_kw: dict[str, float] = TWO_TIERS, period_cycles: tuple[int, ...] = (1, 1)
) -> RunPlan:
    """Plan of a run in real time whose agents remember no more than they last heard."""
    return plan_of(
        ratings_kw,
        cycles=CYCLES,
        period_cycles=period_cycles,
        cycle_wall_ns=CYCLE_WALL_NS,
        scheme="paper",
    )


def heard(plan: RunPlan, seed: int = 1) -> list[Delivery]:
    """What a recorder that loses nothing hears of a run in which some inputs are late or lost."""
    return TroubledRun(plan, cloudy_profile(plan, seed), seed, lost=0.01, late=0.01).run()


def verified(folder: Path, plan: RunPlan, said: list[Delivery]) -> Verification:
    """What the verification of all agents but the plant comes to."""
    return verify(record(folder, plan, said), (), Comparison())


def lose(said: list[Delivery], lost: Callable[[Delivery], bool]) -> list[Delivery]:
    left = [pair for pair in said if pair[0].signal is RUN or not lost(pair)]
    assert len(left) < len(said)
    return left


def planted(said: list[Delivery], agent: str) -> int:
    """How many recorded setpoints a wrong controller would say otherwise now."""
    return sum(
        isinstance(message, Setpoint) and message.source == agent and message.cycle >= WRONG_FROM
        for _, message in said
    )


@pytest.fixture
def go_wrong(monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    """From the call on, let two supervisors set -999 kW in the later cycles."""
    right = Supervisor.step

    def step(self: Supervisor, state: object, turn: Turn) -> object:
        state, outputs = right(self, state, turn)  # type: ignore[arg-type]
        if self.name not in WRONG_AGENTS or turn.cycle < WRONG_FROM:
            return state, outputs
        return state, [
            (port, replace(message, power_kw=-999.0) if isinstance(message, Setpoint) else message)
            for port, message in outputs
        ]

    return lambda: monkeypatch.setattr(Supervisor, "step", step)


def _number(pair: Delivery) -> int:
    """A number from the message's place, the same in every process."""
    return crc32(f"{pair[0]} {pair[1].cycle}".encode())


def is_accounted_for(account: Account) -> bool:
    unpaired = account.counts["only recorded"] + account.counts["recorded twice"]
    return account.recorded == account.compared + account.not_compared + unpaired


@pytest.mark.parametrize("seed", range(4))
def test_all_that_is_recorded_is_compared_or_said_not_to_be(seed: int, tmp_path: Path) -> None:
    for ratings_kw, periods in [(TWO_TIERS, (6, 2)), (THREE_TIERS, (4, 2, 1))]:
        plan = paper_plan(ratings_kw, periods)
        said = heard(plan, seed)
        left = lose(said, lambda pair: _number(pair) % 41 == seed)
        left = lose(left, lambda pair: 9 <= pair[1].cycle <= 11 and pair[1].source != "plant")
        found = verified(tmp_path / "run", plan, left)
        for name, account in found.accounts.items():
            assert is_accounted_for(account), name
            assert set(account.counts) <= {"only new", "input not recorded"}, name
        assert found.compared + found.not_compared == sum(
            message.source != "plant" for _, message in left
        )
        assert not found.equal


@pytest.mark.parametrize("seed", range(4))
def test_a_wrong_controller_is_found_after_a_burst_of_losses(
    go_wrong: Callable[[], None], seed: int, tmp_path: Path
) -> None:
    plan = paper_plan()
    left = lose(heard(plan, seed), lambda pair: 12 <= pair[1].cycle <= 14)
    go_wrong()
    found = verified(tmp_path / "run", plan, left)
    for agent in WRONG_AGENTS:
        count = planted(left, agent)
        account = found.accounts[agent]
        assert count > 20
        assert account.counts["differs"] == count
        assert all(not gap.open and gap.to_cycle < WRONG_FROM for gap in account.gaps)


@pytest.mark.parametrize("last_lost", [WRONG_FROM - 1, WRONG_FROM + 3, CYCLES - 2])
@pytest.mark.parametrize("share", [2, 5, 30])
def test_a_wrong_controller_is_found_or_its_messages_are_counted_as_not_compared(
    go_wrong: Callable[[], None], share: int, last_lost: int, tmp_path: Path
) -> None:
    plan = paper_plan()
    said = heard(plan)
    left = [
        pair
        for place, pair in enumerate(said)
        if pair[0].signal is RUN or pair[1].cycle > last_lost or place % share
    ]
    go_wrong()
    found = verified(tmp_path / "run", plan, left)
    for agent in WRONG_AGENTS:
        count = planted(left, agent)
        account = found.accounts[agent]
        assert is_accounted_for(account)
        assert account.counts["differs"] <= count
        assert account.counts["differs"] + account.not_compared >= count > 10
        if not account.counts["differs"]:
            assert account.not_compared_from is not None
    assert not found.equal


def test_who_remembers_for_longer_is_not_compared_any_more_and_that_is_said(
    go_wrong: Callable[[], None], tmp_path: Path
) -> None:
    plan = paper_plan()
    # From here on the supervisors lack a child's word in every cycle.
    left = lose(
        heard(plan),
        lambda pair: pair[1].cycle >= WRONG_FROM - 2 and str(pair[0]) in {"c1/a/impp", "c2/c/impp"},
    )
    folder = record(tmp_path / "run", plan, left)
    go_wrong()
    result = CliRunner().invoke(app, ["verify", str(folder), "--json", str(tmp_path / "out.json")])
    assert result.exit_code == 1
    document = json.loads((tmp_path / "out.json").read_text())["runs"][0]
    entries = {entry["agent"]: entry for entry in document["agents"]}
    for agent in WRONG_AGENTS:
        count = planted(left, agent)
        entry = entries[agent]
        assert "differs" not in entry["differences"]
        assert entry["not_compared_from"] in range(WRONG_FROM - 2, WRONG_FROM)
        assert entry["not_compared"] >= count > 20
        assert entry["recorded"] == entry["compared"] + entry["not_compared"]
        assert (
            f"\n{agent}: from cycle {entry['not_compared_from']} on not compared: "
            f"{entry['not_compared']} messages\n" in result.stdout
        )
    assert result.stdout.splitlines()[-1].startswith("NOT equal: ")
    assert max(map(len, result.stdout.splitlines()[1:])) <= 100


def test_a_run_that_lost_the_last_words_of_one_agent_is_undecided(
    tmp_path: Path, go_wrong: Callable[[], None]
) -> None:
    plan = paper_plan()
    said = [pair for pair in heard(plan) if pair[1] is not None and pair[1].cycle < CYCLES]
    # The link of one agent broke, then the recording: nothing tells that this is a loss.
    left = lose(said, lambda pair: pair[1].cycle >= 10 and pair[1].source.startswith("c"))
    left += [pair for pair in said if pair[1].source in WRONG_AGENTS and pair[1].cycle >= 10]
    left = [pair for pair in left if pair[0].signal is not RUN or pair[1].cycle == 0]
    folder = record(tmp_path / "run", plan, left)
    go_wrong()
    result = CliRunner().invoke(app, ["verify", str(folder), "--node", "c1,c2"])
    assert result.exit_code == 1
    assert result.stdout.splitlines()[-1].startswith(
        "UNDECIDED: no difference in what was compared; "
    )


def test_a_lost_input_in_lockstep_is_named_and_the_comparison_goes_on(tmp_path: Path) -> None:
    plan = plan_of(cycles=30, scheme="paper")
    said = lockstep_run(plan, cloudy_profile(plan))
    left = lose(said, lambda pair: pair[0] is TELEMETRY.of("c2/c") and pair[1].cycle == 11)
    account = verified(tmp_path / "run", plan, left).accounts["c2/c"]
    assert account.counts == {"input not recorded": 1}
    (gap,) = account.gaps
    assert (gap.from_cycle, gap.to_cycle, gap.open) == (11, 11, False)
    later = [
        (port, replace(message, alpha=0.0625))
        if port is COMMAND.of("c2/c") and message.cycle == 12
        else (port, message)
        for port, message in left
    ]
    account = verified(tmp_path / "run", plan, later).accounts["c2/c"]
    assert account.counts == {"input not recorded": 1, "differs": 1}
    assert account.first is not None
    assert account.first.cycle == 11, "the first in the order of cycles, whenever it was certain"
