"""Agents that the launcher leaves out: which, how they are waited for, what is said of them."""

from __future__ import annotations

import socket
from pathlib import Path
from typing import Any

import pytest
from plans_by_hand import REAL_TIME, plan_at_noon

from agents.events import Presence
from agents.plan import load_plan
from bus_schemas.errors import InputError
from launch_scripts.launcher.external_watch import ExternalWatch
from launch_scripts.launcher.run_folder import RunFolder
from launch_scripts.launcher.tcp_ports import reserved_ports
from launch_scripts.scenarios.preparation import RunOptions, prepare
from launch_scripts.scenarios.scenario import load_scenario

NODE = "c1/a"


def watch(*agents: str, **changes: Any) -> ExternalWatch:
    """A run that waits for these agents since 100 s, up to a minute."""
    plan = plan_at_noon(external=agents, **changes)
    return ExternalWatch(plan, Path("my-run/plan.json"), 60.0, began_at=100.0)


def test_the_plan_names_them_in_the_order_of_the_tree() -> None:
    node, oahu = "c1/inv01", load_scenario("oahu")
    device = RunOptions(duration="10", external=[node, "plant", "c1", node], base_port=7500)
    plan = prepare(oahu, device, "run-1").plan
    assert plan.external == ("plant", "c1", node)
    assert plan.bus_namespace == "oahu", "a device is configured once"


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
    externals.hear(Presence(NODE, True, -1), 101.0)
    assert (externals.complete_at, externals.late(159.0)) == (None, "")
    assert externals.late(161.0).startswith("no sign of central after 60 s")
    assert externals.hear(Presence("central", True, 7), 161.0).endswith("is here")
    assert (externals.complete_at, externals.late(162.0)) == (161.0, "")


@pytest.mark.parametrize(
    ("agent", "changes", "gone"),
    [
        ("plant", {}, [True, True]),
        (NODE, {}, [True, True]),
        ("plant", {"cycle_wall_ns": REAL_TIME}, [True, False]),
        (NODE, {"cycle_wall_ns": REAL_TIME}, [False, False]),
    ],
)
def test_the_plant_is_missed_while_it_is_gone_and_in_lockstep_each_device_from_then_on(
    agent: str, changes: dict[str, Any], gone: list[bool]
) -> None:
    externals = watch(agent, **changes)
    assert externals.hear(Presence(agent, True, -1), 100.0).endswith("is here")
    assert "goes on" not in externals.hear(Presence(agent, False, -1), 101.0)
    # The recorder may tell of a return, or of its first sign, only when cycles have begun.
    assert "is back" in externals.hear(Presence(agent, True, 3), 102.0)
    assert not externals.gone
    found = []
    for alive in (False, True):
        externals.hear(Presence(agent, alive, 41), 150.0)
        found.append(externals.gone == {agent: 150.0})
    assert found == gone


def test_keys_without_an_answer_to_the_arming_rounds_are_named_first() -> None:
    externals = watch(NODE, "c1")
    externals.unheard = ["c1/setpoint"]
    unheard, failure = externals.explain("plant gave up").splitlines()
    assert (failure, unheard.split()[-1]) == ("plant gave up", "c1/setpoint")


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
