"""Results of the cases: a table in CSV or Parquet, and a separate table of timings.

With `recording.parquet_file` the only importer of pyarrow.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, Literal

from micah_plan.errors import MissingDependencyError
from micah_plan.task.sweep import Case, Sweep

Outcome = Literal["solved", "no_plan", "not_verified", "bad_input", "error", "worker_died"]

Columns = dict[str, tuple[str, list[Any]]]
"""Type ("int64", "double" or "string") and cells, by name."""

_STAGES = ("load", "solve", "execute", "total")

_KINDS = {"outcome": "string", "reason": "string", "modes": "string", "steps": "int64", "successes": "int64"}


@dataclass(frozen=True)
class CaseResult:
    """One row of the table.

    Attributes:
        outcome: of the plan; or why there is none: ``"bad_input"`` (the values make no possible problem), ``"error"``
            (an exception) or ``"worker_died"`` (again and again).
        reason: one sentence.
        modes: the plan's mode sequence.
        steps: control steps that the plan takes.
        cost, goal_error, goal_std, success_probability: as in `task.plan.Plan` [-, rad or m, rad or m, -].
        successes: trials that reached the goal; None if none were executed.
        final_error_mean, final_error_std, final_error_max: over the trials [rad or m].
    """

    outcome: Outcome
    reason: str
    modes: tuple[str, ...] = ()
    steps: int | None = None
    cost: float | None = None
    goal_error: float | None = None
    goal_std: float | None = None
    success_probability: float | None = None
    successes: int | None = None
    final_error_mean: float | None = None
    final_error_std: float | None = None
    final_error_max: float | None = None


@dataclass(frozen=True)
class CaseRun:
    """A result with the measurements that vary between runs.

    Attributes:
        seconds: wall-clock time by stage: `load`, `solve`, `execute` and `total`.
        attempts: how often it was begun; more than 1 if workers died over it.
    """

    result: CaseResult
    seconds: Mapping[str, float] = field(default_factory=dict)
    attempts: int = 1


NUMBERS = tuple(item.name for item in fields(CaseResult) if _KINDS.get(item.name) != "string")


def sweep_timings_path(output: Path) -> Path:
    """Path of the timings of a table, in the same folder, so that equal sweeps give equal tables."""
    return output.with_name(f"{output.stem}.timings{output.suffix}")


def results_table(sweep: Sweep, cases: Sequence[Case], results: Sequence[CaseResult], suffix: str) -> bytes:
    """The bytes of the results table.

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
    for item in fields(CaseResult):
        kind = _KINDS.get(item.name, "double")
        cells = [getattr(result, item.name) for result in results]
        columns[item.name] = kind, [" > ".join(c) if item.name == "modes" else _cell(c, kind) for c in cells]
    return _written(columns, suffix)


def timings_table(runs: Sequence[CaseRun], suffix: str) -> bytes:
    """The bytes of the timings table: seconds by stage, and number of attempts.

    Raises:
        MissingDependencyError: for Parquet without pyarrow.
    """
    columns: Columns = {"case": ("int64", list(range(len(runs))))}
    for stage in _STAGES:
        columns[f"{stage}_s"] = "double", [run.seconds.get(stage) for run in runs]
    columns["attempts"] = "int64", [run.attempts for run in runs]
    return _written(columns, suffix)


def _kind(values: Sequence[Any]) -> str:
    """The type of a column of grid values: double for numbers, else string."""
    numbers = all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)
    return "double" if numbers else "string"


def _cell(value: Any, kind: str) -> Any:
    if value is None and kind != "string":
        return None
    if kind == "double":
        return float(value)
    return value if kind == "int64" or isinstance(value, str) else json.dumps(value, sort_keys=True)


def _written(columns: Columns, suffix: str) -> bytes:
    """The bytes of a table; CSV numbers are shortest without loss, missing ones empty."""
    if suffix.lower() == ".parquet":
        return _parquet(columns)
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
        raise MissingDependencyError.of("parquet", "Parquet files need pyarrow (.csv files do not)") from None
    schema = pyarrow.schema([(name, pyarrow.type_for_alias(kind)) for name, (kind, _) in columns.items()])
    table = pyarrow.table({name: cells for name, (_, cells) in columns.items()}, schema=schema)
    sink = pyarrow.BufferOutputStream()
    parquet.write_table(table, sink)
    content: bytes = sink.getvalue().to_pybytes()
    return content
