"""`heliarch diff`: two recorded runs side by side."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from pathlib import Path

import msgspec
import pytest
from command_line import done, heliarch, refusal
from plans_by_hand import with_changes
from recorded_runs import plan_of
from recordings_by_hand import PLAN, whole_run, write_run
from running import small_plant

from bus_schemas.bus import Delivery
from bus_schemas.messages import Help, Production


def with_production(cycles: int, cycle: int, **fields: tuple[float, ...]) -> Iterator[Delivery]:
    """A run by hand with another production in one cycle."""
    for port, message in whole_run(cycles):
        if isinstance(message, Production) and message.cycle == cycle:
            message = msgspec.structs.replace(message, **fields)  # noqa: PLW2901
        yield port, message


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A recording in which `c2/c` delivers 55 instead of 60 kW in cycle 7."""
    folder = tmp_path / "first"
    folder.mkdir()
    less = with_production(20, 7, inverter_power_kw=(40.0, 80.0, 55.0, 59.0))
    write_run(folder / "run.mcap", less, plan=with_changes(PLAN, cycles=20))
    return folder


POWER = ("production, inverter_power_kw", "c2/c", 7, "12:00:07", 55.0, 60.0)
SKY = ("production, inverter_mpp_kw", "c1/b", 3, "12:00:03", 90.0, 95.0)


@pytest.mark.parametrize(
    ("deliveries", "left_out", "differences", "cycles", "less_kw", "said"),
    [
        (whole_run(20), range(0), [POWER], 20, 5.0, "A: "),
        (
            with_production(20, 3, inverter_mpp_kw=(40.0, 95.0, 75.0, 75.0)),
            *(range(0), [SKY, POWER], 20, 5.0, "Sky or dispatch differ"),
        ),
        # In the cycles that both have recorded they are the same.
        (
            whole_run(6),
            range(0),
            [],
            6,
            0.0,
            "A has 20 of 20, B has 6 of 6",
        ),
        (
            whole_run(20),
            range(5, 9),
            [],
            16,
            0.0,
            "A has 20 of 20, B has 16 of 20",
        ),
    ],
    ids=["another command", "another sky", "shorter", "with a gap"],
)
def test_two_runs_stand_side_by_side_with_their_differences(
    run: Path,
    tmp_path: Path,
    deliveries: Iterable[Delivery],
    left_out: range,
    differences: list[tuple[object, ...]],
    cycles: int,
    less_kw: float,
    said: str,
) -> None:
    document, page, other = (tmp_path / name for name in ("x.json", "x.html", "other.mcap"))
    plan = with_changes(PLAN, cycles=6 if cycles == 6 else 20)
    write_run(other, deliveries, plan=plan, is_kept=lambda pair: pair[1].cycle not in left_out)
    answer = heliarch("diff", run, other, "--json", document, "--report", page)
    text = " ".join(answer.output.split())
    assert answer.exit_code == 1
    assert said in text
    assert "bit for bit" not in text
    assert "gaps" not in text, "A is whole"
    assert ("equal as far as compared" in text) == (not differences)
    found = json.loads(document.read_bytes())
    columns = ("message", "node", "cycle", "time", "A", "B")
    rows = [tuple(row[name] for name in columns) for row in found["differences"]]
    assert rows == differences[:1]
    delivered = {row["figure"]: row for row in found["figures"]}["Delivered energy"]
    assert delivered["B"] == pytest.approx(239.0 * cycles / 3600.0)
    assert delivered["difference"] == pytest.approx(less_kw / 3600.0)
    html = page.read_text(encoding="utf-8")
    assert "delivered, A" in html
    assert "delivered, B" in html


def test_runs_of_two_plants_are_refused(run: Path, tmp_path: Path) -> None:
    renamed = tuple((f"{path}2", rating_kw) for path, rating_kw in PLAN.inverters)
    later_ns = PLAN.timing.start_time_ns + 10**9
    plans = {
        "later": with_changes(PLAN, start_time_ns=later_ns),
        "renamed": msgspec.structs.replace(PLAN, inverters=renamed),
    }
    for name, plan in plans.items():
        of_plant = [(port, message) for port, message in whole_run(20) if not port.node]
        write_run(tmp_path / name, of_plant, plan=plan)
        line = refusal("diff", run, tmp_path / name)
        assert line.startswith(f"heliarch: {tmp_path / name}: expected ")
        assert str(run) in line
    write_run(tmp_path / "empty", [], plan=plan_of(start_time_ns=PLAN.timing.start_time_ns))
    assert "cycle" in refusal("diff", run, tmp_path / "empty")


def test_a_run_is_equal_to_itself_only_if_all_of_it_could_be_read(run: Path) -> None:
    assert "equal bit for bit" in done("diff", run, run)
    cut = run.with_name("cut.mcap")
    cut.write_bytes((run / "run.mcap").read_bytes()[:-40])
    answer = heliarch("diff", run, cut)
    assert answer.exit_code == 1
    assert "equal as far as compared" in " ".join(answer.output.split())


@pytest.mark.parametrize(
    ("missing_kw", "shown"), [(1.0, "1.000000"), (20.0000000001, "20.0000000001")]
)
def test_messages_of_every_signal_are_compared(
    run: Path, tmp_path: Path, missing_kw: float, shown: str
) -> None:
    def with_another_help() -> Iterator[Delivery]:
        for port, message in with_production(20, 7, inverter_power_kw=(40.0, 80.0, 55.0, 59.0)):
            if isinstance(message, Help) and message.cycle == 9:
                message = msgspec.structs.replace(message, missing_kw=missing_kw)  # noqa: PLW2901
            yield port, message

    write_run(tmp_path / "other.mcap", with_another_help())
    answer = heliarch("diff", run, tmp_path / "other.mcap", "--json", "-")
    (row,) = json.loads(answer.stdout)["differences"]
    assert (row["message"], row["cycle"], row["B"]) == ("help, missing_kw", 9, missing_kw)
    assert shown in answer.stderr.split()
    assert answer.exit_code == 1


def test_each_setting_that_differs_is_named_also_with_the_values_of_another(
    tmp_path: Path,
) -> None:
    plant = small_plant(tmp_path / "plant")
    for share in ("0.04", "0.05"):
        fields = (f"control.alpha_min={share}", f"plant.meter_noise={share}")
        words = (word for field in fields for word in ("--set", field))
        done("simulate", plant, "--duration", "3", *words, "--out", tmp_path / share)
    answer = heliarch("diff", tmp_path / "0.04", tmp_path / "0.05", "--json", "-")
    named = {row["setting"] for row in json.loads(answer.stdout)["scenario"]}
    assert named == {"control.alpha_min", "plant.meter_noise"}
