"""A report says who lacked power and who gave it, how clusters fared, and where faults were."""

from __future__ import annotations

from pathlib import Path

import pytest
from plans_by_hand import with_changes
from recordings_by_hand import PLAN, whole_run, write_run

from bus_schemas.messages import Dispatch
from recordings.inspect.overview import read_overview
from recordings.read.reader import RunReader
from recordings.read.series import series_of
from results.report.help import HelpBetween, help_table
from results.report.marks import run_marks
from results.report.run_report import runs_result, write_run_report
from scenarios.fault_rules import parse_fault

CYCLES = 90
HOURS = CYCLES / 3600.0


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A recording with faults: `c1/a` lacks 20 kW in each cycle, and `c1/b` gives them."""
    faults = parse_fault("freeze=c2,at=20s..30s"), parse_fault("kill=c1/a,at=50s")
    plan = with_changes(PLAN, faults=faults, positions_m=((0, 0), (9, 0), (0, 9), (9, 9)))
    deliveries = list(whole_run(CYCLES))
    for _, message in deliveries:
        if isinstance(message, Dispatch) and message.cycle >= 70:
            message.order_source, message.order_cycle, message.order_power_kw = "page", 70, 100.0
    write_run(
        tmp_path / "run.mcap",
        deliveries,
        plan=plan,
        is_kept=lambda one: one[0].publisher != "c2" or not 20 <= one[1].cycle < 30,
    )
    return tmp_path / "run.mcap"


def helped(reader: RunReader) -> HelpBetween:
    found = HelpBetween(reader.plan, reader.plan.tree.nodes)
    series_of(reader, also=[found])
    return found


def test_the_needy_are_ranked_with_their_helpers(run: Path) -> None:
    with RunReader(run) as reader:
        found = helped(reader)
        table = help_table(found, reader.clock)
    assert found.most_needy == ["c1/a"]
    assert found.needs["c1/a"].lacking_kwh == pytest.approx(20.0 * HOURS)
    ((giver, kwh),) = found.helpers("c1/a")
    assert giver == "c1/b"
    assert kwh == pytest.approx(20.0 * HOURS)
    assert table.texts()[0][0] == "c1/a"


def test_faults_and_absences_are_marked_in_every_figure_over_time(run: Path) -> None:
    with RunReader(run) as reader:
        series = series_of(reader)
        marks = run_marks(reader, read_overview(reader), series)
    assert [one.cycle for one in marks] == [20, 20, 30, 50, 70]
    result = runs_result("A run", [series], (), (), marks=marks)
    for figure in result.figures():
        texts = [note.hovertext for note in figure.figure.layout.annotations if note.hovertext]
        assert len(texts) == len(marks) * (figure.anchor != "correlation"), figure.anchor


def test_a_report_of_a_recording_begins_with_what_was_kept_and_at_which_price(run: Path) -> None:
    page = write_run_report(run).read_text(encoding="utf-8")
    first, rest = page.split('<section id="about">')
    for words in ("of the promise missed", "left unused", 'id="power-plot"', "c1/a"):
        assert words in first
    assert first.count("<circle") == 4 * first.count("<svg") > 0
    for words in ("90 of 1,000 cycles", "Who helped whom", "Health of the run"):
        assert words in rest
