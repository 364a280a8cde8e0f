"""The tables of a recording hold all that its messages say, to the last bit."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from math import isnan
from pathlib import Path
from typing import Any

import msgspec
import pandas as pd
import pyarrow.parquet as pq
import pytest
from plans_by_hand import with_changes
from recording_by_hand import PLAN, RECORDER_LAG_NS, written

from agents.plan import RunPlan
from bus_schemas.bus import Delivery
from bus_schemas.codec import encode
from bus_schemas.errors import InputError
from bus_schemas.messages import HelpGiven, Message, Missing, Production
from bus_schemas.signals import PRODUCTION, SIGNALS
from bus_schemas.tree import ROOT, agent_name
from recordings.export.tables import TableFolder, TableForm
from recordings.read.reader import RecordedMessage, RunReader
from recordings.record.writer import ClockAnchor

RECORDED = tuple(signal for signal in SIGNALS if signal.logged)
MAY_BE_LEFT_OUT = {
    field.name
    for signal in RECORDED
    for field in msgspec.structs.fields(signal.type)
    if field.default is msgspec.UNSET
}
MAY_BE_NIL = {
    *(
        "available_kw",
        "clear_sky_kw",
        "frequency_hz",
        "revert_kw",
        "order_power_kw",
        "order_ramp_kw_per_min",
    ),
    *("order_hold_s", "order_renew_s", "correction_kw", "error_kw", "reference_kw"),
    *("lacking_kw", "tried_kw", "helped_share"),
}
BATCH_ROWS = 5

FORMS = pytest.mark.parametrize("form", ["parquet", "csv"])

Frames = dict[str, list[dict[str, Any]]]


def read(folder: Path, name: str, form: str) -> pd.DataFrame:
    if form == "parquet":
        return pd.read_parquet(folder / f"{name}.parquet")
    return pd.read_csv(folder / f"{name}.csv", parse_dates=["time"], dtype={"regulation_kw": float})


@pytest.fixture
def said(tmp_path: Path) -> list[Delivery]:
    """What is in the recording `run.mcap`."""
    return written(tmp_path / "run.mcap")


def write_tables(run: Path, folder: Path, form: TableForm, plan: RunPlan = PLAN) -> dict[str, int]:
    with RunReader(run) as reader:
        anchor = ClockAnchor.of(reader.metadata, reader.path)
        with TableFolder(folder, plan, RECORDED, anchor, form, BATCH_ROWS) as tables:
            for record in reader.records():
                tables.add(record, record.message())
    return tables.rows


def rebuilt(frames: Frames) -> Iterator[tuple[str, str, Message]]:
    """Put the messages of a recording together again from its tables: signal, node, message."""
    help_given, missing = defaultdict(list), defaultdict(list)
    mpp_kw, power_kw = defaultdict(list), defaultdict(list)
    for row in frames["help_given"]:
        help_given[row["donor"], row["sequence"]].append(HelpGiven(row["needy"], row["power_kw"]))
    for row in frames["missing_inputs"]:
        missing[row["signal"], row["node"], row["sequence"]].append(
            str(Missing(row["input"], None if isnan(row["used_cycle"]) else int(row["used_cycle"])))
        )
    for row in frames["production_inverters"]:
        mpp_kw[row["sequence"]].append(row["mpp_kw"])
        power_kw[row["sequence"]].append(row["power_kw"])
    agents = [row["agent"] for row in frames["given_up_agents"]]
    for signal in RECORDED:
        for row in frames[signal.name]:
            node, number = row.pop("node"), row["sequence"]
            row["sim_time_ns"] = row.pop("time").value
            row["missing"] = missing[signal.name, node, number]
            assert row.pop("log_time_ns") - row["publish_time_ns"] == RECORDER_LAG_NS
            for field in MAY_BE_NIL & row.keys():
                row[field] = None if isnan(row[field]) else row[field]
            match signal.name:
                case "given_up":
                    row["agents"] = agents
                case "setpoint":
                    row["help_given"] = help_given[node, number]
                case "production":
                    row["inverter_mpp_kw"] = mpp_kw[number]
                    row["inverter_power_kw"] = power_kw[number]
            yield signal.name, node, msgspec.convert(row, signal.type)


def is_left_out(column: str, cell: object) -> bool:
    return column in MAY_BE_LEFT_OUT and isinstance(cell, float) and isnan(cell)


@FORMS
def test_every_message_can_be_put_together_again_from_the_tables(
    said: list[Delivery], tmp_path: Path, form: TableForm
) -> None:
    rows = write_tables(tmp_path / "run.mcap", tmp_path / "tables", form)
    frames: Frames = {}
    for name, count in rows.items():
        frame = read(tmp_path / "tables", name, form)
        assert len(frame) == count
        frame["time"] = frame["time"].astype("datetime64[ns, UTC]")
        # CSV has nothing for an empty text.
        lines = frame.fillna({"order_source": ""}).to_dict("records")
        frames[name] = [
            {str(key): cell for key, cell in line.items() if not is_left_out(str(key), cell)}
            for line in lines
        ]
    found = {
        (signal, node, message.sequence): encode(message)
        for signal, node, message in rebuilt(frames)
    }
    expected = {
        (port.signal.name, agent_name(port.node), message.sequence): encode(message)
        for port, message in said
    }
    assert found == expected
    if form == "parquet":
        file = pq.ParquetFile(tmp_path / "tables" / "impp.parquet")
        assert file.schema_arrow.field("time").type.tz == "Pacific/Honolulu"
        assert file.metadata.row_group(0).num_rows == BATCH_ROWS


@pytest.mark.usefixtures("said")
@pytest.mark.parametrize(
    ("timezone", "first"),
    [
        ("Pacific/Honolulu", "2010-04-01T12:00:00.500000-10:00"),
        ("Europe/Berlin", "2010-04-02T00:00:00.500000+02:00"),
    ],
)
def test_csv_has_local_times(tmp_path: Path, timezone: str, first: str) -> None:
    plan = with_changes(PLAN, timezone=timezone)
    write_tables(tmp_path / "run.mcap", tmp_path / "csv", "csv", plan)
    lines = (tmp_path / "csv" / "dispatch.csv").read_text(encoding="utf-8").splitlines()
    assert lines[0].startswith('"time","cycle","node","power_kw"')
    assert lines[2].startswith(f'"{first}",1,"central",')


def test_a_production_of_another_plant_is_refused(said: list[Delivery], tmp_path: Path) -> None:
    production = next(m for _, m in said if isinstance(m, Production) and m.cycle == 3)
    production.inverter_mpp_kw = (1.0,)
    record = RecordedMessage(PRODUCTION.of(ROOT), 3, 0, 0, 0, b"")
    with (
        pytest.raises(InputError, match="production of cycle 3: expected 4 inverters"),
        TableFolder(tmp_path / "csv", PLAN, RECORDED, ClockAnchor(0, 0), "csv") as tables,
    ):
        tables.add(record, production)
