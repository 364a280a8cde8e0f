"""Prometheus reads a run from its page, and the shipped dashboard asks for what there is."""

from __future__ import annotations

import json
import re
import urllib.request
from pathlib import Path

import pytest
from prometheus_client.parser import text_string_to_metric_families
from recordings_by_hand import whole_run, write_run
from running import REPOSITORY
from served import served


@pytest.fixture
def samples(tmp_path: Path) -> dict[tuple[str, ...], float]:
    """The metrics of a run of 40 cycles, by name and labels."""
    write_run(tmp_path / "run.mcap", whole_run(40))
    with (
        served(tmp_path) as page,
        urllib.request.urlopen(f"{page.root}metrics", timeout=30) as answer,
    ):
        assert answer.headers["Content-Type"].startswith("text/plain")
        families = text_string_to_metric_families(answer.read().decode())
        return {
            (sample.name, *sample.labels.values()): sample.value
            for family in families
            for sample in family.samples
        }


def test_the_newest_cycle_is_told_in_watts_and_seconds(
    samples: dict[tuple[str, ...], float],
) -> None:
    assert samples["heliarch_cycles_total",] == 40
    assert samples["heliarch_plant_power_watts", "dispatch"] == 240_000.0
    assert samples["heliarch_agents", "fine"] == 8
    assert samples["heliarch_restarts_total", "c1"] == 0
    short = sum(samples["heliarch_shortfall_watts", cause] for cause in ("unavoidable", "control"))
    delivered = samples["heliarch_plant_power_watts", "delivered"]
    assert short == pytest.approx(max(240_000.0 - delivered, 0.0))


def test_the_dashboard_asks_for_metrics_that_there_are(
    samples: dict[tuple[str, ...], float],
) -> None:
    board = json.loads((REPOSITORY / "examples" / "grafana.json").read_text(encoding="utf-8"))
    asked = " ".join(target["expr"] for panel in board["panels"] for target in panel["targets"])
    assert {*re.findall(r"heliarch_\w+", asked)} == {name for name, *_ in samples}
