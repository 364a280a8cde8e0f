"""Reads a recording as typed messages: all of it, or some signals, nodes and cycles."""

from __future__ import annotations

import os
import tomllib
import warnings
from bisect import bisect_left
from collections.abc import Callable, Collection, Container, Iterator, Mapping
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from sys import maxsize
from typing import TYPE_CHECKING, Any, BinaryIO, Final, NamedTuple, TypedDict, Unpack

from agents.plan import RunPlan
from bus_schemas.bus import Delivery
from bus_schemas.codec import UNREADABLE, decode_head
from bus_schemas.errors import InputError, InputWarning, listed, printable
from bus_schemas.messages import Message, Run
from bus_schemas.selection import find_nodes, find_signals
from bus_schemas.signals import RUN, SIGNALS, Port, Signal
from bus_schemas.tree import ROOT
from recordings.read.frames import LISTS, frames
from recordings.read.mcap_file import (
    Chunk,
    DamagedChunkError,
    RawMessage,
    message_records,
    messages_in,
    read_outline,
    take_channels,
    unpack_chunk,
    walk_on,
)
from recordings.read.run_clock import RunClock
from recordings.read.run_file import (
    RECORDING_NAME,
    further_file,
    further_files,
    read_origin,
    recorded_ports,
)
from scenarios.times import When

if TYPE_CHECKING:
    import pandas as pd

_LATEST_S: Final = 30.0
"""How much later than its cycle's turn a message may come and still be found by its cycle."""

_MESSAGES_PER_CHUNK: Final = 4096

_LAST_CHUNKS: Final = 4
"""The newest message of a recording is in one of its last chunks: a recorder can be late."""

_FURTHEST_CYCLES: Final = 1000
"""The same in lockstep over processes, where a link can fall behind: as the recorder allows."""


class Part(TypedDict, total=False):
    """A part of a recording, by default all of it.

    nodes: Which nodes, see `find_nodes`.
    start, end: The first cycle, and the one before which to end: local time (`13:49:00`), seconds
        since cycle 0 (`90`, `"15m"`) or a cycle (`"c90"`).
    """

    nodes: str | Collection[str]
    start: When | None
    end: When | None


class RecordedMessage(NamedTuple):
    """A message as it is in the file; times are wall clock [ns since 1970-01-01 UTC]."""

    port: Port[Message]
    cycle: int
    sequence: int
    log_time_ns: int
    publish_time_ns: int
    payload: bytes
    incarnation: int = 0

    def message(self) -> Message:
        """Decode it; InputError if it is no message of its signal."""
        try:
            return self.port.signal.decode(self.payload)
        except UNREADABLE as error:
            raise InputError(_wrong(self.port, self.sequence, error)) from None


def _wrong(port: Port[Message], sequence: int, error: object) -> str:
    return f"{port} number {sequence}: expected a {port.signal.type.__name__}, got: {error}"


class RunReader:
    """A recording of a run, with its further files.

    A file that was cut is read up to the cut. Damaged chunks, and payloads that are no message of
    their key, are skipped, and an `InputWarning` names them as the reader is closed. A file without
    its plan is refused.

    `damage`: the damaged chunks skipped so far. `wrong`: the first wrong payload of each key that
    was skipped so far. `follow` is called now and then with the share read so far, 0 to 1.
    """

    def __init__(self, path: Path) -> None:
        self.path = path / RECORDING_NAME if path.is_dir() else path
        if self.path.exists() and not self.path.is_file():  # A pipe would be waited for.
            raise InputError(f"{self.path}: expected a recording, got no regular file")
        self.files = [self.path]
        self._absent: dict[str, None] = {}
        self._newest_file = 1
        self.damage: set[Chunk] = set()
        self.wrong: dict[Port[Message], str] = {}
        self.follow: Callable[[float], None] = lambda share: None
        self._said = {""}
        self._first_cycles: dict[Chunk, int | None] = {}
        self._unpacked: tuple[Chunk | None, bytes] = None, b""
        self._in_memory: dict[Chunk, bytes] = {}
        try:
            self._opened = 0, self.path.open("rb", buffering=0)
        except (FileNotFoundError, IsADirectoryError):  # The folder may have come just now.
            raise InputError(
                f"{self.path}: no such file, expected a run's folder or its {RECORDING_NAME}"
            ) from None
        try:
            self.outline = read_outline(self._file(0))
            self.metadata = self.outline.metadata
            self.scenario, self.plan = read_origin(self.outline, self.path)
            self.join()
            if not self.outline.is_own:
                self._take_in_order_of_time()
        except BaseException:
            self.release()
            raise

    def _take_in_order_of_time(self) -> None:
        """Find the channels that another program declared, and put its messages in order.

        If they are in another order than that of their log times, they are kept in memory.
        """
        is_sorted, newest_ns, broken = True, 0, ""
        for chunk in self.outline.chunks:
            try:
                content = self.unpack(chunk)
            except DamagedChunkError as error:
                self.damage.add(chunk)
                broken = str(error)
                continue
            take_channels(self.outline, content)
            times_ns = [time_ns for time_ns, _ in message_records(content)]
            is_sorted &= sorted([newest_ns, *times_ns]) == [newest_ns, *times_ns]
            newest_ns = max(newest_ns, *times_ns, 0)
        if self.outline.chunks and not self.channels:
            why = broken or "no message is on a key of its plan"
            raise InputError(f"{self.path}: expected messages of a heliarch run, got none: {why}")
        if not is_sorted:
            self._keep_sorted()

    def _keep_sorted(self) -> None:
        found: list[tuple[int, bytes]] = []
        for chunk in self.outline.chunks:
            with suppress(DamagedChunkError):
                found += message_records(self.unpack(chunk))
        found.sort(key=lambda one: one[0])
        self.outline.chunks = []
        for number in range(0, len(found), _MESSAGES_PER_CHUNK):
            content = b"".join(one for _, one in found[number : number + _MESSAGES_PER_CHUNK])
            chunk = Chunk(number, len(content), is_record=False)
            self.outline.chunks.append(chunk)
            self._in_memory[chunk] = content

    @property
    def whole(self) -> bool:
        """Whether each file is there and was closed in order."""
        return self.outline.whole and not self.outline.goes_on and not self._absent

    def scenario_table(self) -> dict[str, Any]:
        try:
            return tomllib.loads(self.scenario)
        except (tomllib.TOMLDecodeError, RecursionError) as error:
            raise InputError(f"{self.path}: expected a scenario in TOML, got: {error}") from None

    def join(self) -> None:
        """Read on in the newest file, and add those of later recorders, or after a full one.

        A file that does not name the run yet has just begun, or its recorder was killed at once.
        """
        for number, path in further_files(self.path):
            if number <= self._newest_file:
                continue
            with suppress(FileNotFoundError), path.open("rb", buffering=0) as file:
                outline = read_outline(file, chunks=False)
                if outline.metadata.get("run", {}).get("run_id") != self.plan.run_id:
                    continue
                self._walk_on()  # Nobody writes there any more.
                walk_on(outline, file)
                self._note_absent(range(self._newest_file + 1, number))
                self.outline.append(outline, is_next=number == self._newest_file + 1)
                self.files.append(path)
                self._newest_file = number
        self._walk_on()

    def _walk_on(self) -> None:
        if not self.outline.ended:
            with suppress(FileNotFoundError):
                walk_on(self.outline, self._file(self.outline.file))

    def _note_absent(self, numbers: range) -> None:
        if numbers:
            names = [further_file(self.path, one).name for one in (numbers[0], numbers[-1])]
            self._absent[" to ".join(dict.fromkeys(names))] = None

    def _file(self, number: int) -> BinaryIO:
        """Return one of the files. One is open at a time: a run of months has thousands."""
        if self._opened[0] != number:
            file = self.files[number].open("rb", buffering=0)
            self._opened[1].close()
            self._opened = number, file
        return self._opened[1]

    def stats(self) -> list[os.stat_result]:
        """Return what the system says of those files that were not deleted meanwhile."""
        found = []
        for path in self.files:
            with suppress(FileNotFoundError):
                found.append(path.stat())
        return found

    def messages(
        self,
        *signals: Signal[Message] | str,
        **part: Unpack[Part],
    ) -> Iterator[Delivery]:
        """Yield messages with their ports, in the order in which they were recorded."""
        start, end = part.get("start"), part.get("end")
        ports = self.ports(*signals, nodes=part.get("nodes", ()))
        if start is None and end is None:
            return self.on(ports)
        return self.on(ports, self.clock.span(start, end, ("start", "end")))

    def ports(
        self, *signals: Signal[Message] | str, nodes: str | Collection[str] = ()
    ) -> frozenset[Port[Message]]:
        """Return the ports of some signals about some nodes, see `messages`."""
        wanted = find_signals(signals) or SIGNALS
        about = frozenset(find_nodes(self.plan.tree, nodes) or self.plan.tree.nodes)
        return frozenset(
            port
            for port in self.plan.wiring.ports
            if port.signal.logged and port.signal in wanted and port.node in about
        )

    def on(
        self, ports: Collection[Port[Message]], cycles: range | None = None
    ) -> Iterator[Delivery]:
        """Yield the messages on some ports, of some cycles (in steps of 1) or of all."""
        of_channel = {
            channel: (port, port.signal.decode)
            for channel, port in self._channels_of(ports).items()
        }
        for chunk in self._chunks_of(cycles):
            for channel, sequence, _, _, payload in self.messages_of(chunk, of_channel):
                port, decode = of_channel[channel]
                try:
                    message = decode(payload)
                except UNREADABLE as error:
                    self.wrong.setdefault(port, _wrong(port, sequence, error))
                    continue
                if cycles is None or cycles.start <= message.cycle < cycles.stop:
                    yield port, message

    def records(
        self, ports: Collection[Port[Message]] | None = None, cycles: range | None = None
    ) -> Iterator[RecordedMessage]:
        """Yield messages as they are in the file; only their head is decoded."""
        port_of = self._channels_of(self.ports() if ports is None else ports)
        for chunk in self._chunks_of(cycles):
            for record in self.records_of(chunk, port_of):
                if cycles is None or cycles.start <= record.cycle < cycles.stop:
                    yield record

    def records_of(
        self, chunk: Chunk, port_of: Mapping[int, Port[Message]] | None = None
    ) -> Iterator[RecordedMessage]:
        """Yield the messages of some channels in a chunk, or of all; none if it is damaged."""
        port_of = self.channels if port_of is None else port_of
        for channel, sequence, logged_ns, published_ns, payload in self.messages_of(chunk, port_of):
            port = port_of[channel]
            try:
                head = decode_head(payload)
            except UNREADABLE as error:
                self.wrong.setdefault(port, _wrong(port, sequence, error))
                continue
            times_ns = logged_ns, published_ns
            yield RecordedMessage(port, head.cycle, sequence, *times_ns, payload, head.incarnation)

    def decoded(self, record: RecordedMessage) -> Message | None:
        """Return a message; None if it is wrong, which is then named at the end."""
        try:
            return record.message()
        except InputError as error:
            self.wrong.setdefault(record.port, str(error))
            return None

    def frames(
        self,
        *tables: Signal[Message] | str,
        **part: Unpack[Part],
    ) -> dict[str, pd.DataFrame]:
        """Return several tables by name, each as `frame` does: the recording is read once."""
        lists = [name for name in tables if isinstance(name, str) and name in LISTS]
        signals = find_signals([name for name in tables if name not in lists])
        about = {*signals, *(LISTS[name].signal for name in lists)}
        # Any message may have a list of no signal of its own.
        wanted = () if None in about else [one for one in about if one is not None]
        messages = self.messages(*wanted, **part)
        names = [*(signal.name for signal in signals), *lists]
        return frames(self.plan, names, messages, self.wrong.setdefault)

    @cached_property
    def channels(self) -> dict[int, Port[Message]]:
        if (
            not self.outline.channels and self.outline.is_own
        ):  # The first chunk has them, and is damaged.
            return dict(enumerate(recorded_ports(self.plan), start=1))
        port_at = self.plan.wiring.port
        port_of = {number: port_at(topic) for number, topic in self.outline.channels.items()}
        return {number: port for number, port in port_of.items() if port is not None}

    @cached_property
    def clock(self) -> RunClock:
        return RunClock(self.plan, self.last_cycle)

    @cached_property
    def last_cycle(self) -> int:
        """The last cycle of which there is a message, -1 if there is none."""
        # The plant's message that the run is over carries the cycle after the last one.
        last = self.last_cycle_on(set(self._own_channels.values()))
        return min(last, self.plan.timing.cycles - 1)

    def last_cycle_on(self, ports: Collection[Port[Message]]) -> int:
        """Return the last cycle of which there is a message on some ports, -1 if there is none."""
        port_of = self._channels_of(ports)
        found, seen = -1, 0
        for chunk in reversed(self.outline.chunks):
            if cycles := [record.cycle for record in self.records_of(chunk, port_of)]:
                found, seen = max(found, *cycles), seen + 1
            if seen == _LAST_CHUNKS:
                break
        return found

    @cached_property
    def stop_cycle(self) -> int | None:
        """The cycle before which the plant ended the run; None: that is not recorded."""
        runs = self.on([RUN.of(ROOT)], range(max(self.last_cycle, 0), maxsize))
        stops = [run.cycle for _, run in runs if isinstance(run, Run) and run.state == "stop"]
        return stop_after(stops, self.last_cycle)

    def followed_chunks(self, begin: int = 0) -> Iterator[Chunk]:
        """Yield the chunks from one on, and tell `follow` now and then how far the reading is."""
        count = len(self.outline.chunks)
        for number, chunk in enumerate(self.outline.chunks[begin:], start=begin):
            if number % (count // 100 + 1) == 0:
                self.follow(number / count)
            yield chunk

    def unpack(self, chunk: Chunk) -> bytes:
        if chunk in self._in_memory:
            return self._in_memory[chunk]
        if self._unpacked[0] != chunk:  # A search by cycles looks into a chunk before it is read.
            try:
                file = self._file(chunk.file)
            except FileNotFoundError:  # Deleted since it was found.
                self._absent[self.files[chunk.file].name] = None
                raise DamagedChunkError("its file was deleted") from None
            self._unpacked = chunk, unpack_chunk(file, chunk)
        return self._unpacked[1]

    def messages_of(self, chunk: Chunk, channels: Container[int]) -> Iterator[RawMessage]:
        """Return the messages of some channels in a chunk, none if it is damaged."""
        try:
            return messages_in(self.unpack(chunk), channels)
        except DamagedChunkError:
            self.damage.add(chunk)
            return iter(())

    def damage_text(self) -> str:
        """Name missing files, and damaged chunks and attachments that were left out, if any."""
        parts, texts = [], []
        for chunk in sorted(self.damage):
            if self.files[chunk.file].name in self._absent:
                continue
            of = f" of {self.files[chunk.file].name}" if chunk.file else ""
            parts.append(f"chunk at byte {chunk.offset:,}{of}")
        parts += [f"attachment {name}" for name in self.outline.damaged_attachments]
        if self._absent:
            names = listed([*self._absent])
            texts.append(f"files are missing or hold nothing of this run ({names})")
        if parts:
            texts.append(f"a part of the file is damaged and left out ({listed(parts)})")
        return f"{self.path}: {'; '.join(texts)}" if texts else ""

    def warn_of_damage(self) -> None:
        """Warn of damaged parts and wrong messages that were left out, once with each text."""
        wrong = f"{self.path}: wrong messages were skipped: {listed([*self.wrong.values()])}"
        texts = {self.damage_text(), printable(wrong) if self.wrong else ""}
        for text in sorted(texts - self._said):
            warnings.warn(text, InputWarning, stacklevel=2)
        self._said |= texts

    def close(self) -> None:
        self.release()
        self.warn_of_damage()

    def __enter__(self) -> RunReader:
        return self

    def __exit__(self, kind: type[BaseException] | None, *error: object) -> None:
        if kind is None:
            self.close()
        else:  # The error is what the user must read.
            self.release()

    def release(self) -> None:
        """Close the file without a word."""
        self._opened[1].close()

    def _channels_of(self, ports: Collection[Port[Message]]) -> dict[int, Port[Message]]:
        return {number: port for number, port in self.channels.items() if port in ports}

    def _chunks_of(self, cycles: range | None) -> Iterator[Chunk]:
        """Yield the chunks that can hold messages of some cycles."""
        if cycles is None:
            yield from self.followed_chunks()
            return
        # Where a chunk begins more than `_slack` cycles before a cycle, that has not begun.
        before, after = cycles.start - self._slack, cycles.stop + self._slack

        def first(chunk: Chunk) -> int:
            cycle = self._first_cycle(chunk)
            return before if cycle is None else cycle

        begin = bisect_left(self.outline.chunks, before, key=first)
        for chunk in self.followed_chunks(max(begin - 1, 0)):
            if first(chunk) >= after:
                return
            yield chunk

    def _first_cycle(self, chunk: Chunk) -> int | None:
        if chunk not in self._first_cycles:
            cycles = (record.cycle for record in self.records_of(chunk, self._own_channels))
            self._first_cycles[chunk] = next(cycles, None)
        return self._first_cycles[chunk]

    @cached_property
    def _own_channels(self) -> dict[int, Port[Message]]:
        """The channels of the run's own agents: an external one may state any cycle."""
        external = self.plan.access.external
        own = {
            number: port
            for number, port in self.channels.items()
            if port.publisher not in external and port.signal is not RUN
        }
        return own or self.channels

    @cached_property
    def _slack(self) -> int:
        """How many cycles behind the newest one a message can be in the file."""
        if self.metadata["run"].get("driver") == "simulate":
            return self.plan.control.periods.longest + 1
        return most_disorder(self.plan)


def stop_after(stops: Collection[int], last_cycle: int) -> int | None:
    """Return before which cycle the plant ended a run, by all that was said of it."""
    # Another program may have said so before a cycle that took place. Controllers that did not
    # wait for the plant may have begun the cycle of its own stop.
    later = [cycle for cycle in stops if cycle > last_cycle]
    return min(later, default=last_cycle if last_cycle in stops else None)


def most_disorder(plan: RunPlan) -> int:
    """Return how many cycles behind the newest one a message of a run can be recorded."""
    longest, timing = plan.control.periods.longest, plan.timing
    if timing.lockstep:
        return max(_FURTHEST_CYCLES, longest + 1)
    return max(round(_LATEST_S * 1e9 / timing.cycle_wall_ns), longest) + 1
