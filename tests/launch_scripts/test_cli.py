"""The command line as a whole."""

from __future__ import annotations

import pytest

from launch_scripts import cli


def test_ctrl_c_before_a_command_can_see_to_it_is_no_traceback(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(cli, "app", interrupted)
    with pytest.raises(SystemExit) as left:
        cli.main()
    assert left.value.code == 130
    assert capsys.readouterr().err == "heliarch: interrupted\n"
