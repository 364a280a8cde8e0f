"""How fast real inverters answered, as a table."""

from __future__ import annotations

from collections.abc import Iterable

from studies.tables import Column, Table, key_column
from sunspec.process import DeviceAccount


def devices_tables(devices: Iterable[DeviceAccount]) -> list[Table]:
    """Return the table of a run's real inverters; none where it had none."""
    columns = (
        key_column("device"),
        *(
            Column(f"{what}{figure}", unit, decimals)
            for what in ("reads", "writes")
            for figure, unit, decimals in (("", "", 0), (" p50", "ms", 1), (" p99", "ms", 1))
        ),
        Column("late"),
        Column("refused"),
        Column("breaks"),
        Column("gone for", "s", 1),
    )
    rows = tuple(
        (
            device.node,
            *(device.reads.count, device.reads.p50_ms, device.reads.p99_ms),
            *(device.writes.count, device.writes.p50_ms, device.writes.p99_ms),
            *(device.late, device.refused, device.breaks, device.gone_s),
        )
        for device in devices
    )
    notes = (
        "how long it takes over Modbus to read all that is needed, and to write a limit",
        "late: readings that came after the end of their cycle",
        "gone for: since the link broke, of a device that was not back at the end of the run",
    )
    return [Table("Devices", columns, rows, notes)] if rows else []
