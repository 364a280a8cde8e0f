"""What the recorder keeps of a run with external agents, and the account that it gives of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import cast

import pytest
from msgspec.structs import replace

from agents.events import Event, Recorded
from agents.launcher_link import LauncherLink
from agents.plan import RunPlan
from bus_schemas.codec import encode
from bus_schemas.messages import Impp, Message
from bus_schemas.signals import IMPP, Port
from bus_schemas.zenoh_bus import ZenohTap
from launch_scripts.launcher.simulation import MemoryRun
from launch_scripts.scenarios.preparation import RunOptions, prepare
from launch_scripts.scenarios.scenario import load_scenario
from recordings.read.reader import RunReader
from recordings.record.recorder import Recorder, RecordingEnd
from recordings.record.writer import RunWriter

CYCLES = 8
PREPARED = prepare(load_scenario("oahu"), RunOptions(duration=str(CYCLES)), "spoken")
DEVICE = "c2/inv07"
IN_LOCKSTEP = replace(PREPARED.plan, external=(DEVICE,))
PORT = IMPP.of(DEVICE)


def impp(cycle: int, power_kw: float = 1.0, sequence: int = 0, node: str = DEVICE) -> Impp:
    return Impp(
        cycle, 0, node, (), publish_time_ns=5, sequence=sequence, power_kw=power_kw, stale_cycles=0
    )


def messages_of_a_run() -> list[tuple[Port[Message], Message]]:
    """All that is said in a run in memory."""
    said: list[tuple[Port[Message], Message]] = []
    run = MemoryRun(
        IN_LOCKSTEP, PREPARED.profile, lambda port, message: said.append((port, message))
    )
    for _ in run.cycles():
        pass
    run.close()
    return said


class FakeTap:
    """The recorder's place on a bus that has delivered all."""

    def __init__(
        self, plan: RunPlan, said: Sequence[tuple[Port[Message], Message | bytes]]
    ) -> None:
        self._waiting = [
            (plan.keys.key(port), entry if isinstance(entry, bytes) else encode(entry))
            for port, entry in said
        ]

    def drain(self) -> Iterator[tuple[str, bytes]]:
        while self._waiting:
            yield self._waiting.pop(0)

    def watch_presence(self) -> None: ...

    def presence(self) -> list[tuple[str, bool]]:
        return []

    def publish(self, port: Port[Message], message: Message) -> None: ...


class FakeLink:
    def __init__(self) -> None:
        self.told: list[Event] = []

    def tell(self, event: Event) -> None:
        self.told.append(event)

    def expected_messages(self) -> None: ...


def recorded(
    said: Sequence[tuple[Port[Message], Message | bytes]], folder: Path
) -> tuple[list[Message], Recorded]:
    """What a recorder keeps of a device's IMPPs, and its account."""
    writer = RunWriter(folder / "run.mcap", IN_LOCKSTEP, 'name = "oahu"\n', "launch")
    end, link = RecordingEnd(), FakeLink()
    end.ask()
    Recorder(
        IN_LOCKSTEP,
        cast("ZenohTap", FakeTap(IN_LOCKSTEP, said)),
        writer,
        cast("LauncherLink", link),
        end,
        lambda text: None,
    ).run()
    (account,) = [event for event in link.told if isinstance(event, Recorded)]
    with RunReader(folder) as reader:
        return [message for port, message in reader.messages(IMPP) if port is PORT], account


def test_a_device_that_answers_ahead_is_recorded_with_both_messages_and_named(
    tmp_path: Path,
) -> None:
    said = messages_of_a_run()
    arming = [(port, replace(message, cycle=-1)) for port, message in said if message.cycle == 0]
    place = next(n for n, (port, message) in enumerate(said) if port is PORT and message.cycle == 2)
    said.insert(place, (PORT, impp(6)))
    kept, account = recorded(arming + said, tmp_path)
    assert [message.cycle for message in kept] == [0, 1, 6, 2, 3, 4, 5, 6, 7]
    assert account.foreign == 0
    assert "repeated" in {entry.cause for entry in account.complaints}
    assert account.cycles == CYCLES


@pytest.mark.parametrize("node", [DEVICE, "c1/inv01"])
def test_a_payload_that_is_nested_very_deep_is_set_aside(node: str, tmp_path: Path) -> None:
    payload = b"\x82\xa5cycle\x01\xa4more" + b"\x91" * 300_000 + b"\xc0"
    said = messages_of_a_run()
    arming = [(port, replace(message, cycle=-1)) for port, message in said if message.cycle == 0]
    kept, account = recorded([*arming, *said, (IMPP.of(node), payload)], tmp_path)
    assert len(kept) == CYCLES
    assert "undecodable" in {entry.cause for entry in account.complaints}


def of_a_run(answers: list[tuple[int, int]], folder: Path) -> Recorded:
    """The recorder's account of a run in which a device gives these IMPPs: cycle and number."""
    said = messages_of_a_run()
    arming = [(port, replace(message, cycle=-1)) for port, message in said if message.cycle == 0]
    spoken = [entry for entry in said if entry[0] is not PORT]
    place = 0
    for cycle, sequence in answers:
        while cycle < CYCLES and spoken[place][1].cycle < cycle:
            place += 1
        place += 1
        spoken.insert(place, (PORT, impp(cycle, sequence=sequence)))
    return recorded(arming + spoken, folder)[1]


@pytest.mark.parametrize(
    ("answers", "lost"),
    [
        ([(cycle, 10 * cycle + n) for cycle in range(CYCLES) for n in range(10)], 0),
        ([(cycle, 10 * cycle + n) for cycle in range(CYCLES) for n in range(10) if n != 7], CYCLES),
        ([(0, 0), (1, 1), (1, 1), (2, 2), (2, 0), (3, 3), (4, 4), (5, 5), (6, 6), (7, 7)], 0),
        ([(0, 0), (1, 1), (2, 2), (3, 3), (4, 0), (5, 1), (6, 3), (7, 4)], 1),
        ([(0, 0), (1, 1), (2, 2), (500, 3), (10**12, 0), (3, 4), (4, 5), (5, 6)], 0),
    ],
    ids=["ten at a time", "one of ten lost", "copies", "begun anew", "far off"],
)
def test_what_a_device_lost_is_told_from_the_numbers_of_all_that_came(
    answers: list[tuple[int, int]], lost: int, tmp_path: Path
) -> None:
    (device,) = of_a_run(answers, tmp_path).external
    assert device.lost == lost
