"""Parquet logs, columns of lists included."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from excitant.exceptions import BadRecording
from excitant.identify.importers.sources import Source, unreadable

_BUFFER = 1 << 18  # bytes of a column at a time: row groups may be larger than memory


def parquet_source(path: Path) -> Source:
    """The log in a Parquet file; a column of lists becomes ``name[0]``, ``name[1]``, ..."""
    with pq.ParquetFile(path) as file:
        schema = file.schema_arrow
        lists = [field.name for field in schema if _is_list(field.type)]
        first = next(file.iter_batches(1, columns=lists), None) if lists else None
    widths = {name: _width(schema.field(name).type, first, name) for name in lists}
    names: list[str] = []
    for field in schema:
        width = widths.get(field.name)
        names += [field.name] if width is None else [f"{field.name}[{k}]" for k in range(width)]

    def frames(rows: int | None, columns: Sequence[str] | None) -> Iterator[pd.DataFrame]:
        logged = None
        if columns is not None:
            logged = [f.name for f in schema if f.name in columns or f.name in widths]
        try:
            with pq.ParquetFile(
                path, pre_buffer=False, buffer_size=_BUFFER, page_checksum_verification=True
            ) as file:
                if rows is None:
                    yield _frame(file.read(columns=logged, use_threads=False), widths, path)
                    return
                for batch in file.iter_batches(rows, columns=logged, use_threads=False):
                    yield _frame(pa.Table.from_batches([batch]), widths, path)
        except (pa.ArrowException, OSError, ValueError) as error:
            raise unreadable(path, error) from None

    return replace(Source(str(path), tuple(names), frames))


def _is_list(kind: Any) -> bool:
    return bool(
        pa.types.is_list(kind) or pa.types.is_large_list(kind) or pa.types.is_fixed_size_list(kind)
    )


def _width(kind: Any, first: Any, name: str) -> int:
    if pa.types.is_fixed_size_list(kind):
        return int(kind.list_size)
    value = first.column(first.schema.get_field_index(name))[0].as_py() if first else None
    return len(value or ())


def _frame(table: Any, widths: dict[str, int], path: Path) -> pd.DataFrame:
    columns: list[Any] = []
    names: list[str] = []
    for field, column in zip(table.schema, table.columns, strict=True):
        width = widths.get(field.name)
        if width is None:
            columns.append(column.to_pandas(ignore_metadata=True))
            names.append(field.name)
            continue
        values = column.to_pylist()
        for row, value in enumerate(values):
            if value is None or len(value) != width:
                raise BadRecording(
                    path, f"holds {len(value or ())} values, the first row {width}; remove it",
                    row=row, column=field.name,
                )  # fmt: skip
        columns += [pd.Series([value[k] for value in values]) for k in range(width)]
        names += [f"{field.name}[{k}]" for k in range(width)]
    frame = pd.concat(columns, axis=1) if columns else pd.DataFrame()
    return frame.set_axis(names, axis=1)
