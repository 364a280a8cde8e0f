"""What loggers, archives and spreadsheets write: each kind is read, or refused in one line.

`owner/repository#number` is the public thread on GitHub that shows such a file.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from bus_schemas.errors import InputError
from sim_plant.clear_sky import clear_ghi
from sim_plant.irradiance import Irradiance, StatedForm, read_measured_ghi

TIMES = pd.date_range("2024-06-15 19:00", periods=12, freq="10s", tz="UTC")
VALUES = np.column_stack([np.arange(600.0, 720.0, 10.0), np.arange(655.5, 715.5, 5.0)])
POSITIONS = "station,lat,lon\np1,35.052,-106.543\np2,35.054,-106.541\n"
LOCAL_FORM = StatedForm(timezone="Etc/GMT+6")


def table(
    stamp: Callable[[pd.Timestamp], str] = lambda time: f"{time:%Y-%m-%dT%H:%M:%SZ}",
    *,
    header: str = "time,p1,p2",
    number: Callable[[float], str] = lambda value: f"{value:g}",
    times: pd.DatetimeIndex = TIMES,
    values: np.ndarray = VALUES,
    by: str = ",",
    end: str = "",
) -> str:
    rows = (
        by.join([stamp(time), *map(number, row)]) + end
        for time, row in zip(times, values, strict=True)
    )
    return "\n".join([header, *rows, ""])


def with_cell(text: str) -> str:
    """Replace one value in the middle."""
    return table().replace(",650,", f",{text},")


def local(form: str) -> Callable[[pd.Timestamp], str]:
    return lambda time: f"{time.tz_convert('Etc/GMT+6'):{form}}"


def comma(value: float) -> str:
    return f"{value:g}".replace(".", ",")


def comma_days(time: pd.Timestamp) -> str:
    since = time.tz_convert("Etc/GMT+6").tz_localize(None) - pd.Timestamp("1899-12-30")
    return f"{since / pd.Timedelta('1D'):.9f}".replace(".", ",")


def day_of_year(form: str) -> Callable[[pd.Timestamp], str]:
    """Write no zeros before the day and the hour, as loggers with arrays of numbers do."""
    return lambda time: f"{local('%Y,')(time)}{int(local('%j')(time))},{int(local(form)(time))}"


def long_table(names: tuple[str, str] = ("p1", "p2")) -> str:
    rows = [
        f"{name},{VALUES[at, of]:g},{time:%Y-%m-%dT%H:%M:%S.000Z}"
        for at, time in enumerate(TIMES)
        for of, name in enumerate(names)
    ]
    return "\n".join(["entity_id,state,last_changed", *rows, ""])


def long_table_of_series() -> str:
    rows = [
        f"{name};{time:%Y-%m-%dT%H:%M:%S.000Z};{VALUES[at, of]:g}"
        for of, name in enumerate(("p1", "p2"))
        for at, time in enumerate(TIMES)
    ]
    return "\n".join(["Series;Time;Value", *rows, ""])


def annotated() -> str:
    """Write the table as InfluxDB does, with the bounds of the query in each line."""
    begin, end = (f"{time:%Y-%m-%dT%H:%M:%SZ}" for time in (TIMES[0], TIMES[-1]))
    rows = [
        f",,{of},{begin},{end},{time:%Y-%m-%dT%H:%M:%SZ},{VALUES[at, of]:g},ghi,{name}"
        for of, name in enumerate(("p1", "p2"))
        for at, time in enumerate(TIMES)
    ]
    head = [
        "#group,false,false,true,true,false,false,true,true",
        "#datatype,string,long,dateTime:RFC3339,dateTime:RFC3339,dateTime:RFC3339,double,string,string",
        "#default,_result,,,,,,,",
        ",result,table,_start,_stop,_time,_value,_field,station",
    ]
    return "\n".join([*head, *rows, ""])


@dataclass(frozen=True)
class Kind:
    """A kind of file: its text, what is said of it, and who wrote such a file."""

    text: str | bytes
    said: str = ""
    positions: str = POSITIONS
    form: StatedForm = LOCAL_FORM


TOA5 = (
    '"TOA5","CR1000X","CR1000X","12345","CR1000X.Std.05.02"\n"TIMESTAMP","RECORD","p1","p2"\n'
    '"TS","RN","W/m^2","W/m^2"\n"","","Avg","Avg"\n'
)
ROWS = table(lambda time: f'"{local("%Y-%m-%d %H:%M:%S")(time)}",7', header="").lstrip("\n")
DAY_FIRST = StatedForm(timezone="Etc/GMT+6", dates="day-first")
MONTH_FIRST = StatedForm(timezone="Etc/GMT+6", dates="month-first")

READ = {
    "plain": Kind(table()),
    "semicolons, decimal commas, german dates": Kind(
        table(local("%d.%m.%Y %H:%M:%S"), header="time;p1;p2", number=comma, by=";"),
        "semicolons; the decimal mark is a comma; time stamps without an offset are taken as",
    ),
    "semicolons": Kind(table(header="time;p1;p2", by=";"), "semicolons"),
    "tabs": Kind(table(header="time\tp1\tp2", by="\t"), "tabs"),
    "bars": Kind(table(header="time|p1|p2", by="|"), "bars"),
    "spaces": Kind(table(header="time p1 p2", by="  "), "spaces"),
    "a comma at the end": Kind(table(header="time,p1,p2,", end=",")),
    "no comma at the end of the header": Kind(table(end=",")),
    "windows line ends": Kind(table().replace("\n", "\r\n")),
    "byte order mark": Kind(b"\xef\xbb\xbf" + table().encode()),
    "utf-16": Kind(table().encode("utf-16"), "utf-16"),
    "latin-1": Kind(("# Größe\n" + table()).encode("latin-1"), "cp1252"),
    "comment lines": Kind("# made by a logger\n# on a roof, W/m2\n" + table(), "header is line 3"),
    "a hash before the header": Kind("# " + table()),
    "a comment between": Kind(
        table().replace("2024-06-15T19:01:00Z", "# cleaned\n2024-06-15T19:01:00Z")
    ),
    "Campbell TOA5": Kind(TOA5 + ROWS, "header is line 2"),
    "Campbell TOACI1 (usbr/Pisces#55)": Kind(
        '"TOACI1","ROOF","Table1"\n"TMSTAMP","RECNBR","p1","p2"\n' + ROWS, "header is line 2"
    ),
    "a row of units": Kind(table().replace("\n", "\nutc,W/m2,W/m2\n", 1)),
    "units in the names": Kind(table(header="time,p1 [W/m^2],p2 (W/m²)")),
    "kilowatts in the names": Kind(
        table(header="time,p1 [kW/m2],p2 [kW/m2]", values=VALUES / 1000.0), "kW/m2 was converted"
    ),
    "milliwatts in a row of units": Kind(
        table(values=VALUES / 10.0).replace("\n", "\nutc,mW/cm2,mW/cm2\n", 1),
        "mW/cm2 was converted",
    ),
    "kilowatts, stated": Kind(
        table(values=VALUES / 1000.0), "kW/m2 was converted", form=StatedForm(unit="kW/m2")
    ),
    "without offset": Kind(table(local("%Y-%m-%d %H:%M:%S")), "are taken as Etc/GMT+6"),
    "hours as offset (duckdb#1627)": Kind(
        table(lambda time: f"{local('%Y-%m-%d %H:%M:%S')(time)}-06")
    ),
    "+00": Kind(table(lambda time: f"{time:%Y-%m-%d %H:%M:%S}+00")),
    "+0000": Kind(table(lambda time: f"{time:%Y-%m-%dT%H:%M:%S}+0000")),
    " UTC (questdb#3039)": Kind(table(lambda time: f"{time:%Y-%m-%d %H:%M:%S} UTC")),
    "UTC in the header": Kind(
        table(lambda time: f"{time:%Y-%m-%d %H:%M:%S}", header="time (UTC),p1,p2"),
        "in UTC, as the header says",
    ),
    "HST after the time": Kind(
        table(lambda time: f"{time.tz_convert('Etc/GMT+10'):%Y-%m-%d %H:%M:%S} HST")
    ),
    "MST in the header (NREL MIDC)": Kind(
        table(
            lambda time: f"{time.tz_convert('Etc/GMT+7'):%m/%d/%Y,%H:%M:%S}",
            header="DATE (MM/DD/YYYY),MST,p1 [W/m^2],p2 [W/m^2]",
        ),
        "in Etc/GMT+7, as the header says",
    ),
    "slashes, UTC (SEED#3324)": Kind(table(lambda time: f"{time:%Y/%m/%d %H:%M:%S} UTC")),
    "two spaces, day first (weewx#880)": Kind(
        table(local("%d/%m/%Y   %H:%M:%S"), header="time;p1;p2", number=comma, by=";")
    ),
    "two spaces, month first (pandas#10037)": Kind(table(local("%m/%d/%Y  %H:%M:%S"))),
    "AM and PM": Kind(table(local("%m/%d/%Y %I:%M:%S %p"))),
    "names of months (gyanz/pydsstools#7)": Kind(table(local("%d%b%Y %H:%M:%S"))),
    "names of months with dashes": Kind(table(local("%d-%b-%Y %H:%M:%S"))),
    "date and time apart": Kind(table(local("%d.%m.%Y,%H:%M:%S"), header="Datum,Zeit,p1,p2")),
    "a comma in the seconds (telegraf#3571)": Kind(
        table(local("%Y-%m-%d %H:%M:%S,000"), header="time;p1;p2", by=";")
    ),
    "quoted dates (PVTools#36)": Kind(table(lambda time: f'"{time:%Y-%m-%d %H:%M:%S}+00:00"')),
    "seconds since 1970 (export-csv-to-influx#17)": Kind(
        table(lambda time: f"{time.value // 10**9}"), "s since 1970"
    ),
    "milliseconds since 1970 (questdb#876)": Kind(
        table(lambda time: f"{time.value // 10**6}"), "ms since 1970"
    ),
    "days of a spreadsheet (PowerShell#19536)": Kind(
        table(comma_days, header="time;p1;p2", number=comma, by=";"),
        "a spreadsheet's days",
    ),
    "digits alone": Kind(table(local("%Y%m%d%H%M%S"))),
    "intervals (pvlib#279, MACC-RAD)": Kind(
        table(
            lambda time: (
                f"{time:%Y-%m-%dT%H:%M:%SZ}/{time + pd.Timedelta('10s'):%Y-%m-%dT%H:%M:%SZ}"
            )
        ),
        "of which the begin was taken",
    ),
    "a number before each line": Kind(
        "\n".join(f"{at - 1 if at else ''},{line}" for at, line in enumerate(table().splitlines()))
    ),
    "R's header, one short": Kind(table(header="p1,p2")),
    "thousands (emoncms#222)": Kind(
        table(
            header="time;p1;p2",
            number=lambda value: f"{2.0 * value:,.2f}",
            by=";",
            values=VALUES / 2.0,
        )
    ),
    "jitter (pecos#39)": Kind(
        table(
            lambda time: f"{time:%Y-%m-%dT%H:%M:%S}.{time.second % 7:03d}Z",
        ),
        "rounded to it",
    ),
    "a stamp one second late": Kind(
        table().replace("19:00:50Z", "19:00:51Z"), "1 of 12 time stamps"
    ),
    "newest first": Kind(table(times=TIMES[::-1], values=VALUES[::-1]), "the order was reversed"),
    "a long table (homeassistant-statistics#82)": Kind(long_table(), "names the station"),
    "other names of positions": Kind(
        table(),
        positions=POSITIONS.replace("station,lat,lon", "Name;Latitude;Longitude").replace(",", ";"),
    ),
    "names with units in both": Kind(
        table(header="time,Global PSP [W/m^2],p2"),
        positions=POSITIONS.replace("p1", "Global PSP [W/m^2]"),
    ),
    "date and time apart, ISO": Kind(table(local("%Y-%m-%d,%H:%M:%S"), header="date,time,p1,p2")),
    "time before the date": Kind(table(local("%H:%M:%S,%Y-%m-%d"), header="time,date,p1,p2")),
    "date and time apart, AM and PM": Kind(
        table(local("%m/%d/%Y,%I:%M:%S %p"), header="Date,Time,p1,p2")
    ),
    "Excel in German, date and time apart": Kind(
        table(local("%d.%m.%Y;%H:%M:%S"), header="Datum;Uhrzeit;p1;p2", number=comma, by=";"),
        "the decimal mark is a comma",
    ),
    "Excel in French, date and time apart": Kind(
        table(local("%d/%m/%Y;%H:%M:%S"), header="Date;Heure;p1;p2", number=comma, by=";"),
        "the decimal mark is a comma",
    ),
    "digits, date and time apart": Kind(table(local("%Y%m%d,%H%M%S"), header="date,time,p1,p2")),
    "year to second in columns": Kind(
        table(local("%Y,%m,%d,%H,%M,%S"), header="Year,Month,Day,Hour,Minute,Second,p1,p2")
    ),
    "day of year and time": Kind(table(local("%Y,%j,%H:%M:%S"), header="Year,DOY,Time,p1,p2")),
    "day of year and digits (Campbell)": Kind(
        table(day_of_year("%H%M%S"), header="Year_RTM,Day_RTM,Hour_Minute_RTM,p1,p2")
    ),
    "UTC_DATE and UTC_TIME (pvlib#666, CRN)": Kind(
        table(
            lambda time: f"23803  {time:%Y%m%d  %H%M%S}",
            header="WBANNO UTC_DATE UTC_TIME p1 p2",
            by="  ",
        ),
        form=StatedForm(timezone="UTC"),
    ),
    "tabs and decimal commas (SBFspot#519)": Kind(
        table(
            lambda time: local("%d/%m/%Y %H:%M:%S")(time) + "\tSB3.6",
            header="d/MM/yyyy HH:mm:ss\tDeviceName\tp1\tp2",
            number=comma,
            by="\t",
        )
    ),
    "spaces after semicolons (SBFspot#538)": Kind(
        table(local("%d/%m/%Y %H:%M:%S"), header="time; p1; p2", number=comma, by="; ")
    ),
    "a line sep=; (grafana#9412)": Kind(
        "sep=;\n" + table(header="Time;p1;p2", by=";"), "header is line 2"
    ),
    "series as columns (grafana#4041)": Kind(
        table(lambda time: f"{time:%Y-%m-%dT%H:%M:%S.000Z}", header="Time;p1;p2", by=";")
    ),
    "series as rows (grafana#2401)": Kind(long_table_of_series(), "names the station"),
    "quoted states (home-assistant/frontend#20088)": Kind(
        re.sub(r",([\d.]+),", r',"\1",', long_table()), "names the station"
    ),
    "quoted local times (GEN24_Ladesteuerung#191)": Kind(
        table(local('"%Y-%m-%d %H:%M:%S"'), header="Zeitpunkt,p1,p2")
    ),
    "dashes, month first, no zero (influxdb-python#552)": Kind(
        table(local("%m-%d-%Y %H:%M:%S"), header="Time;p1;p2", by=";").replace("06-15", "6-15")
    ),
    "HOBOware (nationalparkservice/hobo-py#3)": Kind(
        '"Plot Title: roof"\n'
        + table(
            lambda time: f"4,{time.tz_convert('Etc/GMT+7'):%m/%d/%y %I:%M:%S %p}",
            header='"#","Date Time, GMT-07:00","p1","p2"',
        ),
        "in UTC-07:00, as the header says",
    ),
    "BoxCar (nationalparkservice/hobo-py#2)": Kind(
        table(local("%m/%d/%y %H:%M:%S.0"), header="Date Time\tp1\tp2", by="\t"), "tabs"
    ),
    "12 hours, the date apart (submersion-app/submersion#63)": Kind(
        table(local("7,%Y-%m-%d,%I:%M:%S %p"), header="Dive ,Date,Time,p1,p2")
    ),
    "microseconds (tsdat/tsdat#207)": Kind(table(local("%Y-%m-%d %H:%M:%S.%f"))),
    "months without zeros, the time apart (ORNL-AMO/AMO-Tools-Desktop#7772)": Kind(
        table(
            local("6/%d/%Y,%H:%M:%S"),
            header="Date (MM/DD/YYYY),Time (HH:MM),p1,p2",
        )
    ),
    "spaces after commas (grafana/grafana-csv-datasource#298)": Kind(
        table(
            lambda time: f"{time.tz_convert('Etc/GMT-1'):%Y-%m-%dT%H:%M:%S}+01:00",
            header="timestamp,           p1, p2",
            by=", ",
        )
    ),
    "a name before the time (veusz/veusz#653)": Kind(
        table(lambda time: f"monitor,{time:%Y-%m-%dT%H:%M:%S.%fZ}", header="name,time,p1,p2")
    ),
    "seconds since 1970 beside the time (hosseinmoein/DataFrame#305)": Kind(
        table(
            lambda time: f"{time:%Y-%m-%d %H:%M:%S},{time.value // 10**9}",
            header="INDEX::<DateTimeISO>,Timestamp::<int>,p1,p2",
        ),
        form=StatedForm(timezone="UTC"),
    ),
    "quoted milliseconds (sensebox/OER#11)": Kind(
        table(lambda time: f'"{time:%Y-%m-%dT%H:%M:%S.000Z}"', header='"createdAt","p1","p2"')
    ),
    "two spaces, ISO (CODAIT/pardata#73)": Kind(table(local("%Y-%m-%d  %H:%M:%S"))),
    "months first by name (mbakholdina/lib-tcpdump-processing#22)": Kind(
        table(lambda time: f'"{time.tz_convert("Etc/GMT-1"):%b %d, %Y %H:%M:%S.%f} CET"')
    ),
    "begin and end apart (DarwinsBuddy/WienerNetzeSmartmeter#168)": Kind(
        table(
            lambda time: (
                f"{local('%d.%m.%Y;%H:%M:%S')(time)};"
                f"{local('%H:%M:%S')(time + pd.Timedelta('10s'))}"
            ),
            header="Datum;Zeit von;Zeit bis;p1;p2;",
            number=comma,
            by=";",
            end=";",
        )
    ),
    "a line above, date and hhmm (VOLTTRON/openeis#8)": Kind(
        "Integrated surface data\n"
        + table(lambda time: f"725650,{time:%Y%m%d},{time:%H%M%S}", header="USAF,Date,HrMn,p1,p2"),
        form=StatedForm(timezone="UTC"),
    ),
    "points and milliseconds (stackblitz/bolt.new#7537)": Kind(
        table(local("%d.%m.%Y %H:%M:%S.000"))
    ),
    "offset without a colon (tidyverse/readr#90)": Kind(
        table(lambda time: f"{time.tz_convert('Etc/GMT+5'):%Y-%m-%dT%H:%M:%S}-0500")
    ),
    "lines of the tool above (SBFspot/SBFspot#76)": Kind(
        "sep=;\nVersion CSV1|Tool SBFspot3.9.7|Linebreaks CR/LF|Delimiter semicolon\n\n"
        + table(local("%d/%m/%Y %H:%M:%S"), header="Time;p1;p2", number=comma, by=";"),
        "the header is line 4",
    ),
    "years of two digits": Kind(
        table(local("%d.%m.%y %H:%M:%S"), header="time;p1;p2", number=comma, by=";")
    ),
    "a zone with summer time": Kind(
        table(lambda time: f"{time.tz_convert('America/Denver'):%Y-%m-%d %H:%M:%S}"),
        "taken as America/Denver",
        form=StatedForm(timezone="America/Denver"),
    ),
    "day first, stated": Kind(
        table(lambda time: f"{time:%d/%m/%Y %H:%M:%S}Z").replace("15/06", "05/06"),
        form=DAY_FIRST,
    ),
}


MISSING_WORDS = (
    *("", "NaN", "nan", "NA", "N/A", "#N/A", "NAN", "null", "NULL", "None", "-", "--", "No Data"),
    *("#DIV/0!", "<NA>", "unavailable", "unknown", "-999", "-9999", "-9999.9", "-99999", "-99.9"),
)


def read(folder: Path, kind: Kind, max_gap_s: float | None = 60.0) -> Irradiance:
    raw = kind.text if isinstance(kind.text, bytes) else kind.text.encode()
    (folder / "ghi.csv").write_bytes(raw)
    (folder / "positions.csv").write_text(kind.positions, encoding="utf-8")
    ghi, positions = folder / "ghi.csv", folder / "positions.csv"
    return read_measured_ghi(ghi, positions, None, max_gap_s, kind.form)


@pytest.mark.parametrize("name", READ)
def test_a_kind_of_file_is_read_and_its_assumptions_are_stated(tmp_path: Path, name: str) -> None:
    kind = READ[name]
    with warnings.catch_warnings():
        warnings.filterwarnings("error", "Could not infer format")
        found = read(tmp_path, kind)
    assert list(found.times) == list(
        TIMES if "stated" not in name or "day" not in name else TIMES - pd.Timedelta("10D")
    )
    np.testing.assert_allclose(found.ghi_wm2.to_numpy(), VALUES, rtol=1e-9)
    said = " ".join(found.report)
    assert kind.said in said
    if name == "plain":
        assert said == ""


@pytest.mark.parametrize("word", MISSING_WORDS)
def test_words_and_numbers_for_missing_values_are_filled_and_counted(
    tmp_path: Path, word: str
) -> None:
    found = read(tmp_path, Kind(with_cell(word)))
    np.testing.assert_allclose(found.ghi_wm2.to_numpy(), VALUES)
    assert "1 of 24 values were missing, in gaps of at most 10 s" in " ".join(found.report)
    with pytest.raises(InputError, match=r"ghi.csv: line 7, column 'p1': expected a number"):
        read(tmp_path, Kind(with_cell(word)), max_gap_s=None)


REFUSED = {
    "both decimal marks": (
        Kind(table(header="time;p1;p2", by=";").replace(";650;", ";65,5;")),
        "expected one decimal mark",
    ),
    "commas twice (InfluxDBStudio#22)": (
        Kind(table(number=lambda value: f"{value:.1f}".replace(".", ","))),
        "expected",
    ),
    "one column with commas (open-plan#444)": (Kind("p1\n600,1\n601,2\n"), "expected"),
    "day or month": (
        Kind(table(lambda time: f"{time:%m/%d/%Y %H:%M:%S}").replace("06/15", "06/05")),
        "--dates",
    ),
    "no zone": (
        Kind(table(lambda time: f"{time:%Y-%m-%d %H:%M:%S}"), form=StatedForm()),
        "--timezone",
    ),
    "watts or kilowatts": (Kind(table(values=VALUES / 1000.0)), "--unit"),
    "another unit": (Kind(table(header="time,p1 [°C],p2 [°C]")), "expected W/m2 or kW/m2, got °C"),
    "energy": (Kind(table(header="time,p1 [kWh/m2],p2 [kWh/m2]")), "got kWh/m2"),
    "no times": (Kind(table(lambda time: "roof", header="place,p1,p2")), "expected"),
    "a step that changes": (Kind(table().replace("19:00:50Z", "19:00:55Z")), "line 7"),
    "a time twice": (Kind(table().replace("19:00:50Z", "19:00:40Z")), "line 7"),
    "a word": (Kind(with_cell("lots")), "line 7, column 'p1': expected a number in W/m2"),
    "far below zero by day": (Kind(with_cell("-21")), "line 7, column 'p1': expected -20 to 2000"),
    "too bright": (Kind(with_cell("2400")), "line 7, column 'p1'"),
    "an excel file": (Kind(b"PK\x03\x04" + bytes(40)), "save the sheet as CSV"),
    "a compressed file": (Kind(b"\x1f\x8b\x08" + bytes(40)), "unpack it first"),
    "an empty file": (Kind(b""), "empty"),
    "a line too long": (Kind(table().replace(",650,", ",650,1,1,")), "line 7"),
    "the hour that is skipped": (
        Kind(
            table(lambda time: f"2024-03-10 02:{time:%M:%S}"),
            form=StatedForm(timezone="America/Denver"),
        ),
        "line 2, column 'time': expected a time that the clocks of America/Denver show once",
    ),
    "the hour that comes twice": (
        Kind(
            table(lambda time: f"2024-11-03 01:{time:%M:%S}"),
            form=StatedForm(timezone="America/Denver"),
        ),
        "that the clocks of America/Denver show once",
    ),
    "a day of the year without a year (NREL MIDC)": (
        Kind(table(local("%j,%H:%M:%S"), header="DOY,MST,p1,p2")),
        "line 2, column 'MST': expected a time stamp",
    ),
    "times of day alone": (
        Kind(table(local("%H:%M:%S"))),
        "line 2, column 'time': expected a time stamp",
    ),
    "no such day of the year": (
        Kind(table(lambda time: f"2024,367,{time:%H:%M:%S}", header="Year,DOY,Time,p1,p2")),
        "line 2, column 'Year': expected a time stamp",
    ),
    "points between date and time (borealis#332)": (
        Kind(table(local("%Y%m%d.%H%M%S.000000"))),
        "line 2, column 'time': expected a time stamp",
    ),
    "month and day alone (naiveproxy#356)": (
        Kind(table(local("%m%d/%H%M%S"))),
        "line 1: expected a header",
    ),
    "an ordinal date (lnav#1321)": (Kind(table(local("%Y-%jT%H:%M:%S"))), "line 1: expected"),
    "annotated (influxdata/docs-v2#417)": (Kind(annotated()), "irradiance.stations"),
    "a space behind the sign (gw-pem/kagra-pem#201)": (
        Kind(
            table(
                local("1\t%Y/%m/%d\t%H:%M:%S\t0"),
                header="NO.\tDate\tTime\tus\tp1\tp2",
                number=lambda value: f"+ {value:g}",
                by="\t",
            )
        ),
        "line 1: expected a header",
    ),
    "no header (CapnBry/HeaterMeter#47)": (
        Kind(table(lambda time: f"{time.value // 10**9},nan", header="").lstrip()),
        "irradiance.stations",
    ),
    "a zone that no table has (elastic/kibana#79540)": (
        Kind(table(local('"%d.%m.%Y %H:%M:%S MESZ"'))),
        "line 2, column 'time': expected a time stamp",
    ),
    "a zone glued to the time (CorpGlory/csv2influx#8)": (
        Kind(table(local("%Y-%m-%d %H:%M:%SGMT-04:00"))),
        "line 2, column 'time': expected a time stamp",
    ),
    "offset and zone (astronomer/astronomer#938)": (
        Kind(table(local("%Y-%m-%dT%H:%M:%S.000000000+-0500 US/Eastern"))),
        "line 2, column 'time': expected a time stamp",
    ),
    "digits before the clock (panodata/dwdweather2#17)": (
        Kind(
            table(
                lambda time: f"5856;{time:%Y%m%d%H:%M}",
                header="STATIONS_ID;MESS_DATUM;p1;p2;eor",
                by=";",
                end=";eor",
            )
        ),
        "line 1: expected a header",
    ),
    "a colon between date and time (NatLabRockies/SAM#2104)": (
        Kind(table(lambda time: f"{time:%Y%m%d:%H%M}")),
        "line 1: expected a header",
    ),
    "points in the clock (bskinn/excel-csvexporter#34)": (
        Kind(table(local("%d.%m.%Y %H.%M.%S"), header="time;p1;p2", by=";")),
        "line 2, column 'time': expected a time stamp",
    ),
    "more commas than the header (tomhollander/PowerwallCompanion#32)": (
        Kind(table().replace(",650,", ",650,5,")),
        "line 7: expected 3 values as in the header",
    ),
    "lux (gjr80/weewx-gw1000#33)": (
        Kind(table(header="time,p1 [lux],p2 [lux]")),
        "expected W/m2 or kW/m2, got lux",
    ),
    "an hour twice where no clock was put back (pvlib/pvanalytics#104)": (
        Kind(table().replace("19:01:", "19:00:")),
        "line 8, column 'time': expected times in one step",
    ),
    "times in the header (home-assistant/frontend#20578)": (
        Kind("entity_id,type,unit,2024-06-15T19:00:00.000Z,2024-06-15T19:00:10.000Z\np1,x,W,6,7\n"),
        "line 1: expected",
    ),
    "a year of three digits (OpenEnergyPlatform/open-MaStR#800)": (
        Kind(table().replace("2024-06-15T19:00:50", "205-06-15T19:00:50")),
        "line 7, column 'time': expected a time stamp",
    ),
    "a missing station": (Kind(table(header="time,p1,p3")), "for p2"),
    "irregular, without header (Rello/analytics#357)": (
        Kind("p1,2023-06-19 14:57:32.418625,0.619\np1,2023-06-19 14:57:34.951757,0.606\n"),
        "expected",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_wrong_file_is_refused_with_the_line_and_the_option(tmp_path: Path, name: str) -> None:
    kind, place = REFUSED[name]
    with pytest.raises(InputError) as caught:
        read(tmp_path, kind)
    assert place in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_offsets_at_night_are_set_to_zero_and_counted(tmp_path: Path) -> None:
    night = TIMES - pd.Timedelta("12h")
    values = np.where(VALUES > 650.0, -10.3, -24.0)
    found = read(tmp_path, Kind(table(times=night, values=values)))
    assert not found.ghi_wm2.to_numpy().any()
    assert "set to 0: 24 of the values, from -24 W/m2 up" in " ".join(found.report)


def test_midnight_may_be_written_as_24(tmp_path: Path) -> None:
    times = pd.date_range("2024-06-15 23:00", periods=12, freq="10min", tz="UTC")
    text = table(
        times=times, values=np.zeros((12, 2)), stamp=lambda time: f"{time:%Y/%m/%d %H:%M}Z"
    )
    text = text.replace("2024/06/16 00:00Z", "2024/06/15 24:00Z").replace("Z", "+00")
    found = read(tmp_path, Kind(text, form=StatedForm(stamps="begin")))
    assert list(found.times) == list(times)


@pytest.mark.parametrize("stamps", ["begin", "middle", "end"])
def test_the_sun_tells_which_end_of_an_interval_a_stamp_names(tmp_path: Path, stamps: str) -> None:
    step = pd.Timedelta("15min")
    begins = pd.date_range("2024-06-15 12:00", periods=56, freq=step, tz="UTC")
    fine = pd.date_range(begins[0], periods=56 * 15, freq="1min")
    place = pd.DataFrame({"lat": [35.05], "lon": [-106.54]})
    means = 0.97 * clear_ghi(fine, place).reshape(56, 15).mean(axis=1)
    shift = {"begin": 0.0, "middle": 0.5, "end": 1.0}[stamps]
    text = table(times=begins + shift * step, values=np.column_stack([means, means + 1.0]))
    found = read(tmp_path, Kind(text))
    assert list(found.times) == list(begins)
    assert found.stamps == stamps
    assert f"names the {stamps} of its interval, by the sun's path" in " ".join(found.report)
    stated = read(tmp_path, Kind(text.replace("time", "period_end"), form=StatedForm()))
    assert stated.stamps == "end"
    asked = read(tmp_path, Kind(text, form=StatedForm(stamps="middle")))
    assert list(asked.times) == list(begins + (shift - 0.5) * step)
