"""Reads a recording as typed messages: all of it, or some signals, nodes and cycles."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

import msgspec

from agents.plan import RunPlan
from bus_schemas.bus import Delivery
from bus_schemas.codec import decode
from bus_schemas.errors import InputError
from bus_schemas.messages import Message
from bus_schemas.signals import RUN, SIGNALS, Port, Signal
from bus_schemas.tree import ROOT
from recordings.read.chunks import (
    ChunkPlace,
    DamagedChunkError,
    RawMessage,
    messages_in,
    unpack_chunk,
)
from recordings.read.moments import Moment, RunClock
from recordings.read.outline import NoMcapError, Outline, read_outline
from recordings.read.run_file import RECORDING_NAME, SCHEMA_VERSION, declare
from recordings.read.selection import find_nodes, find_signals

if TYPE_CHECKING:
    import pandas as pd

_NOTHING: Final = "cut before the plan of its run"

_LATEST_S: Final = 30.0
"""How much later than its cycle's turn a message may come and still be found by its cycle."""

_ENDLESS: Final = 1 << 62

_FURTHEST_CYCLES: Final = 1000
"""The same in lockstep over processes, where a link can fall behind: as the recorder allows."""


class _Head(msgspec.Struct, gc=False):
    """What a reader needs to choose a message; the rest is skipped."""

    cycle: int


_head = msgspec.msgpack.Decoder(_Head).decode


def cycle_of(payload: bytes) -> int:
    """Return the cycle of a payload without decoding the rest; DecodeError if it has none."""
    return _head(payload).cycle


class NothingRecordedError(InputError):
    """A recording that was cut before the plan of its run."""


class RecordedMessage(NamedTuple):
    """A message as it is in the file; times are wall clock [ns since 1970-01-01 UTC]."""

    port: Port[Message]
    cycle: int
    sequence: int
    log_time_ns: int
    publish_time_ns: int
    payload: bytes

    def message(self) -> Message:
        """Decode it; InputError if it is no message of its signal."""
        return _decoded(self.port, self.sequence, self.payload)


def _decoded(port: Port[Message], sequence: int, payload: bytes) -> Message:
    try:
        return decode(port.signal, payload)
    except msgspec.DecodeError as error:
        expected = port.signal.type.__name__
        raise InputError(f"{port} number {sequence}: expected a {expected}, got: {error}") from None


class RunReader:
    """A recording of a run; of one that was cut, everything up to the cut.

    Memory is bounded by the largest chunk, and some 300 bytes for each chunk of the file.

    Attributes
    ----------
    path, file
        The MCAP file, and the same as it is open.
    whole
        Whether the file was closed in order and has its index.
    outline
        What the file consists of.
    metadata
        By name: versions, host, clock anchor.
    scenario, plan
        What the run was.
    damage
        Chunks that were skipped so far: why, by their first byte.
    """

    def __init__(self, path: Path, *, skip_damaged: bool = False) -> None:
        self.path = path / RECORDING_NAME if path.is_dir() else path
        try:
            self.file = self.path.open("rb")
        except FileNotFoundError:
            raise InputError(
                f"{self.path}: no such file, expected a run's folder or its {RECORDING_NAME}"
            ) from None
        except OSError as error:
            raise InputError(f"{self.path}: {error.strerror}, expected an MCAP file") from None
        self.damage: dict[int, str] = {}
        self._skip_damaged = skip_damaged
        self._position = 0
        self._first_cycles: dict[ChunkPlace, int | None] = {}
        try:
            self.outline = self._read_outline()
            self.metadata = {entry.name: entry.metadata for entry in self.outline.metadata}
            self._check_version()
            self.scenario, self.plan = self._read_origin()
            if self.outline.chunks and not self.outline.channels:
                declare(self.outline, self.plan)  # The first chunk had them, and is damaged.
        except BaseException:
            self.file.close()
            raise
        self.whole = self.outline.indexed

    def messages(
        self,
        *signals: Signal[Message] | str,
        nodes: str | Collection[str] = (),
        start: Moment | None = None,
        end: Moment | None = None,
    ) -> Iterator[Delivery]:
        """Yield messages with their ports, in the order in which they were recorded.

        Parameters
        ----------
        signals
            Which, or their names; none given: all.
        nodes
            About which nodes, see `find_nodes`; none given: about all.
        start, end
            The first and the last cycle: local time (`13:49:00`), time since the start (`90s`) or
            number. Cycles outside of them are not read.

        Raises
        ------
        InputError
            The run has no such signal, node or moment; or the file is damaged where it is read.
        """
        ports = self.ports(*signals, nodes=nodes)
        cycles = None if start is None and end is None else self.clock.span(start, end)
        return self.on(ports, cycles)

    def ports(
        self, *signals: Signal[Message] | str, nodes: str | Collection[str] = ()
    ) -> frozenset[Port[Message]]:
        """Return the ports of some signals about some nodes, see `messages`."""
        wanted = find_signals(signals) or SIGNALS
        places = find_nodes(self.plan.tree, nodes) or self.plan.tree.nodes
        return frozenset(
            port
            for port in self.plan.keys.ports
            if port.signal.logged and port.signal in wanted and port.node in places
        )

    def on(
        self, ports: Collection[Port[Message]], cycles: range | None = None
    ) -> Iterator[Delivery]:
        """Yield the messages on some ports, of some cycles (in steps of 1) or of all."""
        port_of = self._channels_of(ports)
        for channel, sequence, _, _, payload in self._raw(port_of, cycles):
            port = port_of[channel]
            message = _decoded(port, sequence, payload)
            if cycles is None or cycles.start <= message.cycle < cycles.stop:
                yield port, message

    def records(
        self, ports: Collection[Port[Message]] | None = None, cycles: range | None = None
    ) -> Iterator[RecordedMessage]:
        """Yield messages as they are in the file; only their cycle is decoded."""
        port_of = self._channels_of(self.ports() if ports is None else ports)
        for raw in self._raw(port_of, cycles):
            channel, sequence, log_time_ns, publish_time_ns, payload = raw
            try:
                cycle = _head(payload).cycle
            except msgspec.DecodeError as error:
                raise self._without_cycle(raw, error) from None
            if cycles is None or cycles.start <= cycle < cycles.stop:
                port = port_of[channel]
                yield RecordedMessage(port, cycle, sequence, log_time_ns, publish_time_ns, payload)

    def frame(
        self,
        signal: Signal[Message] | str,
        *,
        nodes: str | Collection[str] = (),
        start: Moment | None = None,
        end: Moment | None = None,
    ) -> pd.DataFrame:
        """Return the messages of one signal as a table, one row each.

        Parameters
        ----------
        signal, nodes, start, end
            See `messages`.

        Returns
        -------
        pandas.DataFrame
            Indexed by `time`, the local time at the beginning of the cycle. Columns `cycle`,
            `node` and the signal's own fields, with units in their names. `help_given` and the
            fields of `production` that list inverters hold tuples.

        Raises
        ------
        InputError
            See `messages`.
        """
        from recordings.read.frames import message_frame  # noqa: PLC0415 - pandas loads slowly

        (found,) = find_signals([signal])
        deliveries = self.messages(found, nodes=nodes, start=start, end=end)
        return message_frame(found, deliveries, self.plan.timezone)

    @cached_property
    def clock(self) -> RunClock:
        """Turns local time and time since the start into cycles of this run."""
        return RunClock(self.plan, self.last_cycle)

    @cached_property
    def last_cycle(self) -> int:
        """The last cycle of which there is a message, -1 if there is none."""
        # The plant's message that the run is over carries the cycle after the last one.
        ports = {port for port in self.ports() if port.signal.name != "run"}
        port_of = self._channels_of(ports)
        for place in reversed(self.outline.chunks):
            cycles = [self._cycle_of(raw) for raw in self._messages_of(place, port_of)]
            if cycles:
                return max(cycles)
        return -1

    @cached_property
    def stop_cycle(self) -> int | None:
        """The cycle before which the plant ended the run; None: the recording does not tell."""
        cycles = range(max(self.last_cycle, 0), _ENDLESS)
        for record in self.records([RUN.of(ROOT)], cycles):
            if decode(RUN, record.payload).state == "stop":
                return record.cycle
        return None

    def cycles_in(self, place: ChunkPlace) -> range | None:
        """Return the cycles that a chunk has messages of; None: it has none that can be read."""
        try:
            raws = list(messages_in(unpack_chunk(self.file, place), self._all_channels))
        except DamagedChunkError:
            return None
        cycles = [self._cycle_of(raw) for raw in raws]
        return range(min(cycles), max(cycles) + 1) if cycles else None

    @property
    def read_share(self) -> float:
        """How far into the file the reading has come, 0 to 1."""
        return self._position / max(self.outline.size, 1)

    def close(self) -> None:
        """Close the file."""
        self.file.close()

    def __enter__(self) -> RunReader:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _channels_of(self, ports: Collection[Port[Message]]) -> dict[int, Port[Message]]:
        """Return the ports by the numbers of their channels."""
        found = {}
        for number, channel in self.outline.channels.items():
            port = self.plan.keys.port(channel.topic)
            if port is not None and port in ports:
                found[number] = port
        return found

    def _raw(
        self, channels: Mapping[int, Port[Message]], cycles: range | None
    ) -> Iterator[RawMessage]:
        """Yield the messages of the chunks that can hold some cycles."""
        begin = 0 if cycles is None else self._search(cycles.start)
        for place in self.outline.chunks[begin:]:
            if cycles is not None:
                first = self._first_cycle(place)
                if first is not None and first >= cycles.stop + self._slack:
                    return
            yield from self._messages_of(place, channels)

    def _search(self, cycle: int) -> int:
        """Return the number of a chunk before which there is no message of a cycle.

        Messages are nearly in the order of their cycles, at most `_slack` cycles behind. So where
        a chunk begins more than that before the cycle, the cycle has not begun.
        """
        low, high = 0, len(self.outline.chunks)
        while high - low > 1:
            middle = (low + high) // 2
            first = self._first_cycle(self.outline.chunks[middle])
            if first is not None and first < cycle - self._slack:
                low = middle
            else:
                high = middle
        return low

    def _first_cycle(self, place: ChunkPlace) -> int | None:
        """Return the cycle of a chunk's first message; None: nothing can be read of it."""
        if place not in self._first_cycles:
            try:
                records = unpack_chunk(self.file, place)
            except DamagedChunkError:
                records = b""  # An error only for whoever reads its messages.
            raw = next(messages_in(records, self._all_channels), None)
            self._first_cycles[place] = None if raw is None else self._cycle_of(raw)
        return self._first_cycles[place]

    def _cycle_of(self, raw: RawMessage) -> int:
        try:
            return cycle_of(raw[4])
        except msgspec.DecodeError as error:
            raise self._without_cycle(raw, error) from None

    def _without_cycle(self, raw: RawMessage, error: msgspec.DecodeError) -> InputError:
        topic = self.outline.channels[raw[0]].topic
        return InputError(
            f"{self.path}: {topic} at log time {raw[2]}: {error}, expected a message with its cycle"
        )

    @cached_property
    def _all_channels(self) -> dict[int, Port[Message]]:
        return self._channels_of(self.ports())

    @cached_property
    def _slack(self) -> int:
        """How many cycles behind the newest one a message can be in the file."""
        if self.metadata["run"].get("driver") == "simulate":
            return self.plan.periods.longest + 1
        if self.plan.lockstep:
            return _FURTHEST_CYCLES
        return max(round(_LATEST_S * 1e9 / self.plan.cycle_wall_ns), self.plan.periods.longest) + 1

    def _messages_of(
        self, place: ChunkPlace, channels: Collection[int] | Mapping[int, object]
    ) -> Iterator[RawMessage]:
        self._position = place.offset
        try:
            records = unpack_chunk(self.file, place)
        except DamagedChunkError as error:
            if self._skip_damaged:
                self.damage[place.offset] = str(error)
                return iter(())
            raise InputError(
                f"{self.path}: chunk at byte {place.offset:,}: {error}; `heliarch recover` keeps "
                "what is sound"
            ) from None
        return messages_in(records, channels)

    def _read_outline(self) -> Outline:
        try:
            return read_outline(self.file)
        except NoMcapError as error:
            if not self.path.stat().st_size:
                raise NothingRecordedError(f"{self.path}: {_NOTHING}, it is empty") from None
            raise InputError(f"{self.path}: not an MCAP file, {error}") from None
        except OSError as error:
            raise InputError(f"{self.path}: {error.strerror}, expected an MCAP file") from None

    def _check_version(self) -> None:
        found = self.metadata.get("run", {}).get("schema_version")
        if found is None and self.outline.cut_early:
            raise NothingRecordedError(f"{self.path}: {_NOTHING}")
        if found is None:
            raise InputError(f"{self.path}: an MCAP file, but no recording of a heliarch run")
        if found != SCHEMA_VERSION:
            raise InputError(
                f"{self.path}: recorded with schema version {found}, this Heliarch reads version "
                f"{SCHEMA_VERSION}; read it with the Heliarch that wrote it"
            )

    def _read_origin(self) -> tuple[str, RunPlan]:
        attachments = {entry.name: entry.data for entry in self.outline.attachments}
        damaged = self.outline.damaged_attachments
        if "plan.json" in damaged:
            raise InputError(
                f"{self.path}: its attachment plan.json is damaged, its checksum is not that of "
                "its content; nothing can be read without it"
            )
        try:
            # Nothing depends on the scenario, which may be damaged: the plan has what the run was.
            scenario = attachments["scenario.toml"].decode(errors="replace")
            return scenario, msgspec.json.decode(attachments["plan.json"], type=RunPlan)
        except KeyError as error:
            if self.outline.cut_early and not damaged:
                raise NothingRecordedError(f"{self.path}: {_NOTHING}") from None
            note = f"; damaged are {', '.join(damaged)}" if damaged else ""
            raise InputError(
                f"{self.path}: recording without its attachment {error}{note}"
            ) from None
        except (msgspec.DecodeError, UnicodeDecodeError) as error:
            raise InputError(f"{self.path}: its attachments do not decode: {error}") from None


def open_run(path: Path | str) -> RunReader:
    """Open a recording: typed messages by signal, node and time, and pandas frames.

    Parameters
    ----------
    path
        The folder of a run, or its MCAP file.

    Raises
    ------
    InputError
        There is no such file, or it is no recording of a run.

    Examples
    --------
    >>> with open_run("runs/oahu-20261121-120000-4711") as run:
    ...     impp = run.frame("impp", nodes="c1/inv07", start="12:20", end="12:30")
    """
    return RunReader(Path(path))
