"""A recording with wrong content and right checksums is one clear line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from struct import pack
from typing import Any
from zlib import crc32

import lz4.frame
import pytest
from command_line import heliarch, refusal
from mcap.opcode import Opcode
from msgspec.structs import force_setattr, replace
from plans_by_hand import with_changes
from recordings_by_hand import (
    PLAN,
    SCENARIO,
    whole_run,
    write_run,
)

from bus_schemas.codec import encode
from bus_schemas.faults import Blackout
from bus_schemas.messages import Impp
from bus_schemas.signals import IMPP
from recordings.record.writer import RunWriter

PORT = IMPP.of("c1/a")
HEAD = Impp(1, PLAN.timing.sim_time_ns(1), "c1/a", (), power_kw=1.0, stale_cycles=0)


def with_plan(**fields: Any) -> Callable[[Path], None]:
    def make(path: Path) -> None:
        write_run(path, whole_run(3), plan=with_changes(PLAN, **fields))

    return make


def with_payload(payload: bytes) -> Callable[[Path], None]:
    def make(path: Path) -> None:
        writer = RunWriter(path, PLAN, SCENARIO, driver="simulate")
        for port, message in whole_run(3):
            writer.add(port, message, encode(message), 1)
        writer.add(PORT, HEAD, payload, 1)
        writer.close()

    return make


def with_a_fault_that_ends_first(path: Path) -> None:
    fault = Blackout(at=(5.0, 10.0))
    force_setattr(fault, "at", (10.0, 5.0))
    with_plan(faults=(fault,))(path)


NESTED = b"\x82\xa5cycle\x01\xa4more" + b"\x91" * 300_000 + b"\xc0"


@pytest.mark.parametrize(
    ("make", "named"),
    [
        (with_plan(cycle_ns=2**62), "cycle_ns: expected above 0, up to"),
        (with_plan(cycles=10**15), "cycles: expected up to"),
        (with_plan(period_cycles=(1,)), "period_cycles"),
        (with_a_fault_that_ends_first, "an end after the beginning 10 s, got 5 s"),
    ],
)
def test_hostile_content_is_refused_in_one_line(
    make: Callable[[Path], None], named: str, tmp_path: Path
) -> None:
    path = tmp_path / "run.mcap"
    make(path)
    for words in ((), ("--nodes", "c1/a"), ("--cycle", "1")):
        assert named in refusal("inspect", path, *words)


@pytest.mark.parametrize(
    "payload",
    [NESTED, encode(replace(HEAD, cycle=2**63 - 1)), b"\x81\xa5cycle\xa1\xff", b"\x81"],
)
def test_a_wrong_message_is_skipped_and_named_by_every_command(
    payload: bytes, tmp_path: Path
) -> None:
    with_payload(payload)(tmp_path / "run.mcap")
    looks = ("inspect", "inspect --nodes c1/a", "inspect --cycle 1", "report")
    for words in (*looks, "export --format csv", "export --format json-mcap"):
        command, *options = words.split()
        done = heliarch(command, tmp_path, *options)
        assert done.exit_code == 0, words
        said = done.stderr.splitlines()
        assert said
        assert all("c1/a/impp" in line for line in said)


def test_a_chunk_that_unpacks_to_far_more_than_a_recorder_writes_is_left_out_and_named(
    tmp_path: Path,
) -> None:
    path = tmp_path / "run.mcap"
    write_run(path, whole_run(3), close=False)
    zeros = bytes((1 << 26) + 1)  # Of zeros, gigabytes are a few megabytes in a file.
    packed = lz4.frame.compress(zeros)
    body = pack("<QQQII3sQ", 1, 1, len(zeros), crc32(zeros), 3, b"lz4", len(packed)) + packed
    with path.open("ab") as file:
        file.write(pack("<BQ", Opcode.CHUNK, len(body)) + body)
    assert "a part of the file is damaged" in heliarch("inspect", path).stderr
