"""Plan files (JSON): a plan with the problem that it solves.

A plan file has everything for executing, viewing and explaining the plan. Times are in a separate file, so that the
same problem and seed give the same bytes.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AliasChoices, Field

from micah_plan import __version__
from micah_plan.arrays import ROUND_OFF
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.input_memory import with_memory_states
from micah_plan.documents.fields import (
    Count,
    Digest,
    Line,
    Lines,
    Listed,
    ModeName,
    ModeNames,
    Name,
    Names,
    NonNegative,
    Probability,
    Vector3,
)
from micah_plan.documents.layout import Document, Mark, Scope, doc, plain_data
from micah_plan.documents.located import Located
from micah_plan.documents.model import automaton_of_document, model_data, scope_of
from micah_plan.documents.problem import ProblemDocument, problem_data, problem_of_document
from micah_plan.documents.validation import check_format, validated
from micah_plan.errors import InputError, shown
from micah_plan.files import read_bytes, replace_file
from micah_plan.task.acceptance import executable_trajectory
from micah_plan.task.contradictions import disagreement
from micah_plan.task.plan import (
    ArmTrajectory,
    Candidate,
    Finding,
    Level,
    ModePurpose,
    Outcome,
    Plan,
    ReleasePlan,
    Trajectory,
)
from micah_plan.task.problem import Problem
from micah_plan.task.reason import Code

PLAN_FORMAT = "micah-plan/plan/1"
LARGEST_PLAN_BYTES = 64 * 1024 * 1024
_DEEPEST = 40
# Places and inputs are smaller, and so are gains: inputs per place.
_LARGEST = 1e9
_AGAIN = "solve the problem again"
_ARRAY = Mark(lambda rows, *_: np.array(rows, dtype=float))

Interval = Annotated[tuple[Probability, ...], Listed(2, 2)]


class CandidateDocument(Document):
    makes = Candidate

    modes: ModeNames = doc("Mode sequence.")
    search_cost: NonNegative = doc("Cost of its cheapest roadmap path.")
    cost: NonNegative | None = doc("Optimised cost; null if the optimisation failed.")
    message: str = doc("Result of its optimisation.")


class FindingDocument(Document):
    makes = Finding

    level: Level = doc("Level at which it was found.")
    code: Code | Literal[""] = doc("What is wrong, for programmes.", "")
    sentence: str = doc("What is wrong.")
    remedy: str = doc("The nearest change that could help.")
    modes: Names = doc("The mode sequence that it is about; empty: all.")
    mode: str = doc("Mode of the place; may be empty.")
    knot: Count | None = doc("Knot of the place.")
    constraint: str = doc("Name of the constraint that does not hold.")
    amount: float | None = doc("By how much it does not hold [unit].")
    room: float | None = doc("Available room [unit].")
    need: float | None = doc("Required room [unit].")
    unit: str = doc("Unit of amount, room and need.")


class ModePurposeDocument(Document):
    makes = ModePurpose

    mode: ModeName = doc("A mode of the plan, not the first.")
    is_goal: bool = doc("Whether the goal is in no other mode.", False)
    why: str = doc("Why there is no path without the mode; empty if there is one.", "")
    without: ModeNames = doc("The cheapest mode sequence without it.", tuple)
    steps_without: NonNegative | None = doc("What that was expected to cost [steps].", None)


class TrajectoryDocument(Document):
    modes: Annotated[tuple[ModeName, ...], Listed(1)] = doc("(K) mode at each knot.")
    means: list[list[float]] = doc("(K, n) means of the belief [rad or m].")
    factors: list[list[list[float]]] = doc("(K, n, n) lower Cholesky factors of its covariance.")
    inputs: list[list[float]] = doc("(K-1, m) inputs from knot to knot [rad or m].")
    gains: list[list[list[float]]] = doc("(K-1, m, n) feedback gains.")
    is_transition: list[bool] = doc("(K-1) whether the step is a transition.")

    def read(self, at: Located, scope: Scope) -> Trajectory:
        values, knots, n, m = self.meanings(at, scope), len(self.modes), len(scope["coordinate"]), len(scope["input"])
        shapes = {"means": (knots, n), "factors": (knots, n, n), "inputs": (knots - 1, m), "gains": (knots - 1, m, n)}
        arrays = {key: _array(values[key], shape, at.at(key)) for key, shape in shapes.items()}
        is_transition = _array(self.is_transition, (knots - 1,), at.at("is_transition")).astype(bool)
        return Trajectory(self.modes, **arrays, is_transition=is_transition)


class ArmDocument(Document):
    makes = ArmTrajectory

    joints: Annotated[tuple[Name, ...], Listed(1)] = doc("(J) names of joints, from the root to the tool.")
    positions: Annotated[list[list[float]], _ARRAY] = doc(
        "(K, J) joint positions at the knots, straight lines in between [rad or m]."
    )
    manipulability: Annotated[list[NonNegative], _ARRAY] = doc("(K) Yoshikawa's measure; 0 at singularities.")
    clearance: Annotated[tuple[float | None, ...], Listed()] = doc("(K) smallest distance at each knot [m], or null.")
    least_clearance: float | None = doc("Smallest distance at and between all knots [m].")
    closest_pair: Lines = doc("The two that come so close.")
    closest_knot: Count = doc("The knot at or after which they do.")
    deviation: NonNegative = doc("Largest deviation of the tool from a straight line between knots [m].")
    limit_margin: float | None = doc("Smallest distance of a joint from an end of its range [rad or m].", None)
    limit_joint: str = doc("Name of that joint.", "")
    limit_unit: Literal["rad", "m"] = doc("Unit of that joint.", "rad")

    def check(self, at: Located) -> None:
        for i, row in enumerate(self.positions):
            if len(row) != len(self.joints):
                raise at.at("positions", i).error(f"expected {len(self.joints)} joints, found {len(row)}", _AGAIN)


class ReleasePlanDocument(Document):
    makes = ReleasePlan

    steps: Annotated[int, Field(ge=1)] = doc("Steps down after the last knot, at most: contact is felt earlier.")
    contact: Annotated[list[float], _ARRAY] = doc("(n) state in which contact is expected [rad or m].")
    rest: Annotated[list[float], _ARRAY] = doc("(n) state of the object at rest that is expected [rad or m].")
    withdrawal: Annotated[list[Vector3], _ARRAY] = doc("(W, 3) displacements of the hand after that [m].")
    lowering: ArmDocument | None = doc("The robot from the last knot down to the lowest place.", None)
    withdrawing: ArmDocument | None = doc("The robot from the expected contact away, its gripper open.", None)

    def read(self, at: Located, scope: Scope) -> ReleasePlan:
        for key, state in (("contact", self.contact), ("rest", self.rest)):
            if len(state) != len(scope["coordinate"]):
                raise at.at(key).error(f"expected {len(scope['coordinate'])} numbers, found {len(state)}", _AGAIN)
        return ReleasePlan(**self.meanings(at, scope))


class PlanDocument(Document):
    """A plan with its whole problem, so that it can be executed and shown without other files."""

    always_written = ("success_interval", "findings")

    format: Literal["micah-plan/plan/1"] = doc("Format and version of this file.")
    version: Line = doc("Version of micah_plan that wrote it.")
    digest: str = doc("SHA-256 of everything else in this file.")
    outcome: Outcome = doc("solved, no_plan or not_verified.")
    reason: str = doc("One sentence.")
    mode_sequence: Names = doc("Modes visited, in order.")
    cost: NonNegative | None = doc("Total cost of the trajectory.")
    goal_error: NonNegative | None = doc("Largest predicted distance from the goal [rad or m].")
    goal_std: NonNegative | None = doc("Largest predicted std at the goal [rad or m].")
    success_probability: Probability | None = doc("Share of roll-outs that ended in the goal set.")
    success_interval: Interval | None = doc("95 % interval of the probability of success, given that share.", None)
    verification_trials: Count = doc("Number of roll-outs.")
    seed: Count = doc("Seed of search and verification.")
    candidates: list[CandidateDocument] = doc("Mode sequences tried, cheapest search cost first.")
    findings: list[FindingDocument] = doc(
        "What stands in the way; of a solved plan, what it keeps only in part.",
        list,
        validation_alias=AliasChoices("findings", "obstacles"),
    )
    warnings: Lines = doc("What of the model the plan ignores.", tuple)
    purposes: list[ModePurposeDocument] = doc(
        "Purposes of the plan's modes, as far as the search could determine.", list
    )
    trajectory: TrajectoryDocument | None = doc("Belief trajectory and feedback; null without a plan.")
    arm: ArmDocument | None = doc("The robot along the trajectory; null without a robot.", None)
    release: ReleasePlanDocument | None = doc("How the hand releases the object; null where it keeps the object.", None)
    problem_file: Line = doc("Name of the problem file that was solved; empty if made in Python.")
    digests: dict[Name, Digest] = doc("SHA-256 of the input files, by role.")
    problem: dict[str, Any] = doc("The problem, laid out as a problem file.")
    model: dict[str, Any] = doc("Its model with the noise planned with, laid out as a model file.")

    def _check_share(self, at: Located) -> None:
        """Refuse a success rate without roll-outs, or outside its interval."""
        share, interval = self.success_probability, self.success_interval
        if self.outcome == "solved" and self.verification_trials > 0 and share is None:
            problem = f"expected the share of {self.verification_trials} roll-outs, found none"
            raise at.at("success_probability").error(problem, _AGAIN)
        if share is not None and self.verification_trials == 0:
            problem = f"expected the number of roll-outs of which {share:g} succeeded, found 0"
            raise at.at("verification_trials").error(problem, _AGAIN)
        if share is None or interval is None:
            return
        if not interval[0] - ROUND_OFF <= share <= interval[1] + ROUND_OFF:
            problem = f"expected an interval that holds the share {share:g}, found {interval[0]:g} to {interval[1]:g}"
            raise at.at("success_interval").error(problem, _AGAIN)

    def check(self, at: Located) -> None:
        if (self.trajectory is None) == (self.outcome != "no_plan"):
            content = "no trajectory" if self.trajectory is None else "a trajectory"
            raise at.at("trajectory").error(f"outcome {self.outcome} with {content}", _AGAIN)
        self._check_share(at)
        if self.trajectory is None or self.arm is None:
            return
        at, arm, knots = at.at("arm"), self.arm, len(self.trajectory.modes)
        for key in ("positions", "manipulability", "clearance"):
            if len(getattr(arm, key)) != knots:
                raise at.at(key).error(f"expected {knots} knots, found {len(getattr(arm, key))}", _AGAIN)
        if arm.closest_knot >= knots or len(arm.closest_pair) not in (0, 2):
            raise at.error("its closest pair and knot are none of the plan", _AGAIN)


@dataclass(frozen=True, eq=False)
class StoredPlan:
    """A plan from a file, with its problem.

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
    entries = {
        "format": PLAN_FORMAT,
        "version": __version__,
        "digest": "",
        "mode_sequence": plan.mode_sequence,
        "problem_file": Path(problem.source).name,
        "digests": problem.digests,
        "problem": problem_data(problem, "model"),
        "model": model_data(problem.automaton),
    }
    data = plain_data(PlanDocument, vars(plan) | entries)
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
    """Path of the timings of a plan file: ``PLAN.timings.json`` next to ``PLAN.json``."""
    return Path(path).with_suffix(".timings.json")


def check_timings(path: str | Path) -> None:
    """Refuse a plan path whose timings would overwrite another kind of file.

    Raises:
        InputError: if the file there is none of times.
    """
    beside = timings_path(path)
    if not beside.is_file():
        return
    try:
        times = json.loads(read_bytes(beside, LARGEST_PLAN_BYTES))
        if isinstance(times, dict) and "total" in times and all(isinstance(s, int | float) for s in times.values()):
            return
    except (InputError, ValueError, RecursionError):
        pass
    problem = "would be replaced by the times of the plan, and is a file of another kind"
    raise InputError(problem, source=beside, remedy="rename it, or name another plan file")


def write_timings(plan: Plan, path: str | Path) -> None:
    """Write the plan's times [s] by stage next to the plan file at `path`.

    Raises:
        InputError: if the file cannot be written, or the existing file has no times.
    """
    check_timings(path)
    replace_file(timings_path(path), timings_text(plan).encode())


def timings_text(plan: Plan) -> str:
    """The text of the timings file."""
    return json.dumps(dict(plan.timings), indent=2) + "\n"


def load_plan(path: str | Path) -> StoredPlan:
    """The plan and problem of a file, for any outcome.

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


def require_executable(stored: StoredPlan, anyway: bool = False) -> Trajectory:
    """The trajectory of a solved plan.

    Args:
        anyway: whether one that was found but not verified will do.

    Raises:
        InputError: if the plan has another outcome.
    """
    return executable_trajectory(stored.plan, anyway=anyway, source=stored.source or None)


def _stored(located: Located) -> StoredPlan:
    document = validated(located, PlanDocument)
    automaton = automaton_of_document(located.at("model"))
    stated = located.at("problem")
    problem = problem_of_document(validated(stated, ProblemDocument), automaton, stated)
    problem = replace(problem, source=document.problem_file, digests=document.digests)
    means = () if document.trajectory is None else document.trajectory.means
    planned = with_memory_states(automaton) if means and len(means[0]) != automaton.n else automaton
    values = document.meanings(located, scope_of(planned))
    plan = Plan(**{field.name: values[field.name] for field in fields(Plan) if field.name in values})
    if found := disagreement(plan, problem):
        raise located.at(found[0]).error(found[1], _AGAIN)
    if plan.mode_sequence != document.mode_sequence:
        raise located.at("mode_sequence").error("does not agree with the trajectory's modes", _AGAIN)
    return StoredPlan(plan, problem, document.version, located.source)


def _array(value: Any, shape: tuple[int, ...], at: Located) -> NDArray[np.float64]:
    try:
        result = np.array(value, dtype=np.float64).reshape(shape if not value else np.shape(value))
    except ValueError:
        raise at.error(f"expected shape {shape}, found ragged rows", _AGAIN) from None
    if result.shape != shape:
        raise at.error(f"expected shape {shape}, found {result.shape}", _AGAIN)
    if result.size and np.abs(result).max() > _LARGEST:
        raise at.error(f"expected numbers of at most {_LARGEST:g} in size, found {np.abs(result).max():g}", _AGAIN)
    return result


def _check_numbers(data: Any, path: str) -> None:
    """Refuse numbers that JSON cannot represent, with their key."""
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
        data = json.loads(content.decode("utf-8"), object_pairs_hook=_once)
    except UnicodeDecodeError:
        raise InputError("expected a plan (JSON), found bytes that are no text", source=source, remedy=_AGAIN) from None
    except json.JSONDecodeError as error:
        suffix = Path(source).suffix.lower()
        if suffix not in ("", ".json"):
            what = "a YAML file" if suffix in (".yaml", ".yml") else f"a {suffix} file"
            remedy = "solve the problem first: micah-plan solve PROBLEM -o plan.json"
            raise InputError(f"expected a plan (.json), found {what}", source=source, remedy=remedy) from None
        where, problem = f"line {error.lineno}", f"not valid JSON, damaged or cut short: {error.msg}"
        raise InputError(problem, source=source, where=where, remedy=_AGAIN) from None
    except _TwiceError as twice:
        problem = f"the key {shown(twice.key)} is given twice"
        raise InputError(problem, source=source, remedy=_AGAIN) from None
    except (RecursionError, ValueError):  # ValueError: an integer of thousands of digits
        raise InputError("not a plan: nested too deep or a number too long", source=source, remedy=_AGAIN) from None
    if _depth(data) > _DEEPEST:
        raise InputError("not a plan: nested too deep", source=source, remedy=_AGAIN)
    return data


class _TwiceError(Exception):
    """A key occurs twice in one object."""

    def __init__(self, key: str) -> None:
        super().__init__(key)
        self.key = key


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """An object from pairs, refusing repeated keys, which readers treat differently."""
    entries = dict(pairs)
    if len(entries) < len(pairs):
        keys = [key for key, _ in pairs]
        raise _TwiceError(next(key for i, key in enumerate(keys) if key in keys[:i]))
    return entries


def _depth(data: Any) -> int:
    """Nesting depth, computed without recursion."""
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
