"""A launched plant promises what its central controller offers, as `simulate` does."""

from __future__ import annotations

from pathlib import Path

import pytest
from command_line import heliarch

from heliarch import open_run

pytestmark = pytest.mark.processes

OFFERED = 'commitment={kind="offered",interval_s=5,lead_s=2}'


def test_launch_offers_what_simulate_offers_and_verify_repeats_it(tmp_path: Path) -> None:
    options = ("oahu", "--duration", "20", "--set", OFFERED)
    for command in ("launch", "simulate"):
        result = heliarch(command, *options, "--out", str(tmp_path / command))
        assert result.exit_code == 0, result.output
    frames = {}
    for command in ("launch", "simulate"):
        with open_run(tmp_path / command) as run:
            frames[command] = run.frame("offer"), run.frame("dispatch")
    offers, dispatch = frames["launch"]
    assert offers["cycle"].tolist() == [3, 8, 13, 18]
    assert offers["share"].tolist() == frames["simulate"][0]["share"].tolist()
    assert dispatch["commitment_kw"].tolist() == frames["simulate"][1]["commitment_kw"].tolist()
    # The offer of cycle 3 is the commitment from cycle 5 on.
    share = dispatch["commitment_kw"] / dispatch["clear_sky_kw"]
    assert share.iloc[5:10].to_numpy() == pytest.approx(offers["share"].iloc[0])
    verified = heliarch("verify", str(tmp_path / "launch"))
    assert verified.exit_code == 0, verified.output


def test_offers_outlive_a_restart_and_verify_knows_what_they_rest_on(tmp_path: Path) -> None:
    shares = {}
    for name, faults in (("killed", ["kill=central,at=30s"]), ("healthy", ["delay=1ms"])):
        words = [word for fault in faults for word in ("--fault", fault)]
        out = ("--out", str(tmp_path / name))
        result = heliarch("simulate", "oahu", "--duration", "60", "--set", OFFERED, *words, *out)
        assert result.exit_code in {0, 1}, result.output
        with open_run(tmp_path / name) as run:
            shares[name] = run.frame("offer").set_index("cycle")["share"]
    first = shares["healthy"].iloc[0]
    assert shares["healthy"][53] > 1.1 * first
    assert shares["killed"][53] == pytest.approx(shares["healthy"][53], rel=0.1)
    verified = heliarch("verify", str(tmp_path / "killed"))
    assert verified.exit_code == 0, verified.output
