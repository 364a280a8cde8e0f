"""A viewer that speaks Foxglove's protocol is sent the messages of a run."""

from __future__ import annotations

import asyncio
import json
import socket
import struct
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator
from recordings_by_hand import PLAN, whole_run, write_run
from served import growing_run

from bus_schemas.errors import InputError
from bus_schemas.signals import RUN
from live_page.run_view import RunView

pytest.importorskip("foxglove", reason="foxglove-sdk is not installed: heliarch[foxglove]")
client = pytest.importorskip("websockets.sync.client", reason="websockets is not installed")
from live_page.foxglove_stream import FoxgloveStream  # noqa: E402

TIME, MESSAGE = 2, 1
KEYS = {
    PLAN.wiring.key(port)
    for port in PLAN.wiring.ports
    if port.signal.logged and port.signal is not RUN
}


class Viewer:
    """A viewer that asks for some topics."""

    def __init__(self, connection: Any) -> None:  # noqa: ANN401 - websockets may not be there
        self._connection = connection
        self.channels: dict[str, dict[str, Any]] = {}
        self.times: set[int] = set()
        while len(self.channels) < len(KEYS):
            said = json.loads(connection.recv(timeout=30))
            self.channels |= {channel["topic"]: channel for channel in said.get("channels", ())}

    def messages(self, *topics: str) -> Iterator[tuple[str, int, dict[str, Any]]]:
        """Subscribe to topics; yield messages as they come: topic, time, fields."""
        wanted = [
            {"id": number, "channelId": self.channels[topic]["id"]}
            for number, topic in enumerate(topics)
        ]
        self._connection.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
        while True:
            said = self._connection.recv(timeout=30)
            if isinstance(said, bytes) and said[0] == TIME:
                self.times.add(struct.unpack_from("<Q", said, 1)[0])
            elif isinstance(said, bytes) and said[0] == MESSAGE:
                number, time_ns = struct.unpack_from("<IQ", said, 1)
                yield topics[number], time_ns, json.loads(said[13:])


@contextmanager
def viewer_of(run: Path) -> Iterator[Viewer]:
    """Stream a run; connect a viewer to it."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    stream = FoxgloveStream(RunView(run), port)
    loop = asyncio.new_event_loop()
    serving = loop.create_task(stream.serve())
    serving.add_done_callback(lambda _: loop.stop())
    thread = threading.Thread(target=loop.run_forever)
    thread.start()
    try:
        with client.connect(
            f"ws://127.0.0.1:{port}", subprotocols=["foxglove.sdk.v1"], max_size=None
        ) as connection:
            yield Viewer(connection)
    finally:
        loop.call_soon_threadsafe(serving.cancel)
        thread.join(20)
        assert not thread.is_alive()


def test_a_recording_is_played_on_a_channel_for_each_key(tmp_path: Path) -> None:
    topics = "field/c1/b/setpoint", "field/production"
    write_run(tmp_path / "run.mcap", whole_run(60))
    with viewer_of(tmp_path) as viewer:
        assert viewer.channels.keys() == KEYS
        assert {channel["encoding"] for channel in viewer.channels.values()} == {"json"}
        seen = []
        for topic, time_ns, fields in islice(viewer.messages(*topics), 20):
            Draft202012Validator(json.loads(viewer.channels[topic]["schema"])).validate(fields)
            seen.append((topic, fields["cycle"]))
            assert time_ns == fields["sim_time_ns"] == PLAN.sim_time_ns(fields["cycle"])
        assert PLAN.sim_time_ns(0) in viewer.times
        assert seen == [(topic, cycle) for cycle in range(10) for topic in topics]


def test_a_run_is_followed_while_it_is_recorded(tmp_path: Path) -> None:
    with growing_run(tmp_path / "run.mcap") as add:
        for cycle in range(10):
            add(cycle)
        with viewer_of(tmp_path) as viewer:
            cycles = (fields["cycle"] for _, _, fields in viewer.messages("field/production"))
            assert 9 in cycles
            add(10)
            assert next(cycles) == 10


def test_a_run_that_has_not_begun_and_a_port_in_use_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="has begun"):
        FoxgloveStream(RunView(tmp_path), 0)
    write_run(tmp_path / "run.mcap", whole_run(1))
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(InputError, match=f"--foxglove.*{port}"):
            FoxgloveStream(RunView(tmp_path), port)
