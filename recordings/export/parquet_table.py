"""A tidy table as a Parquet file. This is the one module that needs pyarrow.

Rows are collected as columns, and written as a row group once there are enough of them: so no more
than one group of each table is in memory, and readers find groups of the size that they like.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import pyarrow as pa
import pyarrow.parquet as pq

from agents.plan import RunPlan
from bus_schemas.errors import InputError
from recordings.export.tables import Column, Row, Table

ROW_GROUP: Final = 65_536
"""Rows of a group: some megabytes."""


class ParquetTable:
    """A Parquet file that is being written.

    Parameters
    ----------
    path
        File to write; there is none yet.
    table
        Gives the columns.
    plan
        Of the run: gives the local time, and the names in the file's metadata.
    """

    def __init__(self, path: Path, table: Table, plan: RunPlan) -> None:
        self._name = table.name
        self._schema = pa.schema(
            [pa.field(column.name, _type(column, plan.timezone)) for column in table.columns],
            metadata={"heliarch.run_id": plan.run_id, "heliarch.plant": plan.plant},
        )
        texts = [column.name for column in table.columns if column.kind == "text"]
        # Names of nodes repeat, numbers hardly do: a dictionary of them would cost size and time.
        self._writer = pq.ParquetWriter(
            path, self._schema, compression="zstd", use_dictionary=texts
        )
        self._batches: list[pa.RecordBatch] = []
        self._rows = 0

    def write(self, rows: Sequence[Row]) -> None:
        """Take in some rows."""
        columns = zip(*rows, strict=True)
        try:
            arrays = [
                pa.array(cells, field.type)
                for cells, field in zip(columns, self._schema, strict=True)
            ]
        except (OverflowError, pa.ArrowInvalid) as error:
            raise InputError(f"{self._name}: {error}, accepted are integers of 64 bits") from None
        self._batches.append(pa.record_batch(arrays, schema=self._schema))
        self._rows += len(rows)
        if self._rows >= ROW_GROUP:
            self._write_group()

    def close(self) -> None:
        """Write what is left and close the file."""
        try:
            self._write_group()
        finally:
            self._writer.close()

    def _write_group(self) -> None:
        group = pa.Table.from_batches(self._batches, self._schema)
        self._batches, self._rows = [], 0
        if len(group):
            self._writer.write_table(group, row_group_size=len(group))


def _type(column: Column, timezone: str) -> pa.DataType:
    match column.kind:
        case "time":
            return pa.timestamp("ns", tz=timezone)
        case "integer":
            return pa.int64()
        case "number":
            return pa.float64()
        case "text":
            return pa.string()
