"""What became of a case: a row of the table, and how long it took, which is kept apart from it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from math import isfinite
from typing import Any, Literal, get_args

Outcome = Literal["solved", "no_plan", "not_verified", "bad_input", "error", "worker_died"]


@dataclass(frozen=True)
class CaseResult:
    """One row of the table.

    Attributes:
        outcome: of the plan; or why there is none: ``"bad_input"`` (the values make no possible problem), ``"error"``
            (an exception) or ``"worker_died"`` (again and again).
        reason: one sentence.
        modes: the plan's mode sequence.
        cost, goal_error, goal_std, success_probability: as in `planning.plan.Plan` [-, rad or m, rad or m, -].
        successes: trials that reached the goal; None if none were executed.
        final_error_mean, final_error_std, final_error_max: over the trials [rad or m].
    """

    outcome: Outcome
    reason: str
    modes: tuple[str, ...] = ()
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
    """A result with what differs from run to run.

    Attributes:
        seconds: wall-clock time by stage: `load`, `solve`, `execute` and `total`.
        attempts: how often it was begun; more than 1 if workers died over it.
    """

    result: CaseResult
    seconds: Mapping[str, float] = field(default_factory=dict)
    attempts: int = 1


NUMBERS = tuple(item.name for item in fields(CaseResult) if item.name not in ("outcome", "reason", "modes"))


def run_data(run: CaseRun) -> dict[str, Any]:
    """Plain data of a run; `run_of` gives the same run again, to the last bit."""
    return asdict(run)


def run_of(data: Any) -> CaseRun:
    """The run that plain data describes.

    Raises:
        ValueError: if it describes none.
    """
    if not isinstance(data, dict) or set(data) != {item.name for item in fields(CaseRun)}:
        raise ValueError("expected a result, seconds and attempts")
    result, seconds, attempts = data["result"], data["seconds"], data["attempts"]
    if not isinstance(result, dict) or set(result) != {item.name for item in fields(CaseResult)}:
        raise ValueError("expected a result with all its columns")
    if result["outcome"] not in get_args(Outcome) or not isinstance(result["reason"], str):
        raise ValueError("expected an outcome and a reason")
    if not isinstance(result["modes"], list) or not all(isinstance(mode, str) for mode in result["modes"]):
        raise ValueError("expected a list of modes")
    if not all(result[name] is None or _is_number(result[name]) for name in NUMBERS):
        raise ValueError("expected finite numbers")
    if not isinstance(seconds, dict) or not all(map(_is_number, seconds.values())) or type(attempts) is not int:
        raise ValueError("expected seconds and a count")
    return CaseRun(CaseResult(**{**result, "modes": tuple(result["modes"])}), seconds, attempts)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and isfinite(value)
