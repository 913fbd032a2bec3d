"""Plan files (JSON): `write_plan`, `load_plan`, `write_timings`.

A plan file holds all that executing, viewing and explaining the plan needs. Times are not in it but beside it, so that
the same problem and seed give the same bytes.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micah_plan import __version__
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.input_memory import with_memory_states
from micah_plan.documents.arm_values import arm_data, arm_of
from micah_plan.documents.located import Located
from micah_plan.documents.model_data import model_data
from micah_plan.documents.model_document import ModelDocument
from micah_plan.documents.model_values import automaton_of
from micah_plan.documents.plan_document import PLAN_FORMAT, PlanDocument, TrajectoryDocument
from micah_plan.documents.problem_document import ProblemDocument
from micah_plan.documents.problem_values import problem_data, problem_of
from micah_plan.documents.validation import check_format, validated
from micah_plan.errors import InputError
from micah_plan.files import read_bytes, replace_file
from micah_plan.task.plan import Candidate, Finding, Plan, Trajectory
from micah_plan.task.problem import Problem

LARGEST_PLAN_BYTES = 64 * 1024 * 1024
_DEEPEST = 40
_AGAIN = "solve the problem again"


@dataclass(frozen=True, eq=False)
class StoredPlan:
    """A plan as read from a file, with the problem that it was made for.

    Attributes:
        plan: without timings.
        problem: with its automaton; its `source` is the problem file's name without the folder.
        version: of the micah_plan that wrote the file.
        source: the plan file.
    """

    plan: Plan
    problem: Problem
    version: str
    source: str

    @property
    def automaton(self) -> HybridAutomaton:
        return self.problem.automaton


def plan_text(plan: Plan, problem: Problem) -> str:
    """The text of a plan file.

    Raises:
        InputError: if a number of the plan is not finite, its sizes disagree, or the model cannot be written.
    """
    data = _plan_data(plan, problem)
    _check_numbers(data, "plan")
    data["digest"] = _digest(data)
    stored = _stored(Located(data, "plan"))
    if replace(stored.problem, source=problem.source) != problem:
        raise InputError("plan: the problem cannot be written exactly", remedy="name each coordinate of the goal once")
    lines = (f"{json.dumps(key)}: {json.dumps(value, ensure_ascii=False)}" for key, value in data.items())
    return "{\n" + ",\n".join(lines) + "\n}\n"


def write_plan(plan: Plan, problem: Problem, path: str | Path) -> None:
    """Write a plan file, at once or not at all.

    Raises:
        InputError: as for `plan_text`, and if the file cannot be written.
    """
    replace_file(path, plan_text(plan, problem).encode())


def timings_path(path: str | Path) -> Path:
    """Where the times of a plan file are kept: ``PLAN.timings.json`` beside ``PLAN.json``."""
    return Path(path).with_suffix(".timings.json")


def write_timings(plan: Plan, path: str | Path) -> None:
    """Write the plan's times [s] by stage beside the plan file at `path`.

    Raises:
        InputError: if the file cannot be written.
    """
    replace_file(timings_path(path), (json.dumps(dict(plan.timings), indent=2) + "\n").encode())


def load_plan(path: str | Path) -> StoredPlan:
    """The plan and problem that a file holds; a plan of any outcome can be read.

    Raises:
        InputError: if the file is no plan, was changed after it was written, or does not agree with itself.
    """
    content, source = read_bytes(path, LARGEST_PLAN_BYTES), str(path)
    located = Located(_parsed(content, source), source)
    check_format(located, PlanDocument)
    if located.data.get("digest") != _digest(located.data):
        problem = "the content does not match its digest: it was changed or damaged after it was written"
        raise InputError(problem, source=source, where="key 'digest'", remedy=_AGAIN)
    return _stored(located)


def require_executable(stored: StoredPlan) -> Trajectory:
    """The trajectory of a plan that solves its problem.

    Raises:
        InputError: if the plan has another outcome.
    """
    plan = stored.plan
    if plan.outcome != "solved" or plan.trajectory is None:
        problem = f"plan has outcome {plan.outcome}: {plan.reason}"
        raise InputError(problem, source=stored.source or None, remedy="only a solved plan can be executed")
    return plan.trajectory


def _plan_data(plan: Plan, problem: Problem) -> dict[str, Any]:
    trajectory = plan.trajectory
    return {
        "format": PLAN_FORMAT,
        "version": __version__,
        "digest": "",
        "outcome": plan.outcome,
        "reason": plan.reason,
        "mode_sequence": list(plan.mode_sequence),
        "cost": _number(plan.cost),
        "goal_error": _number(plan.goal_error),
        "goal_std": _number(plan.goal_std),
        "success_probability": _number(plan.success_probability),
        "success_interval": None if plan.success_interval is None else [float(end) for end in plan.success_interval],
        "verification_trials": int(plan.verification_trials),
        "seed": int(plan.seed),
        "candidates": [
            {
                "modes": list(candidate.modes),
                "search_cost": _number(candidate.search_cost),
                "cost": _number(candidate.cost),
                "message": candidate.message,
            }
            for candidate in plan.candidates
        ],
        "findings": [{**asdict(finding), "modes": list(finding.modes)} for finding in plan.findings],
        **({"warnings": list(plan.warnings)} if plan.warnings else {}),
        "trajectory": None
        if trajectory is None
        else {
            "modes": list(trajectory.modes),
            "means": trajectory.means.tolist(),
            "factors": trajectory.factors.tolist(),
            "inputs": trajectory.inputs.tolist(),
            "gains": trajectory.gains.tolist(),
            "is_transition": trajectory.is_transition.tolist(),
        },
        **({} if plan.arm is None else {"arm": arm_data(plan.arm)}),
        "problem_file": Path(problem.source).name,
        "digests": dict(problem.digests),
        "problem": problem_data(problem, "model"),
        "model": model_data(problem.automaton),
    }


def _number(value: float | None) -> float | None:
    return None if value is None else float(value)


def _check_numbers(data: Any, path: str) -> None:
    """JSON has no NaN: say which number it would have been."""
    if isinstance(data, float) and not np.isfinite(data):
        raise InputError(f"{path} is not finite: {data}", remedy="report this as a bug of the planner")
    items = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for key, value in items:
        _check_numbers(value, f"{path}.{key}")


def _digest(data: dict[str, Any]) -> str:
    """SHA-256 of the content in a fixed formatting, without the digest itself; the order of keys counts."""
    content = {key: value for key, value in data.items() if key != "digest"}
    return hashlib.sha256(json.dumps(content, separators=(",", ":")).encode()).hexdigest()


def _parsed(content: bytes, source: str) -> Any:
    try:
        data = json.loads(content.decode("utf-8"))
    except UnicodeDecodeError:
        raise InputError("expected a plan (JSON), found bytes that are no text", source=source, remedy=_AGAIN) from None
    except json.JSONDecodeError as error:
        where, problem = f"line {error.lineno}", f"not valid JSON, damaged or cut short: {error.msg}"
        raise InputError(problem, source=source, where=where, remedy=_AGAIN) from None
    except (RecursionError, ValueError):  # ValueError: an integer of thousands of digits
        raise InputError("not a plan: nested too deep or a number too long", source=source, remedy=_AGAIN) from None
    if _depth(data) > _DEEPEST:
        raise InputError("not a plan: nested too deep", source=source, remedy=_AGAIN)
    return data


def _depth(data: Any) -> int:
    """Levels of nesting, counted without recursion."""
    depth, level = 0, [data]
    while level:
        depth += 1
        level = [
            child
            for item in level
            if isinstance(item, dict | list)
            for child in (item.values() if isinstance(item, dict) else item)
        ]
    return depth


def _stored(located: Located) -> StoredPlan:
    document = validated(located, PlanDocument)
    model = replace(located, data=document.model, prefix=("model",))
    automaton = automaton_of(validated(model, ModelDocument), model)
    stated = replace(located, data=document.problem, prefix=("problem",))
    problem = problem_of(validated(stated, ProblemDocument), automaton, stated, Path(located.source).parent)
    problem = replace(problem, source=document.problem_file, digests=document.digests)
    trajectory = None if document.trajectory is None else _trajectory(document.trajectory, automaton, located)
    if (trajectory is None) == (document.outcome != "no_plan"):
        found = "no trajectory" if trajectory is None else "a trajectory"
        raise located.error(("trajectory",), f"outcome {document.outcome} with {found}", _AGAIN)
    plan = Plan(
        outcome=document.outcome,
        reason=document.reason,
        trajectory=trajectory,
        candidates=tuple(
            Candidate(tuple(item.modes), item.search_cost, item.cost, item.message) for item in document.candidates
        ),
        cost=document.cost,
        goal_error=document.goal_error,
        goal_std=document.goal_std,
        success_probability=document.success_probability,
        success_interval=None
        if document.success_interval is None
        else (document.success_interval[0], document.success_interval[1]),
        findings=tuple(Finding(**{**item.model_dump(), "modes": tuple(item.modes)}) for item in document.findings),
        warnings=tuple(document.warnings),
        verification_trials=document.verification_trials,
        seed=document.seed,
        arm=None if trajectory is None else arm_of(document.arm, len(trajectory.modes), located),
    )
    if list(plan.mode_sequence) != document.mode_sequence:
        raise located.error(("mode_sequence",), "does not agree with the trajectory's modes", _AGAIN)
    return StoredPlan(plan, problem, document.version, located.source)


def _trajectory(document: TrajectoryDocument, automaton: HybridAutomaton, located: Located) -> Trajectory:
    knots, n, m = len(document.modes), automaton.n, automaton.m
    if document.means and len(document.means[0]) != n:
        n = with_memory_states(automaton).n
    names = automaton.mode_names
    for i, name in enumerate(document.modes):
        if name not in names:
            raise located.unknown(("trajectory", "modes", i), "mode", name, names)

    def array(key: str, *shape: int) -> NDArray[np.float64]:
        value = getattr(document, key)
        try:
            result = np.array(value, dtype=np.float64).reshape(shape if not value else np.shape(value))
        except ValueError:
            raise located.error(("trajectory", key), f"expected shape {shape}, found ragged rows", _AGAIN) from None
        if result.shape != shape:
            raise located.error(("trajectory", key), f"expected shape {shape}, found {result.shape}", _AGAIN)
        return result

    return Trajectory(
        modes=tuple(document.modes),
        means=array("means", knots, n),
        factors=array("factors", knots, n, n),
        inputs=array("inputs", knots - 1, m),
        gains=array("gains", knots - 1, m, n),
        is_transition=array("is_transition", knots - 1).astype(bool),
    )
