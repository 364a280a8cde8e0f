"""The state of each agent in each cycle: of killed, frozen, cut and healthy ones."""

from __future__ import annotations

from pathlib import Path

import pytest
from command_line import done
from recordings_by_hand import whole_run, write_run
from running import small_plant

from bus_schemas.messages import GivenUp
from bus_schemas.signals import GIVEN_UP
from bus_schemas.tree import ROOT
from recordings.inspect.agent_states import AgentStates, states_of
from recordings.read.reader import RunReader

CYCLES = 60
FAULTS = (
    "kill=c1/inv01,at=10s",
    "kill=c1/inv01,at=10.7s",
    "freeze=c2,at=20s..26s",
    "partition=c1|central,at=40s..46s",
    "loss=3%,at=50s..60s",
)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run with a kill, a freeze and a cut."""
    folder = tmp_path_factory.mktemp("states") / "run"
    plant = small_plant(folder.with_name("plant"))
    faults = (word for fault in FAULTS for word in ("--fault", fault))
    late = ("--set", "restart.backoff_s=4.7")  # Before the second restart.
    done("simulate", plant, "--duration", str(CYCLES), *faults, *late, "--out", folder)
    return folder


def kinds(states: AgentStates, agent: str, *cycles: int) -> list[tuple[str, str, int]]:
    found = (states.at(agent, cycle) for cycle in cycles)
    return [(state.kind, state.cause, state.level) for state in found]


def test_an_agent_that_is_given_up_stays_so(tmp_path: Path) -> None:
    deliveries = list(whole_run(20))
    place = next(i for i, (_, message) in enumerate(deliveries) if message.cycle == 9)
    given_up = GivenUp(9, 0, "plant", (), agents=("c2/d",))
    deliveries.insert(place, (GIVEN_UP.of(ROOT), given_up))
    write_run(
        tmp_path / "run.mcap",
        deliveries,
        is_kept=lambda one: one[1].source != "c2/d" or one[1].cycle < 5,
    )
    with RunReader(tmp_path / "run.mcap") as reader:
        states = states_of(reader)
    assert kinds(states, "c2/d", 4, 5, 8, 9, 19) == [
        *(("fine", "", 0), ("absent", "", 1), ("absent", "", 2)),
        *(("given up", "", 2), ("given up", "", 2)),
    ]


def test_cycles_in_which_nobody_was_recorded_are_no_silence(tmp_path: Path) -> None:
    write_run(tmp_path / "run.mcap", whole_run(20), is_kept=lambda one: not 5 <= one[1].cycle < 9)
    with RunReader(tmp_path / "run.mcap") as reader:
        states = states_of(reader)
    assert {states.at(agent, 7).cause for agent in states.agents} == {"from the recorder"}
    assert {states.at(agent, 9).kind for agent in states.agents} == {"fine"}
    assert [(span.agent, span.kind) for span in states.spans()] == [("recorder", "cut off")]
