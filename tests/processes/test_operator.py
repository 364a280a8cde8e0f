"""Orders to a run of processes: by whom they come, and by whom they do not."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from command_line import done, refusal
from running import REPOSITORY, Device, Start
from test_launch import summary_of

from bus_schemas.messages import Dispatch
from bus_schemas.signals import DISPATCH, ORDER
from bus_schemas.tree import CENTRAL, OPERATOR
from recordings.read.reader import RunReader
from recordings.verify.verification import verify

pytestmark = pytest.mark.processes

PROGRAM = REPOSITORY / "examples" / "agc.py"


def sources(folder: Path) -> set[str]:
    """Who gave the orders that the plant obeyed."""
    return {message.order_source for message in dispatches_of(folder)} - {""}


def dispatches_of(folder: Path) -> list[Dispatch]:
    with RunReader(folder) as reader:
        messages = [message for _, message in reader.messages(DISPATCH)]
    return [message for message in messages if isinstance(message, Dispatch)]


@pytest.fixture
def keys(plant: str, tmp_path: Path) -> str:
    pytest.importorskip("cryptography")
    done("keys", plant, "--out", tmp_path / "keys")
    return str(tmp_path / "keys")


def test_a_program_with_the_operators_keys_gives_an_agc_signal_and_the_schedule_returns_after_it(
    heliarch: Start, device: Device, plant: str, keys: str
) -> None:
    words = ("--pace", "10", "--duration", "90", "--secure", "--keys", keys)
    run = heliarch("launch", plant, *words, "--external", OPERATOR)
    program = device(PROGRAM, "--plan", run.folder / "plan.json", "--duration", "20")
    assert run.wait() == 0, run.error_text()
    assert program.wait(timeout=60) == 0
    with RunReader(run.folder) as reader:
        given = [message for _, message in reader.messages(ORDER)]
    dispatches = dispatches_of(run.folder)
    states = {one.order_state for one in dispatches}
    assert states == {"none", "holds", "silent", "over"}
    last = dispatches[-1]
    assert last.power_kw == last.commitment_kw
    assert 3 <= len(given) == len({one.order_cycle for one in dispatches} - {0})
    (account,) = summary_of(run.folder).external
    assert (account.agent, account.recorded, account.lost) == (OPERATOR, {"order": len(given)}, 0)
    assert verify(run.folder).equal


def test_an_order_while_the_central_controller_is_away_is_answered_and_counts(
    heliarch: Start, plant: str
) -> None:
    run = heliarch("launch", plant, "--pace", "1", "--duration", "1h")
    run.until_recorded(3)
    run.process_of(CENTRAL).kill()
    reply, settled = done("order", run.folder, "1MW").splitlines()
    assert reply.startswith("in force from cycle ")
    assert settled.startswith("1,000 kW reached")
    run.interrupt()
    (restarts,) = [summary_of(run.folder).restarts]
    assert restarts == {CENTRAL: 1}
    assert verify(run.folder).equal


def test_without_keys_an_operators_program_is_refused(plant: str) -> None:
    assert "--secure" in refusal("launch", plant, "--external", OPERATOR, "--pace", "1")


def test_the_socket_is_closed_to_other_users(heliarch: Start, plant: str) -> None:
    if os.geteuid() != 0:
        pytest.skip("needs root, to be another user")
    run = heliarch("launch", plant, "--pace", "10", "--duration", "1h")
    run.until_running()
    child = os.fork()
    if child == 0:
        os.setgid(65_534)
        os.setuid(65_534)
        try:
            from sim_plant.order_desk import OrderLine  # noqa: PLC0415

            OrderLine(run.folder)
        except PermissionError:
            os._exit(13)
        except BaseException:
            os._exit(1)
        os._exit(0)
    _, status = os.waitpid(child, 0)
    assert os.waitstatus_to_exitcode(status) == 13
    assert "1,000 kW" in done("order", run.folder, "1MW")
    run.interrupt()
    assert sources(run.folder) == {"command"}
    assert verify(run.folder).equal
