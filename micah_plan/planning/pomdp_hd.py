"""POMDP-HD: mode sequences from a search, a belief trajectory through each, the cheapest with feedback around it.

    1. high level   search the roadmaps of all modes for the cheapest mode sequences        `search`
    2. low level    optimise the belief trajectory through each of them                     `transcription`
    3. choose       the cheapest optimum of all                                             here
    4. feedback     belief-LQR around it                                                    `feedback`

Source: Jain and Niekum, "Efficient hierarchical robot motion planning under uncertainty and hybrid dynamics", CoRL
2018.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from micah_plan.automaton.input_memory import own_size
from micah_plan.planning.attempt import Attempt, Progress, attempted
from micah_plan.planning.chains import with_chains
from micah_plan.planning.feedback import belief_lqr
from micah_plan.planning.findings import finding_of_reason, finding_of_status, findings_of, sentence_of
from micah_plan.planning.input_memory import with_input_memory, without_input_memory
from micah_plan.planning.limits import Limits, limits_of
from micah_plan.planning.no_way import NoWayError
from micah_plan.planning.search.mode_search import ModeSequence, SearchResult, search_modes
from micah_plan.planning.transcription.guess import guess
from micah_plan.planning.transcription.programme import transcribe
from micah_plan.planning.transcription.solve import BeliefPath, solve, unmet
from micah_plan.task.deadline import Deadline, TimeLimitError
from micah_plan.task.plan import Candidate, Finding, Plan, Trajectory
from micah_plan.task.problem import Problem

# Factors on the number of steps of a path, tried in turn: slower inputs, more measurements at a guard.
_STRETCHES = (1.0, 2.0, 4.0)
# Inputs below this share of the largest step are the solver's rounding; on a guard like u < 0 they would matter.
_INPUT_ROUNDING = 1e-6


def plan(problem: Problem, seed: int = 0, progress: Progress | None = None, deadline: Deadline | None = None) -> Plan:
    """Plan from the start belief to the goal. Deterministic but for the limits of processor time.

    Args:
        problem: what to solve.
        seed: of the search.
        progress: called with one line of text and the fraction done whenever a stage begins.
        deadline: when to end; None: as the settings say, from now on.

    Returns:
        A plan with outcome ``"solved"`` (to be confirmed by `verification.verify`) or ``"no_plan"`` with the reason.
    """
    return attempted(planned, "search", problem, seed, progress, deadline)


def with_memory(problem: Problem, sequence: ModeSequence) -> ModeSequence:
    """A sequence found over x as one over (x, m), m as at the start of the problem: search asks for x only."""
    memory = np.array(problem.start.mean[own_size(problem.automaton) :])
    paths = [np.hstack([path, np.tile(memory, (len(path), 1))]) for path in sequence.waypoints]
    return replace(sequence, waypoints=tuple(paths))


def planned(attempt: Attempt, found: SearchResult | None = None) -> Plan:
    """The algorithm; `found`: mode sequences to optimise over x, None: those that a search finds.

    A memory of inputs does not change which mode sequences there are.
    """
    attempt = replace(attempt, problem=with_chains(with_input_memory(attempt.problem)))
    if found is None:
        attempt.progress("searching mode sequences", 0.0)
        plain = without_input_memory(attempt.problem)
        with attempt.clock.stage("search"):
            found = search_modes(plain, limits_of(plain), attempt.mode, attempt.seed, deadline=attempt.deadline)
    if not found.sequences:
        raise NoWayError(found.reason)
    tried = []
    for number, sequence in enumerate(found.sequences, start=1):
        attempt.progress(f"optimising {' -> '.join(sequence.modes)}", number / (len(found.sequences) + 1))
        tried.append(_low_level(attempt, with_memory(attempt.problem, sequence)))
    candidates = tuple(one.candidate for one in tried)
    paths = [(one.path, one.sequence) for one in tried if one.path is not None and one.path.feasible]
    if not paths:
        first, findings = candidates[0], tuple(finding for one in tried for finding in one.findings)
        reason = f"no mode sequence could be optimised; {' -> '.join(first.modes)}: {first.message}"
        return attempt.refused(reason, findings, candidates)
    best, sequence = min(paths, key=lambda pair: pair[0].cost)
    trajectory = trajectory_of(attempt.problem, attempt.limits, best)
    which = f"cheapest of {len(tried)} mode sequences" if len(tried) > 1 else "the only mode sequence"
    in_part = tuple(findings_of(attempt.problem, sequence.modes, best.in_part))
    return attempt.solved(trajectory, best.cost, f", {which}: {best.message}", candidates, in_part)


@dataclass(frozen=True, eq=False)
class _Tried:
    """A mode sequence that was optimised: the belief path, if there is any, and what stands in the way of it."""

    sequence: ModeSequence
    path: BeliefPath | None
    message: str
    findings: tuple[Finding, ...] = ()

    @property
    def candidate(self) -> Candidate:
        cost = self.path.cost if self.path is not None and self.path.feasible else None
        return Candidate(self.sequence.modes, self.sequence.total, cost, self.message)


def _low_level(attempt: Attempt, sequence: ModeSequence) -> _Tried:
    """The belief path through a mode sequence, in as few steps as lead through it."""
    try:
        return _optimised(attempt, sequence)
    except (NoWayError, TimeLimitError) as failed:
        finding = finding_of_reason("optimisation", failed.reason, sequence.modes)
        return _Tried(sequence, None, failed.reason, (finding,))


def _optimised(attempt: Attempt, sequence: ModeSequence) -> _Tried:
    problem, deadline, clock, steps = attempt.problem, attempt.deadline, attempt.clock, -1
    name, state = " -> ".join(sequence.modes), "was not tried"
    for stretch in _STRETCHES:
        deadline.check("optimisation", f"{name} {state}", "candidates")
        with clock.stage("build"):
            phases = guess(problem, attempt.limits, sequence, stretch)
            longer = sum(phase.steps for phase in phases)
            if longer == steps:
                break
            steps, state = longer, "was not tried with more knots"
            nlp = transcribe(problem, attempt.limits, phases)
        with clock.stage("optimise"):
            path = solve(nlp, _time_limit(attempt))
        if path.feasible:
            return _Tried(sequence, path, path.message)
        deadline.check("optimisation", f"{name} was at {steps} steps", "candidates")
    if path.is_out_of_time:  # its state then does not say what is possible
        return _Tried(sequence, path, path.message, (finding_of_status(sequence.modes, path.message),))
    with clock.stage("optimise"):
        missed = unmet(nlp, _time_limit(attempt))
    message = "; ".join([path.message, *map(sentence_of, missed)])
    findings = findings_of(problem, sequence.modes, missed) or [finding_of_status(sequence.modes, path.message)]
    return _Tried(sequence, path, message, tuple(findings))


def _time_limit(attempt: Attempt) -> float:
    """Time limit of an optimisation that begins now [s]."""
    return min(attempt.problem.settings.time_limit_s, attempt.deadline.left_s)


def trajectory_of(problem: Problem, limits: Limits, path: BeliefPath) -> Trajectory:
    """A belief path with the feedback around it."""
    inputs = np.where(np.abs(path.inputs) < _INPUT_ROUNDING * limits.max_step, 0.0, path.inputs)
    inputs = np.clip(inputs, -limits.max_step, limits.max_step)  # the solver meets bounds only to its tolerance
    gains = belief_lqr(problem, limits, path.modes, path.is_transition, (path.means, inputs))
    return Trajectory(path.modes, path.means, path.factors, inputs, gains, path.is_transition)
