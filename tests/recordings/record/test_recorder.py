"""What the recorder keeps of a run with external agents, and says of them; its arming rounds."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from itertools import chain, groupby, pairwise, repeat
from pathlib import Path
from typing import cast

import msgspec
import pytest
from buses_by_hand import LinkByHand, SubscriberByHand
from msgspec.structs import replace
from recorded_runs import cloudy_profile, plan_of, published

from agents.process.beats import BEAT_S
from agents.process.events import Complaint, Recorded
from agents.process.launcher_link import LauncherLink
from bus_schemas.codec import encode, encode_bundle
from bus_schemas.errors import InputWarning
from bus_schemas.messages import Impp, Message, Setpoint
from bus_schemas.signals import DISPATCH, IMPP, RUN, SETPOINT, Occurrence, Port, ports
from bus_schemas.tree import CENTRAL, PLANT, ROOT
from bus_schemas.zenoh_session import RunSubscriber
from launch_scripts.run_end import external_account
from recordings.inspect.overview import read_through
from recordings.read.reader import RunReader
from recordings.record.complaints import Complaints, SecondSenders
from recordings.record.phases import ArmingRound
from recordings.record.recorder import Recorder
from recordings.record.writer import RunWriter
from results.run_document import ExternalAccount

CYCLES = 8
DEVICE = "c2/d"
IN_LOCKSTEP = plan_of(cycles=CYCLES, external=(DEVICE,))
PORT = IMPP.of(DEVICE)
SAID = published(IN_LOCKSTEP, cloudy_profile(IN_LOCKSTEP))

Spoken = tuple[Port[Message], Message | bytes]


def impp(cycle: int, sequence: int = 0) -> Impp:
    return Impp(
        cycle, 0, DEVICE, (), publish_time_ns=5, sequence=sequence, power_kw=1.0, stale_cycles=0
    )


def recorded(
    said: Iterable[Spoken], folder: Path, expected: int | None = None
) -> tuple[list[Message], Recorded]:
    """What a recorder keeps of a device's IMPPs after an arming round, and its account.

    expected: What the launcher says the others have published. None: it ends with SIGTERM.
    """
    arming = [(port, replace(message, cycle=-1)) for port, message in SAID if not message.cycle]
    waiting = (
        (IN_LOCKSTEP.wiring.key(port), entry if isinstance(entry, bytes) else encode(entry))
        for port, entry in chain(arming, said)
    )
    subscriber, link = SubscriberByHand(lambda: waiting), LinkByHand(expected is None, expected)
    writer = RunWriter(folder / "run.mcap", IN_LOCKSTEP, 'name = "oahu"\n', "launch")
    Recorder(
        IN_LOCKSTEP, cast("RunSubscriber", subscriber), writer, cast("LauncherLink", link)
    ).run()
    (own,) = [event for event in link.told if isinstance(event, Recorded)]
    with RunReader(folder) as reader:
        return [message for port, message in reader.messages(IMPP) if port is PORT], own


def device_in(folder: Path) -> ExternalAccount:
    with RunReader(folder) as reader:
        return external_account(IN_LOCKSTEP, DEVICE, CYCLES, read_through(reader)[1])


def test_a_device_that_answers_ahead_is_recorded_and_named(tmp_path: Path) -> None:
    said = list(SAID)
    place = next(n for n, (port, message) in enumerate(said) if port is PORT and message.cycle == 2)
    said.insert(place, (PORT, impp(6)))
    kept, account = recorded(said, tmp_path)
    assert [message.cycle for message in kept] == [0, 1, 6, 2, 3, 4, 5, 6, 7]
    assert account.foreign == 0
    assert "conflicting" in {entry.cause for entry in account.complaints}
    assert account.cycles == CYCLES


OTHERS = [(port, m) for port, m in SAID if port.publisher != DEVICE]


def test_a_flood_without_end_does_not_hold_up_the_end_of_a_recording(tmp_path: Path) -> None:
    _, account = recorded(chain(OTHERS, repeat((PORT, b""))), tmp_path, len(OTHERS))
    assert account.cycles == CYCLES
    assert device_in(tmp_path).answered == 0


@pytest.mark.parametrize(
    ("answers", "lost"),
    [
        ([(cycle, 10 * cycle + n) for cycle in range(CYCLES) for n in range(10) if n != 7], CYCLES),
        ([(0, 0), (1, 1), (2, 2), (500, 3), (10**12, 0), (3, 4), (4, 5), (5, 6)], 0),
    ],
    ids=["one of ten lost", "far off"],
)
def test_messages_of_a_device_that_are_lost_are_counted_by_their_numbers(
    answers: list[tuple[int, int]], lost: int, tmp_path: Path
) -> None:
    spoken = [entry for entry in SAID if entry[0] is not PORT]
    place = 0
    for cycle, sequence in answers:
        while cycle < CYCLES and spoken[place][1].cycle < cycle:
            place += 1
        place += 1
        spoken.insert(place, (PORT, impp(cycle, sequence=sequence)))
    recorded(spoken, tmp_path)
    device = device_in(tmp_path)
    assert device.lost == lost


@pytest.mark.parametrize("node", [DEVICE, "c1/a"])
@pytest.mark.parametrize(
    "head",
    [{"sequence": -1}, {"incarnation": 10**9}],  # One does not decode, the other does.
    ids=str,
)
def test_a_message_with_an_impossible_head_is_named_and_the_recording_goes_on(
    node: str, head: dict[str, int], tmp_path: Path
) -> None:
    forged = msgspec.msgpack.encode(msgspec.to_builtins(replace(impp(4), source=node)) | head)
    place = next(n for n, (_, message) in enumerate(SAID) if message.cycle == 5)
    kept, account = recorded([*SAID[:place], (IMPP.of(node), forged), *SAID[place:]], tmp_path)
    assert {entry.key for entry in account.complaints} == {f"oahu/{node}/impp"}
    assert (account.cycles, account.ended_early) == (CYCLES, "")
    assert len(kept) >= CYCLES
    own = Counter(port.signal.name for port, _ in SAID if port.publisher != DEVICE)
    device = device_in(tmp_path)
    found = Counter(account.recorded) - Counter(device.recorded) - Counter(account.extra)
    assert found == own


@pytest.mark.parametrize("missing", [5, [b"\xff"]])
def test_a_message_with_an_impossible_body_does_not_end_the_recorder(
    missing: object, tmp_path: Path
) -> None:
    fields = msgspec.to_builtins(replace(impp(4), source="c1/a")) | {"missing": missing}
    forged = msgspec.msgpack.encode(fields)
    place = next(n for n, (_, message) in enumerate(SAID) if message.cycle == 5)
    said: list[Spoken] = [*SAID[:place], (IMPP.of("c1/a"), forged), *SAID[place:]]
    _, account = recorded(said, tmp_path)
    assert (account.cycles, account.ended_early) == (CYCLES, "")
    with pytest.warns(InputWarning, match="c1/a/impp"), RunReader(tmp_path) as reader:
        assert len(list(reader.messages())) == len(SAID)


SETPOINT_OF_C1 = SETPOINT.of("c1")
GENUINE = Setpoint(3, 0, CENTRAL, (), sequence=3, power_kw=5.0, share_kw=1.0, help_given=())


NEXT = {"cycle": 4}
FORGED = {"power_kw": 6.0}


@pytest.mark.parametrize(
    ("messages", "causes"),
    [
        ([FORGED | {"sequence": 4}, NEXT], ["conflicting", None]),
        ([{"publish_time_ns": 9}, NEXT], ["conflicting", None]),
        ([{}, NEXT], ["duplicate", None]),
        ([{"incarnation": 3}, NEXT | {"incarnation": 3}], [None, None]),
        (
            [{"incarnation": 3}, {"incarnation": 3, "publish_time_ns": 9}, NEXT],
            [None, "duplicate", "conflicting"],
        ),
        ([NEXT | {"incarnation": 4}, NEXT, {"cycle": 5}], [None, None, "conflicting"]),
        ([{"cycle": 6} | FORGED, NEXT, {"cycle": 5}, {"cycle": 6}], [None] * 3 + ["conflicting"]),
        ([{"cycle": 0}, {"cycle": 0, "publish_time_ns": 9}], [None, "conflicting"]),
    ],
    ids=[
        *("says another thing", "does not count up", "came again", "replaces its predecessor"),
        *("replaced in its first cycle", "was replaced and goes on", "forged for a cycle to come"),
        "does not count up in the first cycle",
    ],
)
def test_a_second_message_of_a_key_in_a_cycle_is_named(
    messages: list[dict[str, object]], causes: list[str | None]
) -> None:
    senders = SecondSenders(IN_LOCKSTEP)
    found = []
    for changes in ({}, *messages):
        message = replace(GENUINE, **changes)
        complaint = senders.hear(
            SETPOINT_OF_C1, message.cycle, message.incarnation, encode(message)
        )
        found.append(complaint and complaint[0])
    assert found == [None, *causes]


def test_a_second_sender_is_no_loss_and_a_false_stop_is_named(tmp_path: Path) -> None:
    said = list(SAID)
    place = next(
        n for n, (port, m) in enumerate(said) if port is DISPATCH.of(ROOT) and m.cycle == 4
    )
    said.insert(place, (RUN.of(ROOT), IN_LOCKSTEP.run_message("stop", 4, 0)))
    said.insert(place, (RUN.of(ROOT), IN_LOCKSTEP.run_message("stop", 1, 0)))
    _, account = recorded(said, tmp_path)
    (complaint,) = account.complaints
    assert (complaint.key, complaint.cause, complaint.count) == ("oahu/run", "conflicting", 2)
    assert account.extra == {"run": 2}
    assert account.cycles == CYCLES


def test_keys_without_end_are_named_up_to_a_number_and_shown_without_control_characters() -> None:
    told: list[Complaint] = []
    complaints = Complaints(told.append)
    for number in range(3000):
        complaints.add(f"oahu/\x1b[31m{number}", "unknown", "x" * 10_000)
    found = complaints.all()
    assert len(found) == len(told) < 1000
    assert sum(entry.count for entry in found) == 3000
    assert all(entry.key.isprintable() and len(entry.example) < 1000 for entry in found)


# Bundles ------------------------------------------------------------------------------------------

GROUPED = plan_of({"c1/a": 100.0, "c1/b": 100.0, "c2/d": 100.0}, cycles=CYCLES, groups=("c1",))


def on_the_bus(messages: Iterable[tuple[Port[Message], Message]]) -> Iterator[tuple[str, bytes]]:
    """Yield keys and payloads: of messages with a bundle in one for each cycle, or a single one."""
    wiring = GROUPED.wiring
    bundle_of = {port: one for one in wiring.bundles for port in one.ports.values()}
    for _, of_cycle in groupby(messages, key=lambda each: each[1].cycle):
        bundled: dict[str, list[tuple[str, Message]]] = {}
        for port, message in of_cycle:
            if (bundle := bundle_of.get(port)) is None:
                yield wiring.key(port), encode(message)
            else:
                bundled.setdefault(wiring.key(bundle), []).append((str(port), message))
        for key, content in bundled.items():
            yield key, encode_bundle(content)


def test_each_message_of_a_bundle_is_recorded_as_if_it_came_alone(tmp_path: Path) -> None:
    said = published(GROUPED, cloudy_profile(GROUPED))
    arming = [(port, replace(message, cycle=-1)) for port, message in said if not message.cycle]
    (inside,) = (one for one in GROUPED.wiring.bundles if not one.sinks)
    wrong = encode_bundle([("c2/d/impp", impp(0))]), b"\xc1 garbage", encode(impp(0))
    key = GROUPED.wiring.key(inside)
    waiting = [*on_the_bus([*arming, *said]), *((key, payload) for payload in wrong)]
    assert len(waiting) < len(said)
    link = LinkByHand(expected=len(said))
    Recorder(
        GROUPED,
        cast("RunSubscriber", SubscriberByHand(lambda: waiting)),
        RunWriter(tmp_path / "run.mcap", GROUPED, 'name = "oahu"\n', "launch"),
        cast("LauncherLink", link),
    ).run()
    with RunReader(tmp_path) as reader:
        kept = Counter((str(one.port), one.payload) for one in reader.records())
        times = [one.publish_time_ns for one in reader.records()]
    assert kept == Counter((str(port), encode(message)) for port, message in said)
    assert len({*times}) == len({message.publish_time_ns for _, message in said})
    (account,) = [event for event in link.told if isinstance(event, Recorded)]
    assert {(one.key, one.cause): one.count for one in account.complaints} == {
        (key, "unknown"): 1,
        (key, "undecodable"): 2,
    }


def test_a_recorder_beats_while_bundles_of_much_work_keep_coming(tmp_path: Path) -> None:
    clock, beats = [0.0], [0.0]

    class Link(LinkByHand):
        def beat(self, cycle: int) -> None:
            beats.append(clock[0])

    def each_takes(work_s: float) -> Iterator[tuple[str, bytes]]:
        for entry in on_the_bus(said):
            clock[0] += work_s
            yield entry

    said = published(GROUPED, cloudy_profile(GROUPED))
    waiting = each_takes(0.05)
    Recorder(
        GROUPED,
        cast("RunSubscriber", SubscriberByHand(lambda: waiting)),
        RunWriter(tmp_path / "run.mcap", GROUPED, 'name = "oahu"\n', "launch"),
        cast("LauncherLink", Link(expected=len(said))),
        now_ns=lambda: round(clock[0] * 1e9),
    ).run()
    assert clock[0] > 10 * BEAT_S
    assert max(after - before for before, after in pairwise(beats)) < BEAT_S


STEADY = [
    port
    for port in ports(IN_LOCKSTEP.tree)
    if port.signal.occurrence in {Occurrence.CYCLE, Occurrence.TURN}
]
OF_PLANT = [port for port in STEADY if port.publisher == PLANT]
OF_OTHERS = [port for port in STEADY if port.publisher != PLANT]


def test_a_device_that_speaks_of_another_round_does_not_end_the_one_under_way() -> None:
    under_way = ArmingRound(IN_LOCKSTEP)
    under_way.hear(DISPATCH.of(ROOT), -7)
    for early in (-5, -9, -6):
        assert not under_way.hear(IMPP.of("c2/d"), early)
    seen = [under_way.hear(port, -7) for port in (*OF_PLANT, *OF_OTHERS)]
    assert seen == [False] * (len(STEADY) - 1) + [True]
    assert under_way.answered


def test_keys_without_a_message_in_the_round_under_way_are_named() -> None:
    under_way = ArmingRound(IN_LOCKSTEP)
    under_way.hear(DISPATCH.of(ROOT), -7)
    under_way.hear(IMPP.of("c2/d"), -5)
    assert under_way.unheard(["c2/d"]) == [
        f"c2/d/{signal}" for signal in ("command", "impp", "residual")
    ]
