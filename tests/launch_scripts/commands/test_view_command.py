"""`heliarch view`: what it refuses. What it shows is tested with the page."""

from __future__ import annotations

import socket
import sys
from pathlib import Path

import pytest
from command_line import refusal
from recordings_by_hand import whole_run, write_run


def test_what_cannot_be_shown_is_refused_in_one_line(tmp_path: Path) -> None:
    assert "nowhere" in refusal("view", tmp_path / "nowhere")
    (tmp_path / "text.mcap").write_text("cycle,power_kw\n")
    assert "text.mcap" in refusal("view", tmp_path / "text.mcap")
    (tmp_path / "empty").mkdir()
    assert "empty" in refusal("view", tmp_path / "empty")


def test_a_port_in_use_is_refused_in_one_line(tmp_path: Path) -> None:
    write_run(tmp_path / "run.mcap", whole_run(2))
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = str(taken.getsockname()[1])
        assert port in refusal("view", tmp_path, "--page-port", port)
    assert "--page-address" in refusal("view", tmp_path, "--page-address", "the moon")


def test_a_stream_for_viewers_is_refused_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "run").mkdir()
    write_run(tmp_path / "run" / "run.mcap", whole_run(2))
    assert "one run" in refusal("view", tmp_path, "--foxglove", "8765")
    monkeypatch.setitem(sys.modules, "foxglove", None)
    monkeypatch.delitem(sys.modules, "live_page.foxglove_stream", raising=False)
    assert "heliarch[foxglove]" in refusal("view", tmp_path / "run", "--foxglove", "8765")
