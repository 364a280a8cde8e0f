"""The command line as a whole."""

from __future__ import annotations

import pytest
from typer.testing import CliRunner

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


@pytest.mark.parametrize(
    "command",
    [
        *("simulate", "launch", "timing", "compare", "clusters", "delays", "report"),
        *("export", "verify", "inspect", "replay", "recover"),
    ],
)
def test_no_word_of_the_help_is_cut_in_a_terminal_of_80_columns(
    command: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("typer.rich_utils.MAX_WIDTH", 80)
    found = CliRunner().invoke(cli.app, [command, "--help"])
    assert found.exit_code == 0
    assert "Usage:" in found.output
    assert "…" not in found.output
