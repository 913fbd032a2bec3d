"""The table of a sweep as CSV or Parquet: one row per case, in the order of the cases. The only importer of pyarrow."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from micah_plan.errors import MissingDependencyError
from micah_plan.sweep.result import NUMBERS, CaseResult, CaseRun
from micah_plan.task.sweep import Case, Sweep

Columns = dict[str, tuple[str, list[Any]]]
_STAGES = ("load", "solve", "execute", "total")


def timings_path(output: Path) -> Path:
    """Where the times of a table lie: beside it, so that tables of the same sweep are the same bytes."""
    return output.with_name(f"{output.stem}.timings{output.suffix}")


def results_table(sweep: Sweep, cases: Sequence[Case], results: Sequence[CaseResult], suffix: str) -> bytes:
    """The content of the file of results.

    Args:
        cases, results: one each per row.
        suffix: ``".csv"`` or ``".parquet"``.

    Raises:
        MissingDependencyError: for Parquet without pyarrow.
    """
    columns: Columns = {
        "case": ("int64", list(range(len(cases)))),
        "problem": ("string", [case.problem for case in cases]),
    }
    for i, (key, values) in enumerate(sweep.grid):
        kind = _kind(values)
        columns[key] = kind, [_cell(case.overrides[i][1], kind) for case in cases]
    columns["seed"] = "int64", [case.seed for case in cases]
    columns["outcome"] = "string", [result.outcome for result in results]
    columns["reason"] = "string", [result.reason for result in results]
    columns["modes"] = "string", [" > ".join(result.modes) for result in results]
    for name in NUMBERS:
        kind = "int64" if name == "successes" else "double"
        columns[name] = kind, [_cell(getattr(result, name), kind) for result in results]
    return _written(columns, suffix)


def timings_table(runs: Sequence[CaseRun], suffix: str) -> bytes:
    """The content of the file of times [s], by stage, and of how often each case was begun.

    Raises:
        MissingDependencyError: for Parquet without pyarrow.
    """
    columns: Columns = {"case": ("int64", list(range(len(runs))))}
    for stage in _STAGES:
        columns[f"{stage}_s"] = "double", [run.seconds.get(stage) for run in runs]
    columns["attempts"] = "int64", [run.attempts for run in runs]
    return _written(columns, suffix)


def _kind(values: Sequence[Any]) -> str:
    """The type of a column that holds values of the grid: numbers as such, all else as text."""
    numbers = all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)
    return "double" if numbers else "string"


def _cell(value: Any, kind: str) -> Any:
    if value is None and kind != "string":
        return None
    if kind == "double":
        return float(value)
    return value if kind == "int64" or isinstance(value, str) else json.dumps(value, sort_keys=True)


def _written(columns: Columns, suffix: str) -> bytes:
    return _parquet(columns) if suffix.lower() == ".parquet" else _csv(columns)


def _csv(columns: Columns) -> bytes:
    """Numbers as short as they can be without losing a bit; nothing where there is none."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(zip(*(cells for _, cells in columns.values()), strict=True))
    return text.getvalue().encode()


def _parquet(columns: Columns) -> bytes:
    try:
        import pyarrow
        from pyarrow import parquet
    except ModuleNotFoundError:
        raise MissingDependencyError(
            "Parquet files need pyarrow: pip install 'micah-plan[parquet]', or write a .csv file"
        ) from None
    schema = pyarrow.schema([(name, getattr(pyarrow, _ARROW[kind])()) for name, (kind, _) in columns.items()])
    table = pyarrow.table({name: cells for name, (_, cells) in columns.items()}, schema=schema)
    sink = pyarrow.BufferOutputStream()
    parquet.write_table(table, sink)
    content: bytes = sink.getvalue().to_pybytes()
    return content


_ARROW = {"int64": "int64", "double": "float64", "string": "string"}
