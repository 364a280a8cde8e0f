"""The tables of a recording hold all that its messages say, to the last bit."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator
from math import isnan
from pathlib import Path
from typing import Any

import msgspec
import pandas as pd
import pyarrow.parquet as pq
import pytest
from recording_by_hand import PLAN, RECORDER_LAG_NS, written

from bus_schemas.bus import Delivery
from bus_schemas.codec import encode
from bus_schemas.errors import InputError
from bus_schemas.messages import HelpGiven, Message, Production
from bus_schemas.missing import Missing
from bus_schemas.signals import PRODUCTION, SIGNALS, TELEMETRY, Signal
from bus_schemas.tree import ROOT, agent_name
from recordings.export import parquet_table
from recordings.export.csv_table import CsvTable, iso_times
from recordings.export.parquet_table import ParquetTable
from recordings.export.records import Record, Selection, clock_anchor, records
from recordings.export.table_files import OpenTable, TableFiles
from recordings.export.tables import inverters_table, tables_of
from recordings.read.reader import RunReader
from recordings.record.writer import ClockAnchor

RECORDED = tuple(signal for signal in SIGNALS if signal.logged)

Read = Callable[[Path, str], pd.DataFrame]
Frames = dict[str, list[dict[str, Any]]]


def read_parquet(folder: Path, name: str) -> pd.DataFrame:
    return pd.read_parquet(folder / f"{name}.parquet")


def read_csv(folder: Path, name: str) -> pd.DataFrame:
    return pd.read_csv(folder / f"{name}.csv", parse_dates=["time"])


FORMS = pytest.mark.parametrize(
    ("open_table", "suffix", "read"),
    [(ParquetTable, ".parquet", read_parquet), (CsvTable, ".csv", read_csv)],
    ids=["parquet", "csv"],
)


@pytest.fixture
def said(tmp_path: Path) -> list[Delivery]:
    """What is in the recording `run.mcap`."""
    return written(tmp_path / "run.mcap")


def write_tables(run: Path, folder: Path, open_table: OpenTable, suffix: str) -> dict[str, int]:
    """Write all tables of a recording; return their numbers of rows."""
    with RunReader(run) as reader:
        files = TableFiles(folder, reader.plan, RECORDED, clock_anchor(reader), open_table, suffix)
        with files:
            for record in records(reader, Selection(RECORDED), lambda share: None):
                files.add(record)
    return files.rows


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
    for signal in RECORDED:
        for row in frames[signal.name]:
            node, number = row.pop("node"), row["sequence"]
            row["sim_time_ns"] = row.pop("time").value
            row["missing"] = missing[signal.name, node, number]
            assert row.pop("log_time_ns") - row["publish_time_ns"] == RECORDER_LAG_NS
            if signal.name == "telemetry" and isnan(row["available_kw"]):
                row["available_kw"] = None
            if signal.name == "setpoint":
                row["help_given"] = help_given[node, number]
            if signal.name == "production":
                row["inverter_mpp_kw"] = mpp_kw[number]
                row["inverter_power_kw"] = power_kw[number]
            yield signal.name, node, msgspec.convert(row, signal.type)


@FORMS
def test_every_message_can_be_put_together_again_from_the_tables(
    said: list[Delivery], tmp_path: Path, open_table: OpenTable, suffix: str, read: Read
) -> None:
    rows = write_tables(tmp_path / "run.mcap", tmp_path / "tables", open_table, suffix)
    frames: Frames = {}
    for name, count in rows.items():
        frame = read(tmp_path / "tables", name)
        assert len(frame) == count
        frame["time"] = frame["time"].astype("datetime64[ns, UTC]")
        frames[name] = frame.to_dict("records")  # type: ignore[assignment]
    found = {
        (signal, node, message.sequence): encode(message)
        for signal, node, message in rebuilt(frames)
    }
    expected = {
        (port.signal.name, agent_name(port.node), message.sequence): encode(message)
        for port, message in said
    }
    assert found == expected


@FORMS
def test_no_cell_holds_a_list(
    said: list[Delivery], tmp_path: Path, open_table: OpenTable, suffix: str, read: Read
) -> None:
    assert said
    for name in write_tables(tmp_path / "run.mcap", tmp_path / "tables", open_table, suffix):
        for cell in read(tmp_path / "tables", name).to_numpy().ravel():
            assert not isinstance(cell, list | tuple | dict)


@pytest.mark.parametrize("signal", RECORDED, ids=[signal.name for signal in RECORDED])
def test_every_field_of_a_signal_has_a_column(signal: Signal[Message]) -> None:
    tables = tables_of([signal], PLAN, ClockAnchor(0, 0))[signal]
    columns = {column.name for table in tables for column in table.columns}
    fields = {name.removeprefix("inverter_") for name in signal.type.__struct_fields__}
    under_other_names = {"sim_time_ns": "time", "missing": "input", "help_given": "donor"}
    assert {under_other_names.get(name, name) for name in fields} <= columns


@pytest.mark.usefixtures("said")
def test_local_time_carries_its_zone(tmp_path: Path) -> None:
    run = tmp_path / "run.mcap"
    write_tables(run, tmp_path / "parquet", ParquetTable, ".parquet")
    times = pq.read_table(tmp_path / "parquet" / "impp.parquet").schema.field("time").type
    assert (times.unit, times.tz) == ("ns", "Pacific/Honolulu")
    write_tables(run, tmp_path / "csv", CsvTable, ".csv")
    lines = (tmp_path / "csv" / "dispatch.csv").read_text(encoding="utf-8").splitlines()
    assert lines[2].startswith("2010-04-01T12:00:00.500-10:00,1,central,")


def test_times_are_unique_where_the_clock_is_put_back() -> None:
    plan = msgspec.structs.replace(PLAN, timezone="Europe/Berlin", cycle_ns=1_000_000_000)
    iso_time = iso_times(plan)
    before_ns = int(pd.Timestamp("2010-10-31T00:30:00Z").value)
    assert iso_time(before_ns) == "2010-10-31T02:30:00+02:00"
    assert iso_time(before_ns + 3600 * 10**9) == "2010-10-31T02:30:00+01:00"


def test_a_time_between_the_cycles_keeps_all_its_digits() -> None:
    iso_time = iso_times(PLAN)
    assert iso_time(PLAN.start_time_ns + 500_000_000) == "2010-04-01T12:00:00.500-10:00"
    assert iso_time(PLAN.start_time_ns + 1) == "2010-04-01T12:00:00.000000001-10:00"


def test_a_time_that_is_no_date_is_refused() -> None:
    with pytest.raises(InputError, match="sim_time_ns is 9223372036854775807000"):
        iso_times(PLAN)(9_223_372_036_854_775_807_000)


@pytest.mark.usefixtures("said")
def test_rows_are_written_in_groups(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parquet_table, "ROW_GROUP", 4)
    monkeypatch.setattr("recordings.export.table_files._BATCH", 3)
    rows = write_tables(tmp_path / "run.mcap", tmp_path / "tables", ParquetTable, ".parquet")
    file = pq.ParquetFile(tmp_path / "tables" / "impp.parquet")
    groups = [file.metadata.row_group(place).num_rows for place in range(file.num_row_groups)]
    assert max(groups) <= 6
    assert sum(groups) == rows["impp"] == PLAN.cycles * len(PLAN.tree.nodes)


def test_a_number_beyond_64_bits_is_refused_by_name(tmp_path: Path) -> None:
    (table, _) = tables_of([TELEMETRY], PLAN, ClockAnchor(0, 0))[TELEMETRY]
    file = ParquetTable(tmp_path / "telemetry.parquet", table, PLAN)
    row = (2**63, 0, "c1/a", 1.0, 1.0, 1.0, None, "plant", 0, 0, 0, 0)
    with pytest.raises(InputError, match=r"telemetry: .*accepted are integers of 64 bits"):
        file.write([row])
    file.close()


def test_a_production_of_another_plant_is_refused() -> None:
    production = Production(
        7,
        0,
        "plant",
        (),
        desired_kw=1.0,
        possible_kw=1.0,
        delivered_kw=1.0,
        inverter_mpp_kw=(1.0,),
        inverter_power_kw=(1.0, 2.0),
    )
    record = Record(PRODUCTION.of(ROOT), production, 0, 0, 0)
    with pytest.raises(InputError, match="production of cycle 7 lists 1 maxima and 2 powers"):
        list(inverters_table(PLAN).rows(record))
