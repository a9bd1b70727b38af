"""Rows as CSV, Arrow and Parquet, written as they are read."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Iterator
from typing import IO, Any

from rcp_protocol.clock import iso
from rcp_recordings.columns import Column, cell, part
from rcp_recordings.rows import Interval, Row

__all__ = ["Rows", "as_arrow", "as_csv"]

_OWN = ("timestamp", "received", "seq", "from", "count")
_BATCH = 4096  # rows
_TYPES = {
    "number": "float64",
    "integer": "int64",
    "boolean": "bool_",
    "string": "string",
    "json": "string",
}
Rows = Iterator[Row] | Iterator[Interval]


def _head(columns: list[Column], *, summary: bool) -> list[tuple[str, str]]:
    """List the names of a table's columns with their kinds."""
    names = [(_named(column.name), column.kind) for column in columns]
    if not summary:
        return [("timestamp", "time"), ("received", "time"), ("seq", "integer"), *names]
    parts = [
        (f"{name}.{what}", "number")
        for name, kind in names
        if kind in ("number", "integer")
        for what in ("min", "max", "mean")
    ]
    return [("from", "time"), ("count", "integer"), *parts]


def _named(field: str) -> str:
    """Return the column of a field; the gateway's own columns keep their names."""
    return f"body.{field}" if field in _OWN else field or "body"


def _cells(row: Row | Interval, columns: list[Column]) -> list[Any]:
    if isinstance(row, Row):
        values = [cell(part(row.value, column.name), column.kind) for column in columns]
        return [row.timestamp, row.received, row.seq, *values]
    found: list[Any] = [row.start, row.samples]
    for column in columns:
        if column.kind in ("number", "integer"):
            found += [one.get(column.name) for one in (row.least, row.most, row.mean)]
    return found


def as_csv(rows: Rows, columns: list[Column], *, summary: bool, out: IO[bytes]) -> None:
    """Write rows as CSV (RFC 4180), times as ISO 8601."""
    text = io.TextIOWrapper(out, "utf-8", newline="", write_through=True)
    writer = csv.writer(text)
    head = _head(columns, summary=summary)
    times = [number for number, (_, kind) in enumerate(head) if kind == "time"]
    writer.writerow([name for name, _ in head])
    for row in rows:
        cells = _cells(row, columns)
        for number in times:
            cells[number] = iso(cells[number])
        writer.writerow([_safe(one) for one in cells])
    text.detach()


def _safe(value: Any) -> Any:
    """Keep a robot's text from being a formula where a table is opened."""
    if isinstance(value, bool):
        return "true" if value else "false"
    return f"'{value}" if isinstance(value, str) and value[:1] in ("=", "+", "-", "@") else value


def as_arrow(
    rows: Rows, columns: list[Column], *, summary: bool, parquet: bool, out: IO[bytes]
) -> None:
    """Write rows as an Arrow stream, or as a Parquet file."""
    import pyarrow as pa
    from pyarrow import ipc
    from pyarrow import parquet as pq

    head = _head(columns, summary=summary)
    types = {"time": pa.timestamp("ns", "UTC")} | {
        kind: getattr(pa, name)() for kind, name in _TYPES.items()
    }
    schema = pa.schema([(name, types[kind]) for name, kind in head])
    with (
        pa.PythonFile(out, mode="w") as sink,
        pq.ParquetWriter(sink, schema, compression="zstd")
        if parquet
        else ipc.new_stream(sink, schema) as writer,
    ):
        for batch in _batches(rows, columns):
            made = [
                pa.array(column, field.type)
                for column, field in zip(zip(*batch, strict=True), schema, strict=True)
            ]
            writer.write_batch(pa.record_batch(made, schema=schema))


def _batches(rows: Rows, columns: list[Column]) -> Iterable[list[list[Any]]]:
    batch: list[list[Any]] = []
    for row in rows:
        batch.append(_cells(row, columns))
        if len(batch) >= _BATCH:
            yield batch
            batch = []
    if batch:
        yield batch
