"""Reads a recording back as typed messages."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import msgspec
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Attachment, Channel, McapRecord, Metadata
from mcap.records import Message as McapMessage
from mcap.stream_reader import StreamReader

from agents.plan import RunPlan
from bus_schemas.bus import Delivery
from bus_schemas.codec import decode
from bus_schemas.errors import InputError
from bus_schemas.messages import Message
from bus_schemas.signals import Signal
from recordings.writer import RECORDING_NAME, SCHEMA_VERSION


class RunReader:
    """A recording of a run; of one that was cut by a crash, all that is there up to the cut.

    Parameters
    ----------
    path
        The MCAP file, or the folder of a run.

    Attributes
    ----------
    whole
        Whether the file was closed in order and has its index.
    metadata
        By name: versions, host, clock anchor.
    scenario, plan
        What the run was.

    Raises
    ------
    InputError
        There is no such file, or it is no recording of a run.
    """

    def __init__(self, path: Path) -> None:
        self.path = path / RECORDING_NAME if path.is_dir() else path
        try:
            self._file = self.path.open("rb")
        except FileNotFoundError:
            raise InputError(
                f"{self.path}: no such file, accepted is a run's folder or its {RECORDING_NAME}"
            ) from None
        except OSError as error:
            raise InputError(f"{self.path}: {error.strerror}, accepted is an MCAP file") from None
        self.metadata: dict[str, dict[str, str]] = {}
        self.whole = False
        self._trouble = ""
        try:
            self._read_origin()
        except BaseException:
            self._file.close()
            raise

    def messages(self, *signals: Signal[Message], by_time: bool = True) -> Iterator[Delivery]:
        """Yield the messages of all signals, or of these.

        Parameters
        ----------
        signals
            Which; none given: all.
        by_time
            Whether in the order of their log time. As they stand in the file they are read in half
            the time, and those of one key are in their order all the same.
        """
        keys = self.plan.keys
        wanted = {signal.name for signal in signals}
        topics = [
            keys.key(port)
            for port in keys.ports
            if port.signal.logged and (not wanted or port.signal.name in wanted)
        ]
        records = self._indexed(topics, by_time) if self.whole else self._up_to_the_cut(set(topics))
        for topic, data in records:
            port = keys.port(topic)
            if port is not None:
                yield port, decode(port.signal, data)

    def _indexed(self, topics: list[str], by_time: bool) -> Iterator[tuple[str, bytes]]:
        self._file.seek(0)
        reader = make_reader(self._file)
        for _, channel, record in reader.iter_messages(topics=topics, log_time_order=by_time):
            yield channel.topic, record.data

    def _up_to_the_cut(self, topics: set[str]) -> Iterator[tuple[str, bytes]]:
        """Read a file without an index from its beginning, in the order it was written."""
        topic_of: dict[int, str] = {}
        for record in self._records():
            if isinstance(record, Channel):
                topic_of[record.id] = record.topic
            elif isinstance(record, McapMessage) and topic_of[record.channel_id] in topics:
                yield topic_of[record.channel_id], record.data

    def _records(self) -> Iterator[McapRecord]:
        self._file.seek(0)
        with suppress(McapError, OSError, struct.error, ValueError):
            yield from StreamReader(self._file).records

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def __enter__(self) -> RunReader:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _read_origin(self) -> None:
        attachments = self._read_index() or self._read_beginning()
        self._check_version()
        try:
            self.scenario = attachments["scenario.toml"].decode()
            self.plan = msgspec.json.decode(attachments["plan.json"], type=RunPlan)
        except KeyError as error:
            raise InputError(f"{self.path}: recording without its attachment {error}") from None
        except (msgspec.DecodeError, UnicodeDecodeError) as error:
            raise InputError(f"{self.path}: its attachments do not decode: {error}") from None

    def _read_index(self) -> dict[str, bytes]:
        """Read metadata and attachments by the index; nothing if the file was cut before it."""
        try:
            reader = make_reader(self._file)
            self.metadata = {entry.name: entry.metadata for entry in reader.iter_metadata()}
            found = {entry.name: entry.data for entry in reader.iter_attachments()}
        except (McapError, OSError, struct.error, ValueError) as error:
            self._trouble = str(error) or type(error).__name__
            return {}
        self.whole = True
        return found

    def _read_beginning(self) -> dict[str, bytes]:
        """Read metadata and attachments from the beginning of a file, where a run has them."""
        found: dict[str, bytes] = {}
        records = 0
        for record in self._records():
            records += 1
            if isinstance(record, Metadata):
                self.metadata[record.name] = record.metadata
            elif isinstance(record, Attachment):
                found[record.name] = record.data
            elif isinstance(record, McapMessage):
                break
        if not records:
            raise InputError(f"{self.path}: not a readable MCAP file ({self._trouble})")
        return found

    def _check_version(self) -> None:
        found = self.metadata.get("run", {}).get("schema_version")
        if found is None:
            raise InputError(f"{self.path}: an MCAP file, but no recording of a heliarch run")
        if found != SCHEMA_VERSION:
            raise InputError(
                f"{self.path}: schema version {found}, accepted is version {SCHEMA_VERSION}"
            )
