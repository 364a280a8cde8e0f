"""`heliarch view`: a port in use. What it shows is tested with the page."""

from __future__ import annotations

import socket
from pathlib import Path

from command_line import refusal
from recordings_by_hand import whole_run, write_run


def test_a_port_in_use_is_refused_in_one_line(tmp_path: Path) -> None:
    write_run(tmp_path / "run.mcap", whole_run(2))
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = str(taken.getsockname()[1])
        assert port in refusal("view", tmp_path, "--page-port", port)
