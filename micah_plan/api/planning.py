"""`solve`: from a problem to a verified plan, or to the obstacles."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from micah_plan.api import inputs
from micah_plan.api.inputs import Modelled, Problematic, Source
from micah_plan.api.result import Result
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.errors import InputError, shown
from micah_plan.message import codes_of
from micah_plan.quantities import count, percent, percent_interval, quantity
from micah_plan.summaries import Progress, Table
from micah_plan.task.by_name import Spread
from micah_plan.task.plan import Plan
from micah_plan.task.problem import Problem

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from micah_plan.task.plan import ArmTrajectory


@dataclass(frozen=True, eq=False, repr=False)
class PlanningResult(Result):
    """Result of `solve`: the plan and its problem.

    Attributes:
        notes: remarks on the problem, one line each.
    """

    plan: Plan
    problem: Problem
    notes: tuple[str, ...] = ()

    @property
    def success(self) -> bool:
        """Whether the plan solves the problem."""
        return self.plan.outcome == "solved"

    @property
    def outcome(self) -> str:
        """``"solved"``, ``"no_plan"`` or ``"not_verified"``."""
        return self.plan.outcome

    @property
    def reason(self) -> str:
        """One sentence, with the remedy if it failed."""
        return self.plan.reason

    @property
    def warnings(self) -> tuple[str, ...]:
        """Notes on the problem, and effects that the plan ignores."""
        return (*self.notes, *self.plan.warnings)

    @property
    def title(self) -> str:
        """The name of the problem's file."""
        return Path(self.problem.source).stem or "Plan"

    @property
    def automaton(self) -> HybridAutomaton:
        """The problem's model."""
        return self.problem.automaton

    @property
    def mode_sequence(self) -> tuple[str, ...]:
        """The modes that the plan visits, in order."""
        return self.plan.mode_sequence

    @property
    def success_probability(self) -> float | None:
        """Fraction of roll-outs that end in the goal; None without verification."""
        return self.plan.success_probability

    def report(self) -> list[str | Table]:
        """Outcome, modes, distance from the goal and success rate; without a plan, the obstacles."""
        from micah_plan.planning.findings import explain

        plan, unit = self.plan, self.problem.goal_unit
        lines: list[str | Table] = [f"{plan.outcome}: {plan.reason}"]
        lines += [] if self.success else explain(self.problem, plan).lines[1:]
        if plan.trajectory is not None:
            lines.append(f"  modes        {' -> '.join(plan.mode_sequence)}")
            if plan.goal_error is not None and plan.goal_std is not None:
                distance = f"{quantity(plan.goal_error, unit)} from the target, σ {quantity(plan.goal_std, unit)}"
                lines.append(f"  at the end   {distance}")
            if plan.success_probability is not None:
                share = f"{percent(plan.success_probability)} of {count(plan.verification_trials, 'roll-out')}"
                pair = plan.success_interval
                sure = "" if pair is None else f" (95 % interval: {percent_interval(*pair)})"
                lines.append(f"  success      {share}{sure}")
        return lines

    def json(self) -> dict[str, Any]:
        """Outcome, modes, goal error, success rate, findings and times."""
        plan = self.plan
        return {
            "outcome": plan.outcome,
            "reason": plan.reason,
            "modes": plan.mode_sequence,
            "cost": plan.cost,
            "goal_error": plan.goal_error,
            "goal_std": plan.goal_std,
            "success_probability": plan.success_probability,
            "success_interval": plan.success_interval,
            "verification_trials": plan.verification_trials,
            "findings": [asdict(finding) for finding in plan.findings],
            "warnings": plan.warnings,
            "warning_codes": codes_of(plan.warnings),
            "arm": None if plan.arm is None else _arm(plan.arm),
            "seconds": plan.timings,
            "seed": plan.seed,
        }

    def plot(self) -> Figure:
        """The planned belief over the steps.

        Raises:
            InputError: if there is no trajectory to draw.
        """
        from micah_plan.view.figures import belief_figure

        return belief_figure(self.problem, self.plan)

    def page(self, title: str = "") -> str:
        """The plan in 3-D; without one, start and goal."""
        from micah_plan.view.plan_page import plan_page

        return plan_page(self.plan, self.problem, title=title or self.title)

    def save(self, path: str | Path) -> None:
        """Write the plan with its problem (JSON)."""
        from micah_plan.documents.plan import write_plan

        write_plan(self.plan, self.problem, path)


def _arm(arm: ArmTrajectory) -> dict[str, Any]:
    return {
        "least_clearance": arm.least_clearance,
        "closest_pair": arm.closest_pair,
        "closest_knot": arm.closest_knot,
        "least_manipulability": float(arm.manipulability.min()),
        "deviation": arm.deviation,
        "limit_margin": arm.limit_margin,
        "limit_joint": arm.limit_joint,
    }


def solve(
    problem: Problematic,
    *,
    model: Modelled | None = None,
    start: Mapping[str, Spread] | None = None,
    start_mode: str | None = None,
    goal: Mapping[str, Spread] | None = None,
    modes: str | Sequence[str] | None = None,
    noise: Mapping[str, Mapping[str, float]] | None = None,
    seed: int = 0,
    advise: bool = True,
    planner: Callable[..., Plan] | None = None,
    progress: Progress | None = None,
    **changes: Any,
) -> PlanningResult:
    """Solve a problem: a plan that holds with the problem's confidence, or the obstacles.

    Args:
        problem: a path, a problem, data with the keys of a problem file, or an earlier result whose problem is solved
            again; a model, or the result of learning one, is moved most of its way if no start and goal are given.
        model: to use instead of the problem's: a path, an automaton, or the result of `learn` or `calibrate`.
        start, start_mode, goal, modes, noise: instead of the problem's, by name, as in ``start={"door": (0.4, 0.05)},
            goal={"door": (1.2, 0.03)}, modes=["rigid"]`` (`Problem.replace`).
        seed: of everything random.
        advise: whether remedies name numbers, which takes further solutions.
        planner: an alternative to POMDP-HD, whose plans are checked in the same way (`planning.solver.solve`).
        progress: called with a message and the fraction done.
        **changes: settings by name, e.g. ``confidence=0.99, max_knots=80``.

    Raises:
        InputError: if the problem or the model cannot be used, or a setting is none.
    """
    from micah_plan.planning.solver import solve as solved

    asked, notes = inputs.problem_and_notes(problem, model)
    if any(given is not None for given in (start, start_mode, goal, modes, noise)):
        asked = inputs.checked_again(
            asked.replace(start=start, start_mode=start_mode, goal=goal, modes=modes, noise=noise)
        )
    asked = replace(asked, settings=inputs.planner_settings(asked, changes))
    plan = solved(asked, seed=seed, progress=progress, advise=advise, planner=planner)
    return PlanningResult(plan, asked, notes)


def plan_of(source: object) -> PlanningResult:
    """A plan with its problem, from a file or a result of `solve`.

    Raises:
        InputError: for anything else.
    """
    if isinstance(source, Source):
        from micah_plan.documents.plan import load_plan

        stored = load_plan(source)
        return PlanningResult(stored.plan, stored.problem)
    if not isinstance(source, PlanningResult):
        problem = f"expected a plan, found {shown(type(source).__name__)}"
        raise InputError(problem, remedy="give the path of one, or what solve returns")
    return source
