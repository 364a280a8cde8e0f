"""Agents that the launcher leaves out: which, how they are waited for, what is said of them."""

from __future__ import annotations

import socket
from functools import cache
from pathlib import Path
from typing import Literal

import pytest
from complaints import complaint_of
from msgspec.structs import replace

from agents.events import Complaint, Presence, Status
from agents.plan import RunPlan, load_plan
from bus_schemas.errors import InputError
from bus_schemas.links import explicit_links
from launch_scripts.launcher.run_folder import RunFolder
from launch_scripts.launcher.tcp_ports import reserved_ports
from launch_scripts.scenarios.externals import (
    ExternalWatch,
    addresses_of,
    check_base_port,
    check_externals,
)
from launch_scripts.scenarios.preparation import RunOptions, prepare
from launch_scripts.scenarios.scenario import load_scenario

NODE = "c1/inv01"


@cache
def planned(
    *agents: str, pace: float | Literal["max"] = "max", base_port: int | None = None
) -> RunPlan:
    options = RunOptions(duration="10", pace=pace, external=list(agents), base_port=base_port)
    return prepare(load_scenario("oahu"), options, "run-1").plan


def watch(*agents: str, pace: float | Literal["max"] = "max") -> ExternalWatch:
    plan = planned()
    listening = explicit_links(plan.tree).listening
    plan = replace(
        plan,
        external=agents,
        cycle_wall_ns=0 if pace == "max" else 1_000_000_000,
        tcp_ports={agent: 7500 + place for place, agent in enumerate(listening)},
    )
    return ExternalWatch(plan, Path("my-run/plan.json"), 60.0, began_at=100.0)


def test_the_plan_names_them_in_the_order_of_the_tree() -> None:
    assert planned(NODE, "plant", "c1", NODE).external == ("plant", "c1", NODE)
    assert planned().external == ()
    assert planned(NODE).bus_namespace == "run-1"
    assert planned(NODE, base_port=7500).bus_namespace == "oahu", "a device is configured once"


@pytest.mark.parametrize(
    ("agents", "timeout_s", "complaint"),
    [
        (("recorder",), 60.0, "--external: expected"),
        (("c1/inv1",), 60.0, "--external: expected"),
        (("",), 60.0, "--external: expected"),
        ((NODE,), 0.0, "--external-timeout: expected"),
        ((NODE,), float("nan"), "--external-timeout: expected"),
        ((NODE,), 1e9, "--external-timeout: expected"),
    ],
)
def test_bad_options_are_refused_in_one_line(
    agents: tuple[str, ...], timeout_s: float, complaint: str
) -> None:
    found = complaint_of(check_externals, agents, timeout_s, planned().tree)
    assert found.startswith(complaint)


@pytest.mark.parametrize(
    ("base_port", "agents", "standby"),
    [(80, (), ()), (65_531, (), ()), (65_530, (), ("c1",)), (65_530, (NODE,), ())],
)
def test_ports_that_there_are_not_are_refused(
    base_port: int, agents: tuple[str, ...], standby: tuple[str, ...]
) -> None:
    plan = replace(planned(*agents, pace=1.0), standby=standby)
    assert complaint_of(check_base_port, base_port, plan).startswith("--base-port: expected")
    check_base_port(65_535 - 11, plan)


SECOND = "127.0.0.2"


@pytest.mark.parametrize(
    ("on", "secure", "named"),
    [
        (("10.0.0.2=c2/*",), False, "--on 10.0.0.2=c2/*: expected --secure"),
        (("10.0.0.2=c2/*",), True, "--on 10.0.0.2=c2/*: expected --address"),
        (("lab=c2",), False, "--on lab=c2: expected ADDRESS=AGENTS"),
        ((SECOND,), False, f"--on {SECOND}: expected ADDRESS=AGENTS"),
        ((f"{SECOND}=c9",), False, f"--on {SECOND}=c9: node 'c9'"),
        ((f"{SECOND}=plant",), False, f"--on {SECOND}=plant: expected controllers"),
        ((f"{SECOND}=c1/*",), False, f"--on {SECOND}=c1/*: expected each agent in one place"),
        ((f"{SECOND}=c2", "127.0.0.3=c2/*"), False, "--on 127.0.0.3=c2/*: expected each agent"),
    ],
)
def test_a_place_that_cannot_be_is_refused(on: tuple[str, ...], secure: bool, named: str) -> None:
    found = complaint_of(addresses_of, on, planned().tree, (NODE,), "127.0.0.1", secure=secure)
    assert found.startswith(named)


def test_what_stops_processes_of_another_host_is_refused() -> None:
    options = RunOptions(pace=1.0, on=[f"{SECOND}=c1"], faults=["kill=c1,at=2s"])
    found = complaint_of(prepare, load_scenario("oahu"), options, "run-1")
    assert "kill=c1,at=2s: expected controllers" in found


def test_ports_begin_with_the_base_port_and_must_be_free() -> None:
    with reserved_ports(("recorder", "plant")) as found:
        first = found["recorder"]
    with reserved_ports(("recorder",), first) as found:
        assert found == {"recorder": first}
    with socket.create_server(("127.0.0.1", 0)) as server:
        taken = server.getsockname()[1]
        complaint = f"--base-port: expected .* port {taken} of recorder"
        with pytest.raises(InputError, match=complaint), reserved_ports(("recorder",), taken):
            pass


def test_only_who_never_came_is_missed_and_only_after_the_time_out() -> None:
    externals = watch(NODE, "central")
    assert externals.complete_at is None
    assert (
        externals.hear(Presence(NODE, True, -1), 101.0, running=False)
        == f"{NODE} (external) is here"
    )
    assert externals.late(159.0) == ""
    assert externals.late(161.0).startswith("no sign of central after 60 s: no liveliness token")
    assert "my-run/plan.json" in externals.late(161.0)
    assert "tcp/" not in externals.late(161.0), "the endpoints stand in the directions above"
    assert NODE not in externals.late(161.0)
    externals.hear(Presence("central", True, -1), 161.0, running=False)
    assert externals.late(162.0) == ""
    assert externals.complete_at == 161.0
    assert (watch().complete_at, watch().late(1e9)) == (100.0, "")


def test_a_plant_that_goes_in_lockstep_has_missed_what_came_since() -> None:
    externals = watch("plant", pace="max")
    externals.hear(Presence("plant", True, -1), 101.0, running=False)
    externals.hear(Presence("plant", False, 41), 150.0, running=True)
    assert externals.plant_gone_at == 150.0
    back = externals.hear(Presence("plant", True, 41), 151.0, running=True)
    assert "what it missed since cycle 41" in back, "in lockstep nothing is sent again"
    assert "plant went away in cycle 41" in externals.explain("stalled", running=True)


def test_who_does_not_answer_arming_rounds_is_named_first_with_what_was_wrong() -> None:
    externals = watch(NODE, "c1")
    externals.complain(Complaint("oahu/c1/inv01/impp", "other_cycle", 1, "it is of cycle 0"))
    externals.complain(Complaint("oahu/c2/inv99/impp", "unknown", 1, "not of this run"))
    unheard = ["c1/setpoint", "c1/inv01/command", "c1/inv01/impp"]
    externals.note(Status(-1, 0, 0.0, 0.0, 0.0, [], 0, unheard=unheard))
    first, *others = externals.explain("plant gave up", running=False).splitlines()
    assert first.startswith(
        "c1/inv01 (external) does not answer the arming rounds: nothing came on "
        "c1/inv01/command, c1/inv01/impp; "
    )
    assert others == [
        "plant gave up",
        "wrong message on oahu/c1/inv01/impp: it is of cycle 0",
    ]


def test_a_plan_appears_whole_after_all_that_it_refers_to(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = RunFolder(tmp_path / "run")
    there_before: list[str] = []

    def replaced(source: Path, target: Path) -> None:
        there_before.extend(sorted(path.name for path in target.parent.iterdir()))
        source.rename(target)

    monkeypatch.setattr(Path, "replace", replaced)
    preparation = prepare(load_scenario("oahu"), RunOptions(duration="10"), "run-1")
    plan = folder.fill(preparation, {"plant": 7501})
    finished = [name for name in there_before if not name.endswith(".unfinished")]
    assert finished == ["logs", "profile.npz", "scenario.toml", "users"]
    assert load_plan(folder.plan) == plan
