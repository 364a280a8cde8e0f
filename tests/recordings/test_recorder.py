"""What belongs to the recording of what external agents say: all that a listener may have used."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import cast

import numpy as np
import pytest
from msgspec.structs import replace

from agents.events import Event, Recorded
from agents.lifeline import Lifeline
from agents.plan import RunPlan
from bus_schemas.codec import encode
from bus_schemas.messages import Dispatch, Impp, Message
from bus_schemas.signals import COMMAND, DISPATCH, HELP, IMPP, NOTICE, PRODUCTION, RUN, Port
from bus_schemas.zenoh_bus import ZenohTap
from launch_scripts.preparation import RunOptions, prepare
from launch_scripts.scenario import load_scenario
from launch_scripts.simulation import MemoryRun
from recordings.reader import RunReader
from recordings.recordable_messages import MOST_WORDS, SpokenWords
from recordings.recorder import Recorder, RecordingEnd
from recordings.series import SeriesCollector
from recordings.writer import RunWriter

CYCLES = 8
PREPARED = prepare(load_scenario("oahu"), RunOptions(duration=str(CYCLES)), "spoken")
DEVICE = "c2/inv07"
IN_LOCKSTEP = replace(PREPARED.plan, external=(DEVICE,))
PORT = IMPP.of(DEVICE)


def in_real_time(cycle_s: float) -> RunPlan:
    return replace(IN_LOCKSTEP, cycle_wall_ns=round(cycle_s * 1e9))


def impp(cycle: int, power_kw: float = 1.0, sequence: int = 0, node: str = DEVICE) -> Impp:
    return Impp(
        cycle, 0, node, (), publish_time_ns=5, sequence=sequence, power_kw=power_kw, stale_cycles=0
    )


def cause(words: SpokenWords, message: Impp, newest: int, port: Port[Message] = PORT) -> str:
    """What is wrong with a message, in one word; in brackets if it is recorded all the same."""
    objection = words.objection(port, message, newest)
    if objection is None:
        return ""
    return f"({objection.cause})" if objection.is_recorded else objection.cause


def words_of_a_run() -> list[tuple[Port[Message], Message]]:
    """All that is said in a run in memory."""
    said: list[tuple[Port[Message], Message]] = []
    run = MemoryRun(
        IN_LOCKSTEP, PREPARED.profile, lambda port, message: said.append((port, message))
    )
    for _ in run.cycles():
        pass
    run.close()
    return said


def test_a_second_word_that_says_something_else_is_recorded_too() -> None:
    words = SpokenWords(IN_LOCKSTEP)
    assert cause(words, impp(15), newest=10) == ""
    assert cause(words, impp(15, 2.0, sequence=5), newest=15) == "(repeated)"
    assert cause(words, impp(15, 2.0, sequence=6), newest=15) == "duplicate", "it says nothing new"
    assert cause(words, impp(15, 1.0, sequence=7), newest=15) == "duplicate"
    assert cause(words, impp(16, 2.0), newest=15) == ""


def test_of_a_device_that_never_ends_only_so_much_is_recorded() -> None:
    words = SpokenWords(IN_LOCKSTEP)
    causes = [cause(words, impp(3, float(number)), newest=3) for number in range(1000)]
    assert causes[:MOST_WORDS] == ["", *["(repeated)"] * (MOST_WORDS - 1)]
    assert set(causes[MOST_WORDS:]) == {"duplicate"}


def test_what_nobody_listens_to_has_one_word() -> None:
    words = SpokenWords(replace(IN_LOCKSTEP, external=("plant",)))
    port = PRODUCTION.of("")
    assert cause(words, impp(3, 1.0), 3, port) == ""
    assert cause(words, impp(3, 2.0), 3, port) == "duplicate"


def test_of_the_run_s_own_processes_there_is_one_word_and_an_old_one_is_recorded_once() -> None:
    words, port = SpokenWords(IN_LOCKSTEP), COMMAND.of("c1/inv01")
    for cycle in range(300):
        assert cause(words, impp(cycle), cycle, port) == ""
    assert cause(words, impp(299, 2.0), 299, port) == "duplicate"
    assert cause(words, impp(3), 299, port) == "", "it had fallen behind"
    assert cause(words, impp(3), 299, port) == "duplicate"
    assert cause(words, impp(299 + 1001), 299, port) == "other_cycle"


def test_words_of_a_cycle_long_ago_or_far_ahead_are_set_aside_however_often_they_come() -> None:
    words = SpokenWords(IN_LOCKSTEP)
    for cycle in range(300):
        assert cause(words, impp(cycle), cycle) == ""
        if cycle > 200:
            assert cause(words, impp(3), cycle) == "late"
            assert cause(words, impp(cycle + 500), cycle) == "other_cycle"
            assert cause(words, impp(cycle - 50), cycle) == "duplicate"


@pytest.mark.parametrize("signal", [HELP, NOTICE])
def test_rare_words_of_another_cycle_are_set_aside_too(signal: object) -> None:
    words, port = SpokenWords(IN_LOCKSTEP), (HELP if signal is HELP else NOTICE).of(DEVICE)
    assert cause(words, impp(3), 300, port) == "late"
    assert cause(words, impp(330), 300, port) == "other_cycle"


@pytest.mark.parametrize("cycle_s", [0.002, 0.05, 1.0])
def test_a_recorder_that_stood_still_in_real_time_may_hear_any_link_first(cycle_s: float) -> None:
    words, count = SpokenWords(in_real_time(cycle_s)), round(9.5 / cycle_s)
    assert {cause(words, impp(cycle), newest=-1) for cycle in range(count)} == {""}
    words = SpokenWords(in_real_time(cycle_s))
    assert {cause(words, impp(cycle), newest=count) for cycle in range(count)} == {""}


def test_a_listener_s_longest_period_is_within_the_window() -> None:
    plan = replace(IN_LOCKSTEP, period_cycles=(60, 1))
    assert cause(SpokenWords(plan), impp(161), newest=100) == ""


def test_what_is_remembered_of_a_device_is_bounded() -> None:
    words = SpokenWords(IN_LOCKSTEP)
    for cycle in range(5000):
        assert cause(words, impp(cycle), cycle) == ""
    assert len(words._external_words[PORT]) < 500


# The recorder -------------------------------------------------------------------------------------


class FakeTap:
    """The recorder's place on a bus that has delivered all."""

    def __init__(self, plan: RunPlan, said: list[tuple[Port[Message], Message]]) -> None:
        self._waiting = [(plan.keys.key(port), encode(message)) for port, message in said]

    def drain(self) -> Iterator[tuple[str, bytes]]:
        while self._waiting:
            yield self._waiting.pop(0)

    def watch_presence(self) -> None: ...

    def presence(self) -> list[tuple[str, bool]]:
        return []

    def publish(self, port: Port[Message], message: Message) -> None: ...


class FakeLifeline:
    def __init__(self) -> None:
        self.told: list[Event] = []

    def tell(self, event: Event) -> None:
        self.told.append(event)


def recorded(
    said: list[tuple[Port[Message], Message]], folder: Path
) -> tuple[list[Message], Recorded]:
    """What a recorder keeps of a device's IMPPs, and its account."""
    writer = RunWriter(folder / "run.mcap", IN_LOCKSTEP, 'name = "oahu"\n', "launch")
    end, lifeline = RecordingEnd(), FakeLifeline()
    Recorder(
        IN_LOCKSTEP,
        cast("ZenohTap", FakeTap(IN_LOCKSTEP, said)),
        writer,
        cast("Lifeline", lifeline),
        end,
        lambda text: None,
        attached=False,
    ).run()
    (account,) = [event for event in lifeline.told if isinstance(event, Recorded)]
    with RunReader(folder) as reader:
        return [message for port, message in reader.messages(IMPP) if port is PORT], account


def test_of_several_words_the_series_of_a_run_hold_the_first() -> None:
    collector = SeriesCollector(IN_LOCKSTEP)
    run = MemoryRun(IN_LOCKSTEP, PREPARED.profile, collector.see)
    for _ in run.cycles():
        pass
    before = collector.series("once")
    for cycle in range(CYCLES):
        collector.see(PORT, impp(cycle, 0.25))
    dispatch = Dispatch(3, 0, "plant", (), power_kw=1.0, commitment_kw=1.0, regulation_kw=0.0)
    collector.see(DISPATCH.of(""), dispatch)
    after = collector.series("twice")
    assert np.array_equal(after.impp_kw, before.impp_kw)
    assert np.array_equal(after.commitment_kw, before.commitment_kw)


def test_a_device_that_speaks_ahead_is_recorded_with_both_words_and_named(tmp_path: Path) -> None:
    said = words_of_a_run()
    arming = [(port, replace(message, cycle=-1)) for port, message in said if message.cycle == 0]
    place = next(n for n, (port, message) in enumerate(said) if port is PORT and message.cycle == 2)
    said.insert(place, (PORT, impp(6)))
    kept, account = recorded(arming + said, tmp_path)
    assert [message.cycle for message in kept] == [0, 1, 6, 2, 3, 4, 5, 6, 7]
    (device,) = account.external
    assert device.answered == device.expected == 3 * CYCLES
    assert account.foreign == 0
    assert ("repeated", 1) in [(entry.cause, entry.count) for entry in account.complaints]
    assert len(account.plant.desired_kw) == CYCLES


def of_a_run(words: list[tuple[int, int]], folder: Path) -> Recorded:
    """The recorder's account of a run in which a device gives these IMPPs: cycle and number."""
    said = words_of_a_run()
    arming = [(port, replace(message, cycle=-1)) for port, message in said if message.cycle == 0]
    spoken = [entry for entry in said if entry[0] is not PORT]
    place = 0
    for cycle, sequence in words:
        while cycle < CYCLES and spoken[place][1].cycle < cycle:
            place += 1
        place += 1
        spoken.insert(place, (PORT, impp(cycle, sequence=sequence)))
    return recorded(arming + spoken, folder)[1]


@pytest.mark.parametrize(
    ("words", "lost"),
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
    words: list[tuple[int, int]], lost: int, tmp_path: Path
) -> None:
    (device,) = of_a_run(words, tmp_path).external
    assert device.lost == lost


def test_a_plant_that_begins_twice_is_named_and_the_run_began_with_the_first(
    tmp_path: Path,
) -> None:
    begin = (RUN.of(""), IN_LOCKSTEP.run_message("start", 0, 5))
    end = (RUN.of(""), IN_LOCKSTEP.run_message("stop", CYCLES, 0))
    account = recorded([begin, begin, end], tmp_path)[1]
    assert [(entry.key, entry.cause, entry.count) for entry in account.complaints] == [
        ("oahu/run", "repeated", 1)
    ]
