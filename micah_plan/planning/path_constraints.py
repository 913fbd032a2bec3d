"""Path constraints and costs (`task.path`) evaluated with arrays: roll-outs, executions, trajectories.

A step counts where it ends: one that ends with a transition, behind it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from micah_plan.arrays import EQUAL, Booleans, Floats, Ints
from micah_plan.planning import messages
from micah_plan.planning.limits import Limits
from micah_plan.planning.offers import LESS_NOISE, MORE_CONFIDENCE, SURER_START
from micah_plan.task.path import Pay, Require, path_terms
from micah_plan.task.plan import Finding, Trajectory
from micah_plan.task.problem import Problem
from micah_plan.task.reason import Offer, one_of


@dataclass(eq=False)
class PathRecord:
    """Record of the constraints that t roll-outs or executions violate, updated step by step.

    Attributes:
        problem: with the constraints, over the coordinates of the true states.
        count: t.
        worst: per constraint, by name and unit, the (t,) smallest margins so far; infinite where it never acted.
    """

    problem: Problem
    count: int
    worst: dict[tuple[str, str], Floats] = field(default_factory=dict)

    def add(self, modes: Ints, x: Floats, u: Floats, factors: Floats) -> None:
        """Record one step of each roll-out.

        Args:
            modes: (t,) indices of the true modes behind it; x: (t, n) true states there.
            u: (t, m) inputs that were commanded.
            factors: (t, n, n) square roots of the covariances of the most likely modes' beliefs there, or over more
                coordinates that come last.
        """
        if not self.problem.constraints:
            return
        std = np.linalg.norm(factors, axis=-1)
        for index in np.unique(modes):
            rows = modes == index
            name = self.problem.automaton.modes[index].name
            for term in _terms(self.problem, name, x[rows], u[rows], std[rows]):
                if isinstance(term, Require):
                    worst = self.worst.setdefault((term.name, term.unit), np.full(self.count, np.inf))
                    worst[rows] = np.fmin(worst[rows], np.where(np.isnan(term.margin), -np.inf, term.margin))

    @property
    def is_broken(self) -> Booleans:
        """(t,) whether any constraint was violated."""
        broken = [worst < -EQUAL for worst in self.worst.values()]
        return np.any(broken, axis=0) if broken else np.zeros(self.count, dtype=bool)

    def sentences(self) -> list[str]:
        """The violated constraints, each with its largest violation."""
        worst = [(name, unit, -float(margin.min())) for (name, unit), margin in self.worst.items()]
        return [messages.constraint_violated(name, by, unit) for name, unit, by in worst if by > EQUAL]

    def findings(self, modes: tuple[str, ...]) -> list[tuple[float, Finding]]:
        """(violating fraction, finding) of each constraint that roll-outs of a plan through these modes violate."""
        findings, confidence = list[tuple[float, Finding]](), self.problem.settings.confidence
        for (name, unit), worst in self.worst.items():
            share, amount = float((worst < -EQUAL).mean()), -float(worst.min())
            if share == 0.0:
                continue
            is_number = amount < np.inf

            ways: tuple[str | Offer, ...] = LESS_NOISE, SURER_START, MORE_CONFIDENCE
            missing = -float(np.quantile(worst, 1.0 - confidence, method="inverted_cdf"))
            if EQUAL < missing < np.inf:
                ways = messages.relax_for_share(missing, unit, confidence), *ways
            sentence = messages.breaks_constraint(share, name, amount if is_number else None, unit)
            place = modes, "", None, f"'{name}'"
            finding = Finding("verification", "breaks_constraint", sentence, one_of(ways), *place, unit=unit, ways=ways)
            findings.append((share, replace(finding, amount=amount if is_number else None)))
        return findings


def joined_records(records: Sequence[PathRecord]) -> PathRecord:
    """One record of all roll-outs of several (at least one)."""
    worst = {}
    for key in dict.fromkeys(key for record in records for key in record.worst):
        worst[key] = np.concatenate([record.worst.get(key, np.full(record.count, np.inf)) for record in records])
    return PathRecord(records[0].problem, sum(record.count for record in records), worst)


def path_cost(problem: Problem, trajectory: Trajectory) -> float:
    """Cost of a trajectory under the problem's path constraints."""
    automaton, cost = problem.automaton, 0.0
    for knot in np.flatnonzero(~trajectory.is_transition) if problem.constraints else ():
        end = int(knot) + 1
        while end < len(trajectory.is_transition) and trajectory.is_transition[end]:
            between = [e for e in automaton.edges if (e.source, e.target) == tuple(trajectory.modes[end : end + 2])]
            if any(edge.guard.on_input for edge in between):
                break
            end += 1
        std = np.linalg.norm(trajectory.factors[end], axis=-1)
        point = trajectory.means[end][None], trajectory.inputs[knot][None], std[None]
        for term in _terms(problem, trajectory.modes[end], *point):
            cost += float(np.sum(term.amount)) if isinstance(term, Pay) else 0.0
    return cost


def admitted(problem: Problem, limits: Limits, mode: str, x: Floats) -> Booleans:
    """(k,) whether known states (k, n) of a mode satisfy the constraints at rest or for some largest input."""
    m, margins = problem.automaton.m, []
    for u in np.vstack([np.zeros(m), np.diag(limits.max_step), -np.diag(limits.max_step)]):
        terms = _terms(problem, mode, x, np.tile(u, (len(x), 1)), np.zeros_like(x))
        required = [np.broadcast_to(term.margin, len(x)) for term in terms if isinstance(term, Require)]
        margins.append(np.array(required).reshape(-1, len(x)))
    return np.asarray((np.max(margins, axis=0) >= -EQUAL).all(axis=0))


def _terms(problem: Problem, mode: str, x: Floats, u: Floats, std: Floats) -> Iterator[Require | Pay]:
    """Terms of the constraints that are active in a mode, for k steps: states and stds (k, n), inputs (k, m)."""
    for constraint in problem.constraints:
        if constraint.acts_in(mode):
            yield from path_terms(constraint, np, problem.automaton, x.T, u.T, std.T)
